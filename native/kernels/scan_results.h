// From sums of look-ups to what was asked.
#pragma once
#include "kernels/lanes.h"
#include "kernels/scan_kernels.h"

namespace drsplat::DRSPLAT_ISA {

constexpr uint64_t kManyRows = 1 << 18;

// Writes past the caches where scores are many: what they held of the codes would be lost, and lines that are written
// whole need not be read first.
#if defined(__AVX512F__)
static void stream_scaled(const float *sums, const float *scale, uint32_t count, float *out) {
  for (uint32_t i = 0; i < count; i += 16)
    _mm512_stream_ps(out + i, _mm512_mul_ps(_mm512_loadu_ps(sums + i), _mm512_loadu_ps(scale + i)));
}
#elif defined(__AVX2__)
static void stream_scaled(const float *sums, const float *scale, uint32_t count, float *out) {
  for (uint32_t i = 0; i < count; i += 8) {
    __builtin_prefetch(scale + i + 2 * kGroupRows);
    _mm256_stream_ps(out + i, _mm256_mul_ps(_mm256_loadu_ps(sums + i), _mm256_loadu_ps(scale + i)));
  }
}
#endif

static void finish(const GroupedRows &rows, const float *coarse, uint32_t coarse_count, uint64_t first_row,
                   uint32_t count, const float *sums, float *out) {
  const float *scale = rows.inverse_norms + first_row;
  if (!rows.coarse_ids) {
#if defined(__AVX2__)
    if (rows.rows >= kManyRows && out != sums && count == kSumRows && (uintptr_t)out % 64 == 0) {
      stream_scaled(sums, scale, count, out);
      return;
    }
#endif
    for (uint32_t i = 0; i < count; i++) out[i] = sums[i] * scale[i];
    return;
  }
  const uint16_t *ids = rows.coarse_ids + first_row;
  for (uint32_t i = 0; i < count; i++) {
    const float term = ids[i] < coarse_count ? coarse[ids[i]] : 0.f;
    out[i] = (sums[i] + term) * scale[i];
  }
}

static uint32_t above(const float *scores, const float *floor, float threshold, uint32_t count, uint32_t *out) {
  uint32_t found = 0, i = 0;
#if defined(__AVX512F__)
  __m512i numbers = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  for (; i + 16 <= count; i += 16) {
    __m512 margin = _mm512_loadu_ps(scores + i);
    if (floor) margin = _mm512_sub_ps(margin, _mm512_loadu_ps(floor + i));
    const __mmask16 above = _mm512_cmp_ps_mask(margin, _mm512_set1_ps(threshold), _CMP_GT_OQ);
    _mm512_storeu_si512(out + found, _mm512_maskz_compress_epi32(above, numbers));
    found += (uint32_t)__builtin_popcount(above);
    numbers = _mm512_add_epi32(numbers, _mm512_set1_epi32(16));
  }
#endif
  for (; i < count; i++) {  // without a branch: which rows are above is not to be foreseen
    out[found] = i;
    found += (floor ? scores[i] - floor[i] : scores[i]) > threshold;
  }
  return found;
}

// Sixteen rows; all queries pass while what they have won stays in registers.
INLINE void compete_16(const float *sums, const float *scale, uint32_t first, uint32_t queries, int32_t *winner,
                       float *best, float *runner_up) {
  const Floats scales = load(scale), lowest = splat(-__builtin_inff());
  Ints won = first ? load_int(winner) : splat_int(0);
  Floats most = first ? load(best) : lowest, second = first ? load(runner_up) : lowest;
  for (uint32_t q = 0; q < queries; q++) {
    const Floats score = load(sums + q * kSumRows) * scales;
    const Mask wins = most < score;
    const Floats other = select(wins, most, score);
    second = select(second < other, other, second);
    won = select(wins, splat_int((int32_t)(first + q)), won);
    most = select(wins, score, most);
  }
  store_int(winner, won), store(best, most), store(runner_up, second);
}

static void compete(const float *sums, const float *scale, uint32_t first, uint32_t queries, uint32_t count,
                    int32_t *winner, float *best, float *runner_up) {
  uint32_t i = 0;
  for (; i + 16 <= count; i += 16) compete_16(sums + i, scale + i, first, queries, winner + i, best + i, runner_up + i);
  if (i == count) return;
  const size_t rest = (count - i) * sizeof(float);
  alignas(64) float scales[16] = {}, most[16] = {}, second[16] = {};
  alignas(64) int32_t won[16] = {};
  memcpy(scales, scale + i, rest), memcpy(won, winner + i, rest);
  memcpy(most, best + i, rest), memcpy(second, runner_up + i, rest);
  compete_16(sums + i, scales, first, queries, won, most, second);
  memcpy(winner + i, won, rest), memcpy(best + i, most, rest), memcpy(runner_up + i, second, rest);
}

static void lookup_tables(const float *centroids, const float *queries, uint32_t count, uint32_t subvectors,
                          uint32_t dim, uint32_t begin, uint32_t end, float *tables) {
  for (uint32_t m = begin; m < end; m++) {
    for (uint32_t q = 0; q < count; q++) {
      const float *part = queries + ((size_t)q * subvectors + m) * dim, *from = centroids + (size_t)m * dim * 256;
      float *__restrict table = tables + ((size_t)q * subvectors + m) * 256;
      for (uint32_t c = 0; c < 256; c++) table[c] = part[0] * from[c];
      for (uint32_t d = 1; d < dim; d++)
        for (uint32_t c = 0; c < 256; c++) table[c] += part[d] * from[d * 256 + c];
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
