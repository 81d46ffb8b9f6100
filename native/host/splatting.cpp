#include "host/splatting.h"
#include "host/sorting.h"

#include <new>

namespace drsplat {
namespace {

struct TileRun {
  int worker;
  size_t begin, end;
};  // where a tile's triples lie

// All triples in the order of their tiles, so that sums do not depend on who computed which.
uint32_t gather_triples(Workspace &w, const std::vector<TileRun> &runs, int threads) {
  std::vector<size_t> starts(runs.size() + 1);
  for (size_t i = 0; i < runs.size(); i++) starts[i + 1] = starts[i] + (runs[i].end - runs[i].begin);
  const size_t count = starts.back();
  if (count > UINT32_MAX) throw std::bad_alloc();  // 48 GiB of them; rows are counted in 32 bits
  grow(w.triples, count), grow(w.other_triples, count);
  over_parts(runs.size(), threads, [&](int, size_t begin, size_t end) {
    for (size_t r = begin; r < end; r++) {
      const Triples &from = w.workers[runs[r].worker]->triples;
      Triple *to = w.triples.data() + starts[r];
      for (size_t i = runs[r].begin; i < runs[r].end; i++)
        *to++ = {((const uint32_t *)from.gaussian_ids.data)[i], ((const int32_t *)from.segment_ids.data)[i],
                 ((const float *)from.weights.data)[i]};
    }
  });
  return (uint32_t)count;
}

// Adds up triples of one Gaussian and segment, of those whose first is in [begin, end).
void merge_part(const Workspace &w, uint32_t count, uint32_t begin, uint32_t end, MergedTriples &out) {
  const auto follows = [&](uint32_t i) {
    const Triple &a = w.triples[i - 1], &b = w.triples[i];
    return (a.gaussian == b.gaussian) & (a.segment == b.segment);
  };
  while (begin > 0 && begin < end && follows(begin)) begin++;
  while (end > begin && end < count && follows(end)) end++;
  grow(out.gaussian_ids, end - begin), grow(out.segment_ids, end - begin), grow(out.weights, end - begin);
  out.size = 0;
  float sum = 0;
  for (uint32_t i = begin; i < end; i++) {  // without a branch, which is not to be foreseen
    const bool more = i > begin && follows(i);
    out.size += !more;
    sum = w.triples[i].weight + (more ? sum : 0.f);
    out.gaussian_ids[out.size - 1] = w.triples[i].gaussian, out.segment_ids[out.size - 1] = w.triples[i].segment;
    out.weights[out.size - 1] = sum;
  }
}

// Stable: equal ones stay in the order of their tiles.
void sort_triples(Workspace &w, uint32_t count, uint32_t gaussians, int threads) {
  uint32_t most = 0;
  for (uint32_t i = 0; i < count; i++) most = std::max(most, (uint32_t)w.triples[i].segment);
  for (int shift = 0; shift < 32 && most >> shift; shift += 11)
    radix_pass(w, w.triples, w.other_triples, count, 11, threads,
               [=](const Triple &triple) { return (uint32_t)triple.segment >> shift & 0x7ff; });
  for (int shift = 0; shift < 32 && gaussians >> shift; shift += 11)
    radix_pass(w, w.triples, w.other_triples, count, 11, threads,
               [=](const Triple &triple) { return triple.gaussian >> shift & 0x7ff; });
}

// In memory that is kept from view to view, then copied: fresh pages cost more than the copy.
ViewTriples merge(Workspace &w, const std::vector<TileRun> &runs, uint32_t gaussians, int threads) {
  const uint32_t count = gather_triples(w, runs, threads);
  sort_triples(w, count, gaussians, threads);
  over_parts(count, threads,
             [&](int t, uint32_t begin, uint32_t end) { merge_part(w, count, begin, end, w.workers[t]->merged); });
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
