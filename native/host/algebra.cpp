// Every output row is made by one thread, whichever: the same bits for any number of them.
#include "host/algebra.h"

#include "host/parallel.h"

#include <atomic>
#include <vector>

namespace drsplat {

constexpr uint64_t kDenseBlock = 64;  // rows of a product that a thread takes at once

bool weighted_rows(const Kernels &kernels, const SparseRows &weights, const Embeddings &embeddings, uint64_t rows,
                   int threads, float *out) {
  std::atomic<bool> ok{true};
  over_rows(rows, 64, threads, [&](int, uint64_t begin, uint64_t end) {
    if (!kernels.weighted_rows(weights, embeddings, begin, end, out)) ok = false;
  });
  return ok;
}

void dense_rows(const Kernels &kernels, const float *a, const float *b, uint64_t rows, uint32_t depth, uint32_t width,
                int threads, float *out) {
  const DenseProduct product{b, depth, width, 1, 0, nullptr};
  over_rows(rows, kDenseBlock, threads, [&](int, uint64_t begin, uint64_t end) {
    const float *starts[kDenseBlock];
    for (uint64_t row = begin; row < end; row++) starts[row - begin] = a + row * depth;
    kernels.dense_rows(product, starts, (uint32_t)(end - begin), out + begin * width);
  });
}

namespace {

// An image with a pixel of zeros around it.
void pad(const Convolution &c, uint64_t image, float *padded) {
  const size_t row = (size_t)c.width * c.channels, wide = row + 2 * (size_t)c.channels;
  std::fill_n(padded, (c.height + 2) * wide, 0.f);
  for (size_t y = 0; y < c.height; y++)
    std::copy_n(c.images + (image * c.height + y) * row, row, padded + (y + 1) * wide + c.channels);
}

}  // namespace

void convolve(const Kernels &kernels, const Convolution &c, int threads, float *out) {
  const size_t wide = ((size_t)c.width + 2) * c.channels, room = ((size_t)c.height + 2) * wide;
  const size_t pixels = (size_t)c.rows() * c.columns();
  if (!pixels) return;
  const DenseProduct product{c.weights, 9 * c.channels, c.outputs, 3, wide, c.bias};
  const uint64_t at_once = std::max<uint64_t>(1, kDenseBlock / pixels);
  over_rows(c.count, at_once, threads, [&](int, uint64_t begin, uint64_t end) {
    std::vector<float> padded((end - begin) * room);
    std::vector<const float *> windows;
    for (uint64_t image = begin; image < end; image++) {
      const float *first = padded.data() + (image - begin) * room;
      pad(c, image, padded.data() + (image - begin) * room);
      for (size_t y = 0; y < c.rows(); y++)
        for (size_t x = 0; x < c.columns(); x++) windows.push_back(first + c.stride * (y * wide + x * c.channels));
    }
    for (size_t at = 0; at < windows.size(); at += kDenseBlock) {
      const auto count = (uint32_t)std::min<size_t>(kDenseBlock, windows.size() - at);
      kernels.dense_rows(product, windows.data() + at, count, out + (begin * pixels + at) * c.outputs);
    }
  });
}

void pq_encode(const Kernels &kernels, const Quantizer &quantizer, const float *features, uint64_t rows, int threads,
               uint8_t *codes) {
  over_rows(rows, 512, threads, [&](int, uint64_t begin, uint64_t end) {
    std::vector<float> scratch(kEncodeScratch * quantizer.dim);
    kernels.pq_encode(quantizer, features, begin, end, scratch.data(), codes);
  });
}

void keep_best(const Kernels &kernels, const Contest &contest, int threads) {
  over_rows(contest.rows, 4096, threads,
            [&](int, uint64_t begin, uint64_t end) { kernels.keep_best(contest, begin, end); });
}

void code_sums(const float *points, const uint8_t *codes, uint64_t rows, uint32_t subvectors, uint32_t dim, int threads,
               double *sums, int64_t *counts) {
  over_rows(subvectors, 16, threads, [&](int, uint64_t begin, uint64_t end) {
    for (uint64_t row = 0; row < rows; row++)
      for (uint64_t m = begin; m < end; m++) {
        const size_t place = m * 256 + codes[row * subvectors + m];
        const float *point = points + (row * subvectors + m) * dim;
        for (uint32_t d = 0; d < dim; d++) sums[place * dim + d] += point[d];
        counts[place]++;
      }
  });
}

bool changed_starts(const ColumnChange &change, int threads, int64_t *starts) {
  std::atomic<bool> ok{true};
  const SparseRows &w = change.weights, &more = change.added;
  starts[0] = 0;
  over_rows(change.rows, 4096, threads, [&](int, uint64_t begin, uint64_t end) {
    for (uint64_t row = begin; row < end; row++) {
      int64_t count = more.starts[row + 1] - more.starts[row];
      for (int64_t k = w.starts[row]; k < w.starts[row + 1]; k++) {
        const bool known = (uint32_t)w.columns[k] < change.columns;
        if (!known) ok = false;
        count += known && change.numbers[w.columns[k]] >= 0;
      }
      starts[row + 1] = count;
    }
  });
  for (uint64_t row = 0; row < change.rows; row++) starts[row + 1] += starts[row];
  return ok;
}

void changed_rows(const ColumnChange &change, const int64_t *starts, int threads, int32_t *columns, float *weights) {
  const SparseRows &w = change.weights, &more = change.added;
  over_rows(change.rows, 4096, threads, [&](int, uint64_t begin, uint64_t end) {
    for (uint64_t row = begin; row < end; row++) {
      int64_t at = starts[row], next = more.starts[row];
      const int64_t last = more.starts[row + 1], end_of_row = starts[row + 1];
      const auto put = [&](int32_t column, float weight) {
        if (at < end_of_row) columns[at] = column, weights[at++] = weight;  // W may be a map of a file that changes
      };
      for (int64_t k = w.starts[row]; k < w.starts[row + 1]; k++) {
        const uint32_t column = (uint32_t)w.columns[k];
        const int32_t number = column < change.columns ? change.numbers[column] : -1;
        if (number < 0) continue;
        for (; next < last && more.columns[next] < number; next++) put(more.columns[next], more.weights[next]);
        put(number, w.weights[k]);
      }
      for (; next < last; next++) put(more.columns[next], more.weights[next]);
    }
  });
}

bool place_entries(const ViewEntries &entries, int64_t *next, uint64_t rows, uint64_t room, int32_t *columns,
                   float *weights) {
  bool ok = true;
  for (uint64_t i = 0; i < entries.count; i++) {
    const uint32_t row = entries.rows[i];
    const uint64_t at = row < rows ? (uint64_t)next[row] : room;
    if (at < room) {
      next[row] = (int64_t)at + 1;
      columns[at] = (int32_t)((uint32_t)entries.first_column + (uint32_t)entries.columns[i]);
      weights[at] = entries.weights[i];
    } else {
      ok = false;
    }
  }
  return ok;
}

}  // namespace drsplat
