// A row of a convolution, 16 pixels a vector: each number is summed in the order of rows, columns and channels.
#pragma once
#include "kernels/lanes.h"
#include "kernels/photo_kernels.h"

namespace drsplat::DRSPLAT_ISA {

// As many sums as stay in registers.
constexpr int kTileOutputs = kParts > 2 ? 2 : 4, kTileVectors = kParts > 1 ? 1 : 4;
static_assert(kOutputBlock % kTileOutputs == 0, "blocks are whole tiles");

template <int Vectors>
static inline void convolve_tile(const ConvolvedRow &row, const float *weights, const float *bias, size_t x,
                                 float *out) {
  Floats total[kTileOutputs][Vectors];
  for (int o = 0; o < kTileOutputs; o++)
    for (int v = 0; v < Vectors; v++) total[o][v] = splat(0.f);
  for (int tap = 0; tap < row.taps * row.taps; tap++)
    for (int i = 0; i < 2; i++) {
      const float *in = row.inputs[i] + (size_t)(tap / row.taps) * row.row_steps[i] + (size_t)(tap % row.taps) + x;
      for (uint32_t c = 0; c < row.channels[i]; c++, in += row.stride, weights += kOutputBlock) {
        Floats seen[Vectors];
        for (int v = 0; v < Vectors; v++) seen[v] = load(in + 16 * v);
        for (int o = 0; o < kTileOutputs; o++)
          for (int v = 0; v < Vectors; v++) total[o][v] = total[o][v] + splat(weights[o]) * seen[v];
      }
    }
  for (int o = 0; o < kTileOutputs; o++)
    for (int v = 0; v < Vectors; v++) {
      const Floats sum = total[o][v] + splat(bias[o]);
      store(out + (size_t)o * row.stride + x + 16 * v,
            row.positive ? minimum(maximum(sum, splat(0.f)), splat(row.most)) : sum);
    }
}

static void convolve_row(const ConvolvedRow &row) {
  const size_t depth = (size_t)(row.taps * row.taps) * (row.channels[0] + row.channels[1]);
  const uint32_t tiles = (row.vectors + kTileVectors - 1) / kTileVectors;
  for (uint32_t t = 0; t < tiles; t++) {  // of nearly equal width
    const uint32_t begin = row.vectors * t / tiles, count = row.vectors * (t + 1) / tiles - begin;
    for (uint32_t o = 0; o < row.blocks * kOutputBlock; o += kTileOutputs) {
      const float *weights = row.weights + o / kOutputBlock * kOutputBlock * depth + o % kOutputBlock;
      float *out = row.out + o * row.stride;
      if (count == 4) convolve_tile<4>(row, weights, row.bias + o, 16 * begin, out);
      else if (count == 3) convolve_tile<3>(row, weights, row.bias + o, 16 * begin, out);
      else if (count == 2) convolve_tile<2>(row, weights, row.bias + o, 16 * begin, out);
      else convolve_tile<1>(row, weights, row.bias + o, 16 * begin, out);
    }
  }
}

static void depthwise_row(const DepthwiseRow &row) {
  for (uint32_t c = 0; c < row.channels; c++) {
    const float *in = row.in + c * row.stride - row.down - row.across;
    for (size_t x = 0; x < 16 * (size_t)row.vectors; x += 16) {
      Floats sum = splat(row.bias[c]);
      for (int tap = 0; tap < 9; tap++)
        sum = sum + splat(row.weights[(size_t)tap * row.channels + c]) *
                        load(in + (size_t)(tap / 3) * row.down + (size_t)(tap % 3) * row.across + x);
      store(row.out + c * row.stride + x, minimum(maximum(sum, splat(0.f)), splat(6.f)));
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
