// What a search finds, from the scores of some rows at a time.
#pragma once
#include <vector>

#include "kernels/scan_kernels.h"

namespace drsplat {

using Candidates = std::vector<CandidateRow>;

// Those of `count` rows from `first` on whose score - floor exceeds the threshold; `floor` may be null.
void append_above(const ScanKernels &, const float *scores, const float *floor, float threshold, uint64_t first,
                  uint64_t count, Candidates &out);

Candidates joined(const std::vector<Candidates> &);

// The `count` best rows, ties to the lower; every thread keeps those of the rows that it scored.
class BestRows {
 public:
  BestRows(const ScanKernels &, size_t count, int threads);
  void offer(int thread, const float *scores, uint64_t first, uint64_t rows);
  Candidates best() const;  // best first

 private:
  struct Seen {  // the best `count_` seen, and some more
    Candidates found;
    float cutoff;  // `count_` rows are at least as good
  };

  const ScanKernels &kernels_;
  size_t count_;
  std::vector<Seen> of_thread_;
};

}  // namespace drsplat
