// The backward pass of one view: from dL/d(image) to dL/d(parameters). Same decisions as the forward
// pass: no gradient through the clamp at 0.99, the cut at 1/255 and the stop at 1e-4.
#pragma once

// --- parameters -> what projection needs ---------------------------------------------------------

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
static void activate(const Parameters &p, uint32_t begin, uint32_t end, float *means, float *covariances, float *opacities) {
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
      for (int c = r; c < 3; c++, i++) out[i] = R[3 * r] * R[3 * c] + R[3 * r + 1] * R[3 * c + 1] + R[3 * r + 2] * R[3 * c + 2];
    out[9] = sigmoid_of(load(raw[10]));
    for (int i = 0; i < 10; i++) {
      float *to = i < 3 ? means + i * N : i < 9 ? covariances + (i - 3) * N : opacities;
      if (n == 16) store(to + at, out[i]);
      else for (int l = 0; l < n; l++) to[at + (uint32_t)l] = lane(out[i], l);
    }
  }
}

// --- colours of the visible splats ---------------------------------------------------------------

struct Directions { Floats x, y, z, inverse_distance; };  // unit, from the camera to sixteen Gaussians

static inline Directions directions_to(const Floats *mean, const float *center) {
  const Floats x = mean[0] - splat(center[0]), y = mean[1] - splat(center[1]), z = mean[2] - splat(center[2]);
  const Floats norm2 = x * x + y * y + z * z, inverse = keep(splat(0.f) < norm2, splat(1.f) / square_root(maximum(norm2, splat(1e-30f))));
  return {x * inverse, y * inverse, z * inverse, inverse};
}

constexpr int kMostColors = 48;  // SH coefficients of three channels
constexpr uint32_t kAhead = 16;  // splats whose rows are fetched while earlier ones are worked on

// Up to sixteen splats, one a lane. Where there are fewer, the first is read again and what comes of it thrown away.
struct Group {
  size_t ids[16];
  int count;
  float *unused;  // room for a row

  Group(const Visible &v, uint32_t first, float *room) : count(v.count - first < 16 ? (int)(v.count - first) : 16), unused(room) {
    for (int l = 0; l < 16; l++) ids[l] = v.splats[first + (l < count ? l : 0)].id;
  }
  void gather(const float *rows, int stride, int width, float (*columns)[16]) const {
    const float *at[16];
    for (int l = 0; l < 16; l++) at[l] = rows + ids[l] * stride;
    gather_rows(at, width, columns);
  }
  void scatter(const float (*columns)[16], int stride, int width, float *rows) const {
    float *at[16];
    for (int l = 0; l < 16; l++) at[l] = l < count ? rows + ids[l] * stride : unused;
    scatter_rows(columns, width, at);
  }
};

static inline void fetch_colors(const Visible &v, const Parameters &p, int used, uint32_t i) {
  if (i >= v.count) return;
  const float *row = p.sh + v.splats[i].id * (size_t)p.coefficients * 3;
  for (int k = 0; k < 3 * used; k += 16) __builtin_prefetch(row + k);
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
    for (int c = 0; c < 3; c++) {
      Floats color = splat(0.5f);
      for (int k = 0; k < n; k++) color = color + Y[k] * load(sh[3 * k + c]);
      store(out[c], maximum(color, splat(0.f)));
    }
    for (int l = 0; l < group.count; l++)
      for (int c = 0; c < 3; c++) colors[3 * (size_t)v.ranks[first + l] + c] = out[c][l];
  }
}

// sum over k of shade_k * d(basis_k) / d(x, y, z), the basis taken as polynomials.
static inline void add_basis_slopes(const Directions &to, int coefficients, const Floats *s, Floats *out) {
  for (int a = 0; a < 3; a++) out[a] = splat(0.f);
  if (coefficients <= 1) return;
  const Floats x = to.x, y = to.y, z = to.z;
  const float c1 = 0.4886025119029199f;
  out[0] = -c1 * s[3], out[1] = -c1 * s[1], out[2] = c1 * s[2];
  if (coefficients <= 4) return;
  const float a = 1.0925484305920792f, b = 0.31539156525252005f, c = 0.5462742152960396f;
  out[0] = out[0] + a * (s[4] * y - s[7] * z) - (2 * b) * (s[6] * x) + (2 * c) * (s[8] * x);
  out[1] = out[1] + a * (s[4] * x - s[5] * z) - (2 * b) * (s[6] * y) - (2 * c) * (s[8] * y);
  out[2] = out[2] - a * (s[5] * y + s[7] * x) + (4 * b) * (s[6] * z);
  if (coefficients <= 9) return;
  const float e = 0.5900435899266435f, f = 2.890611442640554f, g = 0.4570457994644658f, h = 0.3731763325901154f, i = 1.445305721320277f;
  const Floats xx = x * x, yy = y * y, zz = z * z, xy = x * y, xz = x * z, yz = y * z;
  out[0] = out[0] - (6 * e) * (s[9] * xy) + f * (s[10] * yz) + (2 * g) * (s[11] * xy) - (6 * h) * (s[12] * xz) - g * (s[13] * (4.f * zz - 3.f * xx - yy)) +
           (2 * i) * (s[14] * xz) - (3 * e) * (s[15] * (xx - yy));
  out[1] = out[1] - (3 * e) * (s[9] * (xx - yy)) + f * (s[10] * xz) - g * (s[11] * (4.f * zz - xx - 3.f * yy)) - (6 * h) * (s[12] * yz) + (2 * g) * (s[13] * xy) -
           (2 * i) * (s[14] * yz) + (6 * e) * (s[15] * xy);
  out[2] = out[2] + f * (s[10] * xy) - (8 * g) * (s[11] * yz) + h * (s[12] * (6.f * zz - 3.f * xx - 3.f * yy)) - (8 * g) * (s[13] * xz) + i * (s[14] * (xx - yy));
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
  memset(sums, 0, (size_t)tile.count * kSplatSums * sizeof(float));
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
      const Floats px = walk.lane_x + splat(walk.left + (float)(b % 2 * kBlockWidth)), py = walk.lane_y + splat(walk.top + (float)(b / 2 * kBlockHeight));
      const Floats dx = px - splat(g.x), dy = py - splat(g.y);  // rounded as in walk_block: the same cuts
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
      add_to(total[0], w * s.red), add_to(total[1], w * s.green), add_to(total[2], w * s.blue);
      add_to(total[3], G), add_to(total[4], gx), add_to(total[5], gy);
      add_to(total[6], gx * dx), add_to(total[7], gx * dy), add_to(total[8], gy * dy);
    }
    float *out = sums + (size_t)i * kSplatSums;
    store_sums(out, total[0], total[1], total[2], total[3]), store_sums(out + 4, total[4], total[5], total[6], total[7]);
    out[8] = sum(total[8]);
  }
}

// --- splats -> parameters, sixteen at a time -------------------------------------------------------

struct SplatLanes {  // what the way back needs of sixteen splats
  Floats mean[3], log_scale[3], quat[4], logit, cov_xx, cov_xy, cov_yy, sums[kSplatSums];
};

struct LaneGradients {
  Floats mean[3], log_scale[3], quat[4], logit, screen, radius;
};

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
  const Floats mid = 0.5f * (s.cov_xx + s.cov_yy), three_sigma = 3.f * square_root(mid + square_root(maximum(splat(0.1f), mid * mid - det)));
  const Floats rounded = floor_of(minimum(three_sigma, splat(1e6f)));
  out.radius = select(rounded < three_sigma, rounded + splat(1.f), rounded);
  out.screen = 0.5f * square_root((float)cam.width * (float)cam.width * (sx * sx) + (float)cam.height * (float)cam.height * (sy * sy));

  // The same projection as in the forward pass.
  const float *R = cam.rotation;
  Floats t[3];
  for (int i = 0; i < 3; i++) t[i] = R[3 * i] * s.mean[0] + R[3 * i + 1] * s.mean[1] + R[3 * i + 2] * s.mean[2] + splat(cam.translation[i]);
  const Floats iz = splat(1.f) / t[2], ux = t[0] * iz, uy = t[1] * iz;
  const float limit_x = 1.3f * 0.5f * (float)cam.width / cam.fx, limit_y = 1.3f * 0.5f * (float)cam.height / cam.fy;
  const Mask free_x = (ux >= splat(-limit_x)) & (splat(limit_x) >= ux), free_y = (uy >= splat(-limit_y)) & (splat(limit_y) >= uy);
  const Floats cx = clamp(ux, -limit_x, limit_x), cy = clamp(uy, -limit_y, limit_y);
  const Floats j00 = cam.fx * iz, j02 = -(j00 * cx), j11 = cam.fy * iz, j12 = -(j11 * cy);
  Floats T[6], q[4], rotation[9], scale[3], axes[9], V[9];
  for (int i = 0; i < 3; i++) T[i] = R[i] * j00 + R[6 + i] * j02, T[3 + i] = R[3 + i] * j11 + R[6 + i] * j12;
  const Floats inverse_norm = unit_quaternions(s.quat, q);
  rotations_of(q, rotation);
  for (int i = 0; i < 3; i++) scale[i] = exp_of(s.log_scale[i]);
  for (int i = 0; i < 9; i++) axes[i] = rotation[i] * scale[i % 3];
  for (int r = 0; r < 3; r++)
    for (int k = 0; k < 3; k++) V[3 * r + k] = axes[3 * r] * axes[3 * k] + axes[3 * r + 1] * axes[3 * k + 1] + axes[3 * r + 2] * axes[3 * k + 2];

  Floats DT[6], dT[6], daxes[9], drotation[9];
  for (int i = 0; i < 3; i++) DT[i] = Dxx * T[i] + Dxy * T[3 + i], DT[3 + i] = Dxy * T[i] + Dyy * T[3 + i];
  for (int r = 0; r < 2; r++)
    for (int k = 0; k < 3; k++) dT[3 * r + k] = 2.f * (DT[3 * r] * V[k] + DT[3 * r + 1] * V[3 + k] + DT[3 * r + 2] * V[6 + k]);
  for (int k = 0; k < 3; k++) {
    const Floats first = DT[0] * axes[k] + DT[1] * axes[3 + k] + DT[2] * axes[6 + k], second = DT[3] * axes[k] + DT[4] * axes[3 + k] + DT[5] * axes[6 + k];
    for (int r = 0; r < 3; r++) daxes[3 * r + k] = 2.f * (T[r] * first + T[3 + r] * second);
    out.log_scale[k] = scale[k] * (daxes[k] * rotation[k] + daxes[3 + k] * rotation[3 + k] + daxes[6 + k] * rotation[6 + k]);
    for (int r = 0; r < 3; r++) drotation[3 * r + k] = daxes[3 * r + k] * scale[k];
  }
  quaternion_gradient(q, inverse_norm, drotation, out.quat);
  out.logit = s.sums[3] * (splat(1.f) - sigmoid_of(s.logit));

  // dL/dJ = dL/dT R^t; J = fx/z (1, 0, -cx), fy/z (0, 1, -cy), cx and cy fixed where clamped.
  Floats d00 = splat(0.f), d02 = d00, d11 = d00, d12 = d00;
  for (int i = 0; i < 3; i++) d00 = d00 + R[i] * dT[i], d02 = d02 + R[6 + i] * dT[i], d11 = d11 + R[3 + i] * dT[3 + i], d12 = d12 + R[6 + i] * dT[3 + i];
  const Floats bend_x = cam.fx * (d02 * iz * iz), bend_y = cam.fy * (d12 * iz * iz);
  const Floats dx = cam.fx * (sx * iz) - keep(free_x, bend_x), dy = cam.fy * (sy * iz) - keep(free_y, bend_y);
  const Floats dz = -((cam.fx * (sx * ux) + cam.fy * (sy * uy)) * iz) - (cam.fx * d00 + cam.fy * d11) * iz * iz + bend_x * cx + keep(free_x, bend_x * cx) + bend_y * cy +
                    keep(free_y, bend_y * cy);
  for (int i = 0; i < 3; i++) out.mean[i] = R[i] * dx + R[3 + i] * dy + R[6 + i] * dz;
  return out;
}

// Through the colours: dL/d(sh), and what they add to dL/d(mean) by the viewing directions. No gradient
// where a colour was cut at zero.
static inline void color_gradients(const Group &group, const Parameters &p, int32_t active, const float *center, const Floats *color, const SplatLanes &s, LaneGradients &g, float *sh_out) {
  const Directions to = directions_to(s.mean, center);
  Floats Y[16], shade[16], slope[3], along[3];
  float sh[kMostColors][16];
  const int used = sh_basis(to.x, to.y, to.z, active, Y);
  group.gather(p.sh, 3 * p.coefficients, 3 * used, sh);
  for (int c = 0; c < 3; c++) along[c] = keep(splat(0.f) < color[c], s.sums[c]);
  for (int k = 0; k < used; k++) {
    shade[k] = along[0] * load(sh[3 * k]) + along[1] * load(sh[3 * k + 1]) + along[2] * load(sh[3 * k + 2]);
    for (int c = 0; c < 3; c++) store(sh[3 * k + c], Y[k] * along[c]);
  }
  group.scatter(sh, 3 * p.coefficients, 3 * used, sh_out);
  add_basis_slopes(to, used, shade, slope);
  const Floats radial = slope[0] * to.x + slope[1] * to.y + slope[2] * to.z;
  g.mean[0] = g.mean[0] + (slope[0] - radial * to.x) * to.inverse_distance;
  g.mean[1] = g.mean[1] + (slope[1] - radial * to.y) * to.inverse_distance;
  g.mean[2] = g.mean[2] + (slope[2] - radial * to.z) * to.inverse_distance;
}

static inline SplatLanes load_splats(const Visible &v, uint32_t first, const Group &group, const Parameters &p, const float (*sums)[16]) {
  float raw[11][16], cov[3][16];
  group.gather(p.means, 3, 3, raw), group.gather(p.log_scales, 3, 3, raw + 3), group.gather(p.quats, 4, 4, raw + 6), group.gather(p.logits, 1, 1, raw + 10);
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

static inline void fetch_sums(const Visible &v, const Sums &sums, uint32_t i) {
  if (i >= v.count) return;
  for (uint32_t k = v.places_start[i]; k < v.places_start[i + 1]; k++) __builtin_prefetch(sums.values + (size_t)sums.places[k] * kSplatSums);
  __builtin_prefetch(sums.colors + 3 * (size_t)v.ranks[i]);
}

// Of up to sixteen splats, what all their tiles say: kSplatSums columns, and three of colours.
static inline void add_tiles(const Visible &v, const Sums &from, uint32_t first, int count, float (*sums)[16], float (*colors)[16]) {
  for (int l = 0; l < 16; l++) {
    const uint32_t i = first + (uint32_t)(l < count ? l : 0);
    const float *color = from.colors + 3 * (size_t)v.ranks[i];
    Four some = {}, more = {};
    float last = 0;
    for (uint32_t k = v.places_start[i]; k < v.places_start[i + 1]; k++) {
      const float *row = from.values + (size_t)from.places[k] * kSplatSums;
      some += *(const Four *)row, more += *(const Four *)(row + 4), last += row[8];
    }
    for (int c = 0; c < 4; c++) sums[c][l] = some[c], sums[4 + c][l] = more[c];
    sums[8][l] = last;
    for (int c = 0; c < 3; c++) colors[c][l] = color[c];
  }
}

static void splats_backward(const Visible &v, const Sums &from, const Parameters &p, const Camera &cam, int32_t active, const float *center, const GradientArrays &out) {
  float unused[kMostColors];
  for (uint32_t first = 0; first < v.count; first += 16) {
    const Group group(v, first, unused);
    float sums[kSplatSums][16], colors[3][16];
    for (uint32_t l = 0; l < 16; l++) fetch_sums(v, from, first + l + kAhead), fetch_colors(v, p, active, first + l + kAhead);
    add_tiles(v, from, first, group.count, sums, colors);
    const Floats color[3] = {load(colors[0]), load(colors[1]), load(colors[2])};
    const SplatLanes s = load_splats(v, first, group, p, sums);
    LaneGradients g = splat_gradients(s, cam);
    color_gradients(group, p, active, center, color, s, g, out.sh);
    store_gradients(group, g, out);
  }
}
