// The algebra after registration, as the bindings call it: all rows, on several threads.
#pragma once
#include "kernels/kernels.h"

namespace drsplat {

// Rows of W @ E divided by their norms; `out` is rows x dim. False if an entry names no embedding.
bool weighted_rows(const Kernels &, const SparseRows &, const Embeddings &, uint64_t rows, int threads, float *out);

// Per row and sub-vector the nearest of 256 centroids, ties to the lowest.
void pq_encode(const Kernels &, const Quantizer &, const float *features, uint64_t rows, int threads, uint8_t *codes);

}  // namespace drsplat
