// Products of atoms, which are signed bytes, with vectors that are rounded to whole numbers.
#pragma once
#include "kernels/lanes.h"
#include "kernels/mixture_kernels.h"

namespace drsplat::DRSPLAT_ISA {

// <atom, x> for Rows atoms of signed bytes and whole numbers x: exact, whatever the order of additions.
template <int Rows>
static inline void whole_products(const int8_t *const *rows, const int16_t *x, uint32_t dim, int32_t *products) {
  uint32_t d = 0;
#if DRSPLAT_AVX512
  __m512i total[Rows];
  for (int r = 0; r < Rows; r++) total[r] = _mm512_setzero_si512();
  for (; d + 32 <= dim; d += 32) {
    const __m512i numbers = _mm512_loadu_si512(x + d);
    for (int r = 0; r < Rows; r++) {
      const __m512i values = _mm512_cvtepi8_epi16(_mm256_loadu_si256((const __m256i *)(rows[r] + d)));
      total[r] = _mm512_add_epi32(total[r], _mm512_madd_epi16(values, numbers));
    }
  }
  for (int r = 0; r < Rows; r++) products[r] = _mm512_reduce_add_epi32(total[r]);
#elif defined(__AVX2__)
  __m256i total[Rows];
  for (int r = 0; r < Rows; r++) total[r] = _mm256_setzero_si256();
  for (; d + 16 <= dim; d += 16) {
    const __m256i numbers = _mm256_loadu_si256((const __m256i *)(x + d));
    for (int r = 0; r < Rows; r++) {
      const __m256i values = _mm256_cvtepi8_epi16(_mm_loadu_si128((const __m128i *)(rows[r] + d)));
      total[r] = _mm256_add_epi32(total[r], _mm256_madd_epi16(values, numbers));
    }
  }
  for (int r = 0; r < Rows; r++) {
    __m128i half = _mm_add_epi32(_mm256_castsi256_si128(total[r]), _mm256_extracti128_si256(total[r], 1));
    half = _mm_add_epi32(half, _mm_shuffle_epi32(half, 0x4e));
    products[r] = _mm_cvtsi128_si32(_mm_add_epi32(half, _mm_shuffle_epi32(half, 0xb1)));
  }
#else
  for (int r = 0; r < Rows; r++) products[r] = 0;
#endif
  for (int r = 0; r < Rows; r++) {
    int32_t rest = 0;
    for (uint32_t i = d; i < dim; i++) rest += (int32_t)rows[r][i] * x[i];
    products[r] += rest;
  }
}

// Whole numbers for a vector, and what they are to be multiplied by: as many digits as sums of products with an
// atom can hold, by Cauchy-Schwarz for any part of such a sum too.
static float whole_vector(const float *x, uint32_t dim, int16_t *whole) {
  float largest = 0, squared = 0;
  for (uint32_t d = 0; d < dim; d++) {
    const float size = __builtin_fabsf(x[d]);
    largest = size > largest ? size : largest;
    squared += x[d] * x[d];
  }
  // Beyond these the square, or what is divided by it, leaves float32; nothing that long or short has a direction here.
  const bool known = squared > 1e-24f && squared < 1e24f;
  const float room = (0.98f * 2147483648.f / (127 * __builtin_sqrtf((float)dim)) - 1) / __builtin_sqrtf(squared);
  const float factor = !known ? 0.f : room < 32767 / largest ? room : 32767 / largest;
  for (uint32_t d = 0; d < dim; d++)
    whole[d] = known ? (int16_t)(int32_t)(x[d] * factor + (x[d] < 0 ? -0.5f : 0.5f)) : 0;
  return factor > 0 ? 1 / factor : 0.f;
}

// step * <atom, x> of some atoms.
static void atom_products(const Atoms &atoms, const int32_t *ids, size_t count, const int16_t *x, float step,
                          float *products) {
  const int8_t *rows[4];
  for (size_t i = 0; i < count; i += 4) {
    for (size_t r = 0; r < 4; r++) rows[r] = atoms.values + (size_t)ids[i + r < count ? i + r : i] * atoms.dim;
    int32_t whole[4];
    whole_products<4>(rows, x, atoms.dim, whole);
    for (size_t r = 0; r < 4 && i + r < count; r++)
      products[i + r] = (float)whole[r] * (atoms.scales[ids[i + r]] * step);
  }
}

}  // namespace drsplat::DRSPLAT_ISA
