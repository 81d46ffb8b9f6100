// The mixture code: what its kernels and their callers say to each other.
#pragma once
#include <string.h>

#include "kernels/kernels.h"

namespace drsplat {

// Unit vectors as signed bytes: atom = scale * values.
struct Atoms {
  const int8_t *values;  // count x dim
  const float *scales;
  uint32_t count, dim;
};
constexpr int kMostAtoms = 16;     // of one row
constexpr int kMixtureBlock = 64;  // rows; within a block, the k-th ids of all rows lie together
constexpr uint32_t kMostWanted = 64;
constexpr uint32_t kMostAtOnce = 4;  // points of one group

struct MixtureSource {    // rows to encode, each from the atoms of its columns and `num_further` more
  const float *features;  // rows x dim
  const int64_t *starts;  // one more than there are rows
  const int32_t *columns, *further;
  uint32_t num_further, wanted;
};

struct MixtureRows {  // what they become: rows x wanted
  int32_t *ids;
  uint8_t *weights;
  float *scales;  // one per row
};

struct Groups {                 // of atoms; of[row] is the one to search
  const int32_t *of, *members;  // members: groups x size
  uint32_t size, wanted;
};

// feature = scale * sum of weight * atom
struct Mixtures {
  const uint16_t *ids;     // blocks x per_row x kMixtureBlock
  const uint8_t *weights;  // the same
  const uint16_t *scales;  // half floats, one per row
  uint32_t per_row;
};

// A scale from its half float, which is finite and not negative.
static inline float scale_of(uint16_t half) {
  const uint32_t bits = (uint32_t)half << 13;
  float value;
  memcpy(&value, &bits, sizeof value);
  return value * 0x1p112f;
}

struct WholeQueries {
  const int16_t *values;   // count x dim
  const float *steps;      // table entry = product * atom's scale * step
  const uint32_t *places;  // in a row of the table
  uint32_t count, stride;
};

struct QueryTile {
  const int16_t *table;    // atoms x stride
  uint32_t first, stride;  // number of its first query
};

struct BestSums {  // one per row
  int32_t *best, *second, *index;
};

// Part of Kernels.
struct MixtureKernels {
  void (*encode)(const Atoms &, const MixtureSource &, uint64_t begin, uint64_t end, float *scratch,
                 int32_t *candidates, int16_t *whole, const MixtureRows &);
  void (*nearest_centres)(const Embeddings &, const float *points, uint64_t begin, uint64_t end, float *scratch,
                          int32_t *nearest);
  void (*nearest_members)(const Atoms &, const Groups &, const float *points, uint64_t begin, uint64_t end,
                          float *products, int16_t *whole, int32_t *nearest);
  void (*score_table)(const Atoms &, const WholeQueries &, uint64_t begin, uint64_t end, int16_t *table);
  uint32_t (*table_place)(uint32_t query);
  void (*scores)(const Mixtures &, const int16_t *table, uint64_t begin, uint64_t end, float *scores);
  void (*best)(const Mixtures &, const QueryTile &, uint64_t begin, uint64_t end, const BestSums &);
  uint32_t tile_queries;  // of `best`, at most
};

}  // namespace drsplat
