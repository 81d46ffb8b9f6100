// Product quantisation: the nearest centroids of rows.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

// `subvectors`: dim x kLaneRows floats. Dim 0 means `dim`, known at run time only. The
// difference is squared, not expanded: a feature equal to a centroid is at distance 0 exactly.
template <uint32_t Dim>
static inline void nearest_centroids(const float *subvectors, const float *centroids, uint32_t dim, int32_t *nearest) {
  if (Dim) dim = Dim;
  Floats best[kRowParts];
  Ints index[kRowParts];
  for (int p = 0; p < kRowParts; p++) best[p] = splat(__builtin_inff()), index[p] = splat_int(0);
  for (int32_t c = 0; c < 256; c++, centroids += dim) {
    Floats distance[kRowParts];
    for (int p = 0; p < kRowParts; p++) distance[p] = splat(0.f);
    for (uint32_t d = 0; d < dim; d++) {
      const Floats centroid = splat(centroids[d]);
      for (int p = 0; p < kRowParts; p++) {
        const Floats difference = load(subvectors + 16 * (kRowParts * d + p)) - centroid;
        distance[p] = distance[p] + difference * difference;
      }
    }
    for (int p = 0; p < kRowParts; p++) {
      index[p] = select(distance[p] < best[p], splat_int(c), index[p]);
      best[p] = minimum(distance[p], best[p]);
    }
  }
  for (int p = 0; p < kRowParts; p++) memcpy(nearest + 16 * p, &index[p], sizeof index[p]);
}

// `scratch`: kEncodeScratch * dim floats.
static void pq_encode(const Quantizer &q, const float *features, uint64_t begin, uint64_t end, float *scratch,
                      uint8_t *codes) {
  const uint32_t dim = q.dim;
  const size_t stride = (size_t)q.subvectors * dim;
  int32_t nearest[kLaneRows];
  for (uint64_t first = begin; first < end; first += kLaneRows) {
    const uint64_t left = end - first;
    for (uint32_t m = 0; m < q.subvectors; m++) {
      rows_as_lanes(features + first * stride + (size_t)m * dim, stride, left, dim, scratch);
      const float *centroids = q.centroids + (size_t)m * 256 * dim;
      switch (dim) {
        case 2: nearest_centroids<2>(scratch, centroids, dim, nearest); break;
        case 4: nearest_centroids<4>(scratch, centroids, dim, nearest); break;
        case 8: nearest_centroids<8>(scratch, centroids, dim, nearest); break;
        case 16: nearest_centroids<16>(scratch, centroids, dim, nearest); break;
        default: nearest_centroids<0>(scratch, centroids, dim, nearest);
      }
      for (int r = 0; r < kLaneRows && (uint64_t)r < left; r++)
        codes[(first + r) * q.subvectors + m] = (uint8_t)nearest[r];
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
