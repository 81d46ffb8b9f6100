// Texts to vectors: sums of the words of the built-in encoder (photos/models/mini), or a list of texts.

import { product } from "./codes";

const NEAREST = 3, ALIKE = 0.6;

export interface Lexicon {
  words: string[]; names: string[]; colors: string[]; paints: string[]; orange: string; tones: Record<string, string>; synonyms: Record<string, string>;
  stuffs: Record<string, string>; groups: Record<string, string[]>; anything: string[]; ignored: string[]; materials: string[];
}

/** What a page reads. */
export interface Words {
  /** Return the unit vector of a text. Throws an Error that names the nearest words where one is not known. */
  vector(text: string): Float32Array;
  /** Whether a text stands in the list as it is. */
  has(text: string): boolean;
  /** Return texts that begin or go on as what is typed does. */
  suggest(typed: string, most: number): string[];
  isOnlyColors(text: string): boolean;
  /** Whether a text names a thing or a material. */
  hasNouns(text: string): boolean;
  /** Texts that have the colour or the thing of another, and not both. */
  swapped(text: string): string[];
  /** What people are shown of what is known: heads and words. */
  readonly listed: [string, string[]][];
}

export class SummedWords implements Words {
  private readonly rows: Map<string, number>;
  private readonly ignored: Set<string>;
  readonly listed: [string, string[]][];

  /** vectors: of the words, then of the colours on photos. */
  constructor(private readonly lexicon: Lexicon, private readonly vectors: Float32Array[]) {
    this.rows = new Map(lexicon.words.map((word, row) => [word, row]));
    this.ignored = new Set(lexicon.ignored);
    const { names, colors, materials } = lexicon, first = new Set([...names.flatMap((name) => name.split(" ")), ...colors, ...materials, ...lexicon.anything, lexicon.orange]);
    this.listed = [["Things", names], ["Colours", colors], ["Materials", materials], ["Kinds, uses and other names", [...lexicon.words.filter((word) => !first.has(word)), ...Object.keys(lexicon.synonyms)].sort()]];
  }

  vector(text: string): Float32Array {
    const words = this.wordsOf(text), strange = words.filter((word) => !this.rows.has(word));
    if (!words.length) throw new Error(`“${text}” has no word to look for: name a thing, such as “red mug”.`);
    if (strange.length) throw unknown(strange[0], [...this.rows.keys(), ...Object.keys(this.lexicon.synonyms)]);
    const rows = this.isOnlyColors(text) ? this.colorsIn(words).map((color) => this.lexicon.words.length + this.lexicon.colors.indexOf(color)) : words.map((word) => this.rows.get(word) as number);
    return unit(rows.map((row) => this.vectors[row]));
  }

  /** Vectors of the colours on photos, as they are. */
  get photoColors(): Float32Array[] { return this.vectors.slice(this.lexicon.words.length); }

  has(): boolean { return false; }

  suggest(typed: string, most: number): string[] {
    const at = typed.lastIndexOf(" ") + 1, before = typed.slice(0, at), begun = typed.slice(at), { names, colors, materials } = this.lexicon;
    if (!begun) return [];
    const every = [...names, ...colors.map((color) => (before ? color : `something ${color}`)), ...materials, ...this.listed[3][1]];
    return [...new Set(every.filter((word) => word !== begun && (word.startsWith(begun) || word.startsWith(`something ${begun}`))))].slice(0, most).map((word) => before + word);
  }

  isOnlyColors(text: string): boolean { return !this.hasNouns(text) && this.wordsOf(text).some((word) => !this.lexicon.anything.includes(word)); }

  hasNouns(text: string): boolean { return this.nounsIn(text).length > 0; }

  private nounsIn(text: string): string[] {
    const { paints, tones, anything } = this.lexicon;
    return this.wordsOf(text).filter((word) => !paints.includes(tones[word] ?? word) && !anything.includes(word));
  }

  /** Return "blue mug", "red vase" ... of "red mug", as photos/models/mini/lexicon.py does. */
  swapped(text: string): string[] {
    const { names, colors, materials, stuffs, groups } = this.lexicon, nouns = this.nounsIn(text), own = this.colorsIn(this.wordsOf(text));
    if (own.length !== 1 || !nouns.length) return [];
    const isOther = (name: string) => nouns.some((noun) => !name.split(" ").includes(noun) && !groups[noun]?.includes(name) && !materials.includes(stuffs[noun] ?? noun));
    return [...colors.filter((color) => color !== own[0]).map((color) => `${color} ${nouns.join(" ")}`), ...names.filter(isOther).map((name) => `${own[0]} ${name}`)];
  }

  private colorsIn(words: string[]): string[] {
    const { colors, paints, tones } = this.lexicon, color = (tone: string) => colors[paints.indexOf(tone)];
    const named = words.filter((word) => word !== "dark").map((word) => tones[word] ?? word).filter((tone) => paints.includes(tone)).map(color);
    return named.length ? named : words.filter((word) => word in tones).map((word) => color(tones[word]));
  }

  /** Return the words that count, in singular; "orange" is a colour before another word, else the fruit. */
  wordsOf(text: string): string[] {
    const spoken: string[] = text.toLowerCase().match(/\p{L}+/gu) ?? [], counting = spoken.filter((word) => !this.ignored.has(word)), painted = ["something", "anything", "one", "ones", "color", "colour"].some((word) => spoken.includes(word));
    return counting.map((word, at) => (word === "orange" && (painted || at < counting.length - 1) ? this.lexicon.orange : this.singular(word)));
  }

  private singular(word: string): string {
    if (this.rows.has(word)) return word;
    const endings = [word, word.slice(0, -1), word.slice(0, -2), `${word.slice(0, -3)}y`, `${word.slice(0, -3)}f`, `${word.slice(0, -3)}fe`];
    const single = (word.length > 3 && word.endsWith("s") ? endings : [word]).find((one) => this.rows.has(one) || Object.hasOwn(this.lexicon.synonyms, one)) ?? word;
    return Object.hasOwn(this.lexicon.synonyms, single) ? this.lexicon.synonyms[single] : single;
  }
}

export class ListedWords implements Words {
  private readonly rows: Map<string, number>;
  readonly listed: [string, string[]][];

  constructor(readonly texts: string[], readonly vectors: Float32Array[]) {
    this.rows = new Map(texts.map((text, row) => [text.toLowerCase(), row]).reverse() as [string, number][]);
    this.listed = [["Words and phrases", texts]];
  }

  vector(text: string): Float32Array { return this.vectors[this.row(text)]; }

  row(text: string): number {
    const row = spellings(text).map((one) => this.rows.get(one)).find((one) => one !== undefined);
    if (row === undefined) throw unknown(text.trim(), this.texts);
    return row;
  }

  has(text: string): boolean { return this.rows.has(text.trim().toLowerCase()); }

  suggest(typed: string, most: number): string[] {
    const inside = this.texts.filter((text) => text.toLowerCase() !== typed && text.toLowerCase().includes(typed));
    return inside.sort((a, b) => Number(!a.toLowerCase().startsWith(typed)) - Number(!b.toLowerCase().startsWith(typed))).slice(0, most);
  }

  isOnlyColors(): boolean { return false; }
  hasNouns(): boolean { return false; }
  swapped(): string[] { return []; }
}

/** Return a text in small letters, without its article, and what it may be the plural of: formats/vocabulary.py. */
export function spellings(text: string): string[] {
  const word = text.trim().toLowerCase().replace(/^(a|an|the) /, ""), whole = text.trim().toLowerCase();
  const plural = word.endsWith("s") ? [word.slice(0, -1), word.slice(0, -2), `${word.slice(0, -3)}y`] : [];
  return [whole, word, ...plural];
}

function unit(vectors: Float32Array[]): Float32Array {
  const sum = new Float32Array(vectors[0].length);
  for (const vector of vectors) for (let d = 0; d < sum.length; d++) sum[d] += vector[d];
  const length = Math.sqrt(product(sum, sum));
  return sum.map((x) => x / length);
}

function unknown(word: string, known: string[]): Error {
  const near = nearest(word, known);
  return new Error(`This page does not know “${word}”.${near.length ? ` Nearest to it are: ${near.join(", ")}.` : ""} What it knows is listed below under “Words that this page knows”.`);
}

/** Return the words most like another, by the pairs of letters that they have in common. */
export function nearest(word: string, known: string[]): string[] {
  const pairs = (text: string) => { const all = ` ${text.toLowerCase()} `; return Array.from({ length: all.length - 1 }, (_, i) => all.slice(i, i + 2)); };
  const own = pairs(word), likeness = (other: string) => {
    const left = pairs(other), size = own.length + left.length;
    let same = 0;
    for (const pair of own) { const at = left.indexOf(pair); if (at >= 0) { same++; left.splice(at, 1); } }
    return (2 * same) / size;
  };
  const rated = known.map((text): [number, string] => [likeness(text), text]).sort((a, b) => b[0] - a[0]);
  const good = rated.filter(([share]) => share >= ALIKE);
  return (good.length ? good : rated).slice(0, NEAREST).map(([, text]) => text);
}
