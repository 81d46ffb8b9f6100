#include "host/photo_merging.h"

#include "kernels/photo_kernels.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <queue>

namespace drsplat {
namespace {

constexpr double kTraitSteps = 32, kBorderSteps = 255;
constexpr double kNoise = 1;  // CIELAB units that even flat colours differ by

double square(double x) { return x * x; }
double box_area(const double *box) { return (box[0] + box[2]) * (box[1] + box[3]); }

// What pairs ask of a region, from its sums.
struct Look {
  double area, mean[3], rough, log_rough, log_texture, strength, shade[2], shares[3 * kBins];
  double traits[kTraits], spread, root_spread;
  double log_share, log_outline, fill, root_frame;

  void take(const double *sums, const double *box, double pixels) {
    area = sums[kArea];
    take_colors(sums);
    take_traits(sums);
    log_share = std::log(area / pixels);
    log_outline = std::log((sums[kAround] + sums[kFrame]) / std::sqrt(area));
    fill = area / box_area(box);
    root_frame = std::sqrt(sums[kFrame] / std::sqrt(pixels));
  }

  void take_colors(const double *sums) {
    rough = 0;
    for (int c = 0; c < 3; c++) {
      mean[c] = sums[kMean + c] / (area * kLabSteps);
      const double variance = sums[kSquare + c] / (area * square(kLabSteps)) - square(mean[c]);
      rough += std::sqrt(std::max(variance, 0.0));
    }
    log_rough = std::log1p(rough), log_texture = std::log1p(sums[kTexture] / (area * kLabSteps));
    strength = std::hypot(mean[1], mean[2]);
    for (int c = 0; c < 2; c++)
      shade[c] = mean[c + 1] / (mean[0] + 10);  // of one paint in light and shadow nearly equal
    for (int b = 0; b < 3 * kBins; b++) shares[b] = sums[kHistogram + b] / area;
  }

  void take_traits(const double *sums) {
    double squares = 0;
    for (int t = 0; t < kTraits; t++) {
      traits[t] = sums[kTrait + t] / (area * kTraitSteps);
      squares += square(traits[t]);
    }
    spread = std::max(sums[kTraitSquare] / (area * square(kTraitSteps)) - squares, 0.0);
    root_spread = std::sqrt(spread);
  }
};

struct Near { int32_t region, border; };

struct Merging {
  const Kernels &kernels;
  const PairRule &rule;
  double pixels;
  std::vector<double> sums, boxes, borders;
  std::vector<Look> looks;
  std::vector<int32_t> owner;           // to be followed up to one that owns itself; the lower of two owns both
  std::vector<std::vector<Near>> near;  // of each region
  std::vector<uint32_t> born;           // of each border: its older scores do not count any more
  std::vector<double> features, scores;

  struct Scored {
    double score;
    int32_t a, b, border;
    uint32_t born;
    bool operator<(const Scored &other) const {
      if (score != other.score) return score < other.score;
      return a != other.a ? a > other.a : b > other.b;
    }
  };
  std::priority_queue<Scored> queue;

  Merging(const Kernels &k, const GivenGraph &graph, const PairRule &r)
      : kernels(k),
        rule(r),
        pixels(graph.pixels),
        sums(graph.sums, graph.sums + graph.regions * kRegionColumns),
        boxes(graph.boxes, graph.boxes + graph.regions * 4),
        borders(graph.borders, graph.borders + graph.edges * kBorderColumns),
        looks(graph.regions),
        owner(graph.regions),
        near(graph.regions),
        born(graph.edges) {
    std::iota(owner.begin(), owner.end(), 0);
    for (int32_t i = 0; i < (int32_t)owner.size(); i++) look_at(i);
    for (size_t e = 0; e < graph.edges; e++) {
      const int32_t a = graph.pairs[2 * e], b = graph.pairs[2 * e + 1];
      near[a].push_back({b, (int32_t)e}), near[b].push_back({a, (int32_t)e});
    }
  }

  double *sums_of(int32_t i) { return sums.data() + (size_t)i * kRegionColumns; }
  double *box_of(int32_t i) { return boxes.data() + (size_t)i * 4; }
  double *border(int32_t e) { return borders.data() + (size_t)e * kBorderColumns; }
  void look_at(int32_t i) { looks[i].take(sums_of(i), box_of(i), pixels); }

  // The smaller of two regions counts as first, else the one of the lower number.
  void add_features(int32_t a, int32_t b, const double *between) {
    if (looks[a].area > looks[b].area) std::swap(a, b);
    const size_t size = features.size();
    features.resize(size + kPairFeatures);
    double *to = add_colors(looks[a], looks[b], between, features.data() + size);
    to = add_shapes(a, b, between, to);
    add_seen(looks[a], looks[b], between, to);
  }

  static double *add_colors(const Look &x, const Look &y, const double *between, double *to) {
    const double lightness = std::abs(x.mean[0] - y.mean[0]);
    const double chroma = std::hypot(x.mean[1] - y.mean[1], x.mean[2] - y.mean[2]);
    const double color = std::hypot(lightness, chroma), noise = x.rough + y.rough + kNoise;
    const double sides = between[kLength] * kLabSteps, step = between[kStep] / sides;
    const double shade = std::sqrt(square(x.shade[0] - y.shade[0]) + square(x.shade[1] - y.shade[1]));
    for (const double feature :
         {std::sqrt(color), std::sqrt(lightness), std::sqrt(chroma), x.mean[0] - y.mean[0], x.strength - y.strength,
          shade, std::sqrt(step), std::sqrt(between[kStepChroma] / sides), color / noise, step / noise, x.log_rough,
          y.log_rough, x.log_texture, y.log_texture, x.mean[0], y.mean[0], x.strength, y.strength})
      *to++ = feature;
    for (int c = 0; c < 3; c++) {
      double unlike = 0;
      for (int b = c * kBins; b < (c + 1) * kBins; b++) unlike += std::abs(x.shares[b] - y.shares[b]);
      *to++ = unlike;
    }
    return to;
  }

  double *add_shapes(int32_t a, int32_t b, const double *between, double *to) {
    const Look &x = looks[a], &y = looks[b];
    const double touching = between[kLength], around[2] = {sums_of(a)[kAround], sums_of(b)[kAround]};
    double both[4];
    for (int k = 0; k < 4; k++) both[k] = std::min(box_of(a)[k], box_of(b)[k]);
    const double filled = (x.area + y.area) / box_area(both);
    for (const double feature : {x.log_share, y.log_share, touching / around[0], touching / around[1],
                                 touching / std::min(around[0], around[1]), std::log(touching / std::sqrt(x.area)),
                                 x.log_outline, y.log_outline, x.fill, y.fill, filled, filled - y.fill, x.root_frame,
                                 y.root_frame, box_area(both) / box_area(box_of(b)) - 1})
      *to++ = feature;
    return to;
  }

  static void add_seen(const Look &x, const Look &y, const double *between, double *to) {
    double apart = 0;
    for (int t = 0; t < kTraits; t++) apart += square(x.traits[t] - y.traits[t]);
    const double sides = between[kLength];
    for (const double feature :
         {between[kSeen] / (2 * kBorderSteps * sides), std::sqrt(between[kTraitStep] / (kTraitSteps * sides)),
          std::sqrt(apart), apart / (1 + x.spread + y.spread), x.root_spread, y.root_spread})
      *to++ = feature;
  }

  // How likely each neighbour belongs to a region.
  void score_neighbours(int32_t i) {
    features.clear();
    for (const Near &other : near[i])
      add_features(std::min(i, other.region), std::max(i, other.region), border(other.border));
    score_features(near[i].size());
  }

  void score_features(size_t pairs) {
    scores.resize(pairs);
    kernels.photo->pair_likelihoods(rule, features.data(), pairs, scores.data());
  }

  void put_in(int32_t a, int32_t b, int32_t e, double score, double threshold) {
    born[e]++;
    if (score > threshold) queue.push({score, std::min(a, b), std::max(a, b), e, born[e]});
  }

  void score_all(const GivenGraph &graph) {
    features.clear();
    for (size_t e = 0; e < graph.edges; e++)
      add_features(graph.pairs[2 * e], graph.pairs[2 * e + 1], border((int32_t)e));
    score_features(graph.edges);
  }

  void merge_above(const GivenGraph &graph, double threshold) {
    merge_above(graph, threshold, [](int32_t, int32_t) {});
  }

  // Calls `before` with each two that are about to become one.
  template <class Before>
  void merge_above(const GivenGraph &graph, double threshold, Before before) {
    score_all(graph);
    for (size_t e = 0; e < graph.edges; e++)
      put_in(graph.pairs[2 * e], graph.pairs[2 * e + 1], (int32_t)e, scores[e], threshold);
    while (!queue.empty()) {
      const Scored best = queue.top();
      queue.pop();
      if (born[best.border] != best.born) continue;
      before(best.a, best.b);
      unite(best.a, best.b);
      score_neighbours(best.a);
      for (size_t k = 0; k < scores.size(); k++)
        put_in(best.a, near[best.a][k].region, near[best.a][k].border, scores[k], threshold);
    }
  }

  // Smallest first.
  void merge_small(const MergeLimits &limits) {
    using Sized = std::pair<double, int32_t>;
    std::priority_queue<Sized, std::vector<Sized>, std::greater<Sized>> smallest;
    for (int32_t i = 0; i < (int32_t)owner.size(); i++)
      if (owner[i] == i) smallest.push({looks[i].area, i});
    while (!smallest.empty()) {
      const auto [area, i] = smallest.top();
      smallest.pop();
      if (owner[i] != i || looks[i].area != area || near[i].empty()) continue;
      if (area >= limits.least_area && 2 * area >= limits.least_width * sums_of(i)[kAround]) continue;
      const int32_t other = likeliest(i), kept = std::min(i, other);
      unite(kept, std::max(i, other));
      smallest.push({looks[kept].area, kept});
    }
  }

  // The neighbour, of equally likely ones the lowest.
  int32_t likeliest(int32_t i) {
    score_neighbours(i);
    size_t best = 0;
    for (size_t k = 1; k < scores.size(); k++)
      if (scores[k] > scores[best] || (scores[k] == scores[best] && near[i][k].region < near[i][best].region)) best = k;
    return near[i][best].region;
  }

  Near *find(int32_t i, int32_t other) {
    for (Near &entry : near[i])
      if (entry.region == other) return &entry;
    return nullptr;
  }

  int32_t remove(int32_t i, int32_t other) {
    Near *entry = find(i, other);
    const int32_t e = entry->border;
    *entry = near[i].back();
    near[i].pop_back();
    return e;
  }

  // b becomes part of a.
  void unite(int32_t a, int32_t b) {
    const int32_t between = remove(a, b);
    remove(b, a);
    born[between]++;
    for (int c = 0; c < kRegionColumns; c++) sums_of(a)[c] += sums_of(b)[c];
    sums_of(a)[kAround] -= 2 * border(between)[kLength];
    for (int k = 0; k < 4; k++) box_of(a)[k] = std::min(box_of(a)[k], box_of(b)[k]);
    owner[b] = a;
    for (const Near &other : near[b]) take_border(a, b, other);
    near[b] = {};
    look_at(a);
  }

  void take_border(int32_t a, int32_t b, const Near &other) {
    remove(other.region, b);
    if (const Near *own = find(a, other.region)) {
      for (int c = 0; c < kBorderColumns; c++) border(own->border)[c] += border(other.border)[c];
      born[other.border]++;
    } else {
      near[a].push_back(other), near[other.region].push_back({a, other.border});
    }
  }

  std::vector<int32_t> things() {
    std::vector<int32_t> numbers(owner.size());
    int32_t count = 0;
    for (size_t i = 0; i < owner.size(); i++)
      numbers[i] = owner[i] == (int32_t)i ? count++ : numbers[(size_t)owner[i]];  // owners are lower
    return numbers;
  }
};

}  // namespace

std::vector<int32_t> merged_regions(const Kernels &kernels, const GivenGraph &graph, const PairRule &rule,
                                    const MergeLimits &limits) {
  Merging merging(kernels, graph, rule);
  merging.merge_above(graph, limits.threshold);
  merging.merge_small(limits);
  return merging.things();
}

std::vector<int32_t> merge_order(const Kernels &kernels, const GivenGraph &graph, const PairRule &rule) {
  Merging merging(kernels, graph, rule);
  std::vector<int32_t> number(graph.regions);  // of what a region is part of, by the region that owns it
  std::iota(number.begin(), number.end(), 0);
  std::vector<int32_t> order;
  merging.merge_above(graph, -1, [&](int32_t a, int32_t b) {
    order.insert(order.end(), {number[(size_t)a], number[(size_t)b]});
    number[(size_t)a] = (int32_t)(graph.regions + order.size() / 2 - 1);
  });
  return order;
}

std::vector<double> pair_likelihoods(const Kernels &kernels, const GivenGraph &graph, const PairRule &rule) {
  Merging merging(kernels, graph, rule);
  merging.score_all(graph);
  return std::move(merging.scores);
}

}  // namespace drsplat
