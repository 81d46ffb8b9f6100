// From sums of look-ups to what was asked.
#pragma once
#include "kernels/isa.h"
#include "kernels/scan_kernels.h"

namespace drsplat::DRSPLAT_ISA {

static void finish(const GroupedRows &rows, const float *coarse, uint32_t coarse_count, uint64_t first_row,
                   uint32_t count, const float *sums, float *out) {
  const float *scale = rows.inverse_norms + first_row;
  if (!rows.coarse_ids) {
    for (uint32_t i = 0; i < count; i++) out[i] = sums[i] * scale[i];
    return;
  }
  const uint16_t *ids = rows.coarse_ids + first_row;
  for (uint32_t i = 0; i < count; i++) {
    const float term = ids[i] < coarse_count ? coarse[ids[i]] : 0.f;
    out[i] = (sums[i] + term) * scale[i];
  }
}

static uint32_t above(const float *scores, const float *floor, float threshold, uint64_t first_row, uint32_t count,
                      CandidateRow *out) {
  uint32_t found = 0;
  for (uint32_t begin = 0; begin < count; begin += 16) {
    const uint32_t end = begin + 16 < count ? begin + 16 : count;
    float margins[16];
    int any = 0;
    if (end == begin + 16)
      for (uint32_t i = 0; i < 16; i++)
        margins[i] = floor ? scores[begin + i] - floor[begin + i] : scores[begin + i], any |= margins[i] > threshold;
    else
      for (uint32_t i = begin; i < end; i++) margins[i - begin] = floor ? scores[i] - floor[i] : scores[i], any = 1;
    if (!any) continue;
    for (uint32_t i = begin; i < end; i++) {
      out[found] = {scores[i], (int64_t)(first_row + i)};
      found += margins[i - begin] > threshold;
    }
  }
  return found;
}

static void compete(const float *__restrict sums, const float *__restrict scale, int32_t index, uint32_t count,
                    int32_t *__restrict winner, float *__restrict best, float *__restrict runner_up) {
  for (uint32_t i = 0; i < count; i++) {
    const float score = sums[i] * scale[i], other = best[i] < score ? best[i] : score;
    runner_up[i] = runner_up[i] < other ? other : runner_up[i];
    winner[i] = best[i] < score ? index : winner[i];
    best[i] = best[i] < score ? score : best[i];
  }
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
