// One view, start to end: project, sort by depth, bin into tiles, then do something per tile.
#pragma once
#include "host/tiling.h"

namespace drsplat {

struct ViewTriples {  // sorted by (Gaussian, segment)
  std::vector<uint32_t> gaussian_ids;
  std::vector<int32_t> segment_ids;
  std::vector<float> weights;
};

ViewTriples view_weights(const Kernels &, const Scene &, const Camera &, const Selection &, const int32_t *segment_ids,
                         int threads, StageSeconds &);
void topk_contributions(const Kernels &, const Scene &, const Camera &, const Selection &, int threads, int32_t *ids,
                        float *weights);
void render(const Kernels &, const Scene &, const Camera &, const float *values, int32_t channels,
            const float *background, int threads, float *image, float *alpha, float *depth);
void sh_colors(const Kernels &, const float *sh, int32_t coefficients, const float *means, const float *center,
               uint32_t count, int threads, float *colors);

}  // namespace drsplat
