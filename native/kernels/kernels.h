// What the hot kernels and the rest of the core say to each other: plain data and a table of functions.
//
// Conventions: pixel (0, 0) has its centre at (0.5, 0.5); OpenCV camera axes; tiles of 16x16 pixels,
// blocks of 8x2 pixels (16 lanes) inside a tile.
#pragma once
#include <cstddef>
#include <cstdint>

#include "kernels/buffer.h"

namespace drsplat {

struct Camera {
  float rotation[9], translation[3];  // x_cam = rotation * x_world + translation
  float fx, fy, cx, cy;
  float near_z;  // camera z up to which nothing is drawn
  int32_t width, height;
};

struct Scene {               // structure of arrays, `count` floats each
  const float *means;        // 3 rows: x, y, z
  const float *covariances;  // 6 rows: xx, xy, xz, yy, yz, zz
  const float *opacities;
  uint32_t count;
  bool antialiased;  // opacities are dimmed by what widening adds to a splat's area
};

// A projected Gaussian: log2(alpha) = xx dx^2 + xy dx dy + yy dy^2 + log2_opacity, d = pixel - centre.
struct Splat {
  float x, y, xx, xy, yy, log2_opacity;
  uint32_t id;
  float depth;
};

// Where a splat can reach alpha >= 1/255: its 2D covariance, the half extents of that ellipse, and
// the rectangle of tiles [x0, x1) x [y0, y1) that it may touch.
struct Extent {
  float half_width, half_height, cov_xx, cov_xy, cov_yy, reach;
  int16_t x0, x1, y0, y1;
};

// Tiles of one row that a splat may touch: columns [first, last), none where that is empty.
struct TileSpan {
  uint32_t splat;
  uint16_t first, last;
  uint32_t before;  // tiles of the splat in rows above
};

struct Triples {  // structure of arrays, grown together
  Buffer gaussian_ids, segment_ids, weights;
  size_t size = 0;
};

struct TileScratch { Buffer block_masks, hits, hit_list, table; };

struct Tile {
  const Splat *splats;   // all visible ones, front to back
  const uint32_t *list;  // indices into `splats` of those that may touch this tile, front to back
  uint32_t count;
  int32_t x, y;           // tile coordinates
  int32_t width, height;  // of the whole image
};

struct Selection {
  int32_t topk;        // 0 = all
  int32_t first_hits;  // 0 = all
};

struct SparseRows {       // CSR
  const int64_t *starts;  // one more than there are rows
  const int32_t *columns;
  const float *weights;
};

struct Embeddings {
  const float *values;  // count x dim
  uint32_t count, dim;
};

// Rows of `depth` numbers times B. A row is `pieces` runs of equal length, `step` floats from one to the next.
struct DenseProduct {
  const float *b;         // depth x width
  uint32_t depth, width;  // width: a multiple of 16
  uint32_t pieces;
  size_t step;
  const float *bias;  // added to each row, and what is below 0 becomes 0; or null
};

struct Quantizer {
  const float *centroids;    // subvectors x 256 x dim
  uint32_t subvectors, dim;  // dim: of one sub-vector
};
constexpr size_t kEncodeScratch = 32;  // floats of scratch per dimension of a sub-vector

// score = (bias + sum over m of lut[m][code m]) * scale
struct Parameters {  // a scene while it is trained: pre-activation, rows of Gaussians
  const float *means, *log_scales, *quats, *logits, *sh;
  uint32_t count;
  int32_t coefficients;
  bool antialiased;
};

constexpr int kSplatSums = 9;  // see training_tiles.h

struct Visible {  // a run of projected splats, in index order
  const Splat *splats;
  const Extent *extents;
  const uint32_t *ranks;       // by depth
  const uint32_t *rows_start;  // of splat i: rows [rows_start[i], rows_start[i + 1]) of the sums over tiles
  uint32_t count;
  uint32_t begin, end;  // of these Gaussians
};

struct GradientArrays {  // as Parameters; zero where a Gaussian is not seen
  float *means, *log_scales, *quats, *logits, *sh, *screen, *radii;
};

struct LossImages {
  const float *image, *target;
  int32_t width, height;
  float ssim_weight;
};
constexpr size_t kLossRow = 32;  // numbers of a padded row beyond its colours
inline size_t loss_stride(int32_t width) { return ((size_t)width * 3 + 15) / 16 * 16; }
inline size_t loss_scratch(int32_t width) { return 81 * loss_stride(width) + 4 * kLossRow; }

struct AdamStep {  // rates and root_correction carry the bias corrections
  float rate, beta1, beta2, root_correction, epsilon;
  // The first kAdamHead numbers of every row of `row` have a rate of their own; row 0: there are none.
  float head_rate;
  uint32_t row;
};
constexpr int kAdamHead = 3;

struct HarmonicsStep {  // taken on the way back, of the coefficients in use, so that their gradients need no memory
  float *sh, *first, *second;  // rows of Parameters::sh and their moments
  AdamStep adam;
};

struct Contest {       // of `count` more scores of each row with the `kept` best, highest first
  float *scores;       // kept x rows
  uint16_t *names;     // as scores
  const float *found;  // count x rows
  uint64_t rows;
  uint32_t kept, count, first;  // first: name of the first score found, the others count up
};
constexpr uint32_t kMostKept = 256;

struct ScanKernels;     // scan_kernels.h
struct MixtureKernels;  // mixture_kernels.h
struct PhotoKernels;    // photo_kernels.h

struct Kernels {
  const char *name;
  uint32_t (*project)(const Scene &, const Camera &, uint32_t begin, uint32_t end, Splat *, Extent *);
  void (*tile_spans)(const Splat *, const Extent *, uint32_t begin, uint32_t end, TileSpan *, uint32_t *next);
  void (*tile_weights)(const Tile &, const Selection &, const int32_t *segment_ids, TileScratch &, Triples &);
  void (*tile_contributions)(const Tile &, const Selection &, TileScratch &, int32_t *ids, float *weights);
  void (*tile_render)(const Tile &, const float *values, int32_t channels, const float *background, TileScratch &,
                      float *image, float *alpha, float *depth);
  void (*sh_colors)(const float *sh, int32_t coefficients, const float *means, const float *center, uint32_t begin,
                    uint32_t end, float *colors);
  bool (*weighted_rows)(const SparseRows &, const Embeddings &, uint64_t begin, uint64_t end, float *out);
  void (*dense_rows)(const DenseProduct &, const float *const *rows, uint32_t count, float *out);
  void (*pq_encode)(const Quantizer &, const float *features, uint64_t begin, uint64_t end, float *scratch,
                    uint8_t *codes);
  void (*keep_best)(const Contest &, uint64_t begin, uint64_t end);

  // training
  void (*activate)(const Parameters &, uint32_t begin, uint32_t end, float *means, float *covariances,
                   float *opacities);
  void (*splat_colors)(const Visible &, const Parameters &, int32_t active, const float *center, float *colors);
  void (*tile_forward)(const Tile &, const float *colors, const float *background, TileScratch &, float *image,
                       float *alpha, uint16_t *blocks);
  void (*tile_backward)(const Tile &, const uint16_t *blocks, const uint32_t *rows, const float *colors,
                        const float *image, const float *gradient, TileScratch &, float *sums);
  void (*splats_backward)(const Visible &, const float *tile_sums, const Parameters &, const Camera &, int32_t active,
                          const float *center, const GradientArrays &, const HarmonicsStep *);
  void (*loss_rows)(const LossImages &, float *scratch, int begin, int end, float *gradient, double *l1, double *ssim);
  void (*adam)(float *parameter, const float *gradient, float *first, float *second, size_t begin, size_t end,
               const AdamStep &);

  const ScanKernels *scan;
  const MixtureKernels *mixture;
  const PhotoKernels *photo;
};

}  // namespace drsplat
