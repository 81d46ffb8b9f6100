#include "host/candidates.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace drsplat {
namespace {

constexpr float kLowest = -std::numeric_limits<float>::infinity();

bool before(const CandidateRow &a, const CandidateRow &b) {
  return a.score > b.score || (a.score == b.score && a.row < b.row);
}

// Leaves the `count` best, the last of them at the end.
void shrink(Candidates &found, size_t count) {
  if (found.size() <= count) return;
  std::nth_element(found.begin(), found.begin() + (ptrdiff_t)(count - 1), found.end(), before);
  found.resize(count);
}

}  // namespace

void append_above(const ScanKernels &kernels, const float *scores, const float *floor, float threshold, uint64_t first,
                  uint64_t count, Candidates &out) {
  CandidateRow found[kPairRows + 1];
  for (uint64_t at = 0; at < count; at += kPairRows) {
    const uint32_t rows = (uint32_t)std::min<uint64_t>(kPairRows, count - at);
    out.insert(out.end(), found,
               found + kernels.above(scores + at, floor ? floor + at : nullptr, threshold, first + at, rows, found));
  }
}

Candidates joined(const std::vector<Candidates> &parts) {
  size_t total = 0;
  for (const Candidates &part : parts) total += part.size();
  Candidates all;
  all.reserve(total);
  for (const Candidates &part : parts) all.insert(all.end(), part.begin(), part.end());
  return all;
}

BestRows::BestRows(const ScanKernels &kernels, size_t count, int threads)
    : kernels_(kernels), count_(count), of_thread_(threads, {{}, kLowest}) {}

void BestRows::offer(int thread, const float *scores, uint64_t first, uint64_t rows) {
  Seen &seen = of_thread_[thread];
  append_above(kernels_, scores, nullptr, std::nextafter(seen.cutoff, kLowest), first, rows, seen.found);
  if (seen.found.size() < 2 * count_ + 1024) return;
  shrink(seen.found, count_);
  seen.cutoff = seen.found.back().score;
}

Candidates BestRows::best() const {
  Candidates all;
  for (const Seen &seen : of_thread_) all.insert(all.end(), seen.found.begin(), seen.found.end());
  shrink(all, count_);
  std::sort(all.begin(), all.end(), before);
  return all;
}

}  // namespace drsplat
