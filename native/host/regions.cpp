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

  void add(const Regions &all, const Region &region) {
    if (region.is_row()) {
      const int32_t *columns = all.votes.columns + region.begin;
      const float *weights = all.votes.weights + region.begin;
      add(region.num_entries(), [&](size_t e) -> Sum { return {columns[e], weights[e]}; });
    } else {
      add(region.num_entries(), [&](size_t e) -> Sum { return {region.entries[e].column, region.entries[e].weight}; });
    }
  }

  template <class At>
  void add(size_t count, At at) {
    const size_t begin = size();
    if (runs.size() < begin + count) runs.resize(begin + count);
    for (size_t e = 0; e < count; e++) runs[begin + e] = at(e);
    ends.push_back(begin + count);
  }

  // The last two runs are merged into `to`, at its end.
  void merge_into(std::vector<Entry> &to) {
    while (ends.size() > 2) merge_pairs();
    const size_t begin = to.size(), middle = ends[0], end = ends.back();
    to.resize(begin + end);
    const Entry *last = merge(runs.data(), runs.data() + middle, runs.data() + end, to.data() + begin);
    to.resize((size_t)(last - to.data()));
  }

  void merge_pairs() {
    if (merged.size() < size()) merged.resize(size());
    Sum *to = merged.data();
    size_t kept = 0;
    for (size_t r = 0, begin = 0; r < ends.size(); r += 2) {
      const size_t middle = ends[r], end = r + 1 < ends.size() ? ends[r + 1] : middle;
      to = merge(runs.data() + begin, runs.data() + middle, runs.data() + end, to);
      ends[kept++] = (size_t)(to - merged.data()), begin = end;
    }
    ends.resize(kept), runs.swap(merged);
  }

  template <class To>
  static To *merge(const Sum *x, const Sum *middle, const Sum *end, To *to) {
    const auto kept = [](int32_t column, double weight) -> To { return {column, (decltype(To::weight))weight}; };
    const Sum *y = middle;
    while (x < middle && y < end) {
      const int32_t p = x->column, q = y->column;
      *to++ = kept(std::min(p, q), (p <= q ? x->weight : 0) + (q <= p ? y->weight : 0));
      x += p <= q, y += q <= p;
    }
    for (; x < middle; x++) *to++ = kept(x->column, x->weight);
    for (; y < end; y++) *to++ = kept(y->column, y->weight);
    return to;
  }
};

// New regions of several, and what is to be known of them.
struct Part {
  std::vector<Region> regions;
  std::vector<float> fits, spreads;
  Chunk chunk;
};

// Room for the sums of a part, as large as it ever had to be.
struct Making {
  Summing sums;
  std::vector<double> feature;
  std::vector<Entry> entries;
  std::vector<Sight> sights;
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
  double fit(const Region &region) const {
    double sum = 0, seen = 0;
    for (int32_t i = 0; i < region.num_sights; i++) {
      const double mass = region.sights[i].mass;
      double best = 0;
      for (uint32_t e = region.sights[i].entry; e < region.sights[i + 1].entry; e++) {
        const Entry &entry = region.entries[e];
        const double both = entry.weight, either = mass + mask_masses[entry.column] - both;
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
        most = std::max(most, distance(all, all.regions[largest], all.regions[members[i]], rule.unit));
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

  // Where its sums are is told when the part is whole.
  void add(const int32_t *members, size_t count, Making &making, Part &part) {
    making.sums.ends.clear();
    for (size_t i = 0; i < count; i++) making.sums.add(all, all.regions[members[i]]);
    const size_t begin = making.entries.size();
    making.sums.merge_into(making.entries);
    const int32_t seen =
        add_sights(making.entries.data() + begin, making.entries.size() - begin, votes.views, making.sights);
    part.regions.push_back({{nullptr}, nullptr, seen, all.regions[members[0]].place, -1, -1});
    part.spreads.push_back(judged(members, count) ? (float)spread(members, count) : -1.f);
    making.feature.assign(votes.dim, 0.0);
    for (size_t i = 0; i < count; i++) add_feature(all.regions[members[i]], making.feature);
    keep_feature(all, (size_t)part.regions.back().place, making.feature);
  }

  // Of a part that is whole: its sums become a chunk, and those of its regions that are judged get their fits.
  void finish(const Making &making, Part &part) const {
    part.chunk.entries = making.entries, part.chunk.sights = making.sights, part.chunk.used = making.entries.size();
    const Entry *entries = part.chunk.entries.data();
    const Sight *sights = part.chunk.sights.data();
    for (size_t i = 0; i < part.regions.size(); i++) {
      Region &region = part.regions[i];
      region.entries = entries, region.sights = sights;
      entries += region.num_entries(), sights += region.num_sights + 1;
      part.fits.push_back(part.spreads[i] < 0 ? 0.f : (float)fit(region));
      part.spreads[i] = std::max(part.spreads[i], 0.f);
    }
  }

  // Merges each group of several.
  void merge(const Groups &groups, double threshold, int threads) {
    std::vector<Part> parts((groups.several.size() + kBlock - 1) / kBlock);
    std::vector<Making> makings((size_t)threads);
    over_rows(groups.several.size(), kBlock, threads, [&](int t, uint64_t begin, uint64_t end) {
      Making &making = makings[(size_t)t];
      making.entries.clear(), making.sights.clear();
      for (uint64_t i = begin; i < end; i++) {
        const auto n = (size_t)groups.several[i];
        add(groups.members.data() + groups.begins[n], groups.size(n), making, parts[begin / kBlock]);
      }
      finish(making, parts[begin / kBlock]);
    });
    renumber(groups, threshold, parts);
    for (Part &part : parts) all.chunks.push_back(std::move(part.chunk));
    close_gaps(all);
  }

  // Puts regions in their new places, none of which is behind the old one.
  void renumber(const Groups &groups, double threshold, const std::vector<Part> &parts) {
    size_t next = 0;
    for (size_t n = 0; n + 1 < groups.begins.size(); n++) {
      const int32_t *members = groups.members.data() + groups.begins[n];
      if (groups.size(n) == 1) {
        all.regions[n] = all.regions[*members];
        continue;
      }
      const Part &part = parts[next / kBlock];
      const size_t i = next % kBlock;
      for (size_t m = 0; m < groups.size(n); m++) {
        const Region &member = all.regions[members[m]];
        if (!member.is_row()) all.chunks[member.chunk].used -= member.num_entries();
      }
      Region region = part.regions[i];
      region.chunk = (int32_t)(all.chunks.size() + next++ / kBlock);
      region.node = new_node(members, groups.size(n), threshold, part.fits[i], part.spreads[i]);
      all.regions[n] = region;
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
  std::vector<Border> borders = first_borders(all, edges, num_edges, rule.soft, threads);
  for (size_t t = 0; t < thresholds.size(); t++)
    for (int round = 0; round < rule.rounds && !borders.empty(); round++) {
      score(all, borders, rule, thresholds[t], threads);
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
