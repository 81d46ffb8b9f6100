// sRGB to CIELAB in whole steps.
#pragma once
#include "kernels/isa.h"
#include "kernels/photo_kernels.h"

namespace drsplat::DRSPLAT_ISA {

// Of numbers in [0.008, 2]: x times the square of 1 / cbrt(x), which needs no division, from a first guess by the bits.
INLINE double cube_root(double x) {
  const float single = (float)x;
  int32_t bits;
  float guess;
  memcpy(&bits, &single, 4);
  bits = 0x54a2fa8c - bits / 3;
  memcpy(&guess, &bits, 4);
  double inverse = guess;
  for (int i = 0; i < 4; i++) inverse *= (4 - x * inverse * inverse * inverse) * (1.0 / 3);
  return x * inverse * inverse;
}

INLINE double lightness_of(double x) {
  const double root = cube_root(x > 0.008 ? x : 0.008);
  return x > 0.008856 ? root : 7.787 * x + 16.0 / 116;
}

static void lab_colors(const uint8_t *rgb, size_t begin, size_t end, const double *linear, int32_t *lab) {
  constexpr size_t kBlock = 64;
  constexpr double kShift = 0x1.8p52;  // plus this, minus this: rounded to whole numbers
  for (size_t start = begin; start < end; start += kBlock) {
    const size_t count = end - start < kBlock ? end - start : kBlock;
    double x[kBlock] = {}, y[kBlock] = {}, z[kBlock] = {};
    for (size_t i = 0; i < count; i++) {
      const uint8_t *color = rgb + 3 * (start + i);
      const double r = linear[color[0]], g = linear[color[1]], b = linear[color[2]];
      x[i] = (0.412453 * r + 0.357580 * g + 0.180423 * b) / 0.95047;
      y[i] = 0.212671 * r + 0.715160 * g + 0.072169 * b;
      z[i] = (0.019334 * r + 0.119193 * g + 0.950227 * b) / 1.08883;
    }
    for (size_t i = 0; i < kBlock; i++) x[i] = lightness_of(x[i]), y[i] = lightness_of(y[i]), z[i] = lightness_of(z[i]);
    for (size_t i = 0; i < count; i++) {
      int32_t *out = lab + 3 * (start + i);
      out[0] = (int32_t)((116 * y[i] - 16) * kLabSteps + kShift - kShift);
      out[1] = (int32_t)(500 * (x[i] - y[i]) * kLabSteps + kShift - kShift);
      out[2] = (int32_t)(200 * (y[i] - z[i]) * kLabSteps + kShift - kShift);
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
