// The mixture code as the bindings call it: all rows, on several threads.
#pragma once
#include "host/candidates.h"
#include "kernels/mixture_kernels.h"

namespace drsplat {

void mixture_encode(const Kernels &, const Atoms &, const MixtureSource &, uint64_t rows, int threads,
                    const MixtureRows &out);

void nearest_centres(const Kernels &, const Embeddings &centres, const float *points, uint64_t rows, int threads,
                     int32_t *nearest);

// Every row of `members` is to name existing atoms, and every entry of `of` a row of `members`.
void nearest_members(const Kernels &, const Atoms &, const Groups &, const float *points, uint64_t rows, int threads,
                     int32_t *nearest);

struct MixtureCode {
  Mixtures mixtures;
  uint64_t rows;
  Atoms atoms;
};

struct MixtureQueries {  // count x dim of the atoms, finite
  const float *values;
  uint32_t count;
};

// scores: queries x rows
void mixture_scores(const Kernels &, const MixtureCode &, const MixtureQueries &, int threads, float *scores);

// Rows with score - floor > threshold, ascending. floor: one per row, or null.
Found mixture_select(const Kernels &, const MixtureCode &, const float *query, float threshold, const float *floor,
                     int threads);

// The `count` best rows, best first, ties to the lower row.
Found mixture_top(const Kernels &, const MixtureCode &, const float *query, uint64_t count, int threads);

struct MixtureBest {  // one per row
  int32_t *index;
  float *scores, *runner_up;
};

void mixture_best(const Kernels &, const MixtureCode &, const MixtureQueries &, int threads, const MixtureBest &out);

}  // namespace drsplat
