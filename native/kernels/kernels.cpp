// Every hot kernel, compiled once per instruction set into a namespace of that name.
#include "kernels/kernels.h"

#include "kernels/activation.h"
#include "kernels/adam.h"
#include "kernels/best_kept.h"
#include "kernels/colors.h"
#include "kernels/compositing.h"
#include "kernels/dense_rows.h"
#include "kernels/gradients.h"
#include "kernels/loss.h"
#include "kernels/photo_colors.h"
#include "kernels/photo_network.h"
#include "kernels/photo_rule.h"
#include "kernels/pq.h"
#include "kernels/projection.h"
#include "kernels/training_tiles.h"
#include "kernels/weighted_rows.h"

#define DRSPLAT_TEXT(x) #x
#define DRSPLAT_STRING(x) DRSPLAT_TEXT(x)

namespace drsplat::DRSPLAT_ISA {

static const PhotoKernels photo_kernels = {lab_colors, convolve_row, depthwise_row, pair_likelihoods};

extern const ScanKernels scan_table;  // scan_kernels.cpp
extern const MixtureKernels mixture_table;
extern const Kernels table;
const Kernels table = {DRSPLAT_STRING(DRSPLAT_ISA),
                       project,
                       tile_spans,
                       tile_weights,
                       tile_contributions,
                       tile_render,
                       sh_colors,
                       weighted_rows,
                       dense_rows,
                       pq_encode,
                       keep_best,
                       activate,
                       splat_colors,
                       tile_forward,
                       tile_backward,
                       splats_backward,
                       loss_rows,
                       adam,
                       &scan_table,
                       &mixture_table,
                       &photo_kernels};

}  // namespace drsplat::DRSPLAT_ISA
