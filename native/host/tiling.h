// One view as tiles, each with its splats front to back.
#pragma once
#include <chrono>

#include "host/parallel.h"
#include "host/workspace.h"

namespace drsplat {

inline double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

struct StageSeconds { double project = 0, sort = 0, bin = 0, composite = 0, merge = 0; };

// Projects, sorts by depth and bins into tiles. `way_back` fills ranks and rows.
StageSeconds prepare(Workspace &, const Kernels &, const Scene &, const Camera &, int threads, bool way_back = false);

// Calls work(worker number, tile number, tile) for every tile, on whichever thread is free.
template <class Work>
void each_tile(Workspace &w, const Camera &camera, int threads, Work work) {
  over_rows((uint64_t)w.columns * w.rows, 4, threads, [&](int t, uint64_t begin, uint64_t end) {
    for (int i = (int)begin; i < (int)end; i++) {
      const uint32_t first = w.tile_start[i];
      const Tile tile = {w.splats.data(), w.list.data() + first, w.tile_start[i + 1] - first,
                         i % w.columns,   i / w.columns,         camera.width,
                         camera.height};
      work(t, i, tile);
    }
  });
}

}  // namespace drsplat
