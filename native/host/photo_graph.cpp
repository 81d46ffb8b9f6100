#include "host/photo_graph.h"

#include "kernels/photo_kernels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <unordered_map>

namespace drsplat {
namespace {

constexpr double kLows[3] = {0, -60, -60}, kHighs[3] = {100, 60, 60};  // of histograms, in CIELAB

double square(double x) { return x * x; }

struct Summing {
  const SeenPixels &seen;
  PhotoGraph graph;
  std::vector<std::array<double, kBorderColumns>> borders;
  std::unordered_map<uint64_t, uint32_t> rows;  // of borders, by both regions

  explicit Summing(const SeenPixels &s) : seen(s) {
    graph.sums.assign((size_t)seen.count * kRegionColumns, 0), graph.boxes.assign((size_t)seen.count * 4, 0);
    for (int32_t r = 0; r < seen.count; r++) {
      double *box = graph.boxes.data() + 4 * (size_t)r;
      box[0] = seen.width, box[1] = seen.height;
    }
  }

  double *sums_of(int32_t region) { return graph.sums.data() + (size_t)region * kRegionColumns; }

  void add_pixel(int32_t y, int32_t x) {
    const size_t pixel = (size_t)y * (size_t)seen.width + (size_t)x;
    double *sums = sums_of(seen.labels[pixel]);
    sums[kArea]++;
    add_color(seen.lab + 3 * pixel, sums);
    const int32_t *traits = seen.traits + kTraits * pixel;
    double squares = 0;
    for (int t = 0; t < kTraits; t++) sums[kTrait + t] += traits[t], squares += square(traits[t]);
    sums[kTraitSquare] += squares;
    sums[kFrame] += (y == 0) + (y == seen.height - 1) + (x == 0) + (x == seen.width - 1);
    if (x) sums[kTexture] += lightness_step(pixel, pixel - 1);
    if (y) sums[kTexture] += lightness_step(pixel, pixel - (size_t)seen.width);
    double *box = graph.boxes.data() + 4 * (size_t)seen.labels[pixel];
    const double corners[4] = {(double)x, (double)y, -x - 1.0, -y - 1.0};
    for (int k = 0; k < 4; k++) box[k] = std::min(box[k], corners[k]);
  }

  static void add_color(const int32_t *lab, double *sums) {
    for (int c = 0; c < 3; c++) {
      const double place = (lab[c] / kLabSteps - kLows[c]) * (kBins / (kHighs[c] - kLows[c]));
      sums[kMean + c] += lab[c], sums[kSquare + c] += square(lab[c]);
      sums[kHistogram + c * kBins + (int)std::clamp(place, 0.0, kBins - 1.0)]++;
    }
  }

  double lightness_step(size_t p, size_t q) const { return std::abs((double)seen.lab[3 * p] - seen.lab[3 * q]); }

  // A pixel side between p and q. Steps are taken one pixel farther out on both sides, since an edge is blurred over
  // two pixels.
  void add_side(size_t p, size_t q, size_t inner, size_t outer) {
    const int32_t a = seen.labels[p], b = seen.labels[q];
    if (a == b) return;
    std::array<double, kBorderColumns> &border = border_of(std::min(a, b), std::max(a, b));
    double steps[3], traits = 0;
    for (size_t c = 0; c < 3; c++) steps[c] = square((double)seen.lab[3 * inner + c] - seen.lab[3 * outer + c]);
    for (size_t t = 0; t < kTraits; t++)
      traits += square((double)seen.traits[kTraits * inner + t] - seen.traits[kTraits * outer + t]);
    border[kLength]++;
    border[kStep] += std::nearbyint(std::sqrt(steps[0] + steps[1] + steps[2]));
    border[kStepChroma] += std::nearbyint(std::sqrt(steps[1] + steps[2]));
    border[kSeen] += (double)seen.borders[p] + seen.borders[q];
    border[kTraitStep] += std::nearbyint(std::sqrt(traits));
  }

  std::array<double, kBorderColumns> &border_of(int32_t a, int32_t b) {
    const auto [found, is_new] = rows.try_emplace((uint64_t)a << 32 | (uint32_t)b, (uint32_t)borders.size());
    if (is_new) borders.push_back({}), graph.pairs.insert(graph.pairs.end(), {a, b});
    return borders[found->second];
  }

  void add_sides(int32_t y, int32_t x) {
    const auto width = (size_t)seen.width, p = (size_t)y * width + (size_t)x;
    if (x + 1 < seen.width) add_side(p, p + 1, p - (x > 0), p + 1 + (x + 2 < seen.width));
    if (y + 1 < seen.height) add_side(p, p + width, p - (y > 0) * width, p + width + (y + 2 < seen.height) * width);
  }

  // Borders in the order of their pairs, and how much of each is around a region.
  PhotoGraph finished() {
    std::vector<uint32_t> order(borders.size());
    std::iota(order.begin(), order.end(), 0u);
    const std::vector<int32_t> pairs = std::move(graph.pairs);
    const auto key = [&](uint32_t e) { return (uint64_t)pairs[2 * e] << 32 | (uint32_t)pairs[2 * e + 1]; };
    std::sort(order.begin(), order.end(), [&](uint32_t e, uint32_t f) { return key(e) < key(f); });
    graph.pairs.clear();
    for (const uint32_t e : order) {
      graph.borders.insert(graph.borders.end(), borders[e].begin(), borders[e].end());
      for (const int32_t region : {pairs[2 * e], pairs[2 * e + 1]}) {
        graph.pairs.push_back(region);
        sums_of(region)[kAround] += borders[e][kLength];
      }
    }
    return std::move(graph);
  }
};

}  // namespace

PhotoGraph photo_graph(const SeenPixels &seen) {
  Summing summing(seen);
  for (int32_t y = 0; y < seen.height; y++)
    for (int32_t x = 0; x < seen.width; x++) summing.add_pixel(y, x), summing.add_sides(y, x);
  return summing.finished();
}

}  // namespace drsplat
