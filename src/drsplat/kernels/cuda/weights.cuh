// The largest blending weights of each pixel, and their sums by Gaussian and mask: one view's entries of W.
//
// A first walk finds each pixel's k-th largest weight, a second one takes what reaches it. Each warp has room of its
// own in the list that it writes, so that the order of the entries, and with it every sum, is the same each time.
struct Chosen { float threshold; int room; };  // room: weights equal to the threshold that are taken, front to back

DEVICE bool takes(float weight, Chosen &c) {
  if (weight > c.threshold) return true;
  return weight == c.threshold && weight > 0.f && c.room-- > 0;
}

struct Largest {  // the k largest weights of a pixel, in a column of its own
  float *column;
  int k, count, place;  // place: of the smallest
  float smallest;

  DEVICE_MEMBER void find_smallest() {
    smallest = column[0], place = 0;
    for (int i = 1; i < k; i++)
      if (column[256 * i] < smallest) smallest = column[256 * i], place = i;
  }
  DEVICE_MEMBER void add(float weight) {
    if (count < k) {
      column[256 * count++] = weight;
      if (count == k) find_smallest();
    } else if (weight > smallest) {
      column[256 * place] = weight;
      find_smallest();
    }
  }
  DEVICE_MEMBER Chosen chosen() const {
    if (!k || count < k) return {0.f, 0};
    int equal = 0;
    for (int i = 0; i < k; i++) equal += column[256 * i] == smallest;
    return {smallest, equal};
  }
};

// masks (height, width): of each pixel, -1 for none; null: all pixels are wanted. topk 0: all weights. columns_of_tiles
// (tiles, topk, 256): room for the largest, null: shared memory. chosen (height, width). bounds (tiles, 8): of what
// put_weights writes, or null.
KERNEL __launch_bounds__(256)
    choose_weights(const u32 *starts, const u32 *ids, const Splat *splats, int first_tile, int width, int height, int columns,
                   const int *masks, int topk, int first_hits, float *columns_of_tiles, Chosen *chosen, u32 *bounds) {
  __shared__ Batch<256> batch;
  DYNAMIC_SHARED(float, shared_columns);
  const int tile = first_tile + blockIdx.x;
  const Place place = place_of_thread(tile, columns, width, height);
  const List list = {ids, starts[tile], starts[tile + 1], splats, nullptr, tile, columns};
  const size_t pixel = (size_t)place.y * width + place.x;
  const int mask = !place.inside ? -1 : masks ? masks[pixel] : 0;
  float *column = columns_of_tiles ? columns_of_tiles + (size_t)blockIdx.x * topk * 256 : shared_columns;
  Largest largest = {column + threadIdx.x, topk, 0, 0, 0.f};
  u32 seen = 0;
  walk(
      batch, list, place, mask >= 0, first_hits,
      [&](int, const Hit &hit) {
        seen += __any_sync(FULL, hit.weight > 0.f) != 0;
        if (topk && hit.weight > 0.f) largest.add(hit.weight);
      },
      [](u32, u32) {});
  if (place.inside) chosen[pixel] = largest.chosen();
  if (!bounds) return;
  u32 kinds = 0;  // of masks in this warp
  for (u32 left = __ballot_sync(FULL, mask >= 0); left; kinds++)
    left &= ~__ballot_sync(FULL, mask == __shfl_sync(FULL, mask, __ffs(left) - 1));
  if (lane_of_warp() == 0) bounds[blockIdx.x * WARPS + warp_of_block()] = seen * kinds;
}

// ends (tiles, 8): of each warp's room, by the bounds. Room that is left has Gaussian n.
KERNEL __launch_bounds__(256)
    put_weights(const u32 *starts, const u32 *ids, const Splat *splats, int first_tile, int width, int height, int columns,
                const int *masks, int first_hits, const Chosen *chosen, const u32 *bounds, const i64 *ends, u32 n,
                u32 *gaussians, u32 *mask_ids, float *weights) {
  __shared__ Batch<256> batch;
  const int tile = first_tile + blockIdx.x, warp = blockIdx.x * WARPS + warp_of_block(), lane = lane_of_warp();
  const Place place = place_of_thread(tile, columns, width, height);
  const List list = {ids, starts[tile], starts[tile + 1], splats, nullptr, tile, columns};
  const size_t pixel = (size_t)place.y * width + place.x;
  const int mask = place.inside ? masks[pixel] : -1;
  const u32 wanted = __ballot_sync(FULL, mask >= 0);
  Chosen mine = {0.f, 0};
  if (place.inside) mine = chosen[pixel];
  i64 at = ends[warp] - bounds[warp];
  walk(
      batch, list, place, mask >= 0, first_hits,
      [&](int j, const Hit &hit) {
        const float weight = takes(hit.weight, mine) ? hit.weight : 0.f;
        if (!__any_sync(FULL, weight > 0.f)) return;
        for (u32 left = wanted; left;) {
          const int one = __shfl_sync(FULL, mask, __ffs(left) - 1);
          const float sum = warp_sum(mask == one ? weight : 0.f);
          left &= ~__ballot_sync(FULL, mask == one);
          if (sum > 0.f) {
            if (lane == 0) gaussians[at] = batch.ids[j], mask_ids[at] = (u32)one, weights[at] = sum;
            at++;
          }
        }
      },
      [](u32, u32) {});
  for (i64 rest = at + lane; rest < ends[warp]; rest += 32) gaussians[rest] = n, mask_ids[rest] = 0, weights[rest] = 0.f;
}

// ids and values (height, width, topk), which hold -1 and 0: descending, equal ones front to back.
KERNEL __launch_bounds__(256)
    put_contributions(const u32 *starts, const u32 *ids, const Splat *splats, int first_tile, int width, int height, int columns,
                      int topk, int first_hits, const Chosen *chosen, int *found, float *values) {
  __shared__ Batch<256> batch;
  const int tile = first_tile + blockIdx.x;
  const Place place = place_of_thread(tile, columns, width, height);
  const List list = {ids, starts[tile], starts[tile + 1], splats, nullptr, tile, columns};
  const size_t pixel = (size_t)place.y * width + place.x;
  Chosen mine = {0.f, 0};
  if (place.inside) mine = chosen[pixel];
  int filled = 0;
  walk(
      batch, list, place, place.inside, first_hits,
      [&](int j, const Hit &hit) {
        if (!takes(hit.weight, mine)) return;
        int *id = found + pixel * topk;
        float *value = values + pixel * topk;
        int to = filled++;
        for (; to > 0 && value[to - 1] < hit.weight; to--) id[to] = id[to - 1], value[to] = value[to - 1];
        id[to] = (int)batch.ids[j], value[to] = hit.weight;
      },
      [](u32, u32) {});
}

// Entries in the order (Gaussian, mask): 1 where another pair begins; Gaussian n ends the list.
KERNEL mark_pairs(const u32 *places, const u32 *gaussians, const u32 *mask_ids, u32 count, u32 n, u32 *begins) {
  const u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= count) return;
  const u32 at = places[i], g = gaussians[at], m = mask_ids[at];
  const bool first = i == 0 || gaussians[places[i - 1]] != g || mask_ids[places[i - 1]] != m;
  begins[i] = g < n && first;
}

// The sum of each pair's weights. numbers: inclusive sums of `begins`.
KERNEL add_pairs(const u32 *places, const u32 *gaussians, const u32 *mask_ids, const float *weights, u32 count, u32 n,
                 const u32 *begins, const i64 *numbers, u32 *out_gaussians, u32 *out_masks, float *out_weights) {
  const u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= count || !begins[i]) return;
  const i64 to = numbers[i] - 1;
  float sum = 0.f;
  for (u32 k = i; k < count && (k == i || !begins[k]); k++) {
    if (gaussians[places[k]] == n) break;
    sum += weights[places[k]];
  }
  out_gaussians[to] = gaussians[places[i]], out_masks[to] = mask_ids[places[i]], out_weights[to] = sum;
}
