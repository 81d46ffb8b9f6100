// Tiles of a training pass: their pixels' colours, and from dL/d(image) the sums over pixels that the gradients of
// every splat are made of. Same decisions as the forward pass: no gradient through the clamp at 0.99, the cut at 1/255
// and the stop at 1e-4.
#pragma once
#include "kernels/compositing.h"
#include "kernels/group.h"

namespace drsplat::DRSPLAT_ISA {

constexpr int kSide = 4;  // of a block: a splat touches fewer of 4x4 pixels than of 8x2

// Of a block's pixels in the image, visit(lane, which pixel of the image).
template <class Visit>
INLINE void each_pixel(const Tile &tile, int left, int top, Visit visit) {
  const int width = tile.width - left, height = tile.height - top;
  const size_t first = (size_t)top * tile.width + left;
  if (width >= kSide && height >= kSide) {
    for (int l = 0; l < 16; l++) visit(l, first + (size_t)(l / kSide) * tile.width + l % kSide);
    return;
  }
  for (int l = 0; l < 16; l++)
    if (l % kSide < width && l / kSide < height) visit(l, first + (size_t)(l / kSide) * tile.width + l % kSide);
}

// colors: 3 per splat. image (height, width, 3), alpha (height, width). blocks: of each list entry, a bit for each
// block of which it reaches a ray, which is where the way back finds something to do.
static void tile_forward(const Tile &tile, const float *colors, const float *background, TileScratch &scratch,
                         float *image, float *alpha, uint16_t *blocks) {
  Walk walk(tile, scratch, colors, kSide);
  memset(blocks, 0, tile.count * sizeof(uint16_t));
  for (int b = 0; b < kBlocks; b++) {
    const auto [left, top, inside] = pixels_of(walk, b);
    if (!any(inside)) continue;
    Floats red = splat(0.f), green = red, blue = red;
    const Floats rest = walk_block(
        walk, b, inside, 0, ChunkOnStack{}, [&](uint32_t i, Floats w, Mask reached) __attribute__((always_inline)) {
          const float *color = colors + 3 * (size_t)tile.list[i];
          blocks[i] = (uint16_t)(blocks[i] | (uint32_t)any(reached) << b);
          red = red + w * splat(color[0]), green = green + w * splat(color[1]), blue = blue + w * splat(color[2]);
        });
    float columns[4][16];
    store(columns[0], red + rest * splat(background[0])), store(columns[1], green + rest * splat(background[1]));
    store(columns[2], blue + rest * splat(background[2])), store(columns[3], splat(1.f) - rest);
    each_pixel(tile, left, top, [&](int l, size_t pixel) __attribute__((always_inline)) {
      for (int c = 0; c < 3; c++) image[3 * pixel + c] = columns[c][l];
      alpha[pixel] = columns[3][l];
    });
  }
}

struct BlockState {              // 16 pixels during the backward walk
  Floats x, y;                   // their centres
  Floats transmittance, behind;  // behind: (what is composited from here on) . dL/dpixel
  Floats red, green, blue;       // dL/dpixel
};

static inline void start_blocks(const Walk &walk, const float *image, const float *gradient, BlockState *states) {
  const Floats none = splat(0.f);
  for (int b = 0; b < kBlocks; b++) {
    const auto [left, top, inside] = pixels_of(walk, b);
    const Points centres = centres_of(walk, b);
    float columns[6][16] = {};
    each_pixel(walk.tile, left, top, [&](int l, size_t pixel) __attribute__((always_inline)) {
      for (int c = 0; c < 3; c++) columns[c][l] = image[3 * pixel + c], columns[3 + c][l] = gradient[3 * pixel + c];
    });
    const Floats red = load(columns[3]), green = load(columns[4]), blue = load(columns[5]);
    const Floats behind = load(columns[0]) * red + load(columns[1]) * green + load(columns[2]) * blue;
    states[b] = {centres.x, centres.y, keep(inside, splat(1.f)), behind, red, green, blue};
  }
  states[kBlocks] = {none, none, none, none, none, none, none};
}

// Blocks that a splat passes together, as registers allow: each step in one waits for the one before.
constexpr int kBlocksTogether = kParts == 1 ? 2 : 1;

// Brings some blocks behind a splat and adds what it does there to `total`, kSplatSums of them.
INLINE void pass_splat(const Splat &g, const float *color, BlockState *const *blocks, Floats *total) {
  constexpr int n = kBlocksTogether;
  const Splat *splats[n];
  Points d[n];
  Floats alpha[n], transmittance[n], w[n], shade[n], behind[n], slope[n], G[n];
  for (int b = 0; b < n; b++) splats[b] = &g, d[b] = offsets({blocks[b]->x, blocks[b]->y}, g);
  alphas_at<n>(splats, d, alpha);
  Mask live[n];
  for (int b = 0; b < n; b++) transmittance[b] = blocks[b]->transmittance;
  for (int b = 0; b < n; b++) {
    const Floats weight = transmittance[b] * alpha[b], after = transmittance[b] - weight;
    blocks[b]->transmittance = after;
    live[b] = after >= splat(kMinTransmittance);
    w[b] = keep(live[b], weight);
  }
  for (int b = 0; b < n; b++)
    shade[b] =
        blocks[b]->red * splat(color[0]) + blocks[b]->green * splat(color[1]) + blocks[b]->blue * splat(color[2]);
  for (int b = 0; b < n; b++) blocks[b]->behind = behind[b] = blocks[b]->behind - w[b] * shade[b];
  for (int b = 0; b < n; b++)  // dL/d(alpha)
    slope[b] = transmittance[b] * shade[b] - behind[b] * reciprocal(splat(1.f) - alpha[b]);
  for (int b = 0; b < n; b++) G[b] = keep(live[b] & (alpha[b] < splat(kMaxAlpha)), slope[b] * alpha[b]);
  for (int b = 0; b < n; b++) {
    const Floats gx = G[b] * d[b].x, gy = G[b] * d[b].y;
    add_to(total[0], w[b] * blocks[b]->red), add_to(total[1], w[b] * blocks[b]->green),
        add_to(total[2], w[b] * blocks[b]->blue);
    add_to(total[3], G[b]), add_to(total[4], gx), add_to(total[5], gy);
    add_to(total[6], gx * d[b].x), add_to(total[7], gx * d[b].y), add_to(total[8], gy * d[b].y);
  }
}

// Sums over the tile's pixels for every list entry, kSplatSums in a row of its own: dL/d(colour), then with
// G = dL/d(ln alpha): G, G dx, G dy, G dx^2, G dx dy, G dy^2, d = pixel - centre. blocks: of tile_forward.
//
// dL/d(alpha_i) = T_i (c_i . g) - (what is behind i) / (1 - alpha_i), and what is behind i is the pixel's
// value less what was composited up to i: so one walk front to back, without a record, is enough.
static void tile_backward(const Tile &tile, const uint16_t *blocks, const uint32_t *rows, const float *colors,
                          const float *image, const float *gradient, TileScratch &scratch, float *sums) {
  if (!tile.count) return;
  BlockState states[kBlocks + 1];  // the last: one that no light reaches
  start_blocks(Walk(tile, scratch, nullptr, kSide), image, gradient, states);
  for (uint32_t i = 0; i < tile.count; i++) {
    fetch_splat(tile, colors, i + kSplatsAhead);
    if (i + kAhead < tile.count) __builtin_prefetch(sums + (size_t)rows[i + kAhead] * kSplatSums, 1);
    uint32_t reached = blocks[i];
    float *out = sums + (size_t)rows[i] * kSplatSums;
    if (!reached) {
      memset(out, 0, kSplatSums * sizeof(float));
      continue;
    }
    const Splat &g = tile.splats[tile.list[i]];
    const float *color = colors + 3 * (size_t)tile.list[i];
    Floats total[kSplatSums];
    for (Floats &t : total) t = splat(0.f);
    while (reached) {
      BlockState *passed[kBlocksTogether];
      for (BlockState *&block : passed) {
        block = &states[reached ? __builtin_ctz(reached) : kBlocks];
        reached &= reached - 1;
      }
      pass_splat(g, color, passed, total);
    }
    store_eight_sums(out, total);
    out[8] = sum(total[8]);
  }
}

}  // namespace drsplat::DRSPLAT_ISA
