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

// Rows [begin, end).
static void keep_best(const Contest &c, uint64_t begin, uint64_t end) {
  BestOf16 best;
  memset(&best, 0, sizeof best);
  for (uint64_t row = begin; row < end; row += 16) {
    const uint64_t rows = end - row < 16 ? end - row : 16;
    float *scores = c.scores + row * c.kept;
    uint16_t *names = c.names + row * c.kept;
    for (uint64_t l = 0; l < rows; l++)
      for (uint32_t k = 0; k < c.kept; k++)
        best.scores[k][l] = scores[l * c.kept + k], best.names[k][l] = names[l * c.kept + k];
    for (uint32_t i = 0; i < c.count; i++) {
      alignas(64) float found[16] = {};
      memcpy(found, c.found + i * c.rows + row, rows * sizeof(float));
      insert_16(best, c.kept, load(found), splat_int((int32_t)(c.first + i)));
    }
    for (uint64_t l = 0; l < rows; l++)
      for (uint32_t k = 0; k < c.kept; k++)
        scores[l * c.kept + k] = best.scores[k][l], names[l * c.kept + k] = (uint16_t)best.names[k][l];
  }
}

}  // namespace drsplat::DRSPLAT_ISA
