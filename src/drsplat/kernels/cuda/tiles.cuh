// Which splats touch which tile, front to back: pairs in order of depth, which a stable sort by tile then keeps.
constexpr u32 FEW_TILES = 16;  // of a splat: more are listed by the whole warp

struct Pairs { u32 *tiles, *values, *owners; };

// owners null: a value is the splat's Gaussian. Else it is the pair's row: rows of one Gaussian follow each other.
DEVICE void put_pair(const Pairs &out, i64 at, i64 row, u32 tile, u32 gaussian) {
  out.tiles[at] = tile, out.values[at] = out.owners ? (u32)row : gaussian;
  if (out.owners) out.owners[row] = gaussian;
}

// order: Gaussians front to back. ends: of each one's pairs, in that order. row_ends: in the order of the Gaussians.
KERNEL list_tiles(const u32 *order, const u32 *counts, const i64 *ends, const i64 *row_ends, const Splat *splats,
                  const Extent *extents, u32 n, int columns, u32 *tiles, u32 *values, u32 *owners) {
  const u32 rank = blockIdx.x * blockDim.x + threadIdx.x;
  const Pairs out = {tiles, values, owners};
  const u32 mine = rank < n ? order[rank] : 0, count = rank < n ? counts[mine] : 0;
  const i64 first = count ? ends[rank] - count : 0, first_row = count && owners ? row_ends[mine] - count : 0;
  if (count && count <= FEW_TILES) {
    const Splat s = splats[mine];
    const Extent e = extents[mine];
    u32 k = 0;
    for (int row = e.y0; row < e.y1; row++) {
      const Span span = span_in_row(s, e, row);
      for (int x = span.first; x < span.last; x++, k++)
        put_pair(out, first + k, first_row + k, (u32)(row * columns + x), mine);
    }
  }
  for (u32 many = __ballot_sync(FULL, count > FEW_TILES); many; many &= many - 1) {
    const int lane = __ffs(many) - 1;
    const u32 gaussian = __shfl_sync(FULL, mine, lane);
    i64 at = __shfl_sync(FULL, first, lane), at_row = __shfl_sync(FULL, first_row, lane);
    const Splat s = splats[gaussian];
    const Extent e = extents[gaussian];
    for (int row = e.y0; row < e.y1; row++) {
      const Span span = span_in_row(s, e, row);
      for (int x = span.first + lane_of_warp(); x < span.last; x += 32)
        put_pair(out, at + x - span.first, at_row + x - span.first, (u32)(row * columns + x), gaussian);
      at += span.last - span.first, at_row += span.last - span.first;
    }
  }
}

// starts: (tiles + 1), of each tile's run in the sorted pairs. ids: Gaussians of the pairs, where values are rows.
KERNEL find_tiles(const u32 *tiles, const u32 *values, const u32 *owners, u32 count, u32 num_tiles, u32 *starts,
                  u32 *ids) {
  const u32 at = blockIdx.x * blockDim.x + threadIdx.x;
  if (at >= count) return;
  const u32 tile = tiles[at];
  for (u32 t = at ? tiles[at - 1] + 1 : 0; t <= tile; t++) starts[t] = at;
  if (at + 1 == count)
    for (u32 t = tile + 1; t <= num_tiles; t++) starts[t] = count;
  if (ids) ids[at] = owners[values[at]];
}
