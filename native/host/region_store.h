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

// Where a region's sights and entries are. After its sights comes one that only ends its entries.
struct Region {
  int64_t sights, entries;
  int32_t num_sights;
  int32_t place;  // its first row
  int32_t node;
};

// What each region gets from each mask, and from each view. Regions that are no more leave gaps, until those are as
// much as half of the rest.
struct Regions {
  std::vector<Region> regions;  // by their first rows
  std::vector<Sight> sights;
  std::vector<Entry> entries;
  std::vector<float> features, lengths;  // by place: of the sum of a region's embeddings, the direction and the length

  int32_t count() const { return (int32_t)regions.size(); }
  const Sight *sights_of(const Region &region) const { return sights.data() + region.sights; }
  const Entry *entries_of(const Region &region) const { return entries.data() + region.entries; }
  int64_t num_entries(const Region &region) const { return sights_of(region)[region.num_sights].entry; }
};

struct Agreement {
  double shared = 0, seen = 0;  // the mean is shared / seen
};

// Over the views that see both, how much the same masks hold both.
Agreement agreement(const Regions &, const Region &, const Region &, double soft);

// Agreement of one region with many, without a search: what it gets from each view and mask, in a table.
struct Table {
  Table(const Regions &regions, const Votes &votes) : all(regions), masses(votes.num_views()), weights(votes.masks) {}

  // As agreement(a, b), quicker if the last one was of a, too.
  Agreement of(const Region &a, const Region &b, double soft);

  template <class Set>
  void each(const Region &region, Set set) {
    const Sight *sights = all.sights_of(region);
    const Entry *entries = all.entries_of(region);
    for (int32_t s = 0; s < region.num_sights; s++) set(masses[(size_t)sights[s].view], sights[s].mass);
    for (int64_t e = 0; e < all.num_entries(region); e++) set(weights[(size_t)entries[e].column], entries[e].weight);
  }

  const Regions &all;
  const Region *held = nullptr;
  std::vector<float> masses, weights;
};

// Of the regions' mean embeddings, 1 for unrelated ones.
double distance(const Regions &, const Region &, const Region &, uint32_t dim, double unit);

// The sights of so many entries, and the one that ends them. How many there are.
int32_t add_sights(const Entry *, size_t count, const int32_t *views, std::vector<Sight> &);

// A sum of embeddings, weighted, as a unit vector (or zero) and its length.
void keep_feature(Regions &, size_t place, const std::vector<double> &sum);

Regions first_regions(const Votes &, int threads);

// Moves what is in use together, where there are many gaps.
void close_gaps(Regions &);

}  // namespace drsplat
