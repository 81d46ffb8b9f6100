// 3D Gaussians -> 2D splats, sixteen at a time. 3DGS "EWA" projection with its conventions (method.md 1).
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

constexpr float kMinAlpha = 1.f / 255, kBlur = 0.3f, kLog2E = 1.44269504f;
constexpr float kLog2MinAlpha = -7.99435344f;
constexpr float kCullSlack = 1e-4f;  // keeps every cull on the safe side of float rounding

INLINE Floats clamp(Floats a, float low, float high) { return minimum(maximum(a, splat(low)), splat(high)); }

// |x / z| beyond which the Jacobian is that at the bound: 1.3 times the field of view, symmetric about the axis.
INLINE float most_slanted(int32_t size, float focal) { return 1.3f * 0.5f * (float)size / focal; }

// Pixels that a splat reaches as published: 3 sigma of the longer axis, in whole ones.
INLINE Floats published_radius(Floats mid, Floats det) {
  const Floats three_sigma = splat(3.f) * square_root(mid + square_root(maximum(splat(0.1f), mid * mid - det)));
  const Floats rounded = floor_of(minimum(three_sigma, splat(1e6f)));
  return select(rounded < three_sigma, rounded + splat(1.f), rounded);  // ceil
}

struct Projected {  // sixteen lanes of Splat and Extent, plus who survived
  Floats splat[6], depth, extent[6];
  Ints x0, x1, y0, y1;
  uint32_t visible;
};

// Tiles of the 3-sigma square (the published rule), intersected with the exact box of alpha >= 1/255.
INLINE void tile_range(Floats centre, Floats radius, Floats half, int tiles, Ints &first, Ints &last) {
  const Floats tile = splat(1.f / 16), bound = splat(16.f * (float)tiles);
  Floats pixel = centre - splat(0.5f), zero = splat(0.f);
  Floats low = minimum(maximum(pixel - radius, zero), bound),
         high = minimum(maximum(pixel + radius + splat(15.f), zero), bound);
  Floats tight_low = minimum(maximum(pixel - half, splat(-16.f)), bound),
         tight_high = minimum(maximum(pixel + half, splat(-16.f)), bound);
  Ints a = truncate(low * tile), b = truncate(high * tile);
  Ints ta = truncate(floor_of(tight_low * tile)), tb = truncate(floor_of(tight_high * tile)) + splat_int(1);
  first = select(a < ta, ta, a);
  last = select(tb < b, tb, b);
}

// Factor on the opacity of an antialiased splat: sqrt(det(cov2d) / det(cov2d + kBlur I)), from the entries of cov2d and
// the widened determinant. Between 0 and 1, also where rounding leaves no determinant.
INLINE Floats dimming(Floats xx, Floats xy, Floats yy, Floats widened) {
  return square_root(minimum(maximum((xx * yy - xy * xy) / widened, splat(0.f)), splat(1.f)));
}

template <bool kAntialiased>
INLINE Projected project_lanes(const Scene &s, const Camera &c, uint32_t at, uint32_t n) {
  Projected out;
  const size_t N = s.count;
  const float *R = c.rotation;
  const Floats mx = load_some(s.means + at, n), my = load_some(s.means + N + at, n),
               mz = load_some(s.means + 2 * N + at, n);
  Floats opacity = load_some(s.opacities + at, n);
  const Floats Z = splat(R[6]) * mx + splat(R[7]) * my + splat(R[8]) * mz + splat(c.translation[2]);
  Mask seen = (splat(c.near_z) < Z) & (opacity >= splat(kMinAlpha));
  out.visible = 0;
  if (!any(seen)) return out;
  const Floats X = splat(R[0]) * mx + splat(R[1]) * my + splat(R[2]) * mz + splat(c.translation[0]);
  const Floats Y = splat(R[3]) * mx + splat(R[4]) * my + splat(R[5]) * mz + splat(c.translation[1]);

  // Jacobian of the projection, taken at the clamped point.
  const Floats iz = splat(1.f) / Z;
  const float limit_x = most_slanted(c.width, c.fx), limit_y = most_slanted(c.height, c.fy);
  const Floats tx = clamp(X * iz, -limit_x, limit_x), ty = clamp(Y * iz, -limit_y, limit_y);
  const Floats j00 = splat(c.fx) * iz, j02 = splat(0.f) - j00 * tx, j11 = splat(c.fy) * iz, j12 = splat(0.f) - j11 * ty;
  Floats u[3], v[3], cov[6];
  for (int i = 0; i < 3; i++) {
    u[i] = j00 * splat(R[i]) + j02 * splat(R[6 + i]);
    v[i] = j11 * splat(R[3 + i]) + j12 * splat(R[6 + i]);
  }
  for (int i = 0; i < 6; i++) cov[i] = load_some(s.covariances + i * N + at, n);
  const Floats su0 = cov[0] * u[0] + cov[1] * u[1] + cov[2] * u[2], su1 = cov[1] * u[0] + cov[3] * u[1] + cov[4] * u[2];
  const Floats su2 = cov[2] * u[0] + cov[4] * u[1] + cov[5] * u[2];
  const Floats sv0 = cov[0] * v[0] + cov[1] * v[1] + cov[2] * v[2], sv1 = cov[1] * v[0] + cov[3] * v[1] + cov[4] * v[2];
  const Floats sv2 = cov[2] * v[0] + cov[4] * v[1] + cov[5] * v[2];
  const Floats xx = u[0] * su0 + u[1] * su1 + u[2] * su2 + splat(kBlur), xy = v[0] * su0 + v[1] * su1 + v[2] * su2;
  const Floats yy = v[0] * sv0 + v[1] * sv1 + v[2] * sv2 + splat(kBlur);
  const Floats det = xx * yy - xy * xy;
  seen = seen & (splat(0.f) < det) & (det < splat(1e30f));
  if constexpr (kAntialiased) {
    const Floats sharp_xx = u[0] * su0 + u[1] * su1 + u[2] * su2, sharp_yy = v[0] * sv0 + v[1] * sv1 + v[2] * sv2;
    opacity = opacity * dimming(sharp_xx, xy, sharp_yy, det);
    seen = seen & (opacity >= splat(kMinAlpha));
  }
  if (!any(seen)) return out;

  const Floats radius = published_radius(splat(0.5f) * (xx + yy), det);
  const Floats x = splat(c.fx) * X * iz + splat(c.cx), y = splat(c.fy) * Y * iz + splat(c.cy);
  const Floats log2_opacity = log2_of(maximum(opacity, splat(kMinAlpha)));
  const Floats reach = splat(2.f / kLog2E) * (log2_opacity - splat(kLog2MinAlpha)) + splat(kCullSlack);
  const Floats half_width = square_root(reach * xx), half_height = square_root(reach * yy);
  tile_range(x, radius, half_width, (c.width + 15) / 16, out.x0, out.x1);
  tile_range(y, radius, half_height, (c.height + 15) / 16, out.y0, out.y1);
  seen = seen & (out.x0 < out.x1) & (out.y0 < out.y1);

  const Floats inverse = splat(1.f) / det;
  out.splat[0] = x;
  out.splat[1] = y;
  out.splat[2] = splat(-0.5f * kLog2E) * yy * inverse;
  out.splat[3] = splat(kLog2E) * xy * inverse;
  out.splat[4] = splat(-0.5f * kLog2E) * xx * inverse;
  out.splat[5] = log2_opacity;
  out.depth = Z;
  const Floats extent[6] = {half_width, half_height, xx, xy, yy, reach};
  memcpy(out.extent, extent, sizeof extent);
  out.visible = lanes_of(seen) & (n >= 16 ? 0xffffu : (1u << n) - 1);
  return out;
}

template <bool kAntialiased>
static uint32_t project_as(const Scene &scene, const Camera &camera, uint32_t begin, uint32_t end, Splat *splats,
                           Extent *extents) {
  uint32_t written = 0;
  for (uint32_t at = begin; at < end; at += 16) {
    const Projected p = project_lanes<kAntialiased>(scene, camera, at, end - at);
    for (uint32_t m = p.visible; m; m &= m - 1) {
      const int i = __builtin_ctz(m);
      splats[written] = {lane(p.splat[0], i),
                         lane(p.splat[1], i),
                         lane(p.splat[2], i),
                         lane(p.splat[3], i),
                         lane(p.splat[4], i),
                         lane(p.splat[5], i),
                         at + i,
                         lane(p.depth, i)};
      const auto tile = [i](const Ints &a) { return (int16_t)((const int32_t *)&a)[i]; };
      extents[written++] = {
          lane(p.extent[0], i), lane(p.extent[1], i), lane(p.extent[2], i), lane(p.extent[3], i), lane(p.extent[4], i),
          lane(p.extent[5], i), tile(p.x0),           tile(p.x1),           tile(p.y0),           tile(p.y1)};
    }
  }
  return written;
}

// Two functions, so that scenes that are not antialiased keep every bit, whatever multiplications a compiler fuses.
static uint32_t project(const Scene &scene, const Camera &camera, uint32_t begin, uint32_t end, Splat *splats,
                        Extent *extents) {
  return (scene.antialiased ? project_as<true> : project_as<false>)(scene, camera, begin, end, splats, extents);
}

struct TileSpan { int first, last; };

// Whole tiles at or below x; far outside any image where x is, or is no number.
static inline int tile_at(float x) {
  return x > -1e6f && x < 1e6f ? (int)__builtin_floorf(x) : x < 0 ? -1000000 : 1000000;
}

INLINE float clamped(float x, float low, float high) {  // without a branch, which is not to be foreseen
  const float below = x < high ? x : high;
  return below > low ? below : low;
}

// Tile columns that the ellipse d^T cov^-1 d <= reach touches within one tile row: its extreme x there
// is at the dy of its overall extreme where the row holds that, else at the row's nearer edge.
static inline TileSpan span_in_row(const Splat &g, const Extent &e, int row) {
  float top = (float)row * 16.f + 0.5f - g.y, bottom = top + 15.f;
  top = top > -e.half_height ? top : -e.half_height;
  bottom = bottom < e.half_height ? bottom : e.half_height;
  if (top > bottom) return {0, 0};
  const float at_extreme = e.half_width * e.cov_xy / e.cov_xx;
  const float right_y = clamped(at_extreme, top, bottom), left_y = clamped(-at_extreme, top, bottom);
  const float inverse = 1.f / e.cov_yy, slope = e.cov_xy * inverse,
              scale = (e.cov_xx * e.cov_yy - e.cov_xy * e.cov_xy) * inverse;
  const float right_2 = (e.reach - right_y * right_y * inverse) * scale,
              left_2 = (e.reach - left_y * left_y * inverse) * scale;
  const float right = right_y * slope + __builtin_sqrtf(right_2 > 0 ? right_2 : 0.f);
  const float left = left_y * slope - __builtin_sqrtf(left_2 > 0 ? left_2 : 0.f);
  const float origin = g.x - 0.5f;
  const int first = tile_at((origin + left) * (1 / 16.f) - 1e-3f);
  const int last = tile_at((origin + right) * (1 / 16.f) + 1e-3f) + 1;
  const TileSpan span = {first > e.x0 ? first : e.x0, last < e.x1 ? last : e.x1};
  return span.last > span.first ? span : TileSpan{0, 0};
}

// Writes, for every splat and every tile row of its rectangle, first | last << 16. Adds to `changes`, one more than
// there are tiles, by how much more splats touch a tile than the one before.
static uint32_t *tile_spans(const Splat *splats, const Extent *extents, uint32_t count, int32_t columns,
                            uint32_t *spans, uint32_t *changes) {
  for (uint32_t i = 0; i < count; i++) {
    const Extent &e = extents[i];
    const bool narrow = e.x1 - e.x0 == 1;
    for (int row = e.y0; row < e.y1; row++) {
      const TileSpan s = narrow ? TileSpan{e.x0, e.x1} : span_in_row(splats[i], e, row);
      *spans++ = (uint32_t)s.first | (uint32_t)s.last << 16;
      changes[(size_t)row * columns + s.first]++, changes[(size_t)row * columns + s.last]--;
    }
  }
  return spans;
}

}  // namespace drsplat::DRSPLAT_ISA
