#include "host/training.h"
#include "bindings/arrays.h"
#include "bindings/module.h"

#include <nanobind/stl/unique_ptr.h>

#include <cmath>
#include <mutex>

using namespace drsplat;

namespace {

using Pixels = Array<float, 3>;
using Target = nb::ndarray<float, nb::c_contig, nb::device::cpu>;  // written in place

struct ParameterArrays {  // keeps the arrays alive as long as the pass that points into them
  Rows means, log_scales, quats;
  Vector logits;
  Pixels sh;
  bool antialiased;

  Parameters view() const {
    const size_t n = logits.shape(0), k = sh.shape(1);
    require(means.shape(0) == n && means.shape(1) == 3 && log_scales.shape(0) == n && log_scales.shape(1) == 3 &&
                quats.shape(0) == n && quats.shape(1) == 4,
            "means (N, 3), log_scales (N, 3), quats (N, 4), logits (N)");
    require_sh(sh, n);
    require(n < (1u << 31), "fewer than 2^31 Gaussians");
    return {means.data(), log_scales.data(), quats.data(), logits.data(),
            sh.data(),    (uint32_t)n,       (int32_t)k,   antialiased};
  }
};

class Pass {
 public:
  Pass(ParameterArrays arrays, Vector camera, int width, int height, int active, Vector background, int threads,
       const std::string &isa)
      : arrays_(std::move(arrays)), parameters_(arrays_.view()), camera_(camera_of(camera, width, height)) {
    require(background.shape(0) == 3, "background (3)");
    require(active >= 1 && active <= parameters_.coefficients, "active coefficients: 1 to those stored");
    pass_ = std::make_unique<TrainingPass>(kernels_named(isa), parameters_, camera_, active, background.data(),
                                           thread_count(threads));
  }

  nb::tuple forward() {
    const size_t h = camera_.height, w = camera_.width;
    Fresh<float> image(h * w * 3), alpha(h * w);
    {
      nb::gil_scoped_release release;
      const std::lock_guard<std::mutex> lock(one_at_a_time_);
      require(state_ != kDone, "a new pass: this one's gradients are taken");
      state_ = kFresh;
      pass_->forward(image.get(), alpha.get());
      state_ = kForward;
    }
    return nb::make_tuple(image.numpy({h, w, 3}), alpha.numpy({h, w}));
  }

  // After forward, and once: the gradients lie in memory of this pass, which they keep alive.
  nb::tuple backward(nb::handle self, const Pixels &image, const Pixels &gradient) {
    return went_back(self, image, gradient, nullptr);
  }

  nb::tuple backward_and_step(nb::handle self, const Pixels &image, const Pixels &gradient, Target sh, Target first,
                              Target second, const AdamStep &adam) {
    const size_t n = (size_t)parameters_.count * (size_t)parameters_.coefficients * 3;
    require(sh.data() == parameters_.sh && sh.size() == n && first.size() == n && second.size() == n,
            "the harmonics of this pass, and moments of their size");
    const HarmonicsStep step = {sh.data(), first.data(), second.data(), adam};
    return went_back(self, image, gradient, &step);
  }
  nb::dict seconds() const {
    const TrainingSeconds &s = pass_->seconds;
    nb::dict d;
    d["activate"] = s.activate, d["project"] = s.project, d["sort"] = s.sort, d["bin"] = s.bin;
    d["color"] = s.color, d["forward"] = s.forward, d["backward"] = s.backward, d["parameters"] = s.parameters;
    return d;
  }

 private:
  nb::tuple went_back(nb::handle self, const Pixels &image, const Pixels &gradient, const HarmonicsStep *step) {
    const size_t h = camera_.height, w = camera_.width, n = parameters_.count, k = parameters_.coefficients;
    for (const Pixels *p : {&image, &gradient})
      require(p->shape(0) == h && p->shape(1) == w && p->shape(2) == 3, "image and gradient (H, W, 3)");
    GradientArrays out;
    {
      nb::gil_scoped_release release;
      const std::lock_guard<std::mutex> lock(one_at_a_time_);
      require(state_ == kForward,
              state_ == kFresh ? "a forward pass before the backward pass" : "one backward pass for each forward pass");
      state_ = kDone;
      out = pass_->backward(image.data(), gradient.data(), step);
    }
    const auto view = [&](float *data, std::initializer_list<size_t> shape) {
      return nb::cast(nb::ndarray<nb::numpy, float>(data, shape, self));
    };
    return nb::make_tuple(view(out.means, {n, 3}), view(out.log_scales, {n, 3}), view(out.quats, {n, 4}),
                          view(out.logits, {n}), view(out.sh, {n, step ? 0 : k, 3}), view(out.screen, {n}),
                          view(out.radii, {n}));
  }

  ParameterArrays arrays_;
  Parameters parameters_;
  Camera camera_;
  std::unique_ptr<TrainingPass> pass_;
  enum { kFresh, kForward, kDone } state_ = kFresh;
  std::mutex one_at_a_time_;  // Python threads may share a pass; the work is done without the GIL
};

std::unique_ptr<Pass> start_pass(Rows means, Rows log_scales, Rows quats, Vector logits, Pixels sh, bool antialiased,
                                 Vector camera, int width, int height, int active, Vector background, int threads,
                                 const std::string &isa) {
  return std::make_unique<Pass>(ParameterArrays{means, log_scales, quats, logits, sh, antialiased}, camera, width,
                                height, active, background, threads, isa);
}

nb::tuple loss_of(Pixels image, Pixels target, float ssim_weight, int threads, const std::string &isa) {
  const size_t h = image.shape(0), w = image.shape(1);
  require(image.shape(2) == 3 && target.shape(0) == h && target.shape(1) == w && target.shape(2) == 3,
          "image and target (H, W, 3)");
  require(h > 0 && w > 0 && h <= 65536 && w <= 65536, "1 to 65536 pixels a side");
  const Kernels &kernels = kernels_named(isa);
  Fresh<float> gradient(h * w * 3);
  const LossValue value = without_gil([&] {
    return photometric_loss(kernels, image.data(), target.data(), (int)w, (int)h, ssim_weight, thread_count(threads),
                            gradient.get());
  });
  return nb::make_tuple(value.l1, value.ssim, gradient.numpy({h, w, 3}));
}

AdamStep corrected(float rate, int64_t step, float beta1, float beta2, float epsilon, float head_rate, uint32_t row) {
  require(step >= 1, "step 1 or more");
  const double bias1 = 1 - std::pow((double)beta1, (double)step), bias2 = 1 - std::pow((double)beta2, (double)step);
  return {(float)(rate / bias1), beta1, beta2, (float)(1 / std::sqrt(bias2)), epsilon, (float)(head_rate / bias1), row};
}

void adam_of(Target parameter, Vector gradient, Target first, Target second, float rate, int64_t step, float beta1,
             float beta2, float epsilon, float head_rate, uint32_t row, int threads, const std::string &isa) {
  const size_t n = gradient.shape(0);
  require(parameter.size() == n && first.size() == n && second.size() == n, "four arrays of one size");
  require(!row || (row >= kAdamHead && n % row == 0), "whole rows, at least as long as their head");
  const Kernels &kernels = kernels_named(isa);
  const AdamStep s = corrected(rate, step, beta1, beta2, epsilon, head_rate, row);
  nb::gil_scoped_release release;
  adam_step(kernels, parameter.data(), gradient.data(), first.data(), second.data(), n, s, thread_count(threads));
}

}  // namespace

void bind_training(nb::module_ &m) {
  nb::class_<Pass>(m, "TrainingPass")
      .def("forward", &Pass::forward)
      .def(
          "backward",
          [](nb::object self, Pixels image, Pixels gradient) {
            return nb::cast<Pass &>(self).backward(self, image, gradient);
          },
          "image"_a, "gradient"_a)
      .def(
          "backward_and_step",
          [](nb::object self, Pixels image, Pixels gradient, Target sh, Target first, Target second, float rate,
             int64_t step, float beta1, float beta2, float epsilon, float head_rate) {
            return nb::cast<Pass &>(self).backward_and_step(
                self, image, gradient, sh, first, second,
                corrected(rate, step, beta1, beta2, epsilon, head_rate, (uint32_t)(3 * sh.shape(1))));
          },
          "image"_a, "gradient"_a, "sh"_a, "first"_a, "second"_a, "rate"_a, "step"_a, "beta1"_a, "beta2"_a, "epsilon"_a,
          "head_rate"_a)
      .def_prop_ro("seconds", &Pass::seconds);
  m.def("training_pass", &start_pass, "means"_a, "log_scales"_a, "quats"_a, "logits"_a, "sh"_a, "antialiased"_a,
        "camera"_a, "width"_a, "height"_a, "active"_a, "background"_a, "threads"_a, "isa"_a);
  m.def("photometric_loss", &loss_of, "image"_a, "target"_a, "ssim_weight"_a, "threads"_a, "isa"_a);
  m.def("adam_step", &adam_of, "parameter"_a, "gradient"_a, "first"_a, "second"_a, "rate"_a, "step"_a, "beta1"_a,
        "beta2"_a, "epsilon"_a, "head_rate"_a, "row"_a, "threads"_a, "isa"_a);
}
