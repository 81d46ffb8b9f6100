// Eight double lanes on any instruction set, and what the rule of `graph` needs of them.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

typedef double DoublePart __attribute__((vector_size(kVectorBytes)));
typedef int64_t LongPart __attribute__((vector_size(kVectorBytes)));
typedef double LooseDoubles __attribute__((vector_size(kVectorBytes), aligned(8), may_alias));

constexpr int kDoubles = 8;
constexpr double kToWhole = 0x1.8p52;  // plus this, minus this: rounded to whole numbers

struct Doubles { DoublePart part[kParts]; };

#define EACH_PART(statement) \
  for (int i = 0; i < kParts; i++) statement
#define DOUBLES(value)          \
  Doubles r;                    \
  EACH_PART(r.part[i] = value); \
  return r

INLINE Doubles splat_double(double x) { DOUBLES(x - DoublePart{}); }
INLINE Doubles load(const double *p) { DOUBLES(((const LooseDoubles *)p)[i]); }
INLINE void store(double *p, Doubles a) { EACH_PART(((LooseDoubles *)p)[i] = a.part[i]); }
INLINE Doubles operator+(Doubles a, Doubles b) { DOUBLES(a.part[i] + b.part[i]); }
INLINE Doubles operator-(Doubles a, Doubles b) { DOUBLES(a.part[i] - b.part[i]); }
INLINE Doubles operator*(Doubles a, Doubles b) { DOUBLES(a.part[i] * b.part[i]); }
INLINE Doubles operator/(Doubles a, Doubles b) { DOUBLES(a.part[i] / b.part[i]); }
INLINE Doubles at_least(Doubles a, Doubles least) { DOUBLES(a.part[i] > least.part[i] ? a.part[i] : least.part[i]); }
INLINE Doubles at_most(Doubles a, Doubles most) { DOUBLES(a.part[i] < most.part[i] ? a.part[i] : most.part[i]); }
INLINE Doubles rounded(Doubles a) { DOUBLES(a.part[i] + kToWhole - kToWhole); }

// e^x for |x| up to 700, in the last bits wrong: by the series about the nearest multiple of ln 2.
INLINE Doubles exponential(Doubles x) {
  const Doubles shifted = x * splat_double(0x1.71547652b82fep+0) + splat_double(kToWhole);
  const Doubles power = shifted - splat_double(kToWhole);
  const Doubles rest = x - power * splat_double(0x1.62e42fefa39efp-1) - power * splat_double(0x1.abc9e3b39803fp-56);
  Doubles sum = splat_double(1), doubled = splat_double(1);
  for (int k = 13; k > 0; k--) sum = splat_double(1) + sum * rest * splat_double(1.0 / k);
  EACH_PART(doubled.part[i] = (DoublePart)(((LongPart)shifted.part[i] << 52) + (LongPart)doubled.part[i]));
  return sum * doubled;
}
#undef DOUBLES
#undef EACH_PART

}  // namespace drsplat::DRSPLAT_ISA
