// Where people are in a photo: MobileNetV2 and the head of DeepLabv3, at a sixteenth of the size.
#pragma once
#include "host/planes.h"
#include "kernels/kernels.h"

#include <vector>

namespace drsplat {

// In order: first convolution; depthwise and narrow layer of the first block; wide, depthwise and narrow layer of each
// of the other 16; of the head each place's own, the one of the mean of all places, both joined, and the classes.
// Weights of a depthwise layer are (window by row and column) x channels.
constexpr size_t kPeopleBlocks = 17, kPeopleLayers = 3 * kPeopleBlocks + 4, kPersonClass = 15;

bool fits_people(const std::vector<PhotoLayer> &);

// likelihoods: 0 to 1 for each pixel. Sides are multiples of 16, and 1 more. The same bits for any number of threads.
void people(const Kernels &, const std::vector<PhotoLayer> &, const uint8_t *rgb, size_t height, size_t width,
            int threads, float *likelihoods);

}  // namespace drsplat
