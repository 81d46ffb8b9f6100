// Look-ups in tables of bytes (AVX-512 VBMI): 64 codes in two vpermi2b.
//
// The digits of an entry, counted in steps (scan_steps.h), are summed apart, as planes of bytes: the lowest digit to
// base 128 or 256, the others to base 256. Bytes of several sub-vectors are added as bytes while they fit, then widened
// to 16 bits, where bits 8-15 count the odd rows too; these are also summed apart, and taken out at the end.
// Source: Andre et al. 2015, 2017 (PQ Fast Scan, Quick ADC) for sums in small integers of shuffled tables;
// tables of all 256 entries in registers, and planes, are ours.

constexpr uint32_t kPlanes = 3;
#pragma once
#include "kernels/isa.h"
#include "kernels/scan_kernels.h"
#include "kernels/scan_steps.h"

namespace drsplat::DRSPLAT_ISA {

constexpr uint32_t kTile = 32;  // sub-vectors whose codes stay in the L1 cache
constexpr uint32_t kTilesPerChunk = kChunk / kTile;

struct Step {         // one table of 256 bytes
  uint16_t in_chunk;  // its sub-vector
  uint16_t flush;     // widen the bytes after it
};
struct Run {                     // the steps of one tile and plane, or of a chunk where they are few
  uint32_t begin, singles, end;  // groups that fit a byte together, then those that do not
  bool fresh;                    // the first of its chunk and plane
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

// How many steps above the lowest the highest entry of a table is.
INLINE uint32_t steps_of(Range range, float per_step) {
  const __m128 steps = _mm_fmadd_ss(_mm_set_ss(range.width), _mm_set_ss(per_step), _mm_set_ss(0.5f));
  return (uint32_t)_mm_cvttss_si32(steps);
}

// Groups of tables that fit a byte together, as few as first fit finds from the largest on. Tables in `order`, groups
// of many first; `flush` after the last of each.
static void group_tables(const uint32_t *largest, uint32_t count, uint32_t *order, bool *flush, Run &run) {
  uint32_t sorted[kTile], group[kTile], held[kTile] = {}, size[kTile] = {};
  for (uint32_t i = 0; i < count; i++) {
    uint32_t at = i;
    for (; at > 0 && largest[sorted[at - 1]] < largest[i]; at--) sorted[at] = sorted[at - 1];
    sorted[at] = i;
  }
  for (uint32_t i = 0; i < count; i++) {
    uint32_t g = 0;
    while (held[g] + largest[sorted[i]] > 255) g++;
    held[g] += largest[sorted[i]], size[g]++, group[i] = g;
  }
  uint32_t at = 0;
  const auto add_groups = [&](uint32_t least, uint32_t most) {
    for (uint32_t g = 0; g < count && size[g]; g++) {
      if (size[g] < least || size[g] > most) continue;
      for (uint32_t i = 0; i < count; i++)
        if (group[i] == g) flush[at] = false, order[at++] = sorted[i];
      flush[at - 1] = true;
    }
    return run.begin + at;
  };
  run.singles = add_groups(2, kTile), run.end = add_groups(1, 1);
}

// The steps of the sub-vectors [first, last) of a chunk, at most kTile, that have this digit.
static void plan_run(BytePlan &plan, const float *tables, uint32_t chunk, uint32_t first, uint32_t last, int shift,
                     uint32_t mask, Run &run) {
  const float per_step = 1.f / plan.scale.step;
  uint8_t digits[kTile][256];
  uint32_t largest[kTile], order[kTile], subvectors[kTile], count = 0;
  bool flush[kTile];
  for (uint32_t m = first; m < last; m++) {
    if (!(steps_of(plan.ranges[m], per_step) >> shift)) continue;
    largest[count] = digits_of(tables + 256 * (size_t)m, plan.ranges[m].low, per_step, shift, mask, digits[count]);
    subvectors[count++] = m - chunk;
  }
  group_tables(largest, count, order, flush, run);
  for (uint32_t i = 0; i < count; i++) {
    plan.steps[run.begin + i] = {(uint16_t)subvectors[order[i]], flush[i]};
    memcpy(plan.tables + 256 * (size_t)(run.begin + i), digits[order[i]], 256);
  }
}

// Whether no more than kTile sub-vectors of [first, last) have this digit: one run holds them all.
static bool is_sparse(const BytePlan &plan, uint32_t first, uint32_t last, int shift) {
  const float per_step = 1.f / plan.scale.step;
  uint32_t count = 0;
  for (uint32_t m = first; m < last; m++) count += steps_of(plan.ranges[m], per_step) >> shift > 0;
  return count <= kTile;
}

static void prepare_one(const float *tables, uint32_t subvectors, Precision precision, BytePlan &plan) {
  plan.scale = scale_of(tables, subvectors, precision, plan.ranges), plan.planes = 1;
  const int lowest = precision.wide ? 8 : 7;  // bits; pairs of 7 fit a byte
  const int shifts[kPlanes] = {0, lowest, lowest + 8};
  const uint32_t masks[kPlanes] = {(1u << lowest) - 1, 255, 255};
  uint32_t at = 0;
  for (uint32_t chunk = 0; chunk < subvectors; chunk += kChunk) {
    const uint32_t chunk_end = chunk + kChunk < subvectors ? chunk + kChunk : subvectors;
    for (uint32_t plane = 0; plane < kPlanes; plane++) {
      const bool sparse = plane > 0 && is_sparse(plan, chunk, chunk_end, shifts[plane]);
      const uint32_t first_step = at;
      for (uint32_t first = chunk; first < chunk_end; first += kTile) {
        const uint32_t last = first + kTile < chunk_end ? first + kTile : chunk_end;
        Run &run = plan.runs[first / kTile * kPlanes + plane];
        run.begin = at, run.fresh = at == first_step;
        const uint32_t from = !sparse ? first : last < chunk_end ? last : chunk;
        plan_run(plan, tables, chunk, from, last, shifts[plane], masks[plane], run);
        at = run.end;
      }
      if (at > first_step && plan.planes <= plane) plan.planes = plane + 1;
      plan.weights[plane] = (float)(1 << shifts[plane]);
    }
  }
}

static void prepare(const QueryTables &q, uint32_t subvectors, Precision precision, uint32_t begin, uint32_t end,
                    void *prepared) {
  for (uint32_t i = begin; i < end; i++)
    prepare_one(q.tables + (size_t)i * subvectors * 256, subvectors, precision, new_plan(prepared, subvectors, i));
}

struct Accumulators { __m512i even[8], odd[8]; };  // of two groups
static size_t scratch_bytes(uint32_t) { return sizeof(Accumulators) * kPlanes * kQueryTile; }

struct CodeTile {  // a chunk of two groups, and the tile that is read after theirs
  const uint8_t *first, *second, *next_first, *next_second, *next_lines;
};
// One group at a time, and of many queries' each an eighth of both: more requests at once stall the loop.
enum Prefetch { kNothing, kFirst, kSecond, kEighth };

template <Prefetch Ahead>
INLINE void fetch(const CodeTile &codes, uint32_t step) {
  const size_t at = 256 * (size_t)step;  // in their order, whatever that of the steps
  if (Ahead == kEighth) _mm_prefetch((const char *)codes.next_lines + 64 * (size_t)step, _MM_HINT_T0);
#pragma GCC unroll 4
  for (int b = 0; b < 4; b++) {
    if (Ahead == kFirst) _mm_prefetch((const char *)codes.next_first + at + 64 * b, _MM_HINT_T0);
    if (Ahead == kSecond) _mm_prefetch((const char *)codes.next_second + at + 64 * b, _MM_HINT_T0);
  }
}

struct Table { __m512i quarters[4]; };
INLINE Table table_of(const BytePlan &plan, uint32_t step) {
  const uint8_t *entries = plan.tables + 256 * (size_t)step;
  return {{_mm512_loadu_si512(entries), _mm512_loadu_si512(entries + 64), _mm512_loadu_si512(entries + 128),
           _mm512_loadu_si512(entries + 192)}};
}

// In the codes of 64 rows, block b of eight.
INLINE __m512i look_up(const Table &table, const CodeTile &tile, size_t at, int b) {
  __m512i codes = _mm512_loadu_si512((b < 4 ? tile.first : tile.second) + at + (b & 3) * 64);
  __asm__("" : "+v"(codes));  // else GCC loads once for each use, and loads are what the loop waits for
  return _mm512_mask_blend_epi8(_mm512_cmplt_epi8_mask(codes, _mm512_setzero_si512()),
                                _mm512_permutex2var_epi8(table.quarters[0], codes, table.quarters[1]),
                                _mm512_permutex2var_epi8(table.quarters[2], codes, table.quarters[3]));
}

INLINE void widen(__m512i bytes, __m512i &even, __m512i &odd) {
  even = _mm512_add_epi16(even, bytes), odd = _mm512_add_epi16(odd, _mm512_srli_epi16(bytes, 8));
}

// The part of a run whose tables fit a byte with others.
template <Prefetch Ahead>
INLINE void add_groups(const BytePlan &plan, const Run &run, const CodeTile &codes, __m512i *even, __m512i *odd) {
  __m512i bytes[8];
#pragma GCC unroll 8
  for (int b = 0; b < 8; b++) bytes[b] = _mm512_setzero_si512();
  for (uint32_t s = run.begin; s < run.singles; s++) {
    const Table table = table_of(plan, s);
    const size_t at = (size_t)plan.steps[s].in_chunk * 256;
    fetch<Ahead>(codes, s - run.begin);
#pragma GCC unroll 8
    for (int b = 0; b < 8; b++) bytes[b] = _mm512_add_epi8(bytes[b], look_up(table, codes, at, b));
    if (!plan.steps[s].flush) continue;
#pragma GCC unroll 8
    for (int b = 0; b < 8; b++) widen(bytes[b], even[b], odd[b]), bytes[b] = _mm512_setzero_si512();
  }
}

template <Prefetch Ahead>
static void accumulate(const BytePlan &plan, const Run &run, const CodeTile &codes, Accumulators &sums) {
  __m512i even[8], odd[8];
#pragma GCC unroll 8
  for (int b = 0; b < 8; b++) even[b] = odd[b] = _mm512_setzero_si512();
  if (!run.fresh) {
#pragma GCC unroll 8
    for (int b = 0; b < 8; b++) even[b] = sums.even[b], odd[b] = sums.odd[b];
  }
  if (run.begin < run.singles) add_groups<Ahead>(plan, run, codes, even, odd);
  for (uint32_t s = run.singles; s < run.end; s++) {
    const Table table = table_of(plan, s);
    const size_t at = (size_t)plan.steps[s].in_chunk * 256;
    fetch<Ahead>(codes, s - run.begin);
#pragma GCC unroll 8
    for (int b = 0; b < 8; b++) widen(look_up(table, codes, at, b), even[b], odd[b]);
  }
#pragma GCC unroll 8
  for (int b = 0; b < 8; b++) sums.even[b] = even[b], sums.odd[b] = odd[b];
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

INLINE Prefetch prefetch_of(uint32_t query, uint32_t queries, uint32_t plane) {
  if (queries == 8) return plane == 0 ? kEighth : kNothing;
  if (query == 0 && plane == 0) return kFirst;
  return queries == 1 ? (plane == 1 ? kSecond : kNothing) : query == 1 && plane == 0 ? kSecond : kNothing;
}

static void sums(const GroupedRows &rows, uint32_t, const void *prepared, uint32_t begin, uint32_t end,
                 uint64_t first_row, void *scratch, float *out) {
  const uint32_t subvectors = rows.subvectors, tiles = tiles_of(subvectors);
  const size_t group_bytes = (size_t)subvectors * kGroupRows;
  const uint64_t groups = (rows.rows + kGroupRows - 1) / kGroupRows, group = first_row / kGroupRows;
  const uint8_t *first = rows.codes + group * group_bytes, *second = group + 1 < groups ? first + group_bytes : first;
  const size_t to_next = group + 3 < groups ? 2 * group_bytes : 0;  // the next pair: nearer comes too late
  Accumulators(*totals)[kPlanes] = (Accumulators(*)[kPlanes])scratch;
  if (begin == 0)  // before the codes take all requests: `finish` would wait for each line
    for (uint32_t i = 0; i < kPairRows; i += 16)
      _mm_prefetch((const char *)(rows.inverse_norms + first_row + kPairRows + i), _MM_HINT_T0);
  for (uint32_t tile = 0; tile < tiles; tile++) {
    const bool last = tile + 1 == tiles || (tile + 1) % kTilesPerChunk == 0;
    const size_t at = (size_t)tile / kTilesPerChunk * kChunk * 256, next = (size_t)tile * kTile * 256 + to_next;
    CodeTile codes = {first + at, second + at, first + next, second + next, nullptr};
    for (uint32_t q = begin; q < end; q++) {
      const BytePlan &plan = plan_at(prepared, subvectors, q);
      Accumulators *total = totals[q - begin];
      codes.next_lines = (q - begin < 4 ? codes.next_first : codes.next_second) + kTile * 64 * ((q - begin) % 4);
      for (uint32_t plane = 0; plane < plan.planes; plane++) {
        const Run &run = plan.runs[tile * kPlanes + plane];
        const Prefetch ahead = prefetch_of(q - begin, end - begin, plane);
        if (ahead == kFirst) accumulate<kFirst>(plan, run, codes, total[plane]);
        else if (ahead == kSecond) accumulate<kSecond>(plan, run, codes, total[plane]);
        else if (ahead == kEighth) accumulate<kEighth>(plan, run, codes, total[plane]);
        else if (run.begin < run.end || (last && run.fresh)) accumulate<kNothing>(plan, run, codes, total[plane]);
      }
      if (last) emit(plan, total, tile < kTilesPerChunk, out + (q - begin) * kPairRows);
    }
  }
}

}  // namespace drsplat::DRSPLAT_ISA
