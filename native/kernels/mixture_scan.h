// The score of every row, by looking up those of its atoms. All sums are of whole numbers, so that no order of
// additions, number of queries or instruction set changes a bit of a score.
#pragma once
#include "kernels/lanes.h"
#include "kernels/mixture_atoms.h"

namespace drsplat::DRSPLAT_ISA {

INLINE int16_t table_entry(int32_t product, float factor) {
  const float value = __builtin_rintf((float)product * factor);
  return (int16_t)(value > 32767.f ? 32767.f : value > -32767.f ? value : -32767.f);  // also what is no number
}

constexpr uint32_t kAtomsAhead = 16;  // atoms that are fetched before they are asked for

// table[atom][place of query] = cosine * 32767.
static void score_table(const Atoms &atoms, const WholeQueries &queries, uint64_t begin, uint64_t end, int16_t *table) {
  for (uint64_t first = begin; first < end; first += 4) {
    const int count = end - first < 4 ? (int)(end - first) : 4;
    const int8_t *rows[4];
    for (int r = 0; r < 4; r++) rows[r] = atoms.values + (first + (uint64_t)(r < count ? r : 0)) * atoms.dim;
    if (first + kAtomsAhead + 4 <= end)
      for (uint32_t d = 0; d < 4 * atoms.dim; d += 64)
        __builtin_prefetch(atoms.values + (first + kAtomsAhead) * atoms.dim + d);
    for (uint32_t q = 0; q < queries.count; q++) {
      FourWhole products[1];
      whole_products<1>(rows, queries.values + (size_t)q * atoms.dim, atoms.dim, products);
      for (int r = 0; r < count; r++)
        table[(first + r) * queries.stride + queries.places[q]] =
            table_entry(products[0][r], atoms.scales[first + r] * queries.steps[q]);
    }
  }
}

INLINE Floats load_halves(const uint16_t *p) {
#if DRSPLAT_AVX512
  return {{(FloatPart)_mm512_cvtph_ps(_mm256_loadu_si256((const __m256i *)p))}};
#else
  float scales[16];
  for (int i = 0; i < 16; i++) scales[i] = scale_of(p[i]);
  return load(scales);
#endif
}

// total[i] = sum over k of weight * table[id], for sixteen rows of a block.
INLINE Ints sixteen_sums(const uint16_t *ids, const uint8_t *weights, uint32_t per_row, const int16_t *table) {
#if DRSPLAT_AVX512
  __m512i total = _mm512_setzero_si512();
  for (uint32_t k = 0; k < per_row; k++, ids += kMixtureBlock, weights += kMixtureBlock) {
    // Each lane holds its entry and the next one; the weight of the next is zero.
    const __m512i entries =
        _mm512_i32gather_epi32(_mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i *)ids)), table, 2);
    total = _mm512_add_epi32(
        total, _mm512_madd_epi16(entries, _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i *)weights))));
  }
  return {{(IntPart)total}};
#else
  int32_t total[16] = {};
  for (uint32_t k = 0; k < per_row; k++, ids += kMixtureBlock, weights += kMixtureBlock)
    for (int i = 0; i < 16; i++) total[i] += (int32_t)table[ids[i]] * weights[i];
  return load_int(total);
#endif
}

template <uint32_t PerRow>
static inline void block_scores(const Mixtures &m, uint64_t block, const uint16_t *scales, const int16_t *table,
                                float *scores) {
  const uint32_t per_row = PerRow ? PerRow : m.per_row;
  const uint16_t *ids = m.ids + block * per_row * kMixtureBlock;
  const uint8_t *weights = m.weights + block * per_row * kMixtureBlock;
  for (int i = 0; i < kMixtureBlock; i += 16) {
    const Ints total = sixteen_sums(ids + i, weights + i, per_row, table);
    store(scores + i, to_float(total) * (load_halves(scales + i) * splat(1.f / 32767)));
  }
}

// Scores of rows [begin, end); begin is the first of a block, and so is end unless it is the last row.
static void mixture_scores(const Mixtures &m, const int16_t *table, uint64_t begin, uint64_t end, float *scores) {
  for (uint64_t row = begin; row < end; row += kMixtureBlock, scores += kMixtureBlock) {
    const uint64_t left = end - row;
    if (left < kMixtureBlock) {
      uint16_t scales[kMixtureBlock] = {};
      float last[kMixtureBlock];
      memcpy(scales, m.scales + row, left * sizeof(uint16_t));
      block_scores<0>(m, row / kMixtureBlock, scales, table, last);
      memcpy(scores, last, left * sizeof(float));
      return;
    }
    switch (m.per_row) {
      case 2: block_scores<2>(m, row / kMixtureBlock, m.scales + row, table, scores); break;
      case 4: block_scores<4>(m, row / kMixtureBlock, m.scales + row, table, scores); break;
      case 8: block_scores<8>(m, row / kMixtureBlock, m.scales + row, table, scores); break;
      default: block_scores<0>(m, row / kMixtureBlock, m.scales + row, table, scores);
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
