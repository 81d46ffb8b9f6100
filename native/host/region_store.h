// What regions of Gaussians get from masks and views, while they are merged.
#pragma once
#include "host/regions.h"

#include <cstddef>

namespace drsplat {

// A region's weight in one view, and where the entries of that view begin among its own.
struct Sight {
  int32_t view;
  float mass;
  uint32_t entry;
};

struct Entry {
  int32_t column;
  float weight;
};

// A single row, whose entries are those of W, or several, whose sums are in a chunk.
struct Region {
  union {
    const Entry *entries;
    int64_t begin;  // of a row: where it begins in W
  };
  const Sight *sights;  // after the last one comes one that only ends its entries; null: of a single row
  int32_t num_sights;   // of a row: entries
  int32_t place;        // its first row
  int32_t node;
  int32_t chunk;

  bool is_row() const { return !sights; }
  size_t num_entries() const { return is_row() ? (size_t)num_sights : sights[num_sights].entry; }
};

// Sums of several regions; `used` entries are those of regions that still are.
struct Chunk {
  std::vector<Entry> entries;
  std::vector<Sight> sights;
  size_t used = 0;
};

struct Regions {
  const Votes &votes;
  std::vector<Region> regions;  // by their first rows
  std::vector<Chunk> chunks;
  std::vector<float> features, lengths;  // by place: of the sum of a region's embeddings, the direction and the length

  int32_t count() const { return (int32_t)regions.size(); }
  void prefetch(const Region &) const;
  void prefetch_feature(const Region &) const;
};

struct Agreement {
  double shared = 0, seen = 0;  // the mean is shared / seen
};

// Sums of single rows, which are made when they are needed, and kept until another one needs their place.
struct Laid {
  explicit Laid(const Regions &regions) : all(regions), rows(kRows) {}

  // The same region with its sums, until the next is asked for.
  Region of(const Region &);

  static constexpr size_t kRows = 256;
  struct Row {
    int32_t place = -1, num_sights = 0;
    std::vector<Entry> entries;
    std::vector<Sight> sights;
  };
  const Regions &all;
  std::vector<Row> rows;
};

// Over the views that see both, how much the same masks hold both. Neither is a single row that is not laid out.
Agreement agreement(const Region &, const Region &, double soft);

// Agreement of one region with many, without a search: what it gets from each view and mask, in a table.
struct Table {
  explicit Table(const Regions &regions)
      : all(regions), laid(regions), masses(regions.votes.num_views()), weights(regions.votes.masks) {}

  // As agreement(a, b), quicker if the last one was of a, too.
  Agreement of(const Region &a, const Region &b, double soft);

  template <class Set>
  void each(const Region &, Set);

  const Regions &all;
  const Region *held = nullptr;
  Laid laid;
  std::vector<float> masses, weights;
};

// Of the regions' mean embeddings, 1 for unrelated ones.
double distance(const Regions &, const Region &, const Region &, double unit);

// The sights of so many entries, and the one that ends them. How many there are.
int32_t add_sights(const Entry *, size_t count, const int32_t *views, std::vector<Sight> &);

// A sum of embeddings, weighted, as a unit vector (or zero) and its length.
void keep_feature(Regions &, size_t place, const std::vector<double> &sum);

Regions first_regions(const Votes &, int threads);

// Moves what is in use together, out of chunks of which little is, and lets these go.
void close_gaps(Regions &);

}  // namespace drsplat
