// The mixture code: a feature as a few atoms of a dictionary with weights. Choosing the atoms by orthogonal
// least squares, and scans that look up the score of each atom.
#pragma once

// <atom, x> for Rows atoms of signed bytes and whole numbers x: exact, whatever the order of additions.
template <int Rows>
static inline void whole_products(const int8_t *const *rows, const int16_t *x, uint32_t dim, int32_t *products) {
  uint32_t d = 0;
#if DRSPLAT_AVX512
  __m512i total[Rows];
  for (int r = 0; r < Rows; r++) total[r] = _mm512_setzero_si512();
  for (; d + 32 <= dim; d += 32) {
    const __m512i numbers = _mm512_loadu_si512(x + d);
    for (int r = 0; r < Rows; r++) {
      const __m512i values = _mm512_cvtepi8_epi16(_mm256_loadu_si256((const __m256i *)(rows[r] + d)));
      total[r] = _mm512_add_epi32(total[r], _mm512_madd_epi16(values, numbers));
    }
  }
  for (int r = 0; r < Rows; r++) products[r] = _mm512_reduce_add_epi32(total[r]);
#elif defined(__AVX2__)
  __m256i total[Rows];
  for (int r = 0; r < Rows; r++) total[r] = _mm256_setzero_si256();
  for (; d + 16 <= dim; d += 16) {
    const __m256i numbers = _mm256_loadu_si256((const __m256i *)(x + d));
    for (int r = 0; r < Rows; r++) {
      const __m256i values = _mm256_cvtepi8_epi16(_mm_loadu_si128((const __m128i *)(rows[r] + d)));
      total[r] = _mm256_add_epi32(total[r], _mm256_madd_epi16(values, numbers));
    }
  }
  for (int r = 0; r < Rows; r++) {
    __m128i half = _mm_add_epi32(_mm256_castsi256_si128(total[r]), _mm256_extracti128_si256(total[r], 1));
    half = _mm_add_epi32(half, _mm_shuffle_epi32(half, 0x4e));
    products[r] = _mm_cvtsi128_si32(_mm_add_epi32(half, _mm_shuffle_epi32(half, 0xb1)));
  }
#else
  for (int r = 0; r < Rows; r++) products[r] = 0;
#endif
  for (int r = 0; r < Rows; r++) {
    int32_t rest = 0;
    for (uint32_t i = d; i < dim; i++) rest += (int32_t)rows[r][i] * x[i];
    products[r] += rest;
  }
}

// Whole numbers for a vector, and what they are to be multiplied by: as many digits as sums of products with an
// atom can hold, by Cauchy-Schwarz for any part of such a sum too.
static float whole_vector(const float *x, uint32_t dim, int16_t *whole) {
  float largest = 0, squared = 0;
  for (uint32_t d = 0; d < dim; d++) {
    const float size = __builtin_fabsf(x[d]);
    largest = size > largest ? size : largest;
    squared += x[d] * x[d];
  }
  const float room = 0.98f * 2147483648.f / (127 * __builtin_sqrtf((float)dim) * __builtin_sqrtf(squared)) - 1;
  const float factor = !(largest > 0) ? 0.f : room < 32767 / largest ? room : 32767 / largest;
  for (uint32_t d = 0; d < dim; d++) whole[d] = (int16_t)(int32_t)(x[d] * factor + (x[d] < 0 ? -0.5f : 0.5f));
  return factor > 0 ? 1 / factor : 0.f;
}

// step * <atom, x> of some atoms.
static void atom_products(const Atoms &atoms, const int32_t *ids, size_t count, const int16_t *x, float step, float *products) {
  const int8_t *rows[4];
  for (size_t i = 0; i < count; i += 4) {
    for (size_t r = 0; r < 4; r++) rows[r] = atoms.values + (size_t)ids[i + r < count ? i + r : i] * atoms.dim;
    int32_t whole[4];
    whole_products<4>(rows, x, atoms.dim, whole);
    for (size_t r = 0; r < 4 && i + r < count; r++) products[i + r] = (float)whole[r] * (atoms.scales[ids[i + r]] * step);
  }
}

// One row while its atoms are chosen. Arrays of `stride` numbers, one per candidate, unless said otherwise.
struct Pursuit {
  const int32_t *candidates;
  size_t count, stride;
  float *targets;  // <candidate, feature>
  float *left;     // the same, of what the chosen atoms leave over of the feature
  float *norms;    // squared norm of what they leave over of the candidate
  float *barred;   // 1: is not to be chosen
  float *gram;     // a row for each chosen atom and a spare one: <candidate, chosen atom>
  float *basis;    // a row for each chosen atom: <candidate, that atom orthonormalised>
  float *spare;
  int16_t *whole;  // dim numbers: the feature or an atom
  int chosen;
  size_t places[kMostAtoms];  // of the chosen among the candidates
  float levels[kMostAtoms];   // <orthonormalised chosen atom, feature>
};

constexpr float kDependent = 1e-4f;  // an atom adds nothing if its squared sine to the chosen ones is below
constexpr float kLeastGain = 1e-8f;  // of the feature's squared norm

// Orthonormalises the t-th chosen atom and takes it out of what is left.
static void extend_basis(Pursuit &p, int t) {
  const size_t place = p.places[t];
  const float inverse = 1 / __builtin_sqrtf(p.norms[place]), level = p.left[place] * inverse;
  const float *gram = p.gram + t * p.stride;
  float *basis = p.basis + t * p.stride;
  float known[kMostAtoms];
  for (int u = 0; u < t; u++) known[u] = p.basis[u * p.stride + place];
  for (size_t i = 0; i < p.stride; i += 16) {
    Floats part = load(gram + i);
    for (int u = 0; u < t; u++) part = part - known[u] * load(p.basis + u * p.stride + i);
    part = inverse * part;
    store(basis + i, part);
    store(p.left + i, load(p.left + i) - level * part);
    store(p.norms + i, load(p.norms + i) - part * part);
  }
  p.levels[t] = level;
}

static void rebuild_basis(Pursuit &p) {
  memcpy(p.left, p.targets, p.stride * sizeof(float));
  for (size_t i = 0; i < p.stride; i += 16) store(p.norms + i, splat(1.f));
  for (int t = 0; t < p.chosen; t++) extend_basis(p, t);
}

// The candidate that leaves least over together with the chosen ones; -1 if none points the feature's way.
static int64_t best_candidate(const Pursuit &p) {
  int64_t best = -1;
  float most = kLeastGain;
  for (size_t j = 0; j < p.count; j++) {
    if (!(p.left[j] > 0) || p.norms[j] < kDependent || p.barred[j] != 0) continue;
    const float gain = p.left[j] * p.left[j] / p.norms[j];
    if (gain > most) most = gain, best = (int64_t)j;
  }
  return best;
}

static void append(Pursuit &p, size_t place) {
  p.barred[place] = 1;
  p.places[p.chosen] = place;
  extend_basis(p, p.chosen++);
}

static void choose(Pursuit &p, const Atoms &atoms, size_t place) {
  const int32_t id = p.candidates[place];
  const int8_t *values = atoms.values + (size_t)id * atoms.dim;
  for (uint32_t d = 0; d < atoms.dim; d++) p.whole[d] = values[d];
  atom_products(atoms, p.candidates, p.count, p.whole, atoms.scales[id], p.gram + p.chosen * p.stride);
  append(p, place);
}

// Leaves the t-th chosen atom out; its products stay in the spare row.
static void drop(Pursuit &p, int t) {
  const size_t bytes = p.stride * sizeof(float);
  memcpy(p.spare, p.gram + t * p.stride, bytes);
  for (int u = t; u + 1 < p.chosen; u++) {
    p.places[u] = p.places[u + 1];
    memcpy(p.gram + u * p.stride, p.gram + (u + 1) * p.stride, bytes);
  }
  p.chosen--;
  rebuild_basis(p);
}

// Least squares weights of the chosen atoms, in which the basis is triangular.
static void solve(const Pursuit &p, float *weights) {
  for (int t = p.chosen - 1; t >= 0; t--) {
    float rest = p.levels[t];
    for (int u = t + 1; u < p.chosen; u++) rest -= p.basis[t * p.stride + p.places[u]] * weights[u];
    weights[t] = rest / p.basis[t * p.stride + p.places[t]];
  }
}

static int least_weight(const Pursuit &p, const float *weights) {
  int least = 0;
  for (int t = 1; t < p.chosen; t++)
    if (weights[t] < weights[least]) least = t;
  return least;
}

// Greedily; an atom whose weight falls below zero leaves, and is not asked again.
static void choose_atoms(Pursuit &p, const Atoms &atoms, int wanted, float *weights) {
  for (int tries = 2 * wanted; p.chosen < wanted && tries > 0; tries--) {
    const int64_t place = best_candidate(p);
    if (place < 0) return;
    choose(p, atoms, (size_t)place);
    for (;;) {
      solve(p, weights);
      const int least = least_weight(p, weights);
      if (weights[least] > 0) break;
      drop(p, least);
    }
  }
}

static float explained(const Pursuit &p) {
  float total = 0;
  for (int t = 0; t < p.chosen; t++) total += p.levels[t] * p.levels[t];
  return total;
}

static void put_back(Pursuit &p, size_t place) {
  memcpy(p.gram + p.chosen * p.stride, p.spare, p.stride * sizeof(float));
  append(p, place);
}

// Each chosen atom once gives way to the candidate that fits best without it, where that explains more.
static void exchange_atoms(Pursuit &p, const Atoms &atoms, float *weights) {
  for (int left = p.chosen; left > 0; left--) {
    const float before = explained(p);
    const size_t old = p.places[0];
    drop(p, 0);
    p.barred[old] = 0;
    const int64_t best = best_candidate(p);
    if (best < 0 || (size_t)best == old) {
      put_back(p, old);
      continue;
    }
    choose(p, atoms, (size_t)best);
    solve(p, weights);
    if (explained(p) > before && weights[least_weight(p, weights)] > 0) continue;
    p.chosen--;
    p.barred[best] = 0;
    rebuild_basis(p);
    put_back(p, old);
  }
  solve(p, weights);
}

// Weights as bytes, heaviest first; the scale makes what they decode to a unit vector.
static float quantise(const Pursuit &p, const float *weights, int wanted, int32_t *ids, uint8_t *bytes) {
  int order[kMostAtoms];
  for (int t = 0; t < p.chosen; t++) {
    int at = t;
    for (; at > 0 && weights[order[at - 1]] < weights[t]; at--) order[at] = order[at - 1];
    order[at] = t;
  }
  for (int k = 0; k < wanted; k++) {
    const bool known = k < p.chosen;
    bytes[k] = known ? (uint8_t)(weights[order[k]] / weights[order[0]] * 255 + 0.5f) : 0;
    ids[k] = p.chosen ? p.candidates[p.places[order[known ? k : 0]]] : 0;
  }
  double squared = 0;
  for (int k = 0; k < p.chosen; k++)
    for (int l = 0; l < p.chosen; l++) squared += (double)bytes[k] * bytes[l] * p.gram[order[k] * p.stride + p.places[order[l]]];
  return squared > 0 ? (float)(1 / __builtin_sqrt(squared)) : 0.f;
}

// `scratch`: (5 + 2 * wanted) * n floats, where n is the most candidates of a row in whole sixteens; `candidates`:
// n numbers; `whole`: dim numbers.
static void mixture_encode(const Atoms &atoms, const MixtureSource &source, uint64_t begin, uint64_t end, float *scratch, int32_t *candidates, int16_t *whole, const MixtureRows &out) {
  const int wanted = (int)source.wanted;
  for (uint64_t row = begin; row < end; row++) {
    Pursuit p;
    const size_t own = (size_t)(source.starts[row + 1] - source.starts[row]), further = source.num_further;
    memcpy(candidates, source.columns + source.starts[row], own * sizeof(int32_t));
    memcpy(candidates + own, source.further + row * further, further * sizeof(int32_t));
    p.candidates = candidates, p.count = own + further, p.stride = (p.count + 15) / 16 * 16, p.chosen = 0;
    float *next = scratch;
    float **const arrays[] = {&p.targets, &p.left, &p.norms, &p.barred, &p.spare};
    for (float **array : arrays) *array = next, next += p.stride;
    p.gram = next, next += wanted * p.stride;
    p.basis = next, next += wanted * p.stride;
    p.whole = whole;
    memset(scratch, 0, (size_t)(next - scratch) * sizeof(float));
    const float step = whole_vector(source.features + row * atoms.dim, atoms.dim, whole);
    atom_products(atoms, candidates, p.count, whole, step, p.targets);
    rebuild_basis(p);
    float weights[kMostAtoms] = {};
    choose_atoms(p, atoms, wanted, weights);
    if (p.chosen) exchange_atoms(p, atoms, weights);
    out.scales[row] = quantise(p, weights, wanted, out.ids + row * wanted, out.weights + row * wanted);
  }
}

// The centre of largest inner product with each point, ties to the lowest; one point per lane.
constexpr int kSearchParts = kParts == 1 ? 2 : 1;
constexpr uint32_t kSearchCentres = kParts == 1 ? 8 : 4;  // at once: as many sums as fit the registers

template <int Centres>
static inline void search_centres(const float *points, const float *centres, uint32_t dim, int32_t first, Floats *best, Ints *index) {
  Floats total[Centres][kSearchParts];
  for (int c = 0; c < Centres; c++)
    for (int p = 0; p < kSearchParts; p++) total[c][p] = splat(0.f);
  for (uint32_t d = 0; d < dim; d++) {
    Floats numbers[kSearchParts];
    for (int p = 0; p < kSearchParts; p++) numbers[p] = load(points + 16 * (kSearchParts * d + p));
    for (int c = 0; c < Centres; c++)
      for (int p = 0; p < kSearchParts; p++) total[c][p] = total[c][p] + centres[(size_t)c * dim + d] * numbers[p];
  }
  for (int c = 0; c < Centres; c++)
    for (int p = 0; p < kSearchParts; p++) {
      index[p] = select(best[p] < total[c][p], splat_int(first + c), index[p]);
      best[p] = maximum(best[p], total[c][p]);
    }
}

// `scratch`: kEncodeScratch * dim floats.
static void nearest_centres(const Embeddings &centres, const float *points, uint64_t begin, uint64_t end, float *scratch, int32_t *nearest) {
  constexpr uint64_t rows = 16 * kSearchParts;
  static_assert(rows <= kEncodeScratch, "scratch holds every lane");
  const uint32_t dim = centres.dim;
  for (uint64_t first = begin; first < end; first += rows) {
    const uint64_t left = end - first < rows ? end - first : rows;
    for (uint64_t r = 0; r < rows; r++) {
      const float *point = points + (first + (r < left ? r : left - 1)) * dim;
      for (uint32_t d = 0; d < dim; d++) scratch[d * rows + r] = point[d];
    }
    Floats best[kSearchParts];
    Ints index[kSearchParts];
    for (int p = 0; p < kSearchParts; p++) best[p] = splat(-__builtin_inff()), index[p] = splat_int(0);
    uint32_t c = 0;
    for (; c + kSearchCentres <= centres.count; c += kSearchCentres) search_centres<kSearchCentres>(scratch, centres.values + (size_t)c * dim, dim, (int32_t)c, best, index);
    for (; c < centres.count; c++) search_centres<1>(scratch, centres.values + (size_t)c * dim, dim, (int32_t)c, best, index);
    int32_t found[rows];
    for (int p = 0; p < kSearchParts; p++) store_int(found + 16 * p, index[p]);
    memcpy(nearest + first, found, left * sizeof(int32_t));
  }
}

// The `wanted` members of each point's group with the largest inner products, best first. `products`: a number
// per member; `whole`: dim numbers.
static void nearest_members(const Atoms &atoms, const Groups &groups, const float *points, uint64_t begin, uint64_t end, float *products, int16_t *whole, int32_t *nearest) {
  const uint32_t wanted = groups.wanted;
  for (uint64_t row = begin; row < end; row++) {
    const int32_t *members = groups.members + (size_t)groups.of[row] * groups.size;
    int32_t *found = nearest + row * wanted;
    const float step = whole_vector(points + row * atoms.dim, atoms.dim, whole);
    atom_products(atoms, members, groups.size, whole, step, products);
    uint32_t count = 0;
    float best[kMostWanted];
    for (uint32_t j = 0; j < groups.size; j++) {
      if (count == wanted && !(products[j] > best[count - 1])) continue;
      uint32_t at = count < wanted ? count++ : count - 1;
      for (; at > 0 && best[at - 1] < products[j]; at--) best[at] = best[at - 1], found[at] = found[at - 1];
      best[at] = products[j], found[at] = members[j];
    }
  }
}

// From here on sums are of whole numbers, so that no order of additions, number of queries or instruction set
// changes a bit of a score.

INLINE int16_t table_entry(int32_t product, float factor) {
  const float value = __builtin_rintf((float)product * factor);
  return (int16_t)(value > 32767.f ? 32767.f : value < -32767.f ? -32767.f : value);
}

constexpr uint32_t kAtomsAhead = 16;  // atoms that are fetched before they are asked for

// table[atom][place of query] = cosine * 32767.
static void score_table(const Atoms &atoms, const WholeQueries &queries, uint64_t begin, uint64_t end, int16_t *table) {
  for (uint64_t first = begin; first < end; first += 4) {
    const int count = end - first < 4 ? (int)(end - first) : 4;
    const int8_t *rows[4];
    for (int r = 0; r < 4; r++) rows[r] = atoms.values + (first + (uint64_t)(r < count ? r : 0)) * atoms.dim;
    if (first + kAtomsAhead + 4 <= end)
      for (uint32_t d = 0; d < 4 * atoms.dim; d += 64) __builtin_prefetch(atoms.values + (first + kAtomsAhead) * atoms.dim + d);
    for (uint32_t q = 0; q < queries.count; q++) {
      int32_t products[4];
      whole_products<4>(rows, queries.values + (size_t)q * atoms.dim, atoms.dim, products);
      for (int r = 0; r < count; r++) table[(first + r) * queries.stride + queries.places[q]] = table_entry(products[r], atoms.scales[first + r] * queries.steps[q]);
    }
  }
}

// Scales are half floats; all of them finite and not negative.
INLINE Floats load_halves(const uint16_t *p) {
#if DRSPLAT_AVX512
  return {{(FloatPart)_mm512_cvtph_ps(_mm256_loadu_si256((const __m256i *)p))}};
#else
  int32_t bits[16];
  for (int i = 0; i < 16; i++) bits[i] = (int32_t)p[i] << 13;
  return splat(0x1p112f) * float_of_bits(load_int(bits));
#endif
}

// total[i] = sum over k of weight * table[id], for sixteen rows of a block.
INLINE Ints sixteen_sums(const uint16_t *ids, const uint8_t *weights, uint32_t per_row, const int16_t *table) {
#if DRSPLAT_AVX512
  __m512i total = _mm512_setzero_si512();
  for (uint32_t k = 0; k < per_row; k++, ids += kMixtureBlock, weights += kMixtureBlock) {
    // Each lane holds its entry and the next one; the weight of the next is zero.
    const __m512i entries = _mm512_i32gather_epi32(_mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i *)ids)), table, 2);
    total = _mm512_add_epi32(total, _mm512_madd_epi16(entries, _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i *)weights))));
  }
  return {{(IntPart)total}};
#else
  int32_t total[16] = {};
  for (uint32_t k = 0; k < per_row; k++, ids += kMixtureBlock, weights += kMixtureBlock)
    for (int i = 0; i < 16; i++) total[i] += (int32_t)table[ids[i]] * weights[i];
  return load_int(total);
#endif
}

template <uint32_t PerRow>
static inline void block_scores(const Mixtures &m, uint64_t block, const uint16_t *scales, const int16_t *table, float *scores) {
  const uint32_t per_row = PerRow ? PerRow : m.per_row;
  const uint16_t *ids = m.ids + block * per_row * kMixtureBlock;
  const uint8_t *weights = m.weights + block * per_row * kMixtureBlock;
  for (int i = 0; i < kMixtureBlock; i += 16) {
    const Ints total = sixteen_sums(ids + i, weights + i, per_row, table);
    store(scores + i, to_float(total) * (load_halves(scales + i) * splat(1.f / 32767)));
  }
}

// Scores of rows [begin, end); begin is the first of a block, and so is end unless it is the last row.
static void mixture_scores(const Mixtures &m, const int16_t *table, uint64_t begin, uint64_t end, float *scores) {
  for (uint64_t row = begin; row < end; row += kMixtureBlock, scores += kMixtureBlock) {
    const uint64_t left = end - row;
    if (left < kMixtureBlock) {
      uint16_t scales[kMixtureBlock] = {};
      float last[kMixtureBlock];
      memcpy(scales, m.scales + row, left * sizeof(uint16_t));
      block_scores<0>(m, row / kMixtureBlock, scales, table, last);
      memcpy(scores, last, left * sizeof(float));
      return;
    }
    switch (m.per_row) {
      case 2: block_scores<2>(m, row / kMixtureBlock, m.scales + row, table, scores); break;
      case 4: block_scores<4>(m, row / kMixtureBlock, m.scales + row, table, scores); break;
      case 8: block_scores<8>(m, row / kMixtureBlock, m.scales + row, table, scores); break;
      default: block_scores<0>(m, row / kMixtureBlock, m.scales + row, table, scores);
    }
  }
}

// Which of up to 2^32 rows have score - floor > threshold; returns how many. `out` holds 16 more than there are rows.
static uint32_t rows_above(const float *scores, const float *floor, float threshold, uint32_t count, uint32_t *out) {
  uint32_t found = 0, i = 0;
#if DRSPLAT_AVX512
  __m512i numbers = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  for (; i + 16 <= count; i += 16) {
    __m512 margin = _mm512_loadu_ps(scores + i);
    if (floor) margin = _mm512_sub_ps(margin, _mm512_loadu_ps(floor + i));
    const __mmask16 above = _mm512_cmp_ps_mask(margin, _mm512_set1_ps(threshold), _CMP_GT_OQ);
    _mm512_storeu_si512(out + found, _mm512_maskz_compress_epi32(above, numbers));
    found += (uint32_t)__builtin_popcount(above);
    numbers = _mm512_add_epi32(numbers, _mm512_set1_epi32(16));
  }
#endif
  for (; i < count; i++) {  // without a branch: which rows are above is not to be foreseen
    out[found] = i;
    found += (floor ? scores[i] - floor[i] : scores[i]) > threshold;
  }
  return found;
}

// The best of many queries: the entries of a row's atoms are added up for kLanes queries at once, twice.
#if DRSPLAT_AVX512
typedef __m512i Wide;
constexpr uint32_t kLanes = 16;
INLINE Wide wide_load(const int16_t *p) { return _mm512_loadu_si512(p); }
INLINE Wide wide_splat(int32_t x) { return _mm512_set1_epi32(x); }
INLINE Wide wide_larger(Wide a, Wide b) { return _mm512_max_epi32(a, b); }
INLINE Wide wide_smaller(Wide a, Wide b) { return _mm512_min_epi32(a, b); }
INLINE Wide wide_marked(Wide a, int32_t bits, int32_t mark) { return _mm512_or_si512(_mm512_slli_epi32(a, (unsigned)bits), wide_splat(mark)); }
// Adds the entries x and y of two atoms with their weights: of the first kLanes queries to low, of the others to high.
INLINE void wide_add(Wide x, Wide y, Wide weights, Wide *low, Wide *high) {
  *low = _mm512_add_epi32(*low, _mm512_madd_epi16(_mm512_unpacklo_epi16(x, y), weights));
  *high = _mm512_add_epi32(*high, _mm512_madd_epi16(_mm512_unpackhi_epi16(x, y), weights));
}
INLINE int32_t wide_largest(Wide a) { return _mm512_reduce_max_epi32(a); }
INLINE uint32_t wide_where(Wide a, int32_t x) { return _mm512_cmpeq_epi32_mask(a, wide_splat(x)); }
INLINE Wide wide_replaced(Wide a, uint32_t lane, Wide b) { return _mm512_mask_mov_epi32(a, (__mmask16)(1u << lane), b); }
#elif defined(__AVX2__)
typedef __m256i Wide;
constexpr uint32_t kLanes = 8;
INLINE Wide wide_load(const int16_t *p) { return _mm256_loadu_si256((const __m256i *)p); }
INLINE Wide wide_splat(int32_t x) { return _mm256_set1_epi32(x); }
INLINE Wide wide_larger(Wide a, Wide b) { return _mm256_max_epi32(a, b); }
INLINE Wide wide_smaller(Wide a, Wide b) { return _mm256_min_epi32(a, b); }
INLINE Wide wide_marked(Wide a, int32_t bits, int32_t mark) { return _mm256_or_si256(_mm256_slli_epi32(a, bits), wide_splat(mark)); }
INLINE void wide_add(Wide x, Wide y, Wide weights, Wide *low, Wide *high) {
  *low = _mm256_add_epi32(*low, _mm256_madd_epi16(_mm256_unpacklo_epi16(x, y), weights));
  *high = _mm256_add_epi32(*high, _mm256_madd_epi16(_mm256_unpackhi_epi16(x, y), weights));
}
INLINE int32_t wide_largest(Wide a) {
  __m128i half = _mm_max_epi32(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
  half = _mm_max_epi32(half, _mm_shuffle_epi32(half, 0x4e));
  return _mm_cvtsi128_si32(_mm_max_epi32(half, _mm_shuffle_epi32(half, 0xb1)));
}
INLINE uint32_t wide_where(Wide a, int32_t x) { return (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpeq_epi32(a, wide_splat(x)))); }
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
    for (uint32_t k = 0; k < num_pairs; k++) wide_add(wide_load(entries[2 * k] + q), wide_load(entries[2 * k + 1] + q), weights[k], &sums[0], &sums[1]);
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
static inline void best_of_rows(const Mixtures &m, const QueryTile &tile, uint64_t begin, uint64_t end, const BestSums &found) {
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
    const int32_t loser = wins ? found.best[row] : top.best, other = top.second > found.second[row] ? top.second : found.second[row];
    found.second[row] = loser > other ? loser : other;
    found.best[row] = wins ? top.best : found.best[row];
    found.index[row] = wins ? (int32_t)tile.first + top.index : found.index[row];
  }
}

// The best and second best of a tile of queries for rows [begin, end), merged into those of the tiles before.
// Places of the table without a query hold -32768, which loses against every query.
static void mixture_best(const Mixtures &m, const QueryTile &tile, uint64_t begin, uint64_t end, const BestSums &found) {
  switch (m.per_row) {
    case 2: return best_of_rows<2>(m, tile, begin, end, found);
    case 4: return best_of_rows<4>(m, tile, begin, end, found);
    case 8: return best_of_rows<8>(m, tile, begin, end, found);
    default: return best_of_rows<0>(m, tile, begin, end, found);
  }
}

static const MixtureKernels mixture_kernels = {mixture_encode, nearest_centres, nearest_members, score_table, table_place, mixture_scores, rows_above, mixture_best, kTileQueries};
