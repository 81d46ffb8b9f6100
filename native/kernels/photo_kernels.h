// What cutting photos into things asks of the kernels: colours, convolutions, and how likely regions belong together.
#pragma once
#include <cstddef>
#include <cstdint>

namespace drsplat {

constexpr uint32_t kOutputBlock = 4;  // outputs whose weights lie side by side
constexpr double kLabSteps = 16;      // of one unit of CIELAB

// A row of a convolution. Rows hold channel after channel, `stride` floats each, and end in zeros; inputs[i] is where
// the window of pixel 0 begins. weights: for each block of outputs, by row, column and channel of the window.
struct ConvolvedRow {
  const float *inputs[2];
  uint32_t channels[2];
  size_t row_steps[2];  // floats from a row to the next
  size_t stride;
  int taps;  // rows and columns of the window
  const float *weights, *bias;
  uint32_t blocks, vectors;  // of outputs, of 16 pixels
  bool positive;             // what is below 0 becomes 0, and what is above `most` becomes that
  float most;
  float *out;
};

// A row of each channel's own 3x3 convolution, bounded by 0 and 6. in: channel after channel, where the middle of the
// window of pixel 0 lies; weights: by row and column of the window, then channel. across, down: floats from a tap to
// the next.
struct DepthwiseRow {
  const float *in, *weights, *bias;
  size_t across, down;
  size_t stride;  // floats from a channel to the next
  uint32_t channels, vectors;
  float *out;
};

// How likely two regions belong together: a network of one hidden layer, whose units are padded to a multiple of 8.
struct PairRule {
  const double *center, *width, *hidden, *hidden_bias, *output;
  double output_bias;
  uint32_t features, units;
};

struct PhotoKernels {
  // linear: the 256 intensities of sRGB. lab: in kLabSteps.
  void (*lab_colors)(const uint8_t *rgb, size_t begin, size_t end, const double *linear, int32_t *lab);
  void (*convolve_row)(const ConvolvedRow &);
  void (*depthwise_row)(const DepthwiseRow &);
  void (*pair_likelihoods)(const PairRule &, const double *features, size_t pairs, double *likelihoods);
};

}  // namespace drsplat
