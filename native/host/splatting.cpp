#include "host/splatting.h"

#include <new>

namespace drsplat {
namespace {

struct TileRun {
  int worker;
  size_t begin, end;
};  // where a tile's triples lie

// Adds one weight to the last Gaussian's entries, which begin at `first` and stay sorted by segment.
void add_weight(MergedTriples &out, size_t first, uint32_t id, SegmentWeight entry) {
  int32_t *segments = out.segment_ids.data();
  float *weights = out.weights.data();
  size_t at = out.size;
  while (at > first && segments[at - 1] > entry.segment) at--;
  if (at > first && segments[at - 1] == entry.segment) {
    weights[at - 1] += entry.weight;
    return;
  }
  for (size_t i = out.size; i > at; i--) segments[i] = segments[i - 1], weights[i] = weights[i - 1];
  segments[at] = entry.segment, weights[at] = entry.weight;
  out.gaussian_ids[out.size++] = id;
}

// Sorts the triples of Gaussians [begin, end) by Gaussian (in tile order, so that sums do not
// depend on who computed which tile), then adds up equal segments of each Gaussian.
void merge_part(const Workspace &w, const std::vector<TileRun> &runs, uint32_t begin, uint32_t end, Worker &worker) {
  const uint32_t rows = end - begin;
  auto &start = worker.row_start;
  start.assign(rows + 2, 0);  // counts of row r go to r + 2, so that filling leaves starts in place
  const auto each_triple = [&](auto visit) {
    for (const TileRun &run : runs) {
      const Triples &triples = w.workers[run.worker]->triples;
      const auto *id = (const uint32_t *)triples.gaussian_ids.data;
      for (size_t i = run.begin; i < run.end; i++)
        if (id[i] - begin < rows) visit(id[i] - begin, triples, i);
    }
  };
  each_triple([&](uint32_t row, const Triples &, size_t) { start[row + 2]++; });
  for (uint32_t r = 2; r < rows + 2; r++) start[r] += start[r - 1];
  grow(worker.by_row, start[rows + 1]);
  each_triple([&](uint32_t row, const Triples &triples, size_t i) {
    worker.by_row[start[row + 1]++] = {((const int32_t *)triples.segment_ids.data)[i],
                                       ((const float *)triples.weights.data)[i]};
  });
  const uint32_t size = start[rows];
  MergedTriples &out = worker.merged;
  grow(out.gaussian_ids, size), grow(out.segment_ids, size), grow(out.weights, size);
  out.size = 0;
  for (uint32_t row = 0; row < rows; row++) {
    const size_t first = out.size;
    for (uint32_t i = start[row]; i < start[row + 1]; i++) add_weight(out, first, begin + row, worker.by_row[i]);
  }
}

// Merged in memory that is kept from view to view, then copied: fresh pages cost more than the copy.
ViewTriples merge(const Workspace &w, const std::vector<TileRun> &runs, uint32_t count, int threads) {
  over_parts(count, threads,
             [&](int t, uint32_t begin, uint32_t end) { merge_part(w, runs, begin, end, *w.workers[t]); });
  size_t total = 0;
  for (int t = 0; t < threads; t++) total += w.workers[t]->merged.size;
  ViewTriples out;
  out.gaussian_ids.reserve(total), out.segment_ids.reserve(total), out.weights.reserve(total);
  for (int t = 0; t < threads; t++) {
    const MergedTriples &part = w.workers[t]->merged;
    const auto append = [&](auto &to, const auto &from) { to.insert(to.end(), from.data(), from.data() + part.size); };
    append(out.gaussian_ids, part.gaussian_ids), append(out.segment_ids, part.segment_ids);
    append(out.weights, part.weights);
  }
  return out;
}

}  // namespace

ViewTriples view_weights(const Kernels &kernels, const Scene &scene, const Camera &camera, const Selection &selection,
                         const int32_t *segment_ids, int threads, StageSeconds &seconds) {
  Lease w(threads);
  seconds = prepare(*w, kernels, scene, camera, threads);
  const double t0 = now();
  std::vector<TileRun> runs((size_t)w->columns * w->rows);
  for (auto &worker : w->workers) worker->triples.size = 0;
  each_tile(*w, camera, threads, [&](int t, int i, const Tile &tile) {
    Worker &worker = *w->workers[t];
    const size_t begin = worker.triples.size;
    kernels.tile_weights(tile, selection, segment_ids, worker.scratch, worker.triples);
    runs[i] = {t, begin, worker.triples.size};
  });
  const double t1 = now();
  size_t triples = 0;
  for (const auto &worker : w->workers) triples += worker->triples.size;
  if (triples > UINT32_MAX) throw std::bad_alloc();  // 48 GiB of them; rows are counted in 32 bits
  ViewTriples out = merge(*w, runs, scene.count, threads);
  seconds.composite = t1 - t0, seconds.merge = now() - t1;
  return out;
}

void topk_contributions(const Kernels &kernels, const Scene &scene, const Camera &camera, const Selection &selection,
                        int threads, int32_t *ids, float *weights) {
  Lease w(threads);
  prepare(*w, kernels, scene, camera, threads);
  each_tile(*w, camera, threads, [&](int t, int, const Tile &tile) {
    kernels.tile_contributions(tile, selection, w->workers[t]->scratch, ids, weights);
  });
}

void render(const Kernels &kernels, const Scene &scene, const Camera &camera, const float *values, int32_t channels,
            const float *background, int threads, float *image, float *alpha, float *depth) {
  Lease w(threads);
  prepare(*w, kernels, scene, camera, threads);
  each_tile(*w, camera, threads, [&](int t, int, const Tile &tile) {
    kernels.tile_render(tile, values, channels, background, w->workers[t]->scratch, image, alpha, depth);
  });
}

void sh_colors(const Kernels &kernels, const float *sh, int32_t coefficients, const float *means, const float *center,
               uint32_t count, int threads, float *colors) {
  over_parts(count, threads, [&](int, uint32_t begin, uint32_t end) {
    kernels.sh_colors(sh, coefficients, means, center, begin, end, colors);
  });
}

}  // namespace drsplat
