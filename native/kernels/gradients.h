// Splats -> parameters: from the sums over all pixels to dL/d(parameters), sixteen splats at a time.
#pragma once
#include "kernels/activation.h"
#include "kernels/adam.h"
#include "kernels/colors.h"
#include "kernels/group.h"
#include "kernels/projection.h"

namespace drsplat::DRSPLAT_ISA {

struct SplatLanes {  // what the way back needs of sixteen splats
  Floats mean[3], log_scale[3], quat[4], logit, cov_xx, cov_xy, cov_yy, sums[kSplatSums];
};

struct LaneGradients { Floats mean[3], log_scale[3], quat[4], logit, screen, radius; };

// dL/d(raw quaternion) from dL/d(rotation); q the unit one.
static inline void quaternion_gradient(const Floats *q, Floats inverse_norm, const Floats *D, Floats *out) {
  const Floats w = q[0], x = q[1], y = q[2], z = q[3];
  const Floats unit[4] = {2.f * (z * (D[3] - D[1]) + y * (D[2] - D[6]) + x * (D[7] - D[5])),
                          2.f * (y * (D[1] + D[3]) + z * (D[2] + D[6]) + w * (D[7] - D[5]) - 2.f * x * (D[4] + D[8])),
                          2.f * (x * (D[1] + D[3]) + w * (D[2] - D[6]) + z * (D[5] + D[7]) - 2.f * y * (D[0] + D[8])),
                          2.f * (w * (D[3] - D[1]) + x * (D[2] + D[6]) + y * (D[5] + D[7]) - 2.f * z * (D[0] + D[4]))};
  const Floats along = unit[0] * w + unit[1] * x + unit[2] * y + unit[3] * z;
  for (int i = 0; i < 4; i++) out[i] = (unit[i] - along * q[i]) * inverse_norm;
}

// From the 2D covariance and the sums over pixels to all parameters but the colours; `T` is J R.
//   dL/d(centre) = Q [G dx, G dy];  dL/d(cov2d) = D = 1/2 Q M Q, M the second moments of G, Q the conic;
//   dL/dT = 2 D T V;  dL/dV = T^t D T;  dL/d(axes) = 2 dL/dV axes, with V = axes axes^t.
static inline LaneGradients splat_gradients(const SplatLanes &s, const Camera &cam) {
  LaneGradients out;
  const Floats det = s.cov_xx * s.cov_yy - s.cov_xy * s.cov_xy, inverse = splat(1.f) / det;
  const Floats qxx = s.cov_yy * inverse, qxy = -(s.cov_xy * inverse), qyy = s.cov_xx * inverse;
  const Floats sx = qxx * s.sums[4] + qxy * s.sums[5], sy = qxy * s.sums[4] + qyy * s.sums[5];
  const Floats a = qxx * s.sums[6] + qxy * s.sums[7], b = qxx * s.sums[7] + qxy * s.sums[8];
  const Floats c = qxy * s.sums[6] + qyy * s.sums[7], d = qxy * s.sums[7] + qyy * s.sums[8];
  const Floats Dxx = 0.5f * (a * qxx + b * qxy), Dxy = 0.5f * (a * qxy + b * qyy), Dyy = 0.5f * (c * qxy + d * qyy);
  out.radius = published_radius(0.5f * (s.cov_xx + s.cov_yy), det);
  out.screen = 0.5f * square_root((float)cam.width * (float)cam.width * (sx * sx) +
                                  (float)cam.height * (float)cam.height * (sy * sy));

  // The same projection as in the forward pass.
  const float *R = cam.rotation;
  Floats t[3];
  for (int i = 0; i < 3; i++)
    t[i] = R[3 * i] * s.mean[0] + R[3 * i + 1] * s.mean[1] + R[3 * i + 2] * s.mean[2] + splat(cam.translation[i]);
  const Floats iz = splat(1.f) / t[2], ux = t[0] * iz, uy = t[1] * iz;
  const float limit_x = most_slanted(cam.width, cam.fx), limit_y = most_slanted(cam.height, cam.fy);
  const Mask free_x = (ux >= splat(-limit_x)) & (splat(limit_x) >= ux),
             free_y = (uy >= splat(-limit_y)) & (splat(limit_y) >= uy);
  const Floats cx = clamp(ux, -limit_x, limit_x), cy = clamp(uy, -limit_y, limit_y);
  const Floats j00 = cam.fx * iz, j02 = -(j00 * cx), j11 = cam.fy * iz, j12 = -(j11 * cy);
  Floats T[6], q[4], rotation[9], scale[3], axes[9], V[9];
  for (int i = 0; i < 3; i++) T[i] = R[i] * j00 + R[6 + i] * j02, T[3 + i] = R[3 + i] * j11 + R[6 + i] * j12;
  const Floats inverse_norm = unit_quaternions(s.quat, q);
  rotations_of(q, rotation);
  for (int i = 0; i < 3; i++) scale[i] = exp_of(s.log_scale[i]);
  for (int i = 0; i < 9; i++) axes[i] = rotation[i] * scale[i % 3];
  for (int r = 0; r < 3; r++)
    for (int k = 0; k < 3; k++)
      V[3 * r + k] = axes[3 * r] * axes[3 * k] + axes[3 * r + 1] * axes[3 * k + 1] + axes[3 * r + 2] * axes[3 * k + 2];

  Floats DT[6], dT[6], daxes[9], drotation[9];
  for (int i = 0; i < 3; i++) DT[i] = Dxx * T[i] + Dxy * T[3 + i], DT[3 + i] = Dxy * T[i] + Dyy * T[3 + i];
  for (int r = 0; r < 2; r++)
    for (int k = 0; k < 3; k++)
      dT[3 * r + k] = 2.f * (DT[3 * r] * V[k] + DT[3 * r + 1] * V[3 + k] + DT[3 * r + 2] * V[6 + k]);
  for (int k = 0; k < 3; k++) {
    const Floats first = DT[0] * axes[k] + DT[1] * axes[3 + k] + DT[2] * axes[6 + k],
                 second = DT[3] * axes[k] + DT[4] * axes[3 + k] + DT[5] * axes[6 + k];
    for (int r = 0; r < 3; r++) daxes[3 * r + k] = 2.f * (T[r] * first + T[3 + r] * second);
    out.log_scale[k] =
        scale[k] * (daxes[k] * rotation[k] + daxes[3 + k] * rotation[3 + k] + daxes[6 + k] * rotation[6 + k]);
    for (int r = 0; r < 3; r++) drotation[3 * r + k] = daxes[3 * r + k] * scale[k];
  }
  quaternion_gradient(q, inverse_norm, drotation, out.quat);
  out.logit = s.sums[3] * (splat(1.f) - sigmoid_of(s.logit));

  // dL/dJ = dL/dT R^t; J = fx/z (1, 0, -cx), fy/z (0, 1, -cy), cx and cy fixed where clamped.
  Floats d00 = splat(0.f), d02 = d00, d11 = d00, d12 = d00;
  for (int i = 0; i < 3; i++)
    d00 = d00 + R[i] * dT[i], d02 = d02 + R[6 + i] * dT[i], d11 = d11 + R[3 + i] * dT[3 + i],
    d12 = d12 + R[6 + i] * dT[3 + i];
  const Floats bend_x = cam.fx * (d02 * iz * iz), bend_y = cam.fy * (d12 * iz * iz);
  const Floats dx = cam.fx * (sx * iz) - keep(free_x, bend_x), dy = cam.fy * (sy * iz) - keep(free_y, bend_y);
  const Floats dz = -((cam.fx * (sx * ux) + cam.fy * (sy * uy)) * iz) - (cam.fx * d00 + cam.fy * d11) * iz * iz +
                    bend_x * cx + keep(free_x, bend_x * cx) + bend_y * cy + keep(free_y, bend_y * cy);
  for (int i = 0; i < 3; i++) out.mean[i] = R[i] * dx + R[3 + i] * dy + R[6 + i] * dz;
  return out;
}

// Through the colours: dL/d(sh), in columns, and what they add to dL/d(mean) by the viewing directions. No gradient
// where a colour was cut at zero. Returns how many coefficients are in use.
static inline int color_gradients(const Group &group, const Parameters &p, int32_t active, const float *center,
                                  const SplatLanes &s, LaneGradients &g, float (*sh)[16]) {
  const Directions to = directions_to(s.mean, center);
  Floats Y[16], shade[16], slope[3], along[3];
  const int used = sh_basis(to.x, to.y, to.z, active, Y);
  group.gather(p.sh, 3 * p.coefficients, 3 * used, sh);
  for (int c = 0; c < 3; c++) along[c] = keep(splat(0.f) < harmonic_sum(Y, sh, used, c), s.sums[c]);
  for (int k = 0; k < used; k++) {
    shade[k] = along[0] * load(sh[3 * k]) + along[1] * load(sh[3 * k + 1]) + along[2] * load(sh[3 * k + 2]);
    for (int c = 0; c < 3; c++) store(sh[3 * k + c], Y[k] * along[c]);
  }
  add_basis_slopes(to, used, shade, slope);
  const Floats radial = slope[0] * to.x + slope[1] * to.y + slope[2] * to.z;
  g.mean[0] = g.mean[0] + (slope[0] - radial * to.x) * to.inverse_distance;
  g.mean[1] = g.mean[1] + (slope[1] - radial * to.y) * to.inverse_distance;
  g.mean[2] = g.mean[2] + (slope[2] - radial * to.z) * to.inverse_distance;
  return used;
}

static inline void step_unseen(int width, int stride, const HarmonicsStep &step, const AdamLanes &adam, uint32_t begin,
                               uint32_t end) {
  for (size_t at = begin * (size_t)stride; at < end * (size_t)stride; at += (size_t)stride)
    step_row(step.sh + at, nullptr, step.first + at, step.second + at, (size_t)width, adam);
}

// Steps the harmonics of a group's splats, and of the unseen Gaussians from `next` up to them.
static inline void step_harmonics(const Group &group, const float (*columns)[16], int width, int stride,
                                  const HarmonicsStep &step, const AdamLanes &adam, uint32_t &next) {
  float rows[16][kMostColors], *at[16];
  for (int l = 0; l < 16; l++) at[l] = rows[l];
  scatter_rows(columns, width, at);
  for (int l = 0; l < group.count; l++) {
    step_unseen(width, stride, step, adam, next, (uint32_t)group.ids[l]);
    const size_t first = group.ids[l] * (size_t)stride;
    step_row(step.sh + first, rows[l], step.first + first, step.second + first, (size_t)width, adam);
    next = (uint32_t)group.ids[l] + 1;
  }
}

static inline SplatLanes load_splats(const Visible &v, uint32_t first, const Group &group, const Parameters &p,
                                     const float (*sums)[16]) {
  float raw[11][16], cov[3][16];
  group.gather(p.means, 3, 3, raw), group.gather(p.log_scales, 3, 3, raw + 3), group.gather(p.quats, 4, 4, raw + 6),
      group.gather(p.logits, 1, 1, raw + 10);
  for (int l = 0; l < 16; l++) {
    const Extent &e = v.extents[first + (l < group.count ? l : 0)];
    cov[0][l] = e.cov_xx, cov[1][l] = e.cov_xy, cov[2][l] = e.cov_yy;
  }
  SplatLanes s;
  for (int i = 0; i < 3; i++) s.mean[i] = load(raw[i]), s.log_scale[i] = load(raw[3 + i]);
  for (int i = 0; i < 4; i++) s.quat[i] = load(raw[6 + i]);
  for (int i = 0; i < kSplatSums; i++) s.sums[i] = load(sums[i]);
  s.logit = load(raw[10]), s.cov_xx = load(cov[0]), s.cov_xy = load(cov[1]), s.cov_yy = load(cov[2]);
  return s;
}

static inline void store_gradients(const Group &group, const LaneGradients &g, const GradientArrays &out) {
  float columns[4][16];
  const auto put = [&](const Floats *values, int width, float *rows) {
    for (int i = 0; i < width; i++) store(columns[i], values[i]);
    group.scatter(columns, width, width, rows);
  };
  put(g.mean, 3, out.means), put(g.log_scale, 3, out.log_scales), put(g.quat, 4, out.quats);
  put(&g.logit, 1, out.logits), put(&g.screen, 1, out.screen), put(&g.radius, 1, out.radii);
}

// Of up to sixteen splats, what all their tiles say, in columns.
static inline void add_tiles(const Visible &v, const float *tile_sums, uint32_t first, int count, float (*sums)[16]) {
  for (int l = 0; l < 16; l++) {
    const uint32_t i = first + (uint32_t)(l < count ? l : 0);
    Four some = {}, more = {};
    float last = 0;
    const float *row = tile_sums + (size_t)v.rows_start[i] * kSplatSums;
    for (uint32_t k = v.rows_start[i]; k < v.rows_start[i + 1]; k++, row += kSplatSums)
      some += *(const Four *)row, more += *(const Four *)(row + 4), last += row[8];
    for (int c = 0; c < 4; c++) sums[c][l] = some[c], sums[4 + c][l] = more[c];
    sums[8][l] = last;
  }
}

// Of antialiased splats: what comes through ln(opacity) = ... + 1/2 ln det S - 1/2 ln det W, W = S + kBlur I the
// widened covariance, added to the second moments. dL/dW gains 1/2 g (S^-1 - Q) = 1/2 Q (g (W S^-1 W - W)) Q with g =
// sum G, and W S^-1 W - W = kBlur (I + kBlur S^-1). Not inlined, so that other scenes keep every bit of their
// gradients, whatever multiplications a compiler fuses.
static __attribute__((noinline)) void add_dimming(const Visible &v, uint32_t first, int count, float (*sums)[16]) {
  float cov[3][16];
  for (int l = 0; l < 16; l++) {
    const Extent &e = v.extents[first + (uint32_t)(l < count ? l : 0)];
    cov[0][l] = e.cov_xx, cov[1][l] = e.cov_xy, cov[2][l] = e.cov_yy;
  }
  const Floats xx = load(cov[0]) - splat(kBlur), xy = load(cov[1]), yy = load(cov[2]) - splat(kBlur);
  const Floats det = xx * yy - xy * xy, inverse = splat(kBlur) / maximum(det, splat(1e-30f));
  const Floats slope = kBlur * keep(splat(0.f) < det, load(sums[3]));
  store(sums[6], load(sums[6]) + slope * (splat(1.f) + inverse * yy));
  store(sums[7], load(sums[7]) - slope * (inverse * xy));
  store(sums[8], load(sums[8]) + slope * (splat(1.f) + inverse * xx));
}

static void splats_backward(const Visible &v, const float *tile_sums, const Parameters &p, const Camera &cam,
                            int32_t active, const float *center, const GradientArrays &out, const HarmonicsStep *step) {
  float unused[kMostColors];
  const int stride = 3 * p.coefficients;
  const AdamLanes adam(step ? step->adam : AdamStep{});
  uint32_t next = v.begin;  // of the Gaussians whose harmonics are to be stepped
  int width = 3 * active;
  for (uint32_t first = 0; first < v.count; first += 16) {
    const Group group(v, first, unused);
    float sums[kSplatSums][16];
    for (uint32_t l = 0; l < 16; l++) fetch_colors(v, p, active, first + l + kAhead);
    add_tiles(v, tile_sums, first, group.count, sums);
    if (p.antialiased) add_dimming(v, first, group.count, sums);
    const SplatLanes s = load_splats(v, first, group, p, sums);
    LaneGradients g = splat_gradients(s, cam);
    float sh[kMostColors][16];
    width = 3 * color_gradients(group, p, active, center, s, g, sh);
    if (step) step_harmonics(group, sh, width, stride, *step, adam, next);
    else group.scatter(sh, stride, width, out.sh);
    store_gradients(group, g, out);
  }
  if (step) step_unseen(width, stride, *step, adam, next, v.end);
}

}  // namespace drsplat::DRSPLAT_ISA
