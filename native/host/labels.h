// What pixels show: of labelled Gaussians, the label with the most weight.
#pragma once
#include <cstddef>
#include <cstdint>

namespace drsplat {

constexpr size_t kHeaviest = 8;  // Gaussians of a pixel

// ids, weights: kHeaviest for each pixel; an id below 0 is none, and has the label -1. Weights of a label are added
// pair by pair; of equal sums the first wins. False if an id names no Gaussian.
bool heaviest_labels(const int32_t *ids, const float *weights, size_t pixels, const int32_t *labels, size_t gaussians,
                     int threads, int32_t *found);

}  // namespace drsplat
