#include "host/photo_network.h"

#include "host/photo_graph.h"
#include "kernels/photo_kernels.h"

#include <cmath>

namespace drsplat {
namespace {

constexpr float kTraitSteps = 32, kBorderSteps = 255, kMost = 127 * kTraitSteps;

struct Looking {
  const Kernels &kernels;
  const PhotoNetwork &network;
  int threads;
  size_t next = 0;  // layer

  // A 3x3 convolution of one or two images of one size and ReLU.
  Planes convolved(std::initializer_list<const Planes *> inputs) {
    const Packed layer(network.layers[next++]);
    const Planes &first = **inputs.begin();
    Planes out(first.height, first.width, layer.outputs);
    over(out, threads, [&](size_t y) {
      ConvolvedRow row = row_of(inputs.begin(), inputs.size(), y, layer, 3);
      row.out = out.row(y, 0);
      kernels.photo->convolve_row(row);
      end_row(out, y);
    });
    return out;
  }

  Planes block(std::initializer_list<const Planes *> inputs) {
    const Planes first = convolved(inputs);
    return convolved({&first});
  }

  // The largest of each 2x2 block.
  Planes pooled(const Planes &in) const {
    Planes out(in.height / 2, in.width / 2, in.channels);
    over(out, threads, [&](size_t y) {
      for (size_t c = 0; c < out.channels; c++) {
        const float *above = in.row(2 * y, c), *below = in.row(2 * y + 1, c);
        float *to = out.row(y, c);
        for (size_t x = 0; x < out.width; x++)
          to[x] = std::max(std::max(above[2 * x], above[2 * x + 1]), std::max(below[2 * x], below[2 * x + 1]));
      }
    });
    return out;
  }

  Planes enlarged(const Planes &in) const {
    Planes out(2 * in.height, 2 * in.width, in.channels);
    over(out, threads, [&](size_t y) {
      for (size_t c = 0; c < out.channels; c++) {
        const float *from = in.row(y / 2, c);
        float *to = out.row(y, c);
        for (size_t x = 0; x < in.width; x++) to[2 * x] = to[2 * x + 1] = from[x];
      }
    });
    return out;
  }

  Planes all_levels(const Planes &blocks) {
    std::vector<Planes> seen;
    Planes x = convolved({&blocks});
    for (int level = 0; level < network.levels; level++) {
      if (level) x = pooled(seen.back());
      seen.push_back(block({&x}));
    }
    x = std::move(seen.back());
    for (int level = network.levels - 2; level >= 0; level--) {
      const Planes large = enlarged(x);
      x = block({&seen[(size_t)level], &large});
    }
    return x;
  }
};

// The four pixels of each 2x2 block as channels, from -1 to 1; beyond the photo, its last row and column.
Planes blocks_of(const uint8_t *rgb, int32_t height, int32_t width, int levels) {
  const size_t step = (size_t)1 << levels;
  Planes out(up_to((size_t)height, step) / 2, up_to((size_t)width, step) / 2, 12);
  for (size_t y = 0; y < 2 * out.height; y++)
    for (size_t x = 0; x < 2 * out.width; x++) {
      const size_t row = std::min(y, (size_t)height - 1), column = std::min(x, (size_t)width - 1);
      const uint8_t *color = rgb + 3 * (row * (size_t)width + column);
      for (size_t c = 0; c < 3; c++) out.row(y / 2, 4 * c + y % 2 * 2 + x % 2)[x / 2] = color[c] / 127.5f - 1;
    }
  return out;
}

int32_t border_of(float logit) {
  const double steps = kBorderSteps / (1 + std::exp(-(double)logit));
  return steps > 0 ? (int32_t)std::nearbyint(steps) : 0;  // no number, of weights that are none, is no border
}

int32_t trait_of(float value) {
  const float steps = value * kTraitSteps;
  return (int32_t)std::nearbyint(steps > kMost ? kMost : steps > -kMost ? steps : -kMost);
}

}  // namespace

bool fits(const PhotoNetwork &network) {
  const auto levels = (size_t)network.levels;
  if (levels < 1 || levels > 10 || network.layers.size() != 4 * levels) return false;
  std::vector<size_t> seen;
  size_t channels = 12, next = 0;
  const auto passes = [&](size_t inputs, size_t taps) {
    const PhotoLayer &layer = network.layers[next++];
    channels = layer.outputs;
    return layer.depth == taps * inputs && channels > 0 && channels < 4096;
  };
  if (!passes(channels, 9)) return false;
  for (size_t level = 0; level < levels; level++) {
    if (!passes(channels, 9) || !passes(channels, 9)) return false;
    seen.push_back(channels);
  }
  for (size_t level = levels - 1; level-- > 0;)
    if (!passes(seen[level] + channels, 9) || !passes(channels, 9)) return false;
  return passes(channels, 1) && channels == 4 * (1 + kTraits);
}

void look(const Kernels &kernels, const PhotoNetwork &network, const uint8_t *rgb, int32_t height, int32_t width,
          int threads, int32_t *borders, int32_t *traits) {
  Looking looking{kernels, network, threads};
  const Planes last = looking.all_levels(blocks_of(rgb, height, width, network.levels));
  const Packed head(network.layers.back());
  over_rows(last.height, kRows, threads, [&](int, uint64_t begin, uint64_t end) {
    Planes out(1, last.width, head.outputs);
    for (uint64_t y = begin; y < end; y++) {
      const Planes *input = &last;
      ConvolvedRow row = row_of(&input, 1, (size_t)y, head, 1);
      row.out = out.row(0, 0);
      kernels.photo->convolve_row(row);
      for (size_t pixel_y = 2 * y; pixel_y < std::min<size_t>(2 * y + 2, (size_t)height); pixel_y++)
        for (size_t x = 0; x < (size_t)width; x++) {
          const size_t part = pixel_y % 2 * 2 + x % 2, pixel = pixel_y * (size_t)width + x;
          borders[pixel] = border_of(out.row(0, part)[x / 2]);
          for (size_t t = 0; t < kTraits; t++)
            traits[kTraits * pixel + t] = trait_of(out.row(0, 4 * (1 + t) + part)[x / 2]);
        }
    }
  });
}

}  // namespace drsplat
