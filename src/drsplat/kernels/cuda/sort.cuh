// A stable sort of 32-bit keys with 32-bit values, a byte of the key a pass, each pass one read and one write.
//
// A block counts its keys by digit, tells the blocks behind it, and adds up what those before it have told ("decoupled
// look-back": Merrill & Garland 2016; as a sort: Adinets & Merrill, "Onesweep", 2022). Blocks take numbers in the order
// in which they start, so that none waits for one that has not.
constexpr int SORT_THREADS = 256, SORT_ITEMS = 16, SORT_BLOCK = SORT_THREADS * SORT_ITEMS, DIGITS = 256;
constexpr u32 TOLD_OWN = 1u << 30, TOLD_ALL = 2u << 30, COUNT_BITS = TOLD_OWN - 1;

// histograms: (passes, 256), zero before.
KERNEL sort_histograms(const u32 *keys, u32 count, int passes, u32 *histograms) {
  __shared__ u32 local[4 * DIGITS];
  for (int i = threadIdx.x; i < 4 * DIGITS; i += blockDim.x) local[i] = 0;
  __syncthreads();
  for (u32 at = blockIdx.x * blockDim.x + threadIdx.x; at < count; at += gridDim.x * blockDim.x)
    for (int pass = 0; pass < passes; pass++) atomicAdd(&local[pass * DIGITS + (keys[at] >> 8 * pass & 255)], 1u);
  __syncthreads();
  for (int i = threadIdx.x; i < passes * DIGITS; i += blockDim.x)
    if (local[i]) atomicAdd(&histograms[i], local[i]);
}

// Of thread d of 256: the sum of all `value` of threads before it.
DEVICE u32 sum_before(u32 value, u32 *of_warps) {
  const int lane = lane_of_warp();
  u32 sum = value;
  for (int step = 1; step < 32; step <<= 1) {
    const u32 other = __shfl_up_sync(FULL, sum, step);
    if (lane >= step) sum += other;
  }
  if (lane == 31) of_warps[warp_of_block()] = sum;
  __syncthreads();
  for (int w = 0; w < warp_of_block(); w++) sum += of_warps[w];
  __syncthreads();
  return sum - value;
}

// Lanes whose digit (0 to 255) is this lane's; nothing for a lane that is not valid.
DEVICE u32 lanes_alike(u32 digit, bool valid) {
  u32 alike = __ballot_sync(FULL, valid);
  for (int bit = 0; bit < 8; bit++) {
    const bool set = digit >> bit & 1;
    const u32 vote = __ballot_sync(FULL, set);
    alike &= set ? vote : ~vote;
  }
  return valid ? alike : 0;
}

// One pass. values null: the places of the keys. status: (blocks, 256), and ticket: zero before.
KERNEL __launch_bounds__(SORT_THREADS)
    sort_pass(const u32 *keys, const u32 *values, u32 *keys_out, u32 *values_out, u32 count, int shift,
              const u32 *histogram, u32 *status, u32 *ticket) {
  __shared__ u32 counts[SORT_THREADS / 32][DIGITS], start[DIGITS], of_warps[SORT_THREADS / 32], number;
  const int lane = lane_of_warp(), warp = warp_of_block(), digit_here = threadIdx.x;
  if (threadIdx.x == 0) number = atomicAdd(ticket, 1u);
  for (int w = 0; w < SORT_THREADS / 32; w++) counts[w][threadIdx.x] = 0;
  __syncthreads();
  const u32 block = number, first = block * SORT_BLOCK + warp * 32 * SORT_ITEMS + lane;

  u32 key[SORT_ITEMS], rank[SORT_ITEMS];
#pragma unroll
  for (int i = 0; i < SORT_ITEMS; i++) key[i] = first + 32 * i < count ? keys[first + 32 * i] : 0;
#pragma unroll
  for (int i = 0; i < SORT_ITEMS; i++) {
    const bool valid = first + 32 * i < count;
    const u32 digit = key[i] >> shift & 255, alike = lanes_alike(digit, valid);
    const u32 seen = counts[warp][digit];
    __syncwarp();
    if (valid && lane == __ffs(alike) - 1) counts[warp][digit] = seen + __popc(alike);
    __syncwarp();
    rank[i] = seen + __popc(alike & ((1u << lane) - 1));
  }
  __syncthreads();

  u32 total = 0;
  for (int w = 0; w < SORT_THREADS / 32; w++) {
    const u32 c = counts[w][digit_here];
    counts[w][digit_here] = total;
    total += c;
  }
  volatile u32 *told = status + digit_here;
  told[(size_t)block * DIGITS] = total | (block ? TOLD_OWN : TOLD_ALL);
  u32 before = 0;
  for (u32 b = block; b-- > 0;) {
    u32 word;
    do word = told[(size_t)b * DIGITS];
    while (!(word & ~COUNT_BITS));
    before += word & COUNT_BITS;
    if (word & TOLD_ALL) break;
  }
  if (block) told[(size_t)block * DIGITS] = (before + total) | TOLD_ALL;
  const u32 smaller = sum_before(histogram[digit_here], of_warps);
  start[digit_here] = smaller + before;
  __syncthreads();
#pragma unroll
  for (int i = 0; i < SORT_ITEMS; i++) {
    const u32 at = first + 32 * i;
    if (at >= count) continue;
    const u32 digit = key[i] >> shift & 255, to = start[digit] + counts[warp][digit] + rank[i];
    keys_out[to] = key[i], values_out[to] = values ? values[at] : at;
  }
}

// --- running sums --------------------------------------------------------------------------------

constexpr int SCAN_ITEMS = 8, SCAN_BLOCK = SORT_THREADS * SCAN_ITEMS;
constexpr u64 TOLD_OWN_SUM = 1ull << 62, TOLD_ALL_SUM = 2ull << 62, SUM_BITS = TOLD_OWN_SUM - 1;

// ends[i]: the sum of counts[order[k]], k <= i; order null: of counts[k]. status (blocks) and ticket: zero before.
KERNEL __launch_bounds__(SORT_THREADS)
    sum_counts(const u32 *counts, const u32 *order, u32 n, i64 *ends, u64 *status, u32 *ticket) {
  __shared__ u64 of_warps[SORT_THREADS / 32], shared_before;
  __shared__ u32 number;
  const int lane = lane_of_warp(), warp = warp_of_block();
  if (threadIdx.x == 0) number = atomicAdd(ticket, 1u);
  __syncthreads();
  const u32 block = number, first = block * SCAN_BLOCK + threadIdx.x * SCAN_ITEMS;
  u32 item[SCAN_ITEMS];
  u64 own = 0;
#pragma unroll
  for (int i = 0; i < SCAN_ITEMS; i++) {
    const u32 at = first + i;
    item[i] = at < n ? counts[order ? order[at] : at] : 0, own += item[i];
  }
  u64 sum = own;
  for (int step = 1; step < 32; step <<= 1) {
    const u64 other = __shfl_up_sync(FULL, sum, step);
    if (lane >= step) sum += other;
  }
  if (lane == 31) of_warps[warp] = sum;
  __syncthreads();
  u64 total = 0, of_others = 0;
  for (int w = 0; w < SORT_THREADS / 32; w++) {
    if (w < warp) of_others += of_warps[w];
    total += of_warps[w];
  }
  if (threadIdx.x == 0) {
    volatile u64 *told = status;
    u64 before = 0;
    told[block] = total | (block ? TOLD_OWN_SUM : TOLD_ALL_SUM);
    for (u32 b = block; b-- > 0;) {
      u64 word;
      do word = told[b];
      while (!(word & ~SUM_BITS));
      before += word & SUM_BITS;
      if (word & TOLD_ALL_SUM) break;
    }
    if (block) told[block] = (before + total) | TOLD_ALL_SUM;
    shared_before = before;
  }
  __syncthreads();
  u64 running = shared_before + of_others + sum - own;
#pragma unroll
  for (int i = 0; i < SCAN_ITEMS; i++) {
    running += item[i];
    if (first + i < n) ends[first + i] = (i64)running;
  }
}
