// Front-to-back compositing of one 16x16 tile in blocks of 8x2 pixels, and what is made of the weights.
//
// The blocks are done one after the other; each walks the tile's list in depth order. Which splats can
// touch which block is found for all 16 blocks at once (one lane per block), lazily, as deep as any
// block needs to look.
#pragma once
#include "kernels/projection.h"
#include "kernels/ranking.h"

namespace drsplat::DRSPLAT_ISA {

constexpr int kBlocks = 16, kBlockWidth = 8, kBlockHeight = 2;
constexpr uint32_t kChunk = 128;       // list entries per look-ahead
constexpr uint32_t kSplatsAhead = 32;  // of those, fetched before they are tested
constexpr float kMinTransmittance = 1e-4f, kMaxAlpha = 0.99f;
constexpr size_t kTableLimit = 1 << 16;  // 64-byte cells: 4 MiB

struct Walk {
  const Tile &tile;
  const float *colors;  // 3 per splat, fetched with the splats; or null
  int width, height;    // of a block; as many blocks lie side by side as one is high
  uint16_t *masks;      // per list entry: the blocks it may touch
  uint32_t known = 0;   // masks are filled up to here
  float left, top;      // centre of the tile's first pixel
  Floats block_x, block_y, lane_x, lane_y;

  Walk(const Tile &t, TileScratch &scratch, const float *colors = nullptr, int block_width = kBlockWidth)
      : tile(t),
        colors(colors),
        width(block_width),
        height(16 / block_width),
        left((float)t.x * 16.f + 0.5f),
        top((float)t.y * 16.f + 0.5f) {
    reserve(scratch.block_masks, (t.count + 16) * sizeof(uint16_t));
    masks = (uint16_t *)scratch.block_masks.data;
    float bx[16], by[16], lx[16], ly[16];
    for (int i = 0; i < 16; i++) {
      bx[i] = left + (float)(i % height * width), by[i] = top + (float)(i / height * height);
      lx[i] = (float)(i % width), ly[i] = (float)(i / width);
    }
    block_x = load(bx), block_y = load(by), lane_x = load(lx), lane_y = load(ly);
  }
};

struct Pixels {   // of a block
  int left, top;  // its first
  Mask inside;    // which of them are in the image
};

INLINE Pixels pixels_of(const Walk &w, int block) {
  const int left = w.tile.x * 16 + block % w.height * w.width, top = w.tile.y * 16 + block / w.height * w.height;
  return {left, top,
          (w.lane_x < splat((float)(w.tile.width - left))) & (w.lane_y < splat((float)(w.tile.height - top)))};
}

struct Points { Floats x, y; };

INLINE Points centres_of(const Walk &w, int block) {  // of its pixels
  return {w.lane_x + splat(w.left + (float)(block % w.height * w.width)),
          w.lane_y + splat(w.top + (float)(block / w.height * w.height))};
}

INLINE Points offsets(const Points &pixels, const Splat &g) { return {pixels.x - splat(g.x), pixels.y - splat(g.y)}; }

// Of each splat at sixteen pixels, 0 where it is less than 1/255.
template <int kCount>
INLINE void alphas_at(const Splat *const *splats, const Points *d, Floats *alphas) {
  Floats p[kCount];
  for (int i = 0; i < kCount; i++) p[i] = splat(splats[i]->xx) * d[i].x + splat(splats[i]->xy) * d[i].y;
  for (int i = 0; i < kCount; i++)
    p[i] = p[i] * d[i].x + (splat(splats[i]->yy) * d[i].y * d[i].y + splat(splats[i]->log2_opacity));
  for (int i = 0; i < kCount; i++) alphas[i] = p[i];
  exp2_of_each<kCount>(alphas);
  for (int i = 0; i < kCount; i++) alphas[i] = keep(p[i] >= splat(kLog2MinAlpha), minimum(alphas[i], splat(kMaxAlpha)));
}

// Exact test of one splat against all blocks: the largest log2(alpha) over each block's rectangle of
// pixel centres. That maximum of a concave quadratic lies on the line through the point nearest to the
// centre, along x or along y.
INLINE uint32_t blocks_touched(const Walk &w, const Splat &g) {
  const Floats xa = w.block_x - splat(g.x), ya = w.block_y - splat(g.y), zero = splat(0.f);
  const Floats xb = xa + splat((float)w.width - 1.f), yb = ya + splat((float)w.height - 1.f);
  const Floats near_x = minimum(maximum(zero, xa), xb), near_y = minimum(maximum(zero, ya), yb);
  const Floats best_y = minimum(maximum(near_x * splat(-0.5f * g.xy / g.yy), ya), yb);
  const Floats best_x = minimum(maximum(near_y * splat(-0.5f * g.xy / g.xx), xa), xb);
  const Floats xx = splat(g.xx), xy = splat(g.xy), yy = splat(g.yy);
  const Floats p1 = (xx * near_x + xy * best_y) * near_x + yy * best_y * best_y;
  const Floats p2 = (xx * best_x + xy * near_y) * best_x + yy * near_y * near_y;
  return lanes_of(maximum(p1, p2) >= splat(kLog2MinAlpha - g.log2_opacity - 1e-3f));
}

INLINE void fetch_splat(const Tile &tile, const float *colors, uint32_t i) {
  if (i >= tile.count) return;
  __builtin_prefetch(&tile.splats[tile.list[i]]);
  if (colors) __builtin_prefetch(colors + 3 * (size_t)tile.list[i]);
}

static inline void look_ahead(Walk &w, uint32_t end) {
  for (; w.known < end; w.known++) {
    fetch_splat(w.tile, w.colors, w.known + kSplatsAhead);
    w.masks[w.known] = (uint16_t)blocks_touched(w, w.tile.splats[w.tile.list[w.known]]);
  }
}

// Which of a chunk's entries a block may be touched by; writes up to sixteen numbers beyond them.
static inline uint32_t candidates(const Walk &w, int block, uint32_t begin, uint32_t end, uint32_t *out) {
  uint32_t n = 0, i = begin;
#if DRSPLAT_AVX512
  __m512i numbers = _mm512_add_epi32(_mm512_set1_epi32((int)begin),
                                     _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15));
  const __m256i bit = _mm256_set1_epi16((short)(1u << block));
  for (; i < end; i += 16) {
    uint32_t touched = _mm256_test_epi16_mask(_mm256_loadu_si256((const __m256i *)(w.masks + i)), bit);
    if (end - i < 16) touched &= (1u << (end - i)) - 1;
    _mm512_storeu_si512(out + n, _mm512_maskz_compress_epi32((__mmask16)touched, numbers));
    n += (uint32_t)__builtin_popcount(touched);
    numbers = _mm512_add_epi32(numbers, _mm512_set1_epi32(16));
  }
#endif
  for (; i < end; i++) {
    out[n] = i;
    n += w.masks[i] >> block & 1;
  }
  return n;
}

constexpr uint32_t kBetweenChecks = 8;               // visits
constexpr uint32_t kTogether = kParts == 1 ? 4 : 1;  // splats whose alphas are found at once, as registers allow

struct Never {
  __attribute__((always_inline)) bool operator()(Floats) const { return false; }
};

struct ChunkOnStack {  // of list indices
  uint32_t indices[kChunk + 16];
  uint32_t *operator()(uint32_t) { return indices; }
};

// Calls begin_chunk(n), which gives room for n list indices and sixteen more, before up to n visits,
// visit(list index, weights, reached) for every splat front to back, and now and then ends(transmittance), which ends
// the walk where it is true. reached: lanes whose rays it touches or ends.
// The transmittance is not zeroed at the stop: it only falls, so "would bring it under 1e-4" stays true
// by itself, and the loop-carried chain is one multiplication. Returns the final transmittance. A few visits more than
// any ray needs, in which all weights are 0, cost less than a look for the end after each.
template <class Begin, class Visit, class Ends = Never>
INLINE Floats walk_block(Walk &w, int block, Mask wanted, int32_t first_hits, Begin begin_chunk, Visit visit,
                         Ends ends = {}) {
  const Tile &tile = w.tile;
  const Points pixels = centres_of(w, block);
  Floats transmittance = keep(wanted, splat(1.f)), last = splat(1.f);
  Ints hits = splat_int(0);
  Mask before = wanted;
  for (uint32_t at = 0; at < tile.count; at += kChunk) {
    const uint32_t end = at + kChunk < tile.count ? at + kChunk : tile.count;
    look_ahead(w, end);
    uint32_t *chunk = begin_chunk(end - at);
    const uint32_t n = candidates(w, block, at, end, chunk);
    for (uint32_t i = n; i % kTogether; i++) chunk[i] = chunk[n - 1];
    for (uint32_t j = 0; j < n; j += kTogether) {
      if (j % kBetweenChecks == 0 && (!any(before) || ends(transmittance))) return last;
      const Splat *splats[kTogether];
      Points d[kTogether];
      Floats alphas[kTogether];
      for (uint32_t i = 0; i < kTogether; i++) splats[i] = &tile.splats[tile.list[chunk[j + i]]];
      for (uint32_t i = 0; i < kTogether; i++) d[i] = offsets(pixels, *splats[i]);
      alphas_at<kTogether>(splats, d, alphas);
      for (uint32_t i = 0; i < kTogether && j + i < n; i++) {
        const Floats weight = transmittance * alphas[i], after = transmittance - weight;
        Mask live = after >= splat(kMinTransmittance);
        Floats kept = keep(live, weight);
        if (first_hits) {
          hits = increment(hits, splat(0.f) < kept);
          live = live & !(splat_int(first_hits) < hits);
          kept = keep(live, kept);
        }
        visit(chunk[j + i], kept, before & (splat(0.f) < weight));
        before = live;
        last = select(live, after, last);
        transmittance = first_hits ? keep(live, after) : after;
      }
    }
  }
  return last;
}

// --- the weights of one block, recorded ---------------------------------------------------------

struct Record {
  float *weights;   // 16 per hit, front to back
  uint32_t *index;  // list index of each hit
  size_t size;
};

INLINE Ints count_from(const Record &r, Floats threshold) {
  Ints a = splat_int(0), b = splat_int(0);
  size_t i = 0;
  for (; i + 1 < r.size; i += 2) {
    a = increment(a, load(r.weights + 16 * i) >= threshold);
    b = increment(b, load(r.weights + 16 * i + 16) >= threshold);
  }
  if (i < r.size) a = increment(a, load(r.weights + 16 * i) >= threshold);
  return a + b;
}

// Whether no later weight can be among a lane's k largest: as many reach what is left of the light already. Of equal
// weights the earlier counts. `guess`: what the k-th weight may be; above it, counting is not worth while.
INLINE bool is_complete(const Record &r, int32_t k, Ints guess, Floats transmittance) {
  const Floats most = transmittance * splat(kMaxAlpha);
  const Mask alive = transmittance >= splat(kMinTransmittance);
  if (any(alive & (float_of_bits(guess) < most))) return false;
  return !any(alive & (count_from(r, most) < splat_int(k)));
}

static Record record_block(Walk &w, int block, Mask wanted, const Selection &selection, Ints guess,
                           TileScratch &scratch) {
  Record r = {(float *)scratch.hits.data, (uint32_t *)scratch.hit_list.data, 0};
  walk_block(
      w, block, wanted, selection.first_hits,
      [&](uint32_t n) {
        reserve(scratch.hits, (r.size + n) * sizeof(Floats));
        reserve(scratch.hit_list, (r.size + n + 16) * sizeof(uint32_t));
        r.weights = (float *)scratch.hits.data, r.index = (uint32_t *)scratch.hit_list.data;
        return r.index + r.size;
      },
      [&](uint32_t, Floats weight, Mask) __attribute__((always_inline)) { store(r.weights + 16 * r.size++, weight); },
      [&](Floats transmittance) __attribute__((always_inline)) {
        return selection.topk && r.size >= (size_t)selection.topk &&
               is_complete(r, selection.topk, guess, transmittance);
      });
  return r;
}

// Lanes whose k-th and (k+1)-th weight are equal: the earlier ones stay, the later become zero.
static void drop_late_ties(const Record &r, Floats threshold, Mask tied, int32_t k) {
  Ints room = splat_int(k) - count_from(r, float_of_bits(bits_of(threshold) + splat_int(1)));
  for (size_t i = 0; i < r.size; i++) {
    Floats w = load(r.weights + 16 * i);
    Mask equal = tied & (bits_of(w) == bits_of(threshold)), full = room < splat_int(1);
    store(r.weights + 16 * i, keep(!(equal & full), w));
    room = select(equal, room - splat_int(1), room);
  }
}

constexpr int32_t kFew = 4;
constexpr int32_t kTinyWeightBits = 0x34000000;  // 1.2e-7, below any weight: at least 1/255 * 1e-4
constexpr int32_t kOneBits = 0x3f800000;
constexpr int32_t kFirstGuessBits = 0x3b800000;  // 2^-8

// Per lane, the k-th largest weight where `low` is reached by k and one to kFew more: one of the few smallest that
// reach it. Elsewhere `threshold`.
static Ints settle_few(const Record &r, int32_t k, Ints low, Ints excess, Mask few, Ints threshold) {
  Ints above[kFew + 1];  // the smallest beyond `low`, ascending; what is below it wraps around
  for (int n = 0; n <= kFew; n++) above[n] = splat_int(-1);
  for (size_t i = 0; i < r.size; i++) {
    Ints in = bits_of(load(r.weights + 16 * i)) - low;
    for (int n = 0; n <= kFew; n++) {
      const Ints larger = maximum_unsigned(above[n], in);
      above[n] = minimum_unsigned(above[n], in), in = larger;
    }
  }
  Ints kth = above[1], next = above[0];
  for (int n = 2; n <= kFew; n++) {
    const Mask mine = excess == splat_int(n);
    kth = select(mine, above[n], kth), next = select(mine, above[n - 1], next);
  }
  threshold = select(few, low + kth, threshold);
  const Mask tied = few & (kth == next);
  if (any(tied)) drop_late_ties(r, float_of_bits(threshold), tied, k);
  return threshold;
}

// Per lane, a threshold that exactly its k largest weights reach (all of them, where it has fewer).
// Positive floats order as their bits do, so the search runs on bits: between `low` (reached by more
// than k) and `high` (by fewer), starting at `guess`, going on by linear interpolation of the counts to one that a
// little more than k reach, and halving every third round so that it always ends.
static Ints topk_threshold(const Record &r, int32_t k, Ints guess) {
  const Ints wanted = splat_int(k), one = splat_int(1);
  Ints low = splat_int(kTinyWeightBits), high = splat_int(kOneBits), threshold = low;
  Ints count_low = count_from(r, float_of_bits(low)), count_high = splat_int(0);
  Mask busy = wanted < count_low;
  for (int round = 0; any(busy & (splat_int(kFew) < count_low - wanted)); round++) {
    const Ints width = high - low;
    const Floats share = (to_float(count_low - wanted) - splat(1.f)) / to_float(count_low - count_high);
    Ints step = round == 0 ? guess - low : round % 3 == 2 ? shift_right(width, 1) : truncate(to_float(width) * share);
    step = select(step < one, one, select(step < width, step, width - one));
    const Ints middle = low + step, count = count_from(r, float_of_bits(middle));
    const Mask more = busy & (wanted < count), fewer = busy & (count < wanted);
    threshold = select(busy & !(more | fewer), middle, threshold);
    low = select(more, middle, low), count_low = select(more, count, count_low);
    high = select(fewer, middle, high), count_high = select(fewer, count, count_high);
    busy = busy & (more | fewer);
    const Mask tied = busy & (high - low < splat_int(2));
    if (any(tied)) {
      threshold = select(tied, low, threshold);
      drop_late_ties(r, float_of_bits(threshold), tied, k);
      busy = busy & !tied;
    }
  }
  return any(busy) ? settle_few(r, k, low, count_low - wanted, busy, threshold) : threshold;
}

// Thresholds change little from block to block: that of the block above is the first guess, in the top row that of the
// block to the left.
struct Guesses {
  Ints bits[2] = {splat_int(kFirstGuessBits), splat_int(kFirstGuessBits)};

  Ints &of(int block) {
    if (block == 1) bits[1] = bits[0];
    return bits[block % 2];
  }
};

static Floats selection_threshold(const Record &r, const Selection &s, Ints &guess) {
  if (!s.topk || r.size <= (size_t)s.topk) return float_of_bits(splat_int(kTinyWeightBits));
  const Ints threshold = topk_threshold(r, s.topk, guess);
  guess = select(splat_int(kTinyWeightBits) < threshold, threshold, guess);
  return float_of_bits(threshold);
}

// --- registration: (Gaussian, segment, weight) triples of a tile --------------------------------

struct TileSegments {
  int32_t ids[256];  // segment of each local slot, in order of first appearance
  int count = 0;
  Ints slot_of_lane[kBlocks];           // -1: no segment
  uint32_t slots_of_block[kBlocks][8];  // bit set
};

// Of a block's pixels, -1 beyond the image.
INLINE Ints segments_of(const Tile &tile, const int32_t *segment_ids, int block) {
  const int left = tile.x * 16 + block % 2 * kBlockWidth, top = tile.y * 16 + block / 2 * kBlockHeight;
  int32_t ids[16];
  for (int row = 0; row < kBlockHeight; row++) {
    const int32_t *from = segment_ids + (size_t)(top + row) * tile.width + left;
    if (top + row < tile.height && left + kBlockWidth <= tile.width)
      memcpy(ids + row * kBlockWidth, from, kBlockWidth * sizeof *ids);
    else
      for (int x = 0; x < kBlockWidth; x++)
        ids[row * kBlockWidth + x] = top + row < tile.height && left + x < tile.width ? from[x] : -1;
  }
  return load_int(ids);
}

static void find_segments(const Tile &tile, const int32_t *segment_ids, TileSegments &s) {
  memset(s.slots_of_block, 0, sizeof s.slots_of_block);
  for (int y = tile.y * 16; y < tile.y * 16 + 16 && y < tile.height; y++)  // of the tile after the next
    if (tile.x * 16 + 32 < tile.width) __builtin_prefetch(segment_ids + (size_t)y * tile.width + tile.x * 16 + 32);
  for (int b = 0; b < kBlocks; b++) {
    const Ints ids = segments_of(tile, segment_ids, b);
    Ints slots = splat_int(-1);
    for (uint32_t left = lanes_of(splat_int(-1) < ids); left;) {
      const int32_t id = ((const int32_t *)&ids)[__builtin_ctz(left)];
      int slot = 0;
      while (slot < s.count && s.ids[slot] != id) slot++;
      if (slot == s.count) s.ids[s.count++] = id;
      s.slots_of_block[b][slot / 32] |= 1u << slot % 32;
      const Mask same = ids == splat_int(id);
      slots = select(same, splat_int(slot), slots);
      left &= ~lanes_of(same);
    }
    s.slot_of_lane[b] = slots;
  }
}

static inline void emit(Triples &out, uint32_t gaussian, int32_t segment, float weight) {
  ((uint32_t *)out.gaussian_ids.data)[out.size] = gaussian;
  ((int32_t *)out.segment_ids.data)[out.size] = segment;
  ((float *)out.weights.data)[out.size] = weight;
  out.size += weight > 0;
}

static void reserve_triples(Triples &out, size_t more) {
  reserve(out.gaussian_ids, (out.size + more + 1) * 4);
  reserve(out.segment_ids, (out.size + more + 1) * 4);
  reserve(out.weights, (out.size + more + 1) * 4);
}

template <class Add>
static inline void each_slot(const TileSegments &s, int block, Add add) {
  for (int word = 0; word * 32 < s.count; word++)
    for (uint32_t m = s.slots_of_block[block][word]; m; m &= m - 1) add(word * 32 + __builtin_ctz(m));
}

// Adds up the tile in a table of (list entry, slot) cells of 16 lanes. Where the table would be huge
// (noise as a segment map, or a very long list), every hit becomes a triple of its own instead.
static void tile_weights(const Tile &tile, const Selection &selection, const int32_t *segment_ids, TileScratch &scratch,
                         Triples &out) {
  TileSegments segments;
  find_segments(tile, segment_ids, segments);
  if (!segments.count || !tile.count) return;
  Walk walk(tile, scratch);
  Guesses guesses;
  const size_t slots = segments.count;
  const bool tabled = tile.count * slots <= kTableLimit;
  if (tabled) reserve(scratch.table, tile.count * slots * sizeof(Floats));
  Floats *table = (Floats *)scratch.table.data;
  uint32_t cleared = 0;
  for (int b = 0; b < kBlocks; b++) {
    const Mask wanted = splat_int(-1) < segments.slot_of_lane[b];
    if (!any(wanted)) continue;
    Ints &guess = guesses.of(b);
    const Record r = record_block(walk, b, wanted, selection, guess, scratch);
    const Floats threshold = selection_threshold(r, selection, guess);
    if (tabled && cleared < walk.known) {
      memset(table + cleared * slots, 0, (walk.known - cleared) * slots * sizeof(Floats));
      cleared = walk.known;
    }
    each_slot(segments, b, [&](int slot) {
      const Mask mine = segments.slot_of_lane[b] == splat_int(slot);
      if (!tabled) reserve_triples(out, r.size);
      for (size_t i = 0; i < r.size; i++) {
        const Floats w = load(r.weights + 16 * i), part = keep(mine & (w >= threshold), w);
        if (tabled) table[r.index[i] * slots + slot] = table[r.index[i] * slots + slot] + part;
        else emit(out, tile.splats[tile.list[r.index[i]]].id, segments.ids[slot], sum(part));
      }
    });
  }
  if (!tabled) return;
  reserve_triples(out, cleared * slots);
  for (uint32_t i = 0; i < cleared; i++)
    for (size_t slot = 0; slot < slots; slot++)
      emit(out, tile.splats[tile.list[i]].id, segments.ids[slot], sum(table[i * slots + slot]));
}

// --- per-pixel contributors ---------------------------------------------------------------------

// Fills ids and weights, both (height, width, topk); the caller has set them to -1 and 0.
static void tile_contributions(const Tile &tile, const Selection &selection, TileScratch &scratch, int32_t *ids,
                               float *weights) {
  if (!tile.count) return;
  Walk walk(tile, scratch);
  const size_t k = selection.topk;
  Guesses guesses;
  for (int b = 0; b < kBlocks; b++) {
    const auto [left, top, inside] = pixels_of(walk, b);
    if (!any(inside)) continue;
    Ints &guess = guesses.of(b);
    const Record r = record_block(walk, b, inside, selection, guess, scratch);
    const Floats threshold = selection_threshold(r, selection, guess);
    size_t filled[16] = {};
    for (size_t i = 0; i < r.size; i++) {
      const Floats w = load(r.weights + 16 * i);
      const int32_t id = (int32_t)tile.splats[tile.list[r.index[i]]].id;
      for (uint32_t m = lanes_of(w >= threshold); m; m &= m - 1) {
        const int l = __builtin_ctz(m);
        if (filled[l] == k) continue;  // room for k, whatever rounding made of a covariance that is none
        const size_t pixel = ((size_t)(top + l / kBlockWidth) * tile.width + left + l % kBlockWidth) * k;
        insert_descending(ids + pixel, weights + pixel, filled[l]++, id, lane(w, l));
      }
    }
  }
}

// --- rendering ----------------------------------------------------------------------------------

constexpr int kChannelsAtOnce = 16;

static inline void write_lanes(float *image, const Tile &tile, int left, int top, Mask inside, size_t stride,
                               Floats value) {
  for (uint32_t m = lanes_of(inside); m; m &= m - 1) {
    const int l = __builtin_ctz(m);
    image[((size_t)(top + l / kBlockWidth) * tile.width + left + l % kBlockWidth) * stride] = lane(value, l);
  }
}

// image (height, width, channels): sum of w * value, plus the background behind what is left.
static void tile_render(const Tile &tile, const float *values, int32_t channels, const float *background,
                        TileScratch &scratch, float *image, float *alpha, float *depth) {
  Walk walk(tile, scratch);
  for (int b = 0; b < kBlocks; b++) {
    const auto [left, top, inside] = pixels_of(walk, b);
    if (!any(inside)) continue;
    for (int32_t first = 0; first == 0 || first < channels; first += kChannelsAtOnce) {
      const int n = channels - first < kChannelsAtOnce ? channels - first : kChannelsAtOnce;
      Floats total[kChannelsAtOnce], weight_sum = splat(0.f), depth_sum = splat(0.f);
      for (int c = 0; c < n; c++) total[c] = splat(0.f);
      const Floats rest = walk_block(walk, b, inside, 0, ChunkOnStack{},
                                     [&](uint32_t i, Floats w, Mask) __attribute__((always_inline)) {
                                       const Splat &g = tile.splats[tile.list[i]];
                                       const float *value = values + (size_t)g.id * channels + first;
                                       for (int c = 0; c < n; c++) total[c] = total[c] + w * splat(value[c]);
                                       weight_sum = weight_sum + w;
                                       depth_sum = depth_sum + w * splat(g.depth);
                                     });
      for (int c = 0; c < n; c++)
        write_lanes(image + first + c, tile, left, top, inside, channels,
                    total[c] + rest * splat(background[first + c]));
      if (first) continue;
      write_lanes(alpha, tile, left, top, inside, 1, splat(1.f) - rest);
      write_lanes(depth, tile, left, top, inside, 1,
                  keep(splat(0.f) < weight_sum, depth_sum / maximum(weight_sum, splat(1e-30f))));
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
