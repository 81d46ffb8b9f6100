// Look-ups in tables of float32, on any machine. Sub-vectors are added one after the other, so a row's sum is
// the same for one query and for many.
#pragma once
#include "kernels/isa.h"
#include "kernels/scan_kernels.h"

namespace drsplat::DRSPLAT_ISA {

constexpr uint32_t kWide = 8;                 // queries looked up by one load
constexpr uint32_t kTile = 8, kWideTile = 4;  // sub-vectors whose tables stay in the L1 cache: of one query, of eight
typedef float Eight __attribute__((vector_size(32), aligned(4), may_alias));

INLINE size_t entries_of(uint32_t subvectors) { return (size_t)subvectors * 256; }
static size_t prepared_bytes(uint32_t subvectors, uint32_t queries) {
  return entries_of(subvectors) * ((queries + kWide - 1) / kWide * kWide) * sizeof(float);
}
static size_t scratch_bytes(uint32_t) { return kGroupRows * sizeof(Eight); }

// Queries from `first` on are looked up eight by eight while this says so: half an eight pays.
INLINE bool in_eights(uint32_t first, uint32_t queries) { return queries - first / kWide * kWide >= kWide / 2; }

static void prepare(const QueryTables &q, uint32_t subvectors, Precision, uint32_t begin, uint32_t end,
                    void *prepared) {
  const size_t entries = entries_of(subvectors);
  for (uint32_t i = begin; i < end; i++) {
    const float *from = q.tables + i * entries;
    if (in_eights(i, q.queries)) {
      float *to = (float *)prepared + i / kWide * kWide * entries + i % kWide;
      for (size_t e = 0; e < entries; e++) to[kWide * e] = from[e];
    } else {
      memcpy((float *)prepared + i * entries, from, entries * sizeof(float));
    }
  }
}

// Eight rows at a time: one load for their eight codes, a register for each of their sums.
template <uint32_t Count>
static void add_tile(const uint8_t *codes, const float *tables, float *out) {
  for (uint32_t i = 0; i < kGroupRows; i += 8) {
    float total[8];
#pragma GCC unroll 8
    for (int r = 0; r < 8; r++) total[r] = out[i + r];
#pragma GCC unroll 4
    for (uint32_t m = 0; m < Count; m++) {
      const float *table = tables + 256 * m;
      uint32_t four[2];
      memcpy(four, codes + 256 * m + i, 8);
#pragma GCC unroll 8
      for (int r = 0; r < 8; r++) total[r] += table[(uint8_t)(four[r / 4] >> 8 * (r % 4))];
    }
#pragma GCC unroll 8
    for (int r = 0; r < 8; r++) out[i + r] = total[r];
  }
}

static void sum_one(const uint8_t *codes, const float *tables, uint32_t subvectors, float *out) {
  for (uint32_t i = 0; i < kGroupRows; i++) out[i] = 0.f;
  uint32_t m = 0;
  for (; m + kTile <= subvectors; m += kTile) add_tile<kTile>(codes + 256 * m, tables + 256 * m, out);
  for (; m < subvectors; m++) add_tile<1>(codes + 256 * m, tables + 256 * m, out);
}

template <uint32_t Count>
static void add_eights(const uint8_t *codes, const float *tables, Eight *total) {
  for (uint32_t i = 0; i < kGroupRows; i++) {
    Eight sum = total[i];
#pragma GCC unroll 4
    for (uint32_t m = 0; m < Count; m++) sum += *(const Eight *)(tables + kWide * (256 * m + codes[256 * m + i]));
    total[i] = sum;
  }
}

static void sum_eight(const uint8_t *codes, const float *tables, uint32_t subvectors, Eight *total) {
  memset((void *)total, 0, kGroupRows * sizeof(Eight));
  uint32_t m = 0;
  for (; m + kWideTile <= subvectors; m += kWideTile)
    add_eights<kWideTile>(codes + 256 * m, tables + kWide * 256 * m, total);
  for (; m < subvectors; m++) add_eights<1>(codes + 256 * m, tables + kWide * 256 * m, total);
}

static void sums(const GroupedRows &rows, uint32_t queries, const void *prepared, uint32_t begin, uint32_t end,
                 uint64_t first_row, void *scratch, float *out) {
  const size_t entries = entries_of(rows.subvectors);
  const uint64_t groups = (rows.rows + kGroupRows - 1) / kGroupRows, group = first_row / kGroupRows;
  for (uint32_t half = 0; half < 2 && group + half < groups; half++, out += kGroupRows) {
    const uint8_t *codes = rows.codes + (group + half) * entries;
    for (uint32_t q = begin; q < end;) {
      float *to = out + (q - begin) * kPairRows;
      const float *tables = (const float *)prepared + q * entries;
      if (in_eights(q, queries)) {
        sum_eight(codes, tables, rows.subvectors, (Eight *)scratch);
        const uint32_t count = end - q < kWide ? end - q : kWide;
        for (uint32_t k = 0; k < count; k++)
          for (uint32_t i = 0; i < kGroupRows; i++) to[k * kPairRows + i] = ((const float *)scratch)[kWide * i + k];
        q += kWide;
      } else {
        sum_one(codes, tables, rows.subvectors, to);
        q++;
      }
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
