// The best of many queries for every row: the scores of all queries for its atoms, added up side by side.
#pragma once
#include "kernels/lanes.h"
#include "kernels/mixture_kernels.h"

namespace drsplat::DRSPLAT_ISA {

// kLanes sums at once; they are loaded as twice as many entries.
#if DRSPLAT_AVX512
typedef __m512i Wide;
constexpr uint32_t kLanes = 16;
INLINE Wide wide_load(const int16_t *p) { return _mm512_loadu_si512(p); }
INLINE Wide wide_splat(int32_t x) { return _mm512_set1_epi32(x); }
INLINE Wide wide_larger(Wide a, Wide b) { return _mm512_max_epi32(a, b); }
INLINE Wide wide_smaller(Wide a, Wide b) { return _mm512_min_epi32(a, b); }
INLINE Wide wide_marked(Wide a, int32_t bits, int32_t mark) {
  return _mm512_or_si512(_mm512_slli_epi32(a, (unsigned)bits), wide_splat(mark));
}
// Adds the entries x and y of two atoms with their weights: of the first kLanes queries to low, of the others to high.
INLINE void wide_add(Wide x, Wide y, Wide weights, Wide *low, Wide *high) {
  *low = _mm512_add_epi32(*low, _mm512_madd_epi16(_mm512_unpacklo_epi16(x, y), weights));
  *high = _mm512_add_epi32(*high, _mm512_madd_epi16(_mm512_unpackhi_epi16(x, y), weights));
}
INLINE int32_t wide_largest(Wide a) { return _mm512_reduce_max_epi32(a); }
INLINE uint32_t wide_where(Wide a, int32_t x) { return _mm512_cmpeq_epi32_mask(a, wide_splat(x)); }
INLINE Wide wide_replaced(Wide a, uint32_t lane, Wide b) {
  return _mm512_mask_mov_epi32(a, (__mmask16)(1u << lane), b);
}
#elif defined(__AVX2__)
typedef __m256i Wide;
constexpr uint32_t kLanes = 8;
INLINE Wide wide_load(const int16_t *p) { return _mm256_loadu_si256((const __m256i *)p); }
INLINE Wide wide_splat(int32_t x) { return _mm256_set1_epi32(x); }
INLINE Wide wide_larger(Wide a, Wide b) { return _mm256_max_epi32(a, b); }
INLINE Wide wide_smaller(Wide a, Wide b) { return _mm256_min_epi32(a, b); }
INLINE Wide wide_marked(Wide a, int32_t bits, int32_t mark) {
  return _mm256_or_si256(_mm256_slli_epi32(a, bits), wide_splat(mark));
}
INLINE void wide_add(Wide x, Wide y, Wide weights, Wide *low, Wide *high) {
  *low = _mm256_add_epi32(*low, _mm256_madd_epi16(_mm256_unpacklo_epi16(x, y), weights));
  *high = _mm256_add_epi32(*high, _mm256_madd_epi16(_mm256_unpackhi_epi16(x, y), weights));
}
INLINE int32_t wide_largest(Wide a) {
  __m128i half = _mm_max_epi32(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
  half = _mm_max_epi32(half, _mm_shuffle_epi32(half, 0x4e));
  return _mm_cvtsi128_si32(_mm_max_epi32(half, _mm_shuffle_epi32(half, 0xb1)));
}
INLINE uint32_t wide_where(Wide a, int32_t x) {
  return (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpeq_epi32(a, wide_splat(x))));
}
INLINE Wide wide_replaced(Wide a, uint32_t lane, Wide b) {
  const __m256i there = _mm256_cmpeq_epi32(_mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7), wide_splat((int32_t)lane));
  return _mm256_blendv_epi8(a, b, there);
}
#else
constexpr uint32_t kLanes = 16;
#endif

constexpr int32_t kMarkBits = 4;  // below a sum: how many times kLanes queries come after its own in the tile
constexpr uint32_t kTileQueries = kLanes << kMarkBits;
static_assert(255ll * 32768 * kMostAtoms << kMarkBits < 1ll << 31, "marked sums are whole numbers of 32 bits");

// Where the table keeps the query-th of its queries: two atoms' entries, unpacked, come in the order of queries.
static uint32_t table_place(uint32_t query) {
#if defined(__AVX2__)
  const uint32_t within = query % kLanes;
  return query / (2 * kLanes) * 2 * kLanes + within / 4 * 8 + query % (2 * kLanes) / kLanes * 4 + within % 4;
#else
  return query;
#endif
}

struct TopTwo { int32_t best, second, index; };

INLINE TopTwo unmarked(int32_t best, int32_t second, int32_t lane) {
  constexpr int32_t last = (1 << kMarkBits) - 1;
  return {best >> kMarkBits, second >> kMarkBits, (last - (best & last)) * (int32_t)kLanes + lane};
}

// pairs: weights of two atoms each, in 16 bits. The best and second best of a row, ties to the lowest query.
template <uint32_t Pairs>
INLINE TopTwo top_two(const int16_t *const *entries, const int32_t *pairs, uint32_t count, uint32_t stride) {
  const uint32_t num_pairs = Pairs ? Pairs : count;
  int32_t mark = (1 << kMarkBits) - 1;
#if defined(__AVX2__)
  Wide weights[Pairs ? Pairs : kMostAtoms / 2];
  for (uint32_t k = 0; k < num_pairs; k++) weights[k] = wide_splat(pairs[k]);
  Wide best = wide_splat(INT32_MIN), second = best;
  for (uint32_t q = 0; q < stride; q += 2 * kLanes) {
    Wide sums[2] = {wide_splat(0), wide_splat(0)};
    for (uint32_t k = 0; k < num_pairs; k++)
      wide_add(wide_load(entries[2 * k] + q), wide_load(entries[2 * k + 1] + q), weights[k], &sums[0], &sums[1]);
    for (int half = 0; half < 2; half++, mark--) {
      const Wide marked = wide_marked(sums[half], kMarkBits, mark);
      second = wide_larger(second, wide_smaller(best, marked));
      best = wide_larger(best, marked);
    }
  }
  const int32_t most = wide_largest(best);
  const uint32_t lane = (uint32_t)__builtin_ctz(wide_where(best, most));
  return unmarked(most, wide_largest(wide_replaced(best, lane, second)), (int32_t)lane);
#else
  int32_t best[kLanes], second[kLanes];
  for (uint32_t i = 0; i < kLanes; i++) best[i] = second[i] = INT32_MIN;
  for (uint32_t q = 0; q < stride; q += kLanes, mark--) {
    int32_t sums[kLanes] = {};
    for (uint32_t k = 0; k < 2 * num_pairs; k++) {
      const int16_t *row = entries[k] + q;
      const int16_t weight = (int16_t)(pairs[k / 2] >> k % 2 * 16 & 255);
      for (uint32_t i = 0; i < kLanes; i++) sums[i] += row[i] * weight;
    }
    for (uint32_t i = 0; i < kLanes; i++) {
      const int32_t marked = sums[i] * (1 << kMarkBits) + mark, loser = best[i] < marked ? best[i] : marked;
      second[i] = second[i] < loser ? loser : second[i];
      best[i] = best[i] < marked ? marked : best[i];
    }
  }
  int32_t lane = 0;
  for (uint32_t i = 1; i < kLanes; i++) lane = best[i] > best[lane] ? (int32_t)i : lane;
  int32_t next = second[lane];
  for (int32_t i = 0; i < (int32_t)kLanes; i++) next = i != lane && best[i] > next ? best[i] : next;
  return unmarked(best[lane], next, lane);
#endif
}

template <uint32_t PerRow>
static inline void best_of_rows(const Mixtures &m, const QueryTile &tile, uint64_t begin, uint64_t end,
                                const BestSums &found) {
  const uint32_t per_row = PerRow ? PerRow : m.per_row, num_pairs = (per_row + 1) / 2;
  for (uint64_t row = begin; row < end; row++) {
    const size_t at = row / kMixtureBlock * per_row * kMixtureBlock + row % kMixtureBlock;
    const int16_t *entries[kMostAtoms];
    int32_t weights[kMostAtoms], pairs[kMostAtoms / 2];
    for (uint32_t k = 0; k < per_row; k++) {
      entries[k] = tile.table + (size_t)m.ids[at + k * kMixtureBlock] * tile.stride;
      weights[k] = m.weights[at + k * kMixtureBlock];
    }
    if (per_row % 2) entries[per_row] = entries[0], weights[per_row] = 0;
    for (uint32_t k = 0; k < num_pairs; k++) pairs[k] = weights[2 * k] | weights[2 * k + 1] << 16;
    const TopTwo top = top_two<(PerRow + 1) / 2>(entries, pairs, num_pairs, tile.stride);
    const bool wins = top.best > found.best[row];
    const int32_t loser = wins ? found.best[row] : top.best,
                  other = top.second > found.second[row] ? top.second : found.second[row];
    found.second[row] = loser > other ? loser : other;
    found.best[row] = wins ? top.best : found.best[row];
    found.index[row] = wins ? (int32_t)tile.first + top.index : found.index[row];
  }
}

// The best and second best of a tile of queries for rows [begin, end), merged into those of the tiles before.
// Places of the table without a query hold -32768, which loses against every query.
static void mixture_best(const Mixtures &m, const QueryTile &tile, uint64_t begin, uint64_t end,
                         const BestSums &found) {
  switch (m.per_row) {
    case 2: return best_of_rows<2>(m, tile, begin, end, found);
    case 4: return best_of_rows<4>(m, tile, begin, end, found);
    case 8: return best_of_rows<8>(m, tile, begin, end, found);
    default: return best_of_rows<0>(m, tile, begin, end, found);
  }
}

}  // namespace drsplat::DRSPLAT_ISA
