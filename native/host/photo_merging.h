// A photo's regions become things: the likeliest pair is merged first.
#pragma once
#include "host/photo_graph.h"
#include "kernels/kernels.h"

namespace drsplat {

struct PairRule;

constexpr uint32_t kPairFeatures = 42;

// As photo_graph has it. pixels: of the photo.
struct GivenGraph {
  const double *sums, *boxes, *borders;
  const int32_t *pairs;
  size_t regions, edges;
  double pixels;
};

// threshold: of likelihoods, above which pairs are merged. Regions of fewer pixels than least_area, or narrower than
// least_width as a strip of their area and border, go to their likeliest neighbour.
struct MergeLimits { double threshold, least_area, least_width; };

// The thing of each region, from 0 in the order of the lowest region of each.
std::vector<int32_t> merged_regions(const Kernels &, const GivenGraph &, const PairRule &, const MergeLimits &);

// Which two become one, likeliest first, until no two touch: the numbers of both, where the first union has the number
// after those of the regions.
std::vector<int32_t> merge_order(const Kernels &, const GivenGraph &, const PairRule &);

// How likely the two regions of each pair belong to one thing.
std::vector<double> pair_likelihoods(const Kernels &, const GivenGraph &, const PairRule &);

}  // namespace drsplat
