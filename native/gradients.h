// The backward pass of one view: from dL/d(image) to dL/d(parameters). Same decisions as the forward
// pass: no gradient through the clamp at 0.99, the cut at 1/255 and the stop at 1e-4.
#pragma once

// --- parameters -> what projection needs ---------------------------------------------------------

struct Rotation { float r[9]; };

static inline Rotation rotation_of(const float *q) {  // unit wxyz
  const float w = q[0], x = q[1], y = q[2], z = q[3];
  return {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
           2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
}

static inline float unit_quaternion(const float *raw, float *unit) {  // returns 1 / norm
  const float norm2 = raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] + raw[3] * raw[3];
  const float inverse = 1.f / __builtin_sqrtf(norm2 > 1e-30f ? norm2 : 1e-30f);
  for (int i = 0; i < 4; i++) unit[i] = raw[i] * inverse;
  return inverse;
}

// exp of 16 numbers; beyond +-80 it stays finite.
INLINE Floats exp_of(Floats x) { return exp2_of(clamp(x * splat(kLog2E), -115.f, 115.f)); }

static inline void activate_some(const Parameters &p, uint32_t at, uint32_t n, float *means, float *covariances, float *opacities) {
  float logs[3][16] = {}, logits[16] = {}, scales[3][16], sigmoids[16];
  for (uint32_t i = 0; i < n; i++) {
    logits[i] = p.logits[at + i];
    for (int a = 0; a < 3; a++) logs[a][i] = p.log_scales[3 * (size_t)(at + i) + a];
  }
  for (int a = 0; a < 3; a++) store(scales[a], exp_of(load(logs[a])));
  store(sigmoids, splat(1.f) / (splat(1.f) + exp_of(splat(0.f) - load(logits))));
  const size_t N = p.count;
  for (uint32_t i = 0; i < n; i++) {
    const size_t row = at + i;
    float q[4], m[9];
    unit_quaternion(p.quats + 4 * row, q);
    const Rotation R = rotation_of(q);
    for (int r = 0; r < 3; r++)
      for (int c = 0; c < 3; c++) m[3 * r + c] = R.r[3 * r + c] * scales[c][i];
    const auto dot = [&m](int a, int b) { return m[3 * a] * m[3 * b] + m[3 * a + 1] * m[3 * b + 1] + m[3 * a + 2] * m[3 * b + 2]; };
    const float cov[6] = {dot(0, 0), dot(0, 1), dot(0, 2), dot(1, 1), dot(1, 2), dot(2, 2)};
    for (int a = 0; a < 6; a++) covariances[a * N + row] = cov[a];
    for (int a = 0; a < 3; a++) means[a * N + row] = p.means[3 * row + a];
    opacities[row] = sigmoids[i];
  }
}

static void activate(const Parameters &p, uint32_t begin, uint32_t end, float *means, float *covariances, float *opacities) {
  for (uint32_t at = begin; at < end; at += 16) activate_some(p, at, end - at < 16 ? end - at : 16, means, covariances, opacities);
}

// --- colours of the visible splats ---------------------------------------------------------------

struct Direction { float d[3], inverse_distance; };

static inline Direction direction_to(const float *mean, const float *center) {
  float v[3];
  for (int a = 0; a < 3; a++) v[a] = mean[a] - center[a];
  const float norm2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], inverse = norm2 > 0 ? 1.f / __builtin_sqrtf(norm2) : 0.f;
  return {{v[0] * inverse, v[1] * inverse, v[2] * inverse}, inverse};
}

// colors: 3 for each splat, by rank.
static void splat_colors(const Visible &v, const Parameters &p, int32_t active, const float *center, float *colors) {
  for (uint32_t i = 0; i < v.count; i++) {
    const size_t id = v.splats[i].id;
    float Y[16], color[3] = {0.5f, 0.5f, 0.5f}, *out = colors + 3 * (size_t)v.ranks[i];
    const Direction to = direction_to(p.means + 3 * id, center);
    const int n = sh_basis(to.d[0], to.d[1], to.d[2], active, Y);
    const float *row = p.sh + id * p.coefficients * 3;
    for (int k = 0; k < n; k++)
      for (int c = 0; c < 3; c++) color[c] += Y[k] * row[3 * k + c];
    for (int c = 0; c < 3; c++) out[c] = color[c] > 0 ? color[c] : 0.f;
  }
}

// d(basis) / d(x, y, z), the basis taken as polynomials.
static inline void sh_basis_gradient(float x, float y, float z, int coefficients, float (*D)[3]) {
  const auto set = [D](int k, float dx, float dy, float dz) { D[k][0] = dx, D[k][1] = dy, D[k][2] = dz; };
  set(0, 0, 0, 0);
  if (coefficients <= 1) return;
  const float c1 = 0.4886025119029199f;
  set(1, 0, -c1, 0), set(2, 0, 0, c1), set(3, -c1, 0, 0);
  if (coefficients <= 4) return;
  const float a = 1.0925484305920792f, b = 0.31539156525252005f, c = 0.5462742152960396f;
  set(4, a * y, a * x, 0), set(5, 0, -a * z, -a * y), set(6, -2 * b * x, -2 * b * y, 4 * b * z), set(7, -a * z, 0, -a * x), set(8, 2 * c * x, -2 * c * y, 0);
  if (coefficients <= 9) return;
  const float e = 0.5900435899266435f, f = 2.890611442640554f, g = 0.4570457994644658f, h = 0.3731763325901154f, i = 1.445305721320277f;
  const float xx = x * x, yy = y * y, zz = z * z;
  set(9, -6 * e * x * y, -e * (3 * xx - 3 * yy), 0);
  set(10, f * y * z, f * x * z, f * x * y);
  set(11, 2 * g * x * y, -g * (4 * zz - xx - 3 * yy), -8 * g * y * z);
  set(12, -6 * h * x * z, -6 * h * y * z, h * (6 * zz - 3 * xx - 3 * yy));
  set(13, -g * (4 * zz - 3 * xx - yy), 2 * g * x * y, -8 * g * x * z);
  set(14, 2 * i * x * z, -2 * i * y * z, i * (xx - yy));
  set(15, -e * (3 * xx - 3 * yy), 6 * e * x * y, 0);
}

// --- tiles ---------------------------------------------------------------------------------------

// colors: 3 per splat. image (height, width, 3), alpha (height, width).
static void tile_forward(const Tile &tile, const float *colors, const float *background, TileScratch &scratch, float *image, float *alpha) {
  Walk walk(tile, scratch);
  for (int b = 0; b < kBlocks; b++) {
    const int left = tile.x * 16 + b % 2 * kBlockWidth, top = tile.y * 16 + b / 2 * kBlockHeight;
    const Mask inside = (walk.lane_x < splat((float)(tile.width - left))) & (walk.lane_y < splat((float)(tile.height - top)));
    if (!any(inside)) continue;
    Floats red = splat(0.f), green = red, blue = red;
    const Floats rest = walk_block(
        walk, b, inside, 0, [](uint32_t) {},
        [&](uint32_t i, Floats w) __attribute__((always_inline)) {
          const float *color = colors + 3 * (size_t)tile.list[i];
          red = red + w * splat(color[0]), green = green + w * splat(color[1]), blue = blue + w * splat(color[2]);
        });
    write_lanes(image, tile, left, top, inside, 3, red + rest * splat(background[0]));
    write_lanes(image + 1, tile, left, top, inside, 3, green + rest * splat(background[1]));
    write_lanes(image + 2, tile, left, top, inside, 3, blue + rest * splat(background[2]));
    write_lanes(alpha, tile, left, top, inside, 1, splat(1.f) - rest);
  }
}

struct BlockState {  // 16 pixels during the backward walk
  Floats transmittance, behind;  // behind: (what is composited from here on) . dL/dpixel
  Floats red, green, blue;       // dL/dpixel
};

static inline uint32_t start_blocks(const Walk &walk, const float *image, const float *gradient, BlockState *blocks) {
  uint32_t alive = 0;
  const Tile &tile = walk.tile;
  for (int b = 0; b < kBlocks; b++) {
    float t[16], behind[16], g[3][16];
    for (int l = 0; l < 16; l++) {
      const int x = tile.x * 16 + b % 2 * kBlockWidth + l % kBlockWidth, y = tile.y * 16 + b / 2 * kBlockHeight + l / kBlockWidth;
      const bool inside = x < tile.width && y < tile.height;
      const size_t pixel = inside ? ((size_t)y * tile.width + x) * 3 : 0;
      t[l] = inside, behind[l] = 0;
      for (int c = 0; c < 3; c++) {
        g[c][l] = inside ? gradient[pixel + c] : 0.f;
        behind[l] += inside ? image[pixel + c] * g[c][l] : 0.f;
      }
      alive |= (uint32_t)inside << b;
    }
    blocks[b] = {load(t), load(behind), load(g[0]), load(g[1]), load(g[2])};
  }
  return alive;
}

// Sums over the tile's pixels for every list entry, kSplatSums each: dL/d(colour), then with
// G = dL/d(ln alpha): G, G dx, G dy, G dx^2, G dx dy, G dy^2, d = pixel - centre.
//
// dL/d(alpha_i) = T_i (c_i . g) - (what is behind i) / (1 - alpha_i), and what is behind i is the pixel's
// value less what was composited up to i: so one walk front to back, without a record, is enough.
static void tile_backward(const Tile &tile, const float *colors, const float *image, const float *gradient, TileScratch &scratch, float *sums) {
  memset(sums, 0, tile.count * kSplatSums * sizeof(float));
  if (!tile.count) return;
  const Walk walk(tile, scratch);
  BlockState blocks[kBlocks];
  uint32_t alive = start_blocks(walk, image, gradient, blocks);
  for (uint32_t i = 0; i < tile.count && alive; i++) {
    if (i + 8 < tile.count) __builtin_prefetch(&tile.splats[tile.list[i + 8]]);
    const Splat &g = tile.splats[tile.list[i]];
    uint32_t touched = blocks_touched(walk, g) & alive;
    if (!touched) continue;
    const float *color = colors + 3 * (size_t)tile.list[i];
    Floats total[kSplatSums];
    for (Floats &t : total) t = splat(0.f);
    for (; touched; touched &= touched - 1) {
      const int b = __builtin_ctz(touched);
      BlockState &s = blocks[b];
      const Floats dx = walk.lane_x + splat(walk.left + (float)(b % 2 * kBlockWidth) - g.x), dy = walk.lane_y + splat(walk.top + (float)(b / 2 * kBlockHeight) - g.y);
      const Floats p = (splat(g.xx) * dx + splat(g.xy) * dy) * dx + (splat(g.yy) * dy * dy + splat(g.log2_opacity));
      const Floats alpha = keep(p >= splat(kLog2MinAlpha), minimum(exp2_of(p), splat(0.99f)));
      const Floats weight = s.transmittance * alpha, after = s.transmittance - weight;
      const Mask live = after >= splat(kMinTransmittance);
      const Floats w = keep(live, weight);
      const Floats shade = s.red * splat(color[0]) + s.green * splat(color[1]) + s.blue * splat(color[2]);
      const Floats behind = s.behind - w * shade;
      const Floats slope = s.transmittance * shade - behind / (splat(1.f) - alpha);  // dL/d(alpha)
      const Floats G = keep(live & (alpha < splat(0.99f)), slope * alpha);
      s.transmittance = after, s.behind = behind;
      if (!any(live)) alive &= ~(1u << b);
      const Floats gx = G * dx, gy = G * dy;
      const Floats parts[kSplatSums] = {w * s.red, w * s.green, w * s.blue, G, gx, gy, gx * dx, gx * dy, gy * dy};
      for (int c = 0; c < kSplatSums; c++) total[c] = total[c] + parts[c];
    }
    for (int c = 0; c < kSplatSums; c++) sums[i * kSplatSums + c] = sum(total[c]);
  }
}

// --- splats -> parameters ------------------------------------------------------------------------

struct Symmetric2 { float xx, xy, yy; };

// dL/d(covariance in 2D) = 1/2 Q M Q, M the second moments of G, Q the conic.
static inline Symmetric2 covariance_gradient(const Symmetric2 &Q, const float *m) {
  const float a = Q.xx * m[0] + Q.xy * m[1], b = Q.xx * m[1] + Q.xy * m[2], c = Q.xy * m[0] + Q.yy * m[1], d = Q.xy * m[1] + Q.yy * m[2];
  return {0.5f * (a * Q.xx + b * Q.xy), 0.5f * (a * Q.xy + b * Q.yy), 0.5f * (c * Q.xy + d * Q.yy)};
}

// dL/d(raw quaternion) from dL/d(rotation).
static inline void quaternion_gradient(const float *q, float inverse_norm, const float *D, float *out) {
  const float w = q[0], x = q[1], y = q[2], z = q[3];
  const float unit[4] = {
      2 * (-z * D[1] + y * D[2] + z * D[3] - x * D[5] - y * D[6] + x * D[7]),
      2 * (y * D[1] + z * D[2] + y * D[3] - 2 * x * D[4] - w * D[5] + z * D[6] + w * D[7] - 2 * x * D[8]),
      2 * (-2 * y * D[0] + x * D[1] + w * D[2] + x * D[3] + z * D[5] - w * D[6] + z * D[7] - 2 * y * D[8]),
      2 * (-2 * z * D[0] - w * D[1] + x * D[2] + w * D[3] - 2 * z * D[4] + y * D[5] + x * D[6] + y * D[7])};
  const float along = unit[0] * w + unit[1] * x + unit[2] * y + unit[3] * z;
  for (int i = 0; i < 4; i++) out[i] = (unit[i] - along * q[i]) * inverse_norm;
}

// Through the colour: dL/d(sh), and what it adds to dL/d(mean) by the viewing direction.
static inline void color_backward(const Parameters &p, size_t id, int32_t active, const float *center, const float *sums, float *sh_out, float *mean_out) {
  float Y[16], D[16][3], color[3] = {0.5f, 0.5f, 0.5f}, g[3], along_d[3] = {};
  const Direction to = direction_to(p.means + 3 * id, center);
  const int n = sh_basis(to.d[0], to.d[1], to.d[2], active, Y);
  sh_basis_gradient(to.d[0], to.d[1], to.d[2], active, D);
  const float *row = p.sh + id * p.coefficients * 3;
  for (int k = 0; k < n; k++)
    for (int c = 0; c < 3; c++) color[c] += Y[k] * row[3 * k + c];
  for (int c = 0; c < 3; c++) g[c] = color[c] > 0 ? sums[c] : 0.f;
  for (int k = 0; k < n; k++) {
    float shade = 0;
    for (int c = 0; c < 3; c++) sh_out[3 * k + c] = Y[k] * g[c], shade += g[c] * row[3 * k + c];
    for (int a = 0; a < 3; a++) along_d[a] += shade * D[k][a];
  }
  const float radial = along_d[0] * to.d[0] + along_d[1] * to.d[1] + along_d[2] * to.d[2];
  for (int a = 0; a < 3; a++) mean_out[a] += (along_d[a] - radial * to.d[a]) * to.inverse_distance;
}

static inline void splat_backward(const Splat &g, const Extent &e, const Parameters &p, const Camera &cam, int32_t active, const float *center,
                                  const float *sums, const GradientArrays &out) {
  const size_t id = g.id;
  const float det = e.cov_xx * e.cov_yy - e.cov_xy * e.cov_xy, inverse = 1.f / det;
  const Symmetric2 Q = {e.cov_yy * inverse, -e.cov_xy * inverse, e.cov_xx * inverse};
  const float sx = Q.xx * sums[4] + Q.xy * sums[5], sy = Q.xy * sums[4] + Q.yy * sums[5];  // dL/d(centre), pixels
  const Symmetric2 D = covariance_gradient(Q, sums + 6);
  const float mid = 0.5f * (e.cov_xx + e.cov_yy), gap = mid * mid - det;
  out.radii[id] = __builtin_ceilf(3.f * __builtin_sqrtf(mid + __builtin_sqrtf(gap > 0.1f ? gap : 0.1f)));
  out.screen[id] = 0.5f * __builtin_sqrtf(sx * sx * (float)cam.width * (float)cam.width + sy * sy * (float)cam.height * (float)cam.height);

  // the same projection as in the forward pass
  const float *R = cam.rotation, *mean = p.means + 3 * id;
  float t[3];
  for (int a = 0; a < 3; a++) t[a] = R[3 * a] * mean[0] + R[3 * a + 1] * mean[1] + R[3 * a + 2] * mean[2] + cam.translation[a];
  const float iz = 1.f / t[2], limit_x = 1.3f * 0.5f * (float)cam.width / cam.fx, limit_y = 1.3f * 0.5f * (float)cam.height / cam.fy;
  const float ux = t[0] * iz, uy = t[1] * iz;
  const bool free_x = ux >= -limit_x && ux <= limit_x, free_y = uy >= -limit_y && uy <= limit_y;
  const float cx = free_x ? ux : ux < 0 ? -limit_x : limit_x, cy = free_y ? uy : uy < 0 ? -limit_y : limit_y;
  const float j00 = cam.fx * iz, j02 = -j00 * cx, j11 = cam.fy * iz, j12 = -j11 * cy;
  float T[6], q[4];
  for (int i = 0; i < 3; i++) T[i] = j00 * R[i] + j02 * R[6 + i], T[3 + i] = j11 * R[3 + i] + j12 * R[6 + i];
  const float inverse_norm = unit_quaternion(p.quats + 4 * id, q);
  const Rotation rot = rotation_of(q);
  float scale[3], M[9], V[9];
  for (int a = 0; a < 3; a++) scale[a] = __builtin_expf(p.log_scales[3 * id + a]);
  for (int r = 0; r < 3; r++)
    for (int c = 0; c < 3; c++) M[3 * r + c] = rot.r[3 * r + c] * scale[c];
  for (int r = 0; r < 3; r++)
    for (int c = 0; c < 3; c++) V[3 * r + c] = M[3 * r] * M[3 * c] + M[3 * r + 1] * M[3 * c + 1] + M[3 * r + 2] * M[3 * c + 2];

  // D T (2x3), then dL/dT = 2 (D T) V, dL/dV = T^t (D T), dL/dM = 2 dL/dV M
  float DT[6], dT[6], dM[9], dR[9];
  for (int i = 0; i < 3; i++) DT[i] = D.xx * T[i] + D.xy * T[3 + i], DT[3 + i] = D.xy * T[i] + D.yy * T[3 + i];
  for (int r = 0; r < 2; r++)
    for (int c = 0; c < 3; c++) dT[3 * r + c] = 2 * (DT[3 * r] * V[c] + DT[3 * r + 1] * V[3 + c] + DT[3 * r + 2] * V[6 + c]);
  for (int r = 0; r < 3; r++)
    for (int c = 0; c < 3; c++) {
      dM[3 * r + c] = 0;
      for (int k = 0; k < 3; k++) dM[3 * r + c] += 2 * (T[r] * DT[k] + T[3 + r] * DT[3 + k]) * M[3 * k + c];
    }
  for (int a = 0; a < 3; a++) {
    out.log_scales[3 * id + a] = scale[a] * (dM[a] * rot.r[a] + dM[3 + a] * rot.r[3 + a] + dM[6 + a] * rot.r[6 + a]);
    for (int r = 0; r < 3; r++) dR[3 * r + a] = dM[3 * r + a] * scale[a];
  }
  quaternion_gradient(q, inverse_norm, dR, out.quats + 4 * id);
  out.logits[id] = sums[3] * (1.f - 1.f / (1.f + __builtin_expf(-p.logits[id])));

  // dL/dJ = dL/dT R^t; J = fx/z (1, 0, -cx), fy/z (0, 1, -cy)
  float d00 = 0, d02 = 0, d11 = 0, d12 = 0;
  for (int i = 0; i < 3; i++) d00 += dT[i] * R[i], d02 += dT[i] * R[6 + i], d11 += dT[3 + i] * R[3 + i], d12 += dT[3 + i] * R[6 + i];
  float d[3];  // dL/d(camera coordinates)
  d[0] = sx * cam.fx * iz - (free_x ? d02 * cam.fx * iz * iz : 0.f);
  d[1] = sy * cam.fy * iz - (free_y ? d12 * cam.fy * iz * iz : 0.f);
  d[2] = -(sx * cam.fx * ux + sy * cam.fy * uy) * iz - (d00 * cam.fx + d11 * cam.fy) * iz * iz +
         (free_x ? 2.f : 1.f) * d02 * cam.fx * cx * iz * iz + (free_y ? 2.f : 1.f) * d12 * cam.fy * cy * iz * iz;
  float mean_out[3];
  for (int a = 0; a < 3; a++) mean_out[a] = R[a] * d[0] + R[3 + a] * d[1] + R[6 + a] * d[2];
  color_backward(p, id, active, center, sums, out.sh + id * p.coefficients * 3, mean_out);
  for (int a = 0; a < 3; a++) out.means[3 * id + a] = mean_out[a];
}

constexpr uint32_t kAhead = 12;  // splats whose sums are fetched while earlier ones are worked on

static void splats_backward(const Visible &v, const Places &at, const Parameters &p, const Camera &cam, int32_t active, const float *center, const GradientArrays &out) {
  for (uint32_t i = 0; i < v.count; i++) {
    if (i + kAhead < v.count) {
      const uint32_t rank = v.ranks[i + kAhead];
      for (uint32_t k = at.start[rank]; k < at.start[rank + 1]; k++) __builtin_prefetch(at.sums + (size_t)at.places[k] * kSplatSums);
    }
    float total[kSplatSums] = {};
    const uint32_t rank = v.ranks[i];
    for (uint32_t k = at.start[rank]; k < at.start[rank + 1]; k++)
      for (int c = 0; c < kSplatSums; c++) total[c] += at.sums[(size_t)at.places[k] * kSplatSums + c];
    splat_backward(v.splats[i], v.extents[i], p, cam, active, center, total, out);
  }
}
