// What one view needs between projecting its splats and visiting its tiles.
#pragma once
#include "kernels.h"
#include "memory.h"
#include "parallel.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <vector>

namespace drsplat {

inline double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

struct StageSeconds { double project = 0, sort = 0, bin = 0, composite = 0, merge = 0; };

struct SegmentWeight { int32_t segment; float weight; };

struct Worker {
  TileScratch scratch;
  Triples triples;
  Kept<uint32_t> spans, tile_counts, depth_counts, row_start;
  Kept<SegmentWeight> by_row;

  Worker() = default;
  Worker(const Worker &) = delete;
  ~Worker() {
    for (Buffer *b : {&scratch.block_masks, &scratch.hits, &scratch.hit_list, &scratch.table, &triples.gaussian_ids, &triples.segment_ids, &triples.weights}) std::free(b->data);
  }
};

// Memory that one view needs, kept for the next one: fresh pages cost as much as the work on them.
struct Workspace {
  Kept<Splat> projected, splats;
  Kept<Extent> projected_extents, extents;
  Kept<uint64_t> keys, other_keys;
  Kept<uint32_t> list, tile_start;
  // For the way back, if asked: how many each thread projected, in index order; the depth rank of each,
  // and its entries of `list` in tile order.
  Kept<uint32_t> projected_counts, ranks, places, places_start;
  Kept<float> scene, colors, sums, gradients;  // training only
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

// Projects, sorts by depth and bins into tiles. `way_back` fills ranks and places.
StageSeconds prepare(Workspace &, const Kernels &, const Scene &, const Camera &, int threads, bool way_back = false);

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

}  // namespace drsplat
