#include "host/region_store.h"

#include "host/parallel.h"

#include <cmath>
#include <numeric>

namespace drsplat {
namespace {

constexpr double kGaps = 1.5;  // times what is in use, of what is kept
constexpr uint64_t kBlock = 256;

double dot(const Entry *x, const Entry *x_end, const Entry *y, const Entry *y_end) {
  double sum = 0;
  while (x < x_end && y < y_end) {
    const int32_t p = x->column, q = y->column;
    if (p == q) sum += (double)x->weight * y->weight;
    x += p <= q, y += q <= p;
  }
  return sum;
}

void first_feature(Regions &all, const Region &region, const Votes &votes, std::vector<double> &sum) {
  sum.assign(votes.dim, 0.0);
  const Entry *entries = all.entries_of(region);
  for (int64_t e = 0; e < all.num_entries(region); e++) {
    const float *embedding = votes.embeddings + (size_t)entries[e].column * votes.dim;
    for (uint32_t d = 0; d < votes.dim; d++) sum[d] += (double)entries[e].weight * embedding[d];
  }
  keep_feature(all, (size_t)region.place, sum);
}

}  // namespace

Agreement agreement(const Regions &all, const Region &a, const Region &b, double soft) {
  Agreement sum;
  const Sight *i = all.sights_of(a), *j = all.sights_of(b);
  const Sight *i_end = i + a.num_sights, *j_end = j + b.num_sights;
  const Entry *x = all.entries_of(a), *y = all.entries_of(b);
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

Agreement Table::of(const Region &a, const Region &b, double soft) {
  if (held != &a) {
    if (held) each(*held, [](float &x, float) { x = 0; });
    each(a, [](float &x, float value) { x = value; }), held = &a;
  }
  Agreement sum;
  const Entry *entries = all.entries_of(b);
  const Sight *sight = all.sights_of(b), *end = sight + b.num_sights;
  for (; sight < end; sight++) {
    const double mass = masses[(size_t)sight->view];
    if (mass == 0) continue;
    const double known = (mass + soft) * (sight->mass + soft);
    double both = 0;
    for (uint32_t e = sight[0].entry; e < sight[1].entry; e++)
      both += (double)weights[(size_t)entries[e].column] * entries[e].weight;
    sum.shared += both / known, sum.seen += mass * sight->mass / known;
  }
  return sum;
}

double distance(const Regions &all, const Region &a, const Region &b, uint32_t dim, double unit) {
  const float *f = all.features.data() + (size_t)a.place * dim, *g = all.features.data() + (size_t)b.place * dim;
  double cosine = 0;
  for (uint32_t d = 0; d < dim; d++) cosine += (double)f[d] * g[d];
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
  Regions all;
  const size_t weights = (size_t)(votes.starts[votes.rows] - votes.starts[0]);
  all.regions.reserve(votes.rows), all.entries.reserve(2 * weights), all.sights.reserve(2 * (weights + votes.rows));
  for (uint32_t r = 0; r < votes.rows; r++) {
    const auto entries = (int64_t)all.entries.size(), sights = (int64_t)all.sights.size();
    for (int64_t e = votes.begin(r); e < votes.end(r); e++) all.entries.push_back({votes.columns[e], votes.weights[e]});
    const size_t count = all.entries.size() - (size_t)entries;
    const int32_t seen = add_sights(all.entries.data() + entries, count, votes.views, all.sights);
    all.regions.push_back({sights, entries, seen, (int32_t)r, (int32_t)r});
  }
  all.features.resize((size_t)votes.rows * votes.dim), all.lengths.resize(votes.rows);
  over_rows(votes.rows, kBlock, threads, [&](int, uint64_t begin, uint64_t end) {
    std::vector<double> sum;
    for (uint64_t r = begin; r < end; r++) first_feature(all, all.regions[r], votes, sum);
  });
  return all;
}

void close_gaps(Regions &all) {
  int64_t used = 0;
  for (const Region &region : all.regions) used += all.num_entries(region);
  if ((double)all.entries.size() <= kGaps * (double)used) return;
  std::vector<int32_t> order((size_t)all.count());
  std::iota(order.begin(), order.end(), 0);
  const auto earlier = [&](int32_t x, int32_t y) { return all.regions[x].sights < all.regions[y].sights; };
  std::sort(order.begin(), order.end(), earlier);
  int64_t sights = 0, entries = 0;
  for (const int32_t r : order) {
    Region &region = all.regions[r];
    const int64_t count = all.num_entries(region), num_sights = region.num_sights + 1;
    std::copy_n(all.entries.begin() + region.entries, count, all.entries.begin() + entries);
    std::copy_n(all.sights.begin() + region.sights, num_sights, all.sights.begin() + sights);
    region.sights = sights, region.entries = entries;
    sights += num_sights, entries += count;
  }
  all.sights.resize((size_t)sights), all.entries.resize((size_t)entries);
}

}  // namespace drsplat
