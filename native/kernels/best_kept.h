// The best of many scores of each row, kept while more of them come.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

struct BestOf16 {  // rows side by side
  alignas(64) float scores[kMostKept][16];
  alignas(64) int32_t names[kMostKept][16];
};

// A score goes below those that are as high; what was below it moves down by one, and the last falls out.
static inline void insert_16(BestOf16 &best, uint32_t count, Floats score, Ints name) {
  if (!any(load(best.scores[count - 1]) < score)) return;
  Mask moves = load(best.scores[0]) < score;
  for (uint32_t k = 0; k < count; k++) {
    const Floats old = load(best.scores[k]);
    const Ints old_name = load_int(best.names[k]);
    moves = moves | (old < score);
    store(best.scores[k], select(moves, score, old));
    store_int(best.names[k], select(moves, name, old_name));
    score = select(moves, old, score), name = select(moves, old_name, name);
  }
}

INLINE void keep_16(const Contest &c, uint64_t row, uint64_t rows, BestOf16 &best) {
  for (uint32_t k = 0; k < c.kept; k++) {
    const uint64_t at = k * c.rows + row;
    memcpy(best.scores[k], c.scores + at, rows * sizeof(float));
    for (uint64_t l = 0; l < rows; l++) best.names[k][l] = c.names[at + l];
  }
  for (uint32_t i = 0; i < c.count; i++) {
    alignas(64) float found[16] = {};
    memcpy(found, c.found + i * c.rows + row, rows * sizeof(float));
    insert_16(best, c.kept, load(found), splat_int((int32_t)(c.first + i)));
  }
  for (uint32_t k = 0; k < c.kept; k++) {
    const uint64_t at = k * c.rows + row;
    memcpy(c.scores + at, best.scores[k], rows * sizeof(float));
    for (uint64_t l = 0; l < rows; l++) c.names[at + l] = (uint16_t)best.names[k][l];
  }
}

// Rows [begin, end).
static void keep_best(const Contest &c, uint64_t begin, uint64_t end) {
  BestOf16 best;
  memset(best.scores, 0, c.kept * sizeof best.scores[0]);
  memset(best.names, 0, c.kept * sizeof best.names[0]);
  uint64_t row = begin;
  for (; row + 16 <= end; row += 16) keep_16(c, row, 16, best);
  if (row < end) keep_16(c, row, end - row, best);
}

}  // namespace drsplat::DRSPLAT_ISA
