// View-dependent colour from spherical harmonics, degree 0-3, with the 3DGS sign convention:
// max(0, 0.5 + sum_k c_k Y_k(d)), d the unit direction from the camera to the Gaussian.
#pragma once
#include "kernels/group.h"
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

// Of the basis polynomials; two of the second and of the third degree share one.
constexpr float kSh0 = 0.28209479177387814f, kSh1 = 0.4886025119029199f;
constexpr float kSh4 = 1.0925484305920792f, kSh6 = 0.31539156525252005f, kSh8 = 0.5462742152960396f;
constexpr float kSh9 = 0.5900435899266435f, kSh10 = 2.890611442640554f, kSh11 = 0.4570457994644658f,
                kSh12 = 0.3731763325901154f, kSh14 = 1.445305721320277f;

// F is float, or Floats for sixteen directions at once.
template <class F>
static inline int sh_basis(F x, F y, F z, int coefficients, F *Y) {
  Y[0] = constant<F>(kSh0);
  if (coefficients <= 1) return 1;
  Y[1] = -kSh1 * y, Y[2] = kSh1 * z, Y[3] = -kSh1 * x;
  if (coefficients <= 4) return 4;
  const F xx = x * x, yy = y * y, zz = z * z;
  Y[4] = kSh4 * (x * y);
  Y[5] = -kSh4 * (y * z);
  Y[6] = kSh6 * (2.f * zz - xx - yy);
  Y[7] = -kSh4 * (x * z);
  Y[8] = kSh8 * (xx - yy);
  if (coefficients <= 9) return 9;
  Y[9] = -kSh9 * (y * (3.f * xx - yy));
  Y[10] = kSh10 * (x * y * z);
  Y[11] = -kSh11 * (y * (4.f * zz - xx - yy));
  Y[12] = kSh12 * (z * (2.f * zz - 3.f * xx - 3.f * yy));
  Y[13] = -kSh11 * (x * (4.f * zz - xx - yy));
  Y[14] = kSh14 * (z * (xx - yy));
  Y[15] = -kSh9 * (x * (xx - 3.f * yy));
  return 16;
}

static void sh_colors(const float *sh, int32_t coefficients, const float *means, const float *center, uint32_t begin,
                      uint32_t end, float *colors) {
  for (uint32_t i = begin; i < end; i++) {
    float d[3], Y[16], color[3] = {0.5f, 0.5f, 0.5f};
    for (int a = 0; a < 3; a++) d[a] = means[3 * (size_t)i + a] - center[a];
    const float norm = __builtin_sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]), scale = norm > 0 ? 1.f / norm : 0.f;
    const int n = sh_basis(d[0] * scale, d[1] * scale, d[2] * scale, coefficients, Y);
    const float *row = sh + (size_t)i * coefficients * 3;
    for (int k = 0; k < n; k++)
      for (int c = 0; c < 3; c++) color[c] += Y[k] * row[3 * k + c];
    for (int c = 0; c < 3; c++) colors[3 * (size_t)i + c] = color[c] > 0 ? color[c] : 0.f;
  }
}

struct Directions { Floats x, y, z, inverse_distance; };  // unit, from the camera to sixteen Gaussians

static inline Directions directions_to(const Floats *mean, const float *center) {
  const Floats x = mean[0] - splat(center[0]), y = mean[1] - splat(center[1]), z = mean[2] - splat(center[2]);
  const Floats norm2 = x * x + y * y + z * z,
               inverse = keep(splat(0.f) < norm2, splat(1.f) / square_root(maximum(norm2, splat(1e-30f))));
  return {x * inverse, y * inverse, z * inverse, inverse};
}

constexpr int kMostColors = 48;  // SH coefficients of three channels

INLINE void fetch_colors(const Visible &v, const Parameters &p, int used, uint32_t i) {
  if (i >= v.count) return;
  const float *row = p.sh + v.splats[i].id * (size_t)p.coefficients * 3;
  for (int k = 0; k < 3 * used; k += 16) __builtin_prefetch(row + k);
}

INLINE Floats harmonic_sum(const Floats *Y, const float (*sh)[16], int count, int channel) {
  Floats color = splat(0.5f);
  for (int k = 0; k < count; k++) color = color + Y[k] * load(sh[3 * k + channel]);
  return color;
}

// colors: 3 for each splat, by rank.
static void splat_colors(const Visible &v, const Parameters &p, int32_t active, const float *center, float *colors) {
  for (uint32_t first = 0; first < v.count; first += 16) {
    const Group group(v, first, nullptr);
    float means[3][16], sh[kMostColors][16], out[3][16];
    for (uint32_t l = 0; l < 16; l++) fetch_colors(v, p, active, first + l + kAhead);
    group.gather(p.means, 3, 3, means);
    const Floats mean[3] = {load(means[0]), load(means[1]), load(means[2])};
    const Directions to = directions_to(mean, center);
    Floats Y[16];
    const int n = sh_basis(to.x, to.y, to.z, active, Y);
    group.gather(p.sh, 3 * p.coefficients, 3 * n, sh);
    for (int c = 0; c < 3; c++) store(out[c], maximum(harmonic_sum(Y, sh, n, c), splat(0.f)));
    for (int l = 0; l < group.count; l++)
      for (int c = 0; c < 3; c++) colors[3 * (size_t)v.ranks[first + l] + c] = out[c][l];
  }
}

// sum over k of shade_k * d(basis_k) / d(x, y, z), the basis taken as polynomials.
static inline void add_basis_slopes(const Directions &to, int coefficients, const Floats *s, Floats *out) {
  for (int a = 0; a < 3; a++) out[a] = splat(0.f);
  if (coefficients <= 1) return;
  const Floats x = to.x, y = to.y, z = to.z;
  out[0] = -kSh1 * s[3], out[1] = -kSh1 * s[1], out[2] = kSh1 * s[2];
  if (coefficients <= 4) return;
  const float a = kSh4, b = kSh6, c = kSh8;
  out[0] = out[0] + a * (s[4] * y - s[7] * z) - (2 * b) * (s[6] * x) + (2 * c) * (s[8] * x);
  out[1] = out[1] + a * (s[4] * x - s[5] * z) - (2 * b) * (s[6] * y) - (2 * c) * (s[8] * y);
  out[2] = out[2] - a * (s[5] * y + s[7] * x) + (4 * b) * (s[6] * z);
  if (coefficients <= 9) return;
  const float e = kSh9, f = kSh10, g = kSh11, h = kSh12, i = kSh14;
  const Floats xx = x * x, yy = y * y, zz = z * z, xy = x * y, xz = x * z, yz = y * z;
  out[0] = out[0] - (6 * e) * (s[9] * xy) + f * (s[10] * yz) + (2 * g) * (s[11] * xy) - (6 * h) * (s[12] * xz) -
           g * (s[13] * (4.f * zz - 3.f * xx - yy)) + (2 * i) * (s[14] * xz) - (3 * e) * (s[15] * (xx - yy));
  out[1] = out[1] - (3 * e) * (s[9] * (xx - yy)) + f * (s[10] * xz) - g * (s[11] * (4.f * zz - xx - 3.f * yy)) -
           (6 * h) * (s[12] * yz) + (2 * g) * (s[13] * xy) - (2 * i) * (s[14] * yz) + (6 * e) * (s[15] * xy);
  out[2] = out[2] + f * (s[10] * xy) - (8 * g) * (s[11] * yz) + h * (s[12] * (6.f * zz - 3.f * xx - 3.f * yy)) -
           (8 * g) * (s[13] * xz) + i * (s[14] * (xx - yy));
}

}  // namespace drsplat::DRSPLAT_ISA
