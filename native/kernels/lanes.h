// Sixteen float or int lanes on any instruction set, as native-width vectors of the compiler.
// Everything is always inlined: passing these structs through the stack costs more than most functions do.
#pragma once
#include "kernels/isa.h"
#include "kernels/kernels.h"

namespace drsplat::DRSPLAT_ISA {

#if defined(__AVX512F__) && defined(__AVX512DQ__)
#define DRSPLAT_AVX512 1
constexpr int kVectorBytes = 64;
#elif defined(__AVX__)
constexpr int kVectorBytes = 32;
#else
constexpr int kVectorBytes = 16;
#endif
constexpr int kParts = 64 / kVectorBytes;  // GCC 12 scalarises ?: on vectors wider than the machine's

typedef float FloatPart __attribute__((vector_size(kVectorBytes)));
typedef int32_t IntPart __attribute__((vector_size(kVectorBytes)));
typedef uint32_t UintPart __attribute__((vector_size(kVectorBytes)));

struct Floats { FloatPart part[kParts]; };
struct Ints { IntPart part[kParts]; };
#if DRSPLAT_AVX512
struct Mask { __mmask16 lanes; };
#else
struct Mask { IntPart part[kParts]; };  // all bits set = true
#endif

#define EACH_PART(statement) \
  for (int i = 0; i < kParts; i++) statement
#define LANES(Type, value)      \
  Type r;                       \
  EACH_PART(r.part[i] = value); \
  return r

// x - 0 is x for every float, x + 0 is not for -0: only the former compiles to a plain broadcast.
INLINE Floats splat(float x) { LANES(Floats, x - FloatPart{}); }
INLINE Ints splat_int(int32_t x) { LANES(Ints, IntPart{} + x); }

// Loads and stores through unaligned vector types: GCC 12 splits a memcpy of 64 bytes into small moves.
typedef float LooseFloats __attribute__((vector_size(kVectorBytes), aligned(4), may_alias));
typedef int32_t LooseInts __attribute__((vector_size(kVectorBytes), aligned(4), may_alias));
INLINE Floats load(const float *p) { LANES(Floats, ((const LooseFloats *)p)[i]); }
INLINE Ints load_int(const int32_t *p) { LANES(Ints, ((const LooseInts *)p)[i]); }
INLINE void store(float *p, Floats a) { EACH_PART(((LooseFloats *)p)[i] = a.part[i]); }
INLINE void store_int(int32_t *p, Ints a) { EACH_PART(((LooseInts *)p)[i] = a.part[i]); }

// Of up to sixteen numbers; lanes beyond them are 0, and stay out of memory.
INLINE Floats load_some(const float *p, uint32_t n) {
  if (n >= 16) return load(p);
#if DRSPLAT_AVX512
  return {{(FloatPart)_mm512_maskz_loadu_ps((__mmask16)((1u << n) - 1), p)}};
#else
  float padded[16] = {};
  memcpy(padded, p, n * sizeof(float));
  return load(padded);
#endif
}
INLINE void store_some(float *p, Floats a, uint32_t n) {
  if (n >= 16) return store(p, a);
#if DRSPLAT_AVX512
  _mm512_mask_storeu_ps(p, (__mmask16)((1u << n) - 1), (__m512)a.part[0]);
#else
  memcpy(p, &a, n * sizeof(float));
#endif
}

#define LANE_OPERATOR(Type, op) \
  INLINE Type operator op(Type a, Type b) { LANES(Type, a.part[i] op b.part[i]); }
LANE_OPERATOR(Floats, +)
LANE_OPERATOR(Floats, -)
LANE_OPERATOR(Floats, *)
LANE_OPERATOR(Floats, /)
LANE_OPERATOR(Ints, &)
LANE_OPERATOR(Ints, |)
#undef LANE_OPERATOR
// Bits of floats beyond any range may be added up: they wrap.
INLINE Ints operator+(Ints a, Ints b) { LANES(Ints, (IntPart)((UintPart)a.part[i] + (UintPart)b.part[i])); }
INLINE Ints operator-(Ints a, Ints b) { LANES(Ints, (IntPart)((UintPart)a.part[i] - (UintPart)b.part[i])); }

// For sums in memory: GCC 12 copies a whole struct in pieces of 16 bytes, and a wider load of what was just
// stored in pieces waits for the store buffer to drain.
INLINE void add_to(Floats &total, Floats a) { EACH_PART(total.part[i] += a.part[i]); }

template <class F> F constant(float x);
template <> inline __attribute__((always_inline)) float constant<float>(float x) { return x; }
template <> inline __attribute__((always_inline)) Floats constant<Floats>(float x) { return splat(x); }

INLINE Floats operator*(float a, Floats b) { return splat(a) * b; }
INLINE Floats operator-(Floats a) { return splat(0.f) - a; }

INLINE Ints shift_left(Ints a, int s) { LANES(Ints, a.part[i] << s); }
INLINE Ints shift_right(Ints a, int s) { LANES(Ints, a.part[i] >> s); }
INLINE Ints bits_of(Floats a) { LANES(Ints, (IntPart)a.part[i]); }
INLINE Floats float_of_bits(Ints a) { LANES(Floats, (FloatPart)a.part[i]); }
INLINE Floats to_float(Ints a) { LANES(Floats, __builtin_convertvector(a.part[i], FloatPart)); }
INLINE Ints truncate(Floats a) { LANES(Ints, __builtin_convertvector(a.part[i], IntPart)); }

#if DRSPLAT_AVX512
INLINE Mask operator<(Floats a, Floats b) {
  return {_mm512_cmp_ps_mask((__m512)a.part[0], (__m512)b.part[0], _CMP_LT_OQ)};
}
INLINE Mask operator>=(Floats a, Floats b) {
  return {_mm512_cmp_ps_mask((__m512)a.part[0], (__m512)b.part[0], _CMP_GE_OQ)};
}
INLINE Mask operator<(Ints a, Ints b) { return {_mm512_cmplt_epi32_mask((__m512i)a.part[0], (__m512i)b.part[0])}; }
INLINE Mask operator==(Ints a, Ints b) { return {_mm512_cmpeq_epi32_mask((__m512i)a.part[0], (__m512i)b.part[0])}; }
INLINE Mask operator&(Mask a, Mask b) { return {(__mmask16)(a.lanes & b.lanes)}; }
INLINE Mask operator|(Mask a, Mask b) { return {(__mmask16)(a.lanes | b.lanes)}; }
INLINE Mask operator!(Mask a) { return {(__mmask16)~a.lanes}; }
INLINE uint32_t lanes_of(Mask m) { return m.lanes; }
INLINE Floats select(Mask m, Floats a, Floats b) {
  return {{(FloatPart)_mm512_mask_blend_ps(m.lanes, (__m512)b.part[0], (__m512)a.part[0])}};
}
INLINE Ints select(Mask m, Ints a, Ints b) {
  return {{(IntPart)_mm512_mask_blend_epi32(m.lanes, (__m512i)b.part[0], (__m512i)a.part[0])}};
}
INLINE Floats keep(Mask m, Floats a) { return {{(FloatPart)_mm512_maskz_mov_ps(m.lanes, (__m512)a.part[0])}}; }
INLINE Ints increment(Ints a, Mask m) {
  return {{(IntPart)_mm512_mask_sub_epi32((__m512i)a.part[0], m.lanes, (__m512i)a.part[0], _mm512_set1_epi32(-1))}};
}
INLINE Floats minimum(Floats a, Floats b) { return {{(FloatPart)_mm512_min_ps((__m512)a.part[0], (__m512)b.part[0])}}; }
INLINE Floats maximum(Floats a, Floats b) { return {{(FloatPart)_mm512_max_ps((__m512)a.part[0], (__m512)b.part[0])}}; }
INLINE Ints minimum_unsigned(Ints a, Ints b) {
  return {{(IntPart)_mm512_min_epu32((__m512i)a.part[0], (__m512i)b.part[0])}};
}
INLINE Ints maximum_unsigned(Ints a, Ints b) {
  return {{(IntPart)_mm512_max_epu32((__m512i)a.part[0], (__m512i)b.part[0])}};
}
INLINE Floats square_root(Floats a) { return {{(FloatPart)_mm512_sqrt_ps((__m512)a.part[0])}}; }
// 1 / a to 1e-7 for normal a: the processor's estimate and one step of Newton's, in a third of a division's time.
INLINE Floats reciprocal(Floats a) {
  const Floats guess = {{(FloatPart)_mm512_rcp14_ps((__m512)a.part[0])}};
  return guess * (splat(2.f) - a * guess);
}
#else
INLINE Floats reciprocal(Floats a) { return splat(1.f) / a; }
#define LANE_COMPARISON(Type, op) \
  INLINE Mask operator op(Type a, Type b) { LANES(Mask, a.part[i] op b.part[i]); }
LANE_COMPARISON(Floats, <)
LANE_COMPARISON(Floats, >=)
LANE_COMPARISON(Ints, <)
LANE_COMPARISON(Ints, ==)
#undef LANE_COMPARISON
INLINE Mask operator&(Mask a, Mask b) { LANES(Mask, a.part[i] & b.part[i]); }
INLINE Mask operator|(Mask a, Mask b) { LANES(Mask, a.part[i] | b.part[i]); }
INLINE Mask operator!(Mask a) { LANES(Mask, ~a.part[i]); }
INLINE Floats select(Mask m, Floats a, Floats b) { LANES(Floats, m.part[i] ? a.part[i] : b.part[i]); }
INLINE Ints select(Mask m, Ints a, Ints b) { LANES(Ints, m.part[i] ? a.part[i] : b.part[i]); }
INLINE Floats keep(Mask m, Floats a) { LANES(Floats, (FloatPart)((IntPart)a.part[i] & m.part[i])); }
INLINE Ints increment(Ints a, Mask m) { LANES(Ints, a.part[i] - m.part[i]); }
INLINE Floats minimum(Floats a, Floats b) { return select(a < b, a, b); }
INLINE Floats maximum(Floats a, Floats b) { return select(b < a, a, b); }
INLINE Ints minimum_unsigned(Ints a, Ints b) {
  LANES(Ints, (UintPart)a.part[i] < (UintPart)b.part[i] ? a.part[i] : b.part[i]);
}
INLINE Ints maximum_unsigned(Ints a, Ints b) {
  LANES(Ints, (UintPart)b.part[i] < (UintPart)a.part[i] ? a.part[i] : b.part[i]);
}
#if defined(__AVX__)
INLINE uint32_t lanes_of(Mask m) {
  return (uint32_t)_mm256_movemask_ps((__m256)m.part[0]) | (uint32_t)_mm256_movemask_ps((__m256)m.part[1]) << 8;
}
INLINE Floats square_root(Floats a) { LANES(Floats, (FloatPart)_mm256_sqrt_ps((__m256)a.part[i])); }
#elif defined(__SSE2__)
INLINE uint32_t lanes_of(Mask m) {
  uint32_t r = 0;
  EACH_PART(r |= (uint32_t)_mm_movemask_ps((__m128)m.part[i]) << (4 * i));
  return r;
}
INLINE Floats square_root(Floats a) { LANES(Floats, (FloatPart)_mm_sqrt_ps((__m128)a.part[i])); }
#elif defined(__aarch64__)  // all else above is NEON already, as the compiler makes it
INLINE uint32_t lanes_of(Mask m) {
  const uint32x4_t bits = {1, 2, 4, 8};
  uint32_t r = 0;
  EACH_PART(r |= vaddvq_u32(vandq_u32((uint32x4_t)m.part[i], bits)) << (4 * i));
  return r;
}
INLINE Floats square_root(Floats a) { LANES(Floats, (FloatPart)vsqrtq_f32((float32x4_t)a.part[i])); }
#else
INLINE uint32_t lanes_of(Mask m) {
  uint32_t r = 0;
  for (int lane = 0; lane < 16; lane++) r |= (uint32_t)(((const int32_t *)&m)[lane] < 0) << lane;
  return r;
}
INLINE Floats square_root(Floats a) {
  for (int lane = 0; lane < 16; lane++) ((float *)&a)[lane] = __builtin_sqrtf(((float *)&a)[lane]);
  return a;
}
#endif
#endif

INLINE bool any(Mask m) { return lanes_of(m) != 0; }
INLINE float lane(const Floats &a, int i) { return ((const float *)&a)[i]; }

typedef float Four __attribute__((vector_size(16), aligned(4), may_alias));

INLINE Four quarters(const Floats &a) {  // added up
  const Four *q = (const Four *)&a;
  return (q[0] + q[1]) + (q[2] + q[3]);
}

// Sum of all lanes in a fixed tree order, so that every instruction set adds alike.
INLINE float sum(const Floats &a) {
  const Four s = quarters(a);
  return (s[0] + s[2]) + (s[1] + s[3]);
}

// GCC before 12 has no __builtin_shufflevector, Clang no __builtin_shuffle.
#if defined(__clang__)
#define FOUR_OF(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
typedef int32_t FourIndices __attribute__((vector_size(16)));
#define FOUR_OF(a, b, ...) __builtin_shuffle(a, b, FourIndices{__VA_ARGS__})
#endif
#define LOW_PAIRS(a, b) FOUR_OF(a, b, 0, 4, 1, 5)
#define HIGH_PAIRS(a, b) FOUR_OF(a, b, 2, 6, 3, 7)
#define LOW_HALVES(a, b) FOUR_OF(a, b, 0, 1, 4, 5)
#define HIGH_HALVES(a, b) FOUR_OF(a, b, 2, 3, 6, 7)

// Rows a, b, c, d of four numbers become the columns of w, x, y, z.
INLINE void transpose_4x4(const float *a, const float *b, const float *c, const float *d, float *w, float *x, float *y,
                          float *z) {
  const Four A = *(const Four *)a, B = *(const Four *)b, C = *(const Four *)c, D = *(const Four *)d;
  const Four ab = LOW_PAIRS(A, B), AB = HIGH_PAIRS(A, B), cd = LOW_PAIRS(C, D), CD = HIGH_PAIRS(C, D);
  *(Four *)w = LOW_HALVES(ab, cd), *(Four *)x = HIGH_HALVES(ab, cd);
  *(Four *)y = LOW_HALVES(AB, CD), *(Four *)z = HIGH_HALVES(AB, CD);
}

// columns[i][l] = rows[l][i], i < width
INLINE void gather_rows(const float *const *rows, int width, float (*columns)[16]) {
  int i = 0;
  for (; i + 4 <= width; i += 4)
    for (int l = 0; l < 16; l += 4)
      transpose_4x4(rows[l] + i, rows[l + 1] + i, rows[l + 2] + i, rows[l + 3] + i, columns[i] + l, columns[i + 1] + l,
                    columns[i + 2] + l, columns[i + 3] + l);
  for (; i < width; i++)
    for (int l = 0; l < 16; l++) columns[i][l] = rows[l][i];
}

// rows[l][i] = columns[i][l], i < width
INLINE void scatter_rows(const float (*columns)[16], int width, float *const *rows) {
  int i = 0;
  for (; i + 4 <= width; i += 4)
    for (int l = 0; l < 16; l += 4)
      transpose_4x4(columns[i] + l, columns[i + 1] + l, columns[i + 2] + l, columns[i + 3] + l, rows[l] + i,
                    rows[l + 1] + i, rows[l + 2] + i, rows[l + 3] + i);
  for (; i < width; i++)
    for (int l = 0; l < 16; l++) rows[l][i] = columns[i][l];
}

// The sums of four at once, added in the order of `sum`.
INLINE void store_sums(float *out, const Floats &a, const Floats &b, const Floats &c, const Floats &d) {
  const Four A = quarters(a), B = quarters(b), C = quarters(c), D = quarters(d);
  const Four ab = LOW_PAIRS(A, B) + HIGH_PAIRS(A, B), cd = LOW_PAIRS(C, D) + HIGH_PAIRS(C, D);
  *(Four *)out = LOW_HALVES(ab, cd) + HIGH_HALVES(ab, cd);
}

// The sums of eight at once.
INLINE void store_eight_sums(float *out, const Floats *a) {
#if DRSPLAT_AVX512
  const auto halved = [](__m512 p, __m512 q) {
    return _mm512_add_ps(_mm512_shuffle_f32x4(p, q, 0x88), _mm512_shuffle_f32x4(p, q, 0xdd));
  };
  __m512 four[2];
  for (int i = 0; i < 2; i++, a += 4)
    four[i] =
        halved(halved((__m512)a[0].part[0], (__m512)a[1].part[0]), halved((__m512)a[2].part[0], (__m512)a[3].part[0]));
  const __m512 pairs = _mm512_add_ps(_mm512_unpacklo_ps(four[0], four[1]), _mm512_unpackhi_ps(four[0], four[1]));
  const __m512 sums = _mm512_add_ps(pairs, _mm512_permute_ps(pairs, 0x4e));
  const __m512i order = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 0, 0, 0, 0, 0, 0, 0, 0);
  _mm256_storeu_ps(out, _mm512_castps512_ps256(_mm512_permutexvar_ps(order, sums)));
#else
  store_sums(out, a[0], a[1], a[2], a[3]), store_sums(out + 4, a[4], a[5], a[6], a[7]);
#endif
}

INLINE Floats floor_of(Floats a) {  // |a| < 2^31
  Floats t = to_float(truncate(a));
  return select(a < t, t - splat(1.f), t);
}

// 2^p for p in [-126, 127], relative error 2e-7: minimax polynomial of 2^f on |f| <= 1/2 after rounding
// p to the nearest integer, which the addition of 1.5 * 2^23 leaves in the low mantissa bits. Forbids
// -ffast-math. Of several numbers step by step, since each step of one waits for the one before.
template <int kCount>
INLINE void exp2_of_each(Floats *p) {
  constexpr float kPolynomial[] = {9.67554189e-3f, 5.55071309e-2f, 2.40221202e-1f, 6.93146944e-1f, 1.f};
  Floats whole[kCount], f[kCount], r[kCount];
#if DRSPLAT_AVX512  // the same bits in fewer instructions
  for (int i = 0; i < kCount; i++)
    whole[i] = {{(FloatPart)_mm512_roundscale_ps((__m512)p[i].part[0], _MM_FROUND_TO_NEAREST_INT)}};
#else
  Floats t[kCount];
  for (int i = 0; i < kCount; i++) t[i] = p[i] + splat(12582912.f);
  for (int i = 0; i < kCount; i++) whole[i] = t[i] - splat(12582912.f);
#endif
  for (int i = 0; i < kCount; i++) f[i] = p[i] - whole[i];
  for (int i = 0; i < kCount; i++) r[i] = splat(1.32764713e-3f);
  for (float coefficient : kPolynomial)
    for (int i = 0; i < kCount; i++) r[i] = r[i] * f[i] + splat(coefficient);
#if DRSPLAT_AVX512
  for (int i = 0; i < kCount; i++)
    p[i] = {{(FloatPart)_mm512_scalef_ps((__m512)r[i].part[0], (__m512)whole[i].part[0])}};
#else
  for (int i = 0; i < kCount; i++) p[i] = float_of_bits(bits_of(r[i]) + shift_left(bits_of(t[i]), 23));
#endif
}

INLINE Floats exp2_of(Floats p) {
  exp2_of_each<1>(&p);
  return p;
}

// log2(a) for normal a > 0, absolute error 1e-7 times the exponent's size: a = m * 2^e with m in
// [sqrt(1/2), sqrt(2)), log(m) = 2 atanh((m - 1) / (m + 1)) by its odd series.
INLINE Floats log2_of(Floats a) {
  Ints shifted = bits_of(a) - splat_int(0x3f3504f3);
  Ints exponent = shift_right(shifted, 23);
  Floats m = float_of_bits((shifted & splat_int(0x7fffff)) + splat_int(0x3f3504f3));
  Floats s = (m - splat(1.f)) / (m + splat(1.f)), z = s * s;
  Floats series = splat(1.f / 9) * z + splat(1.f / 7);
  series = series * z + splat(1.f / 5);
  series = series * z + splat(1.f / 3);
  series = series * z + splat(1.f);
  return to_float(exponent) + s * series * splat(2.8853900818f);
}
#undef LANES
#undef EACH_PART

// Sixteen or more rows, one a lane, so that to compare them takes no reduction across lanes.
constexpr int kRowParts = kParts == 1 ? 2 : 1, kLaneRows = 16 * kRowParts;
static_assert(kLaneRows <= (int)kEncodeScratch, "scratch holds every lane");

// columns[d][r] = rows[r][d], d < dim; where fewer than kLaneRows are left, the last stands for those beyond it.
static inline void rows_as_lanes(const float *rows, size_t stride, uint64_t left, uint32_t dim, float *columns) {
  for (int r = 0; r < kLaneRows; r++) {
    const float *row = rows + ((uint64_t)r < left ? (uint64_t)r : left - 1) * stride;
    for (uint32_t d = 0; d < dim; d++) columns[d * kLaneRows + r] = row[d];
  }
}

}  // namespace drsplat::DRSPLAT_ISA
