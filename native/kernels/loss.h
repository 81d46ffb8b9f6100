// The photometric loss of 3DGS, (1 - w) L1 + w (1 - SSIM), with its gradient.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

constexpr int kWindow = 11, kReach = kWindow / 2;  // Gaussian window, sigma 1.5
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;

struct Window {
  float w[kReach + 1];  // from an end to the middle
  Window() {
    double total = 0, raw[kWindow];
    for (int i = 0; i < kWindow; i++) total += raw[i] = __builtin_exp(-(i - kReach) * (i - kReach) / (2 * 1.5 * 1.5));
    for (int i = 0; i <= kReach; i++) w[i] = (float)(raw[i] / total);
  }
  __attribute__((always_inline)) Floats at(int i) const { return splat(w[i <= kReach ? i : kWindow - 1 - i]); }
};

// Sixteen numbers of which the first n count, the others become 0.
INLINE Floats first_lanes(Floats a, int n) {
  if (n >= 16) return a;
  float kept[16];
  store(kept, a);
  for (int i = n; i < 16; i++) kept[i] = 0;
  return load(kept);
}

// Rows of pixels have their three colours side by side: what is one pixel away lies three numbers away, and a blur
// never asks which colour it blurs. A padded row has kBefore zeros in front and as many behind.
constexpr int kBefore = 16, kCompared = 4, kSlopes = 3;
static_assert(kBefore > 3 * kReach && kLossRow == 2 * kBefore, "room for the window beyond both ends");

// The last kWindow rows of a running blur, `planes` of each: row y takes the place of row y - kWindow.
struct RecentRows {
  float *rows;
  size_t stride;
  int planes;

  float *row(int y) const { return rows + (size_t)(y % kWindow) * stride * (size_t)planes; }
};

INLINE void blur_row(const Window &g, const float *padded, float *out, int size) {
  const float *first = padded + kBefore - 3 * kReach;
  for (int x = 0; x < size; x += 16) {
    Floats s = splat(0.f);
    for (int k = 0; k < kWindow; k++) s = s + g.at(k) * load(first + x + 3 * k);
    store(out + x, s);
  }
}

// The vertical half, of the rows about y that the image has.
template <int kPlanes>
struct Column {
  const float *rows[kWindow];
  Floats weights[kWindow];

  Column(const Window &g, const RecentRows &recent, int y, int height) {
    for (int k = 0; k < kWindow; k++) {
      const int row = y + k - kReach;
      const bool inside = row >= 0 && row < height;
      rows[k] = recent.row(inside ? row : y), weights[k] = inside ? g.at(k) : splat(0.f);
    }
  }
  __attribute__((always_inline)) void blur(size_t stride, int x, Floats *out) const {
    for (int i = 0; i < kPlanes; i++) out[i] = splat(0.f);
    for (int k = 0; k < kWindow; k++)
      for (int i = 0; i < kPlanes; i++) out[i] = out[i] + weights[k] * load(rows[k] + (size_t)i * stride + x);
  }
};

// A row of both images, the sum of their squares and their product, blurred along the row.
static inline void compare_row(const Window &g, const LossImages &of, int y, float *padded, size_t stride, float *out) {
  const int size = 3 * of.width;
  const float *image = of.image + (size_t)y * size, *target = of.target + (size_t)y * size;
  float *rows[kCompared];
  for (int i = 0; i < kCompared; i++) rows[i] = padded + (size_t)i * (stride + kLossRow);
  for (int x = 0; x < size; x += 16) {
    const uint32_t n = (uint32_t)(size - x);
    const Floats a = load_some(image + x, n), b = load_some(target + x, n);
    const Floats planes[kCompared] = {a, b, a * a + b * b, a * b};
    for (int i = 0; i < kCompared; i++) store(rows[i] + kBefore + x, planes[i]);
  }
  for (int i = 0; i < kCompared; i++) blur_row(g, rows[i], out + (size_t)i * stride, size);
}

// The sum of a row's SSIM, and its derivatives by the blurred image, its square and the product, blurred along the row.
static inline double ssim_row(const Window &g, const RecentRows &compared, const LossImages &of, int y, float *padded,
                              float *out) {
  const size_t stride = compared.stride;
  const Column<kCompared> column(g, compared, y, of.height);
  const Floats c1 = splat(kC1), c2 = splat(kC2), two = splat(2.f), one = splat(1.f);
  const int size = 3 * of.width;
  float *rows[kSlopes];
  for (int i = 0; i < kSlopes; i++) rows[i] = padded + (size_t)i * (stride + kLossRow);
  Floats total = splat(0.f);
  for (int x = 0; x < size; x += 16) {
    Floats blurred[kCompared];
    column.blur(stride, x, blurred);
    const int n = size - x;
    const Floats a = blurred[0], b = blurred[1], aa = a * a, bb = b * b, ab = a * b;
    const Floats top1 = two * ab + c1, top2 = two * (blurred[3] - ab) + c2;
    const Floats low1 = aa + bb + c1, low2 = blurred[2] - (aa + bb) + c2;
    const Floats inverse = one / (low1 * low2), ssim = top1 * top2 * inverse;
    const Floats by_product = two * top1 * inverse, by_square = splat(0.f) - ssim * low1 * inverse;
    const Floats by_mean = two * b * (top2 - top1) * inverse - two * a * ssim * (low2 - low1) * inverse;
    total = total + first_lanes(ssim, n);
    store(rows[0] + kBefore + x, first_lanes(by_mean, n)), store(rows[1] + kBefore + x, first_lanes(by_square, n)),
        store(rows[2] + kBefore + x, first_lanes(by_product, n));
  }
  for (int i = 0; i < kSlopes; i++) blur_row(g, rows[i], out + (size_t)i * stride, size);
  return (double)sum(total);
}

// A row of the loss's gradient: the vertical half of the transposed blur. Returns the sum of |image - target|.
static inline double gradient_row(const Window &g, const RecentRows &slopes, const LossImages &of, int y,
                                  float *gradient) {
  const Column<kSlopes> column(g, slopes, y, of.height);
  const float share = 1.f / (3.f * (float)of.width * (float)of.height), l1 = (1 - of.ssim_weight) * share,
              structure = -of.ssim_weight * share;
  const int size = 3 * of.width;
  const size_t first = (size_t)y * size;
  Floats total = splat(0.f);
  for (int x = 0; x < size; x += 16) {
    Floats blurred[kSlopes];
    column.blur(slopes.stride, x, blurred);
    const int n = size - x;
    const Floats a = load_some(of.image + first + x, (uint32_t)n), b = load_some(of.target + first + x, (uint32_t)n);
    const Floats difference = a - b, none = splat(0.f);
    const Floats up = keep(none < difference, splat(1.f)), down = keep(difference < none, splat(1.f));
    total = total + maximum(difference, -difference);
    store_some(gradient + first + x,
               l1 * (up - down) + structure * (blurred[0] + 2.f * (a * blurred[1]) + b * blurred[2]), (uint32_t)n);
  }
  return (double)sum(total);
}

// Rows of the gradient, with the sums of |image - target| and of SSIM in each. All blurs run down the image together,
// so that what is still needed of them stays in the cache; a band works out again what it needs of rows beyond its own.
static void loss_rows(const LossImages &of, float *scratch, int begin, int end, float *gradient, double *l1,
                      double *ssim) {
  const Window g;
  const size_t stride = loss_stride(of.width);
  float *const padded = scratch;
  const RecentRows compared = {padded + kCompared * (stride + kLossRow), stride, kCompared};
  const RecentRows slopes = {compared.rows + kWindow * kCompared * stride, stride, kSlopes};
  memset(padded, 0, kCompared * (stride + kLossRow) * sizeof(float));  // their margins stay so
  for (int y = begin - 2 * kReach < 0 ? 0 : begin - 2 * kReach; y < end + 2 * kReach; y++) {
    if (y < of.height) compare_row(g, of, y, padded, stride, compared.row(y));
    const int middle = y - kReach, done = middle - kReach;
    if (middle >= 0 && middle < of.height && middle >= begin - kReach) {
      const double total = ssim_row(g, compared, of, middle, padded, slopes.row(middle));
      if (middle >= begin && middle < end) ssim[middle] = total;
    }
    if (done >= begin && done < end) l1[done] = gradient_row(g, slopes, of, done, gradient);
  }
}

}  // namespace drsplat::DRSPLAT_ISA
