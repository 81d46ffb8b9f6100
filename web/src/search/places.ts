// Selected rows as places: objects, and loose Gaussians that hang together. The rules of query/tasks.py and linking.py.

import type { Splats } from "../protocol";
import { ofShare, type Rules } from "./contrast";
import { connected, median, Tree } from "./numbers";

export interface Place { rows: number[]; thing: number; score: number; rank: number; sure: boolean } // rows: of the field

/** Return the places that the selected rows make, best first. shown: the Gaussian of each row. */
export function placesOf(selected: number[], values: Float32Array, things: Int32Array, splats: Splats, solid: ArrayLike<number>, shown: Uint32Array, rules: Rules, share: number): Place[] {
  const fewest = ofShare(rules.min_gaussians, share);
  if (selected.length < Math.max(fewest, 2)) return [];
  const opacity = (row: number) => splats.opacity[shown[row]] / 255, groups = new Map<number, number[]>();
  numbered(selected, things, splats, shown, rules).forEach((place, i) => { const held = groups.get(place); if (held) held.push(selected[i]); else groups.set(place, [selected[i]]); });
  const places = [...groups].filter(([, rows]) => rows.filter((row) => solid[shown[row]]).length >= fewest).map(([place, rows]): Place => {
    const mass = rows.reduce((sum, row) => sum + opacity(row), 0), score = rows.reduce((sum, row) => sum + (mass > 0 ? opacity(row) / mass : 1 / rows.length) * values[row], 0);
    return { rows, thing: place, score, rank: score > 0 ? score * mass ** rules.mass_power : score, sure: true };
  });
  places.sort((a, b) => b.rank - a.rank || shown[a.rows[0]] - shown[b.rows[0]]);
  const best = places[0]?.rank ?? 0;
  for (const place of places) place.sure = place.rank >= Math.min(rules.sure_rank_share * best, best);
  countOnce(places.filter((place) => place.sure), splats, solid, shown, rules);
  return places;
}

interface Part { at: Float64Array; tree: Tree; reach: number; whole: Place }

/** Take the parts of other places from those that are sure: query/tasks.py::whole_of. */
function countOnce(places: Place[], splats: Splats, solid: ArrayLike<number>, shown: Uint32Array, rules: Rules): void {
  const known: Part[] = [];
  for (const place of places.length > 1 ? places : []) {
    const at = pointsOf(place.rows.filter((row) => solid[shown[row]]), splats, shown), tree = new Tree(at);
    const part = { at, tree, reach: rules.touch_factor / rules.link_factor * reachOf(at, tree, rules), whole: place };
    const touched = new Set(known.filter((one) => place.score >= rules.part_score_share * one.whole.score && touch(part, one, rules)).map((one) => one.whole));
    const whole = places.find((one) => touched.has(one)) ?? place;
    for (const one of [place, ...touched]) if (one !== whole) one.sure = false;
    for (const one of [part, ...known]) if (one === part || touched.has(one.whole)) one.whole = whole;
    known.push(part);
  }
}

function touch(one: Part, other: Part, rules: Rules): boolean {
  const [small, large] = one.at.length <= other.at.length ? [one, other] : [other, one], reach = Math.max(one.reach, other.reach), count = small.at.length / 3;
  let near = 0;
  for (let i = 0; i < count; i++) near += Number(large.tree.nearest(small.at[3 * i], small.at[3 * i + 1], small.at[3 * i + 2], 1).squares[0] <= reach * reach);
  return near >= rules.min_touching_share * count;
}

function pointsOf(rows: number[], splats: Splats, shown: Uint32Array): Float64Array {
  const out = new Float64Array(3 * rows.length);
  rows.forEach((row, n) => { for (let k = 0; k < 3; k++) out[3 * n + k] = splats.centers[3 * shown[row] + k]; });
  return out;
}

/** Return the object of each selected row; loose ones that hang together share a number below 0. */
function numbered(selected: number[], things: Int32Array, splats: Splats, shown: Uint32Array, rules: Rules): number[] {
  const places = selected.map((row) => things[row]), loose = [...places.keys()].filter((i) => places[i] < 0), held = [...places.keys()].filter((i) => places[i] >= 0);
  const points = (some: number[]) => pointsOf(some.map((i) => selected[i]), splats, shown);
  if (loose.length > 1) {
    const at = points(loose), labels = connected(at, reachOf(at, new Tree(at), rules));
    loose.forEach((i, k) => { places[i] = -1 - labels[k]; });
  }
  if (loose.length && held.length > 1) joinToHeld(places, points(loose), points(held), loose, held, rules);
  return places;
}

/** Return the linking distance: a multiple of the median distance to the last neighbour. */
function reachOf(at: Float64Array, tree: Tree, rules: Rules): number {
  const count = at.length / 3, among = Math.min(rules.num_neighbours, count - 1) + 1;
  return rules.link_factor * median(Float32Array.from({ length: count }, (_, i) => Math.sqrt(tree.nearest(at[3 * i], at[3 * i + 1], at[3 * i + 2], among).squares[among - 1])));
}

/** Give loose places of which half lies at an object that was selected as well its number: they are its border. */
function joinToHeld(places: number[], looseAt: Float64Array, heldAt: Float64Array, loose: number[], held: number[], rules: Rules): void {
  const tree = new Tree(heldAt), reach = reachOf(heldAt, tree, rules), members = new Map<number, number[]>();
  const nearest = loose.map((_, k) => { const { squares, rows } = tree.nearest(looseAt[3 * k], looseAt[3 * k + 1], looseAt[3 * k + 2], 1); return squares[0] <= reach * reach ? places[held[rows[0]]] : -1; });
  loose.forEach((i, k) => { const some = members.get(places[i]); if (some) some.push(k); else members.set(places[i], [k]); });
  for (const some of members.values()) {
    const near = some.filter((k) => nearest[k] >= 0), counts = new Map<number, number>();
    if (near.length < rules.min_near_share * some.length || !near.length) continue;
    for (const k of near) counts.set(nearest[k], (counts.get(nearest[k]) ?? 0) + 1);
    const [[number]] = [...counts].sort((a, b) => b[1] - a[1] || a[0] - b[0]);
    for (const k of some) places[loose[k]] = number;
  }
}
