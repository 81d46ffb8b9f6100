// A link that holds the question, its thresholds and the camera.

import type { Mode } from "../protocol";
import type { App } from "./app";

const PLACES = 3, THRESHOLD_PLACES = 4;

/** What was asked in words; of a page's own answers their texts. */
export function askedOf({ state }: App): string[] { return state.chosen ? [] : state.asked ?? state.results.map((result) => result.text); }

export function linkOf(app: App): string {
  const numbers = [...app.camera.eye, ...app.camera.target].map((x) => x.toFixed(PLACES)).join(","), parts = new URLSearchParams({ at: numbers });
  const { chosen, results, present, mode } = app.state, asked = askedOf(app);
  if (chosen?.number != null) parts.set("object", String(chosen.number));
  else if (asked.length) {
    parts.set("q", asked.join("; "));
    if (present) parts.set("present", "1");
    const cuts = results.map(({ threshold, automatic }) => (threshold === automatic ? "" : threshold.toFixed(THRESHOLD_PLACES)));
    if (cuts.some(Boolean)) parts.set("cut", cuts.join(","));
  }
  if (mode === "heat map" || mode === "features" || mode === "objects") parts.set("colours", mode);
  const url = new URL(location.href);
  url.hash = parts.toString();
  return url.href;
}

/** Do what the address of the page says: ask, cut, and stand there. */
export async function follow(app: App): Promise<boolean> {
  const parts = new URLSearchParams(location.hash.slice(1)), text = parts.get("q"), object = parts.get("object"), at = parts.get("at")?.split(",").map(Number) ?? [];
  if (object) await app.act({ act: "choose", number: Number(object) });
  else if (text && app.header.can.ask) {
    await app.act({ act: "ask", text, ...(parts.get("present") ? { present: true } : {}) });
    const cuts = app.backend.live ? parts.get("cut")?.split(",") ?? [] : [];
    for (const [query, value] of cuts.entries()) if (value && query < app.state.results.length) await app.act({ act: "threshold", query, value: Number(value) });
  }
  const mode = parts.get("colours") as Mode | null;
  if (mode && app.header.modes.includes(mode)) await app.act({ act: "mode", mode });
  if (at.length !== 6 || !at.every(Number.isFinite)) return Boolean(text ?? object);
  app.camera.stand([at[0], at[1], at[2]], [at[3], at[4], at[5]]);
  return true;
}

/** Load the page anew, and ask what it shows. */
export function loadAgain(app: App): void {
  history.replaceState(null, "", linkOf(app));
  location.reload();
}

export async function share(app: App): Promise<void> {
  const url = linkOf(app), what = askedOf(app).length ? "this view with this query" : "this view";
  history.replaceState(null, "", url);
  try {
    if (navigator.share && matchMedia("(pointer: coarse)").matches) await navigator.share({ title: app.header.title, url });
    else { await navigator.clipboard.writeText(url); app.say(`The link is copied: it opens ${what}.`); }
  } catch { app.say(`The address of this page now opens ${what}: copy it.`); }
}
