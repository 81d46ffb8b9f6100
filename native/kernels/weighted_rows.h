// Rows of W @ E, of length one.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

constexpr int kColumnParts = kParts == 1 ? 8 : 4;  // sums of 16 columns kept in registers
constexpr int64_t kPartialSum = 32;                // entries added up before they join the total: keeps long rows exact

template <int Parts>
static inline void weighted_columns(const SparseRows &w, int64_t begin, int64_t end, const float *embeddings,
                                    size_t dim, float *out) {
  Floats total[Parts];
  for (int p = 0; p < Parts; p++) total[p] = splat(0.f);
  for (int64_t first = begin; first < end; first += kPartialSum) {
    const int64_t last = end - first < kPartialSum ? end : first + kPartialSum;
    Floats partial[Parts];
    for (int p = 0; p < Parts; p++) partial[p] = splat(0.f);
    for (int64_t k = first; k < last; k++) {
      const float *embedding = embeddings + (size_t)w.columns[k] * dim;
      const Floats weight = splat(w.weights[k]);
      for (int p = 0; p < Parts; p++) partial[p] = partial[p] + weight * load(embedding + 16 * p);
    }
    for (int p = 0; p < Parts; p++) total[p] = total[p] + partial[p];
  }
  for (int p = 0; p < Parts; p++) store(out + 16 * p, total[p]);
}

static inline float weighted_column(const SparseRows &w, int64_t begin, int64_t end, const float *embeddings,
                                    size_t dim) {
  float total = 0.f;
  for (int64_t first = begin; first < end; first += kPartialSum) {
    const int64_t last = end - first < kPartialSum ? end : first + kPartialSum;
    float partial = 0.f;
    for (int64_t k = first; k < last; k++) partial += w.weights[k] * embeddings[(size_t)w.columns[k] * dim];
    total += partial;
  }
  return total;
}

static inline void normalize(float *row, size_t dim) {
  double lanes[8] = {};
  size_t c = 0;
  for (; c + 8 <= dim; c += 8)
    for (int i = 0; i < 8; i++) lanes[i] += (double)row[c + i] * row[c + i];
  for (int i = 0; c < dim; c++, i++) lanes[i] += (double)row[c] * row[c];
  const double squared =
      ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]));
  if (!(squared > 0)) return;
  const double scale = 1 / __builtin_sqrt(squared);
  for (c = 0; c < dim; c++) row[c] = (float)(row[c] * scale);
}

// Rows [begin, end) of W @ E, each divided by its norm. False, with nothing promised about `out`, if an
// entry names no embedding.
static bool weighted_rows(const SparseRows &w, const Embeddings &e, uint64_t begin, uint64_t end, float *out) {
  for (uint64_t i = begin; i < end; i++) {
    const int64_t first = w.starts[i], last = w.starts[i + 1];
    for (int64_t k = first; k < last; k++)
      if ((uint32_t)w.columns[k] >= e.count) return false;
    float *row = out + i * e.dim;
    size_t c = 0;
    for (; c + 16 * kColumnParts <= e.dim; c += 16 * kColumnParts)
      weighted_columns<kColumnParts>(w, first, last, e.values + c, e.dim, row + c);
    for (; c + 16 <= e.dim; c += 16) weighted_columns<1>(w, first, last, e.values + c, e.dim, row + c);
    for (; c < e.dim; c++) row[c] = weighted_column(w, first, last, e.values + c, e.dim);
    normalize(row, e.dim);
  }
  return true;
}

}  // namespace drsplat::DRSPLAT_ISA
