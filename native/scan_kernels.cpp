// The scan kernels, compiled once per instruction set into a namespace of that name. As in kernels.cpp, no
// std:: template may be instantiated here.
#include "scan.h"

#include <stdint.h>
#include <string.h>
#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#endif

namespace drsplat {
namespace DRSPLAT_ISA {

#define INLINE static inline __attribute__((always_inline))
#if defined(__AVX512VBMI__)
#include "scan_bytes.h"
#else
#include "scan_floats.h"
#endif
#include "scan_results.h"

extern const ScanKernels scan_table;
const ScanKernels scan_table = {prepared_bytes, scratch_bytes, prepare, sums, finish, above, compete, lookup_tables};

}  // namespace DRSPLAT_ISA
}  // namespace drsplat
