// Memory for one view at a time.
#pragma once
#include <memory>
#include <vector>

#include "host/memory.h"
#include "kernels/kernels.h"

namespace drsplat {

struct Triple {
  uint32_t gaussian;
  int32_t segment;
  float weight;
};

struct MergedTriples {  // the first `size`: sorted by (Gaussian, segment)
  Kept<uint32_t> gaussian_ids;
  Kept<int32_t> segment_ids;
  Kept<float> weights;
  size_t size = 0;
};

struct Worker {
  TileScratch scratch;
  Triples triples;
  MergedTriples merged;
  Kept<uint32_t> row_counts, tile_counts, digit_counts;
};

// What one view needs between projecting its splats and visiting its tiles, kept for the next one: fresh pages cost as
// much as the work on them.
struct Workspace {
  Kept<Splat> projected, splats;
  Kept<Extent> projected_extents, extents;
  Kept<uint64_t> keys, other_keys;
  Kept<TileSpan> spans;  // row after row, front to back
  Kept<uint32_t> list, spans_start, tile_start, tile_next;
  Kept<Triple> triples, other_triples;
  // For the way back, if asked: how many each thread projected, in index order; the depth rank of each,
  // and where its rows of sums begin, one for each tile; of each entry of `list`, its row.
  Kept<uint32_t> projected_counts, ranks, rows_start, rows_of_list;
  Kept<float> scene, colors, sums, gradients;  // training only
  Kept<uint16_t> blocks;                       // also: of each entry of `list`, the blocks in which it reaches a ray
  std::vector<std::unique_ptr<Worker>> workers;
  int columns = 0, rows = 0;
  uint32_t visible = 0;
};

void release_idle();  // gives back the memory of workspaces that nobody uses

class Lease {  // a workspace nobody else is using
 public:
  explicit Lease(int threads);
  ~Lease();
  Lease(const Lease &) = delete;
  Workspace *operator->() const { return space_.get(); }
  Workspace &operator*() const { return *space_; }

 private:
  std::unique_ptr<Workspace> space_;
};

}  // namespace drsplat
