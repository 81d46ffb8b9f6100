// Colours that say something. The photo's own colours stay in full light where something answers; the rest is dimmed
// and loses most of its colour, but never goes black. `drsplat.fronts.viewing.painting` paints pictures and films alike.

import type { Marks } from "./drawing/raster";
import type { Color, Header, Look, Paint, Splats, State } from "./protocol";

const LIGHT_FLOOR = 0.34; // of the rest, on light paper
const OBJECT_TINT = 0.42, WHITE = 255, TURN = 0.618034;

export interface Painted { rgba: Uint8Array; marks: Marks[] }

/** Return the colours of all rows, and the rows that are outlined. */
export function painted(header: Header, state: State, splats: Splats, paint: Paint, colors: Uint8Array | null, light: boolean): Painted {
  const look = light ? { ...header.look, floor: LIGHT_FLOOR } : header.look;
  const rgba = new Uint8Array(4 * splats.count), set = setter(splats, rgba), mode = modeOf(state, colors);
  if (mode === "answer") answers(state, splats, paint, look, set);
  else if (mode === "heat map") heats(header, paint, set);
  else if (mode === "objects") objects(splats, paint, look, set);
  else if (mode !== "as it is" && colors) for (let i = 0; i < splats.count; i++) set(i, colors[3 * i], colors[3 * i + 1], colors[3 * i + 2]);
  else for (let i = 0; i < splats.count; i++) set(i, splats.rgb[3 * i], splats.rgb[3 * i + 1], splats.rgb[3 * i + 2]);
  return { rgba, marks: marks(state, paint, splats.count) };
}

/** Return the mode that can be shown: an answer of nothing leaves the scene as it is. */
function modeOf(state: State, colors: Uint8Array | null): State["mode"] {
  const empty = state.results.every((result) => !result.matches.length);
  if (state.mode === "answer" && empty) return "as it is";
  return (state.mode === "features" || state.mode === "classes") && !colors ? "as it is" : state.mode;
}

type Set = (i: number, r: number, g: number, b: number) => void;

function setter(splats: Splats, rgba: Uint8Array): Set {
  return (i, r, g, b) => {
    rgba[4 * i] = r;
    rgba[4 * i + 1] = g;
    rgba[4 * i + 2] = b;
    rgba[4 * i + 3] = splats.opacity[i];
  };
}

function rest(splats: Splats, i: number, { dim, floor, greyed }: Look, set: Set): void {
  const { rgb } = splats, r = rgb[3 * i], g = rgb[3 * i + 1], b = rgb[3 * i + 2];
  const grey = 0.299 * r + 0.587 * g + 0.114 * b, own = dim * (1 - greyed), base = WHITE * floor + dim * greyed * grey;
  set(i, base + own * r, base + own * g, base + own * b);
}

function answers(state: State, splats: Splats, paint: Paint, look: Look, set: Set): void {
  const tint = state.results.length > 1 ? look.tint : 0, { rgb } = splats;
  for (let i = 0; i < splats.count; i++) {
    const owner = paint.owner[i];
    if (!owner) { rest(splats, i, look, set); continue; }
    const accent = state.results[owner - 1]?.accent ?? [WHITE, WHITE, WHITE], r = rgb[3 * i], g = rgb[3 * i + 1], b = rgb[3 * i + 2];
    const shade = 0.45 + (0.55 * (0.299 * r + 0.587 * g + 0.114 * b)) / WHITE, mixed = (own: number, k: number) => own * (1 - tint) + accent[k] * shade * tint;
    set(i, mixed(r, 0), mixed(g, 1), mixed(b, 2));
  }
}

function heats(header: Header, paint: Paint, set: Set): void {
  const stops = header.heat, last = stops.length - 1;
  const table = Array.from({ length: 256 }, (_, k) => {
    const at = (k / 255) * last, low = Math.min(last - 1, Math.floor(at));
    return stops[low].map((x, c) => WHITE * (x + (stops[low + 1][c] - x) * (at - low)));
  });
  for (let i = 0; i < paint.heat.length; i++) { const [r, g, b] = table[paint.heat[i]]; set(i, r, g, b); }
}

function objects(splats: Splats, paint: Paint, look: Look, set: Set): void {
  const { rgb } = splats;
  for (let i = 0; i < splats.count; i++) {
    const number = paint.object ? paint.object[i] : 0;
    if (!number) { rest(splats, i, look, set); continue; }
    const [red, green, blue] = objectColor(number - 1), r = rgb[3 * i], g = rgb[3 * i + 1], b = rgb[3 * i + 2];
    const shade = 0.35 + (0.65 * (0.299 * r + 0.587 * g + 0.114 * b)) / WHITE;
    set(i, r * (1 - OBJECT_TINT) + red * shade * OBJECT_TINT, g * (1 - OBJECT_TINT) + green * shade * OBJECT_TINT, b * (1 - OBJECT_TINT) + blue * shade * OBJECT_TINT);
  }
}

/** Return the colour of an object: hues far from each other, none of them loud. */
export function objectColor(number: number): Color {
  const hue = 6 * ((number * TURN) % 1), chroma = 0.5 + 0.18 * (number % 3), part = (shift: number) => {
    const k = (shift + hue) % 6;
    return WHITE * (1 - chroma * Math.max(0, Math.min(k, 4 - k, 1)) * 0.8);
  };
  return [part(5), part(3), part(1)];
}

function marks(state: State, paint: Paint, count: number): Marks[] {
  const shown = state.mode === "answer" || state.mode === "heat map" || (state.mode === "objects" && state.chosen !== null);
  if (!shown) return [];
  const sizes = new Uint32Array(state.results.length + 1);
  for (let i = 0; i < count; i++) sizes[paint.owner[i]]++;
  const made = state.results.map((result, k) => ({ rows: new Uint32Array(sizes[k + 1] ?? 0), color: result.accent.map((x) => x / WHITE) }));
  const at = new Uint32Array(state.results.length);
  for (let i = 0; i < count; i++) { const k = paint.owner[i] - 1; if (k >= 0) made[k].rows[at[k]++] = i; }
  return made.filter((one) => one.rows.length);
}
