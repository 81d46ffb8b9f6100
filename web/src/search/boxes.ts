// The box of some Gaussians without strays and outliers, as kernels/boxes.py makes it (twin: tests/twins/boxes.py).

import { HALVES } from "../halves";
import type { Box, Splats } from "../protocol";
import { cross, dot, minus, norm, plus, times, unit, type Vec } from "../vectors";
import type { Rules } from "./contrast";

const DEVIATIONS = 6, STEPS = 30, ROUNDS = 2, FEWEST = 4, MOST_ROWS = 3000, LEAST = 2.3e-308;

/** Of many Gaussians some stand for all. up: null where a box lies as the thing does. */
export function boxOf(splats: Splats, all: number[], up: Vec | null, rules: Rules): Box {
  const each = Math.ceil(all.length / MOST_ROWS), rows = all.filter((_, i) => i % each === 0);
  const points = Array.from(rows, (row): Vec => [splats.centers[3 * row], splats.centers[3 * row + 1], splats.centers[3 * row + 2]]);
  let mass = Array.from(rows, (row) => splats.opacity[row] / 255);
  if (!mass.some((x) => x > 0)) mass = mass.map(() => 1);
  const inside = withoutStrays(points, shares(mass), up, rules), kept = points.filter((_, i) => inside[i]), weights = shares(mass.filter((_, i) => inside[i]));
  const covariances = Array.from(rows).filter((_, i) => inside[i]).map((row) => Array.from({ length: 6 }, (_, k) => HALVES[splats.covariances[6 * row + k]]));
  const axes = axesOf(kept, weights, up), ends = axes.map((axis): [number, number] => {
    const along = kept.map((point) => dot(point, axis)), spread = covariances.map((c) => Math.sqrt(Math.max(0, variance(c, axis))));
    const low = lowQuantile(along, spread, weights, rules.outlier_share);
    return [low, -lowQuantile(along.map((x) => -x), spread, weights, rules.outlier_share)];
  });
  return ordered(axes, ends, up ? 2 : 3);
}

const shares = (mass: number[]): number[] => { const all = mass.reduce((sum, x) => sum + x, 0); return mass.map((x) => x / all); };

function variance([xx, xy, xz, yy, yz, zz]: number[], [x, y, z]: Vec): number { return xx * x * x + yy * y * y + zz * z * z + 2 * (xy * x * y + xz * x * z + yz * y * z); }

function withoutStrays(points: Vec[], mass: number[], up: Vec | null, rules: Rules): boolean[] {
  let inside = points.map(() => true);
  for (let round = 0; round < ROUNDS; round++) {
    const axes = axesOf(points.filter((_, i) => inside[i]), mass.filter((_, i) => inside[i]), up);
    const cores = axes.map((axis) => core(points.map((point) => dot(point, axis)), mass, rules));
    inside = points.map((point) => axes.every((axis, a) => { const x = dot(point, axis); return x >= cores[a][0] && x <= cores[a][1]; }));
    if (inside.filter((is, i) => is && mass[i] > 0).length < FEWEST) inside.fill(true);
  }
  return inside;
}

/** Return the interval between two tails that has the largest mass^sparseness / length. */
function core(values: number[], mass: number[], { max_stray_share, min_tail_sparseness }: Rules): [number, number] {
  const tails = [0, ...Array.from({ length: 12 }, (_, i) => max_stray_share * 0.77 ** (11 - i))], order = Array.from(values.keys()).sort((a, b) => values[a] - values[b] || a - b);
  const firsts = (along: number[]) => {
    const out: number[] = [];
    let sum = 0, i = -1;
    for (const tail of tails) { while (i < along.length - 1 && (i < 0 || sum <= tail)) sum += mass[along[++i]]; out.push(values[along[i]]); }
    return out;
  };
  const lows = firsts(order), highs = firsts(order.slice().reverse()), least = 1e-9 * (highs[0] - lows[0]) + LEAST;
  let best = -Infinity, found: [number, number] = [lows[0], highs[0]];
  tails.forEach((low, a) => tails.forEach((high, b) => {
    const length = highs[b] - lows[a], kept = length < 0 ? -Infinity : min_tail_sparseness * Math.log(1 - high - low) - Math.log(Math.max(length, least));
    if (kept > best) { best = kept; found = [lows[a], highs[b]]; }
  }));
  return found;
}

/** Return the value below which a share of a mixture of normal distributions lies, by bisection. */
function lowQuantile(means: number[], deviations: number[], mass: number[], share: number): number {
  const order = Array.from(means.keys()).sort((a, b) => means[a] - means[b]);
  let before = 0, sum = 0;
  while (before < order.length - 1 && (sum += mass[order[before]]) < 2 * share) before++;
  let high = means[order[before]], low = means.reduce((least, mean, i) => Math.min(least, mean - DEVIATIONS * deviations[i]), Infinity);
  const near = order.filter((i) => means[i] - DEVIATIONS * deviations[i] <= high), narrow = 1e-12 * (high - low) + LEAST;
  for (let step = 0; step < STEPS; step++) {
    const middle = (low + high) / 2, below = near.reduce((part, i) => part + mass[i] * normal((middle - means[i]) / Math.max(deviations[i], narrow)), 0);
    if (below < share) low = middle; else high = middle;
  }
  return (low + high) / 2;
}

/** Return the normal distribution's share below x (Numerical Recipes, erfc to 1.2e-7 of itself). */
function normal(x: number): number {
  const z = Math.abs(x) * Math.SQRT1_2, t = 1 / (1 + z / 2);
  const powers = [-1.26551223, 1.00002368, 0.37409196, 0.09678418, -0.18628806, 0.27886807, -1.13520398, 1.48851587, -0.82215223, 0.17087277];
  const tail = (t * Math.exp(-z * z + powers.reduceRight((sum, c) => c + t * sum, 0))) / 2;
  return x > 0 ? 1 - tail : tail;
}

/** Return the principal axes, longest first, or those in the plane, and up. */
function axesOf(points: Vec[], mass: number[], up: Vec | null): Vec[] {
  const all = mass.reduce((sum, m) => sum + m, 0), middle: Vec = [0, 1, 2].map((k) => points.reduce((sum, p, i) => sum + mass[i] * p[k], 0) / all) as Vec;
  const spread = [0, 1, 2].map((a) => [0, 1, 2].map((b) => points.reduce((sum, p, i) => sum + mass[i] * (p[a] - middle[a]) * (p[b] - middle[b]), 0)));
  if (!up) return principal(spread);
  const least = up.map(Math.abs).indexOf(Math.min(...up.map(Math.abs))), east = unit(cross(up, [0, 1, 2].map((k) => Number(k === least)) as Vec)), north = cross(up, east);
  const entry = (a: Vec, b: Vec) => a.reduce((sum, x, i) => sum + x * dot(spread[i] as Vec, b), 0), turn = Math.atan2(2 * entry(east, north), entry(east, east) - entry(north, north)) / 2;
  const along = (angle: number): Vec => east.map((x, k) => Math.cos(angle) * x + Math.sin(angle) * north[k]) as Vec;
  return [along(turn), along(turn + Math.PI / 2), up];
}

/** Return the eigenvectors of a symmetric matrix, of the largest eigenvalue first, by Jacobi's rotations. */
function principal(matrix: number[][]): Vec[] {
  const m = matrix.map((row) => row.slice()), v = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  for (let sweep = 0; sweep < 30; sweep++) for (const [p, q] of [[0, 1], [0, 2], [1, 2]]) {
    if (Math.abs(m[p][q]) < 1e-300) continue;
    const angle = Math.atan2(2 * m[p][q], m[p][p] - m[q][q]) / 2, c = Math.cos(angle), s = Math.sin(angle);
    for (let k = 0; k < 3; k++) [m[k][p], m[k][q]] = [c * m[k][p] + s * m[k][q], c * m[k][q] - s * m[k][p]];
    for (let k = 0; k < 3; k++) [m[p][k], m[q][k]] = [c * m[p][k] + s * m[q][k], c * m[q][k] - s * m[p][k]];
    for (let k = 0; k < 3; k++) [v[k][p], v[k][q]] = [c * v[k][p] + s * v[k][q], c * v[k][q] - s * v[k][p]];
  }
  return [0, 1, 2].sort((a, b) => m[b][b] - m[a][a]).map((k) => unit([v[0][k], v[1][k], v[2][k]]));
}

/** Order the first `free` axes by length, turn each to where its largest part is positive, and make them right-handed. */
function ordered(axes: Vec[], ends: [number, number][], free: number): Box {
  const order = [0, 1, 2].slice(0, free).sort((a, b) => ends[b][1] - ends[b][0] - (ends[a][1] - ends[a][0])).concat([0, 1, 2].slice(free));
  const turned = order.map((a, k) => (k >= free || Math.max(...axes[a]) >= -Math.min(...axes[a]) ? 1 : -1));
  const made = () => order.map((a, k) => times(axes[a], turned[k])), flip = free < 3 ? 1 : 2;
  if (dot(cross(made()[0], made()[1]), made()[2]) < 0) turned[flip] *= -1;
  const directions = made() as [Vec, Vec, Vec], spans = order.map((a, k) => (turned[k] > 0 ? ends[a] : [-ends[a][1], -ends[a][0]]));
  const center = [0, 1, 2].map((i) => directions.reduce((sum, axis, k) => sum + axis[i] * (spans[k][0] + spans[k][1]) / 2, 0)) as Vec;
  return { center, axes: directions, extent: spans.map(([low, high]) => high - low) as Vec };
}

/** Cameras of the photos, as arrays of numbers. places: in the browser's frame. poses: 4 x 4, of the world. */
export interface Cameras { places: Float32Array; poses: Float32Array; lenses: Float32Array; sizes: Float32Array }

/** Return a place to see something from, on the way to a photo that shows it; see authoring/filming/looking.py. */
export function eyeFor(center: Vec, extent: Vec, radius: number, up: Vec, cameras: Cameras, rules: Rules): Vec {
  const { places, poses, lenses, sizes } = cameras, size = Math.max(...extent, rules.min_size_share * radius, 1e-6), distance = rules.distance_sizes * size * Math.hypot(1, rules.rise);
  if (!places.length) {
    const side: Vec = [0.8, 0.5, 0.3], level = unit(side.map((x, k) => x - dot(side, up) * up[k]) as Vec), way = level.map((x, k) => x + rules.rise * up[k]) as Vec;
    return center.map((x, k) => x + (distance * way[k]) / norm(way)) as Vec;
  }
  const at = (i: number): Vec => [places[3 * i], places[3 * i + 1], places[3 * i + 2]], ways = Array.from({ length: places.length / 3 }, (_, i) => minus(at(i), center));
  const showing = ways.map((way, i) => {
    const [x, y, z] = [0, 1, 2].map((row) => -dot(way, [0, 1, 2].map((k) => poses[16 * i + 4 * row + k]) as Vec));
    const seen = [(lenses[9 * i] * x / z + lenses[9 * i + 2]) / sizes[2 * i], (lenses[9 * i + 4] * y / z + lenses[9 * i + 5]) / sizes[2 * i + 1]];
    return z > 0 && seen.every((share) => share >= rules.margin_share && share <= 1 - rules.margin_share);
  });
  const any = showing.some(Boolean), lengths = ways.map((way) => Math.max(norm(way), 1e-9)), unfit = lengths.map((length, i) => (showing[i] || !any ? Math.abs(Math.log(length / distance)) : Infinity));
  const best = unfit.indexOf(Math.min(...unfit));
  return plus(center, ways[best], Math.min(1, distance / lengths[best]));
}
