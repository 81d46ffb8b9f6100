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

// The `wanted` of a group's members with the largest products, best first; of equal ones the earlier member.
static void best_members(const int32_t *members, const float *products, const Groups &groups, int32_t *nearest) {
  uint32_t count = 0;
  float best[kMostWanted];
  for (uint32_t j = 0; j < groups.size; j++) {
    if (count == groups.wanted && !(products[j] > best[count - 1])) continue;
    insert_descending(nearest, best, count < groups.wanted ? count++ : count - 1, members[j], products[j]);
  }
}

constexpr uint32_t kPointsAtOnce = kParts == 1 ? 4 : 2;  // as many as leave all sums in registers
static_assert(kPointsAtOnce <= kMostAtOnce, "scratch holds every point");

// Points that follow each other in one group share what is read of its members.
template <int Points>
static void nearest_of_group(const Atoms &atoms, const Groups &groups, const float *points, uint64_t row,
                             float *products, int16_t *whole, int32_t *nearest) {
  const int32_t *members = groups.members + (size_t)groups.of[row] * groups.size;
  float steps[Points];
  for (int v = 0; v < Points; v++)
    steps[v] = whole_vector(points + (row + v) * atoms.dim, atoms.dim, whole + (size_t)v * atoms.dim);
  atom_products<Points>(atoms, members, groups.size, whole, steps, products);
  for (int v = 0; v < Points; v++)
    best_members(members, products + (size_t)v * groups.size, groups, nearest + (row + v) * groups.wanted);
}

// The `wanted` members of each point's group with the largest inner products, best first. `products`: as many numbers
// per member as points are taken at once; `whole`: dim numbers for each of these.
static void nearest_members(const Atoms &atoms, const Groups &groups, const float *points, uint64_t begin, uint64_t end,
                            float *products, int16_t *whole, int32_t *nearest) {
  for (uint64_t row = begin; row < end;) {
    uint64_t same = row + 1;
    while (same < end && same < row + kPointsAtOnce && groups.of[same] == groups.of[row]) same++;
    if (same - row == kPointsAtOnce) {
      nearest_of_group<kPointsAtOnce>(atoms, groups, points, row, products, whole, nearest);
      row = same;
    } else {
      nearest_of_group<1>(atoms, groups, points, row++, products, whole, nearest);
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
