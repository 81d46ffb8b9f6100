// How likely pairs of regions belong together.
#pragma once
#include "kernels/doubles.h"
#include "kernels/photo_kernels.h"

namespace drsplat::DRSPLAT_ISA {

constexpr double kDigits = 1e6;  // that count: the last bits depend on the processor
constexpr uint32_t kMostFeatures = 64;

INLINE Doubles within(Doubles x, double most) { return at_most(at_least(x, splat_double(-most)), splat_double(most)); }

INLINE Doubles hyperbolic_tangent(Doubles x) {
  const Doubles power = exponential(within(x + x, 40));
  return splat_double(1) - splat_double(2) / (power + splat_double(1));
}

static inline double logit_of(const PairRule &rule, const double *features) {
  double scaled[kMostFeatures];
  for (uint32_t f = 0; f < rule.features; f++) {
    const double away = (features[f] - rule.center[f]) / rule.width[f];
    scaled[f] = away < -5 ? -5 : away > 5 ? 5 : away;
  }
  Doubles logit = splat_double(0);
  for (uint32_t u = 0; u < rule.units; u += kDoubles) {
    Doubles sum = load(rule.hidden_bias + u);
    for (uint32_t f = 0; f < rule.features; f++)
      sum = sum + splat_double(scaled[f]) * load(rule.hidden + (size_t)f * rule.units + u);
    logit = logit + hyperbolic_tangent(sum) * load(rule.output + u);
  }
  double lanes[kDoubles], total = rule.output_bias;
  store(lanes, logit);
  for (int i = 0; i < kDoubles; i++) total += lanes[i];
  return total;
}

static void pair_likelihoods(const PairRule &rule, const double *features, size_t pairs, double *likelihoods) {
  for (size_t p = 0; p < pairs; p += kDoubles) {
    double lanes[kDoubles] = {};
    const size_t count = pairs - p < kDoubles ? pairs - p : kDoubles;
    for (size_t i = 0; i < count; i++) lanes[i] = logit_of(rule, features + (p + i) * rule.features);
    const Doubles power = exponential(within(splat_double(0) - load(lanes), 40));
    const Doubles likely = splat_double(1) / (splat_double(1) + power);
    store(lanes, rounded(likely * splat_double(kDigits)) / splat_double(kDigits));
    for (size_t i = 0; i < count; i++) likelihoods[p + i] = lanes[i];
  }
}

}  // namespace drsplat::DRSPLAT_ISA
