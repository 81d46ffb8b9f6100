// Products of atoms, which are signed bytes, with vectors that are rounded to whole numbers.
#pragma once
#include "kernels/lanes.h"
#include "kernels/mixture_kernels.h"

namespace drsplat::DRSPLAT_ISA {

#if DRSPLAT_AVX512
using WholeSums = __m512i;
INLINE WholeSums no_sums() { return _mm512_setzero_si512(); }
INLINE WholeSums loaded(const int16_t *p) { return _mm512_loadu_si512(p); }
INLINE WholeSums widened(const int8_t *p) { return _mm512_cvtepi8_epi16(_mm256_loadu_si256((const __m256i *)p)); }
INLINE WholeSums with_products(WholeSums total, WholeSums a, WholeSums b) {
#if defined(__AVX512VNNI__)
  return _mm512_dpwssd_epi32(total, a, b);
#else
  return _mm512_add_epi32(total, _mm512_madd_epi16(a, b));
#endif
}
INLINE __m256i half_sums(WholeSums a) {
  return _mm256_add_epi32(_mm512_castsi512_si256(a), _mm512_extracti64x4_epi64(a, 1));
}
#elif defined(__AVX2__)
using WholeSums = __m256i;
INLINE WholeSums no_sums() { return _mm256_setzero_si256(); }
INLINE WholeSums loaded(const int16_t *p) { return _mm256_loadu_si256((const __m256i *)p); }
INLINE WholeSums widened(const int8_t *p) { return _mm256_cvtepi8_epi16(_mm_loadu_si128((const __m128i *)p)); }
INLINE WholeSums with_products(WholeSums total, WholeSums a, WholeSums b) {
  return _mm256_add_epi32(total, _mm256_madd_epi16(a, b));
}
INLINE __m256i half_sums(WholeSums a) { return a; }
#endif

#if defined(__AVX2__)
constexpr uint32_t kWholeStep = sizeof(WholeSums) / 2;  // numbers at once

// The sum of each of four.
INLINE __m128i four_sums(const WholeSums *totals) {
  __m256i half[4];
  for (int i = 0; i < 4; i++) half[i] = half_sums(totals[i]);
  const __m256i ab = _mm256_hadd_epi32(half[0], half[1]), cd = _mm256_hadd_epi32(half[2], half[3]);
  const __m256i all = _mm256_hadd_epi32(ab, cd);
  return _mm_add_epi32(_mm256_castsi256_si128(all), _mm256_extracti128_si256(all, 1));
}
#endif

typedef int32_t FourWhole __attribute__((vector_size(16)));

// products[v][r] = <atom r, v-th of the vectors at x>, of whole numbers: exact, whatever the order of additions.
template <int Vectors>
static inline void whole_products(const int8_t *const *rows, const int16_t *x, uint32_t dim, FourWhole *products) {
  uint32_t d = 0;
#if defined(__AVX2__)
  WholeSums totals[Vectors][4];
  for (int v = 0; v < Vectors; v++)
    for (int r = 0; r < 4; r++) totals[v][r] = no_sums();
  for (; d + kWholeStep <= dim; d += kWholeStep) {
    WholeSums numbers[Vectors];
    for (int v = 0; v < Vectors; v++) numbers[v] = loaded(x + (size_t)v * dim + d);
    for (int r = 0; r < 4; r++) {
      const WholeSums values = widened(rows[r] + d);
      for (int v = 0; v < Vectors; v++) totals[v][r] = with_products(totals[v][r], values, numbers[v]);
    }
  }
  for (int v = 0; v < Vectors; v++) products[v] = (FourWhole)four_sums(totals[v]);
#else
  for (int v = 0; v < Vectors; v++) products[v] = FourWhole{};
#endif
  for (int v = 0; v < Vectors && d < dim; v++)
    for (int r = 0; r < 4; r++) {
      int32_t rest = 0;
      for (uint32_t i = d; i < dim; i++) rest += (int32_t)rows[r][i] * x[(size_t)v * dim + i];
      products[v][r] += rest;
    }
}

static float largest_size(const float *x, uint32_t dim) {
  float sizes[16];
  Floats most = splat(0.f);
  uint32_t d = 0;
  for (; d + 16 <= dim; d += 16) {
    const Floats numbers = load(x + d);
    most = maximum(maximum(numbers, -numbers), most);
  }
  store(sizes, most);
  for (uint32_t i = 0; d < dim; i++, d++) {
    const float size = __builtin_fabsf(x[d]);
    sizes[i] = size > sizes[i] ? size : sizes[i];
  }
  float largest = 0;
  for (int i = 0; i < 16; i++) largest = sizes[i] > largest ? sizes[i] : largest;
  return largest;
}

// Whole numbers for a vector, and what they are to be multiplied by: as many digits as sums of products with an
// atom can hold, by Cauchy-Schwarz for any part of such a sum too.
static float whole_vector(const float *x, uint32_t dim, int16_t *whole) {
  const float largest = largest_size(x, dim);
  float squared = 0;
  for (uint32_t d = 0; d < dim; d++) squared += x[d] * x[d];
  // Beyond these the square, or what is divided by it, leaves float32; nothing that long or short has a direction here.
  const bool known = squared > 1e-24f && squared < 1e24f;
  const float room = (0.98f * 2147483648.f / (127 * __builtin_sqrtf((float)dim)) - 1) / __builtin_sqrtf(squared);
  const float factor = !known ? 0.f : room < 32767 / largest ? room : 32767 / largest;
  for (uint32_t d = 0; d < dim; d++)
    whole[d] = known ? (int16_t)(int32_t)(x[d] * factor + (x[d] < 0 ? -0.5f : 0.5f)) : 0;
  return factor > 0 ? 1 / factor : 0.f;
}

// products[v][i] = steps[v] * <atom i, v-th of the vectors at x>, for some atoms.
template <int Vectors>
static void atom_products(const Atoms &atoms, const int32_t *ids, size_t count, const int16_t *x, const float *steps,
                          float *products) {
  for (size_t i = 0; i < count; i += 4) {
    const size_t known = count - i < 4 ? count - i : 4;  // the first stands for those beyond the last
    const int8_t *rows[4];
    Four scales;
    for (size_t r = 0; r < 4; r++) {
      const size_t id = (size_t)ids[r < known ? i + r : i];
      rows[r] = atoms.values + id * atoms.dim, scales[r] = atoms.scales[id];
    }
    FourWhole whole[Vectors];
    whole_products<Vectors>(rows, x, atoms.dim, whole);
    for (int v = 0; v < Vectors; v++) {
      const Four four = __builtin_convertvector(whole[v], Four) * (scales * steps[v]);
      float *out = products + v * count + i;
      if (known == 4) *(Four *)out = four;
      else
        for (size_t r = 0; r < known; r++) out[r] = four[r];
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
