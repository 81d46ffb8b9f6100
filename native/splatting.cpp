#include "splatting.h"

#include "parallel.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <mutex>

namespace drsplat {
namespace {

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

void free_buffers(std::initializer_list<Buffer *> buffers) {
  for (Buffer *b : buffers) std::free(b->data);
}

struct SegmentWeight { int32_t segment; float weight; };

struct Worker {
  TileScratch scratch;
  Triples triples;
  std::vector<uint32_t> spans, tile_counts, depth_counts, row_start;
  std::vector<SegmentWeight> by_row;

  Worker() = default;
  Worker(const Worker &) = delete;
  ~Worker() {
    free_buffers({&scratch.block_masks, &scratch.hits, &scratch.hit_list, &scratch.table, &scratch.slots, &triples.gaussian_ids,
                  &triples.segment_ids, &triples.weights});
  }
};

// Memory that one view needs, kept for the next one: fresh pages cost as much as the work on them.
struct Workspace {
  std::vector<Splat> projected, splats;
  std::vector<Extent> projected_extents, extents;
  std::vector<uint64_t> keys, other_keys;
  std::vector<uint32_t> list, tile_start;
  std::vector<std::unique_ptr<Worker>> workers;
  int columns = 0, rows = 0;
  uint32_t visible = 0;
};

class Lease {  // a workspace nobody else is using
 public:
  explicit Lease(int threads) {
    {
      std::lock_guard<std::mutex> lock(mutex());
      if (!idle().empty()) space_ = std::move(idle().back()), idle().pop_back();
    }
    if (!space_) space_ = std::make_unique<Workspace>();
    while ((int)space_->workers.size() < threads) space_->workers.push_back(std::make_unique<Worker>());
  }
  ~Lease() {
    std::lock_guard<std::mutex> lock(mutex());
    if (idle().size() < 2) idle().push_back(std::move(space_));
  }
  Workspace *operator->() const { return space_.get(); }
  Workspace &operator*() const { return *space_; }

 private:
  static std::mutex &mutex() { static std::mutex m; return m; }
  static std::vector<std::unique_ptr<Workspace>> &idle() { static std::vector<std::unique_ptr<Workspace>> list; return list; }
  std::unique_ptr<Workspace> space_;
};

template <class T>
void grow(std::vector<T> &v, size_t n) {
  if (v.size() < n) v.resize(n);
}

void project_all(Workspace &w, const Kernels &kernels, const Scene &scene, const Camera &camera, int threads) {
  w.columns = (camera.width + 15) / 16, w.rows = (camera.height + 15) / 16;
  grow(w.projected, scene.count), grow(w.projected_extents, scene.count);
  std::vector<uint32_t> written(threads);
  parallel(threads, [&](int t) {
    const Part p = part_of(scene.count, threads, t);
    written[t] = kernels.project(scene, camera, p.begin, p.end, w.projected.data() + p.begin, w.projected_extents.data() + p.begin);
  });
  w.visible = 0;
  for (uint32_t n : written) w.visible += n;
  grow(w.keys, w.visible), grow(w.other_keys, w.visible);
  uint32_t at = 0;
  for (int t = 0; t < threads; t++) {
    const uint32_t begin = part_of(scene.count, threads, t).begin;
    for (uint32_t i = begin; i < begin + written[t]; i++) {
      uint32_t bits;  // of a positive float: orders as the float does
      std::memcpy(&bits, &w.projected[i].depth, 4);
      w.keys[at++] = (uint64_t)bits << 32 | i;
    }
  }
}

// One stable counting-sort pass over `bits` bits of the keys; thread histograms keep it stable.
void radix_pass(Workspace &w, int shift, int bits, int threads) {
  const uint32_t buckets = 1u << bits, mask = buckets - 1;
  parallel(threads, [&](int t) {
    auto &counts = w.workers[t]->depth_counts;
    counts.assign(buckets, 0);
    const Part p = part_of(w.visible, threads, t);
    for (uint32_t i = p.begin; i < p.end; i++) counts[w.keys[i] >> shift & mask]++;
  });
  uint32_t sum = 0;
  for (uint32_t b = 0; b < buckets; b++)
    for (int t = 0; t < threads; t++) {
      uint32_t &c = w.workers[t]->depth_counts[b], n = c;
      c = sum, sum += n;
    }
  parallel(threads, [&](int t) {
    auto &next = w.workers[t]->depth_counts;
    const Part p = part_of(w.visible, threads, t);
    for (uint32_t i = p.begin; i < p.end; i++) w.other_keys[next[w.keys[i] >> shift & mask]++] = w.keys[i];
  });
  w.keys.swap(w.other_keys);
}

// Front to back; equal depths in index order.
void sort_by_depth(Workspace &w, int threads) {
  for (int pass = 0; pass < 3; pass++) radix_pass(w, 32 + 11 * pass, pass == 2 ? 10 : 11, threads);
  grow(w.splats, w.visible), grow(w.extents, w.visible);
  parallel(threads, [&](int t) {
    const Part p = part_of(w.visible, threads, t);
    for (uint32_t i = p.begin; i < p.end; i++) {
      if (i + 16 < p.end) {
        __builtin_prefetch(&w.projected[(uint32_t)w.keys[i + 16]]);
        __builtin_prefetch(&w.projected_extents[(uint32_t)w.keys[i + 16]]);
      }
      w.splats[i] = w.projected[(uint32_t)w.keys[i]];
      w.extents[i] = w.projected_extents[(uint32_t)w.keys[i]];
    }
  });
}

// Counting sort of (tile, splat) pairs by tile; since splats come in depth order, so does every list.
void bin_into_tiles(Workspace &w, const Kernels &kernels, int threads) {
  const int tiles = w.columns * w.rows;
  parallel(threads, [&](int t) {
    Worker &worker = *w.workers[t];
    const Part p = part_of(w.visible, threads, t);
    size_t rows = 0;
    for (uint32_t i = p.begin; i < p.end; i++) rows += w.extents[i].y1 - w.extents[i].y0;
    grow(worker.spans, rows);
    worker.tile_counts.assign(tiles, 0);
    kernels.tile_spans(w.splats.data() + p.begin, w.extents.data() + p.begin, p.end - p.begin, w.columns, worker.spans.data(), worker.tile_counts.data());
  });
  grow(w.tile_start, tiles + 1);
  uint64_t sum = 0;
  for (int tile = 0; tile < tiles; tile++) {
    w.tile_start[tile] = (uint32_t)sum;
    for (int t = 0; t < threads; t++) {
      uint32_t &c = w.workers[t]->tile_counts[tile], n = c;
      c = (uint32_t)sum, sum += n;
    }
  }
  if (sum > UINT32_MAX) out_of_memory();
  w.tile_start[tiles] = (uint32_t)sum;
  grow(w.list, sum);
  parallel(threads, [&](int t) {
    Worker &worker = *w.workers[t];
    const uint32_t *span = worker.spans.data();
    const Part p = part_of(w.visible, threads, t);
    for (uint32_t i = p.begin; i < p.end; i++)
      for (int row = w.extents[i].y0; row < w.extents[i].y1; row++, span++)
        for (uint32_t x = *span & 0xffff; x < *span >> 16; x++) w.list[worker.tile_counts[(size_t)row * w.columns + x]++] = i;
  });
}

StageSeconds prepare(Workspace &w, const Kernels &kernels, const Scene &scene, const Camera &camera, int threads) {
  StageSeconds seconds;
  const double t0 = now();
  project_all(w, kernels, scene, camera, threads);
  const double t1 = now();
  sort_by_depth(w, threads);
  const double t2 = now();
  bin_into_tiles(w, kernels, threads);
  seconds.project = t1 - t0, seconds.sort = t2 - t1, seconds.bin = now() - t2;
  return seconds;
}

// Calls work(worker number, tile number, tile) for every tile, on whichever thread is free.
template <class Work>
void each_tile(Workspace &w, const Camera &camera, int threads, Work work) {
  std::atomic<int> next{0};
  const int tiles = w.columns * w.rows, batch = 4;
  parallel(threads, [&](int t) {
    for (int first; (first = next.fetch_add(batch)) < tiles;)
      for (int i = first; i < std::min(first + batch, tiles); i++) {
        const uint32_t begin = w.tile_start[i];
        const Tile tile = {w.splats.data(), w.list.data() + begin, w.tile_start[i + 1] - begin, i % w.columns, i / w.columns, camera.width, camera.height};
        work(t, i, tile);
      }
  });
}

struct TileRun { int worker; size_t begin, end; };  // where a tile's triples lie

// Adds one weight to the last Gaussian's entries, which begin at `first` and stay sorted by segment.
void add_weight(ViewTriples &out, size_t first, uint32_t id, SegmentWeight entry) {
  size_t at = out.weights.size();
  while (at > first && out.segment_ids[at - 1] > entry.segment) at--;
  if (at > first && out.segment_ids[at - 1] == entry.segment) {
    out.weights[at - 1] += entry.weight;
    return;
  }
  out.gaussian_ids.push_back(id);
  out.segment_ids.insert(out.segment_ids.begin() + at, entry.segment);
  out.weights.insert(out.weights.begin() + at, entry.weight);
}

// Sorts the triples of Gaussians [ids.begin, ids.end) by Gaussian (in tile order, so that sums do not
// depend on who computed which tile), then adds up equal segments of each Gaussian.
void merge_part(const Workspace &w, const std::vector<TileRun> &runs, Part ids, Worker &worker, ViewTriples &out) {
  const uint32_t rows = ids.end - ids.begin;
  auto &start = worker.row_start;
  start.assign(rows + 2, 0);  // counts of row r go to r + 2, so that filling leaves starts in place
  const auto each_triple = [&](auto visit) {
    for (const TileRun &run : runs) {
      const Triples &triples = w.workers[run.worker]->triples;
      const auto *id = (const uint32_t *)triples.gaussian_ids.data;
      for (size_t i = run.begin; i < run.end; i++)
        if (id[i] - ids.begin < rows) visit(id[i] - ids.begin, triples, i);
    }
  };
  each_triple([&](uint32_t row, const Triples &, size_t) { start[row + 2]++; });
  for (uint32_t r = 2; r < rows + 2; r++) start[r] += start[r - 1];
  grow(worker.by_row, start[rows + 1]);
  each_triple([&](uint32_t row, const Triples &triples, size_t i) {
    worker.by_row[start[row + 1]++] = {((const int32_t *)triples.segment_ids.data)[i], ((const float *)triples.weights.data)[i]};
  });
  const uint32_t size = start[rows];
  out.gaussian_ids.reserve(size), out.segment_ids.reserve(size), out.weights.reserve(size);
  for (uint32_t row = 0; row < rows; row++) {
    const size_t first = out.weights.size();
    for (uint32_t i = start[row]; i < start[row + 1]; i++) add_weight(out, first, ids.begin + row, worker.by_row[i]);
  }
}

template <class T>
void append(std::vector<T> &to, const std::vector<T> &from) { to.insert(to.end(), from.begin(), from.end()); }

ViewTriples merge(const Workspace &w, const std::vector<TileRun> &runs, uint32_t count, int threads) {
  std::vector<ViewTriples> parts(threads);
  parallel(threads, [&](int t) { merge_part(w, runs, part_of(count, threads, t), *w.workers[t], parts[t]); });
  for (int t = 1; t < threads; t++) {
    append(parts[0].gaussian_ids, parts[t].gaussian_ids);
    append(parts[0].segment_ids, parts[t].segment_ids);
    append(parts[0].weights, parts[t].weights);
  }
  return std::move(parts[0]);
}

}  // namespace

ViewTriples view_weights(const Kernels &kernels, const Scene &scene, const Camera &camera, const Selection &selection, const int32_t *segment_ids, int threads,
                         StageSeconds &seconds) {
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

void topk_contributions(const Kernels &kernels, const Scene &scene, const Camera &camera, const Selection &selection, int threads, int32_t *ids, float *weights) {
  Lease w(threads);
  prepare(*w, kernels, scene, camera, threads);
  each_tile(*w, camera, threads, [&](int t, int, const Tile &tile) { kernels.tile_contributions(tile, selection, w->workers[t]->scratch, ids, weights); });
}

void render(const Kernels &kernels, const Scene &scene, const Camera &camera, const float *values, int32_t channels, const float *background, int threads, float *image,
            float *alpha, float *depth) {
  Lease w(threads);
  prepare(*w, kernels, scene, camera, threads);
  each_tile(*w, camera, threads,
            [&](int t, int, const Tile &tile) { kernels.tile_render(tile, values, channels, background, w->workers[t]->scratch, image, alpha, depth); });
}

void sh_colors(const Kernels &kernels, const float *sh, int32_t coefficients, const float *means, const float *center, uint32_t count, int threads, float *colors) {
  parallel(threads, [&](int t) {
    const Part p = part_of(count, threads, t);
    kernels.sh_colors(sh, coefficients, means, center, p.begin, p.end, colors);
  });
}

}  // namespace drsplat
