// The Adam step.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

// One Adam step of some numbers, in place; a null gradient is 0. rate and epsilon carry the bias corrections (Kingma &
// Ba 2015, end of Sec. 2).
INLINE void step_numbers(float *parameter, const float *gradient, float *first, float *second, size_t count,
                         Floats rate, const AdamStep &s) {
  for (size_t at = 0; at < count; at += 16) {
    const uint32_t n = count - at < 16 ? (uint32_t)(count - at) : 16;
    const Floats g = gradient ? load_some(gradient + at, n) : splat(0.f);
    const Floats m = s.beta1 * load_some(first + at, n) + (1 - s.beta1) * g,
                 v = s.beta2 * load_some(second + at, n) + (1 - s.beta2) * g * g;
    store_some(first + at, m, n), store_some(second + at, v, n);
    const Floats change = rate * m / (square_root(v) * splat(s.root_correction) + splat(s.epsilon));
    store_some(parameter + at, load_some(parameter + at, n) - change, n);
  }
}

// The first `count` numbers of a row; the head has a rate of its own.
INLINE void step_row(float *parameter, const float *gradient, float *first, float *second, int count,
                     const AdamStep &s) {
  float rates[16];
  for (int i = 0; i < 16; i++) rates[i] = i < kAdamHead ? s.head_rate : s.rate;
  const size_t begun = count < 16 ? (size_t)count : 16;
  step_numbers(parameter, gradient, first, second, begun, load(rates), s);
  if (count > 16)
    step_numbers(parameter + 16, gradient ? gradient + 16 : nullptr, first + 16, second + 16, (size_t)count - 16,
                 splat(s.rate), s);
}

static void adam(float *parameter, const float *gradient, float *first, float *second, size_t begin, size_t end,
                 const AdamStep &s) {
  if (!s.row)
    return step_numbers(parameter + begin, gradient + begin, first + begin, second + begin, end - begin, splat(s.rate),
                        s);
  for (size_t at = begin; at < end; at += s.row)
    step_row(parameter + at, gradient + at, first + at, second + at, (int)s.row, s);
}

}  // namespace drsplat::DRSPLAT_ISA
