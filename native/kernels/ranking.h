// The few best of many.
#pragma once
#include "kernels/isa.h"

namespace drsplat::DRSPLAT_ISA {

// The n-th of a list, heaviest first; of equal weights the earlier stays in front.
static inline void insert_descending(int32_t *ids, float *weights, size_t n, int32_t id, float weight) {
  for (; n > 0 && weights[n - 1] < weight; n--) ids[n] = ids[n - 1], weights[n] = weights[n - 1];
  ids[n] = id, weights[n] = weight;
}

}  // namespace drsplat::DRSPLAT_ISA
