// 3D Gaussians -> 2D splats, one a thread: the arithmetic of native/kernels/projection.h (docs/method.md 1).
struct Splat { float x, y, xx, xy, yy, log2_opacity, depth, unused; };  // log2(alpha): see log2_alpha

// Where a splat can reach alpha >= 1/255: half extents of that ellipse, its 2D covariance, and the rectangle of tiles
// [x0, x1) x [y0, y1) that it may touch.
struct Extent {
  float half_width, half_height, cov_xx, cov_xy, cov_yy, reach;
  short x0, x1, y0, y1;
};

struct Shape { float mean[3], covariance[6], opacity; };  // xx, xy, xz, yy, yz, zz

// |x / z| beyond which the Jacobian is that at the bound.
DEVICE float most_slanted(int size, float focal) { return 1.3f * 0.5f * (float)size / focal; }

// Pixels that a splat reaches as published: 3 sigma of the longer axis, in whole ones.
DEVICE float published_radius(float mid, float det) {
  return ceilf(fminf(3.f * sqrtf(mid + sqrtf(fmaxf(0.1f, mid * mid - det))), 1e6f));
}

// Tiles of the 3-sigma square (the published rule), intersected with the exact box of alpha >= 1/255.
DEVICE void tile_range(float centre, float radius, float half, int tiles, short &first, short &last) {
  const float bound = 16.f * (float)tiles, pixel = centre - 0.5f;
  const int a = (int)(clampf(pixel - radius, 0.f, bound) / 16.f);
  const int b = (int)(clampf(pixel + radius + 15.f, 0.f, bound) / 16.f);
  const int ta = (int)floorf(clampf(pixel - half, -16.f, bound) / 16.f);
  const int tb = (int)floorf(clampf(pixel + half, -16.f, bound) / 16.f) + 1;
  first = (short)max(a, ta), last = (short)min(b, tb);
}

// False where nothing of it is seen.
DEVICE bool project(const Shape &g, const Camera &c, int width, int height, bool antialiased, Splat &s, Extent &e) {
  const float *R = c.rotation, *m = g.mean;
  const float Z = R[6] * m[0] + R[7] * m[1] + R[8] * m[2] + c.translation[2];
  float opacity = g.opacity;
  if (!(c.near_z < Z) || !(opacity >= MIN_ALPHA)) return false;
  const float X = R[0] * m[0] + R[1] * m[1] + R[2] * m[2] + c.translation[0];
  const float Y = R[3] * m[0] + R[4] * m[1] + R[5] * m[2] + c.translation[1];

  const float iz = 1.f / Z, limit_x = most_slanted(width, c.fx), limit_y = most_slanted(height, c.fy);
  const float tx = clampf(X * iz, -limit_x, limit_x), ty = clampf(Y * iz, -limit_y, limit_y);
  const float j00 = c.fx * iz, j02 = -(j00 * tx), j11 = c.fy * iz, j12 = -(j11 * ty);
  float u[3], v[3];
  for (int i = 0; i < 3; i++) u[i] = j00 * R[i] + j02 * R[6 + i], v[i] = j11 * R[3 + i] + j12 * R[6 + i];
  const float *cov = g.covariance;
  const float su0 = cov[0] * u[0] + cov[1] * u[1] + cov[2] * u[2], su1 = cov[1] * u[0] + cov[3] * u[1] + cov[4] * u[2];
  const float su2 = cov[2] * u[0] + cov[4] * u[1] + cov[5] * u[2];
  const float sv0 = cov[0] * v[0] + cov[1] * v[1] + cov[2] * v[2], sv1 = cov[1] * v[0] + cov[3] * v[1] + cov[4] * v[2];
  const float sv2 = cov[2] * v[0] + cov[4] * v[1] + cov[5] * v[2];
  const float sharp_xx = u[0] * su0 + u[1] * su1 + u[2] * su2, sharp_yy = v[0] * sv0 + v[1] * sv1 + v[2] * sv2;
  const float xx = sharp_xx + BLUR, xy = v[0] * su0 + v[1] * su1 + v[2] * su2, yy = sharp_yy + BLUR;
  const float det = xx * yy - xy * xy;
  if (!(0.f < det) || !(det < 1e30f)) return false;
  if (antialiased) {  // dimmed by what widening adds to its area
    opacity *= sqrtf(clampf((sharp_xx * sharp_yy - xy * xy) / det, 0.f, 1.f));
    if (!(opacity >= MIN_ALPHA)) return false;
  }

  const float radius = published_radius(0.5f * (xx + yy), det);
  s.x = c.fx * X * iz + c.cx, s.y = c.fy * Y * iz + c.cy;
  s.log2_opacity = log2f(opacity), s.depth = Z, s.unused = 0.f;
  e.reach = 2.f / LOG2_E * (s.log2_opacity - LOG2_MIN_ALPHA) + CULL_SLACK;
  e.half_width = sqrtf(e.reach * xx), e.half_height = sqrtf(e.reach * yy);
  tile_range(s.x, radius, e.half_width, (width + 15) / 16, e.x0, e.x1);
  tile_range(s.y, radius, e.half_height, (height + 15) / 16, e.y0, e.y1);
  if (e.x0 >= e.x1 || e.y0 >= e.y1) return false;
  const float inverse = 1.f / det;
  s.xx = -0.5f * LOG2_E * yy * inverse, s.xy = LOG2_E * xy * inverse, s.yy = -0.5f * LOG2_E * xx * inverse;
  e.cov_xx = xx, e.cov_xy = xy, e.cov_yy = yy;
  return true;
}

struct Span { int first, last; };

// Whole tiles at or below x; far outside any image where x is, or is no number.
DEVICE int tile_at(float x) { return x > -1e6f && x < 1e6f ? (int)floorf(x) : x < 0 ? -1000000 : 1000000; }

// Tile columns that the ellipse touches within one row of tiles: its extreme x there is at the dy of its overall
// extreme where the row holds that, else at the row's nearer edge. A splat one tile wide takes that in every row.
DEVICE Span span_in_row(const Splat &g, const Extent &e, int row) {
  if (e.x1 - e.x0 == 1) return {e.x0, e.x1};
  float top = (float)row * 16.f + 0.5f - g.y, bottom = top + 15.f;
  top = fmaxf(top, -e.half_height), bottom = fminf(bottom, e.half_height);
  if (top > bottom) return {0, 0};
  const float at_extreme = e.half_width * e.cov_xy / e.cov_xx;
  const float right_y = clampf(at_extreme, top, bottom), left_y = clampf(-at_extreme, top, bottom);
  const float inverse = 1.f / e.cov_yy, slope = e.cov_xy * inverse;
  const float scale = (e.cov_xx * e.cov_yy - e.cov_xy * e.cov_xy) * inverse;
  const float right = right_y * slope + sqrtf(fmaxf((e.reach - right_y * right_y * inverse) * scale, 0.f));
  const float left = left_y * slope - sqrtf(fmaxf((e.reach - left_y * left_y * inverse) * scale, 0.f));
  const float origin = g.x - 0.5f;
  const int first = max(tile_at((origin + left) / 16.f - 1e-3f), e.x0);
  const int last = min(tile_at((origin + right) / 16.f + 1e-3f) + 1, e.x1);
  return last > first ? Span{first, last} : Span{0, 0};
}

DEVICE u32 tiles_of(const Splat &s, const Extent &e) {
  u32 count = 0;
  for (int row = e.y0; row < e.y1; row++) {
    const Span span = span_in_row(s, e, row);
    count += (u32)(span.last - span.first);
  }
  return count;
}

struct Rows { int first, last; };  // of tiles: those from `last` on, and those before `first`, are not looked at

// keys: order as the depths do, and those that are not seen come last. counts: tiles of each.
DEVICE bool keep_splat(u32 i, const Shape &g, const Camera &c, int width, int height, int antialiased, Rows rows,
                       Splat *splats, Extent *extents, u32 *keys, u32 *counts) {
  Splat s;
  Extent e;
  const bool seen = project(g, c, width, height, antialiased, s, e);
  if (seen) e.y0 = (short)max(e.y0, rows.first), e.y1 = (short)min(e.y1, rows.last);
  const u32 count = seen ? tiles_of(s, e) : 0;
  keys[i] = count ? __float_as_uint(s.depth) : 0xffffffffu, counts[i] = count;
  if (count) splats[i] = s, extents[i] = e;
  return count > 0;
}

// means (3, n), covariances (6, n), opacities (n): of `kernels.splatting.SplatArrays`. Rows [first_row, last_row) of
// tiles are looked at.
KERNEL project_scene(const float *means, const float *covariances, const float *opacities, u32 n, const Camera *camera,
                     int width, int height, int antialiased, int first_row, int last_row, Splat *splats,
                     Extent *extents, u32 *keys, u32 *counts) {
  const u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= n) return;
  Shape g;
  for (size_t a = 0; a < 3; a++) g.mean[a] = means[a * n + i];
  for (size_t a = 0; a < 6; a++) g.covariance[a] = covariances[a * n + i];
  g.opacity = opacities[i];
  keep_splat(i, g, *camera, width, height, antialiased, {first_row, last_row}, splats, extents, keys, counts);
}
