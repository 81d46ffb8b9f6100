// Scores are sums of whole numbers and every row is made by one thread, so that they are the same to the bit for any
// number of threads, queries and instruction set.
#include "host/mixture.h"

#include "host/parallel.h"

#include <algorithm>
#include <climits>
#include <cmath>
#include <cstdlib>
#include <new>

namespace drsplat {
namespace {

constexpr size_t kAddressable = 65536;  // what an id can name; the table answers all of it
constexpr int16_t kNoQuery = -32768;

// A query as whole numbers: as many digits as the sums of products can hold.
float whole_query(const float *query, uint32_t dim, int16_t *whole) {
  double largest = 0, squared = 0;
  for (uint32_t d = 0; d < dim; d++) {
    largest = std::max(largest, std::fabs((double)query[d]));
    squared += (double)query[d] * query[d];
  }
  if (!(largest > 0) || !std::isfinite(squared)) {
    std::fill_n(whole, dim, (int16_t)0);
    return 0;
  }
  // |<atom, query>| <= 127 sqrt(dim) |query| by Cauchy-Schwarz, of any part of the sum too.
  const double most = (0.99 * INT_MAX / (127 * std::sqrt((double)dim)) - 1) / std::sqrt(squared);
  const double factor = std::min(32767 / largest, most);
  for (uint32_t d = 0; d < dim; d++) whole[d] = (int16_t)std::nearbyint(query[d] * factor);
  return (float)(32767 / factor);
}

// The score of every atom for some queries: rows of `stride` entries, one row for every id there can be. Stride 1
// is for one query; all others are whole times 32.
class Table {
 public:
  Table(const Kernels &kernels, const Atoms &atoms, const MixtureQueries &queries, uint32_t stride, int threads)
      : stride_(stride) {
    std::vector<int16_t> whole((size_t)queries.count * atoms.dim);
    std::vector<float> steps(queries.count);
    std::vector<uint32_t> places(queries.count);
    for (uint32_t q = 0; q < queries.count; q++) {
      steps[q] = whole_query(queries.values + (size_t)q * atoms.dim, atoms.dim, whole.data() + (size_t)q * atoms.dim);
      places[q] = stride_ == 1 ? 0 : kernels.mixture->table_place(q);
    }
    // calloc: what no atom has is never touched. A scan of one query reads an entry more than it uses.
    entries_ = (int16_t *)std::calloc(kAddressable * stride_ + 1, sizeof(int16_t));
    if (!entries_) throw std::bad_alloc();
    if (queries.count < stride_) mark_empty(atoms.count, places);
    const WholeQueries given = {whole.data(), steps.data(), places.data(), queries.count, stride_};
    over_rows(atoms.count, 256, threads, [&](int, uint64_t begin, uint64_t end) {
      kernels.mixture->score_table(atoms, given, begin, end, entries_);
    });
  }
  ~Table() { std::free(entries_); }
  Table(const Table &) = delete;
  Table &operator=(const Table &) = delete;
  const int16_t *entries() const { return entries_; }
  uint32_t stride() const { return stride_; }

 private:
  void mark_empty(uint32_t atoms, const std::vector<uint32_t> &places) {
    std::vector<int16_t> row(stride_, kNoQuery);
    for (uint32_t place : places) row[place] = 0;
    for (uint32_t a = 0; a < atoms; a++) std::copy(row.begin(), row.end(), entries_ + (size_t)a * stride_);
  }
  uint32_t stride_;
  int16_t *entries_;
};

// work(thread, begin, end, scores) with the scores of one query, kRowsAtOnce rows at a time.
template <class Work>
void over_scores(const Kernels &kernels, const MixtureCode &code, const float *query, int threads, Work work) {
  const Table table(kernels, code.atoms, {query, 1}, 1, threads);
  over_rows(code.rows, kRowsAtOnce, threads, [&](int thread, uint64_t begin, uint64_t end) {
    float scores[kRowsAtOnce];
    kernels.mixture->scores(code.mixtures, table.entries(), begin, end, scores);
    work(thread, begin, end, scores);
  });
}

size_t longest_row(const MixtureSource &source, uint64_t begin, uint64_t end) {
  int64_t longest = 0;
  for (uint64_t i = begin; i < end; i++) longest = std::max(longest, source.starts[i + 1] - source.starts[i]);
  return ((size_t)longest + source.num_further + 15) / 16 * 16;
}

}  // namespace

void mixture_encode(const Kernels &kernels, const Atoms &atoms, const MixtureSource &source, uint64_t rows, int threads,
                    const MixtureRows &out) {
  over_rows(rows, 64, threads, [&](int, uint64_t begin, uint64_t end) {
    const size_t candidates = longest_row(source, begin, end);
    std::vector<float> scratch((5 + 2 * source.wanted) * candidates);
    std::vector<int16_t> whole(atoms.dim);
    std::vector<int32_t> ids(candidates);
    kernels.mixture->encode(atoms, source, begin, end, scratch.data(), ids.data(), whole.data(), out);
  });
}

void nearest_centres(const Kernels &kernels, const Embeddings &centres, const float *points, uint64_t rows, int threads,
                     int32_t *nearest) {
  over_rows(rows, 256, threads, [&](int, uint64_t begin, uint64_t end) {
    std::vector<float> scratch(kEncodeScratch * centres.dim);
    kernels.mixture->nearest_centres(centres, points, begin, end, scratch.data(), nearest);
  });
}

void nearest_members(const Kernels &kernels, const Atoms &atoms, const Groups &groups, const float *points,
                     uint64_t rows, int threads, int32_t *nearest) {
  over_rows(rows, 256, threads, [&](int, uint64_t begin, uint64_t end) {
    std::vector<float> products(kMostAtOnce * (size_t)groups.size);
    std::vector<int16_t> whole(kMostAtOnce * (size_t)atoms.dim);
    kernels.mixture->nearest_members(atoms, groups, points, begin, end, products.data(), whole.data(), nearest);
  });
}

void mixture_scores(const Kernels &kernels, const MixtureCode &code, const MixtureQueries &queries, int threads,
                    float *scores) {
  for (uint32_t q = 0; q < queries.count; q++) {
    const Table table(kernels, code.atoms, {queries.values + (size_t)q * code.atoms.dim, 1}, 1, threads);
    float *out = scores + q * code.rows;
    over_rows(code.rows, 4 * kRowsAtOnce, threads, [&](int, uint64_t begin, uint64_t end) {
      kernels.mixture->scores(code.mixtures, table.entries(), begin, end, out + begin);
    });
  }
}

Found mixture_select(const Kernels &kernels, const MixtureCode &code, const float *query, float threshold,
                     const float *floor, int threads) {
  std::vector<Found> of_block((code.rows + kRowsAtOnce - 1) / kRowsAtOnce);
  over_scores(kernels, code, query, threads, [&](int, uint64_t begin, uint64_t end, const float *scores) {
    add_above(*kernels.scan, scores, floor ? floor + begin : nullptr, threshold, begin, (uint32_t)(end - begin),
              of_block[begin / kRowsAtOnce]);
  });
  return joined(of_block);
}

Found mixture_top(const Kernels &kernels, const MixtureCode &code, const float *query, uint64_t count, int threads) {
  if (!count) return {};
  BestRows best(*kernels.scan, std::min(count, code.rows), threads);
  over_scores(kernels, code, query, threads, [&](int thread, uint64_t begin, uint64_t end, const float *scores) {
    best.offer(thread, scores, begin, (uint32_t)(end - begin));
  });
  return std::move(best).best();
}

void mixture_best(const Kernels &kernels, const MixtureCode &code, const MixtureQueries &queries, int threads,
                  const MixtureBest &out) {
  std::vector<int32_t> best(code.rows, INT_MIN), second(code.rows, INT_MIN);
  std::fill_n(out.index, code.rows, 0);
  const uint32_t tile_queries = kernels.mixture->tile_queries;
  for (uint32_t first = 0; first < queries.count; first += tile_queries) {
    const uint32_t count = std::min(tile_queries, queries.count - first);
    const Table table(kernels, code.atoms, {queries.values + (size_t)first * code.atoms.dim, count},
                      (count + 31) / 32 * 32, threads);
    const QueryTile tile = {table.entries(), first, table.stride()};
    over_rows(code.rows, kRowsAtOnce, threads, [&](int, uint64_t row, uint64_t end) {
      kernels.mixture->best(code.mixtures, tile, row, end, {best.data(), second.data(), out.index});
    });
  }
  for (uint64_t row = 0; row < code.rows; row++) {
    const float step = scale_of(code.mixtures.scales[row]) * (1.f / 32767);
    out.scores[row] = (float)best[row] * step;
    out.runner_up[row] = queries.count > 1 ? (float)second[row] * step : -INFINITY;
  }
}

}  // namespace drsplat
