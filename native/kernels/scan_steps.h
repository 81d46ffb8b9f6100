// Tables in whole numbers: an entry is rounded to a whole number of steps above the lowest of its table. Sums of those
// are exact, so that a score has the same bits whichever way, and in whichever order, they are added up.
#pragma once
#include "kernels/isa.h"
#include "kernels/scan_kernels.h"

namespace drsplat::DRSPLAT_ISA {

constexpr uint32_t kChunk = 256;            // sub-vectors whose sum fits 31 bits, and its digits 16
constexpr float kMaxSteps = (1 << 23) - 2;  // of one entry; digits of 7, 8 and 8 bits hold them

struct Range { float low, width; };
struct Scale { float step, bias; };  // score = bias + step * sum

static Range range_of(const float *table) {
  float low[16], high[16];
  for (int i = 0; i < 16; i++) low[i] = high[i] = table[i];
  for (int c = 16; c < 256; c += 16)
    for (int i = 0; i < 16; i++) {
      const float entry = table[c + i];
      low[i] = low[i] < entry ? low[i] : entry, high[i] = high[i] > entry ? high[i] : entry;
    }
  for (int i = 1; i < 16; i++)
    low[0] = low[0] < low[i] ? low[0] : low[i], high[0] = high[0] > high[i] ? high[0] : high[i];
  return {low[0], high[0] - low[0]};
}

// The width that `rank` others exceed; ranks are few.
static float ranked_width(const Range *ranges, uint32_t subvectors, uint32_t rank) {
  float bound = __builtin_inff();
  for (uint32_t seen = 0; seen <= rank;) {
    float next = -1.f;
    uint32_t equal = 0;
    for (uint32_t m = 0; m < subvectors; m++) {
      const float width = ranges[m].width;
      if (width < bound && width > next) next = width, equal = 1;
      else if (width == next) equal++;
    }
    if (next < 0) return 0.f;
    bound = next, seen += equal;
  }
  return bound;
}

static float step_of(const Range *ranges, uint32_t subvectors, Precision precision) {
  const float finest = ranked_width(ranges, subvectors, 0) / kMaxSteps;
  // Half a step for each: never off by more than 0.95 error, and by less where more costs next to nothing.
  float step = 1.9f * precision.error / (float)(subvectors < 32 ? 32 : subvectors);
  if (precision.wide) {
    const float largest = precision.error / (6.f * __builtin_sqrtf((float)subvectors / 12.f));
    step = ranked_width(ranges, subvectors, precision.wide) / 255.f;
    if (!(step <= largest)) step = largest;
    if (step < 0.01f * largest) step = 0.01f * largest;
  }
  if (step < finest) step = finest;
  return step > 0 ? step : 1.f;
}

// Of one query; `ranges`: of each sub-vector, written.
static Scale scale_of(const float *tables, uint32_t subvectors, Precision precision, Range *ranges) {
  double bias = 0;
  for (uint32_t m = 0; m < subvectors; m++) ranges[m] = range_of(tables + 256 * (size_t)m), bias += ranges[m].low;
  return {step_of(ranges, subvectors, precision), (float)bias};
}

}  // namespace drsplat::DRSPLAT_ISA
