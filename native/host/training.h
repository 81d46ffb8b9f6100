// What an optimiser of a scene needs of one view: forward, loss, backward, Adam.
#pragma once
#include "host/tiling.h"

namespace drsplat {

struct TrainingSeconds {
  double activate = 0, project = 0, sort = 0, bin = 0, color = 0, forward = 0, backward = 0, parameters = 0;
};

// One forward pass, with all that its backward pass needs. The parameters must stay as they are between.
class TrainingPass {
 public:
  TrainingPass(const Kernels &, const Parameters &, const Camera &, int32_t active, const float *background,
               int threads);
  void forward(float *image, float *alpha);
  // The arrays live in the workspace: as long as this pass does.
  // With a step, that of the harmonics is taken at once, and their gradients are not kept.
  GradientArrays backward(const float *image, const float *image_gradient, const HarmonicsStep *step);
  TrainingSeconds seconds;

 private:
  GradientArrays cleared_gradients(bool harmonics);
  Visible visible_of(int thread) const;  // what that thread projected

  const Kernels &kernels_;
  Parameters parameters_;
  Camera camera_;
  int32_t active_;
  float background_[3], center_[3];
  int threads_;
  Lease space_;
};

struct LossValue { double l1, ssim; };

LossValue photometric_loss(const Kernels &, const float *image, const float *target, int width, int height,
                           float ssim_weight, int threads, float *gradient);
void adam_step(const Kernels &, float *parameter, const float *gradient, float *first, float *second, size_t count,
               const AdamStep &, int threads);

}  // namespace drsplat
