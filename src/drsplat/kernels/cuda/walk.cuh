// Front-to-back compositing of one tile of 16x16 pixels by a block of 256 threads; a warp has 8x4 pixels.
//
// The tile's list is taken in batches. Of each splat it is found which warps it can touch, and each warp walks over
// those of its own. Weights are computed in fixed roundings, so that a second walk finds the very same.
constexpr int WARPS = 8, BLOCK_WIDTH = 8, BLOCK_HEIGHT = 4;

struct Place {  // of a thread
  int x, y;
  bool inside;
  float px, py;  // centre of its pixel
};

DEVICE Place place_of_thread(int tile, int columns, int width, int height) {
  const int lane = lane_of_warp(), warp = warp_of_block();
  Place p;
  p.x = tile % columns * TILE + (warp & 1) * BLOCK_WIDTH + (lane & 7);
  p.y = tile / columns * TILE + (warp >> 1) * BLOCK_HEIGHT + (lane >> 3);
  p.inside = p.x < width && p.y < height;
  p.px = (float)p.x + 0.5f, p.py = (float)p.y + 0.5f;
  return p;
}

// Of one splat, the warps that it may touch: the largest log2(alpha) over each warp's rectangle of pixel centres lies
// on the line through the point nearest to the centre, along x or along y.
DEVICE u32 warps_touched(const Splat &g, float left, float top) {
  u32 touched = 0;
  for (int w = 0; w < WARPS; w++) {
    const float xa = left + (float)((w & 1) * BLOCK_WIDTH) - g.x, xb = xa + (BLOCK_WIDTH - 1);
    const float ya = top + (float)((w >> 1) * BLOCK_HEIGHT) - g.y, yb = ya + (BLOCK_HEIGHT - 1);
    const float near_x = clampf(0.f, xa, xb), near_y = clampf(0.f, ya, yb);
    const float best_y = clampf(near_x * (-0.5f * g.xy / g.yy), ya, yb);
    const float best_x = clampf(near_y * (-0.5f * g.xy / g.xx), xa, xb);
    const float p1 = (g.xx * near_x + g.xy * best_y) * near_x + g.yy * best_y * best_y;
    const float p2 = (g.xx * best_x + g.xy * near_y) * best_x + g.yy * near_y * near_y;
    touched |= (u32)(fmaxf(p1, p2) >= LOG2_MIN_ALPHA - g.log2_opacity - 1e-3f) << w;
  }
  return touched;
}

DEVICE float log2_alpha(const Splat &g, float dx, float dy) {
  const float across = __fmaf_rn(g.xx, dx, __fmul_rn(g.xy, dy));
  return __fmaf_rn(across, dx, __fmaf_rn(__fmul_rn(g.yy, dy), dy, g.log2_opacity));
}

// 0 where it is less than 1/255.
DEVICE float alpha_at(const Splat &g, float dx, float dy) {
  const float p = log2_alpha(g, dx, dy);
  return p >= LOG2_MIN_ALPHA ? fminf(exp2f(p), MAX_ALPHA) : 0.f;
}

template <int SIZE>
struct Batch {
  Splat splats[SIZE];
  float4 colors[SIZE];
  u32 ids[SIZE];
  u8 touched[SIZE];  // a bit for each warp
};

struct List {  // of a tile: entries [begin, end) of `ids`, front to back
  const u32 *ids;
  u32 begin, end;
  const Splat *splats;
  const float4 *colors;  // of all Gaussians, or null
  int tile, columns;
};

// Entries from `at` on, as many as fit, by the first threads of the block.
template <int SIZE>
DEVICE void load_batch(Batch<SIZE> &batch, const List &list, u32 at) {
  const u32 mine = threadIdx.x;
  if (mine >= SIZE) return;
  batch.touched[mine] = 0;
  if (at + mine >= list.end) return;
  const u32 id = list.ids[at + mine];
  const Splat s = list.splats[id];
  batch.splats[mine] = s, batch.ids[mine] = id;
  if (list.colors) batch.colors[mine] = list.colors[id];
  const float left = (float)(list.tile % list.columns * TILE) + 0.5f;
  const float top = (float)(list.tile / list.columns * TILE) + 0.5f;
  batch.touched[mine] = (u8)warps_touched(s, left, top);
}

struct Hit {  // of a splat and a pixel; weight is 0 where the pixel has ended or alpha is below 1/255
  float dx, dy, alpha, before, weight;  // before: transmittance up to here
  bool live;
};

struct Walked {
  float rest;  // transmittance that is left
  u32 at;      // entries from here on were not looked at
};

// Calls visit(place in the batch, hit) for every splat that touches the warp, front to back, by all its lanes, and
// end_batch(first entry, end) by all threads of the block.
template <int SIZE, class Visit, class EndBatch>
DEVICE Walked walk(Batch<SIZE> &batch, const List &list, const Place &place, bool wanted, int first_hits, Visit visit,
                   EndBatch end_batch) {
  float transmittance = 1.f;
  bool live = wanted;
  int hits = 0;
  u32 at = list.begin;
  for (; at < list.end; at += SIZE) {
    if (!__syncthreads_or(live)) break;
    load_batch(batch, list, at);
    __syncthreads();
    for (int k = 0; k < SIZE / 32; k++) {
      u32 bits = __ballot_sync(FULL, batch.touched[32 * k + lane_of_warp()] >> warp_of_block() & 1);
      for (; bits && __any_sync(FULL, live); bits &= bits - 1) {
        const int j = 32 * k + __ffs(bits) - 1;
        const Splat &g = batch.splats[j];
        Hit hit;
        hit.dx = place.px - g.x, hit.dy = place.py - g.y;
        hit.alpha = alpha_at(g, hit.dx, hit.dy), hit.before = transmittance;
        const float weight = __fmul_rn(transmittance, hit.alpha), after = __fsub_rn(transmittance, weight);
        live = live && after >= MIN_TRANSMITTANCE;
        if (first_hits && live && weight > 0.f && ++hits > first_hits) live = false;
        hit.live = live, hit.weight = live ? weight : 0.f;
        visit(j, hit);
        if (live) transmittance = after;
      }
    }
    end_batch(at, at + SIZE < list.end ? at + SIZE : list.end);
  }
  return {transmittance, at < list.end ? at : list.end};
}
