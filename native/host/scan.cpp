// Every row is scored by one thread, whichever, and what is found is put in order at the end: the same bits for any
// number of them.
#include "host/scan.h"

#include "host/parallel.h"
#include "kernels/buffer.h"

#include <algorithm>

namespace drsplat {
namespace {

constexpr uint64_t kBlockRows = 4 * kSumRows;       // handed to a thread at once
constexpr uint64_t kManyBlockRows = 32 * kSumRows;  // the same where tables of many queries pass by

// A prepared scan.
struct Scan {
  const ScanKernels &kernels;
  const GroupedRows &rows;
  const QueryTables &tables;
  Buffer prepared;
  uint64_t block_rows;

  Scan(const ScanKernels &kernels_, const GroupedRows &rows_, const QueryTables &tables_, Precision precision,
       int threads)
      : kernels(kernels_),
        rows(rows_),
        tables(tables_),
        block_rows(tables.queries > kQueryTile ? kManyBlockRows : kBlockRows) {
    reserve(prepared, kernels.prepared_bytes(rows.subvectors, tables.queries));
    over_rows(tables.queries, kQueryTile, threads, [&](int, uint64_t begin, uint64_t end) {
      kernels.prepare(tables, rows.subvectors, precision, (uint32_t)begin, (uint32_t)end, prepared.data);
    });
  }

  uint64_t blocks() const { return (rows.rows + block_rows - 1) / block_rows; }
  const float *coarse(uint32_t query) const {
    return tables.coarse ? tables.coarse + (size_t)query * tables.coarse_count : nullptr;
  }

  // work(thread, block, first query, queries, first row, rows, sums) for kSumRows at a time and every tile of
  // queries, in their order.
  template <class Work>
  void run(int threads, Work work) const {
    std::vector<Buffer> scratch(threads), sums(threads);
    over_rows(rows.rows, block_rows, threads, [&](int thread, uint64_t begin, uint64_t end) {
      reserve(scratch[thread], kernels.scratch_bytes(rows.subvectors));
      reserve(sums[thread], sizeof(float) * kSumRows * kQueryTile);
      for (uint32_t query = 0; query < tables.queries; query += kQueryTile) {
        const uint32_t last = std::min(tables.queries, query + kQueryTile);
        for (uint64_t row = begin; row < end; row += kSumRows) {
          float *of_query = (float *)sums[thread].data;
          kernels.sums(rows, tables.queries, prepared.data, query, last, row, scratch[thread].data, of_query);
          const uint32_t count = (uint32_t)std::min<uint64_t>(kSumRows, end - row);
          work(thread, begin / block_rows, query, last - query, row, count, of_query);
        }
      }
    });
  }

  void finish(uint32_t query, uint64_t row, uint32_t count, const float *sums, float *scores) const {
    kernels.finish(rows, coarse(query), tables.coarse_count, row, count, sums, scores);
  }
};

}  // namespace

void lookup_tables(const ScanKernels &kernels, const float *centroids, const float *queries, uint32_t count,
                   uint32_t subvectors, uint32_t dim, int threads, float *tables) {
  const bool small = (uint64_t)count * subvectors * dim < 1 << 14;  // threads cost more than that
  const int workers = small ? 1 : (int)std::min<uint32_t>((uint32_t)threads, subvectors);
  over_parts(subvectors, workers, [&](int, uint32_t begin, uint32_t end) {
    kernels.lookup_tables(centroids, queries, count, subvectors, dim, begin, end, tables);
  });
}

void scan_scores(const ScanKernels &kernels, const GroupedRows &rows, const QueryTables &tables, Precision precision,
                 int threads, float *scores) {
  const Scan scan(kernels, rows, tables, precision, threads);
  scan.run(threads,
           [&](int, uint64_t, uint32_t first, uint32_t queries, uint64_t row, uint32_t count, const float *sums) {
             for (uint32_t q = first; q < first + queries; q++, sums += kSumRows)
               scan.finish(q, row, count, sums, scores + (size_t)q * rows.rows + row);
           });
}

Found scan_above(const ScanKernels &kernels, const GroupedRows &rows, const QueryTables &tables, Precision precision,
                 const float *floor, float threshold, int threads) {
  const Scan scan(kernels, rows, tables, precision, threads);
  std::vector<Found> of_block(scan.blocks());
  scan.run(threads, [&](int, uint64_t block, uint32_t, uint32_t, uint64_t row, uint32_t count, float *sums) {
    scan.finish(0, row, count, sums, sums);
    add_above(kernels, sums, floor ? floor + row : nullptr, threshold, row, count, of_block[block]);
  });
  return joined(of_block);
}

Found scan_top(const ScanKernels &kernels, const GroupedRows &rows, const QueryTables &tables, Precision precision,
               size_t count, int threads) {
  const Scan scan(kernels, rows, tables, precision, threads);
  BestRows best(kernels, count, threads);
  scan.run(threads, [&](int thread, uint64_t, uint32_t, uint32_t, uint64_t row, uint32_t n, float *sums) {
    scan.finish(0, row, n, sums, sums);
    best.offer(thread, sums, row, n);
  });
  return std::move(best).best();
}

void scan_best(const ScanKernels &kernels, const GroupedRows &rows, const QueryTables &tables, Precision precision,
               int threads, int32_t *winner, float *best, float *runner_up) {
  const Scan scan(kernels, rows, tables, precision, threads);
  const std::vector<float> ones(rows.coarse_ids ? kSumRows : 0, 1.f);
  scan.run(threads, [&](int, uint64_t, uint32_t first, uint32_t queries, uint64_t row, uint32_t count, float *sums) {
    for (uint32_t q = 0; q < queries && rows.coarse_ids; q++)
      scan.finish(first + q, row, count, sums + q * kSumRows, sums + q * kSumRows);
    kernels.compete(sums, rows.coarse_ids ? ones.data() : rows.inverse_norms + row, first, queries, count, winner + row,
                    best + row, runner_up + row);
  });
}

}  // namespace drsplat
