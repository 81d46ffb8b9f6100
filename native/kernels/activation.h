// From the parameters that are trained to what projection needs.
#pragma once
#include "kernels/projection.h"

namespace drsplat::DRSPLAT_ISA {

// Unit quaternions wxyz, with 1 / norm of the raw ones.
INLINE Floats unit_quaternions(const Floats *raw, Floats *unit) {
  const Floats norm2 = raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] + raw[3] * raw[3];
  const Floats inverse = splat(1.f) / square_root(maximum(norm2, splat(1e-30f)));
  for (int i = 0; i < 4; i++) unit[i] = raw[i] * inverse;
  return inverse;
}

INLINE void rotations_of(const Floats *q, Floats *R) {  // q unit; R row by row
  const Floats w = q[0], x = q[1], y = q[2], z = q[3], one = splat(1.f);
  R[0] = one - 2.f * (y * y + z * z), R[1] = 2.f * (x * y - w * z), R[2] = 2.f * (x * z + w * y);
  R[3] = 2.f * (x * y + w * z), R[4] = one - 2.f * (x * x + z * z), R[5] = 2.f * (y * z - w * x);
  R[6] = 2.f * (x * z - w * y), R[7] = 2.f * (y * z + w * x), R[8] = one - 2.f * (x * x + y * y);
}

// exp of 16 numbers; beyond +-80 it stays finite.
INLINE Floats exp_of(Floats x) { return exp2_of(clamp(x * splat(kLog2E), -115.f, 115.f)); }

INLINE Floats sigmoid_of(Floats x) { return splat(1.f) / (splat(1.f) + exp_of(-x)); }

// means (3, N), covariances (6, N), opacities (N), as Scene has them.
static void activate(const Parameters &p, uint32_t begin, uint32_t end, float *means, float *covariances,
                     float *opacities) {
  const size_t N = p.count;
  for (uint32_t at = begin; at < end; at += 16) {
    const int n = end - at < 16 ? (int)(end - at) : 16;
    float raw[11][16];
    for (int l = 0; l < 16; l++) {
      const size_t row = at + (uint32_t)(l < n ? l : 0);
      for (int a = 0; a < 3; a++) raw[a][l] = p.means[3 * row + a], raw[3 + a][l] = p.log_scales[3 * row + a];
      for (int a = 0; a < 4; a++) raw[6 + a][l] = p.quats[4 * row + a];
      raw[10][l] = p.logits[row];
    }
    const Floats quats[4] = {load(raw[6]), load(raw[7]), load(raw[8]), load(raw[9])};
    Floats q[4], R[9], out[10];
    unit_quaternions(quats, q), rotations_of(q, R);
    for (int a = 0; a < 3; a++) {
      const Floats scale = exp_of(load(raw[3 + a]));
      for (int r = 0; r < 3; r++) R[3 * r + a] = R[3 * r + a] * scale;
      out[a] = load(raw[a]);
    }
    for (int r = 0, i = 3; r < 3; r++)
      for (int c = r; c < 3; c++, i++)
        out[i] = R[3 * r] * R[3 * c] + R[3 * r + 1] * R[3 * c + 1] + R[3 * r + 2] * R[3 * c + 2];
    out[9] = sigmoid_of(load(raw[10]));
    for (int i = 0; i < 10; i++) {
      float *to = i < 3 ? means + i * N : i < 9 ? covariances + (i - 3) * N : opacities;
      if (n == 16) store(to + at, out[i]);
      else
        for (int l = 0; l < n; l++) to[at + (uint32_t)l] = lane(out[i], l);
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
