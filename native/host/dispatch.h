// The kernels for this machine, picked at run time.
#pragma once
#include "kernels/kernels.h"

namespace drsplat {

// Every instruction set that this build holds and this machine runs, best first; null at the end.
const Kernels *const *available_kernels();
// By name, or the best for "" (which the variable DRSPLAT_ISA overrides); null if it is not available.
const Kernels *find_kernels(const char *name);

}  // namespace drsplat
