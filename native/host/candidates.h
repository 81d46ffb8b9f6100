// What a search finds, from the scores of some rows at a time.
#pragma once
#include <vector>

#include "kernels/scan_kernels.h"

namespace drsplat {

// Rows to look through at once, at most: their scores stay in the first-level cache.
constexpr uint32_t kRowsAtOnce = 4096;

struct Found {
  std::vector<int64_t> rows;
  std::vector<float> scores;
};

// Adds those of `count` rows from `first` on whose score - floor exceeds the threshold; `floor` may be null.
void add_above(const ScanKernels &, const float *scores, const float *floor, float threshold, uint64_t first,
               uint32_t count, Found &out);

Found joined(const std::vector<Found> &);

struct Ranked {
  float score;
  int64_t row;
  bool operator<(const Ranked &o) const { return score > o.score || (score == o.score && row < o.row); }  // comes first
};

// The `count` best rows, ties to the lower; every thread keeps those of the rows that it scored.
class BestRows {
 public:
  BestRows(const ScanKernels &, size_t count, int threads);
  void offer(int thread, const float *scores, uint64_t first, uint32_t count);
  Found best() &&;  // best first

 private:
  struct Seen {
    std::vector<Ranked> rows;  // the best, and some more
    float cutoff;              // that many of them reach
  };

  const ScanKernels &kernels_;
  size_t count_;
  std::vector<Seen> of_thread_;
};

}  // namespace drsplat
