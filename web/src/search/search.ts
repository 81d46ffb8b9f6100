// A page that is asked words which nobody asked when it was written: what `drsplat locate` does, in the browser.

import { HALVES } from "../halves";
import type { Box, Color, Match, Result, Splats } from "../protocol";
import type { Vec } from "../vectors";
import { boxOf, eyeFor } from "./boxes";
import { Codes, product } from "./codes";
import { Contrast, cosineThreshold, lowerPartialFits, membersOf, ofShare, withObjects, type Certainty, type Rules } from "./contrast";
import { largest, median, most } from "./numbers";
import { placesOf, type Place } from "./places";
import { parsed, splitNegation, type SentenceRules } from "./sentences";
import { ListedWords, spellings, SummedWords, type Lexicon, type Words } from "./words";

interface ListFile { texts: string[]; spread: number; least: number | null }

/** What a page's file says of its search; fronts/viewing/page_search.py writes it. */
export interface SearchFile {
  rules: Rules; share: number; up: Vec | null; radius: number; center: Vec; sentences: SentenceRules; threshold: number | null; doubt: string; weak_doubt: string; accents: Color[];
  offers: string[]; missed: { best_place: string; below_threshold: string };
  lists: { all?: ListFile; colors?: ListFile }; texts?: string[]; lexicon?: Lexicon; kinds?: Record<string, number[]>; vocabulary: string[];
}

export type Arrays = Record<string, Uint8Array | Uint16Array | Uint32Array | Float32Array>;

/** The values of a text per row, and above which of them it selects. */
export interface Answered { values: Float32Array; threshold: number; measure: "cosine" | "relevancy"; certainty: Certainty; doubt: string }

/** An answer, and its paint per shown Gaussian. */
export interface Found { result: Result; heat: Uint8Array; owner: Uint8Array }

const MOST_MATCHES = 254, MOST_WORDS = 5, WARMEST = 255, SAME = 1 - 1e-5;

export class Search {
  readonly words: Words;
  readonly codes: Codes;
  private readonly things: Int32Array;
  private readonly groups: { things: Uint32Array[]; pieces: Uint32Array[] };
  private vocabulary: { text: string; vector: Float32Array }[] | null = null;
  private readonly every: Contrast | null;
  private readonly colors: Contrast | null;

  constructor(readonly file: SearchFile, private readonly arrays: Arrays, private readonly splats: Splats, private readonly lookUp: Vec, private readonly scale: number) {
    const place = arrays.things as Uint32Array, stages = (arrays.steps as Float32Array).length, dim = arrays.centroids.length / (256 * stages), size = arrays.usual.length;
    const rows = Uint32Array.from(place.keys()).filter((i) => place[i] > 0), piece = arrays.pieces as Uint32Array;
    this.codes = new Codes(rows, Array.from({ length: stages }, (_, k) => arrays[`code${k}`] as Uint8Array), arrays.centroids as Uint8Array, arrays.steps as Float32Array, dim);
    this.things = Int32Array.from(rows, (row) => place[row] - 2);
    this.groups = { things: membersOf(this.things), pieces: membersOf(Int32Array.from(rows, (row) => piece[row] - 1)) };
    const vectors = rowsOf(Float32Array.from(arrays.texts as Uint16Array, (half) => HALVES[half]), size);
    const summed = file.lexicon ? new SummedWords(file.lexicon, vectors) : null, listed = new ListedWords(file.texts ?? [], vectors);
    this.words = summed ?? listed;
    const list = (one: ListFile | undefined, of: Float32Array[], isOfKind: boolean) => one ? new Contrast(this.codes, one.texts, of, arrays.usual as Float32Array, one.spread, one.least, isOfKind, file.rules, file.share) : null;
    this.every = list(file.lists.all, file.lists.all?.texts.map((text) => this.words.vector(text)) ?? [], false);
    this.colors = list(file.lists.colors, summed?.photoColors ?? [], true);
  }

  /** Return texts to go on with what is typed. */
  suggest(typed: string, number: number): string[] { return this.words.suggest(typed.toLowerCase(), number); }

  /** Return what of a text is looked for, and what is not. */
  reads(text: string): [string, string[]] { return splitNegation(this.words.has(text) ? text : parsed(text, this.file.sentences), this.file.sentences); }

  /** Answer a text, as query/measuring.py does. Throws an Error where a word is not known or a relation is asked. */
  answer(text: string): Answered {
    const [wanted, unwanted] = this.reads(text);
    const query = this.words.vector(wanted), answered = this.measured(wanted, query), doubt = this.words.hasNouns(wanted) ? this.file.doubt : "";
    if (unwanted.length) {
      const scores = this.whole(this.codes.scores(query)), rivals = this.whole(this.best(unwanted.map((word) => `${word} ${wanted}`)));
      for (let i = 0; i < scores.length; i++) if (rivals[i] >= scores[i]) answered.values[i] = answered.measure === "cosine" ? -1 : 0;
    }
    const doubts = [answered.doubt, doubt].filter(Boolean).join(". "), found = answered.values.some((value) => value > answered.threshold);
    return { ...answered, doubt: doubts, certainty: !found ? "nothing" : answered.certainty === "sure" && !doubts ? "sure" : "maybe" };
  }

  /** Do in steps what a first question needs. */
  *preparing(): Generator<void> { for (const list of [this.every, this.colors]) if (list) yield* list.preparing(); }

  /** Return values as whole objects have them. */
  private whole(values: Float32Array): Float32Array { return withObjects(values, this.groups.things, this.groups.pieces, this.file.rules); }

  /** Return each row's best score among some texts. */
  private best(texts: string[]): Float32Array {
    const all = texts.map((text) => this.codes.scores(this.words.vector(text)));
    return all[0].map((_, i) => Math.max(...all.map((scores) => scores[i])));
  }

  private measured(text: string, query: Float32Array): Answered {
    const scores = this.codes.scores(query), { rules, share, threshold } = this.file, list = this.words.isOnlyColors(text) ? this.colors : this.every;
    const plain = (): Answered => ({ values: this.whole(scores), threshold: cosineThreshold(scores, threshold, rules, share), measure: "cosine", certainty: "sure", doubt: "" });
    if (!list || threshold !== null) return plain();
    const same = this.sameKind(text), near = this.near(list, text, query), fits = same.length ? this.kindScores(list, query, scores, same) : scores;
    for (const word of same) near[word] = 1;
    let values = list.relevancy(query, fits, near);
    if (!values) return plain();
    if (this.every?.least !== null && !list.isOfKind) values = lowerPartialFits(scores, values, rules, share);
    const found = list.certainty(scores, values, same.length || 1), level = list.threshold(values, found), answered = this.whole(values);
    const swap = found === "sure" && list.least !== null ? this.betterSwap(text, query, scores) : "", certainty = swap ? "maybe" : found;
    const rival = swap || (certainty === "maybe" && list.least === null ? list.rival(values, near) : "");
    const doubt = certainty !== "maybe" ? "" : list.least !== null && !swap ? this.file.weak_doubt : `only maybe: ${rival ? `'${rival}' fits` : "other words fit"} as well or better`;
    return { values: answered, threshold: level, measure: "relevancy", certainty, doubt };
  }

  /** Return the text of another colour, or of another thing, that fits better what a text fits best; "" for none. */
  private betterSwap(text: string, query: Float32Array, scores: Float32Array): string {
    const { rules, share } = this.file, others = this.words.swapped(text);
    if (!others.length) return "";
    const peak = largest(scores, ofShare(rules.peak_rows, share)), best = above(scores, peak), { codes } = this;
    for (let i = 0; best.length < ofShare(rules.peak_rows, share) && i < scores.length; i++) if (scores[i] === peak) best.push(i);
    const mean = (vector: Float32Array): number => { const tables = codes.products(vector); return best.reduce((sum, row) => sum + codes.score(row, tables), 0) / best.length; };
    const fits = others.map((other) => mean(this.words.vector(other))), top = Math.max(...fits);
    return top > mean(query) + rules.swap_tolerance ? others[fits.indexOf(top)] : "";
  }

  /** Mark the words of a list that mean the same as a text: those of a list of texts were compared when it was written. */
  private near(list: Contrast, text: string, query: Float32Array): Uint8Array {
    const near = new Uint8Array(list.vectors.length), ends = this.arrays.near_ends as Uint32Array | undefined;
    if (ends && this.words instanceof ListedWords) {
      const row = this.words.row(text);
      for (const word of (this.arrays.near as Uint16Array).subarray(row ? ends[row - 1] : 0, ends[row])) near[word] = 1;
      return near;
    }
    const count = list.vectors.length + 1, middle = query.map((x, d) => list.vectors.reduce((sum, vector) => sum + vector[d], x) / count);
    const seen = (vector: Float32Array) => vector.map((x, d) => x - middle[d]), own = seen(query), length = Math.sqrt(product(own, own));
    list.vectors.forEach((vector, k) => {
      const other = seen(vector), cosine = product(own, other) / (length * Math.sqrt(product(other, other)) || 1e-12);
      near[k] = Number(product(vector, query) > SAME || cosine > this.file.rules.same_meaning_cosine);
    });
    return near;
  }

  /** Return the words of the list that name what is of the kind of a text: canoes of "boat". */
  private sameKind(text: string): number[] {
    const { kinds } = this.file;
    if (!kinds) return [];
    const names = spellings(text), name = Object.keys(kinds).find((one) => names.includes(one.toLowerCase()));
    return name === undefined ? [] : kinds[name];
  }

  private kindScores(list: Contrast, query: Float32Array, scores: Float32Array, same: number[]): Float32Array {
    const best = scores.slice(), own = product(query, list.usual);
    for (const word of same) {
      const usual = product(list.vectors[word], list.usual) - own, every = this.codes.scores(list.vectors[word]);
      for (let i = 0; i < best.length; i++) best[i] = Math.max(best[i], every[i] - usual);
    }
    return best;
  }

  /** Return the texts that fit a shown Gaussian best, none where it has no feature. */
  wordsOf(shown: number): { text: string; score: number }[] {
    const row = this.codes.rows.indexOf(shown);
    if (row < 0) return [];
    this.vocabulary ??= (this.file.vocabulary.length ? this.file.vocabulary : this.file.texts ?? []).flatMap((text) => { try { return [{ text, vector: this.words.vector(text) }]; } catch { return []; } });
    const feature = this.codes.feature(row), rated = this.vocabulary.map(({ text, vector }) => ({ text, score: product(feature, vector) }));
    return rated.sort((a, b) => b.score - a.score).slice(0, MOST_WORDS);
  }

  /** Return, in a step for each word that is tried, the words nearest to a query which do match: query/suggesting.py. */
  *instead(text: string): Generator<void, string[]> {
    const { rules, offers } = this.file, query = this.words.vector(this.reads(text)[0]), likeness = new Map(offers.map((word) => [word, product(this.words.vector(word), query)]));
    const near = [...offers].sort((a, b) => (likeness.get(b) ?? 0) - (likeness.get(a) ?? 0)).slice(0, rules.max_words_tried), found: string[] = [];
    for (const word of near) {
      if (found.length === rules.max_words_instead) break;
      yield;
      const answered = this.answer(word);
      if (answered.certainty === "sure" && this.places(answered)[0]?.sure) found.push(word);
    }
    return found;
  }

  /** Say how near a query without a match came to one. */
  private missed({ values, threshold, measure }: Answered): string {
    const best = most(values), { best_place, below_threshold } = this.file.missed, [height, limit] = [best.toFixed(2), threshold.toFixed(2)];
    if (best <= (measure === "cosine" ? -1 : 0)) return "";
    return best_place.replace("{measure}", measure).replace("{best}", height).replace("{below}", Number(height) < Number(limit) ? below_threshold.replace("{threshold}", limit) : "");
  }

  private places({ values, threshold }: Answered): Place[] {
    return placesOf(above(values, threshold), values, this.things, this.splats, this.arrays.solid, this.codes.rows, this.file.rules, this.file.share);
  }

  /** Answer a text with its matches and its paint. */
  find(text: string, number = 0): Found {
    const answered = this.answer(text), { values, threshold, measure, certainty } = answered, { rows } = this.codes, { accents } = this.file;
    const places = this.places(answered).slice(0, MOST_MATCHES), doubt = [answered.doubt, places.length ? "" : this.missed(answered)].filter(Boolean).join(". ");
    const heat = new Uint8Array(this.splats.count), owner = new Uint8Array(this.splats.count), warm = heatOf(values, threshold);
    warm.forEach((value, i) => { heat[rows[i]] = Math.round(WARMEST * value); });
    places.forEach((place, k) => { for (const row of place.rows) owner[rows[row]] = k + 1; });
    const matches = places.map((place) => this.match(place, certainty)), limits: [number, number] = [0, 1];
    const result: Result = {
      text, summary: "", doubt, accent: accents[number % accents.length], matches, num_matches: matches.length, threshold, automatic: threshold, limits, measure, threshold_rule: "", exact: true, certainty,
    };
    return { result, heat, owner };
  }

  private eye({ center, extent }: Box, rules: Rules, radius: number): Vec {
    const part = (name: string) => this.arrays[`camera_${name}`] as Float32Array, { scale } = this, middle = this.file.center;
    const places = part("centers").map((x, i) => scale * (x - middle[i % 3]));
    return eyeFor(center, extent, radius, this.lookUp, { places, poses: part("poses"), lenses: part("K"), sizes: part("sizes") }, rules);
  }

  private match(place: Place, certainty: Certainty): Match {
    const { rules, up, radius, center } = this.file, shown = place.rows.map((row) => this.codes.rows[row]), solid = shown.filter((i) => this.arrays.solid[i]);
    const box = boxOf(this.splats, solid.length ? solid : shown, up, rules), world = box.center.map((x, k) => x / this.scale + center[k]);
    return {
      ...box, eye: this.eye(box, rules, radius), score: place.score, num_gaussians: place.rows.length, name: "",
      sure: certainty === "sure" && place.sure, object: place.thing, size: box.extent.map((x) => Number((x / this.scale).toPrecision(3)).toString()).join(" x "), place: world.map((x) => (Math.round(100 * x) / 100 + 0).toFixed(2)).join(", "),
    };
  }
}

function rowsOf(numbers: Float32Array, dim: number): Float32Array[] { return Array.from({ length: numbers.length / dim }, (_, i) => numbers.subarray(i * dim, (i + 1) * dim)); }

function above(values: Float32Array, threshold: number): number[] {
  const out: number[] = [];
  for (let i = 0; i < values.length; i++) if (values[i] > threshold) out.push(i);
  return out;
}

/** Return 0 at the median, 0.5 at the threshold, 1 at the highest value: drawing/heat.py. */
function heatOf(values: Float32Array, threshold: number): Float32Array {
  const middle = Math.min(median(values), threshold - 1e-6), top = Math.max(most(values), 0, threshold + 1e-6);
  return values.map((x) => Math.max(0, Math.min(1, x <= threshold ? (x - middle) / (2 * (threshold - middle)) : 0.5 + (x - threshold) / (2 * (top - threshold)))));
}
