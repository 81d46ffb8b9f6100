#include "host/region_store.h"

#include "host/parallel.h"

#include <cmath>

namespace drsplat {
namespace {

constexpr double kUsed = 0.7;               // of a chunk: less is moved
constexpr size_t kChunkEntries = 1u << 16;  // or a few more, of what is moved
constexpr uint64_t kBlock = 256;
constexpr uint64_t kAhead = 8;  // rows
constexpr size_t kLine = 64;    // bytes that the cache holds together

double dot(const Entry *x, const Entry *x_end, const Entry *y, const Entry *y_end) {
  double sum = 0;
  while (x < x_end && y < y_end) {
    const int32_t p = x->column, q = y->column;
    if (p == q) sum += (double)x->weight * y->weight;
    x += p <= q, y += q <= p;
  }
  return sum;
}

void first_feature(Regions &all, uint32_t row, std::vector<double> &sum) {
  const Votes &votes = all.votes;
  sum.assign(votes.dim, 0.0);
  for (int64_t e = votes.begin(row); e < votes.end(row); e++) {
    const float *embedding = votes.embeddings + (size_t)votes.columns[e] * votes.dim;
    for (uint32_t d = 0; d < votes.dim; d++) sum[d] += (double)votes.weights[e] * embedding[d];
  }
  keep_feature(all, row, sum);
}

// Regions with their sums, which go to a chunk of their own.
void move_together(Regions &all, const std::vector<int32_t> &regions) {
  Chunk chunk;
  size_t sights = 0;
  for (const int32_t r : regions) chunk.used += all.regions[r].num_entries(), sights += all.regions[r].num_sights + 1;
  chunk.entries.reserve(chunk.used), chunk.sights.reserve(sights);
  for (const int32_t r : regions) {
    Region &region = all.regions[r];
    const Entry *entries = region.entries;
    const Sight *own = region.sights;
    region.entries = chunk.entries.data() + chunk.entries.size();
    region.sights = chunk.sights.data() + chunk.sights.size();
    region.chunk = (int32_t)all.chunks.size();
    chunk.entries.insert(chunk.entries.end(), entries, entries + own[region.num_sights].entry);
    chunk.sights.insert(chunk.sights.end(), own, own + region.num_sights + 1);
  }
  all.chunks.push_back(std::move(chunk));
}

}  // namespace

Region Laid::of(const Region &region) {
  if (!region.is_row()) return region;
  const Votes &votes = all.votes;
  Row &row = rows[(size_t)region.place % kRows];
  if (row.place != region.place) {
    row.place = region.place, row.num_sights = 0;
    const auto count = (size_t)region.num_sights;
    row.entries.resize(count), row.sights.resize(count + 1);
    double mass = 0;
    for (size_t e = 0; e < count; e++) {
      const int32_t column = votes.columns[region.begin + (int64_t)e], view = votes.views[column];
      const float weight = votes.weights[region.begin + (int64_t)e];
      row.entries[e] = {column, weight};
      const bool same = row.num_sights && row.sights[row.num_sights - 1].view == view;
      mass = same ? mass + weight : weight;
      row.num_sights += !same;
      Sight &sight = row.sights[row.num_sights - 1];
      sight = {view, (float)mass, same ? sight.entry : (uint32_t)e};
    }
    row.sights[row.num_sights] = {-1, 0, (uint32_t)count};
  }
  return {{row.entries.data()}, row.sights.data(), row.num_sights, region.place, region.node, region.chunk};
}

void Regions::prefetch(const Region &region) const {
  const auto lines = [](const auto *from, int32_t count) {
    for (const char *at = (const char *)from, *end = (const char *)(from + count); at < end; at += kLine)
      __builtin_prefetch(at);
  };
  if (region.is_row())
    lines(votes.columns + region.begin, region.num_sights), lines(votes.weights + region.begin, region.num_sights);
  else lines(region.entries, region.num_sights), lines(region.sights, region.num_sights + 1);
}

void Regions::prefetch_feature(const Region &region) const {
  const float *feature = features.data() + (size_t)region.place * votes.dim;
  for (uint32_t d = 0; d < votes.dim; d += kLine / sizeof(float)) __builtin_prefetch(feature + d);
}

Agreement agreement(const Region &a, const Region &b, double soft) {
  Agreement sum;
  const Sight *i = a.sights, *j = b.sights;
  const Sight *i_end = i + a.num_sights, *j_end = j + b.num_sights;
  const Entry *x = a.entries, *y = b.entries;
  while (i < i_end && j < j_end) {
    const int32_t one = i->view, other = j->view;
    if (one == other) {
      const double known = (i->mass + soft) * (j->mass + soft);
      sum.shared += dot(x + i[0].entry, x + i[1].entry, y + j[0].entry, y + j[1].entry) / known;
      sum.seen += (double)i->mass * j->mass / known;
    }
    i += one <= other, j += other <= one;
  }
  return sum;
}

template <class Set>
void Table::each(const Region &region, Set set) {
  const Region laid_out = laid.of(region);
  const Sight *sights = laid_out.sights;
  const Entry *entries = laid_out.entries;
  for (int32_t s = 0; s < laid_out.num_sights; s++) set(masses[(size_t)sights[s].view], sights[s].mass);
  for (size_t e = 0; e < laid_out.num_entries(); e++) set(weights[(size_t)entries[e].column], entries[e].weight);
}

// Of views that see but one, nothing is added: that is quicker than to look for them.
Agreement Table::of(const Region &a, const Region &b, double soft) {
  if (held != &a) {
    if (held) each(*held, [](float &x, float) { x = 0; });
    each(a, [](float &x, float value) { x = value; }), held = &a;
  }
  const Region laid_out = laid.of(b);
  const Entry *entry = laid_out.entries;
  double shared = 0, seen = 0;
  for (const Sight *sight = laid_out.sights, *end = sight + laid_out.num_sights; sight < end; sight++) {
    const double mass = masses[(size_t)sight->view], known = (mass + soft) * (sight->mass + soft);
    double both = 0;
    for (const Entry *next = laid_out.entries + sight[1].entry; entry < next; entry++)
      both += (double)weights[(size_t)entry->column] * entry->weight;
    shared += both / known;
    seen += mass * sight->mass / known;
  }
  return {shared, seen};
}

double distance(const Regions &all, const Region &a, const Region &b, double unit) {
  const size_t dim = all.votes.dim;
  const float *f = all.features.data() + (size_t)a.place * dim, *g = all.features.data() + (size_t)b.place * dim;
  double cosine = 0;
  for (size_t d = 0; d < dim; d++) cosine += (double)f[d] * g[d];
  return std::max(0.0, 1 - cosine) / unit;
}

int32_t add_sights(const Entry *entries, size_t count, const int32_t *views, std::vector<Sight> &sights) {
  const size_t before = sights.size();
  for (size_t e = 0; e < count;) {
    const size_t first = e;
    const int32_t view = views[entries[e].column];
    double mass = 0;
    for (; e < count && views[entries[e].column] == view; e++) mass += entries[e].weight;
    sights.push_back({view, (float)mass, (uint32_t)first});
  }
  sights.push_back({-1, 0, (uint32_t)count});
  return (int32_t)(sights.size() - before - 1);
}

void keep_feature(Regions &all, size_t place, const std::vector<double> &sum) {
  double square = 0;
  for (const double x : sum) square += x * x;
  all.lengths[place] = (float)std::sqrt(square);
  const double scale = square > 0 ? 1 / std::sqrt(square) : 0;
  for (size_t d = 0; d < sum.size(); d++) all.features[place * sum.size() + d] = (float)(sum[d] * scale);
}

Regions first_regions(const Votes &votes, int threads) {
  Regions all{votes, {}, {}, {}, {}};
  all.regions.reserve(votes.rows);
  for (int32_t r = 0; r < (int32_t)votes.rows; r++) {
    Region row{{nullptr}, nullptr, (int32_t)(votes.end(r) - votes.begin(r)), r, r, -1};
    row.begin = votes.begin(r), all.regions.push_back(row);
  }
  all.features.resize((size_t)votes.rows * votes.dim), all.lengths.resize(votes.rows);
  over_rows(votes.rows, kBlock, threads, [&](int, uint64_t begin, uint64_t end) {
    std::vector<double> sum;
    for (uint64_t r = begin; r < end; r++) {
      if (r + kAhead < end) all.prefetch(all.regions[r + kAhead]);
      first_feature(all, (uint32_t)r, sum);
    }
  });
  return all;
}

void close_gaps(Regions &all) {
  const size_t count = all.chunks.size();
  const auto sparse = [&](const Chunk &chunk) { return (double)chunk.used < kUsed * (double)chunk.entries.size(); };
  std::vector<int32_t> moved;
  size_t entries = 0;
  for (int32_t r = 0; r < all.count(); r++) {
    const Region &region = all.regions[r];
    if (region.is_row() || !sparse(all.chunks[region.chunk])) continue;
    moved.push_back(r), entries += region.num_entries();
    if (entries >= kChunkEntries) move_together(all, moved), moved.clear(), entries = 0;
  }
  if (!moved.empty()) move_together(all, moved);
  for (size_t c = 0; c < count; c++)
    if (sparse(all.chunks[c])) all.chunks[c] = {};
}

}  // namespace drsplat
