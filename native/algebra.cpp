// The algebra of algebra.h on several threads. Every output row is made by one thread, whichever, so
// the result is the same to the bit for any number of them.
#include "row_algebra.h"

#include "parallel.h"

#include <algorithm>
#include <atomic>

namespace drsplat {
namespace {

// work(begin, end) over blocks of rows, handed out as threads become free.
template <class Work>
void over_rows(uint64_t rows, uint64_t block, int threads, Work work) {
  std::atomic<uint64_t> next{0};
  const uint64_t blocks = (rows + block - 1) / block;
  parallel((int)std::max<uint64_t>(1, std::min<uint64_t>(threads, blocks)), [&](int) {
    for (uint64_t i; (i = next.fetch_add(1)) < blocks;) work(i * block, std::min(rows, (i + 1) * block));
  });
}

}  // namespace

bool weighted_rows(const Kernels &kernels, const SparseRows &weights, const Embeddings &embeddings, uint64_t rows, int threads, float *out) {
  std::atomic<bool> ok{true};
  over_rows(rows, 64, threads, [&](uint64_t begin, uint64_t end) {
    if (!kernels.weighted_rows(weights, embeddings, begin, end, out)) ok = false;
  });
  return ok;
}

void pq_encode(const Kernels &kernels, const Quantizer &quantizer, const float *features, uint64_t rows, int threads, uint8_t *codes) {
  over_rows(rows, 512, threads, [&](uint64_t begin, uint64_t end) {
    std::vector<float> scratch(kEncodeScratch * quantizer.dim);
    kernels.pq_encode(quantizer, features, begin, end, scratch.data(), codes);
  });
}

void pq_scores(const Kernels &kernels, const Scan &scan, uint64_t rows, int threads, float *scores) {
  over_rows(rows, 16384, threads, [&](uint64_t begin, uint64_t end) { kernels.pq_scores(scan, begin, end, scores); });
}

}  // namespace drsplat
