// Look-ups in tables of bytes (AVX-512 VBMI): 64 codes in two vpermi2b.
//
// The digits of an entry, counted in steps (scan_steps.h), are summed apart, as planes of bytes: the lowest digit to
// base 128 or 256, the others to base 256. Bytes of several sub-vectors are added as bytes while they fit ("packed"),
// then widened to 16 bits, where bits 8-15 count the odd rows too; these are also summed apart, and taken out at the
// end.
// Source: Andre et al. 2015, 2017 (PQ Fast Scan, Quick ADC) for sums in small integers of shuffled tables;
// tables of all 256 entries in registers, and planes, are ours.

constexpr uint32_t kPlanes = 3;
#pragma once
#include "kernels/isa.h"
#include "kernels/scan_kernels.h"
#include "kernels/scan_steps.h"

namespace drsplat::DRSPLAT_ISA {

constexpr uint32_t kTile = 32;  // sub-vectors whose codes stay in the L1 cache

struct Step {        // one table of 256 bytes
  uint16_t in_tile;  // its sub-vector, within the tile
  uint16_t flush;    // widen the packed bytes after it
};
struct Run {  // the steps of one tile and plane
  uint32_t begin, end;
  bool packed;
};

struct BytePlan {  // of one query; pointers are set by `plan_at`
  Scale scale;
  float weights[kPlanes];
  uint32_t planes;  // in use
  Range *ranges;    // of each sub-vector
  Run *runs;        // tiles x kPlanes
  Step *steps;      // up to kPlanes for each sub-vector
  uint8_t *tables;  // 256 for each step
};

INLINE uint32_t tiles_of(uint32_t subvectors) { return (subvectors + kTile - 1) / kTile; }
INLINE size_t rounded(size_t bytes) { return (bytes + 63) / 64 * 64; }
INLINE size_t run_bytes(uint32_t subvectors) { return rounded(tiles_of(subvectors) * kPlanes * sizeof(Run)); }
INLINE size_t step_bytes(uint32_t subvectors) { return rounded((size_t)subvectors * kPlanes * sizeof(Step)); }
INLINE size_t range_bytes(uint32_t subvectors) { return rounded(subvectors * sizeof(Range)); }
INLINE size_t plan_bytes(uint32_t subvectors) {
  return rounded(sizeof(BytePlan)) + range_bytes(subvectors) + run_bytes(subvectors) + step_bytes(subvectors) +
         (size_t)subvectors * kPlanes * 256;
}
static size_t prepared_bytes(uint32_t subvectors, uint32_t queries) { return plan_bytes(subvectors) * queries; }

INLINE BytePlan &plan_at(const void *prepared, uint32_t subvectors, uint32_t query) {
  return *(BytePlan *)((char *)prepared + plan_bytes(subvectors) * query);
}

static BytePlan &new_plan(void *prepared, uint32_t subvectors, uint32_t query) {
  BytePlan &plan = plan_at(prepared, subvectors, query);
  char *p = (char *)&plan + rounded(sizeof(BytePlan));
  plan.ranges = (Range *)p, p += range_bytes(subvectors);
  plan.runs = (Run *)p, p += run_bytes(subvectors);
  plan.steps = (Step *)p, p += step_bytes(subvectors);
  plan.tables = (uint8_t *)p;
  return plan;
}

// Bytes of one plane of one table; returns the largest.
static uint32_t digits_of(const float *table, float low, float per_step, int shift, uint32_t mask, uint8_t *bytes) {
  const __m512 l = _mm512_set1_ps(low), p = _mm512_set1_ps(per_step), half = _mm512_set1_ps(0.5f);
  __m512i largest = _mm512_setzero_si512();
  for (int c = 0; c < 256; c += 16) {
    const __m512i steps = _mm512_cvttps_epi32(_mm512_fmadd_ps(_mm512_sub_ps(_mm512_loadu_ps(table + c), l), p, half));
    const __m512i digits = _mm512_and_si512(_mm512_srli_epi32(steps, shift), _mm512_set1_epi32((int)mask));
    largest = _mm512_max_epu32(largest, digits);
    _mm_storeu_si128((__m128i *)(bytes + c), _mm512_cvtepi32_epi8(digits));
  }
  return _mm512_reduce_max_epu32(largest);
}

// In which order the tables of a run are added, and after which the bytes are widened: small ones first, as many as fit
// a byte together. Returns how often bytes are widened.
static uint32_t pack(const uint32_t *largest, uint32_t count, uint32_t *order, bool *flush) {
  for (uint32_t i = 0; i < count; i++) {
    uint32_t at = i;
    for (; at > 0 && largest[order[at - 1]] > largest[i]; at--) order[at] = order[at - 1];
    order[at] = i;
  }
  uint32_t flushes = count > 0, held = 0;
  for (uint32_t i = 0; i < count; i++) {
    held += largest[order[i]];
    flush[i] = i + 1 == count || held + largest[order[i + 1]] > 255;
    if (flush[i] && i + 1 < count) held = 0, flushes++;
  }
  return flushes;
}

static void plan_run(BytePlan &plan, const float *tables, uint32_t first, uint32_t last, int shift, uint32_t mask,
                     Run &run) {
  const float per_step = 1.f / plan.scale.step;
  uint8_t digits[kTile][256];
  uint32_t largest[kTile], order[kTile], of_table[kTile], count = 0;
  bool flush[kTile];
  for (uint32_t m = first; m < last; m++) {
    largest[count] = digits_of(tables + 256 * (size_t)m, plan.ranges[m].low, per_step, shift, mask, digits[count]);
    of_table[count] = m - first;
    count += largest[count] > 0;
  }
  run.packed = 3 * pack(largest, count, order, flush) < 2 * count;  // else two additions and a shift each are less
  run.end = run.begin + count;
  for (uint32_t i = 0; i < count; i++) {
    plan.steps[run.begin + i] = {(uint16_t)of_table[order[i]], flush[i]};
    memcpy(plan.tables + 256 * (size_t)(run.begin + i), digits[order[i]], 256);
  }
}

static void prepare_one(const float *tables, uint32_t subvectors, Precision precision, BytePlan &plan) {
  plan.scale = scale_of(tables, subvectors, precision, plan.ranges), plan.planes = 1;
  const int lowest = precision.wide ? 8 : 7;  // bits; pairs of 7 fit a byte
  const int shifts[kPlanes] = {0, lowest, lowest + 8};
  const uint32_t masks[kPlanes] = {(1u << lowest) - 1, 255, 255};
  uint32_t at = 0;
  for (uint32_t first = 0, i = 0; first < subvectors; first += kTile)
    for (uint32_t plane = 0; plane < kPlanes; plane++, i++) {
      plan.runs[i].begin = at;
      plan_run(plan, tables, first, first + kTile < subvectors ? first + kTile : subvectors, shifts[plane],
               masks[plane], plan.runs[i]);
      at = plan.runs[i].end;
      if (at > plan.runs[i].begin && plan.planes <= plane) plan.planes = plane + 1;
      plan.weights[plane] = (float)(1 << shifts[plane]);
    }
}

static void prepare(const QueryTables &q, uint32_t subvectors, Precision precision, uint32_t begin, uint32_t end,
                    void *prepared) {
  for (uint32_t i = begin; i < end; i++)
    prepare_one(q.tables + (size_t)i * subvectors * 256, subvectors, precision, new_plan(prepared, subvectors, i));
}

struct Accumulators { __m512i even[8], odd[8]; };  // of two groups
static size_t scratch_bytes(uint32_t) { return sizeof(Accumulators) * kPlanes * kQueryTile; }

struct CodeTile {  // of two groups, and what is read after it
  const uint8_t *first, *second, *next_first, *next_second;
};
enum Prefetch { kNothing, kFirst, kSecond };  // one group at a time: more requests at once stall the loop

INLINE __m512i look_up(const __m512i *table, const uint8_t *from) {
  __m512i codes = _mm512_loadu_si512(from);
  __asm__("" : "+v"(codes));  // else GCC loads once for each use, and loads are what the loop waits for
  return _mm512_mask_blend_epi8(_mm512_cmplt_epi8_mask(codes, _mm512_setzero_si512()),
                                _mm512_permutex2var_epi8(table[0], codes, table[1]),
                                _mm512_permutex2var_epi8(table[2], codes, table[3]));
}

template <Prefetch Ahead, bool Packed>
static void accumulate(const BytePlan &plan, Run run, const CodeTile &codes, bool fresh, Accumulators &sums) {
  __m512i even[8], odd[8], bytes[8];
#pragma GCC unroll 8
  for (int b = 0; b < 8; b++) even[b] = odd[b] = bytes[b] = _mm512_setzero_si512();
  if (!fresh) {
#pragma GCC unroll 8
    for (int b = 0; b < 8; b++) even[b] = sums.even[b], odd[b] = sums.odd[b];
  }
  const __m512i second = _mm512_set1_epi16(1 << 8);  // as pairs of bytes: takes the odd one of two rows
  for (uint32_t s = run.begin; s < run.end; s++) {
    const uint8_t *entries = plan.tables + 256 * (size_t)s;
    const __m512i table[4] = {_mm512_loadu_si512(entries), _mm512_loadu_si512(entries + 64),
                              _mm512_loadu_si512(entries + 128), _mm512_loadu_si512(entries + 192)};
    const size_t at = (size_t)plan.steps[s].in_tile * 256;
#pragma GCC unroll 8
    for (int b = 0; b < 8; b++) {
      const size_t offset = at + (b & 3) * 64;
      if (Ahead == kFirst && b < 4) _mm_prefetch((const char *)codes.next_first + offset, _MM_HINT_T1);
      if (Ahead == kSecond && b >= 4) _mm_prefetch((const char *)codes.next_second + offset, _MM_HINT_T1);
      const __m512i found = look_up(table, (b < 4 ? codes.first : codes.second) + offset);
      if (Packed) {
        bytes[b] = _mm512_add_epi8(bytes[b], found);
      } else {
        even[b] = _mm512_add_epi16(even[b], found);
        odd[b] = _mm512_add_epi16(odd[b], _mm512_maddubs_epi16(found, second));
      }
    }
    if (Packed && plan.steps[s].flush) {
#pragma GCC unroll 8
      for (int b = 0; b < 8; b++) {
        even[b] = _mm512_add_epi16(even[b], bytes[b]);
        odd[b] = _mm512_add_epi16(odd[b], _mm512_srli_epi16(bytes[b], 8));
        bytes[b] = _mm512_setzero_si512();
      }
    }
  }
#pragma GCC unroll 8
  for (int b = 0; b < 8; b++) sums.even[b] = even[b], sums.odd[b] = odd[b];
}

template <Prefetch Ahead>
INLINE void accumulate_run(const BytePlan &plan, const Run &run, const CodeTile &codes, bool fresh,
                           Accumulators &sums) {
  if (run.packed) accumulate<Ahead, true>(plan, run, codes, fresh, sums);
  else accumulate<Ahead, false>(plan, run, codes, fresh, sums);
}

INLINE __m512 widened(__m256i v) { return _mm512_cvtepi32_ps(_mm512_cvtepu16_epi32(v)); }

// Sums of 64 rows, in their order.
INLINE void unpack(__m512i even, __m512i odd, __m512 *rows) {
  const __m512i low = _mm512_set_epi16(47, 15, 46, 14, 45, 13, 44, 12, 43, 11, 42, 10, 41, 9, 40, 8, 39, 7, 38, 6, 37,
                                       5, 36, 4, 35, 3, 34, 2, 33, 1, 32, 0);
  const __m512i high = _mm512_set_epi16(63, 31, 62, 30, 61, 29, 60, 28, 59, 27, 58, 26, 57, 25, 56, 24, 55, 23, 54, 22,
                                        53, 21, 52, 20, 51, 19, 50, 18, 49, 17, 48, 16);
  even = _mm512_sub_epi16(even, _mm512_slli_epi16(odd, 8));
  const __m512i a = _mm512_permutex2var_epi16(even, low, odd), b = _mm512_permutex2var_epi16(even, high, odd);
  rows[0] = widened(_mm512_castsi512_si256(a)), rows[1] = widened(_mm512_extracti64x4_epi64(a, 1));
  rows[2] = widened(_mm512_castsi512_si256(b)), rows[3] = widened(_mm512_extracti64x4_epi64(b, 1));
}

// out = bias + step * sum over planes; after the first chunk, out += step * sum.
static void emit(const BytePlan &plan, const Accumulators *totals, bool first_chunk, float *out) {
  const __m512 step = _mm512_set1_ps(plan.scale.step), bias = _mm512_set1_ps(plan.scale.bias);
  for (int b = 0; b < 8; b++) {
    __m512 sum[4];
    unpack(totals[0].even[b], totals[0].odd[b], sum);
    for (uint32_t plane = 1; plane < plan.planes; plane++) {
      __m512 rows[4];
      unpack(totals[plane].even[b], totals[plane].odd[b], rows);
      for (int i = 0; i < 4; i++) sum[i] = _mm512_fmadd_ps(rows[i], _mm512_set1_ps(plan.weights[plane]), sum[i]);
    }
    for (int i = 0; i < 4; i++) {
      float *at = out + 64 * b + 16 * i;
      _mm512_storeu_ps(at, _mm512_fmadd_ps(sum[i], step, first_chunk ? bias : _mm512_loadu_ps(at)));
    }
  }
}

static void sums(const GroupedRows &rows, uint32_t, const void *prepared, uint32_t begin, uint32_t end,
                 uint64_t first_row, void *scratch, float *out) {
  const uint32_t subvectors = rows.subvectors, tiles = tiles_of(subvectors);
  const size_t group_bytes = (size_t)subvectors * kGroupRows;
  const uint64_t groups = (rows.rows + kGroupRows - 1) / kGroupRows, group = first_row / kGroupRows;
  const uint8_t *first = rows.codes + group * group_bytes, *second = group + 1 < groups ? first + group_bytes : first;
  const size_t ahead = group + 3 < groups ? 2 * group_bytes : 0;  // the next pair: nearer comes too late
  Accumulators(*totals)[kPlanes] = (Accumulators(*)[kPlanes])scratch;
  if (begin == 0)  // into the L2 cache, before the codes take all requests: `finish` would wait for each line
    for (uint32_t i = 0; i < kPairRows; i += 16)
      _mm_prefetch((const char *)(rows.inverse_norms + first_row + kPairRows + i), _MM_HINT_T1);
  for (uint32_t tile = 0; tile < tiles; tile++) {
    const size_t at = (size_t)tile * kTile * 256;
    const bool fresh = tile % (kChunk / kTile) == 0, last = tile + 1 == tiles || (tile + 1) % (kChunk / kTile) == 0;
    const CodeTile codes = {first + at, second + at, first + at + ahead, second + at + ahead};
    for (uint32_t q = begin; q < end; q++) {
      const BytePlan &plan = plan_at(prepared, subvectors, q);
      Accumulators *total = totals[q - begin];
      for (uint32_t plane = 0; plane < plan.planes; plane++) {
        const Run &run = plan.runs[tile * kPlanes + plane];
        if (q == begin && plane == 0) accumulate_run<kFirst>(plan, run, codes, fresh, total[plane]);
        else if (end - begin == 1 ? plane == 1 : q == begin + 1 && plane == 0)
          accumulate_run<kSecond>(plan, run, codes, fresh, total[plane]);
        else if (fresh || run.begin < run.end) accumulate_run<kNothing>(plan, run, codes, fresh, total[plane]);
      }
      if (last) emit(plan, total, tile < kChunk / kTile, out + (q - begin) * kPairRows);
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
