// Rows of A @ B, both dense: each number is summed in the order of the columns of A, whoever computes it.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

constexpr int kDenseRows = kParts > 2 ? 2 : 4;  // rows at once, so that sums and one vector of B stay in registers

template <int Rows>
static inline void dense_columns(const float *a, const float *b, uint32_t depth, uint32_t width, float *out) {
  Floats total[Rows];
  for (int r = 0; r < Rows; r++) total[r] = splat(0.f);
  for (uint32_t k = 0; k < depth; k++) {
    const Floats column = load(b + (size_t)k * width);
    for (int r = 0; r < Rows; r++) total[r] = total[r] + splat(a[(size_t)r * depth + k]) * column;
  }
  for (int r = 0; r < Rows; r++) store(out + (size_t)r * width, total[r]);
}

// Rows [begin, end) of `out`, which is as wide as B: a multiple of 16.
static void dense_rows(const DenseProduct &p, uint64_t begin, uint64_t end, float *out) {
  uint64_t row = begin;
  for (; row + kDenseRows <= end; row += kDenseRows)
    for (uint32_t c = 0; c < p.width; c += 16)
      dense_columns<kDenseRows>(p.a + row * p.depth, p.b + c, p.depth, p.width, out + row * p.width + c);
  for (; row < end; row++)
    for (uint32_t c = 0; c < p.width; c += 16)
      dense_columns<1>(p.a + row * p.depth, p.b + c, p.depth, p.width, out + row * p.width + c);
}

}  // namespace drsplat::DRSPLAT_ISA
