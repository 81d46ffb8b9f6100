// The scan kernels, compiled once per instruction set into a namespace of that name.
#include "kernels/scan_kernels.h"

#if defined(__AVX512VBMI__)
#include "kernels/scan_bytes.h"
#else
#include "kernels/scan_integers.h"
#endif
#include "kernels/scan_results.h"

namespace drsplat::DRSPLAT_ISA {

extern const ScanKernels scan_table;
const ScanKernels scan_table = {prepared_bytes, scratch_bytes, prepare, sums, finish, above, compete, lookup_tables};

}  // namespace drsplat::DRSPLAT_ISA
