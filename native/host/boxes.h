// Oriented boxes about sets of Gaussians.
#pragma once
#include <cstdint>

namespace drsplat {

// Means, 3 each; unit quaternions, wxyz; scales, 3 each; opacities.
struct Solids { const float *means, *quats, *scales, *mass; };

struct BoxRule {
  double outliers;   // of a set's mass, cut off at each end of each axis
  double strays;     // of a set's mass at each end of each axis: no more is left out before
  double sparse;     // how many times less mass per length than the set has a tail that is left out
  const double *up;  // a unit direction in which boxes stand, or none
};

// The box of each set: ids[starts[s]] ... ids[starts[s + 1] - 1], at least one. Writes 3 numbers of the centre, 9 of
// the axes by rows and 3 of the lengths along them for each. The same bits for any number of threads.
void boxes(const Solids &, const int64_t *starts, const int64_t *ids, uint64_t sets, const BoxRule &, int threads,
           double *centers, double *axes, double *lengths);

}  // namespace drsplat
