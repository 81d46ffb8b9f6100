// Every output row is made by one thread, whichever: the same bits for any number of them.
#include "host/algebra.h"

#include "host/parallel.h"

#include <atomic>

namespace drsplat {

bool weighted_rows(const Kernels &kernels, const SparseRows &weights, const Embeddings &embeddings, uint64_t rows,
                   int threads, float *out) {
  std::atomic<bool> ok{true};
  over_rows(rows, 64, threads, [&](int, uint64_t begin, uint64_t end) {
    if (!kernels.weighted_rows(weights, embeddings, begin, end, out)) ok = false;
  });
  return ok;
}

void pq_encode(const Kernels &kernels, const Quantizer &quantizer, const float *features, uint64_t rows, int threads,
               uint8_t *codes) {
  over_rows(rows, 512, threads, [&](int, uint64_t begin, uint64_t end) {
    std::vector<float> scratch(kEncodeScratch * quantizer.dim);
    kernels.pq_encode(quantizer, features, begin, end, scratch.data(), codes);
  });
}

}  // namespace drsplat
