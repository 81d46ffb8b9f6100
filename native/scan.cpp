// The scans of scan_kernels.cpp on several threads. Every row is scored by one thread, whichever, and what is
// found is put in order at the end: the same bits for any number of them.
#include "scan_rows.h"

#include "parallel.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <memory>
#include <new>

namespace drsplat {
namespace {

struct Free {
  void operator()(void *p) const { std::free(p); }
};
using Memory = std::unique_ptr<void, Free>;

Memory aligned(size_t bytes) {
  Memory memory(std::aligned_alloc(64, std::max<size_t>(64, (bytes + 63) / 64 * 64)));
  if (!memory) throw std::bad_alloc();
  return memory;
}

constexpr uint64_t kBlockRows = 16 * kPairRows;       // handed to a thread at once
constexpr uint64_t kManyBlockRows = 128 * kPairRows;  // the same where tables of many queries pass by

// A prepared scan; `next` hands out blocks of rows.
struct Scan {
  const ScanKernels &kernels;
  const GroupedRows &rows;
  const QueryTables &tables;
  Memory prepared;
  uint64_t block_rows;
  std::atomic<uint64_t> next{0};

  Scan(const ScanKernels &kernels_, const GroupedRows &rows_, const QueryTables &tables_, Precision precision, int threads)
      : kernels(kernels_), rows(rows_), tables(tables_),
        prepared(aligned(kernels.prepared_bytes(rows.subvectors, tables.queries))), block_rows(tables.queries > kQueryTile ? kManyBlockRows : kBlockRows) {
    std::atomic<uint32_t> tile{0};
    const uint32_t tiles = (tables.queries + kQueryTile - 1) / kQueryTile;
    parallel((int)std::max(1u, std::min((uint32_t)threads, tiles)), [&](int) {
      for (uint32_t t; (t = tile.fetch_add(1)) < tiles;) kernels.prepare(tables, rows.subvectors, precision, t * kQueryTile, std::min(tables.queries, (t + 1) * kQueryTile), prepared.get());
    });
  }

  uint64_t blocks() const { return (rows.rows + block_rows - 1) / block_rows; }
  const float *coarse(uint32_t query) const { return tables.coarse ? tables.coarse + (size_t)query * tables.coarse_count : nullptr; }

  // work(thread, block, query, first row, rows, sums) for every pair of groups and every query, queries in order.
  template <class Work>
  void run(int threads, Work work) {
    parallel((int)std::max<uint64_t>(1, std::min<uint64_t>(threads, blocks())), [&](int thread) {
      const Memory scratch = aligned(kernels.scratch_bytes(rows.subvectors)), sums = aligned(sizeof(float) * kPairRows * kQueryTile);
      for (uint64_t block; (block = next.fetch_add(1)) < blocks();) {
        const uint64_t begin = block * block_rows, end = std::min(rows.rows, begin + block_rows);
        for (uint32_t query = 0; query < tables.queries; query += kQueryTile) {
          const uint32_t last = std::min(tables.queries, query + kQueryTile);
          for (uint64_t row = begin; row < end; row += kPairRows) {
            float *of_query = (float *)sums.get();
            kernels.sums(rows, tables.queries, prepared.get(), query, last, row, scratch.get(), of_query);
            const uint32_t count = (uint32_t)std::min<uint64_t>(kPairRows, end - row);
            for (uint32_t q = query; q < last; q++, of_query += kPairRows) work(thread, block, q, row, count, of_query);
          }
        }
      }
    });
  }

  void finish(uint32_t query, uint64_t row, uint32_t count, const float *sums, float *scores) const { kernels.finish(rows, coarse(query), tables.coarse_count, row, count, sums, scores); }
};

bool before(const CandidateRow &a, const CandidateRow &b) { return a.score > b.score || (a.score == b.score && a.row < b.row); }

// The best `count` candidates seen, and some more.
struct Best {
  std::vector<CandidateRow> found;
  float cutoff = -std::numeric_limits<float>::infinity();  // `count` rows are at least as good

  void shrink(size_t count) {
    if (found.size() <= count) return;
    std::nth_element(found.begin(), found.begin() + (ptrdiff_t)(count - 1), found.end(), before);
    found.resize(count);
    cutoff = found.back().score;
  }
  void offer(const ScanKernels &kernels, const float *scores, uint64_t first, uint32_t rows, size_t count) {
    CandidateRow some[kPairRows + 1];
    const float below = std::nextafter(cutoff, -std::numeric_limits<float>::infinity());
    found.insert(found.end(), some, some + kernels.above(scores, nullptr, below, first, rows, some));
    if (found.size() >= 2 * count + 1024) shrink(count);
  }
};

}  // namespace

void lookup_tables(const ScanKernels &kernels, const float *centroids, const float *queries, uint32_t count, uint32_t subvectors, uint32_t dim, int threads, float *tables) {
  const bool small = (uint64_t)count * subvectors * dim < 1 << 14;  // threads cost more than that
  const int workers = small ? 1 : (int)std::min<uint32_t>((uint32_t)threads, subvectors);
  parallel(workers, [&](int t) {
    const Part part = part_of(subvectors, workers, t);
    kernels.lookup_tables(centroids, queries, count, subvectors, dim, part.begin, part.end, tables);
  });
}

void scan_scores(const ScanKernels &kernels, const GroupedRows &rows, const QueryTables &tables, Precision precision, int threads, float *scores) {
  Scan scan(kernels, rows, tables, precision, threads);
  scan.run(threads, [&](int, uint64_t, uint32_t query, uint64_t row, uint32_t count, const float *sums) { scan.finish(query, row, count, sums, scores + (size_t)query * rows.rows + row); });
}

std::vector<CandidateRow> scan_above(const ScanKernels &kernels, const GroupedRows &rows, const QueryTables &tables, Precision precision, const float *floor, float threshold, int threads) {
  Scan scan(kernels, rows, tables, precision, threads);
  std::vector<std::vector<CandidateRow>> of_block(scan.blocks());
  scan.run(threads, [&](int, uint64_t block, uint32_t, uint64_t row, uint32_t count, float *sums) {
    CandidateRow found[kPairRows + 1];
    scan.finish(0, row, count, sums, sums);
    const uint32_t n = kernels.above(sums, floor ? floor + row : nullptr, threshold, row, count, found);
    of_block[block].insert(of_block[block].end(), found, found + n);
  });
  std::vector<CandidateRow> all;
  size_t total = 0;
  for (const auto &found : of_block) total += found.size();
  all.reserve(total);
  for (const auto &found : of_block) all.insert(all.end(), found.begin(), found.end());
  return all;
}

std::vector<CandidateRow> scan_top(const ScanKernels &kernels, const GroupedRows &rows, const QueryTables &tables, Precision precision, size_t count, int threads) {
  Scan scan(kernels, rows, tables, precision, threads);
  std::vector<Best> of_thread((size_t)std::max(threads, 1));
  scan.run(threads, [&](int thread, uint64_t, uint32_t, uint64_t row, uint32_t n, float *sums) {
    scan.finish(0, row, n, sums, sums);
    of_thread[(size_t)thread].offer(kernels, sums, row, n, count);
  });
  std::vector<CandidateRow> all;
  for (const Best &best : of_thread) all.insert(all.end(), best.found.begin(), best.found.end());
  std::sort(all.begin(), all.end(), before);
  all.resize(std::min(count, all.size()));
  return all;
}

void scan_best(const ScanKernels &kernels, const GroupedRows &rows, const QueryTables &tables, Precision precision, int threads, int32_t *winner, float *best, float *runner_up) {
  Scan scan(kernels, rows, tables, precision, threads);
  const std::vector<float> ones(rows.coarse_ids ? kPairRows : 0, 1.f);
  scan.run(threads, [&](int, uint64_t, uint32_t query, uint64_t row, uint32_t count, float *sums) {
    if (query == 0) {
      std::fill_n(winner + row, count, 0);
      std::fill_n(best + row, count, -std::numeric_limits<float>::infinity());
      std::fill_n(runner_up + row, count, -std::numeric_limits<float>::infinity());
    }
    if (rows.coarse_ids) scan.finish(query, row, count, sums, sums);
    kernels.compete(sums, rows.coarse_ids ? ones.data() : rows.inverse_norms + row, (int32_t)query, count, winner + row, best + row, runner_up + row);
  });
}

}  // namespace drsplat
