// The search for candidates: the centres and atoms of largest inner product.
#pragma once
#include "kernels/lanes.h"
#include "kernels/mixture_atoms.h"
#include "kernels/mixture_kernels.h"
#include "kernels/ranking.h"

namespace drsplat::DRSPLAT_ISA {

// The centre of largest inner product with each point, ties to the lowest; one point per lane.
constexpr uint32_t kSearchCentres = kParts == 1 ? 8 : 4;  // at once: as many sums as fit the registers

template <int Centres>
static inline void search_centres(const float *points, const float *centres, uint32_t dim, int32_t first, Floats *best,
                                  Ints *index) {
  Floats total[Centres][kRowParts];
  for (int c = 0; c < Centres; c++)
    for (int p = 0; p < kRowParts; p++) total[c][p] = splat(0.f);
  for (uint32_t d = 0; d < dim; d++) {
    Floats numbers[kRowParts];
    for (int p = 0; p < kRowParts; p++) numbers[p] = load(points + 16 * (kRowParts * d + p));
    for (int c = 0; c < Centres; c++)
      for (int p = 0; p < kRowParts; p++) total[c][p] = total[c][p] + centres[(size_t)c * dim + d] * numbers[p];
  }
  for (int c = 0; c < Centres; c++)
    for (int p = 0; p < kRowParts; p++) {
      index[p] = select(best[p] < total[c][p], splat_int(first + c), index[p]);
      best[p] = maximum(best[p], total[c][p]);
    }
}

// `scratch`: kEncodeScratch * dim floats.
static void nearest_centres(const Embeddings &centres, const float *points, uint64_t begin, uint64_t end,
                            float *scratch, int32_t *nearest) {
  const uint32_t dim = centres.dim;
  for (uint64_t first = begin; first < end; first += kLaneRows) {
    const uint64_t left = end - first < kLaneRows ? end - first : kLaneRows;
    rows_as_lanes(points + first * dim, dim, left, dim, scratch);
    Floats best[kRowParts];
    Ints index[kRowParts];
    for (int p = 0; p < kRowParts; p++) best[p] = splat(-__builtin_inff()), index[p] = splat_int(0);
    uint32_t c = 0;
    for (; c + kSearchCentres <= centres.count; c += kSearchCentres)
      search_centres<kSearchCentres>(scratch, centres.values + (size_t)c * dim, dim, (int32_t)c, best, index);
    for (; c < centres.count; c++)
      search_centres<1>(scratch, centres.values + (size_t)c * dim, dim, (int32_t)c, best, index);
    int32_t found[kLaneRows];
    for (int p = 0; p < kRowParts; p++) store_int(found + 16 * p, index[p]);
    memcpy(nearest + first, found, left * sizeof(int32_t));
  }
}

// The `wanted` members of each point's group with the largest inner products, best first. `products`: a number
// per member; `whole`: dim numbers.
static void nearest_members(const Atoms &atoms, const Groups &groups, const float *points, uint64_t begin, uint64_t end,
                            float *products, int16_t *whole, int32_t *nearest) {
  const uint32_t wanted = groups.wanted;
  for (uint64_t row = begin; row < end; row++) {
    const int32_t *members = groups.members + (size_t)groups.of[row] * groups.size;
    int32_t *found = nearest + row * wanted;
    const float step = whole_vector(points + row * atoms.dim, atoms.dim, whole);
    atom_products(atoms, members, groups.size, whole, step, products);
    uint32_t count = 0;
    float best[kMostWanted];
    for (uint32_t j = 0; j < groups.size; j++) {
      if (count == wanted && !(products[j] > best[count - 1])) continue;
      insert_descending(found, best, count < wanted ? count++ : count - 1, members[j], products[j]);
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
