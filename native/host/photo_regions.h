// A photo's small regions of like colour.
#pragma once
#include "kernels/kernels.h"

#include <vector>

namespace drsplat {

// CIELAB in steps of 1/16, 3 numbers a pixel.
void lab_colors(const Kernels &, const uint8_t *rgb, size_t pixels, int threads, int32_t *lab);

// The number of each pixel's region: from 0 in the order of their first pixels, each in one piece. The fewer neighbours
// differ, the sooner they are merged; of equal ones those side by side first, then above each other, then diagonal
// ones, each by rows. scale: higher, larger regions. least: pixels of a region. Source: Felzenszwalb and Huttenlocher
// 2004, Efficient graph-based image segmentation.
std::vector<int32_t> small_regions(const int32_t *lab, int32_t height, int32_t width, double scale, int32_t least);

// The marker that each pixel is flooded from, along sides of pixels: lowest pixels first, of equal ones those that were
// reached first. markers: numbers from 1 on, 0 for none; pixels that no marker reaches keep 0.
std::vector<int32_t> flooded(const int32_t *heights, const int32_t *markers, int32_t height, int32_t width);

}  // namespace drsplat
