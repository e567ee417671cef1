/* Sums over the samples of every pixel, or the largest of what they leave at places of a table.
   What stands between two @ is filled in by emit.py. */
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <mutex>
#ifdef __AVX2__
#include <immintrin.h>
#endif

#include "xla/ffi/api/c_api.h"

enum {
  HEIGHT = @HEIGHT@,
  WIDTH = @WIDTH@,
  COUNT = @COUNT@,
  SUMS = @SUMS@,
  RESULTS = @RESULTS@, /* of a pixel */
  KEPT = @KEPT@, /* of them that pixels which do not move take from the last argument */
  REST = @REST@, /* 0, or all of them if such pixels have results of their own */
  ARGUMENTS = @ARGUMENTS_READ@ + (KEPT > 0),
  TABLES = @TABLES@, /* results that taps add to anywhere, or leave their marks in */
#ifdef __AVX512F__
  LANES = 16, /* pixels of a row that go through the samples together */
#else
  LANES = 8,
#endif
  STRIP = TABLES ? 256 : WIDTH, /* pixels of a row at a time: what taps add to stays in the cache */
  ROWS_AT_ONCE = 4, /* rows of a strip that a thread takes at a time: a piece */
  PIECES_OF_STRIP = (HEIGHT + ROWS_AT_ONCE - 1) / ROWS_AT_ONCE,
  PIECES = (WIDTH + STRIP - 1) / STRIP * PIECES_OF_STRIP,
  MOST_PARTS_WITH_TABLES = 8 /* each has tables of its own */
};

typedef @ELEMENT@ Element; /* of such a table */

/* One value a lane; a comparison gives -1 where it holds and 0 elsewhere. */
typedef float Floats __attribute__((vector_size(4 * LANES)));
typedef int32_t Ints __attribute__((vector_size(4 * LANES)));

static inline Floats wide(float a) { return a - Floats{}; }
static inline Ints wide(int32_t a) { return a - Ints{}; }
static inline Ints wide(bool a) { return -int32_t(a) - Ints{}; }

static inline Ints lane_numbers() {
  Ints numbers;
  for (int k = 0; k < LANES; ++k) numbers[k] = k;
  return numbers;
}
static inline Floats to_floats(Ints a) { return __builtin_convertvector(a, Floats); }
static inline Ints to_ints(Floats a) { return __builtin_convertvector(a, Ints); }

/* Maximum and minimum that give the second value if there is a NaN. Compilers do not make one
   instruction of a choice between vectors. */
#if defined(__AVX512F__)
static inline Floats larger(Floats a, Floats b) {
  return (Floats)_mm512_max_ps((__m512)a, (__m512)b);
}
static inline Floats smaller(Floats a, Floats b) {
  return (Floats)_mm512_min_ps((__m512)a, (__m512)b);
}
#elif defined(__AVX2__)
static inline Floats larger(Floats a, Floats b) {
  return (Floats)_mm256_max_ps((__m256)a, (__m256)b);
}
static inline Floats smaller(Floats a, Floats b) {
  return (Floats)_mm256_min_ps((__m256)a, (__m256)b);
}
#else
static inline Floats larger(Floats a, Floats b) { return a > b ? a : b; }
static inline Floats smaller(Floats a, Floats b) { return a < b ? a : b; }
#endif
static inline float larger(float a, float b) { return a > b ? a : b; }
static inline float smaller(float a, float b) { return a < b ? a : b; }

/* Maximum and minimum that keep NaN. */
template <typename Value>
static inline Value max_float(Value a, Value b) { return a != a ? a : larger(a, b); }
template <typename Value>
static inline Value min_float(Value a, Value b) { return a != a ? a : smaller(a, b); }
static inline Ints max_int(Ints a, Ints b) { return a > b ? a : b; }
static inline Ints min_int(Ints a, Ints b) { return a < b ? a : b; }
static inline int32_t max_int(int32_t a, int32_t b) { return a > b ? a : b; }
static inline int32_t min_int(int32_t a, int32_t b) { return a < b ? a : b; }

/* The lanes in which a comparison holds, a bit each. */
static inline uint32_t lanes_of(Ints a) {
#if defined(__AVX512F__)
  return _mm512_test_epi32_mask((__m512i)a, (__m512i)a);
#elif defined(__AVX2__)
  return _mm256_movemask_ps((__m256)a);
#else
  uint32_t lanes = 0;
  for (int k = 0; k < LANES; ++k) lanes |= uint32_t(a[k] != 0) << k;
  return lanes;
#endif
}
static inline bool any(Ints a) { return lanes_of(a) != 0; }

static inline int32_t largest(Ints a) {
  int32_t most = 0;
  for (int k = 0; k < LANES; ++k) most = a[k] > most ? a[k] : most;
  return most;
}

static inline float sign_float(float a) { return a > 0 ? 1.0f : (a < 0 ? -1.0f : a); }
static inline Floats sign_float(Floats a) {
  return a > 0 ? wide(1.0f) : (a < 0 ? wide(-1.0f) : a);
}
static inline Floats fabsf(Floats a) { return (Floats)((Ints)a & 0x7fffffff); }

#define LANE_BY_LANE(name)                                      \
  static inline Floats name(Floats a) {                         \
    Floats result;                                              \
    for (int k = 0; k < LANES; ++k) result[k] = ::name(a[k]);   \
    return result;                                              \
  }
LANE_BY_LANE(ceilf)
LANE_BY_LANE(cosf)
LANE_BY_LANE(expf)
LANE_BY_LANE(log1pf)
LANE_BY_LANE(rintf)
LANE_BY_LANE(roundf)
LANE_BY_LANE(sinf)
LANE_BY_LANE(sqrtf)
LANE_BY_LANE(tanhf)

/* Natural logarithm, within two units in the last place [Cephes]: of m 2^exponent, m in
   [sqrt(1/2), sqrt(2)), that of m by a polynomial in m - 1. */
static inline Floats logf(Floats a) {
  const Ints usual = (a >= 0x1p-126f) & (a < INFINITY);
  if (any(~usual)) {
    Floats result;
    for (int k = 0; k < LANES; ++k) result[k] = ::logf(a[k]);
    return result;
  }
  const Ints bits = (Ints)a;
  const Floats half = (Floats)((bits & 0x7fffff) | 0x3f000000); /* in [1/2, 1) */
  const Ints low = half < 0x1.6a09e6p-1f;
  const Floats exponent = to_floats((bits >> 23) - 126 + low);
  const Floats x = (low ? half + half : half) - 1.0f;
  Floats y = 7.0376836292e-2f * x - 1.1514610310e-1f;
  y = y * x + 1.1676998740e-1f;
  y = y * x - 1.2420140846e-1f;
  y = y * x + 1.4249322787e-1f;
  y = y * x - 1.6668057665e-1f;
  y = y * x + 2.0000714765e-1f;
  y = y * x - 2.4999993993e-1f;
  y = y * x + 3.3333331174e-1f;
  y = y * x * x * x - 2.12194440e-4f * exponent - 0.5f * x * x;
  return x + y + 0.693359375f * exponent;
}

#define LANE_BY_LANE_OF_TWO(name)                                   \
  static inline Floats name(Floats a, Floats b) {                   \
    Floats result;                                                  \
    for (int k = 0; k < LANES; ++k) result[k] = ::name(a[k], b[k]); \
    return result;                                                  \
  }
LANE_BY_LANE_OF_TWO(fmodf)
LANE_BY_LANE_OF_TWO(powf)

#if defined(__AVX512F__)
static inline Floats floorf(Floats a) {
  return (Floats)_mm512_roundscale_ps((__m512)a, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
}
static inline Ints floor_to_ints(Floats a) {
  return (Ints)_mm512_cvt_roundps_epi32((__m512)a, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
}
static inline Floats read(const float* table, Ints index) {
  return (Floats)_mm512_i32gather_ps((__m512i)index, table, 4);
}
static inline Ints read(const int32_t* table, Ints index) {
  return (Ints)_mm512_i32gather_epi32((__m512i)index, table, 4);
}
/* Two neighbors in memory at once: half of the loads. */
static inline void read(const float* table, Ints index, Floats& first, Floats& second) {
  const double* pairs = (const double*)table;
  const __m256i upper = _mm512_extracti64x4_epi64((__m512i)index, 1);
  const __m512 low =
      (__m512)_mm512_i32gather_pd(_mm512_castsi512_si256((__m512i)index), pairs, 4);
  const __m512 high = (__m512)_mm512_i32gather_pd(upper, pairs, 4);
  const __m512i even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
  first = (Floats)_mm512_permutex2var_ps(low, even, high);
  second = (Floats)_mm512_permutex2var_ps(low, _mm512_add_epi32(even, _mm512_set1_epi32(1)), high);
}
#elif defined(__AVX2__)
static inline Floats floorf(Floats a) { return (Floats)_mm256_floor_ps((__m256)a); }
static inline Floats read(const float* table, Ints index) {
  return (Floats)_mm256_i32gather_ps(table, (__m256i)index, 4);
}
static inline Ints read(const int32_t* table, Ints index) {
  return (Ints)_mm256_i32gather_epi32(table, (__m256i)index, 4);
}
#else
LANE_BY_LANE(floorf)
static inline Floats read(const float* table, Ints index) {
  Floats result;
  for (int k = 0; k < LANES; ++k) result[k] = table[index[k]];
  return result;
}
static inline Ints read(const int32_t* table, Ints index) {
  Ints result;
  for (int k = 0; k < LANES; ++k) result[k] = table[index[k]];
  return result;
}
#endif

#if !defined(__AVX512F__)
static inline Ints floor_to_ints(Floats a) { return to_ints(floorf(a)); }
static inline void read(const float* table, Ints index, Floats& first, Floats& second) {
  first = read(table, index);
  second = read(table, index + 1);
}
#endif

/* Lanes often read neighbors in memory, those of a plane at the same offset: one load then. */
static inline Floats read_plane(const float* table, Ints index) {
  const int32_t first = index[0];
  if (any(index != first + lane_numbers())) return read(table, index);
  Floats result;
  memcpy(&result, table + first, sizeof result);
  return result;
}

/* Lanes beyond the end of a row hold the row's last value; they are never written back. */
template <typename Wide, typename Narrow>
static inline Wide load(const Narrow* row, int lanes) {
  Wide result;
  for (int k = 0; k < LANES; ++k) result[k] = row[k < lanes ? k : lanes - 1];
  return result;
}
static inline Floats load_floats(const float* row, int lanes) {
  if (lanes < LANES) return load<Floats>(row, lanes);
  Floats result;
  memcpy(&result, row, sizeof result);
  return result;
}
static inline void store(float* row, Floats values, int lanes) {
  if (lanes == LANES) {
    memcpy(row, &values, sizeof values);
  } else {
    for (int k = 0; k < lanes; ++k) row[k] = values[k];
  }
}

/* Four vectors as rows of four, one a lane: that of lane 4 p + k is part p of rows[k]. */
#if defined(__AVX512F__)
static inline void make_rows(const Floats* a, Floats* rows) {
  const __m512 low = _mm512_unpacklo_ps((__m512)a[0], (__m512)a[1]);
  const __m512 high = _mm512_unpackhi_ps((__m512)a[0], (__m512)a[1]);
  const __m512 more_low = _mm512_unpacklo_ps((__m512)a[2], (__m512)a[3]);
  const __m512 more_high = _mm512_unpackhi_ps((__m512)a[2], (__m512)a[3]);
  rows[0] = (Floats)_mm512_unpacklo_pd((__m512d)low, (__m512d)more_low);
  rows[1] = (Floats)_mm512_unpackhi_pd((__m512d)low, (__m512d)more_low);
  rows[2] = (Floats)_mm512_unpacklo_pd((__m512d)high, (__m512d)more_high);
  rows[3] = (Floats)_mm512_unpackhi_pd((__m512d)high, (__m512d)more_high);
}
#else
static inline void make_rows(const Floats* a, Floats* rows) {
  for (int lane = 0; lane < LANES; ++lane)
    for (int c = 0; c < 4; ++c) rows[lane % 4][lane / 4 * 4 + c] = a[c][lane];
}
#endif

/* Adds a row of neighbors a lane. Lanes may meet at one place, so they add in turn. Only rows of
   four are added whole: others would overlap, and what was just stored in part is slow to load. */
template <int COLUMNS>
static inline void add(float* table, Ints index, const Floats (&values)[COLUMNS], int lanes) {
  typedef float Four __attribute__((vector_size(16)));
  Floats padded[4] = {}, rows[4];
  for (int c = 0; c < COLUMNS; ++c) padded[c] = values[c];
  make_rows(padded, rows);
  float memory[4][LANES];
  int32_t places[LANES];
  memcpy(memory, rows, sizeof memory);
  memcpy(places, &index, sizeof places);
  for (int k = 0; k < lanes; ++k) {
    float* place = table + places[k];
    const float* row = memory[k % 4] + k / 4 * 4;
    if (COLUMNS == 4) {
      Four sum, more;
      memcpy(&sum, place, sizeof sum);
      memcpy(&more, row, sizeof more);
      sum += more;
      memcpy(place, &sum, sizeof sum);
    } else {
      for (int c = 0; c < COLUMNS; ++c) place[c] += row[c];
    }
  }
}

/* Adds a row of three a lane, to a table in which it has the room of four. The index, that of the
   row without that room, is a multiple of 3, which the inverse of 3 modulo 2^32 divides exactly. */
static inline void add_three(float* table, Ints index, const Floats (&values)[3], int lanes) {
  const Floats row[4] = {values[0], values[1], values[2], Floats{}};
  add(table, index * (int32_t)0xAAAAAAABu * 4, row, lanes);
}

/* Keeps the larger of what is there and the lane's own. Lanes may meet at one place, so they come
   in turn. */
static inline void keep_larger(int32_t* table, Ints places, Ints marks, int lanes) {
  const Ints there = read(table, places);
  uint32_t larger = lanes_of(marks > there);
  if (larger == 0) return;
  int32_t place[LANES], mark[LANES];
  memcpy(place, &places, sizeof place);
  memcpy(mark, &marks, sizeof mark);
  for (; larger != 0; larger &= larger - 1) {
    const int k = __builtin_ctz(larger);
    if (k < lanes && mark[k] > table[place[k]]) table[place[k]] = mark[k];
  }
}

static inline float joined(float a, float b) { return a + b; }
static inline int32_t joined(int32_t a, int32_t b) { return max_int(a, b); }

static const int64_t TABLE_SIZES[] = {@TABLE_SIZES@};
static const bool ROWS_OF_THREE[] = {@ROWS_OF_THREE@}; /* with the room of four while added to */
@CONSTANTS@
/* A call. Threads take its parts in turn, so that it waits for none that has not begun. */
struct Job {
  const float* kept;
  void* const* arguments;
  float* results[RESULTS + 1];
  Element* tables[TABLES + 1];
  Element* tables_of_part[MOST_PARTS_WITH_TABLES][TABLES + 1];
  int parts;
  std::atomic<int> next_part{0}, users{1};
  std::mutex mutex;
  std::condition_variable finished;
  int parts_done = 0;
};

/* Results of the lanes that move; what is kept by the others. */
static inline void store_results(const Job* job, int64_t pixel, Ints moving,
                                 const Floats* results, int lanes, bool more) {
  if (KEPT == 0) {
    for (int k = 0; k < RESULTS; ++k) store(job->results[k] + pixel, results[k], lanes);
    return;
  }
  if (KEPT == RESULTS && !any(moving)) {
    memcpy(job->results[0] + pixel * KEPT, job->kept + pixel * KEPT, sizeof(float) * KEPT * lanes);
    return;
  }
  if (RESULTS <= 4 && more) {
    const Ints own = ((int32_t)pixel + lane_numbers()) * (int32_t)KEPT;
    Floats columns[4] = {}, rows[4];
    for (int k = 0; k < RESULTS; ++k)
      columns[k] = moving ? results[k] : k < KEPT ? read(job->kept, own + k) : Floats{};
    make_rows(columns, rows);
    float memory[4][LANES];
    memcpy(memory, rows, sizeof memory);
    /* A row of four each, the end of which the next one overwrites, at last those of the pixels
       which this thread computes next. */
    for (int lane = 0; lane < LANES; ++lane)
      memcpy(job->results[0] + (pixel + lane) * RESULTS, memory[lane % 4] + lane / 4 * 4, 16);
    return;
  }
  float values[RESULTS + 1][LANES];
  memcpy(values, results, sizeof values);
  for (int lane = 0; lane < lanes; ++lane) {
    float* result = job->results[0] + (pixel + lane) * RESULTS;
    const float* kept = job->kept + (pixel + lane) * KEPT;
    for (int k = 0; k < RESULTS; ++k)
      result[k] = moving[lane] ? values[k][lane] : k < KEPT ? kept[k] : 0.0f;
  }
}

static void sum_row(const Job* job, Element* const* tables, const int row, const int from,
                    const int until) {
  (void)tables;
  const int64_t start = (int64_t)row * WIDTH;
  const Ints y = wide((int32_t)row);
@ARGUMENTS@
  for (int first = from; first < until; first += LANES) {
    const int lanes = until - first < LANES ? until - first : LANES;
    const int64_t pixel = start + first;
    const Ints x = first + lane_numbers();
    const Ints own = (int32_t)pixel + min_int(lane_numbers(), wide(lanes - 1));
    (void)x, (void)y, (void)own;
    Floats results[RESULTS + 1] = {};
@MOVING@
    if (any(moving)) {
      Floats sums[SUMS + 1] = {};
      int32_t last = COUNT;
@PIXEL@
      for (int32_t i = 0; i < last; ++i) {
@SAMPLE@
@TAP@
      }
@FINISH@
    }
    const Ints computed = REST ? wide(true) : moving;
    store_results(job, pixel, computed, results, lanes, first + LANES + 4 <= until);
  }
}

/* Some rows of one strip. */
static void sum_piece(const Job* job, Element* const* tables, int piece) {
  const int from = piece / PIECES_OF_STRIP * STRIP;
  const int row = piece % PIECES_OF_STRIP * ROWS_AT_ONCE;
  const int until = from + STRIP < WIDTH ? from + STRIP : WIDTH;
  const int end = row + ROWS_AT_ONCE < HEIGHT ? row + ROWS_AT_ONCE : HEIGHT;
  for (int k = row; k < end; ++k) sum_row(job, tables, k, from, until);
}

/* A part is one piece. Where taps add to tables it has tables of its own and every so many pieces,
   the same in every run, so that the same input gives the same bits. */
static void sum_part(const Job* job, int part) {
  if (TABLES == 0) return sum_piece(job, job->tables, part);
  for (int piece = part; piece < PIECES; piece += job->parts)
    sum_piece(job, job->tables_of_part[part], piece);
}

/* What a thread does; the last one that knows the job removes it. */
static void work(void* argument) {
  Job* job = static_cast<Job*>(argument);
  int done = 0;
  for (int part = job->next_part++; part < job->parts; part = job->next_part++, ++done)
    sum_part(job, part);
  if (done) {
    std::lock_guard<std::mutex> lock(job->mutex);
    job->parts_done += done;
    if (job->parts_done == job->parts) job->finished.notify_one();
  }
  if (--job->users == 0) delete job;
}

/* Whether XLA refused something; its error is thrown away. */
static bool refused(const XLA_FFI_Api* api, XLA_FFI_Error* error) {
  if (!error) return false;
  XLA_FFI_Error_Destroy_Args arguments = {};
  arguments.struct_size = XLA_FFI_Error_Destroy_Args_STRUCT_SIZE;
  arguments.error = error;
  api->XLA_FFI_Error_Destroy(&arguments);
  return true;
}

/* Threads of XLA's pool that may help; none without a pool. */
static int count_helpers(XLA_FFI_CallFrame* frame) {
  int64_t threads = 1;
  XLA_FFI_ThreadPool_NumThreads_Args count = {};
  count.struct_size = XLA_FFI_ThreadPool_NumThreads_Args_STRUCT_SIZE;
  count.ctx = frame->ctx;
  count.num_threads = &threads;
  if (refused(frame->api, frame->api->XLA_FFI_ThreadPool_NumThreads(&count))) return 0;
  return (int)threads - 1;
}

/* Tables of every part; the first has the result's own, but for rows of three. Calloc hands out
   pages that cost nothing until a tap touches them. */
static bool make_tables(Job* job) {
  bool enough = true;
  for (int part = 0; part < job->parts && TABLES; ++part) {
    for (int k = 0; k < TABLES; ++k) {
      const int64_t size = ROWS_OF_THREE[k] ? TABLE_SIZES[k] / 3 * 4 : TABLE_SIZES[k];
      const bool own = part || ROWS_OF_THREE[k];
      Element* table = own ? (Element*)calloc(size, sizeof(Element)) : job->tables[k];
      job->tables_of_part[part][k] = table;
      enough = enough && table;
    }
  }
  for (int k = 0; k < TABLES; ++k) memset(job->tables[k], 0, TABLE_SIZES[k] * sizeof(Element));
  return enough;
}

static void join_tables(Job* job, bool enough) {
  for (int part = 0; part < job->parts && TABLES; ++part) {
    for (int k = 0; k < TABLES; ++k) {
      const int64_t size = enough ? TABLE_SIZES[k] : 0;
      Element *table = job->tables[k], *more = job->tables_of_part[part][k];
      if (more == table) continue;
      if (ROWS_OF_THREE[k]) {
        for (int64_t p = 0; p < size / 3; ++p)
          for (int c = 0; c < 3; ++c)
            table[3 * p + c] = joined(table[3 * p + c], more[4 * p + c]);
      } else {
        for (int64_t p = 0; p < size; ++p) table[p] = joined(table[p], more[p]);
      }
      free(more);
    }
  }
}

static bool run(Job* job, XLA_FFI_CallFrame* frame) {
  const int helpers = count_helpers(frame);
  const int most = TABLES ? MOST_PARTS_WITH_TABLES : PIECES;
  job->parts = TABLES && helpers + 1 < most ? helpers + 1 : most;
  const bool enough = make_tables(job);
  if (enough) {
    ++job->users; /* Who waits for it, and who works. */
    for (int t = 0; t < helpers && t + 1 < job->parts; ++t) {
      XLA_FFI_ThreadPool_Schedule_Args task = {};
      task.struct_size = XLA_FFI_ThreadPool_Schedule_Args_STRUCT_SIZE;
      task.ctx = frame->ctx;
      task.task = work;
      task.data = job;
      ++job->users;
      if (refused(frame->api, frame->api->XLA_FFI_ThreadPool_Schedule(&task))) --job->users;
    }
    work(job);
    std::unique_lock<std::mutex> lock(job->mutex);
    job->finished.wait(lock, [job] { return job->parts_done == job->parts; });
  }
  join_tables(job, enough);
  if (--job->users == 0) delete job;
  return enough;
}

static XLA_FFI_Error* out_of_memory(const XLA_FFI_Api* api) {
  XLA_FFI_Error_Create_Args arguments = {};
  arguments.struct_size = XLA_FFI_Error_Create_Args_STRUCT_SIZE;
  arguments.message = "no memory for the derivatives of the sum over samples";
  arguments.errc = XLA_FFI_Error_Code_RESOURCE_EXHAUSTED;
  return api->XLA_FFI_Error_Create(&arguments);
}

extern "C" XLA_FFI_Error* @NAME@(XLA_FFI_CallFrame* frame) {
  auto* extension = frame->extension_start;
  if (extension && extension->type == XLA_FFI_Extension_Metadata) {
    XLA_FFI_Metadata* metadata = ((XLA_FFI_Metadata_Extension*)extension)->metadata;
    metadata->api_version.major_version = XLA_FFI_API_MAJOR;
    metadata->api_version.minor_version = XLA_FFI_API_MINOR;
    return nullptr;
  }
  void* arguments[ARGUMENTS + 1];
  for (int k = 0; k < ARGUMENTS; ++k)
    arguments[k] = ((XLA_FFI_Buffer*)frame->args.args[k])->data;
  Job* job = new Job;
  job->kept = KEPT ? (const float*)arguments[ARGUMENTS - 1] : nullptr;
  job->arguments = arguments;
  const int buffers = KEPT ? 1 : RESULTS;
  for (int k = 0; k < buffers; ++k)
    job->results[k] = (float*)((XLA_FFI_Buffer*)frame->rets.rets[k])->data;
  for (int k = 0; k < TABLES; ++k)
    job->tables[k] = (Element*)((XLA_FFI_Buffer*)frame->rets.rets[buffers + k])->data;
  return run(job, frame) ? nullptr : out_of_memory(frame->api);
}
