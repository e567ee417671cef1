/* Values of several neighboring pixels at once, one a lane: arithmetic, reads and writes. Put into
   kernel.cc by emit.py. */
#include <math.h>
#include <stdint.h>
#include <string.h>
#if defined(__AVX2__) && defined(__GNUC__) && !defined(__clang__) && __GNUC__ < 15
/* The parts of immintrin.h that are used, in its order: all of it takes GCC 0.7 s, these 0.1 s. */
#define _IMMINTRIN_H_INCLUDED
#include <mmintrin.h>
#include <xmmintrin.h>
#include <emmintrin.h>
#include <pmmintrin.h>
#include <tmmintrin.h>
#include <smmintrin.h>
#include <avxintrin.h>
#include <avx2intrin.h>
#ifdef __AVX512F__
#include <avx512fintrin.h>
#endif
#elif defined(__AVX2__)
#include <immintrin.h>
#endif

enum {
#ifdef __AVX512F__
  LANES = 16, /* pixels of a row that go through the samples together */
#else
  LANES = 8,
#endif
};

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

/* The lanes in which a comparison holds, a bit each. Of an integer AVX looks at the sign alone. */
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

/* The number of the lowest bit of each lane, from 0 to 30; 0 where there is none. */
static inline Ints lowest_bit(Ints a) {
  const Ints exponent = ((Ints)to_floats(a & -a) >> 23) - 127;
  return a == 0 ? Ints{} : exponent;
}

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
LANE_BY_LANE(acosf)
LANE_BY_LANE(acoshf)
LANE_BY_LANE(asinf)
LANE_BY_LANE(asinhf)
LANE_BY_LANE(atanhf)
LANE_BY_LANE(cbrtf)
LANE_BY_LANE(ceilf)
LANE_BY_LANE(cosf)
LANE_BY_LANE(coshf)
LANE_BY_LANE(erff)
LANE_BY_LANE(expf)
LANE_BY_LANE(exp2f)
LANE_BY_LANE(expm1f)
LANE_BY_LANE(log1pf)
LANE_BY_LANE(rintf)
LANE_BY_LANE(roundf)
LANE_BY_LANE(sinhf)
LANE_BY_LANE(sqrtf)
LANE_BY_LANE(tanf)
LANE_BY_LANE(tanhf)

/* Arctangent, within two units in the last place [Cephes]: by a polynomial below tan(pi/8), to which
   larger values are brought by atan(x) = pi/4 + atan((x - 1)/(x + 1)) = pi/2 - atan(1/x). */
static inline Floats atanf(Floats a) {
  const Floats x = fabsf(a);
  const Ints large = x > 2.414213562f, medium = x > 0.4142135624f;
  const Floats above = large ? wide(-1.0f) : medium ? x - 1.0f : x;
  const Floats below = large ? x : medium ? x + 1.0f : wide(1.0f);
  const Floats start = large ? wide(1.5707963268f) : medium ? wide(0.7853981634f) : Floats{};
  const Floats z = above / below, s = z * z;
  Floats y = 8.05374449538e-2f * s - 1.38776856032e-1f;
  y = y * s + 1.99777106478e-1f;
  y = y * s - 3.33329491539e-1f;
  y = start + (y * s * z + z);
  return (Floats)((Ints)y | ((Ints)a & INT32_MIN));
}

/* Sine, within 1e-7 up to 1000: of x - n pi, in [-pi/2, pi/2], by a polynomial. */
static inline Floats sinf(Floats a) {
  if (any(~(fabsf(a) <= 1000.0f))) {
    Floats result;
    for (int k = 0; k < LANES; ++k) result[k] = ::sinf(a[k]);
    return result;
  }
  const Ints turns = to_ints(a * 0.318309886f + (a < 0.0f ? wide(-0.5f) : wide(0.5f)));
  const Floats n = to_floats(turns);
  Floats x = a - n * 3.140625f;
  x = x - n * 0.0009670257568359375f;
  x = x - n * 6.2771141529083252e-7f;
  const Floats s = x * x;
  Floats y = 2.6083159809786594e-6f * s - 0.00019810690719168633f;
  y = y * s + 0.00833307858556509f;
  y = y * s - 0.16666659712791443f;
  y = s * (y * x) + x;
  return (turns & 1) != 0 ? -y : y;
}

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
LANE_BY_LANE_OF_TWO(atan2f)
LANE_BY_LANE_OF_TWO(fmodf)
LANE_BY_LANE_OF_TWO(powf)

#if defined(__AVX512F__)
static inline Floats floorf(Floats a) {
  return (Floats)_mm512_roundscale_ps((__m512)a, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
}
static inline Ints floor_to_ints(Floats a) {
  return (Ints)_mm512_cvt_roundps_epi32((__m512)a, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
}
#elif defined(__AVX2__)
static inline Floats floorf(Floats a) { return (Floats)_mm256_floor_ps((__m256)a); }
#else
LANE_BY_LANE(floorf)
#endif

/* Sanitizers do not see what the gather instructions read. */
#if defined(__AVX512F__) && !defined(SANITIZED)
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
#elif defined(__AVX2__) && !defined(SANITIZED)
static inline Floats read(const float* table, Ints index) {
  return (Floats)_mm256_i32gather_ps(table, (__m256i)index, 4);
}
static inline Ints read(const int32_t* table, Ints index) {
  return (Ints)_mm256_i32gather_epi32(table, (__m256i)index, 4);
}
#else
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
#endif
#if (!defined(__AVX512F__) && !defined(__AVX2__)) || defined(SANITIZED)
static inline void read(const float* table, Ints index, Floats& first, Floats& second) {
  first = read(table, index);
  second = read(table, index + 1);
}
#endif

/* Several neighbors in memory: a load of a row for each lane and a transposition take half of the
   time of gather instructions. */
#if (defined(__AVX512F__) || defined(__AVX2__)) && !defined(SANITIZED)
/* The places of all lanes, none of which is negative. With 8 lanes two at a time out of the vector,
   which takes less time than one by one, or through memory. */
#if defined(__AVX512F__)
typedef int32_t Place;
#else
typedef uint64_t Place;
#endif
struct Places {
  Place of[LANES];
  explicit Places(Ints index) {
#if defined(__AVX512F__)
    memcpy(of, &index, sizeof of);
#else
    for (int half = 0; half < 2; ++half) {
      const __m128i four = half ? _mm256_extracti128_si256((__m256i)index, 1)
                                : _mm256_castsi256_si128((__m256i)index);
      const uint64_t low = _mm_cvtsi128_si64(four), high = _mm_extract_epi64(four, 1);
      Place* place = of + 4 * half;
      place[0] = (uint32_t)low, place[1] = low >> 32;
      place[2] = (uint32_t)high, place[3] = high >> 32;
    }
#endif
  }
};
static inline __m128 row_of_three(const float* row) {
  return _mm_maskload_ps(row, _mm_setr_epi32(-1, -1, -1, 0));
}
static inline __m128 row_of_four(const float* row) { return _mm_loadu_ps(row); }
#if defined(__AVX512F__)
typedef __m512 Wide;
template <__m128 (*ROW)(const float*)>
static inline Wide rows_of(const float* table, const Place* place) {
  Wide rows = _mm512_castps128_ps512(ROW(table + place[0]));
  rows = _mm512_insertf32x4(rows, ROW(table + place[4]), 1);
  rows = _mm512_insertf32x4(rows, ROW(table + place[8]), 2);
  return _mm512_insertf32x4(rows, ROW(table + place[12]), 3);
}
static inline Wide low_singles(Wide a, Wide b) { return _mm512_unpacklo_ps(a, b); }
static inline Wide high_singles(Wide a, Wide b) { return _mm512_unpackhi_ps(a, b); }
static inline Floats low_pairs(Wide a, Wide b) {
  return (Floats)_mm512_unpacklo_pd((__m512d)a, (__m512d)b);
}
static inline Floats high_pairs(Wide a, Wide b) {
  return (Floats)_mm512_unpackhi_pd((__m512d)a, (__m512d)b);
}
#else
typedef __m256 Wide;
template <__m128 (*ROW)(const float*)>
static inline Wide rows_of(const float* table, const Place* place) {
  const Wide rows = _mm256_castps128_ps256(ROW(table + place[0]));
  return _mm256_insertf128_ps(rows, ROW(table + place[4]), 1);
}
static inline Wide low_singles(Wide a, Wide b) { return _mm256_unpacklo_ps(a, b); }
static inline Wide high_singles(Wide a, Wide b) { return _mm256_unpackhi_ps(a, b); }
static inline Floats low_pairs(Wide a, Wide b) {
  return (Floats)_mm256_unpacklo_pd((__m256d)a, (__m256d)b);
}
static inline Floats high_pairs(Wide a, Wide b) {
  return (Floats)_mm256_unpackhi_pd((__m256d)a, (__m256d)b);
}
#endif
#if !defined(__AVX512F__)
static inline __m128 two_pairs(const float* table, const Place* place) {
  const __m128 low = _mm_castpd_ps(_mm_load_sd((const double*)(table + place[0])));
  return _mm_loadh_pi(low, (const __m64*)(table + place[1]));
}
static inline void read(const float* table, Ints index, Floats& first, Floats& second) {
  const Places places(index);
  const Place* of = places.of;
  const __m256 low = _mm256_setr_m128(two_pairs(table, of), two_pairs(table, of + 4));
  const __m256 high = _mm256_setr_m128(two_pairs(table, of + 2), two_pairs(table, of + 6));
  first = (Floats)_mm256_shuffle_ps(low, high, 0x88);
  second = (Floats)_mm256_shuffle_ps(low, high, 0xdd);
}
#endif
template <__m128 (*ROW)(const float*)>
static inline void read_rows(const float* table, const Places& places, Floats* columns) {
  const Wide row[4] = {rows_of<ROW>(table, places.of), rows_of<ROW>(table, places.of + 1),
                       rows_of<ROW>(table, places.of + 2), rows_of<ROW>(table, places.of + 3)};
  const Wide low = low_singles(row[0], row[1]), high = high_singles(row[0], row[1]);
  const Wide more_low = low_singles(row[2], row[3]), more_high = high_singles(row[2], row[3]);
  columns[0] = low_pairs(low, more_low);
  columns[1] = high_pairs(low, more_low);
  columns[2] = low_pairs(high, more_high);
  columns[3] = high_pairs(high, more_high);
}
static inline void read(const float* table, Ints index, Floats& a, Floats& b, Floats& c) {
  Floats columns[4];
  read_rows<row_of_three>(table, Places(index), columns);
  a = columns[0], b = columns[1], c = columns[2];
}
static inline void read(const float* table, Ints index, Floats& a, Floats& b, Floats& c,
                        Floats& d) {
  Floats columns[4];
  read_rows<row_of_four>(table, Places(index), columns);
  a = columns[0], b = columns[1], c = columns[2], d = columns[3];
}
/* The fifth is the last of the row of four that begins at the second. */
static inline void read(const float* table, Ints index, Floats& a, Floats& b, Floats& c, Floats& d,
                        Floats& e) {
  const Places places(index);
  Floats columns[4], next[4];
  read_rows<row_of_four>(table, places, columns);
  read_rows<row_of_four>(table + 1, places, next);
  a = columns[0], b = columns[1], c = columns[2], d = columns[3], e = next[3];
}
#else
static inline void read(const float* table, Ints index, Floats& a, Floats& b, Floats& c) {
  read(table, index, a, b);
  c = read(table, index + 2);
}
static inline void read(const float* table, Ints index, Floats& a, Floats& b, Floats& c,
                        Floats& d) {
  read(table, index, a, b);
  read(table, index + 2, c, d);
}
static inline void read(const float* table, Ints index, Floats& a, Floats& b, Floats& c, Floats& d,
                        Floats& e) {
  read(table, index, a, b, c, d);
  e = read(table, index + 4);
}
#endif

/* Lanes often read neighbors in memory, those of a plane at the same offset: one load then. */
template <typename Element>
static inline auto read_plane(const Element* table, Ints index) {
  const int32_t first = index[0];
  if (any(index != first + lane_numbers())) return read(table, index);
  decltype(read(table, index)) result;
  memcpy(&result, table + first, sizeof result);
  return result;
}

static inline Ints read_bytes(const uint8_t* table, Ints index) {
  Ints result;
  for (int k = 0; k < LANES; ++k) result[k] = table[index[k]];
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
#if (defined(__AVX512F__) || defined(__AVX2__)) && !defined(SANITIZED)
static inline void make_rows(const Floats* a, Floats* rows) {
  const Wide low = low_singles((Wide)a[0], (Wide)a[1]), high = high_singles((Wide)a[0], (Wide)a[1]);
  const Wide more_low = low_singles((Wide)a[2], (Wide)a[3]);
  const Wide more_high = high_singles((Wide)a[2], (Wide)a[3]);
  rows[0] = low_pairs(low, more_low);
  rows[1] = high_pairs(low, more_low);
  rows[2] = low_pairs(high, more_high);
  rows[3] = high_pairs(high, more_high);
}
#else
static inline void make_rows(const Floats* a, Floats* rows) {
  for (int lane = 0; lane < LANES; ++lane)
    for (int c = 0; c < 4; ++c) rows[lane % 4][lane / 4 * 4 + c] = a[c][lane];
}
#endif

/* Adds a row of neighbors. Only rows of four are added whole: others would overlap, and what was
   just stored in part is slow to load. */
template <int COLUMNS>
static inline void add_one(float* place, const float* row) {
  if (COLUMNS == 4) {
    typedef float Four __attribute__((vector_size(16)));
    Four sum, more;
    memcpy(&sum, place, sizeof sum);
    memcpy(&more, row, sizeof more);
    sum += more;
    memcpy(place, &sum, sizeof sum);
  } else {
    for (int c = 0; c < COLUMNS; ++c) place[c] += row[c];
  }
}
/* Adds a row of neighbors a lane. Lanes may meet at one place, so they add in turn. */
template <int COLUMNS>
static inline void add(float* table, Ints index, const Floats (&values)[COLUMNS], int lanes) {
  Ints some = {};
  for (int c = 0; c < COLUMNS; ++c) some |= values[c] != 0;
  uint32_t adding = lanes_of(some) & (0xffffffffu >> (32 - lanes));
  if (adding == 0) return;
  Floats padded[4] = {}, rows[4];
  for (int c = 0; c < COLUMNS; ++c) padded[c] = values[c];
  make_rows(padded, rows);
  float memory[4][LANES];
  int32_t places[LANES];
  memcpy(memory, rows, sizeof memory);
  memcpy(places, &index, sizeof places);
  if (adding == (1u << LANES) - 1) {
    for (int k = 0; k < LANES; ++k)
      add_one<COLUMNS>(table + places[k], memory[k % 4] + k / 4 * 4);
    return;
  }
  for (; adding != 0; adding &= adding - 1) {
    const int k = __builtin_ctz(adding);
    add_one<COLUMNS>(table + places[k], memory[k % 4] + k / 4 * 4);
  }
}

/* Adds a row of three a lane, to a table in which it has the room of four. The index, that of the
   row without that room, is a multiple of 3, which the inverse of 3 modulo 2^32 divides exactly. */
static inline void add_three(float* table, Ints index, const Floats (&values)[3], int lanes) {
  const Floats row[4] = {values[0], values[1], values[2], Floats{}};
  typedef uint32_t Modular __attribute__((vector_size(4 * LANES)));
  add(table, (Ints)((Modular)index * 0xAAAAAAABu * 4), row, lanes);
}

/* Keeps the larger of what is there and the lane's own. Lanes may meet at one place, so they come
   in turn; those beyond the end of a row are the row's last pixel again, which changes nothing. */
static inline void keep_larger(int32_t* table, Ints places, Ints marks) {
  int32_t place[LANES], mark[LANES];
  memcpy(place, &places, sizeof place);
  memcpy(mark, &marks, sizeof mark);
  for (int k = 0; k < LANES; ++k) {
    const int32_t there = table[place[k]];
    table[place[k]] = mark[k] > there ? mark[k] : there;
  }
}

static inline float joined(float a, float b) { return a + b; }
static inline int32_t joined(int32_t a, int32_t b) { return max_int(a, b); }
