// Time in a page: what moves is put where it is, on straight lines between the times that the page has.

import { HALVES, toHalf } from "./halves";
import type { Clock, PageBackend } from "./page_backend";
import type { Place } from "./protocol";
import { clamp, type Vec } from "./vectors";
import type { App } from "./ui/app";

export class Moves {
  share = 0;
  isRunning = false;
  private readonly clock: Clock;
  private readonly places: Uint16Array;
  private readonly turns: Uint16Array;
  private readonly fades: Uint8Array;
  private readonly things: Place[];

  constructor(private readonly app: App, backend: PageBackend) {
    const { file, arrays } = backend;
    this.clock = file.clock as Clock;
    this.places = arrays.places as Uint16Array;
    this.turns = arrays.turns as Uint16Array;
    this.fades = arrays.fades as Uint8Array;
    const last = this.clock.at.length - 1;
    for (const one of [this.places, this.turns, this.fades]) { // each time is written as what it differs in from the one before
      const each = one.length / (last + 1);
      for (let i = each; i < one.length; i++) one[i] += one[i - each];
    }
    this.things = [...file.answers.flatMap((answer) => answer.matches), ...file.objects].filter((one) => one.boxes?.length);
  }

  /** Return the time that is shown, for people. */
  get summary(): string {
    const { at } = this.clock, place = this.share * (at.length - 1), low = Math.min(Math.floor(place), at.length - 2), t = place - low;
    return Number((at[low] * (1 - t) + at[low + 1] * t).toPrecision(4)).toString();
  }

  stand(part: number): void {
    const { clock, places, turns, fades, app } = this, { splats } = app;
    if (!splats) return;
    this.share = clamp(part, 0, 1);
    const last = clock.at.length - 1, at = this.share * last, low = Math.min(Math.floor(at), last - 1), t = at - low, { count } = clock;
    const p = 3 * count * low, c = 6 * count * low, o = count * low;
    for (let i = 0; i < 3 * count; i++) splats.centers[i] = clock.low[i % 3] + clock.step[i % 3] * (places[p + i] * (1 - t) + places[p + i + 3 * count] * t);
    for (let i = 0; i < 6 * count; i++) {
      const one = turns[c + i], other = turns[c + i + 6 * count];
      splats.covariances[i] = one === other ? one : toHalf(HALVES[one] * (1 - t) + HALVES[other] * t);
    }
    for (let i = 0; i < count; i++) splats.opacity[i] = fades[o + i] * (1 - t) + fades[o + i + count] * t + 0.5;
    for (const thing of this.things) follow(thing, low, t);
    app.stage.move(count);
    app.repaint();
    const now = document.getElementById("now"), slider = document.getElementById("time") as HTMLInputElement | null;
    if (now) now.textContent = this.summary;
    if (slider) slider.value = String(Math.round(1000 * this.share));
  }

  run(on: boolean): void {
    if (on === this.isRunning) return;
    this.isRunning = on;
    let before: number | null = null;
    const step = (now: number) => {
      if (!this.isRunning) return;
      const part = this.share + (before === null ? 0 : (now - before) / (1000 * this.clock.seconds));
      before = now;
      this.stand(part > 1 ? 0 : part); // from the first time again
      requestAnimationFrame(step);
    };
    if (on) requestAnimationFrame(step);
  }
}

/** Move a box, and the place to see it from, to where they are between two times. */
function follow(thing: Place, low: number, t: number): void {
  const one = thing.boxes?.[low] ?? null, other = thing.boxes?.[low + 1] ?? null, near = t < 0.5 ? one : other;
  thing.gone = !near;
  if (!near) return;
  const center = (one && other ? [0, 1, 2].map((i) => one[i] * (1 - t) + other[i] * t) : near.slice(0, 3)) as Vec;
  thing.eye = thing.eye.map((x, i) => x + center[i] - thing.center[i]) as Vec;
  Object.assign(thing, { center, axes: [near.slice(3, 6), near.slice(6, 9), near.slice(9, 12)], extent: near.slice(12) });
}
