// The kernels of mixture.h on several threads. Scores are sums of whole numbers and every row is made by
// one thread, so that they are the same to the bit for any number of threads, queries and instruction set.
#include "mixture_rows.h"

#include "memory.h"
#include "parallel.h"

#include <algorithm>
#include <atomic>
#include <cfloat>
#include <climits>
#include <cmath>
#include <cstring>
#include <mutex>

namespace drsplat {
namespace {

constexpr uint64_t kRowBlock = 4096;   // of a scan: its scores stay in the first-level cache
constexpr size_t kAddressable = 65536;  // what an id can name; the table answers all of it
constexpr int16_t kNoQuery = -32768;

// work(begin, end) over blocks of rows, handed out as threads become free.
template <class Work>
void over_blocks(uint64_t rows, uint64_t block, int threads, Work work) {
  std::atomic<uint64_t> next{0};
  const uint64_t blocks = (rows + block - 1) / block;
  parallel((int)std::max<uint64_t>(1, std::min<uint64_t>(threads, blocks)), [&](int) {
    for (uint64_t i; (i = next.fetch_add(1)) < blocks;) work(i * block, std::min(rows, (i + 1) * block));
  });
}

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
  Table(const Kernels &kernels, const Atoms &atoms, const MixtureQueries &queries, uint32_t stride, int threads) : stride_(stride) {
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
    over_blocks(atoms.count, 256, threads, [&](uint64_t begin, uint64_t end) {
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

// work(begin, end, scores, number of the block) with the scores of one query, a block of rows at a time.
template <class Work>
void over_scores(const Kernels &kernels, const MixtureCode &code, const float *query, int threads, Work work) {
  const Table table(kernels, code.atoms, {query, 1}, 1, threads);
  over_blocks(code.rows, kRowBlock, threads, [&](uint64_t begin, uint64_t end) {
    float scores[kRowBlock];
    kernels.mixture->scores(code.mixtures, table.entries(), begin, end, scores);
    work(begin, end, scores, begin / kRowBlock);
  });
}

float half_to_float(uint16_t half) {  // finite and not negative
  const uint32_t bits = (uint32_t)half << 13;
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value * 0x1p112f;
}

size_t longest_row(const MixtureSource &source, uint64_t begin, uint64_t end) {
  int64_t longest = 0;
  for (uint64_t i = begin; i < end; i++) longest = std::max(longest, source.starts[i + 1] - source.starts[i]);
  return ((size_t)longest + source.num_further + 15) / 16 * 16;
}

struct Ranked {
  float score;
  int64_t row;
  bool operator<(const Ranked &o) const { return score > o.score || (score == o.score && row < o.row); }
};

void keep_best(std::vector<Ranked> &ranked, uint64_t count) {
  if (ranked.size() <= count) return;
  std::nth_element(ranked.begin(), ranked.begin() + (ptrdiff_t)count, ranked.end());
  ranked.resize(count);
}

}  // namespace

void mixture_encode(const Kernels &kernels, const Atoms &atoms, const MixtureSource &source, uint64_t rows, int threads, const MixtureRows &out) {
  over_blocks(rows, 64, threads, [&](uint64_t begin, uint64_t end) {
    const size_t candidates = longest_row(source, begin, end);
    std::vector<float> scratch((5 + 2 * source.wanted) * candidates);
    std::vector<int16_t> whole(atoms.dim);
    std::vector<int32_t> ids(candidates);
    kernels.mixture->encode(atoms, source, begin, end, scratch.data(), ids.data(), whole.data(), out);
  });
}

void nearest_centres(const Kernels &kernels, const Embeddings &centres, const float *points, uint64_t rows, int threads, int32_t *nearest) {
  over_blocks(rows, 256, threads, [&](uint64_t begin, uint64_t end) {
    std::vector<float> scratch(kEncodeScratch * centres.dim);
    kernels.mixture->nearest_centres(centres, points, begin, end, scratch.data(), nearest);
  });
}

void nearest_members(const Kernels &kernels, const Atoms &atoms, const Groups &groups, const float *points, uint64_t rows, int threads, int32_t *nearest) {
  over_blocks(rows, 256, threads, [&](uint64_t begin, uint64_t end) {
    std::vector<float> products(groups.size);
    std::vector<int16_t> whole(atoms.dim);
    kernels.mixture->nearest_members(atoms, groups, points, begin, end, products.data(), whole.data(), nearest);
  });
}

void mixture_scores(const Kernels &kernels, const MixtureCode &code, const MixtureQueries &queries, int threads, float *scores) {
  for (uint32_t q = 0; q < queries.count; q++) {
    const Table table(kernels, code.atoms, {queries.values + (size_t)q * code.atoms.dim, 1}, 1, threads);
    float *out = scores + q * code.rows;
    over_blocks(code.rows, 4 * kRowBlock, threads, [&](uint64_t begin, uint64_t end) { kernels.mixture->scores(code.mixtures, table.entries(), begin, end, out + begin); });
  }
}

MixtureFound mixture_select(const Kernels &kernels, const MixtureCode &code, const float *query, float threshold, const float *floor, int threads) {
  std::vector<MixtureFound> parts((code.rows + kRowBlock - 1) / kRowBlock);
  over_scores(kernels, code, query, threads, [&](uint64_t begin, uint64_t end, const float *scores, uint64_t block) {
    uint32_t above[kRowBlock + 16];
    const uint32_t count = kernels.mixture->rows_above(scores, floor ? floor + begin : nullptr, threshold, (uint32_t)(end - begin), above);
    MixtureFound &part = parts[block];
    part.rows.resize(count), part.scores.resize(count);
    for (uint32_t i = 0; i < count; i++) part.rows[i] = (int64_t)(begin + above[i]), part.scores[i] = scores[above[i]];
  });
  size_t total = 0;
  for (const MixtureFound &part : parts) total += part.rows.size();
  MixtureFound all;
  all.rows.reserve(total), all.scores.reserve(total);
  for (const MixtureFound &part : parts) {
    all.rows.insert(all.rows.end(), part.rows.begin(), part.rows.end());
    all.scores.insert(all.scores.end(), part.scores.begin(), part.scores.end());
  }
  return all;
}

MixtureFound mixture_top(const Kernels &kernels, const MixtureCode &code, const float *query, uint64_t count, int threads) {
  count = std::min(count, code.rows);
  if (!count) return {};
  std::mutex guard;
  std::vector<Ranked> best;
  std::atomic<float> bar{-FLT_MAX};  // at least `count` rows reach it
  over_scores(kernels, code, query, threads, [&](uint64_t begin, uint64_t end, const float *scores, uint64_t) {
    uint32_t above[kRowBlock + 16];
    const float below_bar = std::nextafter(bar.load(), -INFINITY);
    const uint32_t reached = kernels.mixture->rows_above(scores, nullptr, below_bar, (uint32_t)(end - begin), above);
    const std::lock_guard<std::mutex> lock(guard);
    for (uint32_t i = 0; i < reached; i++) best.push_back({scores[above[i]], (int64_t)(begin + above[i])});
    if (best.size() < count + std::max(count, kRowBlock)) return;
    keep_best(best, count);
    bar = std::max_element(best.begin(), best.end())->score;
  });
  keep_best(best, count);
  std::sort(best.begin(), best.end());
  MixtureFound found;
  for (const Ranked &one : best) found.rows.push_back(one.row), found.scores.push_back(one.score);
  return found;
}

void mixture_best(const Kernels &kernels, const MixtureCode &code, const MixtureQueries &queries, int threads, const MixtureBest &out) {
  std::vector<int32_t> best(code.rows, INT_MIN), second(code.rows, INT_MIN);
  std::fill_n(out.index, code.rows, 0);
  const uint32_t tile_queries = kernels.mixture->tile_queries;
  for (uint32_t first = 0; first < queries.count; first += tile_queries) {
    const uint32_t count = std::min(tile_queries, queries.count - first);
    const Table table(kernels, code.atoms, {queries.values + (size_t)first * code.atoms.dim, count}, (count + 31) / 32 * 32, threads);
    const QueryTile tile = {table.entries(), first, table.stride()};
    over_blocks(code.rows, kRowBlock, threads, [&](uint64_t row, uint64_t end) { kernels.mixture->best(code.mixtures, tile, row, end, {best.data(), second.data(), out.index}); });
  }
  for (uint64_t row = 0; row < code.rows; row++) {
    const float step = half_to_float(code.mixtures.scales[row]) * (1.f / 32767);
    out.scores[row] = (float)best[row] * step;
    out.runner_up[row] = queries.count > 1 ? (float)second[row] * step : -INFINITY;
  }
}

}  // namespace drsplat
