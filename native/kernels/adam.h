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
    for (int i = 0; i < 16; i++) rates[i] = s.row && i < kAdamHead ? s.head_rate : s.rate;
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

// The first `count` numbers of a row. In one place, so that no compiler fuses multiplications here and not there.
static inline void step_row(float *parameter, const float *gradient, float *first, float *second, size_t count,
                            const AdamLanes &s) {
  for (size_t i = 0; i < count; i += 16)
    step_some(parameter + i, gradient ? gradient + i : nullptr, first + i, second + i,
              count - i < 16 ? (uint32_t)(count - i) : 16, i ? s.rate : s.head, s);
}

// All numbers are one row where none has a head.
static void adam(float *parameter, const float *gradient, float *first, float *second, size_t begin, size_t end,
                 const AdamStep &step) {
  const AdamLanes s(step);
  const size_t row = step.row ? step.row : end - begin;
  for (size_t at = begin; at < end; at += row) step_row(parameter + at, gradient + at, first + at, second + at, row, s);
}

}  // namespace drsplat::DRSPLAT_ISA
