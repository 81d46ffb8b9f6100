// Sorting of many rows by whole numbers, to the same order for any number of threads.
#pragma once
#include "host/parallel.h"
#include "host/workspace.h"

namespace drsplat {

// One stable counting-sort pass over the first `count` rows by `bits` bits, which `digit` returns; thread histograms
// keep it stable. `other` is as long, and ends as what `rows` was.
template <class Row, class Digit>
void radix_pass(Workspace &w, Kept<Row> &rows, Kept<Row> &other, uint32_t count, int bits, int threads, Digit digit) {
  const uint32_t buckets = 1u << bits;
  over_parts(count, threads, [&](int t, uint32_t begin, uint32_t end) {
    auto &counts = w.workers[t]->digit_counts;
    counts.assign(buckets, 0);
    for (uint32_t i = begin; i < end; i++) counts[digit(rows[i])]++;
  });
  uint32_t sum = 0;
  for (uint32_t b = 0; b < buckets; b++)
    for (int t = 0; t < threads; t++) {
      uint32_t &c = w.workers[t]->digit_counts[b], n = c;
      c = sum, sum += n;
    }
  over_parts(count, threads, [&](int t, uint32_t begin, uint32_t end) {
    auto &next = w.workers[t]->digit_counts;
    for (uint32_t i = begin; i < end; i++) other[next[digit(rows[i])]++] = rows[i];
  });
  rows.swap(other);
}

}  // namespace drsplat
