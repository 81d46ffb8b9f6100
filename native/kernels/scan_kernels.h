// Search in product-quantised codes: what the scan kernels and their callers say to each other.
//
// Codes lie in groups of 256 rows, sub-vector by sub-vector: (groups, subvectors, 256) bytes. A group is one
// stream through memory, and 64 codes of one sub-vector are one register.
#pragma once
#include <cstddef>
#include <cstdint>

namespace drsplat {

constexpr uint32_t kGroupRows = 256;
constexpr uint32_t kSumRows = 8 * kGroupRows;  // whose sums are asked for at once
constexpr uint32_t kQueryTile = 8;             // queries whose tables stay in half an L2 cache together

struct GroupedRows {
  const uint8_t *codes;        // ceil(rows / 256) x subvectors x 256; bytes past the last row are ignored
  const float *inverse_norms;  // rows
  const uint16_t *coarse_ids;  // rows; null for plain codes
  uint64_t rows;
  uint32_t subvectors;
};

struct QueryTables {
  const float *tables;  // queries x subvectors x 256
  const float *coarse;  // queries x coarse_count; null for plain codes
  uint32_t queries, coarse_count;
};

// How far the sum of look-ups may be off. `error` is never exceeded where `wide` is 0: then tables have as
// many bytes per entry as that takes. Else only the `wide` sub-vectors of the widest range have more than one
// byte, and six standard deviations of the rounding stay below `error`.
struct Precision {
  float error;
  uint32_t wide;
};

// One translation unit, compiled once per instruction set (see CMakeLists.txt).
struct ScanKernels {
  // Bytes that `prepare` writes for `queries` queries at most, and of scratch memory that `sums` needs.
  size_t (*prepared_bytes)(uint32_t subvectors, uint32_t queries);
  size_t (*scratch_bytes)(uint32_t subvectors);
  // Tables as `sums` reads them, of queries [begin, end); begin is a multiple of kQueryTile.
  void (*prepare)(const QueryTables &, uint32_t subvectors, Precision, uint32_t begin, uint32_t end, void *prepared);
  // Sums of look-ups of rows [first_row, first_row + 2048) for queries [begin, end) of one tile: (queries, 2048).
  void (*sums)(const GroupedRows &, uint32_t queries, const void *prepared, uint32_t begin, uint32_t end,
               uint64_t first_row, void *scratch, float *out);
  // scores = (sum + coarse term) * inverse norm; `out` may be `sums`.
  void (*finish)(const GroupedRows &, const float *coarse, uint32_t coarse_count, uint64_t first_row, uint32_t count,
                 const float *sums, float *out);
  // Which scores - floor (or scores, where floor is null) exceed the threshold; returns how many. `out`: count + 16.
  uint32_t (*above)(const float *scores, const float *floor, float threshold, uint32_t count, uint32_t *out);
  // Let `queries` from `first` on, of one tile, compete with sum * scale: `best` and `runner_up` are the two highest so
  // far, ties to the earlier; query 0 finds nothing written.
  void (*compete)(const float *sums, const float *scale, uint32_t first, uint32_t queries, uint32_t count,
                  int32_t *winner, float *best, float *runner_up);
  // tables[q][m][c] = sum over d of queries[q][m][d] * centroids[m][d][c], for sub-vectors [begin, end).
  void (*lookup_tables)(const float *centroids, const float *queries, uint32_t count, uint32_t subvectors, uint32_t dim,
                        uint32_t begin, uint32_t end, float *tables);
};

}  // namespace drsplat
