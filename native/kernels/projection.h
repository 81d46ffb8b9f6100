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

// Tile columns that the ellipse d^T cov^-1 d <= reach touches within sixteen tile rows from `row` on: its extreme x in
// one is at the dy of its overall extreme where the row holds that, else at the row's nearer edge. Writes first and one
// after the last, within [x0, x1).
INLINE void spans_in_rows(const Splat &g, const Extent &e, int row, int32_t *first, int32_t *last) {
  static const float kRows[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  const Floats above = (splat((float)row) + load(kRows)) * splat(16.f) + splat(0.5f - g.y);
  const Floats top = maximum(above, splat(-e.half_height)), bottom = minimum(above + splat(15.f), splat(e.half_height));
  const float at_extreme = e.half_width * e.cov_xy / e.cov_xx, inverse = 1.f / e.cov_yy, slope = e.cov_xy * inverse,
              scale = (e.cov_xx * e.cov_yy - e.cov_xy * e.cov_xy) * inverse, origin = g.x - 0.5f;
  const Floats right_y = maximum(minimum(splat(at_extreme), bottom), top),
               left_y = maximum(minimum(splat(-at_extreme), bottom), top);
  const Floats right_2 = (splat(e.reach) - right_y * right_y * splat(inverse)) * splat(scale),
               left_2 = (splat(e.reach) - left_y * left_y * splat(inverse)) * splat(scale);
  const Floats right = right_y * splat(slope) + square_root(maximum(right_2, splat(0.f))),
               left = left_y * splat(slope) - square_root(maximum(left_2, splat(0.f)));
  const Floats low = splat((float)e.x0), high = splat((float)e.x1);
  const Floats begin = (splat(origin) + left) * splat(1 / 16.f) - splat(1e-3f),
               end = (splat(origin) + right) * splat(1 / 16.f) + splat(1.001f);
  const Ints from = truncate(minimum(maximum(begin, low), high)),  // rounds down, as none is below 0
      to = truncate(minimum(maximum(end, low), high));
  store_int(first, from);
  store_int(last, select((from < to) & (bottom >= top), to, from));
}

// Hands out, for every splat and every tile row of its rectangle, which tiles it may touch: next[row] is where the
// row's next span goes. Numbers splats from `begin` on.
static void tile_spans(const Splat *splats, const Extent *extents, uint32_t begin, uint32_t end, TileSpan *spans,
                       uint32_t *next) {
  for (uint32_t i = begin; i < end; i++) {
    const Extent &e = extents[i];
    int32_t first[16], last[16];
    uint32_t before = 0;
    for (int row = e.y0; row < e.y1; row += 16) {
      spans_in_rows(splats[i], e, row, first, last);
      for (int r = 0; r < 16 && row + r < e.y1; r++) {
        spans[next[row + r]++] = {i, (uint16_t)first[r], (uint16_t)last[r], before};
        before += (uint32_t)(last[r] - first[r]);
      }
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
