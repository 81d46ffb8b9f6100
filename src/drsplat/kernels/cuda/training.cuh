// Training: images of parameters before activation, and the gradients of a loss by them: the arithmetic of
// native/kernels/{activation,colors,training_tiles,gradients}.h, one Gaussian or one pixel a thread.
//
// Nothing is added up by atomic additions: each (splat, tile) has a row of sums, and those of a Gaussian follow each
// other. So the same input gives the same bits.
constexpr int SUMS = 9;       // dL/d(colour), then with G = dL/d(ln alpha): G, G dx, G dy, G dx^2, G dx dy, G dy^2
constexpr int BATCH_BACK = 128;
constexpr u32 FEW_ROWS = 32;  // of a Gaussian: more are added up by the whole warp

struct Parameters {
  const float *means, *log_scales, *quats, *logits, *sh;
  u32 count;
  int coefficients, active;  // of the harmonics: stored, used
};

DEVICE float exp_of(float x) { return exp2f(clampf(x * LOG2_E, -115.f, 115.f)); }
DEVICE float sigmoid(float x) { return 1.f / (1.f + exp_of(-x)); }

struct Axes {  // of a Gaussian: rotation, row by row, and its columns scaled
  float q[4], inverse_norm, rotation[9], scale[3], scaled[9];
};

DEVICE Axes axes_of(const Parameters &p, u32 i) {
  Axes a;
  float norm2 = 0.f;
  for (int k = 0; k < 4; k++) a.q[k] = p.quats[4 * (size_t)i + k], norm2 += a.q[k] * a.q[k];
  a.inverse_norm = 1.f / sqrtf(fmaxf(norm2, 1e-30f));
  for (int k = 0; k < 4; k++) a.q[k] *= a.inverse_norm;
  const float w = a.q[0], x = a.q[1], y = a.q[2], z = a.q[3];
  const float R[9] = {1.f - 2.f * (y * y + z * z), 2.f * (x * y - w * z), 2.f * (x * z + w * y),
                      2.f * (x * y + w * z), 1.f - 2.f * (x * x + z * z), 2.f * (y * z - w * x),
                      2.f * (x * z - w * y), 2.f * (y * z + w * x), 1.f - 2.f * (x * x + y * y)};
  for (int k = 0; k < 3; k++) a.scale[k] = exp_of(p.log_scales[3 * (size_t)i + k]);
  for (int k = 0; k < 9; k++) a.rotation[k] = R[k], a.scaled[k] = R[k] * a.scale[k % 3];
  return a;
}

DEVICE void covariance_of(const float *a, float *V) {  // all nine of a a^t
  for (int r = 0; r < 3; r++)
    for (int k = 0; k < 3; k++)
      V[3 * r + k] = a[3 * r] * a[3 * k] + a[3 * r + 1] * a[3 * k + 1] + a[3 * r + 2] * a[3 * k + 2];
}

// --- colours -------------------------------------------------------------------------------------

constexpr float SH0 = 0.28209479177387814f, SH1 = 0.4886025119029199f, SH4 = 1.0925484305920792f;
constexpr float SH6 = 0.31539156525252005f, SH8 = 0.5462742152960396f, SH9 = 0.5900435899266435f;
constexpr float SH10 = 2.890611442640554f, SH11 = 0.4570457994644658f, SH12 = 0.3731763325901154f;
constexpr float SH14 = 1.445305721320277f;

struct Direction { float x, y, z, inverse_distance; };  // unit, from the camera to a Gaussian

DEVICE Direction direction_to(const float *mean, const float *center) {
  const float x = mean[0] - center[0], y = mean[1] - center[1], z = mean[2] - center[2];
  const float norm2 = x * x + y * y + z * z, inverse = norm2 > 0.f ? 1.f / sqrtf(fmaxf(norm2, 1e-30f)) : 0.f;
  return {x * inverse, y * inverse, z * inverse, inverse};
}

DEVICE void sh_basis(const Direction &d, int coefficients, float *Y) {
  const float x = d.x, y = d.y, z = d.z;
  Y[0] = SH0;
  if (coefficients <= 1) return;
  Y[1] = -SH1 * y, Y[2] = SH1 * z, Y[3] = -SH1 * x;
  if (coefficients <= 4) return;
  const float xx = x * x, yy = y * y, zz = z * z;
  Y[4] = SH4 * (x * y), Y[5] = -SH4 * (y * z), Y[6] = SH6 * (2.f * zz - xx - yy), Y[7] = -SH4 * (x * z);
  Y[8] = SH8 * (xx - yy);
  if (coefficients <= 9) return;
  Y[9] = -SH9 * (y * (3.f * xx - yy)), Y[10] = SH10 * (x * y * z), Y[11] = -SH11 * (y * (4.f * zz - xx - yy));
  Y[12] = SH12 * (z * (2.f * zz - 3.f * xx - 3.f * yy)), Y[13] = -SH11 * (x * (4.f * zz - xx - yy));
  Y[14] = SH14 * (z * (xx - yy)), Y[15] = -SH9 * (x * (xx - 3.f * yy));
}

// sum over k of s_k * d(basis_k) / d(x, y, z), the basis taken as polynomials.
DEVICE void basis_slopes(const Direction &d, int coefficients, const float *s, float *out) {
  out[0] = out[1] = out[2] = 0.f;
  if (coefficients <= 1) return;
  const float x = d.x, y = d.y, z = d.z;
  out[0] = -SH1 * s[3], out[1] = -SH1 * s[1], out[2] = SH1 * s[2];
  if (coefficients <= 4) return;
  out[0] += SH4 * (s[4] * y - s[7] * z) - 2 * SH6 * (s[6] * x) + 2 * SH8 * (s[8] * x);
  out[1] += SH4 * (s[4] * x - s[5] * z) - 2 * SH6 * (s[6] * y) - 2 * SH8 * (s[8] * y);
  out[2] += -SH4 * (s[5] * y + s[7] * x) + 4 * SH6 * (s[6] * z);
  if (coefficients <= 9) return;
  const float xx = x * x, yy = y * y, zz = z * z, xy = x * y, xz = x * z, yz = y * z;
  out[0] += -6 * SH9 * (s[9] * xy) + SH10 * (s[10] * yz) + 2 * SH11 * (s[11] * xy) - 6 * SH12 * (s[12] * xz) -
            SH11 * (s[13] * (4.f * zz - 3.f * xx - yy)) + 2 * SH14 * (s[14] * xz) - 3 * SH9 * (s[15] * (xx - yy));
  out[1] += -3 * SH9 * (s[9] * (xx - yy)) + SH10 * (s[10] * xz) - SH11 * (s[11] * (4.f * zz - xx - 3.f * yy)) -
            6 * SH12 * (s[12] * yz) + 2 * SH11 * (s[13] * xy) - 2 * SH14 * (s[14] * yz) + 6 * SH9 * (s[15] * xy);
  out[2] += SH10 * (s[10] * xy) - 8 * SH11 * (s[11] * yz) + SH12 * (s[12] * (6.f * zz - 3.f * xx - 3.f * yy)) -
            8 * SH11 * (s[13] * xz) + SH14 * (s[14] * (xx - yy));
}

DEVICE float4 color_of(const Parameters &p, u32 i, const float *mean, const float *center) {
  float Y[16], color[3] = {0.5f, 0.5f, 0.5f};
  sh_basis(direction_to(mean, center), p.active, Y);
  const float *row = p.sh + (size_t)i * p.coefficients * 3;
#pragma unroll
  for (int k = 0; k < 16; k++)
    if (k < p.active)
      for (int c = 0; c < 3; c++) color[c] += Y[k] * row[3 * k + c];
  return make_float4(fmaxf(color[0], 0.f), fmaxf(color[1], 0.f), fmaxf(color[2], 0.f), 0.f);
}

KERNEL project_parameters(const float *means, const float *log_scales, const float *quats, const float *logits,
                          const float *sh, u32 n, int coefficients, int active, const Camera *camera, int width,
                          int height, int antialiased, Splat *splats, Extent *extents, float4 *colors, u32 *keys,
                          u32 *counts) {
  const u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= n) return;
  const Parameters p = {means, log_scales, quats, logits, sh, n, coefficients, active};
  Shape g;
  float V[9];
  covariance_of(axes_of(p, i).scaled, V);
  for (int a = 0; a < 3; a++) g.mean[a] = means[3 * (size_t)i + a];
  g.covariance[0] = V[0], g.covariance[1] = V[1], g.covariance[2] = V[2], g.covariance[3] = V[4];
  g.covariance[4] = V[5], g.covariance[5] = V[8], g.opacity = sigmoid(logits[i]);
  if (keep_splat(i, g, *camera, width, height, antialiased, {0, 1 << 15}, splats, extents, keys, counts))
    colors[i] = color_of(p, i, g.mean, camera->center);
}

// --- pixels --------------------------------------------------------------------------------------

// image (height, width, 3)
KERNEL __launch_bounds__(256)
    draw_colors(const u32 *starts, const u32 *ids, const Splat *splats, const float4 *colors, int width, int height,
                int columns, float red, float green, float blue, float *image) {
  __shared__ Batch<256> batch;
  const int tile = blockIdx.x;
  const Place place = place_of_thread(tile, columns, width, height);
  const List list = {ids, starts[tile], starts[tile + 1], splats, colors, tile, columns};
  float r = 0.f, g = 0.f, b = 0.f;
  const Walked walked = walk(
      batch, list, place, place.inside, 0,
      [&](int j, const Hit &hit) {
        const float4 color = batch.colors[j];
        r += hit.weight * color.x, g += hit.weight * color.y, b += hit.weight * color.z;
      },
      [](u32, u32) {});
  if (!place.inside) return;
  float *pixel = image + ((size_t)place.y * width + place.x) * 3;
  pixel[0] = r + walked.rest * red, pixel[1] = g + walked.rest * green, pixel[2] = b + walked.rest * blue;
}

// Eight sums over a warp at once: lane l has that of v[(l >> 4 & 1) * 4 + (l >> 3 & 1) * 2 + (l >> 2 & 1)].
DEVICE float eight_sums(const float *v) {
  const int lane = lane_of_warp();
  const bool high = lane & 16, middle = lane & 8, low = lane & 4;
  float a[4], b[2];
#pragma unroll
  for (int k = 0; k < 4; k++) a[k] = (high ? v[k + 4] : v[k]) + __shfl_xor_sync(FULL, high ? v[k] : v[k + 4], 16);
#pragma unroll
  for (int k = 0; k < 2; k++) b[k] = (middle ? a[k + 2] : a[k]) + __shfl_xor_sync(FULL, middle ? a[k] : a[k + 2], 8);
  float c = (low ? b[1] : b[0]) + __shfl_xor_sync(FULL, low ? b[0] : b[1], 4);
  c += __shfl_xor_sync(FULL, c, 2);
  return c + __shfl_xor_sync(FULL, c, 1);
}

// From dL/d(image) to the sums of each (splat, tile). dL/d(alpha) = T (c . g) - (what is behind) / (1 - alpha), and what
// is behind is the pixel's value less what was composited up to here: one walk front to back, without a record.
// No gradient through the clamp at 0.99, the cut at 1/255 and the stop at 1e-4.
KERNEL __launch_bounds__(256)
    draw_colors_backward(const u32 *starts, const u32 *ids, const u32 *rows, const Splat *splats, const float4 *colors,
                         int width, int height, int columns, const float *image, const float *gradient, float *sums) {
  __shared__ Batch<BATCH_BACK> batch;
  __shared__ float partial[WARPS][BATCH_BACK][SUMS];
  __shared__ u64 done[WARPS][2];
  const int tile = blockIdx.x, lane = lane_of_warp(), warp = warp_of_block();
  const Place place = place_of_thread(tile, columns, width, height);
  const List list = {ids, starts[tile], starts[tile + 1], splats, colors, tile, columns};
  const size_t pixel = ((size_t)place.y * width + place.x) * 3;
  float slope[3] = {}, behind = 0.f;
  if (place.inside)
    for (int c = 0; c < 3; c++) slope[c] = gradient[pixel + c], behind += image[pixel + c] * slope[c];
  u64 low = 0, high = 0;  // entries of the batch that this warp has sums of
  const Walked walked = walk(
      batch, list, place, place.inside, 0,
      [&](int j, const Hit &hit) {
        if (!__any_sync(FULL, hit.weight > 0.f)) return;
        const float4 color = batch.colors[j];
        const float shade = slope[0] * color.x + slope[1] * color.y + slope[2] * color.z;
        behind -= hit.weight * shade;
        const float by_alpha = hit.before * shade - behind / (1.f - hit.alpha);
        const float G = hit.weight > 0.f && hit.alpha < MAX_ALPHA ? by_alpha * hit.alpha : 0.f;
        const float gx = G * hit.dx, gy = G * hit.dy;
        const float v[8] = {hit.weight * slope[0], hit.weight * slope[1], hit.weight * slope[2], G, gx, gy,
                            gx * hit.dx,           gx * hit.dy};
        const float eight = eight_sums(v), last = warp_sum(gy * hit.dy);
        if ((lane & 3) == 0) partial[warp][j][(lane >> 4 & 1) * 4 + (lane >> 3 & 1) * 2 + (lane >> 2 & 1)] = eight;
        if (lane == 0) partial[warp][j][8] = last;
        if (j < 64) low |= 1ull << j;
        else high |= 1ull << (j - 64);
      },
      [&](u32 begin, u32 end) {
        if (lane == 0) done[warp][0] = low, done[warp][1] = high;
        low = high = 0;
        __syncthreads();
        for (int k = threadIdx.x; k < (int)(end - begin) * SUMS; k += 256) {
          const int entry = k / SUMS, column = k % SUMS;
          float sum = 0.f;
          for (int w = 0; w < WARPS; w++)
            if (done[w][entry / 64] >> entry % 64 & 1) sum += partial[w][entry][column];
          sums[(size_t)rows[begin + entry] * SUMS + column] = sum;
        }
      });
  for (u32 k = threadIdx.x; k < (list.end - walked.at) * SUMS; k += 256)
    sums[(size_t)rows[walked.at + k / SUMS] * SUMS + k % SUMS] = 0.f;
}

// --- Gaussians -----------------------------------------------------------------------------------

// All rows of each Gaussian of a warp, added up.
DEVICE void add_rows(const float *sums, i64 first, u32 count, float *out) {
  for (int c = 0; c < SUMS; c++) out[c] = 0.f;
  if (count <= FEW_ROWS)
    for (u32 k = 0; k < count; k++)
      for (int c = 0; c < SUMS; c++) out[c] += sums[(first + k) * SUMS + c];
  for (u32 many = __ballot_sync(FULL, count > FEW_ROWS); many; many &= many - 1) {
    const int one = __ffs(many) - 1;
    const i64 from = __shfl_sync(FULL, first, one);
    const u32 size = __shfl_sync(FULL, count, one);
    float part[SUMS] = {};
    for (u32 k = lane_of_warp(); k < size; k += 32)
      for (int c = 0; c < SUMS; c++) part[c] += sums[(from + k) * SUMS + c];
    for (int c = 0; c < SUMS; c++) {
      const float total = warp_sum(part[c]);
      if (lane_of_warp() == one) out[c] = total;
    }
  }
}

struct Slopes { float mean[3], log_scale[3], quat[4], logit, screen, radius; };

// dL/d(raw quaternion) from dL/d(rotation).
DEVICE void quaternion_slopes(const Axes &a, const float *D, float *out) {
  const float w = a.q[0], x = a.q[1], y = a.q[2], z = a.q[3];
  const float unit[4] = {2.f * (z * (D[3] - D[1]) + y * (D[2] - D[6]) + x * (D[7] - D[5])),
                         2.f * (y * (D[1] + D[3]) + z * (D[2] + D[6]) + w * (D[7] - D[5]) - 2.f * x * (D[4] + D[8])),
                         2.f * (x * (D[1] + D[3]) + w * (D[2] - D[6]) + z * (D[5] + D[7]) - 2.f * y * (D[0] + D[8])),
                         2.f * (w * (D[3] - D[1]) + x * (D[2] + D[6]) + y * (D[5] + D[7]) - 2.f * z * (D[0] + D[4]))};
  const float along = unit[0] * w + unit[1] * x + unit[2] * y + unit[3] * z;
  for (int k = 0; k < 4; k++) out[k] = (unit[k] - along * a.q[k]) * a.inverse_norm;
}

// From the 2D covariance and the sums over pixels to all parameters but the colours; T is J R.
//   dL/d(centre) = Q [G dx, G dy];  dL/d(cov2d) = D = 1/2 Q M Q, M the second moments of G, Q the conic;
//   dL/dT = 2 D T V;  dL/dV = T^t D T;  dL/d(axes) = 2 dL/dV axes, with V = axes axes^t.
DEVICE Slopes slopes_of(const Axes &axes, const float *mean, float logit, const Extent &e, const float *sums,
                        const Camera &cam, int width, int height) {
  Slopes out;
  const float det = e.cov_xx * e.cov_yy - e.cov_xy * e.cov_xy, inverse = 1.f / det;
  const float qxx = e.cov_yy * inverse, qxy = -(e.cov_xy * inverse), qyy = e.cov_xx * inverse;
  const float sx = qxx * sums[4] + qxy * sums[5], sy = qxy * sums[4] + qyy * sums[5];
  const float a = qxx * sums[6] + qxy * sums[7], b = qxx * sums[7] + qxy * sums[8];
  const float c = qxy * sums[6] + qyy * sums[7], d = qxy * sums[7] + qyy * sums[8];
  const float Dxx = 0.5f * (a * qxx + b * qxy), Dxy = 0.5f * (a * qxy + b * qyy), Dyy = 0.5f * (c * qxy + d * qyy);
  out.radius = published_radius(0.5f * (e.cov_xx + e.cov_yy), det);
  const float across = (float)width * sx, down = (float)height * sy;
  out.screen = 0.5f * sqrtf(across * across + down * down);

  const float *R = cam.rotation;
  float t[3];
  for (int i = 0; i < 3; i++)
    t[i] = R[3 * i] * mean[0] + R[3 * i + 1] * mean[1] + R[3 * i + 2] * mean[2] + cam.translation[i];
  const float iz = 1.f / t[2], ux = t[0] * iz, uy = t[1] * iz;
  const float limit_x = most_slanted(width, cam.fx), limit_y = most_slanted(height, cam.fy);
  const bool free_x = ux >= -limit_x && limit_x >= ux, free_y = uy >= -limit_y && limit_y >= uy;
  const float cx = clampf(ux, -limit_x, limit_x), cy = clampf(uy, -limit_y, limit_y);
  const float j00 = cam.fx * iz, j02 = -(j00 * cx), j11 = cam.fy * iz, j12 = -(j11 * cy);
  float T[6], V[9], DT[6], dT[6], drotation[9];
  for (int i = 0; i < 3; i++) T[i] = R[i] * j00 + R[6 + i] * j02, T[3 + i] = R[3 + i] * j11 + R[6 + i] * j12;
  covariance_of(axes.scaled, V);
  for (int i = 0; i < 3; i++) DT[i] = Dxx * T[i] + Dxy * T[3 + i], DT[3 + i] = Dxy * T[i] + Dyy * T[3 + i];
  for (int r = 0; r < 2; r++)
    for (int k = 0; k < 3; k++)
      dT[3 * r + k] = 2.f * (DT[3 * r] * V[k] + DT[3 * r + 1] * V[3 + k] + DT[3 * r + 2] * V[6 + k]);
  const float *A = axes.scaled;
  for (int k = 0; k < 3; k++) {
    const float first = DT[0] * A[k] + DT[1] * A[3 + k] + DT[2] * A[6 + k];
    const float second = DT[3] * A[k] + DT[4] * A[3 + k] + DT[5] * A[6 + k];
    float along = 0.f;
    for (int r = 0; r < 3; r++) {
      const float by_axis = 2.f * (T[r] * first + T[3 + r] * second);
      along += by_axis * axes.rotation[3 * r + k], drotation[3 * r + k] = by_axis * axes.scale[k];
    }
    out.log_scale[k] = axes.scale[k] * along;
  }
  quaternion_slopes(axes, drotation, out.quat);
  out.logit = sums[3] * (1.f - sigmoid(logit));

  // dL/dJ = dL/dT R^t; J = fx/z (1, 0, -cx), fy/z (0, 1, -cy), cx and cy fixed where clamped.
  float d00 = 0.f, d02 = 0.f, d11 = 0.f, d12 = 0.f;
  for (int i = 0; i < 3; i++)
    d00 += R[i] * dT[i], d02 += R[6 + i] * dT[i], d11 += R[3 + i] * dT[3 + i], d12 += R[6 + i] * dT[3 + i];
  const float bend_x = cam.fx * (d02 * iz * iz), bend_y = cam.fy * (d12 * iz * iz);
  const float dx = cam.fx * (sx * iz) - (free_x ? bend_x : 0.f), dy = cam.fy * (sy * iz) - (free_y ? bend_y : 0.f);
  const float dz = -((cam.fx * (sx * ux) + cam.fy * (sy * uy)) * iz) - (cam.fx * d00 + cam.fy * d11) * iz * iz +
                   bend_x * cx + (free_x ? bend_x * cx : 0.f) + bend_y * cy + (free_y ? bend_y * cy : 0.f);
  for (int i = 0; i < 3; i++) out.mean[i] = R[i] * dx + R[3 + i] * dy + R[6 + i] * dz;
  return out;
}

// Of antialiased splats: what comes through ln(opacity) = ... + 1/2 ln det S - 1/2 ln det W, see the CPU's add_dimming.
DEVICE void add_dimming(const Extent &e, float *sums) {
  const float xx = e.cov_xx - BLUR, xy = e.cov_xy, yy = e.cov_yy - BLUR, det = xx * yy - xy * xy;
  const float inverse = BLUR / fmaxf(det, 1e-30f), slope = det > 0.f ? BLUR * sums[3] : 0.f;
  sums[6] += slope * (1.f + inverse * yy), sums[7] -= slope * (inverse * xy), sums[8] += slope * (1.f + inverse * xx);
}

// Through the viewing direction: what the colours add to dL/d(mean).
DEVICE void add_color_slopes(const Parameters &p, u32 i, const float *mean, const float *center, const float *along,
                             float *slopes) {
  const Direction to = direction_to(mean, center);
  const float *row = p.sh + (size_t)i * p.coefficients * 3;
  float shade[16], slope[3];
#pragma unroll
  for (int k = 0; k < 16; k++)
    shade[k] = k < p.active ? along[0] * row[3 * k] + along[1] * row[3 * k + 1] + along[2] * row[3 * k + 2] : 0.f;
  basis_slopes(to, p.active, shade, slope);
  const float radial = slope[0] * to.x + slope[1] * to.y + slope[2] * to.z;
  slopes[0] += (slope[0] - radial * to.x) * to.inverse_distance;
  slopes[1] += (slope[1] - radial * to.y) * to.inverse_distance;
  slopes[2] += (slope[2] - radial * to.z) * to.inverse_distance;
}

// row_ends: of each Gaussian's rows of `sums`. Gradients as the parameters; along (n, 3): dL/d(colour), 0 where a colour
// was cut at zero; screen and radii as `kernels.training.Gradients`. Zero where a Gaussian is not seen.
KERNEL parameter_gradients(const float *means, const float *log_scales, const float *quats, const float *logits,
                           const float *sh, u32 n, int coefficients, int active, const Camera *camera, int width,
                           int height, int antialiased, const Extent *extents, const float4 *colors, const u32 *counts,
                           const i64 *row_ends, const float *sums, float *by_means, float *by_log_scales,
                           float *by_quats, float *by_logits, float *along, float *screen, float *radii) {
  const u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  const u32 count = i < n ? counts[i] : 0;
  float total[SUMS];
  add_rows(sums, count ? row_ends[i] - count : 0, count, total);
  if (i >= n) return;
  const size_t at = i;
  Slopes g = {};
  float by_color[3] = {};
  if (count) {
    const Parameters p = {means, log_scales, quats, logits, sh, n, coefficients, active};
    const float mean[3] = {means[3 * at], means[3 * at + 1], means[3 * at + 2]};
    const Extent e = extents[i];
    const float4 color = colors[i];
    if (antialiased) add_dimming(e, total);
    g = slopes_of(axes_of(p, i), mean, logits[i], e, total, *camera, width, height);
    by_color[0] = color.x > 0.f ? total[0] : 0.f, by_color[1] = color.y > 0.f ? total[1] : 0.f;
    by_color[2] = color.z > 0.f ? total[2] : 0.f;
    add_color_slopes(p, i, mean, camera->center, by_color, g.mean);
  }
  for (int c = 0; c < 3; c++)
    by_means[3 * at + c] = g.mean[c], by_log_scales[3 * at + c] = g.log_scale[c], along[3 * at + c] = by_color[c];
  for (int c = 0; c < 4; c++) by_quats[4 * at + c] = g.quat[c];
  by_logits[i] = g.logit, screen[i] = g.screen, radii[i] = g.radius;
}

// --- Adam ----------------------------------------------------------------------------------------

struct AdamStep { float beta1, beta2, root_correction, epsilon; };

DEVICE void adam(float rate, float g, float *parameter, float *first, float *second, const AdamStep &s) {
  const float m = s.beta1 * *first + (1.f - s.beta1) * g, v = s.beta2 * *second + (1.f - s.beta2) * g * g;
  *first = m, *second = v;
  *parameter -= rate * m / (sqrtf(v) * s.root_correction + s.epsilon);
}

// Means, logarithms of scales, quaternions and logits: 11 numbers of each Gaussian. Rates carry the bias correction.
KERNEL adam_shapes(u32 n, float *means, float *log_scales, float *quats, float *logits, const float *by_means,
                   const float *by_log_scales, const float *by_quats, const float *by_logits, float *first_means,
                   float *first_log_scales, float *first_quats, float *first_logits, float *second_means,
                   float *second_log_scales, float *second_quats, float *second_logits, float means_rate,
                   float log_scales_rate, float quats_rate, float logits_rate, float beta1, float beta2,
                   float root_correction, float epsilon) {
  const AdamStep s = {beta1, beta2, root_correction, epsilon};
  const size_t N = n;
  for (size_t i = (size_t)blockIdx.x * blockDim.x + threadIdx.x; i < 11 * N; i += (size_t)gridDim.x * blockDim.x) {
    if (i < 3 * N) {
      adam(means_rate, by_means[i], means + i, first_means + i, second_means + i, s);
    } else if (i < 6 * N) {
      const size_t at = i - 3 * N;
      adam(log_scales_rate, by_log_scales[at], log_scales + at, first_log_scales + at, second_log_scales + at, s);
    } else if (i < 10 * N) {
      const size_t at = i - 6 * N;
      adam(quats_rate, by_quats[at], quats + at, first_quats + at, second_quats + at, s);
    } else {
      const size_t at = i - 10 * N;
      adam(logits_rate, by_logits[at], logits + at, first_logits + at, second_logits + at, s);
    }
  }
}

// Harmonics, of which `active` are used: dL/d(sh[k, c]) = Y_k * along[c], made here and never stored. Those that are
// not used have no moments, so that nothing moves them. means: those of the pass.
constexpr int ADAM_ROWS = 32;

KERNEL __launch_bounds__(256)
    adam_colors(u32 n, int coefficients, int active, const float *means, const Camera *camera, const float *along,
                float *sh, float *first, float *second, float constant_rate, float rate, float beta1,
                float beta2, float root_correction, float epsilon) {
  __shared__ float basis[ADAM_ROWS][17], slopes[ADAM_ROWS][3];
  const AdamStep s = {beta1, beta2, root_correction, epsilon};
  const u32 begin = blockIdx.x * ADAM_ROWS, mine = begin + threadIdx.x;
  if (threadIdx.x < ADAM_ROWS && mine < n) {
    float Y[16];
    const size_t at = 3 * (size_t)mine;
    const float mean[3] = {means[at], means[at + 1], means[at + 2]};
    sh_basis(direction_to(mean, camera->center), active, Y);
#pragma unroll
    for (int k = 0; k < 16; k++)
      if (k < active) basis[threadIdx.x][k] = Y[k];
    for (int c = 0; c < 3; c++) slopes[threadIdx.x][c] = along[at + c];
  }
  __syncthreads();
  const int width = 3 * active, rows = (int)(n - begin < ADAM_ROWS ? n - begin : ADAM_ROWS);
  for (int e = threadIdx.x; e < rows * width; e += 256) {
    const int row = e / width, column = e % width, k = column / 3;
    const size_t at = (size_t)(begin + row) * coefficients * 3 + column;
    adam(k ? rate : constant_rate, basis[row][k] * slopes[row][column % 3], sh + at, first + at, second + at, s);
  }
}
