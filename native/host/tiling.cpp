#include "host/tiling.h"
#include "host/sorting.h"

#include <algorithm>
#include <cstring>
#include <new>

namespace drsplat {
namespace {

void project_all(Workspace &w, const Kernels &kernels, const Scene &scene, const Camera &camera, int threads) {
  w.columns = (camera.width + 15) / 16, w.rows = (camera.height + 15) / 16;
  grow(w.projected, scene.count), grow(w.projected_extents, scene.count);
  Kept<uint32_t> &written = w.projected_counts;
  written.assign(threads, 0);
  over_parts(scene.count, threads, [&](int t, uint32_t begin, uint32_t end) {
    written[t] =
        kernels.project(scene, camera, begin, end, w.projected.data() + begin, w.projected_extents.data() + begin);
  });
  w.visible = 0;
  for (uint32_t n : written) w.visible += n;
  grow(w.keys, w.visible), grow(w.other_keys, w.visible);
  uint32_t at = 0;
  for (int t = 0; t < threads; t++) {
    const uint32_t begin = part_start(scene.count, threads, t);
    for (uint32_t i = begin; i < begin + written[t]; i++) {
      uint32_t bits;  // of a positive float: orders as the float does
      std::memcpy(&bits, &w.projected[i].depth, 4);
      w.keys[at++] = (uint64_t)bits << 32 | i;
    }
  }
}

uint32_t bits_at(const float *column, uint32_t row) {
  uint32_t bits;
  std::memcpy(&bits, column + row, 4);
  return bits;
}

// The order of Gaussians of one depth: by the bits of what they are, so that it does not hang on their rows. Only rows
// that are the same in everything follow their index.
struct Tied {
  uint64_t place, key;  // place: x and y, which tell nearly all apart
  uint32_t row;
};

struct ByContent {
  const Scene &scene;

  Tied tied(uint64_t key, uint32_t row) const {
    return {(uint64_t)bits_at(scene.means, row) << 32 | bits_at(scene.means + scene.count, row), key, row};
  }

  bool operator()(const Tied &a, const Tied &b) const {
    if (a.place != b.place) return a.place < b.place;
    for (size_t c = 0; c < 8; c++) {
      const float *column = c == 0  ? scene.means + 2 * (size_t)scene.count
                            : c < 7 ? scene.covariances + (c - 1) * scene.count
                                    : scene.opacities;
      const uint32_t x = bits_at(column, a.row), y = bits_at(column, b.row);
      if (x != y) return x < y;
    }
    return a.row < b.row;
  }
};

// Each part begins and ends between two depths, so that no run of one depth is sorted by two threads.
void settle_ties(Workspace &w, const Scene &scene, int threads) {
  const auto tied = [&](uint32_t i) { return i > 0 && i < w.visible && w.keys[i] >> 32 == w.keys[i - 1] >> 32; };
  std::vector<uint32_t> starts(threads + 1);
  for (int t = 0; t <= threads; t++) {
    uint32_t &at = starts[t] = part_start(w.visible, threads, t);
    while (tied(at)) at++;
  }
  parallel(threads, [&](int t) {
    const ByContent order{scene};
    std::vector<Tied> run;
    for (uint32_t i = starts[t], end; i < starts[t + 1]; i = end) {
      for (end = i + 1; end < starts[t + 1] && tied(end); end++) {}
      if (end - i == 1) continue;
      run.clear();
      for (uint32_t k = i; k < end; k++) run.push_back(order.tied(w.keys[k], w.projected[(uint32_t)w.keys[k]].id));
      std::sort(run.begin(), run.end(), order);
      for (uint32_t k = i; k < end; k++) w.keys[k] = run[k - i].key;
    }
  });
}

// Front to back; of equal depths by content.
void sort_by_depth(Workspace &w, const Scene &scene, int threads, bool way_back) {
  for (int shift = 32; shift < 64; shift += 11) {
    const int bits = std::min(11, 64 - shift);
    radix_pass(w, w.keys, w.other_keys, w.visible, bits, threads,
               [=](uint64_t key) { return (uint32_t)(key >> shift) & ((1u << bits) - 1); });
  }
  settle_ties(w, scene, threads);
  grow(w.splats, w.visible), grow(w.extents, w.visible);
  if (way_back) grow(w.ranks, w.projected.size());
  over_parts(w.visible, threads, [&](int, uint32_t begin, uint32_t end) {
    for (uint32_t i = begin; i < end; i++) {
      if (i + 16 < end) {
        __builtin_prefetch(&w.projected[(uint32_t)w.keys[i + 16]]);
        __builtin_prefetch(&w.projected_extents[(uint32_t)w.keys[i + 16]]);
      }
      w.splats[i] = w.projected[(uint32_t)w.keys[i]];
      w.extents[i] = w.projected_extents[(uint32_t)w.keys[i]];
      if (way_back) w.ranks[(uint32_t)w.keys[i]] = i;
    }
  });
}

// The spans of each tile row, front to back; a counting sort by row.
void find_spans(Workspace &w, const Kernels &kernels, int threads) {
  over_parts(w.visible, threads, [&](int t, uint32_t begin, uint32_t end) {
    auto &counts = w.workers[t]->row_counts;
    counts.assign(w.rows + 1, 0);
    for (uint32_t i = begin; i < end; i++) counts[w.extents[i].y0]++, counts[w.extents[i].y1]--;
    for (int row = 1; row < w.rows; row++) counts[row] += counts[row - 1];
  });
  grow(w.spans_start, w.rows + 1);
  uint64_t sum = 0;
  for (int row = 0; row < w.rows; row++) {
    w.spans_start[row] = (uint32_t)sum;
    for (int t = 0; t < threads; t++) {
      uint32_t &c = w.workers[t]->row_counts[row], n = c;
      c = (uint32_t)sum, sum += n;
    }
  }
  if (sum > UINT32_MAX) throw std::bad_alloc();
  w.spans_start[w.rows] = (uint32_t)sum;
  grow(w.spans, sum);
  over_parts(w.visible, threads, [&](int t, uint32_t begin, uint32_t end) {
    kernels.tile_spans(w.splats.data(), w.extents.data(), begin, end, w.spans.data(), w.workers[t]->row_counts.data());
  });
}

// Calls visit(span, numbers of its row's tiles and one more, row) for all spans, each row's on one thread.
template <class Visit>
void each_span(Workspace &w, uint32_t *tiles, int threads, Visit visit) {
  over_rows((uint64_t)w.rows, 1, threads, [&](int, uint64_t row, uint64_t) {
    for (uint32_t i = w.spans_start[row]; i < w.spans_start[row + 1]; i++)
      visit(w.spans[i], tiles + row * ((uint64_t)w.columns + 1), (int)row);
  });
}

// Where each splat's rows of sums begin, in index order: as many as tiles in its spans.
void find_rows(Workspace &w, uint64_t pairs, int threads) {
  const size_t n = w.projected.size();
  grow(w.rows_of_list, pairs), grow(w.rows_start, n + 1);
  std::fill_n(w.rows_start.begin(), n + 1, 0);
  each_span(w, w.tile_next.data(), threads, [&](const TileSpan &span, uint32_t *, int row) {
    if (row + 1 == w.extents[span.splat].y1)
      w.rows_start[(uint32_t)w.keys[span.splat] + 1] = span.before + span.last - span.first;
  });
  for (size_t i = 0; i < n; i++) w.rows_start[i + 1] += w.rows_start[i];
}

// Counting sort of (tile, splat) pairs by tile, a row of tiles at a time, whose ends of lists stay in the cache; since
// spans come in depth order, so does every list.
void bin_into_tiles(Workspace &w, const Kernels &kernels, int threads, bool way_back) {
  find_spans(w, kernels, threads);
  const size_t tiles = (size_t)w.columns * w.rows;
  grow(w.tile_start, tiles + 1), grow(w.tile_next, tiles + w.rows);
  // first, by how much more splats touch a tile than the one before
  std::fill_n(w.tile_next.begin(), tiles + w.rows, 0);
  each_span(w, w.tile_next.data(), threads,
            [](const TileSpan &span, uint32_t *changes, int) { changes[span.first]++, changes[span.last]--; });
  uint64_t sum = 0;
  uint32_t *next = w.tile_next.data(), *start = w.tile_start.data();
  for (int row = 0; row < w.rows; row++, next++)
    for (uint32_t x = 0, count = 0; x < (uint32_t)w.columns; x++, next++) {
      count += *next;
      *start++ = *next = (uint32_t)sum, sum += count;
    }
  if (sum > UINT32_MAX) throw std::bad_alloc();
  w.tile_start[tiles] = (uint32_t)sum;
  grow(w.list, sum);
  if (way_back) find_rows(w, sum, threads);
  each_span(w, w.tile_next.data(), threads, [&](const TileSpan &span, uint32_t *at, int) {
    uint32_t row_of_sums = way_back ? w.rows_start[(uint32_t)w.keys[span.splat]] + span.before : 0;
    for (uint32_t x = span.first; x < span.last; x++) {
      if (way_back) w.rows_of_list[at[x]] = row_of_sums++;
      w.list[at[x]++] = span.splat;
    }
  });
}

}  // namespace

StageSeconds prepare(Workspace &w, const Kernels &kernels, const Scene &scene, const Camera &camera, int threads,
                     bool way_back) {
  StageSeconds seconds;
  const double t0 = now();
  project_all(w, kernels, scene, camera, threads);
  const double t1 = now();
  sort_by_depth(w, scene, threads, way_back);
  const double t2 = now();
  bin_into_tiles(w, kernels, threads, way_back);
  seconds.project = t1 - t0, seconds.sort = t2 - t1, seconds.bin = now() - t2;
  return seconds;
}

}  // namespace drsplat
