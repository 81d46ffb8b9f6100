// The Adam step.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

INLINE float adam_change(float rate, float first, float second, const AdamStep &s) {
  return rate * first / (__builtin_sqrtf(second) * s.root_correction + s.epsilon);
}

static inline void adam_at_one_rate(float *parameter, const float *gradient, float *first, float *second, size_t count,
                                    const AdamStep &s) {
  for (size_t i = 0; i < count; i++) {
    const float g = gradient[i], m = s.beta1 * first[i] + (1 - s.beta1) * g,
                v = s.beta2 * second[i] + (1 - s.beta2) * g * g;
    first[i] = m, second[i] = v;
    parameter[i] -= adam_change(s.rate, m, v, s);
  }
}

static inline void copy_heads(const float *rows, size_t row, size_t count, float *heads) {
  for (size_t i = 0; i < count; i++)
    for (int c = 0; c < kAdamHead; c++) heads[i * kAdamHead + c] = rows[i * row + c];
}

// One Adam step, in place. rate and epsilon carry the bias corrections (Kingma & Ba 2015, end of Sec. 2).
// Heads are stepped with their row and then once more, from where they were: of sixteen rows at a time,
// because a few numbers in a row are too few for a vector.
static void adam(float *parameter, const float *gradient, float *first, float *second, size_t begin, size_t end,
                 const AdamStep &s) {
  if (!s.row)
    return adam_at_one_rate(parameter + begin, gradient + begin, first + begin, second + begin, end - begin, s);
  float heads[16 * kAdamHead], firsts[16 * kAdamHead], seconds[16 * kAdamHead];
  const size_t sixteen = (size_t)16 * s.row;
  for (size_t at = begin; at < end; at += sixteen) {
    const size_t size = end - at < sixteen ? end - at : sixteen, rows = size / s.row;
    copy_heads(parameter + at, s.row, rows, heads);
    adam_at_one_rate(parameter + at, gradient + at, first + at, second + at, size, s);
    copy_heads(first + at, s.row, rows, firsts), copy_heads(second + at, s.row, rows, seconds);
    for (size_t i = 0; i < rows * kAdamHead; i++) heads[i] -= adam_change(s.head_rate, firsts[i], seconds[i], s);
    for (size_t i = 0; i < rows; i++)
      for (int c = 0; c < kAdamHead; c++) parameter[at + i * s.row + c] = heads[i * kAdamHead + c];
  }
}

}  // namespace drsplat::DRSPLAT_ISA
