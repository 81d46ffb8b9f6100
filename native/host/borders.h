// Borders between regions, and which regions they join.
#pragma once
#include "host/region_store.h"

namespace drsplat {

constexpr float kUnknown = -1e30f;

// The border of two regions: sums over the edges that cross it, and the score, if neither has changed since.
struct Border {
  int32_t a, b;
  float shared, seen, score;
};

// Of edges between single rows.
std::vector<Border> first_borders(const Regions &, const Edge *, size_t count, double soft, int threads);

// The agreement of sums over views, pulled towards the prior where few views see both.
double pulled(const Agreement &, const MergeRule &);

// Gives those a score that have none and may reach the threshold.
void score(const Regions &, std::vector<Border> &, const MergeRule &, double threshold, int threads);

// The new number of each region; neighbours that are, nearly, each other's best share one. How many there are. Of a
// chain of such neighbours the heaviest on both sides have to agree as well: what is faint and like two regions does
// not link them. masses: of each region's node.
int32_t joined(const Regions &, const std::vector<Border> &, const std::vector<float> &masses, const MergeRule &,
               double threshold, std::vector<int32_t> &numbers);

// Regions by their new number: members[begins[n]] ... members[begins[n + 1] - 1], ascending.
struct Groups {
  std::vector<int64_t> begins;
  std::vector<int32_t> members;
  std::vector<int32_t> several;  // numbers of more than one region

  size_t size(size_t n) const { return (size_t)(begins[n + 1] - begins[n]); }
};

Groups grouped(const std::vector<int32_t> &numbers, int32_t count);

// Borders between the new regions, ascending; those of the same two are one.
void make_borders_anew(std::vector<Border> &, const std::vector<int32_t> &numbers, const Groups &, int threads);

}  // namespace drsplat
