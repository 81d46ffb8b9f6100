// The photometric loss of 3DGS, (1 - w) L1 + w (1 - SSIM), with its gradient: native/kernels/loss.h, a block for each
// 16x16 pixels. Where `unused` marks a pixel, the image is its own target and learns nothing.
constexpr int REACH = 5, WINDOW = 2 * REACH + 1, SIDE = TILE + 2 * REACH;
constexpr float C1 = 0.01f * 0.01f, C2 = 0.03f * 0.03f;

struct Photo {
  const u8 *pixels, *unused;  // (height, width, 3), (height, width) or null
};

DEVICE float target_at(const Photo &photo, const float *image, size_t pixel, int channel) {
  const float seen = image[pixel * 3 + channel];
  return photo.unused && photo.unused[pixel] ? seen : (float)photo.pixels[pixel * 3 + channel] * (1.f / 255);
}

struct Square {  // 16x16 pixels of a block, and the one of a thread in it
  int left, top, lx, ly;
  bool inside;
  size_t at;
};

DEVICE Square square_of_thread(int width, int height) {
  const int columns = (width + TILE - 1) / TILE, left = blockIdx.x % columns * TILE, top = blockIdx.x / columns * TILE;
  const int lx = threadIdx.x % TILE, ly = threadIdx.x / TILE, x = left + lx, y = top + ly;
  return {left, top, lx, ly, x < width && y < height, (size_t)y * width + x};
}

// The sum of one number of each of 256 threads, in thread 0.
DEVICE double block_sum(double value) {
  __shared__ double of_warps[8];
  value = warp_sum_double(value);
  __syncthreads();
  if (lane_of_warp() == 0) of_warps[warp_of_block()] = value;
  __syncthreads();
  double total = 0;
  for (int w = 0; w < 8; w++) total += of_warps[w];
  return total;
}

// The vertical half of a blur: rows y to y + 10 of column x.
DEVICE float blur_down(const float (*plane)[TILE], const float *window, int y, int x) {
  float sum = 0.f;
#pragma unroll
  for (int k = 0; k < WINDOW; k++) sum += window[k] * plane[y + k][x];
  return sum;
}

// partials (9, height, width): derivatives of SSIM by the blurred image, its square and the product, for each channel.
// sums: a double for each block.
KERNEL __launch_bounds__(256)
    ssim_partials(const float *image, const u8 *pixels, const u8 *unused, int width, int height, const float *window,
                  float *partials, double *sums) {
  __shared__ float a[SIDE][SIDE], b[SIDE][SIDE], across[5][SIDE][TILE], w[WINDOW];
  const Photo photo = {pixels, unused};
  const auto [left, top, lx, ly, inside, at] = square_of_thread(width, height);
  const size_t plane = (size_t)width * height;
  if (threadIdx.x < WINDOW) w[threadIdx.x] = window[threadIdx.x];
  double total = 0;
  for (int c = 0; c < 3; c++) {
    __syncthreads();
    for (int i = threadIdx.x; i < SIDE * SIDE; i += 256) {
      const int px = left + i % SIDE - REACH, py = top + i / SIDE - REACH;
      const bool there = px >= 0 && px < width && py >= 0 && py < height;
      const size_t pixel = there ? (size_t)py * width + px : 0;
      a[i / SIDE][i % SIDE] = there ? image[pixel * 3 + c] : 0.f;
      b[i / SIDE][i % SIDE] = there ? target_at(photo, image, pixel, c) : 0.f;
    }
    __syncthreads();
    for (int i = threadIdx.x; i < SIDE * TILE; i += 256) {
      const int row = i / TILE, column = i % TILE;
      float s[5] = {};
#pragma unroll
      for (int k = 0; k < WINDOW; k++) {
        const float p = a[row][column + k], q = b[row][column + k];
        s[0] += w[k] * p, s[1] += w[k] * q, s[2] += w[k] * (p * p), s[3] += w[k] * (q * q), s[4] += w[k] * (p * q);
      }
      for (int k = 0; k < 5; k++) across[k][row][column] = s[k];
    }
    __syncthreads();
    if (!inside) continue;
    const float p = blur_down(across[0], w, ly, lx), q = blur_down(across[1], w, ly, lx);
    const float pp = p * p, qq = q * q, pq = p * q;
    const float top1 = 2.f * pq + C1, top2 = 2.f * (blur_down(across[4], w, ly, lx) - pq) + C2;
    const float low1 = pp + qq + C1;
    const float low2 = (blur_down(across[2], w, ly, lx) - pp) + (blur_down(across[3], w, ly, lx) - qq) + C2;
    const float inverse = 1.f / (low1 * low2), ssim = top1 * top2 * inverse;
    partials[(0 * 3 + c) * plane + at] =
        2.f * q * (top2 - top1) * inverse - 2.f * p * ssim * (1.f / low1 - 1.f / low2);
    partials[(1 * 3 + c) * plane + at] = -(ssim / low2), partials[(2 * 3 + c) * plane + at] = 2.f * top1 * inverse;
    total += (double)ssim;
  }
  total = block_sum(total);
  if (threadIdx.x == 0) sums[blockIdx.x] = total;
}

// gradient (height, width, 3): of the loss by the image. sums: of |image - target|, a double for each block.
KERNEL __launch_bounds__(256)
    loss_gradient(const float *image, const u8 *pixels, const u8 *unused, int width, int height, const float *window,
                  const float *partials, float ssim_weight, float *gradient, double *sums) {
  __shared__ float planes[3][SIDE][SIDE], across[3][SIDE][TILE], w[WINDOW];
  const Photo photo = {pixels, unused};
  const auto [left, top, lx, ly, inside, at] = square_of_thread(width, height);
  const size_t plane = (size_t)width * height;
  const float share = 1.f / (3.f * (float)width * (float)height), l1 = (1.f - ssim_weight) * share;
  if (threadIdx.x < WINDOW) w[threadIdx.x] = window[threadIdx.x];
  double total = 0;
  for (int c = 0; c < 3; c++) {
    __syncthreads();
    for (int i = threadIdx.x; i < SIDE * SIDE; i += 256) {
      const int px = left + i % SIDE - REACH, py = top + i / SIDE - REACH;
      const bool there = px >= 0 && px < width && py >= 0 && py < height;
      const size_t pixel = there ? (size_t)py * width + px : 0;
      for (int k = 0; k < 3; k++) planes[k][i / SIDE][i % SIDE] = there ? partials[(k * 3 + c) * plane + pixel] : 0.f;
    }
    __syncthreads();
    for (int i = threadIdx.x; i < SIDE * TILE; i += 256) {
      const int row = i / TILE, column = i % TILE;
      float s[3] = {};
#pragma unroll
      for (int k = 0; k < WINDOW; k++)
        for (int m = 0; m < 3; m++) s[m] += w[k] * planes[m][row][column + k];
      for (int m = 0; m < 3; m++) across[m][row][column] = s[m];
    }
    __syncthreads();
    if (!inside) continue;
    const float p = image[at * 3 + c], q = target_at(photo, image, at, c), difference = p - q;
    const float rise = blur_down(across[0], w, ly, lx) + 2.f * (p * blur_down(across[1], w, ly, lx)) +
                       q * blur_down(across[2], w, ly, lx);
    const float sign = difference > 0.f ? 1.f : difference < 0.f ? -1.f : 0.f;
    const bool learns = !(photo.unused && photo.unused[at]);
    gradient[at * 3 + c] = learns ? l1 * sign - ssim_weight * share * rise : 0.f;
    total += (double)fabsf(difference);
  }
  total = block_sum(total);
  if (threadIdx.x == 0) sums[blockIdx.x] = total;
}

// totals: of each of the rows of `sums`, added up in a fixed order by one block of 256 threads each.
KERNEL __launch_bounds__(256) add_blocks(const double *sums, int count, double *totals) {
  double total = 0;
  for (int i = threadIdx.x; i < count; i += 256) total += sums[(size_t)blockIdx.x * count + i];
  total = block_sum(total);
  if (threadIdx.x == 0) totals[blockIdx.x] = total;
}
