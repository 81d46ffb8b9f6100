#include "host/photo_regions.h"

#include "host/parallel.h"
#include "kernels/photo_kernels.h"

#include <array>
#include <cmath>
#include <cstring>
#include <utility>

namespace drsplat {
namespace {

// A normal distribution of sigma 0.5 at 0, 1 and 2 pixels.
constexpr double kBlur[3] = {0.7865707258873422, 0.10645077197359151, 0.00026386508273735414};

struct Planes {
  size_t height, width;
  std::vector<double> values;  // of three channels
  double *row(size_t channel, size_t y) { return values.data() + (channel * height + y) * width; }
  const double *row(size_t channel, size_t y) const { return values.data() + (channel * height + y) * width; }
};

// Beyond an edge, pixels are those on this side of it.
size_t mirrored(ptrdiff_t i, size_t count) {
  const auto period = 2 * (ptrdiff_t)count;
  i = (i % period + period) % period;
  return (size_t)std::min(i, period - 1 - i);
}

double blurred(double middle, double near, double far) { return middle * kBlur[0] + far * kBlur[2] + near * kBlur[1]; }

Planes colors_of(const int32_t *lab, size_t height, size_t width) {
  Planes colors{height, width, std::vector<double>(3 * height * width)};
  for (size_t p = 0; p < height * width; p++)
    for (size_t c = 0; c < 3; c++) colors.values[c * height * width + p] = lab[3 * p + c] / kLabSteps;
  return colors;
}

Planes blurred_down(const Planes &in) {
  Planes out{in.height, in.width, std::vector<double>(in.values.size())};
  for (size_t c = 0; c < 3; c++)
    for (size_t y = 0; y < in.height; y++) {
      const double *rows[5];
      for (int k = 0; k < 5; k++) rows[k] = in.row(c, mirrored((ptrdiff_t)y + k - 2, in.height));
      double *to = out.row(c, y);
      for (size_t x = 0; x < in.width; x++)
        to[x] = blurred(rows[2][x], rows[1][x] + rows[3][x], rows[0][x] + rows[4][x]);
    }
  return out;
}

void blur_across(Planes &planes) {
  const size_t width = planes.width;
  std::vector<double> wide(width + 4);  // two more at both ends
  for (size_t c = 0; c < 3; c++)
    for (size_t y = 0; y < planes.height; y++) {
      double *row = planes.row(c, y);
      for (size_t i = 0; i < width + 4; i++)
        if (i < 2 || i >= width + 2) wide[i] = row[mirrored((ptrdiff_t)i - 2, width)];
      std::copy_n(row, width, wide.begin() + 2);
      for (size_t x = 0; x < width; x++)
        row[x] = blurred(wide[x + 2], wide[x + 1] + wide[x + 3], wide[x] + wide[x + 4]);
    }
}

// place: four times a pixel's number, and in which direction its neighbour lies.
struct Edge {
  double cost;
  uint32_t place;
};

// Costs of most photos differ in these bits: 18 of the mantissa in 16 powers of two from 1/64. Costs are positive, so
// that they are in the order of their bits.
constexpr int kDigit = 11;
constexpr uint64_t kDigits = 1 << kDigit, kMost = kDigits * kDigits - 1;
constexpr int kDropped = 52 - 18;
constexpr uint64_t kFirst = (uint64_t)(1023 - 6) << 18;

uint64_t key_of(double cost) {
  uint64_t bits;
  std::memcpy(&bits, &cost, sizeof bits);
  bits >>= kDropped;
  return bits <= kFirst ? 0 : std::min(bits - kFirst, kMost);
}

using Counts = std::array<uint32_t, kDigits>;

void place_by_digit(const std::vector<Edge> &from, std::vector<Edge> &to, Counts &counts, int shift) {
  uint32_t before = 0;
  for (uint32_t &count : counts) before += std::exchange(count, before);
  for (const Edge &edge : from) to[counts[(key_of(edge.cost) >> shift) % kDigits]++] = edge;
}

// By cost; equal ones keep their order.
void sort(std::vector<Edge> &edges) {
  std::vector<Edge> other(edges.size());
  Counts low{}, high{};
  for (const Edge &edge : edges) {
    const uint64_t key = key_of(edge.cost);
    low[key % kDigits]++, high[key >> kDigit]++;
  }
  place_by_digit(edges, other, low, 0);
  place_by_digit(other, edges, high, kDigit);
  const auto cheaper = [](const Edge &x, const Edge &y) { return x.cost < y.cost; };
  for (auto begin = edges.begin(); begin != edges.end();) {
    auto end = begin + 1;
    bool sorted = true;
    for (const uint64_t key = key_of(begin->cost); end != edges.end() && key_of(end->cost) == key; ++end)
      sorted = sorted && end[-1].cost <= end->cost;
    if (!sorted) std::stable_sort(begin, end, cheaper);
    begin = end;
  }
}

std::vector<Edge> edges_of(const Planes &colors) {
  const size_t height = colors.height, width = colors.width;
  std::vector<Edge> edges;
  edges.reserve(4 * height * width);
  std::vector<double> costs(width);
  const auto add = [&](uint32_t direction, size_t first_row, size_t first_column, size_t rows, size_t columns, int down,
                       int right) {
    for (size_t y = first_row; y < first_row + rows; y++) {
      const double *a[3], *b[3];
      for (size_t c = 0; c < 3; c++)
        a[c] = colors.row(c, y) + first_column,
        b[c] = colors.row(c, y + (size_t)down) + (ptrdiff_t)first_column + right;
      for (size_t x = 0; x < columns; x++) {
        const double l = b[0][x] - a[0][x], u = b[1][x] - a[1][x], v = b[2][x] - a[2][x];
        costs[x] = std::sqrt(l * l + u * u + v * v);
      }
      const auto pixel = (uint32_t)(y * width + first_column);
      for (size_t x = 0; x < columns; x++) edges.push_back({costs[x], 4 * (pixel + (uint32_t)x) + direction});
    }
  };
  add(0, 0, 0, height, width - 1, 0, 1);
  add(1, 0, 0, height - 1, width, 1, 0);
  add(2, 0, 0, height - 1, width - 1, 1, 1);
  add(3, 0, 1, height - 1, width - 1, 1, -1);
  sort(edges);
  return edges;
}

// What regions consist of while they grow: trees of pixels. limit: of what merges with a root's region.
struct Growing {
  struct Node {
    uint32_t parent;
    int32_t size;
    double limit;
  };
  std::vector<Node> nodes;
  uint32_t steps[4];  // to the neighbour in each direction
  double scale;

  Growing(size_t pixels, uint32_t width, double s) : nodes(pixels), steps{1, width, width + 1, width - 1}, scale(s) {
    for (uint32_t p = 0; p < pixels; p++) nodes[p] = {p, 1, scale};
  }

  uint32_t root(uint32_t p) {
    while (nodes[p].parent != p) p = nodes[p].parent = nodes[nodes[p].parent].parent;
    return p;
  }

  std::pair<uint32_t, uint32_t> ends(const Edge &edge) {
    const uint32_t pixel = edge.place / 4;
    return {root(pixel), root(pixel + steps[edge.place % 4])};
  }

  void unite(uint32_t a, uint32_t b, double cost) {
    if (nodes[a].size < nodes[b].size) std::swap(a, b);
    nodes[b].parent = a;
    nodes[a].size += nodes[b].size;
    nodes[a].limit = cost + scale / nodes[a].size;
  }

  // Merges what is alike, and keeps the edges that do not merge anything, in order.
  void merge_alike(std::vector<Edge> &edges) {
    size_t kept = 0;
    for (const Edge &edge : edges) {
      const auto [a, b] = ends(edge);
      if (a == b) continue;
      if (edge.cost < std::min(nodes[a].limit, nodes[b].limit)) unite(a, b, edge.cost);
      else edges[kept++] = edge;
    }
    edges.resize(kept);
  }

  void merge_small(const std::vector<Edge> &edges, int32_t least) {
    for (const Edge &edge : edges) {
      const auto [a, b] = ends(edge);
      if (a != b && (nodes[a].size < least || nodes[b].size < least)) unite(a, b, 0);
    }
  }

  std::vector<int32_t> labels() {
    std::vector<int32_t> numbers(nodes.size(), -1), labels(nodes.size());
    int32_t count = 0;
    for (uint32_t p = 0; p < nodes.size(); p++) {
      int32_t &number = numbers[root(p)];
      if (number < 0) number = count++;
      labels[p] = number;
    }
    return labels;
  }
};

}  // namespace

void lab_colors(const Kernels &kernels, const uint8_t *rgb, size_t pixels, int threads, int32_t *lab) {
  double linear[256];
  for (int i = 0; i < 256; i++) {
    const double intensity = i * (1.0 / 255);
    linear[i] = intensity > 0.04045 ? std::pow((intensity + 0.055) / 1.055, 2.4) : intensity / 12.92;
  }
  over_rows(pixels, 1 << 14, threads,
            [&](int, uint64_t begin, uint64_t end) { kernels.photo->lab_colors(rgb, begin, end, linear, lab); });
}

std::vector<int32_t> small_regions(const int32_t *lab, int32_t height, int32_t width, double scale, int32_t least) {
  Planes colors = blurred_down(colors_of(lab, (size_t)height, (size_t)width));
  blur_across(colors);
  std::vector<Edge> edges = edges_of(colors);
  Growing growing((size_t)height * (size_t)width, (uint32_t)width, scale);
  growing.merge_alike(edges);
  growing.merge_small(edges, least);
  return growing.labels();
}

}  // namespace drsplat
