// How much better a query fits than a list of words: the rules of query/contrast.py and query/thresholds.py.

import { product, type Codes } from "./codes";
import { largest, most, rounded } from "./numbers";

/** Numbers of the rules, by the names of their constants in Python. */
export type Rules = Record<string, number>;
export type Certainty = "sure" | "maybe" | "nothing";

const FEW = 64; // words that are all scored at each row
const STEP = 20; // words between two pictures
const CLOSE = 48; // words of a longer list that are scored at the rows of a centroid

/** What the words of a list reach at each row. least: the cosine that a thing's best rows exceed; null: none is known. */
export class Contrast {
  private scores = new Float32Array(0); // of the best words, best first: all rows of the first, of the second ...
  private words = new Uint16Array(0);
  private readonly kept: number;
  private steps: Generator<void> | null = null;

  constructor(
    private readonly codes: Codes, readonly texts: string[], readonly vectors: Float32Array[], readonly usual: Float32Array, readonly spread: number,
    readonly least: number | null, readonly isOfKind: boolean, private readonly rules: Rules, private readonly share: number,
  ) {
    this.kept = Math.min(vectors.length, Math.max(1, rounded(vectors.length / rules.words_per_rival)) + rules.spare_words);
  }

  get clearMargin(): number {
    const { rules } = this;
    if (this.isOfKind) return rules.kind_clear_margin;
    return this.vectors.length >= rules.words_per_rival ? rules.long_list_clear_margin : rules.clear_margin;
  }

  /** Rows that have to stand above the list, of those in the page. */
  get peak(): number {
    const { rules } = this, every = this.codes.count / this.share;
    const peak = this.vectors.length < rules.words_per_rival ? rules.peak_rows : Math.min(rules.peak_rows, Math.max(rules.min_peak_rows, rounded(rules.peak_share * every)));
    return ofShare(peak, this.share);
  }

  /** Score the list, once, in steps that may stand between two pictures. */
  *preparing(): Generator<void> {
    if (!this.steps) this.steps = this.scoring();
    while (!this.steps.next().done) yield;
  }

  private *scoring(): Generator<void> {
    const { count } = this.codes, levels = this.vectors.map((vector) => product(vector, this.usual));
    this.scores = new Float32Array(this.kept * count).fill(-Infinity);
    this.words = new Uint16Array(this.kept * count);
    if (this.vectors.length <= FEW) {
      for (const [word, vector] of this.vectors.entries()) {
        const own = this.codes.scores(vector);
        for (let i = 0; i < count; i++) this.keep(i, own[i] - levels[word], word);
        yield;
      }
      return;
    }
    const products: Float32Array[][] = [];
    for (const vector of this.vectors) { products.push(this.codes.products(vector)); if (products.length % STEP === 0) yield; }
    for (const [c, rows] of this.codes.alike().entries()) {
      if (!rows.length) continue;
      const roughly = products.map((tables, word) => tables[0][c] - levels[word]), close = Array.from(roughly.keys()).sort((a, b) => roughly[b] - roughly[a]).slice(0, CLOSE).sort((a, b) => a - b);
      for (const row of rows) for (const word of close) this.keep(row, this.codes.score(row, products[word]) - levels[word], word);
      yield;
    }
  }

  private keep(row: number, score: number, word: number): void {
    const { count } = this.codes;
    let k = this.kept - 1;
    if (!(score > this.scores[k * count + row])) return;
    for (; k > 0 && this.scores[(k - 1) * count + row] < score; k--) {
      this.scores[k * count + row] = this.scores[(k - 1) * count + row];
      this.words[k * count + row] = this.words[(k - 1) * count + row];
    }
    this.scores[k * count + row] = score;
    this.words[k * count + row] = word;
  }

  /** Return relevancies: above 0.5 where the query fits better than all words but one in `words_per_rival`. near: words
   * that do not compete. null: none does. */
  relevancy(query: Float32Array, scores: Float32Array, near: Uint8Array): Float32Array | null {
    for (const _ of this.preparing()) { /* what is not there yet, now */ }
    const others = near.reduce((sum, is) => sum + 1 - is, 0), { count } = this.codes;
    if (!others) return null;
    const rank = Math.max(1, rounded(others / this.rules.words_per_rival)), usual = product(query, this.usual), out = new Float32Array(count);
    for (let i = 0; i < count; i++) {
      let better = 0, at = this.kept - 1;
      for (let k = 0; k < this.kept; k++) if (!near[this.words[k * count + i]] && ++better === rank) { at = k; break; }
      const margin = (scores[i] - usual - this.scores[at * count + i]) / this.spread;
      out[i] = 1 / (1 + Math.exp(-Math.max(-50, Math.min(50, margin))));
    }
    return out;
  }

  /** Return the word that fits best where the query fits best, "" for none. */
  rival(values: Float32Array, near: Uint8Array): string {
    const best = Array.from(values.keys()).sort((a, b) => values[b] - values[a] || a - b).slice(0, this.peak), counts = new Map<number, number>(), { count } = this.codes;
    for (const row of best) for (let k = 0; k < this.kept; k++) {
      const word = this.words[k * count + row];
      if (!near[word]) { counts.set(word, (counts.get(word) ?? 0) + 1); break; }
    }
    const [first] = [...counts].sort((a, b) => b[1] - a[1] || a[0] - b[0]);
    return first ? this.texts[first[0]] : "";
  }

  /** Return whether a query is found for sure, maybe, or not. names: that answer it. */
  certainty(scores: Float32Array, values: Float32Array, names: number): Certainty {
    const { rules } = this, clear = (peak: number, margin: number) => largest(values, peak) > leastClear(this.codes.count / this.share, margin, rules);
    if (this.least !== null) {
      const peak = ofShare(rules.peak_rows, this.share), height = largest(scores, peak);
      if (!clear(peak, this.clearMargin)) return "nothing";
      return height > this.least ? "sure" : height > rules.maybe_least_share * this.least && !this.isOfKind ? "maybe" : "nothing";
    }
    const margin = this.clearMargin + rules.kind_margin_per_efold * Math.log(Math.max(names, 1));
    if (clear(this.peak, margin)) return "sure";
    return clear(this.peak, margin - rules.maybe_spreads) ? "maybe" : "nothing";
  }

  /** Return the threshold of values that were compared with the list; the highest where nothing is found. */
  threshold(values: Float32Array, certainty: Certainty): number {
    if (certainty === "nothing") return most(values);
    return certainty === "sure" && this.least !== null ? this.rules.list_relevancy : this.ownLevel(values);
  }

  private ownLevel(values: Float32Array): number {
    const { rules } = this, worse = values.filter((x) => x < rules.list_relevancy), n = worse.length;
    const middle = n ? (margin(largest(worse, (n >> 1) + 1)) + margin(largest(worse, (n + 1) >> 1))) / 2 : 0;
    const height = margin(largest(values, Math.max(this.peak, rounded(rules.large_scene_peak_share * values.length))));
    return sigmoid(rules.own_threshold_share * (middle + rules.way_to_peak_share * (height - middle)));
  }
}

/** Return how many of the rows in the page stand for some of the scene. */
export function ofShare(rows: number, share: number): number { return Math.max(1, Math.round(rows * share)); }

function leastClear(rows: number, margin: number, rules: Rules): number {
  return sigmoid(margin + rules.clear_margin_per_efold * Math.log(Math.max(rows, rules.clear_margin_rows) / rules.clear_margin_rows));
}

const sigmoid = (x: number): number => 1 / (1 + Math.exp(-x));

function margin(relevancy: number): number {
  const inside = Math.max(1e-12, Math.min(1 - 1e-12, relevancy));
  return Math.log(inside / (1 - inside));
}

/** Return values, those of rows that fit half of the query lowered where others fit all of it. */
export function lowerPartialFits(scores: Float32Array, values: Float32Array, rules: Rules, share: number): Float32Array {
  const half = rules.half_fit_share * largest(scores, ofShare(rules.peak_rows, share));
  return values.map((value, i) => (scores[i] <= half ? Math.min(value, rules.relevancy_threshold) : value));
}

/** Return a threshold of cosines: the encoder's own, or between the median and the peak. */
export function cosineThreshold(scores: Float32Array, least: number | null, rules: Rules, share: number): number {
  const peak = largest(scores, ofShare(rules.peak_rows, share));
  if (least !== null) return Math.max(least, rules.cut_share * peak);
  const middle = largest(scores, (scores.length + 1) >> 1);
  return peak > middle ? middle + rules.cut_share * (peak - middle) : most(scores);
}

/** Return values as whole objects have them: the mean of a row's own and of what a quarter of its object reaches, or
 * its piece of that where this is more. things, pieces: the rows of each. */
export function withObjects(values: Float32Array, things: Uint32Array[], pieces: Uint32Array[], rules: Rules): Float32Array {
  const out = values.slice(), spoken = new Float32Array(values.length), reached = (rows: Uint32Array) => largest(Float32Array.from(rows, (row) => values[row]), Math.ceil(rules.speaking_share * rows.length));
  for (const rows of things) { const value = reached(rows); for (const row of rows) spoken[row] = value; }
  for (const rows of pieces) { const value = reached(rows); for (const row of rows) spoken[row] = Math.max(spoken[row], value); }
  for (const rows of things) for (const row of rows) out[row] = (1 - rules.object_trust) * values[row] + rules.object_trust * spoken[row];
  return out;
}

/** Return the rows of each group; those of group -1 or less are in none. */
export function membersOf(groups: Int32Array): Uint32Array[] {
  const members = new Map<number, number[]>();
  groups.forEach((group, i) => { if (group >= 0) { const held = members.get(group); if (held) held.push(i); else members.set(group, [i]); } });
  return [...members.values()].map((rows) => Uint32Array.from(rows));
}
