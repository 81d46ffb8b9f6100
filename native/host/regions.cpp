#include "host/regions.h"

#include "host/borders.h"
#include "host/parallel.h"

#include <cmath>
#include <numeric>

namespace drsplat {
namespace {

constexpr double kFew = 0.001;  // of the regions: when fewer merge, the next threshold is tried
constexpr uint64_t kBlock = 256;

// The sum of several regions' entries, columns ascending: neighbouring runs of them are merged, until it is one.
struct Summing {
  struct Sum {
    int32_t column;
    double weight;
  };
  std::vector<Sum> runs, merged;  // as large as they ever had to be
  std::vector<size_t> ends;

  size_t size() const { return ends.empty() ? 0 : ends.back(); }

  void add(const Entry *entries, size_t count) {
    const size_t begin = size();
    if (runs.size() < begin + count) runs.resize(begin + count);
    for (size_t e = 0; e < count; e++) runs[begin + e] = {entries[e].column, entries[e].weight};
    ends.push_back(begin + count);
  }

  void merge() {
    for (; ends.size() > 1; runs.swap(merged)) {
      if (merged.size() < size()) merged.resize(size());
      Sum *to = merged.data();
      size_t kept = 0;
      for (size_t r = 0, begin = 0; r < ends.size(); r += 2) {
        const size_t middle = ends[r], end = r + 1 < ends.size() ? ends[r + 1] : middle;
        to = merge(runs.data() + begin, runs.data() + middle, runs.data() + end, to);
        ends[kept++] = (size_t)(to - merged.data()), begin = end;
      }
      ends.resize(kept);
    }
  }

  static Sum *merge(const Sum *x, const Sum *middle, const Sum *end, Sum *to) {
    const Sum *y = middle;
    while (x < middle && y < end) {
      const int32_t p = x->column, q = y->column;
      *to++ = {std::min(p, q), (p <= q ? x->weight : 0) + (q <= p ? y->weight : 0)};
      x += p <= q, y += q <= p;
    }
    return std::copy(y, end, std::copy(x, middle, to));
  }
};

// New regions of several, and what is to be known of them. Numbers in them count from the part's own beginnings.
struct Part {
  std::vector<Region> regions;
  std::vector<Sight> sights;
  std::vector<Entry> entries;
  std::vector<float> fits, spreads;
};

// Grows the forest: merges regions, and keeps the nodes that they are.
struct Growing {
  const Votes &votes;
  const MergeRule &rule;
  Regions all;
  std::vector<double> mask_masses;
  Forest forest;

  Growing(const Votes &v, const MergeRule &r, int threads)
      : votes(v), rule(r), all(first_regions(v, threads)), mask_masses(v.masks) {
    forest.parents.assign(v.rows, -1), forest.agreements.assign(v.rows, 1.f), forest.sizes.assign(v.rows, 1);
    forest.fits.assign(v.rows, 0.f), forest.spreads.assign(v.rows, 0.f), forest.masses.assign(v.rows, 0.f);
    for (uint32_t r = 0; r < v.rows; r++) {
      double mass = 0;
      for (int64_t e = v.begin(r); e < v.end(r); e++) mass += v.weights[e], mask_masses[v.columns[e]] += v.weights[e];
      forest.masses[r] = (float)mass;
    }
  }

  // The mean over the views that see a region of the IoU with the mask that is most like it there.
  double fit(const Sight *sights, int32_t num_sights, const Entry *entries) const {
    double sum = 0, seen = 0;
    for (int32_t i = 0; i < num_sights; i++) {
      const double mass = sights[i].mass;
      double best = 0;
      for (uint32_t e = sights[i].entry; e < sights[i + 1].entry; e++) {
        const double both = entries[e].weight, either = mass + mask_masses[entries[e].column] - both;
        if (either > 0) best = std::max(best, both / either);
      }
      sum += best * mass / (mass + rule.far), seen += mass / (mass + rule.far);
    }
    return seen > 0 ? std::min(1.0, sum / seen) : 0;
  }

  // The largest distance that is merged in a group: between its largest member and the others that are judged.
  double spread(const int32_t *members, size_t count) const {
    const auto size = [&](int32_t member) { return forest.sizes[all.regions[member].node]; };
    const int32_t largest =
        *std::max_element(members, members + count, [&](int32_t x, int32_t y) { return size(x) < size(y); });
    double most = 0;
    for (size_t i = 0; i < count; i++) {
      most = std::max(most, (double)forest.spreads[all.regions[members[i]].node]);
      if (members[i] != largest && size(members[i]) >= rule.smallest)
        most = std::max(most, distance(all, all.regions[largest], all.regions[members[i]], votes.dim, rule.unit));
    }
    return most;
  }

  bool judged(const int32_t *members, size_t count) const {
    int64_t size = 0;
    for (size_t i = 0; i < count; i++) size += forest.sizes[all.regions[members[i]].node];
    return size >= rule.smallest;
  }

  void add_feature(const Region &region, std::vector<double> &sum) const {
    const float *feature = all.features.data() + (size_t)region.place * votes.dim;
    for (uint32_t d = 0; d < votes.dim; d++) sum[d] += (double)all.lengths[region.place] * feature[d];
  }

  void add(const int32_t *members, size_t count, Summing &sums, std::vector<double> &sum, Part &part) {
    sums.ends.clear();
    for (size_t i = 0; i < count; i++)
      sums.add(all.entries_of(all.regions[members[i]]), (size_t)all.num_entries(all.regions[members[i]]));
    sums.merge();
    Region region{(int64_t)part.sights.size(), (int64_t)part.entries.size(), 0, all.regions[members[0]].place, 0};
    part.entries.resize(part.entries.size() + sums.size());
    Entry *entries = part.entries.data() + region.entries;
    for (size_t e = 0; e < sums.size(); e++) entries[e] = {sums.runs[e].column, (float)sums.runs[e].weight};
    region.num_sights = add_sights(entries, sums.size(), votes.views, part.sights);
    part.regions.push_back(region);
    const bool known = judged(members, count);
    part.fits.push_back(known ? (float)fit(part.sights.data() + region.sights, region.num_sights, entries) : 0.f);
    part.spreads.push_back(known ? (float)spread(members, count) : 0.f);
    sum.assign(votes.dim, 0.0);
    for (size_t i = 0; i < count; i++) add_feature(all.regions[members[i]], sum);
    keep_feature(all, (size_t)region.place, sum);
  }

  // Merges each group of several.
  void merge(const Groups &groups, double threshold, int threads) {
    std::vector<Part> parts((groups.several.size() + kBlock - 1) / kBlock);
    over_rows(groups.several.size(), kBlock, threads, [&](int, uint64_t begin, uint64_t end) {
      Summing sums;
      std::vector<double> sum;
      for (uint64_t i = begin; i < end; i++) {
        const auto n = (size_t)groups.several[i];
        add(groups.members.data() + groups.begins[n], groups.size(n), sums, sum, parts[begin / kBlock]);
      }
    });
    renumber(groups, threshold, parts);
    for (const Part &part : parts) {
      all.sights.insert(all.sights.end(), part.sights.begin(), part.sights.end());
      all.entries.insert(all.entries.end(), part.entries.begin(), part.entries.end());
    }
    close_gaps(all);
  }

  // Puts regions in their new places, none of which is behind the old one.
  void renumber(const Groups &groups, double threshold, const std::vector<Part> &parts) {
    auto sights = (int64_t)all.sights.size(), entries = (int64_t)all.entries.size();
    size_t next = 0;
    for (size_t n = 0; n + 1 < groups.begins.size(); n++) {
      const int32_t *members = groups.members.data() + groups.begins[n];
      if (groups.size(n) == 1) {
        all.regions[n] = all.regions[*members];
        continue;
      }
      const Part &part = parts[next / kBlock];
      const size_t i = next++ % kBlock;
      Region region = part.regions[i];
      region.sights += sights, region.entries += entries;
      region.node = new_node(members, groups.size(n), threshold, part.fits[i], part.spreads[i]);
      all.regions[n] = region;
      if (i + 1 == part.regions.size()) sights += (int64_t)part.sights.size(), entries += (int64_t)part.entries.size();
    }
    all.regions.resize(groups.begins.size() - 1);
  }

  int32_t new_node(const int32_t *members, size_t count, double threshold, float fit, float spread) {
    const auto node = (int32_t)forest.parents.size();
    double mass = 0;
    int32_t size = 0;
    for (size_t i = 0; i < count; i++) {
      const int32_t child = all.regions[members[i]].node;
      forest.parents[child] = node, size += forest.sizes[child], mass += forest.masses[child];
    }
    forest.parents.push_back(-1), forest.agreements.push_back((float)threshold), forest.sizes.push_back(size);
    forest.masses.push_back((float)mass), forest.fits.push_back(fit), forest.spreads.push_back(spread);
    return node;
  }
};

}  // namespace

Forest agglomerate(const Votes &votes, const Edge *edges, size_t num_edges, const std::vector<double> &thresholds,
                   const MergeRule &rule, int threads) {
  Growing growing(votes, rule, threads);
  Regions &all = growing.all;
  std::vector<Border> borders = first_borders(all, votes, edges, num_edges, rule.soft, threads);
  for (size_t t = 0; t < thresholds.size(); t++)
    for (int round = 0; round < rule.rounds && !borders.empty(); round++) {
      score(all, borders, rule, votes, thresholds[t], threads);
      const int32_t before = all.count();
      std::vector<int32_t> numbers((size_t)before);
      const int32_t count = joined(all, borders, growing.forest.masses, rule, thresholds[t], numbers);
      if (count == before) break;
      const Groups groups = grouped(numbers, count);
      growing.merge(groups, thresholds[t], threads);
      make_borders_anew(borders, numbers, groups, threads);
      if (before - count < kFew * before && t + 1 < thresholds.size()) break;
    }
  return std::move(growing.forest);
}

}  // namespace drsplat
