// Images of many channels, and convolutions of their rows.
#pragma once
#include "host/memory.h"
#include "host/parallel.h"
#include "kernels/photo_kernels.h"

#include <algorithm>
#include <cmath>

namespace drsplat {

constexpr uint64_t kRows = 4;                    // that a thread takes at once
constexpr size_t kVector = 16, kRowsAround = 2;  // rows of zeros above and below

inline size_t up_to(size_t n, size_t whole) { return (n + whole - 1) / whole * whole; }

// Rows of channels, with zeros before and behind each, and above and below them. depth: channels in memory.
struct Planes {
  size_t height = 0, width = 0, channels = 0, depth = 0, stride = 0;
  Kept<float> values;
  Planes() = default;
  Planes(size_t h, size_t w, size_t c)
      : height(h),
        width(w),
        channels(c),
        depth(up_to(c, kOutputBlock)),
        stride(up_to(w, kVector) + 2 * kVector),
        values((h + 2 * kRowsAround) * depth * stride, 0.f) {}
  size_t row_step() const { return depth * stride; }
  size_t place(size_t y, size_t c) const { return ((y + kRowsAround) * depth + c) * stride + kVector; }
  float *row(size_t y, size_t c) { return values.data() + place(y, c); }
  const float *row(size_t y, size_t c) const { return values.data() + place(y, c); }
};

template <class Work>
void over(const Planes &planes, int threads, Work work) {
  over_rows(planes.height, kRows, threads, [&](int, uint64_t begin, uint64_t end) {
    for (uint64_t y = begin; y < end; y++) work((size_t)y);
  });
}

// weights: (inputs of the window by row, column and channel) x outputs.
struct PhotoLayer {
  const float *weights, *bias;
  size_t depth, outputs;
};

// A layer's numbers in the order in which the kernel reads them.
struct Packed {
  std::vector<float> weights, bias;
  size_t outputs;
  explicit Packed(const PhotoLayer &layer) : outputs(layer.outputs) {
    const size_t padded = up_to(outputs, kOutputBlock);
    weights.resize(padded * layer.depth), bias.resize(padded);
    std::copy_n(layer.bias, outputs, bias.begin());
    for (size_t k = 0; k < layer.depth; k++)
      for (size_t o = 0; o < outputs; o++)
        weights[(o / kOutputBlock * layer.depth + k) * kOutputBlock + o % kOutputBlock] =
            layer.weights[k * outputs + o];
  }
};

inline ConvolvedRow row_of(const Planes *const *inputs, size_t count, size_t y, const Packed &layer, int taps) {
  ConvolvedRow row{};
  row.taps = taps, row.positive = taps > 1, row.most = INFINITY;
  row.weights = layer.weights.data(), row.bias = layer.bias.data();
  row.blocks = (uint32_t)(layer.bias.size() / kOutputBlock);
  for (size_t i = 0; i < count; i++) {
    const Planes &in = *inputs[i];
    const float *first = in.row(y, 0);
    row.inputs[i] = taps > 1 ? first - in.row_step() - 1 : first;
    row.channels[i] = (uint32_t)in.channels, row.row_steps[i] = in.row_step();
    row.stride = in.stride, row.vectors = (uint32_t)(up_to(in.width, kVector) / kVector);
  }
  return row;
}

// What vectors wrote beyond the last pixel of a row becomes zeros again.
inline void end_row(Planes &out, size_t y) {
  for (size_t c = 0; c < out.depth; c++)
    std::fill(out.row(y, c) + out.width, out.row(y, c) + out.stride - kVector, 0.f);
}

}  // namespace drsplat
