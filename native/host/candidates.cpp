#include "host/candidates.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace drsplat {
namespace {

constexpr float kLowest = -std::numeric_limits<float>::infinity();

// Leaves the `count` best, the last of them at the end.
void shrink(std::vector<Ranked> &rows, size_t count) {
  if (rows.size() <= count) return;
  std::nth_element(rows.begin(), rows.begin() + (ptrdiff_t)(count - 1), rows.end());
  rows.resize(count);
}

}  // namespace

void add_above(const ScanKernels &kernels, const float *scores, const float *floor, float threshold, uint64_t first,
               uint32_t count, Found &out) {
  uint32_t above[kRowsAtOnce + 16];
  const size_t old = out.rows.size(), found = kernels.above(scores, floor, threshold, count, above);
  out.rows.resize(old + found), out.scores.resize(old + found);
  for (size_t i = 0; i < found; i++)
    out.rows[old + i] = (int64_t)(first + above[i]), out.scores[old + i] = scores[above[i]];
}

Found joined(const std::vector<Found> &parts) {
  size_t total = 0;
  for (const Found &part : parts) total += part.rows.size();
  Found all;
  all.rows.reserve(total), all.scores.reserve(total);
  for (const Found &part : parts) {
    all.rows.insert(all.rows.end(), part.rows.begin(), part.rows.end());
    all.scores.insert(all.scores.end(), part.scores.begin(), part.scores.end());
  }
  return all;
}

BestRows::BestRows(const ScanKernels &kernels, size_t count, int threads)
    : kernels_(kernels), count_(count), of_thread_(threads, {{}, kLowest}) {}

void BestRows::offer(int thread, const float *scores, uint64_t first, uint32_t count) {
  Seen &seen = of_thread_[thread];
  uint32_t above[kRowsAtOnce + 16];
  const uint32_t found = kernels_.above(scores, nullptr, std::nextafter(seen.cutoff, kLowest), count, above);
  for (uint32_t i = 0; i < found; i++) seen.rows.push_back({scores[above[i]], (int64_t)(first + above[i])});
  if (seen.rows.size() < 2 * count_ + 1024) return;
  shrink(seen.rows, count_);
  seen.cutoff = seen.rows.back().score;
}

Found BestRows::best() && {
  std::vector<Ranked> all = std::move(of_thread_[0].rows);
  for (size_t t = 1; t < of_thread_.size(); t++)
    all.insert(all.end(), of_thread_[t].rows.begin(), of_thread_[t].rows.end());
  shrink(all, count_);
  std::sort(all.begin(), all.end());
  Found best;
  best.rows.reserve(all.size()), best.scores.reserve(all.size());
  for (const Ranked &one : all) best.rows.push_back(one.row), best.scores.push_back(one.score);
  return best;
}

}  // namespace drsplat
