// Look-ups in tables of whole numbers of 32 bits (scan_steps.h), on any machine: one load and one addition for a code.
// Shuffles of bytes, as in scan_bytes.h, take more instructions than that where they have tables of 16 (AVX2) or 64
// entries (NEON): docs/search.md.
#pragma once
#include "kernels/isa.h"
#include "kernels/scan_kernels.h"
#include "kernels/scan_steps.h"

namespace drsplat::DRSPLAT_ISA {

constexpr uint32_t kWide = 8;                 // queries looked up by one load
constexpr uint32_t kTile = 8, kWideTile = 4;  // sub-vectors whose tables stay in the L1 cache: of one query, of eight
constexpr uint32_t kAhead = 4096;             // bytes of codes that are fetched before they are needed
typedef uint32_t Eight __attribute__((vector_size(32), aligned(4), may_alias));

// What `prepare` writes: scales of all queries, their tables, and the ranges of each sub-vector.
struct Prepared {
  Scale *scales;
  uint32_t *tables;
  Range *ranges;
};

INLINE size_t entries_of(uint32_t subvectors) { return (size_t)subvectors * 256; }
INLINE size_t padded(uint32_t queries) { return (queries + kWide - 1) / kWide * kWide; }
static size_t prepared_bytes(uint32_t subvectors, uint32_t queries) {
  return padded(queries) *
         (sizeof(Scale) + entries_of(subvectors) * sizeof(uint32_t) + (size_t)subvectors * sizeof(Range));
}
static size_t scratch_bytes(uint32_t) { return kGroupRows * sizeof(Eight); }

INLINE Prepared prepared_at(const void *prepared, uint32_t subvectors, uint32_t queries) {
  Scale *scales = (Scale *)prepared;
  uint32_t *tables = (uint32_t *)(scales + padded(queries));  // padded: at a multiple of 64 bytes
  return {scales, tables, (Range *)(tables + padded(queries) * entries_of(subvectors))};
}

// Queries from `first` on are looked up eight by eight while this says so: half an eight pays.
INLINE bool in_eights(uint32_t first, uint32_t queries) { return queries - first / kWide * kWide >= kWide / 2; }

// One table in steps, every `stride`-th number; 0 where entries that are no finite numbers leave none.
INLINE void round_table(const float *from, float low, float per_step, uint32_t stride, uint32_t *to) {
  for (uint32_t c = 0; c < 256; c++) {
    const float steps = (from[c] - low) * per_step + 0.5f;
    to[stride * c] = steps >= 0.f && steps < 1e9f ? (uint32_t)(int32_t)steps : 0u;
  }
}

static void prepare(const QueryTables &q, uint32_t subvectors, Precision precision, uint32_t begin, uint32_t end,
                    void *prepared) {
  const size_t entries = entries_of(subvectors);
  const Prepared p = prepared_at(prepared, subvectors, q.queries);
  for (uint32_t i = begin; i < end; i++) {
    const float *from = q.tables + i * entries;
    Range *ranges = p.ranges + (size_t)i * subvectors;
    p.scales[i] = scale_of(from, subvectors, precision, ranges);
    const bool wide = in_eights(i, q.queries);
    const uint32_t stride = wide ? kWide : 1;
    uint32_t *to = p.tables + (wide ? i / kWide * kWide * entries + i % kWide : i * entries);
    for (uint32_t m = 0; m < subvectors; m++)
      round_table(from + 256 * m, ranges[m].low, 1.f / p.scales[i].step, stride, to + stride * 256 * m);
  }
}

// Eight rows at a time: one load for their eight codes, a register for each of their sums. Two codes are loaded alone,
// since shifting and adding is what most processors wait for. Not inlined: it needs all registers.
template <uint32_t Count>
__attribute__((noinline)) static void add_tile(const uint8_t *codes, const uint8_t *ahead, const uint32_t *tables,
                                               uint32_t *out) {
  for (uint32_t i = 0; i < kGroupRows; i += 8) {
    uint32_t total[8];
#pragma GCC unroll 8
    for (int r = 0; r < 8; r++) total[r] = out[i + r];
    __builtin_prefetch(ahead + Count * i);
    const uint8_t *at = codes + i;
    const uint32_t *table = tables;
#pragma GCC unroll 1  // else GCC keeps the indices of several tables, and runs out of registers
    for (uint32_t m = 0; m < Count; m++, at += 256, table += 256) {
      uint64_t eight;
      memcpy(&eight, at, 8);
#pragma GCC unroll 4
      for (int r = 0; r < 6; r += 2) {
        total[r] += table[(uint8_t)eight], total[r + 1] += table[(uint8_t)(eight >> 8)];
        eight >>= 16;
        __asm__("" : "+r"(eight));  // else GCC shifts anew for each code; x86-64 has names for the two lowest bytes
      }
      total[6] += table[at[6]], total[7] += table[at[7]];
    }
#pragma GCC unroll 8
    for (int r = 0; r < 8; r++) out[i + r] = total[r];
  }
}

// The codes of one group, sub-vector by sub-vector, and where codes end.
struct Codes { const uint8_t *first, *end; };
INLINE const uint8_t *ahead_of(const uint8_t *at, Codes codes) {
  return (size_t)(codes.end - at) >= 2 * kAhead ? at + kAhead : at;
}

// out = bias + step * total, of the first chunk; of later ones, out += step * total.
INLINE void emit(const uint32_t *total, uint32_t stride, Scale scale, bool first, float *out) {
  for (uint32_t i = 0; i < kGroupRows; i++)
    out[i] = (float)(int32_t)total[stride * i] * scale.step + (first ? scale.bias : out[i]);
}

static void sum_one(Codes codes, const uint32_t *tables, uint32_t subvectors, Scale scale, uint32_t *total,
                    float *out) {
  for (uint32_t m = 0, chunk = 0; chunk < subvectors; chunk += kChunk) {
    memset(total, 0, kGroupRows * sizeof(uint32_t));
    const uint32_t last = chunk + kChunk < subvectors ? chunk + kChunk : subvectors;
    for (; m + kTile <= last; m += kTile) {
      const uint8_t *at = codes.first + 256 * m;
      add_tile<kTile>(at, ahead_of(at, codes), tables + 256 * m, total);
    }
    for (; m < last; m++) add_tile<1>(codes.first + 256 * m, codes.first + 256 * m, tables + 256 * m, total);
    emit(total, 1, scale, chunk == 0, out);
  }
}

template <uint32_t Count>
static void add_eights(const uint8_t *codes, const uint8_t *ahead, const uint32_t *tables, Eight *total) {
  for (uint32_t i = 0; i < kGroupRows; i++) {
    Eight sum = total[i];
    if (i % 16 == 0) __builtin_prefetch(ahead + Count * i);
#pragma GCC unroll 4
    for (uint32_t m = 0; m < Count; m++) sum += *(const Eight *)(tables + kWide * (256 * m + codes[256 * m + i]));
    total[i] = sum;
  }
}

static void sum_eight(Codes codes, const uint32_t *tables, uint32_t subvectors, const Scale *scales, uint32_t count,
                      Eight *total, float *out) {
  for (uint32_t m = 0, chunk = 0; chunk < subvectors; chunk += kChunk) {
    memset((void *)total, 0, kGroupRows * sizeof(Eight));
    const uint32_t last = chunk + kChunk < subvectors ? chunk + kChunk : subvectors;
    for (; m + kWideTile <= last; m += kWideTile) {
      const uint8_t *at = codes.first + 256 * m;
      add_eights<kWideTile>(at, ahead_of(at, codes), tables + kWide * 256 * m, total);
    }
    for (; m < last; m++) add_eights<1>(codes.first + 256 * m, codes.first + 256 * m, tables + kWide * 256 * m, total);
    for (uint32_t k = 0; k < count; k++)
      emit((const uint32_t *)total + k, kWide, scales[k], chunk == 0, out + k * kSumRows);
  }
}

static void sums(const GroupedRows &rows, uint32_t queries, const void *prepared, uint32_t begin, uint32_t end,
                 uint64_t first_row, void *scratch, float *out) {
  const size_t entries = entries_of(rows.subvectors);
  const uint64_t groups = (rows.rows + kGroupRows - 1) / kGroupRows, group = first_row / kGroupRows;
  const Prepared p = prepared_at(prepared, rows.subvectors, queries);
  for (uint32_t g = 0; g < kSumRows / kGroupRows && group + g < groups; g++, out += kGroupRows) {
    const Codes codes = {rows.codes + (group + g) * entries, rows.codes + groups * entries};
    for (uint32_t q = begin; q < end;) {
      float *to = out + (q - begin) * kSumRows;
      const uint32_t *tables = p.tables + q * entries;
      if (in_eights(q, queries)) {
        const uint32_t count = end - q < kWide ? end - q : kWide;
        sum_eight(codes, tables, rows.subvectors, p.scales + q, count, (Eight *)scratch, to);
        q += kWide;
      } else {
        sum_one(codes, tables, rows.subvectors, p.scales[q], (uint32_t *)scratch, to);
        q++;
      }
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
