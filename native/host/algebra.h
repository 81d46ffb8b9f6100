// The algebra after registration, as the bindings call it: all rows, on several threads.
#pragma once
#include "kernels/kernels.h"

namespace drsplat {

// Rows of W @ E divided by their norms; `out` is rows x dim. False if an entry names no embedding.
bool weighted_rows(const Kernels &, const SparseRows &, const Embeddings &, uint64_t rows, int threads, float *out);

// A @ B; `out` is rows x width.
void dense_rows(const Kernels &, const float *a, const float *b, uint64_t rows, uint32_t depth, uint32_t width,
                int threads, float *out);

// Images of pixels of channels, and a 3x3 convolution of them with zeros around each. weights: by row, column and
// channel of the window, `outputs` numbers each, a multiple of 16, as is the bias.
struct Convolution {
  const float *images, *weights, *bias;
  uint64_t count;
  uint32_t height, width, channels, outputs, stride;
  uint32_t rows() const { return (height + stride - 1) / stride; }
  uint32_t columns() const { return (width + stride - 1) / stride; }
};

// What is below 0 becomes 0; `out` is count x rows x columns x outputs.
void convolve(const Kernels &, const Convolution &, int threads, float *out);

// Per row and sub-vector the nearest of 256 centroids, ties to the lowest.
void pq_encode(const Kernels &, const Quantizer &, const float *features, uint64_t rows, int threads, uint8_t *codes);

// Puts more scores among the best that are kept of each row.
void keep_best(const Kernels &, const Contest &, int threads);

// Of the points of each code in each sub-vector, their sum in the order of rows, and how many. points: rows x
// subvectors x dim; sums, which are zero, subvectors x 256 x dim.
void code_sums(const float *points, const uint8_t *codes, uint64_t rows, uint32_t subvectors, uint32_t dim, int threads,
               double *sums, int64_t *counts);

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

// Puts one view's entries into the rows of a matrix. next: where each row's next entry goes, which moves on. False if
// an entry names no row, or its row has no room: it is left out then.
struct ViewEntries {
  const uint32_t *rows;
  const int32_t *columns;  // to which first_column is added
  const float *weights;
  uint64_t count;
  int32_t first_column;
};
bool place_entries(const ViewEntries &, int64_t *next, uint64_t rows, uint64_t room, int32_t *columns, float *weights);

}  // namespace drsplat
