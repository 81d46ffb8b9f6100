// Search in product-quantised codes, as the bindings call it: all rows, on several threads.
#pragma once
#include "host/candidates.h"

namespace drsplat {

void lookup_tables(const ScanKernels &, const float *centroids, const float *queries, uint32_t count,
                   uint32_t subvectors, uint32_t dim, int threads, float *tables);

// queries x rows
void scan_scores(const ScanKernels &, const GroupedRows &, const QueryTables &, Precision, int threads, float *scores);

// Of the first query: rows whose score - floor exceeds the threshold, ascending. `floor` may be null.
Found scan_above(const ScanKernels &, const GroupedRows &, const QueryTables &, Precision, const float *floor,
                 float threshold, int threads);

// Of the first query: the `count` best rows, best first, ties to the lower row.
Found scan_top(const ScanKernels &, const GroupedRows &, const QueryTables &, Precision, size_t count, int threads);

// Per row the best query (ties to the earlier), its score and the second best score.
void scan_best(const ScanKernels &, const GroupedRows &, const QueryTables &, Precision, int threads, int32_t *winner,
               float *best, float *runner_up);

}  // namespace drsplat
