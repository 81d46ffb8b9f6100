// The kernels of scans and mixtures, compiled once per instruction set into a namespace of that name.
#include "kernels/scan_kernels.h"

#include "kernels/mixture_best.h"
#include "kernels/mixture_encoding.h"
#include "kernels/mixture_scan.h"
#include "kernels/mixture_search.h"
#if defined(__AVX512VBMI__)
#include "kernels/scan_bytes.h"
#else
#include "kernels/scan_integers.h"
#endif
#include "kernels/scan_results.h"

namespace drsplat::DRSPLAT_ISA {

extern const ScanKernels scan_table;
const ScanKernels scan_table = {prepared_bytes, scratch_bytes, prepare, sums, finish, above, compete, lookup_tables};

extern const MixtureKernels mixture_table;
const MixtureKernels mixture_table = {mixture_encode, nearest_centres, nearest_members, score_table,
                                      table_place,    mixture_scores,  mixture_best,    kTileQueries};

}  // namespace drsplat::DRSPLAT_ISA
