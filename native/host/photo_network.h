// What a small network sees in a photo: a U-Net of convolutions at a half, a quarter ... of the size, and back.
#pragma once
#include "host/planes.h"
#include "kernels/kernels.h"

#include <vector>

namespace drsplat {

// In order: stem; two of each level down; two of each level up, from the second smallest; head, whose outputs are four
// for each channel: the pixels of a 2x2 block by rows.
struct PhotoNetwork {
  std::vector<PhotoLayer> layers;
  int levels;
};

// Whether the layers fit together, and how they are to be seen: 0 to 255 for each pixel's border, kTraits traits.
bool fits(const PhotoNetwork &);

// borders: 0 to 255. traits: kTraits a pixel, in steps. The same bits for any number of threads.
void look(const Kernels &, const PhotoNetwork &, const uint8_t *rgb, int32_t height, int32_t width, int threads,
          int32_t *borders, int32_t *traits);

}  // namespace drsplat
