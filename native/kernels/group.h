// Sixteen splats of a view, one a lane, from rows in the order of the scene's Gaussians.
#pragma once
#include "kernels/lanes.h"

namespace drsplat::DRSPLAT_ISA {

constexpr uint32_t kAhead = 16;  // splats whose rows are fetched while earlier ones are worked on

// Up to sixteen splats, one a lane. Where there are fewer, the first is read again and what comes of it thrown away.
struct Group {
  size_t ids[16];
  int count;
  float *unused;  // room for a row

  Group(const Visible &v, uint32_t first, float *room)
      : count(v.count - first < 16 ? (int)(v.count - first) : 16), unused(room) {
    for (int l = 0; l < 16; l++) ids[l] = v.splats[first + (l < count ? l : 0)].id;
  }
  void gather(const float *rows, int stride, int width, float (*columns)[16]) const {
    const float *at[16];
    for (int l = 0; l < 16; l++) at[l] = rows + ids[l] * stride;
    gather_rows(at, width, columns);
  }
  void scatter(const float (*columns)[16], int stride, int width, float *rows) const {
    float *at[16];
    for (int l = 0; l < 16; l++) at[l] = l < count ? rows + ids[l] * stride : unused;
    scatter_rows(columns, width, at);
  }
};

}  // namespace drsplat::DRSPLAT_ISA
