// Rows of A @ B, both dense: each number is summed in the order of the columns of A, whoever computes it.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

// Rows at once, and vectors of each, so that sums, vectors of B and a number of A stay in registers.
constexpr int kDenseRows = kParts > 2 ? 2 : kParts > 1 ? 4 : 8, kDenseVectors = kParts > 1 ? 1 : 2;

template <int Rows, int Vectors>
static inline void dense_tile(const DenseProduct &p, const float *const *rows, uint32_t at, float *out) {
  Floats total[Rows][Vectors];
  for (int r = 0; r < Rows; r++)
    for (int v = 0; v < Vectors; v++) total[r][v] = splat(0.f);
  const float *b = p.b + at;
  for (uint32_t piece = 0; piece < p.pieces; piece++) {
    const size_t begin = piece * p.step, end = begin + p.depth / p.pieces;
    for (size_t k = begin; k < end; k++, b += p.width) {
      Floats column[Vectors];
      for (int v = 0; v < Vectors; v++) column[v] = load(b + 16 * v);
      for (int r = 0; r < Rows; r++)
        for (int v = 0; v < Vectors; v++) total[r][v] = total[r][v] + splat(rows[r][k]) * column[v];
    }
  }
  for (int r = 0; r < Rows; r++)
    for (int v = 0; v < Vectors; v++) {
      Floats sum = total[r][v];
      if (p.bias) sum = maximum(sum + load(p.bias + at + 16 * v), splat(0.f));
      store(out + (size_t)r * p.width + at + 16 * v, sum);
    }
}

template <int Vectors>
static inline void dense_columns(const DenseProduct &p, const float *const *rows, uint32_t count, uint32_t at,
                                 float *out) {
  uint32_t row = 0;
  for (; row + kDenseRows <= count; row += kDenseRows)
    dense_tile<kDenseRows, Vectors>(p, rows + row, at, out + (size_t)row * p.width);
  for (; row < count; row++) dense_tile<1, Vectors>(p, rows + row, at, out + (size_t)row * p.width);
}

// `count` rows of `out`, which is as wide as B: a multiple of 16.
static void dense_rows(const DenseProduct &p, const float *const *rows, uint32_t count, float *out) {
  uint32_t at = 0;
  for (; at + 16 * kDenseVectors <= p.width; at += 16 * kDenseVectors)
    dense_columns<kDenseVectors>(p, rows, count, at, out);
  if (at < p.width) dense_columns<1>(p, rows, count, at, out);
}

}  // namespace drsplat::DRSPLAT_ISA
