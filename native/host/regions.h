// Regions of Gaussians that the masks of the photos hold together: a forest of merges.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace drsplat {

// W in CSR, columns ascending in each row; its rows in another order. views: of each column, from 0, never falling.
// embeddings: columns x dim, unit.
struct Votes {
  const int64_t *order;
  const int64_t *starts;
  const int32_t *columns;
  const float *weights;
  uint32_t rows, masks;
  const int32_t *views;
  const float *embeddings;
  uint32_t dim;

  int64_t begin(size_t row) const { return starts[order[row]]; }
  int64_t end(size_t row) const { return starts[order[row] + 1]; }
  size_t num_views() const { return masks ? (size_t)views[masks - 1] + 1 : 0; }
};

struct Edge { int32_t a, b; };

// soft: weight in a view that makes it count half; far: of a region's, for how well masks fit it. local: the share of
// the agreement along the border. prior, least: what regions that are hardly seen together are taken to agree, and
// how much that counts. unlike: what unrelated embeddings cost; unit: 1 - their cosine. tolerance: below the best that
// merges as well. rounds: at most, at each threshold. smallest: rows of a region that is judged. linked: of the
// threshold, what the heaviest regions of a chain have to agree by.
struct MergeRule {
  double soft, far, local, prior, least, unlike, unit, tolerance;
  int rounds;
  int64_t smallest;
  double linked;
};

// Nodes: first the rows, then merges in their order; parents come after their children. fits: how well the masks of
// the photos that see a region are it, [0, 1]. spread: the largest distance of embeddings that was merged in it, 1 for
// unrelated ones. Both are 0 for regions below `smallest`.
struct Forest {
  std::vector<int32_t> parents;
  std::vector<float> agreements, masses, fits, spreads;
  std::vector<int32_t> sizes;
};

// The same bits for any number of threads.
Forest agglomerate(const Votes &, const Edge *, size_t num_edges, const std::vector<double> &thresholds,
                   const MergeRule &, int threads);

}  // namespace drsplat
