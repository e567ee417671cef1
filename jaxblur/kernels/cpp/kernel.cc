/* A program for every pixel of a grid: sums over samples, additions to tables, or the largest marks
   at places of a table. emit.py fills in the text between two @. Sizes are known when it runs. */
/* C headers: those of C++ take the compiler longer than the program does. */
#define _GLIBCXX_INCLUDE_NEXT_C_HEADERS
#include <pthread.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#ifdef __linux__
#include <sys/mman.h>
#endif

#include "xla/ffi/api/c_api.h"

enum {
  COUNT = @COUNT@,
  SUMS = @SUMS@,
  RESULTS = @RESULTS@, /* of a pixel */
  IMAGE = @IMAGE@, /* whether they are the channels of one image, or a plane each */
  KEPT = @KEPT@, /* of them that pixels which do not move take from the last argument */
  REST = @REST@, /* 0, or all of them if such pixels have results of their own */
  ARGUMENTS = @ARGUMENTS_READ@ + (KEPT > 0),
  TABLES = @TABLES@, /* results that taps add to anywhere, or leave their marks in */
  APART = @APART@, /* number of samples if each writes to a share of the tables of its own, or 0 */
  PACKED = @PACKED@, /* whether pixels that move among many that do not wait for others */
  SAMPLES_AT_ONCE = 31, /* that are chosen from */
  ROWS_AT_ONCE = 4, /* rows of a strip that a thread takes at a time: a piece */
  MOST_PARTS_WITH_TABLES = 8 /* each has tables of its own */
};

typedef @ELEMENT@ Element; /* of such a table */

@LANES@

static const bool ROWS_OF_THREE[] = {@ROWS_OF_THREE@}; /* with the room of four while added to */

/* A call. Threads take its parts in turn, so that it waits for none that has not begun. */
struct Job {
  int height, width; /* of the grid */
  const int32_t* sizes; /* rows, columns, rows, columns, ... of the images */
  int strip; /* pixels of a row at a time: of tables that samples add to, the part that they reach
                stays in the cache */
  int pieces_of_strip, pieces;
  const float* kept;
  void* const* arguments;
  float* results[RESULTS + 1];
  Element* tables[TABLES + 1];
  int64_t table_sizes[TABLES + 1];
  Element* tables_of_part[MOST_PARTS_WITH_TABLES][TABLES + 1];
  int parts;
  int next_part, users; /* changed by `count` alone */
  pthread_mutex_t mutex;
  pthread_cond_t finished;
  int parts_done;
};

/* Four channels of each lane. */
static inline void store_rows(float* result, const Floats* columns) {
  Floats rows[4];
  make_rows(columns, rows);
  float memory[4][LANES];
  memcpy(memory, rows, sizeof memory);
  for (int lane = 0; lane < LANES; ++lane)
    memcpy(result + lane * RESULTS, memory[lane % 4] + lane / 4 * 4, 16);
}

/* Results of the lanes that move; what is kept by the others. */
static inline void store_results(const Job* job, int64_t pixel, Ints moving,
                                 const Floats* results, int lanes, bool more) {
  if (!IMAGE) {
    for (int k = 0; k < RESULTS; ++k) store(job->results[k] + pixel, results[k], lanes);
    return;
  }
  if (KEPT && KEPT == RESULTS && !any(moving)) {
    memcpy(job->results[0] + pixel * KEPT, job->kept + pixel * KEPT, sizeof(float) * KEPT * lanes);
    return;
  }
  float* result = job->results[0] + pixel * RESULTS;
  if (RESULTS > 4 ? lanes == LANES : more) {
    Floats columns[RESULTS + 4] = {};
    for (int k = 0; k < RESULTS; ++k) columns[k] = results[k];
    if (KEPT && any(~moving)) {
      const Ints own = ((int32_t)pixel + lane_numbers()) * (int32_t)KEPT;
      for (int k = 0; k < RESULTS; ++k)
        columns[k] = moving ? columns[k] : k < KEPT ? read(job->kept, own + k) : Floats{};
    }
    /* Fewer than four channels: the end of a row is overwritten by the next one, at last by those
       of the pixels which this thread computes next. More: the last four may be written twice. */
    if (RESULTS <= 4) return store_rows(result, columns);
    for (int start = 0; start < RESULTS - 4; start += 4) store_rows(result + start, columns + start);
    return store_rows(result + RESULTS - 4, columns + RESULTS - 4);
  }
  float values[RESULTS + 1][LANES];
  memcpy(values, results, sizeof values);
  for (int lane = 0; lane < lanes; ++lane, result += RESULTS) {
    const float* kept = job->kept + (pixel + lane) * KEPT;
    for (int k = 0; k < RESULTS; ++k)
      result[k] = !KEPT || moving[lane] ? values[k][lane] : k < KEPT ? kept[k] : 0.0f;
  }
}

/* Results of pixels anywhere. */
static inline void store_apart(const Job* job, Ints own, const Floats* results, int lanes) {
  for (int lane = 0; lane < lanes; ++lane)
    for (int k = 0; k < RESULTS; ++k) {
      if (IMAGE) job->results[0][(int64_t)own[lane] * RESULTS + k] = results[k][lane];
      else job->results[k][own[lane]] = results[k][lane];
    }
}

/* Some pixels of neighboring rows, a vector at a time. Where few of a vector move, they wait until
   there are enough of them for a vector of their own, so that its lanes are not idle. */
static void sum_rows(const Job* job, Element* const* tables, int row, const int below,
                     const int from, const int until, const int32_t begin, const int32_t end) {
  (void)tables;
@ARGUMENTS@
  int32_t rows[2 * LANES], columns[2 * LANES];
  int waiting = 0;
  int first = from;
  while (row < below || waiting) {
    const bool apart = PACKED && (waiting >= LANES || row == below);
    const int next = until - first;
    const int lanes = apart ? min_int(waiting, LANES) : next < LANES ? next : LANES;
    const int64_t start = (int64_t)row * job->width;
    const int64_t pixel = start + first;
    const bool more = first + LANES + 4 <= until;
    /* Lanes beyond the last compute that one again, so that they read inside. */
    const Ints inside = min_int(lane_numbers(), wide(lanes - 1));
    Ints x = first + inside, y = wide((int32_t)row);
    if (apart) {
      waiting -= lanes;
      x = read(columns + waiting, inside), y = read(rows + waiting, inside);
    } else if ((first += LANES) >= until) {
      first = from, ++row;
    }
    const Ints own = y * (int32_t)job->width + x;
    (void)x, (void)y, (void)own, (void)pixel;
    Floats results[RESULTS + 1] = {};
@MOVING@
    if (PACKED && !apart) {
      const uint32_t these = lanes_of(moving) & ((1u << lanes) - 1);
      const int count = __builtin_popcount(these);
      if (4 * count < 3 * LANES) {
        store_results(job, pixel, wide(REST > 0), results, lanes, more);
        for (uint32_t left = these; left; left &= left - 1, ++waiting) {
          const int lane = __builtin_ctz(left);
          rows[waiting] = y[lane], columns[waiting] = x[lane];
        }
        continue;
      }
    }
    if (any(moving)) {
      Floats sums[SUMS + 1] = {};
      int32_t last = COUNT;
@PIXEL@
#if @CHOOSES@
      /* Lanes take the samples that count for them, whatever the others take. */
      for (int32_t some = 0; some < last; some += SAMPLES_AT_ONCE) {
        Ints left = {}; /* a bit each */
        for (int32_t i = some; i < min_int(last, some + SAMPLES_AT_ONCE); ++i) {
@CHOICE@
        }
        for (Ints counts = left != 0; any(counts); counts = left != 0) {
          const Ints i = some + lowest_bit(left);
          left &= left - 1;
@SAMPLE@
@TAP@
        }
      }
#else
      for (int32_t i = begin; i < min_int(last, end); ++i) {
@SAMPLE@
@TAP@
      }
#endif
@FINISH@
    }
    if (apart) store_apart(job, own, results, lanes);
    else store_results(job, pixel, REST ? wide(true) : moving, results, lanes, more);
  }
}

/* Some rows of one strip. */
static void sum_piece(const Job* job, Element* const* tables, int piece, int32_t begin = 0,
                      int32_t end = INT32_MAX) {
  const int from = piece / job->pieces_of_strip * job->strip;
  const int row = piece % job->pieces_of_strip * ROWS_AT_ONCE;
  const int until = from + job->strip < job->width ? from + job->strip : job->width;
  const int below = row + ROWS_AT_ONCE < job->height ? row + ROWS_AT_ONCE : job->height;
  sum_rows(job, tables, row, below, from, until, begin, end);
}

/* A part is one piece. Where taps add to tables it has tables of its own and every so many pieces,
   the same in every run, so that the same input gives the same bits. Where samples write apart, a
   part is some samples of all pixels, and the tables are shared. */
static void sum_part(const Job* job, int part) {
  if (APART) {
    const int32_t begin = part * APART / job->parts, end = (part + 1) * APART / job->parts;
    for (int k = 0; k < TABLES; ++k) {
      const int64_t share = job->table_sizes[k] / APART;
      memset(job->tables[k] + begin * share, 0, (end - begin) * share * sizeof(Element));
    }
    for (int piece = 0; piece < job->pieces; ++piece)
      sum_piece(job, job->tables, piece, begin, end);
    return;
  }
  if (TABLES == 0) return sum_piece(job, job->tables, part);
  for (int piece = part; piece < job->pieces; piece += job->parts)
    sum_piece(job, job->tables_of_part[part], piece);
}

/* Adds to a number that threads share; returns what it was. */
static inline int count(int* number, int more) {
  return __atomic_fetch_add(number, more, __ATOMIC_SEQ_CST);
}

/* The last one that knows the job removes it. */
static void leave(Job* job) {
  if (count(&job->users, -1) > 1) return;
  pthread_cond_destroy(&job->finished);
  pthread_mutex_destroy(&job->mutex);
  free(job);
}

/* What a thread does. */
static void work(void* argument) {
  Job* job = static_cast<Job*>(argument);
  int done = 0;
  for (int part = count(&job->next_part, 1); part < job->parts; part = count(&job->next_part, 1)) {
    sum_part(job, part);
    ++done;
  }
  if (done) {
    pthread_mutex_lock(&job->mutex);
    job->parts_done += done;
    if (job->parts_done == job->parts) pthread_cond_signal(&job->finished);
    pthread_mutex_unlock(&job->mutex);
  }
  leave(job);
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
  return threads > 1 ? (int)threads - 1 : 0;
}

/* Tables of every part; the first has the result's own, but for rows of three. Calloc hands out
   pages that cost nothing until a tap touches them. */
static bool make_tables(Job* job) {
  bool enough = true;
  for (int part = 0; part < job->parts && TABLES && !APART; ++part) {
    for (int k = 0; k < TABLES; ++k) {
      const int64_t size = ROWS_OF_THREE[k] ? job->table_sizes[k] / 3 * 4 : job->table_sizes[k];
      const bool own = part || ROWS_OF_THREE[k];
      Element* table = own ? (Element*)calloc(size, sizeof(Element)) : job->tables[k];
      job->tables_of_part[part][k] = table;
      enough = enough && table;
    }
  }
  for (int k = 0; k < TABLES && !APART; ++k)
    memset(job->tables[k], 0, job->table_sizes[k] * sizeof(Element));
  return enough;
}

static void join_tables(Job* job, bool enough) {
  for (int part = 0; part < job->parts && TABLES && !APART; ++part) {
    for (int k = 0; k < TABLES; ++k) {
      const int64_t size = enough ? job->table_sizes[k] : 0;
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
  const int most = APART ? APART : TABLES ? MOST_PARTS_WITH_TABLES : job->pieces;
  job->parts = TABLES && helpers + 1 < most ? helpers + 1 : most;
  const bool enough = make_tables(job);
  if (enough) {
    count(&job->users, 1); /* Who waits for it, and who works. */
    for (int t = 0; t < helpers && t + 1 < job->parts; ++t) {
      XLA_FFI_ThreadPool_Schedule_Args task = {};
      task.struct_size = XLA_FFI_ThreadPool_Schedule_Args_STRUCT_SIZE;
      task.ctx = frame->ctx;
      task.task = work;
      task.data = job;
      count(&job->users, 1);
      if (refused(frame->api, frame->api->XLA_FFI_ThreadPool_Schedule(&task)))
        count(&job->users, -1);
    }
    work(job);
    pthread_mutex_lock(&job->mutex);
    while (job->parts_done < job->parts) pthread_cond_wait(&job->finished, &job->mutex);
    pthread_mutex_unlock(&job->mutex);
  }
  join_tables(job, enough);
  leave(job);
  return enough;
}

/* Rows and columns of the grid, then of every image: the only attribute of a call. */
static const int32_t* sizes_of(const XLA_FFI_CallFrame* frame) {
  return (const int32_t*)((const XLA_FFI_Array*)frame->attrs.attrs[0])->data;
}

static int64_t elements_of(const XLA_FFI_Buffer* buffer) {
  int64_t count = 1;
  for (int64_t axis = 0; axis < buffer->rank; ++axis) count *= buffer->dims[axis];
  return count;
}

#ifdef SANITIZED
/* XLA keeps many arrays in one block of memory, and sanitizers know only where blocks end. So every
   array has a block of its own while the kernel runs. */
static size_t bytes_of(const XLA_FFI_Buffer* buffer) {
  return elements_of(buffer) * (buffer->dtype == XLA_FFI_DataType_PRED ? 1 : 4);
}
static void* data_of(const XLA_FFI_Buffer* buffer) {
  return memcpy(malloc(bytes_of(buffer)), buffer->data, bytes_of(buffer));
}
static void put_back(const XLA_FFI_Buffer* buffer, void* data, bool is_result) {
  if (is_result) memcpy(buffer->data, data, bytes_of(buffer));
  free(data);
}
#else
static void* data_of(const XLA_FFI_Buffer* buffer) { return buffer->data; }
static void put_back(const XLA_FFI_Buffer*, void*, bool) {}
#endif

/* Asks for pages of 2 MiB under a result that fills one: its memory is often new, and to get a page
   takes long, however small it is. */
static void ask_for_large_pages(void* data, const XLA_FFI_Buffer* buffer) {
#if defined(__linux__) && defined(MADV_HUGEPAGE)
  const uintptr_t page = 1 << 21, bytes = elements_of(buffer) * sizeof(float);
  if (bytes < page) return;
  const uintptr_t start = (uintptr_t)data & -page;
  const uintptr_t end = ((uintptr_t)data + bytes + page - 1) & -page;
  madvise((void*)start, end - start, MADV_HUGEPAGE);
#else
  (void)data, (void)buffer;
#endif
}

static XLA_FFI_Error* out_of_memory(const XLA_FFI_Api* api) {
  XLA_FFI_Error_Create_Args arguments = {};
  arguments.struct_size = XLA_FFI_Error_Create_Args_STRUCT_SIZE;
  arguments.message = "no memory for the tables of a native kernel";
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
  /* No `new`: a kernel needs no C++ library. */
  Job* job = (Job*)calloc(1, sizeof(Job));
  if (!job) return out_of_memory(frame->api);
  job->users = 1;
  pthread_mutex_init(&job->mutex, nullptr);
  pthread_cond_init(&job->finished, nullptr);
  void* arguments[ARGUMENTS + 1];
  for (int k = 0; k < ARGUMENTS; ++k)
    arguments[k] = data_of((XLA_FFI_Buffer*)frame->args.args[k]);
  const int32_t* sizes = sizes_of(frame);
  job->height = sizes[0], job->width = sizes[1], job->sizes = sizes + 2;
  job->strip = TABLES ? 256 : job->width;
  job->pieces_of_strip = (job->height + ROWS_AT_ONCE - 1) / ROWS_AT_ONCE;
  job->pieces = (job->width + job->strip - 1) / job->strip * job->pieces_of_strip;
  job->kept = KEPT ? (const float*)arguments[ARGUMENTS - 1] : nullptr;
  job->arguments = arguments;
  const int buffers = IMAGE ? 1 : RESULTS;
  void* results[RESULTS + TABLES + 1];
  for (int k = 0; k < buffers + TABLES; ++k) {
    const XLA_FFI_Buffer* buffer = (XLA_FFI_Buffer*)frame->rets.rets[k];
    results[k] = data_of(buffer);
    ask_for_large_pages(results[k], buffer);
  }
  for (int k = 0; k < buffers; ++k) job->results[k] = (float*)results[k];
  for (int k = 0; k < TABLES; ++k) {
    job->tables[k] = (Element*)results[buffers + k];
    job->table_sizes[k] = elements_of((XLA_FFI_Buffer*)frame->rets.rets[buffers + k]);
  }
  const bool enough = run(job, frame);
  for (int k = 0; k < ARGUMENTS; ++k)
    put_back((XLA_FFI_Buffer*)frame->args.args[k], arguments[k], false);
  for (int k = 0; k < buffers + TABLES; ++k)
    put_back((XLA_FFI_Buffer*)frame->rets.rets[k], results[k], true);
  return enough ? nullptr : out_of_memory(frame->api);
}
