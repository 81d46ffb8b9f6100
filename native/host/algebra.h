// The algebra after registration, as the bindings call it: all rows, on several threads.
#pragma once
#include "kernels/kernels.h"

namespace drsplat {

// Rows of W @ E divided by their norms; `out` is rows x dim. False if an entry names no embedding.
bool weighted_rows(const Kernels &, const SparseRows &, const Embeddings &, uint64_t rows, int threads, float *out);

// A @ B; `out` is rows x width.
void dense_rows(const Kernels &, const DenseProduct &, uint64_t rows, int threads, float *out);

// Per row and sub-vector the nearest of 256 centroids, ties to the lowest.
void pq_encode(const Kernels &, const Quantizer &, const float *features, uint64_t rows, int threads, uint8_t *codes);

// Puts more scores among the best that are kept of each row.
void keep_best(const Kernels &, const Contest &, int threads);

// W with its columns numbered anew (below 0: left out) and the entries of `added` put in, row by row; columns ascend in
// both, and so do numbers.
struct ColumnChange {
  SparseRows weights, added;
  const int32_t *numbers;
  uint64_t rows, columns;
};

// Where rows begin then: rows + 1 numbers. False if an entry names no column.
bool changed_starts(const ColumnChange &, int threads, int64_t *starts);
void changed_rows(const ColumnChange &, const int64_t *starts, int threads, int32_t *columns, float *weights);

}  // namespace drsplat
