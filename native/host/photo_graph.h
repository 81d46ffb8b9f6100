// What is known of a photo's regions and of the borders between them, as sums of whole numbers.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace drsplat {

constexpr int kTraits = 8, kBins = 12;  // of what the network sees; of each channel's histogram

// The columns of a region's sums, and of a border's: drsplat.kernels.photos says what they are.
enum RegionColumn : int {
  kArea,
  kMean,
  kSquare = kMean + 3,
  kFrame = kSquare + 3,
  kAround,
  kTexture,
  kHistogram,
  kTrait = kHistogram + 3 * kBins,
  kTraitSquare = kTrait + kTraits,
  kRegionColumns
};
enum BorderColumn : int { kLength, kStep, kStepChroma, kSeen, kTraitStep, kBorderColumns };

// Of each pixel: its region, from 0 and below `count`, its colour in steps of CIELAB, how likely another thing is next
// to it, and its traits.
struct SeenPixels {
  const int32_t *labels, *lab, *borders, *traits;
  int32_t height, width, count;
};

// boxes: x0, y0, -x1, -y1. pairs: regions that touch, lower number first, ascending.
struct PhotoGraph {
  std::vector<double> sums, boxes, borders;
  std::vector<int32_t> pairs;
};

PhotoGraph photo_graph(const SeenPixels &);

}  // namespace drsplat
