#include "host/borders.h"

#include "host/parallel.h"

#include <algorithm>
#include <numeric>

namespace drsplat {
namespace {

constexpr uint64_t kBlock = 256;
constexpr ptrdiff_t kFewBorders = 24;  // of one region: more are sorted by merging, which takes memory
constexpr size_t kAhead = 8;           // borders
constexpr double kSlack = 1e-5;        // more than bounds are rounded by

int32_t root_of(std::vector<int32_t> &up, int32_t i) {
  while (up[i] != i) i = up[i] = up[up[i]];
  return i;
}

// Borders whose regions are, nearly, each other's best, best first.
std::vector<uint32_t> best_of_both(int32_t count, const std::vector<Border> &borders, double threshold,
                                   double tolerance) {
  std::vector<float> best((size_t)count, kUnknown);
  for (const Border &border : borders)
    for (const int32_t r : {border.a, border.b}) best[r] = std::max(best[r], border.score);
  std::vector<std::pair<float, uint32_t>> found;  // scores turned round: of equal ones the first border comes first
  for (size_t e = 0; e < borders.size(); e++) {
    const Border &border = borders[e];
    const double reached = border.score + tolerance;
    if (border.score >= threshold && reached >= best[border.a] && reached >= best[border.b])
      found.push_back({-border.score, (uint32_t)e});
  }
  std::sort(found.begin(), found.end());
  std::vector<uint32_t> order(found.size());
  std::transform(found.begin(), found.end(), order.begin(), [](const auto &one) { return one.second; });
  return order;
}

// Borders between the new regions, ascending; those of the same two are one. Numbers keep the order of regions, so
// that only the borders of new ones have to be sorted.
struct Rebordering {
  const std::vector<int32_t> &numbers;
  const Groups &groups;
  std::vector<Border> moved;

  bool stays(const Border &border) const {
    return groups.size((size_t)numbers[border.a]) == 1 && groups.size((size_t)numbers[border.b]) == 1;
  }

  // What stays, in its place; the others are moved out, by the lower number.
  std::vector<size_t> part(std::vector<Border> &borders) {
    std::vector<size_t> at(groups.begins.size());
    const auto low = [&](const Border &border) { return (size_t)std::min(numbers[border.a], numbers[border.b]); };
    for (const Border &border : borders)
      if (numbers[border.a] != numbers[border.b] && !stays(border)) at[low(border) + 1]++;
    std::partial_sum(at.begin(), at.end(), at.begin());
    std::vector<size_t> next(at.begin(), at.end() - 1);
    moved.resize(at.back());
    size_t kept = 0;
    for (const Border &border : borders) {
      const int32_t a = numbers[border.a], b = numbers[border.b];
      if (a == b) continue;
      if (stays(border)) borders[kept++] = {a, b, border.shared, border.seen, border.score};
      else moved[next[low(border)]++] = {std::min(a, b), std::max(a, b), border.shared, border.seen, kUnknown};
    }
    borders.resize(kept);
    return at;
  }

  void sort(const std::vector<size_t> &at, int threads) {
    const auto before = [](const Border &x, const Border &y) { return x.b < y.b; };
    over_rows(at.size() - 1, 16 * kBlock, threads, [&](int, uint64_t begin, uint64_t end) {
      for (uint64_t n = begin; n < end; n++) {
        Border *first = moved.data() + at[n], *last = moved.data() + at[n + 1];
        if (last - first > kFewBorders) std::stable_sort(first, last, before);
        else
          for (Border *x = first; x < last; x++) std::rotate(std::upper_bound(first, x, *x, before), x, x + 1);
      }
    });
  }

  void unite() {
    size_t kept = 0;
    for (const Border &border : moved) {
      if (kept && moved[kept - 1].a == border.a && moved[kept - 1].b == border.b)
        moved[kept - 1].shared += border.shared, moved[kept - 1].seen += border.seen;
      else moved[kept++] = border;
    }
    moved.resize(kept);
  }

  // Both are ascending: from behind, so that no place is needed beside.
  void merge_into(std::vector<Border> &borders) const {
    const auto before = [](const Border &x, const Border &y) { return x.a != y.a ? x.a < y.a : x.b < y.b; };
    size_t kept = borders.size(), left = moved.size(), to = kept + left;
    borders.resize(to);
    while (left) {
      const bool from_kept = kept && before(moved[left - 1], borders[kept - 1]);
      borders[--to] = from_kept ? borders[--kept] : moved[--left];
    }
  }
};

}  // namespace

double pulled(const Agreement &sum, const MergeRule &rule) {
  return (sum.shared + rule.prior * rule.least) / (sum.seen + rule.least);
}

std::vector<Border> first_borders(const Regions &all, const Edge *edges, size_t count, double soft, int threads) {
  std::vector<Border> borders(count);
  std::vector<Table> tables((size_t)threads, Table(all));
  over_rows(count, kBlock, threads, [&](int t, uint64_t begin, uint64_t end) {
    for (uint64_t e = begin; e < end; e++) {
      if (e + kAhead < end) all.prefetch(all.regions[edges[e + kAhead].b]);
      const Agreement sum = tables[(size_t)t].of(all.regions[edges[e].a], all.regions[edges[e].b], soft);
      borders[e] = {edges[e].a, edges[e].b, (float)sum.shared, (float)sum.seen, kUnknown};
    }
  });
  return borders;
}

// A border that may reach the threshold. along: what its regions agree by along it.
struct Candidate {
  uint64_t border;
  double along, unlike;
};

// What is below the threshold, however much the two agree, is left for later: mostly its regions change before. Of two
// rows there is but their border. Each step is done for all of a block: what the processor waits for in one border
// does not stop it at the next.
void score(const Regions &all, std::vector<Border> &borders, const MergeRule &rule, double threshold, int threads) {
  const double most = std::max(1.0, rule.prior), whole_share = 1 - rule.local;
  const double enough = threshold - kSlack * (1 + most);
  const auto rows = [&](const Border &x) { return all.regions[x.a].is_row() && all.regions[x.b].is_row(); };
  const auto scored = [&](const Candidate &x, double over) {
    return rule.local * x.along + whole_share * over - x.unlike;
  };
  std::vector<Table> tables((size_t)threads, Table(all));
  over_rows(borders.size(), kBlock, threads, [&](int t, uint64_t begin, uint64_t end) {
    Candidate found[kBlock];
    size_t count = 0, left = 0;
    for (uint64_t e = begin; e < end; e++) {
      const Border &border = borders[e];
      if (border.score != kUnknown) continue;
      const double along = pulled({border.shared, border.seen}, rule);
      const double over = std::max(0.0, whole_share) * (rows(border) ? along : most);
      found[count] = {e, along, 0}, count += rule.local * along + over >= enough;
    }
    for (size_t i = 0; i < count; i++) {
      const Border &border = borders[found[i].border];
      const Region &a = all.regions[border.a], &b = all.regions[border.b];
      found[i].unlike = rule.unlike * distance(all, a, b, rule.unit);
      if (i + kAhead < count) all.prefetch_feature(all.regions[borders[found[i + kAhead].border].b]);
    }
    for (size_t i = 0; i < count; i++) {
      Border &border = borders[found[i].border];
      if (rows(border)) border.score = (float)scored(found[i], found[i].along);
      else if (whole_share <= 0 || scored(found[i], most) >= enough) found[left++] = found[i];
    }
    for (size_t i = 0; i < left; i++) {
      if (i + kAhead < left) all.prefetch(all.regions[borders[found[i + kAhead].border].b]);
      Border &border = borders[found[i].border];
      const Agreement whole = tables[(size_t)t].of(all.regions[border.a], all.regions[border.b], rule.soft);
      border.score = (float)scored(found[i], pulled(whole, rule));
    }
  });
}

int32_t joined(const Regions &all, const std::vector<Border> &borders, const std::vector<float> &masses,
               const MergeRule &rule, double threshold, std::vector<int32_t> &numbers) {
  const int32_t count = all.count();
  std::vector<int32_t> up((size_t)count), heaviest((size_t)count);  // of each root, the heaviest in its group
  std::iota(up.begin(), up.end(), 0), std::iota(heaviest.begin(), heaviest.end(), 0);
  Laid laid(all), beside(all);
  const auto mass = [&](int32_t region) { return masses[all.regions[region].node]; };
  for (const uint32_t e : best_of_both(count, borders, threshold, rule.tolerance)) {
    const int32_t a = root_of(up, borders[e].a), b = root_of(up, borders[e].b);
    const int32_t one = heaviest[a], other = heaviest[b], low = std::min(a, b);
    if (a == b) continue;
    if (one != borders[e].a || other != borders[e].b) {  // else the score says that they agree
      const Agreement whole = agreement(laid.of(all.regions[one]), beside.of(all.regions[other]), rule.soft);
      if (pulled(whole, rule) < rule.linked * threshold) continue;
    }
    up[std::max(a, b)] = low, heaviest[low] = mass(other) > mass(one) ? other : one;
  }
  int32_t next = 0;
  for (int32_t r = 0; r < count; r++) numbers[r] = up[r] == r ? next++ : numbers[root_of(up, r)];
  return next;
}

Groups grouped(const std::vector<int32_t> &numbers, int32_t count) {
  Groups groups{std::vector<int64_t>((size_t)count + 1), std::vector<int32_t>(numbers.size()), {}};
  for (const int32_t n : numbers) groups.begins[(size_t)n + 1]++;
  std::partial_sum(groups.begins.begin(), groups.begins.end(), groups.begins.begin());
  std::vector<int64_t> at(groups.begins.begin(), groups.begins.end() - 1);
  for (size_t r = 0; r < numbers.size(); r++) groups.members[(size_t)at[numbers[r]]++] = (int32_t)r;
  for (int32_t n = 0; n < count; n++)
    if (groups.size((size_t)n) > 1) groups.several.push_back(n);
  return groups;
}

void make_borders_anew(std::vector<Border> &borders, const std::vector<int32_t> &numbers, const Groups &groups,
                       int threads) {
  Rebordering how{numbers, groups, {}};
  how.sort(how.part(borders), threads), how.unite(), how.merge_into(borders);
  if (borders.size() < borders.capacity() / 2) borders.shrink_to_fit();
}

}  // namespace drsplat
