#include "host/photo_regions.h"

#include "host/memory.h"
#include "host/parallel.h"
#include "kernels/photo_kernels.h"

#include <array>
#include <cmath>
#include <cstring>
#include <queue>
#include <utility>

namespace drsplat {
namespace {

// A normal distribution of sigma 0.5 at 0, 1 and 2 pixels.
constexpr double kBlur[3] = {0.7865707258873422, 0.10645077197359151, 0.00026386508273735414};

struct Planes {
  size_t height, width;
  Unset<double> values;  // of three channels
  Planes(size_t h, size_t w) : height(h), width(w), values(unset<double>(3 * h * w)) {}
  double *row(size_t channel, size_t y) { return values.get() + (channel * height + y) * width; }
  const double *row(size_t channel, size_t y) const { return values.get() + (channel * height + y) * width; }
};

// Beyond an edge, pixels are those on this side of it.
size_t mirrored(ptrdiff_t i, size_t count) {
  const auto period = 2 * (ptrdiff_t)count;
  i = (i % period + period) % period;
  return (size_t)std::min(i, period - 1 - i);
}

double blurred(double middle, double near, double far) { return middle * kBlur[0] + far * kBlur[2] + near * kBlur[1]; }

Planes colors_of(const int32_t *lab, size_t height, size_t width) {
  Planes colors(height, width);
  for (size_t p = 0; p < height * width; p++)
    for (size_t c = 0; c < 3; c++) colors.values[c * height * width + p] = lab[3 * p + c] / kLabSteps;
  return colors;
}

Planes blurred_down(const Planes &in) {
  Planes out(in.height, in.width);
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
        wide[i] = row[i < 2 || i >= width + 2 ? mirrored((ptrdiff_t)i - 2, width) : i - 2];
      for (size_t x = 0; x < width; x++)
        row[x] = blurred(wide[x + 2], wide[x + 1] + wide[x + 3], wide[x] + wide[x + 4]);
    }
}

// place: four times a pixel's number, and in which direction its neighbour lies.
struct Edge {
  double cost;
  uint32_t place;
};

// Costs of most photos differ in these bits: 18 of the mantissa in 16 powers of two from 1/512. Costs are positive, so
// that they are in the order of their bits.
constexpr int kDigit = 11;
constexpr uint64_t kDigits = 1 << kDigit, kMost = kDigits * kDigits - 1;
constexpr int kDropped = 52 - 18;
constexpr uint64_t kFirst = (uint64_t)(1023 - 9) << 18;
constexpr ptrdiff_t kFew = 16;    // places that an edge is moved by itself
constexpr ptrdiff_t kAhead = 24;  // edges, whose pixels lie anywhere, that are looked up before their turn

uint64_t key_of(double cost) {
  uint64_t bits;
  std::memcpy(&bits, &cost, sizeof bits);
  bits >>= kDropped;
  return bits <= kFirst ? 0 : std::min(bits - kFirst, kMost);
}

// Both digits of keys are counted while edges are put in, so that they are only read to be moved.
struct Edges {
  using Counts = std::array<uint32_t, kDigits>;
  Unset<Edge> values, moved;
  size_t count = 0;
  Counts low{}, high{};

  explicit Edges(size_t most) : values(unset<Edge>(most)), moved(unset<Edge>(most)) {}
  Edge *begin() { return values.get(); }
  Edge *end() { return values.get() + count; }

  void add(double cost, uint32_t place) {
    const uint64_t key = key_of(cost);
    low[key % kDigits]++, high[key >> kDigit]++;
    values[count++] = {cost, place};
  }

  // By cost; equal ones keep their order.
  void sort() {
    move_by_digit(low, 0);
    move_by_digit(high, kDigit);
    for (Edge *next = begin() + 1; next < end(); next++)
      if (next->cost < next[-1].cost) next = put_in_place(next);
  }

  void move_by_digit(Counts &counts, int shift) {
    uint32_t before = 0;
    for (uint32_t &n : counts) before += std::exchange(n, before);
    for (const Edge &edge : *this) moved[counts[(key_of(edge.cost) >> shift) % kDigits]++] = edge;
    values.swap(moved);
  }

  // The last edge that is then in its place: this one, or where many have the same key, the last of them.
  Edge *put_in_place(Edge *unsorted) {
    const Edge edge = *unsorted;
    Edge *place = unsorted;
    for (; place > begin() && edge.cost < place[-1].cost && unsorted - place < kFew; place--) *place = place[-1];
    *place = edge;
    return unsorted - place < kFew ? unsorted : sort_alike(unsorted, key_of(edge.cost));
  }

  Edge *sort_alike(Edge *within, uint64_t key) {
    Edge *first = within, *last = within + 1;
    while (first > begin() && key_of(first[-1].cost) == key) first--;
    while (last < end() && key_of(last->cost) == key) last++;
    std::stable_sort(first, last, [](const Edge &x, const Edge &y) { return x.cost < y.cost; });
    return last - 1;
  }
};

// Neighbours in one direction: to pixels of the rows and columns, from those so far below and to the right.
struct Direction {
  size_t first_column, rows, columns;
  int down, right;
};

void add_edges(const Planes &colors, const Direction &to, uint32_t number, std::vector<double> &costs, Edges &edges) {
  for (size_t y = 0; y < to.rows; y++) {
    const double *a[3], *b[3];
    for (size_t c = 0; c < 3; c++) {
      a[c] = colors.row(c, y) + to.first_column;
      b[c] = colors.row(c, y + (size_t)to.down) + ((ptrdiff_t)to.first_column + to.right);
    }
    for (size_t x = 0; x < to.columns; x++) {
      const double l = b[0][x] - a[0][x], u = b[1][x] - a[1][x], v = b[2][x] - a[2][x];
      costs[x] = std::sqrt(l * l + u * u + v * v);
    }
    const auto pixel = (uint32_t)(y * colors.width + to.first_column);
    for (size_t x = 0; x < to.columns; x++) edges.add(costs[x], 4 * (pixel + (uint32_t)x) + number);
  }
}

Edges edges_of(const Planes &colors) {
  const size_t height = colors.height, width = colors.width;
  Edges edges(4 * height * width);
  std::vector<double> costs(width);
  const Direction directions[4] = {{0, height, width - 1, 0, 1},
                                   {0, height - 1, width, 1, 0},
                                   {0, height - 1, width - 1, 1, 1},
                                   {1, height - 1, width - 1, 1, -1}};
  for (uint32_t number = 0; number < 4; number++) add_edges(colors, directions[number], number, costs, edges);
  edges.sort();
  return edges;
}

// What regions consist of while they grow: trees of pixels. limit: of what merges with a root's region.
struct Growing {
  struct Node {
    uint32_t parent;
    int32_t size;
    double limit;
  };
  Unset<Node> nodes;
  size_t pixels;
  uint32_t steps[4];  // to the neighbour in each direction
  double scale;

  Growing(size_t count, uint32_t width, double s)
      : nodes(unset<Node>(count)), pixels(count), steps{1, width, width + 1, width - 1}, scale(s) {
    for (uint32_t p = 0; p < pixels; p++) nodes[p] = {p, 1, scale};
  }

  uint32_t root(uint32_t p) {
    while (nodes[p].parent != p) p = nodes[p].parent = nodes[nodes[p].parent].parent;
    return p;
  }

  uint32_t pixel(const Edge &edge) { return edge.place / 4; }
  uint32_t neighbour(const Edge &edge) { return pixel(edge) + steps[edge.place % 4]; }

  std::pair<uint32_t, uint32_t> ends(const Edge &edge) { return {root(pixel(edge)), root(neighbour(edge))}; }

  void fetch(const Edge &edge) {
    __builtin_prefetch(&nodes[pixel(edge)]);
    __builtin_prefetch(&nodes[neighbour(edge)]);
  }

  void unite(uint32_t a, uint32_t b, double cost) {
    if (nodes[a].size < nodes[b].size) std::swap(a, b);
    nodes[b].parent = a;
    nodes[a].size += nodes[b].size;
    nodes[a].limit = cost + scale / nodes[a].size;
  }

  // Merges what is alike, and keeps the edges that do not merge anything, in order.
  void merge_alike(Edges &edges) {
    size_t kept = 0;
    for (const Edge &edge : edges) {
      fetch(edges.end() - &edge > kAhead ? (&edge)[kAhead] : edge);
      const auto [a, b] = ends(edge);
      if (a == b) continue;
      if (edge.cost < std::min(nodes[a].limit, nodes[b].limit)) unite(a, b, edge.cost);
      else edges.values[kept++] = edge;
    }
    edges.count = kept;
  }

  void merge_small(Edges &edges, int32_t least) {
    for (const Edge &edge : edges) {
      const auto [a, b] = ends(edge);
      if (a != b && (nodes[a].size < least || nodes[b].size < least)) unite(a, b, 0);
    }
  }

  std::vector<int32_t> labels() {
    std::vector<int32_t> numbers(pixels, -1), labels(pixels);
    int32_t count = 0;
    for (uint32_t p = 0; p < pixels; p++) {
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
  Edges edges = edges_of(colors);
  Growing growing((size_t)height * (size_t)width, (uint32_t)width, scale);
  growing.merge_alike(edges);
  growing.merge_small(edges, least);
  return growing.labels();
}

std::vector<int32_t> flooded(const int32_t *heights, const int32_t *markers, int32_t height, int32_t width) {
  struct Reached {
    int32_t level;
    uint32_t turn, pixel;
    bool operator<(const Reached &other) const {
      return level != other.level ? level > other.level : turn > other.turn;
    }
  };
  const size_t count = (size_t)height * (size_t)width;
  std::vector<int32_t> owner(markers, markers + count);
  std::priority_queue<Reached> queue;
  uint32_t turn = 0;
  for (size_t p = 0; p < count; p++)
    if (owner[p]) queue.push({heights[p], turn++, (uint32_t)p});
  while (!queue.empty()) {
    const size_t pixel = queue.top().pixel, y = pixel / (size_t)width, x = pixel % (size_t)width;
    queue.pop();
    const auto reach = [&](bool inside, size_t next) {
      if (!inside || owner[next]) return;
      owner[next] = owner[pixel];
      queue.push({heights[next], turn++, (uint32_t)next});
    };
    reach(y > 0, pixel - (size_t)width), reach(x > 0, pixel - 1);
    reach(x + 1 < (size_t)width, pixel + 1), reach(y + 1 < (size_t)height, pixel + (size_t)width);
  }
  return owner;
}

}  // namespace drsplat
