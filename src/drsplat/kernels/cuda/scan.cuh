// Scores of product-quantised codes: one stream through the codes, and look-ups in tables that lie in shared memory.
//
// Tables are words [slice of 64 sub-vectors][code][sub-vector of the slice]: the bank of a look-up is its sub-vector,
// and its address is the code put into the second byte of a base. A warp scores a piece of PIECE rows. SIDE lanes side
// by side read SIDE * 16 neighbouring rows of one sub-vector; SIDE such loads are the codes of 32 sub-vectors (a slot).
// Lanes side by side then look up different ones of their loads, so that all 32 lanes meet 32 banks.
typedef unsigned short u16;

constexpr int SCAN_THREADS = 512, SCAN_WARPS = SCAN_THREADS / 32;
constexpr int SIDE = 4;            // 2, 4 or 8
constexpr int SPREAD = 32 / SIDE;  // sub-vectors of a load
constexpr int LANE_ROWS = 16, PIECE = SIDE * LANE_ROWS, SUMS = LANE_ROWS / SPREAD;
constexpr int GROUP_ROWS = 256, CODES = 256, SLOT = 32, SLICE = 64;
constexpr int AHEAD = 2;  // slots whose codes are on their way

struct Slot {
  uint4 codes[SIDE];
};

// Where a warp is: a slot of a piece.
struct Cursor {
  u32 piece;
  int slot;
  DEVICE_MEMBER void next(int slots, u32 stride) {
    if (++slot == slots) slot = 0, piece += stride;
  }
};

// The tables of `slots` slots from sub-vector `first` on; zeros past the last sub-vector.
DEVICE void fill_tables(float *tables, const float *luts, int subvectors, int first, int slots) {
  for (int i = threadIdx.x; i < slots * SLOT * (CODES / 4); i += blockDim.x) {
    const int place = i % SLOT + i / (SLOT * (CODES / 4)) * SLOT, code = i / SLOT % (CODES / 4) * 4;
    const int m = first + place;
    const float4 four =
        m < subvectors ? *(const float4 *)(luts + (size_t)m * CODES + code) : make_float4(0.f, 0.f, 0.f, 0.f);
    float *at = tables + place / SLICE * (SLICE * CODES) + code * SLICE + place % SLICE;
    at[0] = four.x, at[SLICE] = four.y, at[2 * SLICE] = four.z, at[3 * SLICE] = four.w;
  }
}

// codes: from sub-vector `first` on; `left` sub-vectors from there.
DEVICE void load_slot(Slot &slot, const u8 *codes, int subvectors, int left, Cursor at, u32 pieces, int lane) {
  constexpr u32 PIECES_IN_A_GROUP = GROUP_ROWS / PIECE;
  const int m = at.slot * SLOT + lane / SIDE;
  const u8 *from = codes + ((size_t)(at.piece / PIECES_IN_A_GROUP) * subvectors + m) * GROUP_ROWS +
                   at.piece % PIECES_IN_A_GROUP * PIECE + lane % SIDE * LANE_ROWS;
#pragma unroll
  for (int i = 0; i < SIDE; i++) {
    const bool there = at.piece < pieces && m + i * SPREAD < left;
    slot.codes[i] = there ? __ldcs((const uint4 *)(from + i * SPREAD * GROUP_ROWS)) : uint4{0, 0, 0, 0};
  }
}

DEVICE void exchange(u32 &a, u32 &b, bool wanted) {
  const u32 first = wanted ? b : a;
  b = wanted ? a : b, a = first;
}

// Put load t ^ (lane % SIDE) at place t.
DEVICE void turn_loads(Slot &slot, int lane) {
#pragma unroll
  for (int bit = 1; bit < SIDE; bit <<= 1)
#pragma unroll
    for (int t = 0; t < SIDE; t++)
      if (!(t & bit)) {
        uint4 &a = slot.codes[t], &b = slot.codes[t | bit];
        const bool wanted = lane & bit;
        exchange(a.x, b.x, wanted), exchange(a.y, b.y, wanted), exchange(a.z, b.z, wanted), exchange(a.w, b.w, wanted);
      }
}

DEVICE void add_four(float *sums, const u8 *tables, u32 base, u32 codes) {
  sums[0] += *(const float *)(tables + __byte_perm(codes, base, 0x7604));
  sums[1] += *(const float *)(tables + __byte_perm(codes, base, 0x7614));
  sums[2] += *(const float *)(tables + __byte_perm(codes, base, 0x7624));
  sums[3] += *(const float *)(tables + __byte_perm(codes, base, 0x7634));
}

// sums: of the lane's 16 rows.
DEVICE void add_slot(float *sums, const u8 *tables, Slot &slot, int number, int lane) {
  turn_loads(slot, lane);
  const u32 bank = lane % SIDE * SPREAD + lane / SIDE;
  const u32 base = number / 2 << 16 | (number % 2 * SLOT + bank) * 4;
#pragma unroll
  for (int t = 0; t < SIDE; t++) {
    const u32 of_load = base ^ (u32)(t * SPREAD * 4);
    add_four(sums, tables, of_load, slot.codes[t].x), add_four(sums + 4, tables, of_load, slot.codes[t].y);
    add_four(sums + 8, tables, of_load, slot.codes[t].z), add_four(sums + 12, tables, of_load, slot.codes[t].w);
  }
}

// Add up the sums of lanes of the same rows, in a fixed order: a lane keeps those of SUMS rows, `first_row` and after.
DEVICE void share_sums(float *sums, int lane) {
#pragma unroll
  for (int mask = 16, kept = LANE_ROWS / 2; mask >= SIDE; mask >>= 1, kept >>= 1)
#pragma unroll
    for (int i = 0; i < kept; i++) {
      const bool upper = lane & mask;
      const float mine = upper ? sums[i + kept] : sums[i], theirs = upper ? sums[i] : sums[i + kept];
      sums[i] = mine + __shfl_xor_sync(FULL, theirs, mask);
    }
}

// The first of the rows whose sums a lane keeps.
DEVICE u32 first_row(u32 piece, int lane) {
  return piece * PIECE + lane % SIDE * LANE_ROWS + lane / SIDE * SUMS;
}

// What a row's sum is put together with.
struct Ending {
  float before, norm;
  u32 coarse_id;
};

DEVICE Ending ending_of(u32 row, u32 rows, const float *before, const u16 *coarse_ids, const float *inverse_norms) {
  if (row >= rows) return {0.f, 0.f, 0};
  return {before ? before[row] : 0.f, inverse_norms ? inverse_norms[row] : 1.f, coarse_ids ? coarse_ids[row] : 0u};
}

// scores[row] = (before[row] + look-ups of `slots` slots from sub-vector `first` on + coarse[id]) * inverse_norms[row],
// with null for what there is none of. codes (groups, subvectors, 256), luts (subvectors, 256). before may be scores.
KERNEL __launch_bounds__(SCAN_THREADS)
    scan(const u8 *codes, u32 rows, int subvectors, int first, int slots, const float *luts, const float *before,
         const float *coarse, const u16 *coarse_ids, const float *inverse_norms, float *scores) {
  DYNAMIC_SHARED(float, tables);
  const int lane = lane_of_warp(), left = subvectors - first;
  const u32 pieces = (rows + PIECE - 1) / PIECE, stride = gridDim.x * SCAN_WARPS;
  codes += (size_t)first * GROUP_ROWS;
  Cursor at = {blockIdx.x * SCAN_WARPS + warp_of_block(), 0}, ahead = at;
  Slot ring[AHEAD];
#pragma unroll
  for (int i = 0; i < AHEAD; i++)
    load_slot(ring[i], codes, subvectors, left, ahead, pieces, lane), ahead.next(slots, stride);
  fill_tables(tables, luts, subvectors, first, slots);
  __syncthreads();

  float sums[LANE_ROWS] = {};
  Ending endings[SUMS] = {};
  while (at.piece < pieces) {
#pragma unroll
    for (int i = 0; i < AHEAD; i++)
      if (at.piece < pieces) {
        const u32 row = first_row(at.piece, lane);
        if (at.slot == 0)
#pragma unroll
          for (int k = 0; k < SUMS; k++) endings[k] = ending_of(row + k, rows, before, coarse_ids, inverse_norms);
        add_slot(sums, (const u8 *)tables, ring[i], at.slot, lane);
        load_slot(ring[i], codes, subvectors, left, ahead, pieces, lane), ahead.next(slots, stride);
        if (at.slot == slots - 1) {
          share_sums(sums, lane);
#pragma unroll
          for (int k = 0; k < SUMS; k++) {
            const Ending &end = endings[k];
            const float sum = end.before + sums[k] + (coarse ? coarse[end.coarse_id] : 0.f);
            if (row + k < rows) scores[row + k] = sum * end.norm;
          }
#pragma unroll
          for (int k = 0; k < LANE_ROWS; k++) sums[k] = 0.f;
        }
        at.next(slots, stride);
      }
  }
}

// Let the scores of query `query` take part in each row's best, the first of equals, and the next highest.
KERNEL keep_best(const float *scores, u32 rows, int query, int *index, float *best, float *next) {
  const u32 row = blockIdx.x * blockDim.x + threadIdx.x;
  if (row >= rows) return;
  const float score = scores[row], before = query ? best[row] : __uint_as_float(0xff800000u);  // -inf
  const bool better = query == 0 || score > before;
  next[row] = better ? before : fmaxf(next[row], score);
  best[row] = better ? score : before;
  if (better) index[row] = query;
}
