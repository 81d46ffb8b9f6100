#include "host/training.h"

#include <cstring>

namespace drsplat {

TrainingPass::TrainingPass(const Kernels &kernels, const Parameters &parameters, const Camera &camera, int32_t active,
                           const float *background, int threads)
    : kernels_(kernels), parameters_(parameters), camera_(camera), active_(active), threads_(threads), space_(threads) {
  std::copy_n(background, 3, background_);
  for (int a = 0; a < 3; a++) {
    center_[a] = 0;
    for (int b = 0; b < 3; b++) center_[a] -= camera.rotation[3 * b + a] * camera.translation[b];
  }
}

void TrainingPass::forward(float *image, float *alpha) {
  Workspace &w = *space_;
  const size_t n = parameters_.count;
  const double t0 = now();
  grow(w.scene, 10 * n);
  float *means = w.scene.data(), *covariances = means + 3 * n, *opacities = means + 9 * n;
  over_parts(parameters_.count, threads_, [&](int, uint32_t begin, uint32_t end) {
    kernels_.activate(parameters_, begin, end, means, covariances, opacities);
  });
  seconds.activate = now() - t0;
  const StageSeconds s =
      prepare(w, kernels_, {means, covariances, opacities, parameters_.count, parameters_.antialiased}, camera_,
              threads_, true);
  seconds.project = s.project, seconds.sort = s.sort, seconds.bin = s.bin;
  const double t1 = now();
  grow(w.colors, 3 * (size_t)w.visible);
  parallel(threads_,
           [&](int t) { kernels_.splat_colors(visible_of(t), parameters_, active_, center_, w.colors.data()); });
  const double t2 = now();
  grow(w.blocks, (size_t)w.tile_start[w.columns * w.rows] + 1);
  each_tile(w, camera_, threads_, [&](int t, int i, const Tile &tile) {
    kernels_.tile_forward(tile, w.colors.data(), background_, w.workers[t]->scratch, image, alpha,
                          w.blocks.data() + w.tile_start[i]);
  });
  seconds.color = t2 - t1, seconds.forward = now() - t2;
}

Visible TrainingPass::visible_of(int thread) const {
  const uint32_t begin = part_start(parameters_.count, threads_, thread),
                 end = part_start(parameters_.count, threads_, thread + 1);
  return {space_->projected.data() + begin,
          space_->projected_extents.data() + begin,
          space_->ranks.data() + begin,
          space_->rows_start.data() + begin,
          space_->projected_counts[thread],
          begin,
          end};
}

GradientArrays TrainingPass::cleared_gradients(bool harmonics) {
  const size_t n = parameters_.count, sh = harmonics ? 3 * (size_t)parameters_.coefficients : 0,
               sizes[7] = {3 * n, 3 * n, 4 * n, n, sh * n, n, n}, total = (13 + sh) * n;
  Kept<float> &all = space_->gradients;
  grow(all, total);
  over_parts(total, threads_,
             [&](int, size_t begin, size_t end) { std::fill(all.data() + begin, all.data() + end, 0.f); });
  float *at[7], *next = all.data();
  for (int i = 0; i < 7; i++) at[i] = next, next += sizes[i];
  return {at[0], at[1], at[2], at[3], at[4], at[5], at[6]};
}

GradientArrays TrainingPass::backward(const float *image, const float *image_gradient, const HarmonicsStep *step) {
  Workspace &w = *space_;
  const double t0 = now();
  grow(w.sums, (size_t)w.tile_start[w.columns * w.rows] * kSplatSums + 1);
  each_tile(w, camera_, threads_, [&](int t, int i, const Tile &tile) {
    kernels_.tile_backward(tile, w.blocks.data() + w.tile_start[i], w.rows_of_list.data() + w.tile_start[i],
                           w.colors.data(), image, image_gradient, w.workers[t]->scratch, w.sums.data());
  });
  const double t1 = now();
  const GradientArrays out = cleared_gradients(!step);
  parallel(threads_, [&](int t) {
    kernels_.splats_backward(visible_of(t), w.sums.data(), parameters_, camera_, active_, center_, out, step);
  });
  seconds.backward = t1 - t0, seconds.parameters = now() - t1;
  return out;
}

LossValue photometric_loss(const Kernels &kernels, const float *image, const float *target, int width, int height,
                           float ssim_weight, int threads, float *gradient) {
  std::vector<double> l1_rows(height), ssim_rows(height);
  over_parts(height, threads, [&](int, int begin, int end) {
    static thread_local Kept<float> scratch;
    grow(scratch, loss_scratch(width));
    kernels.loss_rows({image, target, width, height, ssim_weight}, scratch.data(), begin, end, gradient, l1_rows.data(),
                      ssim_rows.data());
  });
  LossValue value = {0, 0};
  for (double x : l1_rows) value.l1 += x;
  for (double x : ssim_rows) value.ssim += x;
  const double count = 3.0 * width * height;
  return {value.l1 / count, value.ssim / count};
}

void adam_step(const Kernels &kernels, float *parameter, const float *gradient, float *first, float *second,
               size_t count, const AdamStep &step, int threads) {
  const int parts = count < 65536 ? 1 : threads;
  const size_t row = step.row ? step.row : 1, rows = count / row;
  over_parts(rows, parts, [&](int, size_t begin, size_t end) {
    kernels.adam(parameter, gradient, first, second, begin * row, end * row, step);
  });
}

}  // namespace drsplat
