// Every hot kernel, compiled once per instruction set into a namespace of that name.
#include "kernels.h"
#include "mixture_kernels.h"

#include <stdlib.h>
#include <string.h>
#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#endif

#define DRSPLAT_TEXT(x) #x
#define DRSPLAT_STRING(x) DRSPLAT_TEXT(x)

namespace drsplat {
namespace DRSPLAT_ISA {

#include "lanes.h"
#include "projection.h"
#include "compositing.h"
#include "colors.h"
#include "algebra.h"
#include "gradients.h"
#include "optimization.h"
#include "mixture.h"

extern const ScanKernels scan_table;  // scan_kernels.cpp
extern const Kernels table;
const Kernels table = {
    DRSPLAT_STRING(DRSPLAT_ISA), project, tile_spans, tile_weights, tile_contributions, tile_render, sh_colors, weighted_rows, pq_encode, pq_scores,
    activate, splat_colors, tile_forward, tile_backward, splats_backward, ssim_rows, ssim_partials, loss_gradient, adam, &scan_table, &mixture_kernels};

}  // namespace DRSPLAT_ISA
}  // namespace drsplat
