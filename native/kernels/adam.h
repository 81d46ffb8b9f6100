// The Adam step.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

struct AdamLanes {  // of a step, for sixteen numbers; `head`: the rates of a row's first sixteen
  Floats rate, head, beta1, beta2, new1, new2, root_correction, epsilon;

  explicit AdamLanes(const AdamStep &s)
      : rate(splat(s.rate)),
        beta1(splat(s.beta1)),
        beta2(splat(s.beta2)),
        new1(splat(1 - s.beta1)),
        new2(splat(1 - s.beta2)),
        root_correction(splat(s.root_correction)),
        epsilon(splat(s.epsilon)) {
    float rates[16];
    for (int i = 0; i < 16; i++) rates[i] = i < kAdamHead ? s.head_rate : s.rate;
    head = load(rates);
  }
};

// One Adam step of up to sixteen numbers, in place; a null gradient is 0. rate and epsilon carry the bias corrections
// (Kingma & Ba 2015, end of Sec. 2).
INLINE void step_some(float *parameter, const float *gradient, float *first, float *second, uint32_t n, Floats rate,
                      const AdamLanes &s) {
  const Floats g = gradient ? load_some(gradient, n) : splat(0.f);
  const Floats m = s.beta1 * load_some(first, n) + s.new1 * g, v = s.beta2 * load_some(second, n) + s.new2 * g * g;
  store_some(first, m, n), store_some(second, v, n);
  const Floats change = rate * m / (square_root(v) * s.root_correction + s.epsilon);
  store_some(parameter, load_some(parameter, n) - change, n);
}

// The first `count` numbers of a row.
INLINE void step_row(float *parameter, const float *gradient, float *first, float *second, uint32_t count,
                     const AdamLanes &s) {
  step_some(parameter, gradient, first, second, count, s.head, s);
  for (uint32_t i = 16; i < count; i += 16)
    step_some(parameter + i, gradient ? gradient + i : nullptr, first + i, second + i, count - i, s.rate, s);
}

static void adam(float *parameter, const float *gradient, float *first, float *second, size_t begin, size_t end,
                 const AdamStep &step) {
  const AdamLanes s(step);
  if (step.row) {
    for (size_t at = begin; at < end; at += step.row)
      step_row(parameter + at, gradient + at, first + at, second + at, step.row, s);
    return;
  }
  for (size_t at = begin; at < end; at += 16)
    step_some(parameter + at, gradient + at, first + at, second + at, end - at < 16 ? (uint32_t)(end - at) : 16, s.rate,
              s);
}

}  // namespace drsplat::DRSPLAT_ISA
