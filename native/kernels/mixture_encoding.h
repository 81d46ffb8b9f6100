// Which atoms make a feature: orthogonal least squares among candidates.
#pragma once
#include "kernels/lanes.h"
#include "kernels/mixture_atoms.h"
#include "kernels/mixture_kernels.h"
#include "kernels/ranking.h"

namespace drsplat::DRSPLAT_ISA {

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
  Floats most = splat(kLeastGain);
  Ints group = splat_int(-1);
  for (size_t i = 0; i < p.stride; i += 16) {  // nothing is left of what fills up the last sixteen
    const Floats left = load(p.left + i), norms = load(p.norms + i), gain = left * left / norms;
    const Mask free = (splat(0.f) < left) & (norms >= splat(kDependent)) & (load(p.barred + i) < splat(1.f));
    const Mask better = free & (most < gain);
    most = select(better, gain, most), group = select(better, splat_int((int32_t)i), group);
  }
  float gains[16];
  int32_t groups[16];
  store(gains, most), store_int(groups, group);
  int64_t best = -1;
  float largest = 0;
  for (int l = 0; l < 16; l++) {
    const int64_t place = groups[l] + l;
    if (groups[l] < 0 || gains[l] < largest || (gains[l] == largest && place > best)) continue;
    largest = gains[l], best = place;
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
  atom_products<1>(atoms, p.candidates, p.count, p.whole, &atoms.scales[id], p.gram + p.chosen * p.stride);
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

// What is not finite counts as least.
static float finite_or_least(float weight) { return weight < __builtin_inff() ? weight : -__builtin_inff(); }

static int least_weight(const Pursuit &p, const float *weights) {
  int least = 0;
  for (int t = 1; t < p.chosen; t++)
    if (finite_or_least(weights[t]) < finite_or_least(weights[least])) least = t;
  return least;
}

static bool all_positive(const Pursuit &p, const float *weights) {
  return finite_or_least(weights[least_weight(p, weights)]) > 0;
}

// Solves for the weights, dropping the least until all are above zero. Ends: every round that does not return leaves
// one atom fewer, so there are at most as many as atoms, whatever the numbers say.
static void solve_positive(Pursuit &p, float *weights) {
  while (p.chosen > 0) {
    solve(p, weights);
    if (all_positive(p, weights)) return;
    drop(p, least_weight(p, weights));
  }
}

// Greedily; an atom whose weight falls below zero leaves, and is not asked again. Ends: each round bars a candidate
// that was not barred, and there are at most 2 * wanted rounds.
static void choose_atoms(Pursuit &p, const Atoms &atoms, int wanted, float *weights) {
  for (int tries = 2 * wanted; p.chosen < wanted && tries > 0; tries--) {
    const int64_t place = best_candidate(p);
    if (place < 0) return;
    choose(p, atoms, (size_t)place);
    solve_positive(p, weights);
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

// Weights of the chosen atoms and of one more, which is not chosen yet: nothing is asked of the other candidates.
static bool is_better(Pursuit &p, size_t place, float before, float *weights) {
  const int t = p.chosen++;
  p.places[t] = place;
  p.basis[t * p.stride + place] = __builtin_sqrtf(p.norms[place]);
  p.levels[t] = p.left[place] / p.basis[t * p.stride + place];
  solve(p, weights);
  const bool better = explained(p) > before && all_positive(p, weights);
  p.chosen--;
  return better;
}

// Each chosen atom once gives way to the candidate that fits best without it, where that explains more. Rounding may
// make a weight of the last order negative that was not in the order before: such atoms leave at the end.
static void exchange_atoms(Pursuit &p, const Atoms &atoms, float *weights) {
  for (int left = p.chosen; left > 0; left--) {
    const float before = explained(p);
    const size_t old = p.places[0];
    drop(p, 0);
    p.barred[old] = 0;
    const int64_t best = best_candidate(p);
    if (best < 0 || (size_t)best == old || !is_better(p, (size_t)best, before, weights)) put_back(p, old);
    else choose(p, atoms, (size_t)best);
  }
  solve_positive(p, weights);
}

// Weights (above zero, finite) as bytes, heaviest first; the scale makes what they decode to a unit vector.
static float quantise(const Pursuit &p, const float *weights, int wanted, int32_t *ids, uint8_t *bytes) {
  int32_t order[kMostAtoms];
  float sorted[kMostAtoms];
  for (int t = 0; t < p.chosen; t++) insert_descending(order, sorted, (size_t)t, t, weights[t]);
  for (int k = 0; k < wanted; k++) {
    const bool known = k < p.chosen;
    bytes[k] = known ? (uint8_t)(sorted[k] / sorted[0] * 255 + 0.5f) : 0;
    ids[k] = p.chosen ? p.candidates[p.places[order[known ? k : 0]]] : 0;
  }
  double squared = 0;
  for (int k = 0; k < p.chosen; k++)
    for (int l = 0; l < p.chosen; l++)
      squared += (double)bytes[k] * bytes[l] * p.gram[order[k] * p.stride + p.places[order[l]]];
  return squared > 0 ? (float)(1 / __builtin_sqrt(squared)) : 0.f;
}

// `scratch`: (5 + 2 * wanted) * n floats, where n is the most candidates of a row in whole sixteens; `candidates`:
// n numbers; `whole`: dim numbers.
static void mixture_encode(const Atoms &atoms, const MixtureSource &source, uint64_t begin, uint64_t end,
                           float *scratch, int32_t *candidates, int16_t *whole, const MixtureRows &out) {
  const int wanted = (int)source.wanted;
  for (uint64_t row = begin; row < end; row++) {
    Pursuit p;
    const size_t own = (size_t)(source.starts[row + 1] - source.starts[row]), further = source.num_further;
    if (own) memcpy(candidates, source.columns + source.starts[row], own * sizeof(int32_t));
    if (further) memcpy(candidates + own, source.further + row * further, further * sizeof(int32_t));
    p.candidates = candidates, p.count = own + further, p.stride = (p.count + 15) / 16 * 16, p.chosen = 0;
    if (!p.count) {  // what is empty may lie nowhere
      out.scales[row] = quantise(p, nullptr, wanted, out.ids + row * wanted, out.weights + row * wanted);
      continue;
    }
    float *next = scratch;
    float **const arrays[] = {&p.targets, &p.left, &p.norms, &p.barred, &p.spare};
    for (float **array : arrays) *array = next, next += p.stride;
    p.gram = next, next += wanted * p.stride;
    p.basis = next, next += wanted * p.stride;
    p.whole = whole;
    memset(scratch, 0, (size_t)(next - scratch) * sizeof(float));
    const float step = whole_vector(source.features + row * atoms.dim, atoms.dim, whole);
    atom_products<1>(atoms, candidates, p.count, whole, &step, p.targets);
    rebuild_basis(p);
    float weights[kMostAtoms] = {};
    choose_atoms(p, atoms, wanted, weights);
    if (p.chosen) exchange_atoms(p, atoms, weights);
    out.scales[row] = quantise(p, weights, wanted, out.ids + row * wanted, out.weights + row * wanted);
  }
}

}  // namespace drsplat::DRSPLAT_ISA
