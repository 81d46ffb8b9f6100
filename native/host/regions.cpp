#include "host/regions.h"

#include "host/parallel.h"

#include <cmath>
#include <numeric>

namespace drsplat {
namespace {

constexpr double kFew = 0.001;  // of the regions: when fewer merge, the next threshold is tried
constexpr uint64_t kBlock = 256;

// A region's weight in one view, and where the entries of that view begin.
struct Sight {
  int32_t view;
  float mass;
  int64_t entry;
};

struct Entry {
  int32_t column;
  float weight;
};

// What each region gets from each mask, and from each view.
struct Regions {
  std::vector<int64_t> starts{0}, sight_starts{0};
  std::vector<Entry> entries;
  std::vector<Sight> sights;
  std::vector<float> features;  // unit, or zero

  int32_t count() const { return (int32_t)starts.size() - 1; }
  int64_t end_of(int64_t sight, int32_t region) const {
    return sight + 1 < sight_starts[region + 1] ? sights[sight + 1].entry : starts[region + 1];
  }
};

constexpr float kUnknown = -1e30f;

// The border of two regions: sums over the edges that cross it, and the score, if neither has changed since.
struct Border {
  int32_t a, b;
  double shared, seen;
  float score;
};

struct Agreement {
  double shared = 0, seen = 0;  // the mean is shared / seen
};

// Over the views that see both, how much the same masks hold both.
Agreement agreement(const Regions &all, int32_t a, int32_t b, double soft) {
  Agreement sum;
  int64_t i = all.sight_starts[a], j = all.sight_starts[b];
  const int64_t i_end = all.sight_starts[a + 1], j_end = all.sight_starts[b + 1];
  while (i < i_end && j < j_end) {
    const Sight &one = all.sights[i], &other = all.sights[j];
    if (one.view != other.view) {
      one.view < other.view ? i++ : j++;
      continue;
    }
    double dot = 0;
    int64_t x = one.entry, y = other.entry;
    const int64_t x_end = all.end_of(i, a), y_end = all.end_of(j, b);
    while (x < x_end && y < y_end) {
      const Entry &p = all.entries[x], &q = all.entries[y];
      if (p.column == q.column) dot += (double)p.weight * q.weight;
      x += p.column <= q.column, y += q.column <= p.column;
    }
    const double known = (one.mass + soft) * (other.mass + soft);
    sum.shared += dot / known, sum.seen += (double)one.mass * other.mass / known;
    i++, j++;
  }
  return sum;
}

double pulled(double shared, double seen, const MergeRule &rule) {
  return (shared + rule.prior * rule.least) / (seen + rule.least);
}

double distance(const Regions &all, int32_t a, int32_t b, uint32_t dim, double unit) {
  const float *f = all.features.data() + (size_t)a * dim, *g = all.features.data() + (size_t)b * dim;
  double cosine = 0;
  for (uint32_t d = 0; d < dim; d++) cosine += (double)f[d] * g[d];
  return std::max(0.0, 1 - cosine) / unit;
}

void add_sights(Regions &all, const int32_t *views) {
  const int32_t region = all.count() - 1;
  for (int64_t e = all.starts[region]; e < all.starts[region + 1];) {
    const int64_t first = e;
    const int32_t view = views[all.entries[e].column];
    double mass = 0;
    for (; e < all.starts[region + 1] && views[all.entries[e].column] == view; e++) mass += all.entries[e].weight;
    all.sights.push_back({view, (float)mass, first});
  }
  all.sight_starts.push_back((int64_t)all.sights.size());
}

// The unit sum of a region's embeddings, weighted.
void make_feature(Regions &all, uint64_t region, const Votes &votes, std::vector<double> &sum) {
  const uint32_t dim = votes.dim;
  std::fill(sum.begin(), sum.end(), 0.0);
  for (int64_t e = all.starts[region]; e < all.starts[region + 1]; e++) {
    const float *embedding = votes.embeddings + (size_t)all.entries[e].column * dim;
    for (uint32_t d = 0; d < dim; d++) sum[d] += (double)all.entries[e].weight * embedding[d];
  }
  double norm = 0;
  for (const double x : sum) norm += x * x;
  const double scale = norm > 0 ? 1 / std::sqrt(norm) : 0;
  for (uint32_t d = 0; d < dim; d++) all.features[region * dim + d] = (float)(sum[d] * scale);
}

Regions first_regions(const Votes &votes, int threads) {
  Regions all;
  const int64_t begin = votes.starts[0], end = votes.starts[votes.rows];
  all.entries.reserve((size_t)(end - begin));
  for (uint32_t r = 0; r < votes.rows; r++) {
    for (int64_t e = votes.starts[r]; e < votes.starts[r + 1]; e++)
      all.entries.push_back({votes.columns[e], votes.weights[e]});
    all.starts.push_back((int64_t)all.entries.size());
    add_sights(all, votes.views);
  }
  all.features.resize((size_t)all.count() * votes.dim);
  over_rows((uint64_t)all.count(), kBlock, threads, [&](int, uint64_t begin, uint64_t end) {
    std::vector<double> sum(votes.dim);
    for (uint64_t r = begin; r < end; r++) make_feature(all, r, votes, sum);
  });
  return all;
}

std::vector<Border> first_borders(const Regions &all, const std::vector<Edge> &edges, double soft, int threads) {
  std::vector<Border> borders(edges.size());
  over_rows(edges.size(), kBlock, threads, [&](int, uint64_t begin, uint64_t end) {
    for (uint64_t e = begin; e < end; e++) {
      const Agreement sum = agreement(all, edges[e].a, edges[e].b, soft);
      borders[e] = {edges[e].a, edges[e].b, sum.shared, sum.seen, kUnknown};
    }
  });
  return borders;
}

// At first the border of two rows is all that there is of them.
void score(const Regions &all, std::vector<Border> &borders, const MergeRule &rule, uint32_t dim, bool first,
           int threads) {
  over_rows(borders.size(), kBlock, threads, [&](int, uint64_t begin, uint64_t end) {
    for (uint64_t e = begin; e < end; e++) {
      Border &border = borders[e];
      if (border.score != kUnknown) continue;
      const Agreement along_it{border.shared, border.seen};
      const Agreement whole = first ? along_it : agreement(all, border.a, border.b, rule.soft);
      const double along = pulled(border.shared, border.seen, rule), over = pulled(whole.shared, whole.seen, rule);
      const double unlike = rule.unlike * distance(all, border.a, border.b, dim, rule.unit);
      border.score = (float)(rule.local * along + (1 - rule.local) * over - unlike);
    }
  });
}

int32_t root_of(std::vector<int32_t> &up, int32_t i) {
  while (up[i] != i) i = up[i] = up[up[i]];
  return i;
}

// The new number of each region; neighbours that are, nearly, each other's best share one. How many there are.
int32_t joined(int32_t count, const std::vector<Border> &borders, double threshold, double tolerance,
               std::vector<int32_t> &numbers) {
  std::vector<float> best((size_t)count, kUnknown);
  for (const Border &border : borders)
    for (const int32_t r : {border.a, border.b}) best[r] = std::max(best[r], border.score);
  std::vector<int32_t> up((size_t)count);
  std::iota(up.begin(), up.end(), 0);
  for (const Border &border : borders) {
    const double reached = border.score + tolerance;
    if (border.score < threshold || reached < best[border.a] || reached < best[border.b]) continue;
    const int32_t a = root_of(up, border.a), b = root_of(up, border.b);
    up[std::max(a, b)] = std::min(a, b);
  }
  int32_t next = 0;
  for (int32_t r = 0; r < count; r++) numbers[r] = up[r] == r ? next++ : numbers[root_of(up, r)];
  return next;
}

// Regions by their new number: members[begins[n]] ... members[begins[n + 1] - 1], ascending.
struct Groups {
  std::vector<int64_t> begins;
  std::vector<int32_t> members;

  bool alone(size_t n) const { return begins[n + 1] - begins[n] == 1; }
};

Groups grouped(const std::vector<int32_t> &numbers, int32_t count) {
  Groups groups{std::vector<int64_t>((size_t)count + 1), std::vector<int32_t>(numbers.size())};
  for (const int32_t n : numbers) groups.begins[(size_t)n + 1]++;
  std::partial_sum(groups.begins.begin(), groups.begins.end(), groups.begins.begin());
  std::vector<int64_t> at(groups.begins.begin(), groups.begins.end() - 1);
  for (size_t r = 0; r < numbers.size(); r++) groups.members[(size_t)at[numbers[r]]++] = (int32_t)r;
  return groups;
}

// The entries of several regions as one, columns ascending.
void add_merged(const Regions &all, const int32_t *members, size_t count, std::vector<std::pair<int32_t, double>> &sums,
                std::vector<Entry> &entries) {
  sums.clear();
  for (size_t i = 0; i < count; i++)
    for (int64_t e = all.starts[members[i]]; e < all.starts[members[i] + 1]; e++)
      sums.push_back({all.entries[e].column, all.entries[e].weight});
  std::stable_sort(sums.begin(), sums.end(), [](const auto &x, const auto &y) { return x.first < y.first; });
  for (size_t i = 0; i < sums.size();) {
    const int32_t column = sums[i].first;
    double weight = 0;
    for (; i < sums.size() && sums[i].first == column; i++) weight += sums[i].second;
    entries.push_back({column, (float)weight});
  }
}

Regions merged(const Regions &all, const Groups &groups, const Votes &votes, int threads) {
  Regions next;
  const size_t count = groups.begins.size() - 1, dim = votes.dim;
  next.entries.reserve(all.entries.size()), next.sights.reserve(all.sights.size());
  next.starts.reserve(count + 1), next.sight_starts.reserve(count + 1);
  std::vector<std::pair<int32_t, double>> sums;
  for (size_t n = 0; n < count; n++) {
    const int32_t *members = groups.members.data() + groups.begins[n];
    if (groups.alone(n))
      next.entries.insert(next.entries.end(), all.entries.begin() + all.starts[*members],
                          all.entries.begin() + all.starts[*members + 1]);
    else add_merged(all, members, (size_t)(groups.begins[n + 1] - groups.begins[n]), sums, next.entries);
    next.starts.push_back((int64_t)next.entries.size());
    add_sights(next, votes.views);
  }
  next.features.resize(count * dim);
  over_rows(count, kBlock, threads, [&](int, uint64_t begin, uint64_t end) {
    std::vector<double> sum(dim);
    for (uint64_t n = begin; n < end; n++) {
      const float *known = all.features.data() + (size_t)groups.members[(size_t)groups.begins[n]] * dim;
      if (groups.alone(n)) std::copy_n(known, dim, next.features.data() + n * dim);
      else make_feature(next, n, votes, sum);
    }
  });
  return next;
}

// Borders between the new regions; those of the same two are one.
std::vector<Border> merged_borders(const std::vector<Border> &borders, const std::vector<int32_t> &numbers,
                                   const Groups &groups, int threads) {
  const auto low = [&](const Border &border) { return std::min(numbers[border.a], numbers[border.b]); };
  std::vector<size_t> at(groups.begins.size());  // counted by the lower number, then sorted by the higher one
  for (const Border &border : borders)
    if (numbers[border.a] != numbers[border.b]) at[(size_t)low(border) + 1]++;
  std::partial_sum(at.begin(), at.end(), at.begin());
  std::vector<Border> left(at.back());
  std::vector<size_t> next(at.begin(), at.end() - 1);
  for (const Border &border : borders) {
    const int32_t a = numbers[border.a], b = numbers[border.b];
    if (a == b) continue;
    const bool same = groups.alone((size_t)a) && groups.alone((size_t)b);
    left[next[(size_t)low(border)]++] = {std::min(a, b), std::max(a, b), border.shared, border.seen,
                                         same ? border.score : kUnknown};
  }
  over_rows(at.size() - 1, kBlock, threads, [&](int, uint64_t begin, uint64_t end) {
    for (uint64_t n = begin; n < end; n++)
      std::stable_sort(left.begin() + (ptrdiff_t)at[n], left.begin() + (ptrdiff_t)at[n + 1],
                       [](const Border &x, const Border &y) { return x.b < y.b; });
  });
  size_t kept = 0;
  for (size_t i = 0; i < left.size(); i++) {
    if (kept && left[kept - 1].a == left[i].a && left[kept - 1].b == left[i].b)
      left[kept - 1].shared += left[i].shared, left[kept - 1].seen += left[i].seen;
    else left[kept++] = left[i];
  }
  left.resize(kept);
  return left;
}

// The mean over the views that see a region of the IoU with the mask that is most like it there.
double fit(const Regions &all, int32_t region, const std::vector<double> &mask_masses, double far) {
  double sum = 0, seen = 0;
  for (int64_t i = all.sight_starts[region]; i < all.sight_starts[region + 1]; i++) {
    const double mass = all.sights[i].mass;
    double best = 0;
    for (int64_t e = all.sights[i].entry; e < all.end_of(i, region); e++) {
      const double both = all.entries[e].weight, either = mass + mask_masses[all.entries[e].column] - both;
      if (either > 0) best = std::max(best, both / either);
    }
    sum += best * mass / (mass + far), seen += mass / (mass + far);
  }
  return seen > 0 ? std::min(1.0, sum / seen) : 0;
}

// Grows the forest: the nodes that the regions are.
struct Growing {
  const Votes &votes;
  const MergeRule &rule;
  std::vector<double> mask_masses;
  Forest forest;
  std::vector<int32_t> nodes;  // of each region

  Growing(const Votes &v, const MergeRule &r) : votes(v), rule(r), mask_masses(v.masks), nodes(v.rows) {
    for (int64_t e = v.starts[0]; e < v.starts[v.rows]; e++) mask_masses[v.columns[e]] += v.weights[e];
    std::iota(nodes.begin(), nodes.end(), 0);
    forest.parents.assign(v.rows, -1), forest.agreements.assign(v.rows, 1.f), forest.sizes.assign(v.rows, 1);
    forest.fits.assign(v.rows, 0.f), forest.spreads.assign(v.rows, 0.f), forest.masses.assign(v.rows, 0.f);
    for (uint32_t r = 0; r < v.rows; r++) {
      double mass = 0;
      for (int64_t e = v.starts[r]; e < v.starts[r + 1]; e++) mass += v.weights[e];
      forest.masses[r] = (float)mass;
    }
  }

  // The largest distance that is merged in a group: between its largest member and the others that are judged.
  double spread(const Regions &before, const int32_t *members, size_t count) const {
    int32_t largest = members[0];
    for (size_t i = 1; i < count; i++)
      if (forest.sizes[nodes[members[i]]] > forest.sizes[nodes[largest]]) largest = members[i];
    double most = 0;
    for (size_t i = 0; i < count; i++) {
      const int32_t node = nodes[members[i]];
      most = std::max(most, (double)forest.spreads[node]);
      if (members[i] != largest && forest.sizes[node] >= rule.smallest)
        most = std::max(most, distance(before, largest, members[i], votes.dim, rule.unit));
    }
    return most;
  }

  void add(const Regions &before, const Regions &after, const Groups &groups, double threshold) {
    std::vector<int32_t> next((size_t)after.count());
    for (int32_t n = 0; n < after.count(); n++) {
      const int32_t *members = groups.members.data() + groups.begins[n];
      const size_t count = (size_t)(groups.begins[n + 1] - groups.begins[n]);
      next[n] = count == 1 ? nodes[members[0]] : new_node(before, after, n, members, count, threshold);
    }
    nodes = std::move(next);
  }

  int32_t new_node(const Regions &before, const Regions &after, int32_t region, const int32_t *members, size_t count,
                   double threshold) {
    const auto node = (int32_t)forest.parents.size();
    double mass = 0;
    int32_t size = 0;
    for (size_t i = 0; i < count; i++) {
      const int32_t child = nodes[members[i]];
      forest.parents[child] = node, size += forest.sizes[child], mass += forest.masses[child];
    }
    const bool judged = size >= rule.smallest;
    forest.parents.push_back(-1), forest.agreements.push_back((float)threshold), forest.sizes.push_back(size);
    forest.masses.push_back((float)mass);
    forest.fits.push_back(judged ? (float)fit(after, region, mask_masses, rule.far) : 0.f);
    forest.spreads.push_back(judged ? (float)spread(before, members, count) : 0.f);
    return node;
  }
};

}  // namespace

Forest agglomerate(const Votes &votes, std::vector<Edge> edges, const std::vector<double> &thresholds,
                   const MergeRule &rule, int threads) {
  Regions regions = first_regions(votes, threads);
  std::vector<Border> borders = first_borders(regions, edges, rule.soft, threads);
  std::vector<Edge>().swap(edges);
  Growing growing(votes, rule);
  for (size_t t = 0; t < thresholds.size(); t++)
    for (int round = 0; round < rule.rounds && !borders.empty(); round++) {
      score(regions, borders, rule, votes.dim, regions.count() == (int32_t)votes.rows, threads);
      std::vector<int32_t> numbers((size_t)regions.count());
      const int32_t before = regions.count();
      const int32_t count = joined(before, borders, thresholds[t], rule.tolerance, numbers);
      if (count == before) break;
      const Groups groups = grouped(numbers, count);
      Regions next = merged(regions, groups, votes, threads);
      growing.add(regions, next, groups, thresholds[t]);
      borders = merged_borders(borders, numbers, groups, threads);
      regions = std::move(next);
      if (before - count < kFew * before && t + 1 < thresholds.size()) break;
    }
  return std::move(growing.forest);
}

}  // namespace drsplat
