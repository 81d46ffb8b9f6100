// The photometric loss of 3DGS, (1 - w) L1 + w (1 - SSIM), with its gradient.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

constexpr int kWindow = 11, kReach = kWindow / 2;  // Gaussian window, sigma 1.5
constexpr int kBlurred = 4;                        // planes of each channel; three more on the way back
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;

struct Window {
  float w[kWindow];
  Window() {
    double total = 0, raw[kWindow];
    for (int i = 0; i < kWindow; i++) total += raw[i] = __builtin_exp(-(i - kReach) * (i - kReach) / (2 * 1.5 * 1.5));
    for (int i = 0; i < kWindow; i++) w[i] = (float)(raw[i] / total);
  }
};

// Sixteen numbers of which the first n count, the others become 0.
INLINE Floats first_lanes(Floats a, int n) {
  if (n >= 16) return a;
  float kept[16];
  store(kept, a);
  for (int i = n; i < 16; i++) kept[i] = 0;
  return load(kept);
}

static inline float *plane_of(const LossPlanes &p, int i, int channel) {
  return p.planes + (size_t)(i * 3 + channel) * p.stride * (size_t)p.height;
}

// One row, zero beyond its ends: `padded` has kReach zeros in front and 16 + kReach behind.
static inline void blur_row(const Window &g, const float *padded, float *out, int width) {
  for (int x = 0; x < width; x += 16) {
    Floats s = splat(0.f);
    for (int k = 0; k < kWindow; k++) s = s + splat(g.w[k]) * load(padded + x + k);
    store(out + x, s);
  }
}

// The vertical half: 16 columns at x of row y, from a plane of `stride` floats a row.
INLINE Floats blur_column(const Window &g, const float *plane, size_t stride, int height, int y, int x) {
  Floats s = splat(0.f);
  if (y >= kReach && y + kReach < height) {
    const float *first = plane + (size_t)(y - kReach) * stride + x;
    for (int k = 0; k < kWindow; k++) s = s + splat(g.w[k]) * load(first + (size_t)k * stride);
    return s;
  }
  for (int k = 0; k < kWindow; k++) {
    const int row = y + k - kReach;
    if (row >= 0 && row < height) s = s + splat(g.w[k]) * load(plane + (size_t)row * stride + x);
  }
  return s;
}

// Rows of one channel of two images as planes: both, the sum of their squares and their product, blurred along the row.
static void ssim_rows(const float *image, const float *target, const LossPlanes &p, int row_begin, int row_end) {
  const Window g;
  float *padded = p.scratch, *rows[kBlurred];
  for (int i = 0; i < kBlurred; i++) rows[i] = padded + (size_t)i * (p.stride + 32);
  memset(padded, 0, kBlurred * (p.stride + 32) * sizeof(float));
  for (int y = row_begin; y < row_end; y++)
    for (int c = 0; c < 3; c++) {
      for (int x = 0; x < p.width; x++) {
        const size_t at = ((size_t)y * p.width + x) * 3 + c;
        const float a = image[at], b = target[at];
        rows[0][kReach + x] = a, rows[1][kReach + x] = b, rows[2][kReach + x] = a * a + b * b,
                         rows[3][kReach + x] = a * b;
      }
      for (int i = 0; i < kBlurred; i++) blur_row(g, rows[i], plane_of(p, i, c) + (size_t)y * p.stride, p.width);
    }
}

// SSIM of each pixel and its derivatives by the blurred image, its square and the product, which are
// blurred along the row at once. Sums of SSIM go to row_sums, one per row and channel.
static void ssim_partials(const LossPlanes &p, int row_begin, int row_end, double *row_sums) {
  const Window g;
  const Floats c1 = splat(kC1), c2 = splat(kC2), two = splat(2.f), one = splat(1.f);
  float *rows[3];
  for (int i = 0; i < 3; i++) rows[i] = p.scratch + (size_t)i * (p.stride + 32);
  memset(p.scratch, 0, 3 * (p.stride + 32) * sizeof(float));
  for (int y = row_begin; y < row_end; y++)
    for (int c = 0; c < 3; c++) {
      Floats total = splat(0.f);
      for (int x = 0; x < p.width; x += 16) {
        const int n = p.width - x;
        const auto blurred = [&](int i) { return blur_column(g, plane_of(p, i, c), p.stride, p.height, y, x); };
        const Floats a = blurred(0), b = blurred(1), aa = a * a, bb = b * b, ab = a * b;
        const Floats top1 = two * ab + c1, top2 = two * (blurred(3) - ab) + c2;
        const Floats low1 = aa + bb + c1, low2 = blurred(2) - (aa + bb) + c2;
        const Floats inverse = one / (low1 * low2), ssim = top1 * top2 * inverse;
        const Floats by_product = two * top1 * inverse;
        const Floats by_square = splat(0.f) - ssim / low2;
        const Floats by_mean = two * b * (top2 - top1) * inverse - two * a * ssim * (one / low1 - one / low2);
        total = total + first_lanes(ssim, n);
        store(rows[0] + kReach + x, first_lanes(by_mean, n)), store(rows[1] + kReach + x, first_lanes(by_square, n)),
            store(rows[2] + kReach + x, first_lanes(by_product, n));
      }
      row_sums[y * 3 + c] = (double)sum(total);
      for (int i = 0; i < 3; i++) blur_row(g, rows[i], plane_of(p, kBlurred + i, c) + (size_t)y * p.stride, p.width);
    }
}

// The vertical half of the transposed blur, and the loss's gradient; row_sums of |image - target|.
static void loss_gradient(const float *image, const float *target, const LossPlanes &p, float ssim_weight,
                          int row_begin, int row_end, float *gradient, double *row_sums) {
  const Window g;
  const float share = 1.f / (3.f * (float)p.width * (float)p.height), l1 = (1 - ssim_weight) * share,
              structure = -ssim_weight * share;
  for (int y = row_begin; y < row_end; y++)
    for (int c = 0; c < 3; c++) {
      Floats total = splat(0.f);
      for (int x = 0; x < p.width; x += 16) {
        const int n = p.width - x < 16 ? p.width - x : 16;
        const size_t first = ((size_t)y * p.width + x) * 3 + c;
        float pixels[2][16] = {}, slopes[16];
        for (int i = 0; i < n; i++) pixels[0][i] = image[first + 3 * i], pixels[1][i] = target[first + 3 * i];
        const auto blurred = [&](int i) {
          return blur_column(g, plane_of(p, kBlurred + i, c), p.stride, p.height, y, x);
        };
        const Floats a = load(pixels[0]), b = load(pixels[1]), difference = a - b, none = splat(0.f);
        const Floats up = keep(none < difference, splat(1.f)), down = keep(difference < none, splat(1.f));
        total = total + maximum(difference, -difference);
        store(slopes, l1 * (up - down) + structure * (blurred(0) + 2.f * (a * blurred(1)) + b * blurred(2)));
        for (int i = 0; i < n; i++) gradient[first + 3 * i] = slopes[i];
      }
      row_sums[y * 3 + c] = (double)sum(total);
    }
}

}  // namespace drsplat::DRSPLAT_ISA
