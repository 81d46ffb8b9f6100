// Look-ups in tables of bytes (AVX-512 VBMI): 64 codes in two vpermi2b.
//
// The digits of an entry, counted in steps (scan_steps.h), are summed apart, as planes of bytes: the lowest digit to
// base 128 or 256, the others to base 256. Two planes that nearly all sub-vectors have are looked up together, since
// they need the codes and the half of a table that each is in once: the two lower ones of a query or, where one byte is
// enough, the lowest of two queries. What few sub-vectors have beyond that is looked up alone.
// Bytes of several sub-vectors are added as bytes while they fit, then widened to 16 bits, where bits 8-15 count the
// odd rows too; these are also summed apart, and taken out at the end. Source: Andre et al. 2015, 2017 (PQ Fast Scan,
// Quick ADC) for sums in small integers of shuffled tables; tables of all 256 entries in registers, and planes, are
// ours.
#pragma once
#include "kernels/isa.h"
#include "kernels/scan_kernels.h"
#include "kernels/scan_steps.h"

namespace drsplat::DRSPLAT_ISA {

constexpr uint32_t kPlanes = 3;
constexpr uint32_t kTile = 32;  // sub-vectors whose tables of two planes stay in the L1 cache, for all groups
constexpr uint32_t kTilesPerChunk = kChunk / kTile;
constexpr uint32_t kGroups = kSumRows / kGroupRows;
constexpr uint32_t kPairBytes = 2 * 256;

struct Run { uint32_t begin, end; };  // look-ups of one plane in one chunk
struct Step {
  uint16_t subvector, flush;  // widen the bytes after it
};

struct BytePlan {  // of one query; pointers are set by `plan_at`
  Scale scale;
  float weights[kPlanes];
  uint32_t planes;   // in use
  uint32_t paired;   // planes that are looked up in pairs: both, or the lowest with that of the next query
  Range *ranges;     // of each sub-vector
  Run *runs;         // chunks x kPlanes: those that are looked up alone
  Step *alone;       // up to two for each sub-vector
  uint8_t *flushes;  // of each sub-vector: 1 and 2, to widen the bytes of the first and the second plane after it
  uint8_t *pairs;    // two tables for each sub-vector
  uint8_t *tables;   // of `alone`
};

INLINE uint32_t tiles_of(uint32_t subvectors) { return (subvectors + kTile - 1) / kTile; }
INLINE size_t rounded(size_t bytes) { return (bytes + 63) / 64 * 64; }
INLINE size_t run_bytes(uint32_t subvectors) {
  return rounded((subvectors + kChunk - 1) / kChunk * kPlanes * sizeof(Run));
}
INLINE size_t alone_bytes(uint32_t subvectors) { return rounded((size_t)subvectors * 2 * sizeof(Step)); }
INLINE size_t range_bytes(uint32_t subvectors) { return rounded(subvectors * sizeof(Range)); }
INLINE size_t plan_bytes(uint32_t subvectors) {
  return rounded(sizeof(BytePlan)) + range_bytes(subvectors) + run_bytes(subvectors) + alone_bytes(subvectors) +
         rounded(subvectors) + (size_t)subvectors * 2 * kPairBytes;
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
  plan.alone = (Step *)p, p += alone_bytes(subvectors);
  plan.flushes = (uint8_t *)p, p += rounded(subvectors);
  plan.pairs = (uint8_t *)p, p += (size_t)subvectors * kPairBytes;
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

// One plane of all sub-vectors as the first or second of the pairs; 2 bits for each say where it is flushed.
static void plan_paired(const BytePlan &plan, const float *tables, uint32_t subvectors, int shift, uint32_t mask,
                        uint32_t slot, BytePlan &pair) {
  const float per_step = 1.f / plan.scale.step;
  uint32_t held = 0;
  for (uint32_t m = 0; m < subvectors; m++) {
    uint8_t *to = pair.pairs + kPairBytes * (size_t)m + 256 * slot;
    const uint32_t largest = digits_of(tables + 256 * (size_t)m, plan.ranges[m].low, per_step, shift, mask, to);
    held += largest;
    if (held > 255 && m % kTile) pair.flushes[m - 1] |= 1u << slot, held = largest;
    if (m % kTile == kTile - 1 || m + 1 == subvectors) pair.flushes[m] |= 1u << slot, held = 0;
  }
}

// One plane of the sub-vectors that have it, beginning at look-up `at`; returns where it ends.
static uint32_t plan_alone(BytePlan &plan, const float *tables, uint32_t subvectors, int shift, uint32_t mask,
                           uint32_t plane, uint32_t at) {
  const float per_step = 1.f / plan.scale.step;
  for (uint32_t chunk = 0; chunk < subvectors; chunk += kChunk) {
    Run &run = plan.runs[chunk / kChunk * kPlanes + plane];
    run.begin = at;
    uint32_t held = 0;
    for (uint32_t m = chunk; m < subvectors && m < chunk + kChunk; m++) {
      if (!(steps_of(plan.ranges[m], per_step) >> shift)) continue;
      uint8_t *to = plan.tables + 256 * (size_t)at;
      const uint32_t largest = digits_of(tables + 256 * (size_t)m, plan.ranges[m].low, per_step, shift, mask, to);
      held += largest;
      if (held > 255 && at > run.begin) plan.alone[at - 1].flush = 1, held = largest;
      plan.alone[at++] = {(uint16_t)m, 0}, plan.planes = plane + 1;
    }
    if (at > run.begin) plan.alone[at - 1].flush = 1;
    run.end = at;
  }
  return at;
}

static void prepare_one(const float *tables, uint32_t subvectors, Precision precision, uint32_t slot, BytePlan &plan,
                        BytePlan &pair) {
  const int lowest = precision.wide ? 8 : 7;  // bits; pairs of 7 fit a byte
  const int shifts[kPlanes] = {0, lowest, lowest + 8};
  const uint32_t masks[kPlanes] = {(1u << lowest) - 1, 255, 255};
  plan.scale = scale_of(tables, subvectors, precision, plan.ranges);
  plan.planes = plan.paired = precision.wide ? 1 : 2;
  if (slot == 0) memset(pair.flushes, 0, subvectors);
  uint32_t at = 0;
  for (uint32_t plane = 0; plane < kPlanes; plane++) {
    plan.weights[plane] = (float)(1 << shifts[plane]);
    if (plane < plan.paired) plan_paired(plan, tables, subvectors, shifts[plane], masks[plane], slot + plane, pair);
    else at = plan_alone(plan, tables, subvectors, shifts[plane], masks[plane], plane, at);
  }
}

static void prepare(const QueryTables &q, uint32_t subvectors, Precision precision, uint32_t begin, uint32_t end,
                    void *prepared) {
  for (uint32_t i = begin; i < end; i++) {
    const uint32_t slot = precision.wide ? i % 2 : 0;
    BytePlan &plan = new_plan(prepared, subvectors, i), &pair = plan_at(prepared, subvectors, i - slot);
    if (precision.wide && !slot) memset(pair.pairs, 0, (size_t)subvectors * kPairBytes);  // the last may stay alone
    prepare_one(q.tables + (size_t)i * subvectors * 256, subvectors, precision, slot, plan, pair);
  }
}

struct Sums { __m512i even[4], odd[4]; };  // of a group
static size_t scratch_bytes(uint32_t) { return sizeof(Sums) * 2 * kQueryTile * kGroups; }

struct Table { __m512i quarters[4]; };
INLINE Table table_of(const uint8_t *entries) {
  return {{_mm512_loadu_si512(entries), _mm512_loadu_si512(entries + 64), _mm512_loadu_si512(entries + 128),
           _mm512_loadu_si512(entries + 192)}};
}

INLINE __m512i codes_of(const uint8_t *at) {
  __m512i codes = _mm512_loadu_si512(at);
  __asm__("" : "+v"(codes));  // else GCC loads once for each use
  return codes;
}

// In 128 entries. Into the codes' register: else GCC copies the tables instead, for which it has not registers enough.
INLINE __m512i in_half(__m512i lower, __m512i upper, __m512i codes) {
  __asm__("vpermi2b %2, %1, %0" : "+v"(codes) : "v"(lower), "v"(upper));
  return codes;
}

INLINE __m512i look_up(const Table &table, __m512i codes, __mmask64 upper) {
  return _mm512_mask_blend_epi8(upper, in_half(table.quarters[0], table.quarters[1], codes),
                                in_half(table.quarters[2], table.quarters[3], codes));
}

INLINE void widen(__m512i bytes, __m512i &even, __m512i &odd) {
  even = _mm512_add_epi16(even, bytes), odd = _mm512_add_epi16(odd, _mm512_srli_epi16(bytes, 8));
}

// Widened and begun anew.
INLINE void flush(__m512i *bytes, __m512i *even, __m512i *odd) {
#pragma GCC unroll 4
  for (int b = 0; b < 4; b++) widen(bytes[b], even[b], odd[b]), bytes[b] = _mm512_setzero_si512();
}

// The codes of one group in one tile, and those that are fetched meanwhile.
struct CodeTile { const uint8_t *codes, *ahead; };

// Both planes of `count` sub-vectors, added to what was `before`.
template <bool Fetch, bool Whole>
static void add_pairs(const CodeTile &tile, const uint8_t *pairs, const uint8_t *flushes, uint32_t count,
                      const Sums *before, Sums *after) {
  __m512i first[4], second[4], even[4], odd[4], even2[4], odd2[4];
#pragma GCC unroll 4
  for (int b = 0; b < 4; b++) {
    first[b] = second[b] = _mm512_setzero_si512();
    even[b] = before[0].even[b], odd[b] = before[0].odd[b];
    even2[b] = before[1].even[b], odd2[b] = before[1].odd[b];
  }
  for (uint32_t m = 0; m < count; m++) {
    const Table one = table_of(pairs + kPairBytes * m), two = table_of(pairs + kPairBytes * m + 256);
#pragma GCC unroll 4
    for (int b = 0; b < 4; b++) {
      const size_t at = 256 * m + 64 * b;
      if (Fetch) _mm_prefetch((const char *)tile.ahead + at, _MM_HINT_T0);
      const __m512i codes = codes_of(tile.codes + at);
      const __mmask64 upper = _mm512_movepi8_mask(codes);
      if (Whole) {
        widen(look_up(one, codes, upper), even[b], odd[b]), widen(look_up(two, codes, upper), even2[b], odd2[b]);
        continue;
      }
      first[b] = _mm512_add_epi8(first[b], look_up(one, codes, upper));
      second[b] = _mm512_add_epi8(second[b], look_up(two, codes, upper));
    }
    if (Whole) continue;
    if (flushes[m] & 1) flush(first, even, odd);
    if (flushes[m] & 2) flush(second, even2, odd2);
  }
#pragma GCC unroll 4
  for (int b = 0; b < 4; b++) {
    after[0].even[b] = even[b], after[0].odd[b] = odd[b];
    after[1].even[b] = even2[b], after[1].odd[b] = odd2[b];
  }
}

// Those of one plane of a chunk that are looked up alone.
static Sums sum_alone(const BytePlan &plan, Run run, const uint8_t *codes_of_group) {
  __m512i bytes[4], even[4], odd[4];
#pragma GCC unroll 4
  for (int b = 0; b < 4; b++) bytes[b] = even[b] = odd[b] = _mm512_setzero_si512();
  for (uint32_t i = run.begin; i < run.end; i++) {
    const Table table = table_of(plan.tables + 256 * (size_t)i);
#pragma GCC unroll 4
    for (int b = 0; b < 4; b++) {
      const __m512i codes = codes_of(codes_of_group + 256 * (size_t)plan.alone[i].subvector + 64 * b);
      bytes[b] = _mm512_add_epi8(bytes[b], look_up(table, codes, _mm512_movepi8_mask(codes)));
    }
    if (plan.alone[i].flush) flush(bytes, even, odd);
  }
  Sums sums;
#pragma GCC unroll 4
  for (int b = 0; b < 4; b++) sums.even[b] = even[b], sums.odd[b] = odd[b];
  return sums;
}

// Sums of 64 rows, in their order: pairs of those that are 16 rows apart, which a mask and a shift part.
INLINE void unpack(__m512i even, __m512i odd, __m512 *rows) {
  constexpr long long k = 0x0028002000080000, next = 0x0001000100010001;
  const __m512i low = _mm512_setr_epi64(k, k + next, k + 2 * next, k + 3 * next, k + 4 * next, k + 5 * next,
                                        k + 6 * next, k + 7 * next);
  const __m512i high = _mm512_add_epi16(low, _mm512_set1_epi16(16)), mask = _mm512_set1_epi32(0xffff);
  even = _mm512_sub_epi16(even, _mm512_slli_epi16(odd, 8));
  const __m512i a = _mm512_permutex2var_epi16(even, low, odd), b = _mm512_permutex2var_epi16(even, high, odd);
  rows[0] = _mm512_cvtepi32_ps(_mm512_and_si512(a, mask)), rows[1] = _mm512_cvtepi32_ps(_mm512_srli_epi32(a, 16));
  rows[2] = _mm512_cvtepi32_ps(_mm512_and_si512(b, mask)), rows[3] = _mm512_cvtepi32_ps(_mm512_srli_epi32(b, 16));
}

// out = bias + step * sum over planes of a chunk of one group; after the first chunk, out += step * sum.
static void emit(const BytePlan &plan, const Sums *paired, uint32_t chunk, const uint8_t *codes, float *out) {
  const __m512 step = _mm512_set1_ps(plan.scale.step), bias = _mm512_set1_ps(plan.scale.bias);
  Sums alone[kPlanes];
  const Sums *sums[kPlanes];
  for (uint32_t plane = 0; plane < plan.planes; plane++) {
    sums[plane] = plane < plan.paired ? paired + plane : alone + plane;
    if (plane >= plan.paired) alone[plane] = sum_alone(plan, plan.runs[chunk * kPlanes + plane], codes);
  }
  for (int b = 0; b < 4; b++) {
    __m512 sum[4];
    unpack(sums[0]->even[b], sums[0]->odd[b], sum);
    for (uint32_t plane = 1; plane < plan.planes; plane++) {
      __m512 rows[4];
      unpack(sums[plane]->even[b], sums[plane]->odd[b], rows);
      for (int i = 0; i < 4; i++) sum[i] = _mm512_fmadd_ps(rows[i], _mm512_set1_ps(plan.weights[plane]), sum[i]);
    }
    for (int i = 0; i < 4; i++) {
      float *at = out + 64 * b + 16 * i;
      _mm512_storeu_ps(at, _mm512_fmadd_ps(sum[i], step, chunk ? _mm512_loadu_ps(at) : bias));
    }
  }
}

// Some groups, and as many after them unless they are the last: their codes are fetched meanwhile.
struct Walk {
  const uint8_t *codes;
  size_t group_bytes;
  uint32_t subvectors, groups;
  bool last;
};

INLINE CodeTile tile_of(const Walk &walk, uint32_t tile, uint32_t group) {
  const uint8_t *here = walk.codes + group * walk.group_bytes + (size_t)tile * kTile * 256;
  if (walk.last) return {here, here};
  return {here, walk.codes + walk.groups * walk.group_bytes + ((size_t)tile * walk.groups + group) * kTile * 256};
}

alignas(64) static const Sums kNothing[2] = {};

// One tile of all groups.
static void add_tile(const Walk &walk, const BytePlan *const *plans, uint32_t queries, uint32_t tile,
                     Sums (*totals)[kGroups][2]) {
  const uint32_t first = tile * kTile, count = walk.subvectors - first < kTile ? walk.subvectors - first : kTile;
  const bool fresh = tile % kTilesPerChunk == 0;
  for (uint32_t q = 0; q < queries; q += plans[q]->paired == 1 ? 2 : 1) {
    const BytePlan &plan = *plans[q];
    const uint8_t *pairs = plan.pairs + (size_t)first * kPairBytes, *flushes = plan.flushes + first;
    for (uint32_t g = 0; g < walk.groups; g++) {
      Sums *after = totals[q][g];
      const Sums *before = fresh ? kNothing : after;
      const CodeTile codes = tile_of(walk, tile, g);
      if (plan.paired == 1 && q == 0) add_pairs<true, true>(codes, pairs, flushes, count, before, after);
      else if (plan.paired == 1) add_pairs<false, true>(codes, pairs, flushes, count, before, after);
      else if (q == 0) add_pairs<true, false>(codes, pairs, flushes, count, before, after);
      else add_pairs<false, false>(codes, pairs, flushes, count, before, after);
    }
  }
}

static void sum_groups(const Walk &walk, const BytePlan *const *plans, uint32_t queries, const float *norms,
                       Sums (*totals)[kGroups][2], float *out) {
  const uint32_t tiles = tiles_of(walk.subvectors), lines = walk.groups * kGroupRows / 16;
  for (uint32_t tile = 0; tile < tiles; tile++) {
    for (uint32_t i = lines * tile / tiles; norms && i < lines * (tile + 1) / tiles; i++)
      _mm_prefetch((const char *)(norms + 16 * i), _MM_HINT_T0);
    add_tile(walk, plans, queries, tile, totals);
    if (tile + 1 < tiles && (tile + 1) % kTilesPerChunk) continue;
    for (uint32_t q = 0; q < queries; q++)
      for (uint32_t g = 0; g < walk.groups; g++) {
        const Sums *paired = plans[q]->paired == 1 ? &totals[q / 2 * 2][g][q % 2] : totals[q][g];
        emit(*plans[q], paired, tile / kTilesPerChunk, walk.codes + g * walk.group_bytes,
             out + q * kSumRows + g * kGroupRows);
      }
  }
}

static void sums(const GroupedRows &rows, uint32_t, const void *prepared, uint32_t begin, uint32_t end,
                 uint64_t first_row, void *scratch, float *out) {
  const size_t group_bytes = (size_t)rows.subvectors * kGroupRows;
  const uint64_t groups = (rows.rows + kGroupRows - 1) / kGroupRows, first = first_row / kGroupRows;
  // Sums of many queries take more of the cache. Tables of one tile stay there anyway.
  const uint32_t at_once = end - begin > 1 ? kGroups / 4 : tiles_of(rows.subvectors) > 1 ? kGroups : 1;
  const BytePlan *plans[kQueryTile];
  for (uint32_t q = begin; q < end; q++) plans[q - begin] = &plan_at(prepared, rows.subvectors, q);
  for (uint64_t g = first; g < groups && g < first + kGroups; g += at_once) {
    const uint32_t count = groups - g < at_once ? (uint32_t)(groups - g) : at_once;
    const Walk walk = {rows.codes + g * group_bytes, group_bytes, rows.subvectors, count, groups - g < 2 * count};
    const float *norms = begin ? nullptr : rows.inverse_norms + g * kGroupRows;  // which `finish` would wait for
    sum_groups(walk, plans, end - begin, norms, (Sums(*)[kGroups][2])scratch, out + (g - first) * kGroupRows);
  }
}

}  // namespace drsplat::DRSPLAT_ISA
