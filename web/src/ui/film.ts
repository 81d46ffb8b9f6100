// A path through the scene: the page's own, or key frames that one adds.

import type { Film, KeyFrame } from "../protocol";
import { clamp, mix } from "../vectors";
import type { App, Tab } from "./app";
import { button, byId, counted, drawer, h } from "./dom";

const FOLLOW_MS = 700; // between two looks at how far a film is

export class FilmTab implements Tab {
  readonly name = "film";
  readonly label = "Film";
  keys: KeyFrame[] = [];
  private seconds: number | null = null;
  private flight: Film | null = null;
  private share = 0;
  private playing = false;
  private format = "";

  constructor(private readonly app: App) { this.format = app.header.can.film_formats[0] ?? ""; }

  get isPlaying(): boolean { return this.playing; }

  /** What is played: the way through key frames where there are two, else the page's own path. */
  get film(): Film | null { return this.keys.length < 2 ? this.app.header.film : this.flight; }

  show(): Node[] {
    const { film } = this, slider = h("input", { type: "range", id: "at", min: 0, max: 1000, value: Math.round(1000 * this.share), "aria-label": "Place in the film", disabled: !film });
    slider.addEventListener("input", () => { this.stop(); this.app.camera.fly(null); this.at(Number(slider.value) / 1000); });
    return [
      h("div", { class: "line" }, button(this.playing ? "Stop" : "Play", () => this.play(), { id: "play", class: "primary", disabled: !film }), slider),
      ...this.time(), h("p", { class: "faint" }, this.keys.length ? counted(this.keys.length, "key frame") : film ? "A path through the scene." : "Add two key frames to make a film."),
      this.app.backend.live ? h("div", { class: "chips" }, button("Add key frame", () => this.add()), button("Drop the last", () => { this.keys.pop(); void this.follow(); }, { disabled: !this.keys.length })) : h("span"),
      ...(this.app.backend.live ? [drawer("Save or load", ...this.saving())] : []),
    ];
  }

  private time(): Node[] {
    const { app } = this, { times } = app.header;
    if (app.moves) {
      const { moves } = app, slider = h("input", { type: "range", id: "time", min: 0, max: 1000, value: Math.round(1000 * moves.share), "aria-label": "Time" });
      slider.addEventListener("input", () => { moves.run(false); moves.stand(Number(slider.value) / 1000); });
      return [h("h2", {}, "Time ", h("span", { id: "now" }, moves.summary)), h("div", { class: "line" }, button(moves.isRunning ? "Stop" : "Play time", () => { moves.run(!moves.isRunning); app.render(); }, { id: "run" }), slider)];
    }
    if (!times || !app.state.time) return [];
    const slider = h("input", { type: "range", id: "time", min: times.first, max: times.last, step: "any", value: app.state.time.at, "aria-label": "Time" });
    slider.addEventListener("change", () => void app.act({ act: "time", at: Number(slider.value) }));
    const [from, to] = app.state.time.during ?? [times.first, times.last], ends = [from, to].map((value, k) => h("input", { type: "number", step: "any", value, "aria-label": k ? "Queries ask until" : "Queries ask from" }));
    const span = () => void app.act({ act: "during", span: ends.map((end) => Number(end.value)) });
    return [h("h2", {}, `Time ${Number(app.state.time.at.toPrecision(4))}`), slider, drawer("Ask of a span of time", h("div", { class: "line" }, ...ends),
      h("div", { class: "chips" }, button("Ask of this span", span), button("Ask of all", () => void app.act({ act: "during", span: null }), { disabled: !app.state.time.during })))];
  }

  add(): void {
    if (!this.app.backend.live) return;
    const { eye, target, fov } = this.app.camera;
    this.keys.push({ eye, target, fov });
    this.app.say(`${counted(this.keys.length, "key frame")}. ${this.keys.length < 2 ? "Go elsewhere and add another." : "Play flies through them."}`);
    void this.follow();
  }

  /** Take the way through the key frames as they are now. */
  private async follow(): Promise<void> {
    const { live } = this.app.backend;
    this.flight = live && this.keys.length > 1 ? await live.flight(this.keys, this.seconds).catch(() => null) : null;
    this.share = 0;
    this.app.render();
  }

  /** Stand where the film is at a share of its time. */
  at(share: number): void {
    const { film } = this, { app } = this;
    if (!film) return;
    const last = film.eyes.length - 1, place = clamp(share, 0, 1) * last, low = Math.min(Math.floor(place), Math.max(0, last - 1)), high = Math.min(low + 1, last), t = place - low;
    this.share = share;
    app.moves?.stand(share); // a film goes from the first time to the last
    app.camera.fov = film.fovs[low] + (film.fovs[high] - film.fovs[low]) * t;
    app.camera.stand(mix(film.eyes[low], film.eyes[high], t), mix(film.targets[low], film.targets[high], t));
    const slider = document.getElementById("at") as HTMLInputElement | null;
    if (slider) slider.value = String(Math.round(1000 * share));
  }

  private stop(): void {
    this.playing = false;
    const label = document.getElementById("play");
    if (label) label.textContent = "Play";
  }

  play(): void {
    const { film } = this;
    if (!film) { this.app.say("There is no path yet: add two key frames."); return; }
    if (this.playing) { this.app.camera.fly(null); this.stop(); return; }
    const from = this.share >= 1 ? 0 : this.share;
    let begin: number | null = null;
    this.app.camera.fly((now) => {
      begin ??= now - 1000 * from * film.seconds;
      this.at(Math.min(1, (now - begin) / (1000 * film.seconds)));
      if (this.share >= 1) this.stop();
      return this.share >= 1;
    }, () => this.stop());
    this.playing = true;
    const label = document.getElementById("play");
    if (label) label.textContent = "Stop";
  }

  private saving(): Node[] {
    const { app } = this, { film_formats } = app.header.can, few = this.keys.length < 2;
    const choice = h("select", { "aria-label": "Format of the film", onchange: () => { this.format = choice.value; } }, ...film_formats.map((one) => h("option", { value: one, selected: one === this.format }, one.toUpperCase())));
    const path = () => ({ keys: this.keys, ...(this.seconds === null ? {} : { seconds: this.seconds }) });
    return [
      h("div", { class: "line" }, choice, button("Save the film", () => void this.save({ ...path(), format: this.format }), { disabled: few })),
      h("div", { class: "line" }, button("Save the path", () => void app.edit.save("/view/path", path()), { disabled: few }), button("Load a path", () => byId<HTMLInputElement>("path-file").click())),
    ];
  }

  /** Save the film, and say meanwhile how far it is. */
  private async save(film: object): Promise<void> {
    const { app } = this, job = Array.from(crypto.getRandomValues(new Uint32Array(3)), (x) => x.toString(36)).join("");
    let asking = 0;
    const follow = async () => {
      const { done, count } = await app.backend.live!.filmProgress(job).catch(() => ({ done: 0, count: 0 }));
      if (!asking) return;
      if (count) app.say(`Drawing the film: ${done} of ${counted(count, "picture")}.`);
      asking = window.setTimeout(() => void follow(), FOLLOW_MS);
    };
    asking = window.setTimeout(() => void follow(), FOLLOW_MS);
    try { await app.edit.save("/view/film", { ...film, job }); } finally { clearTimeout(asking); asking = 0; }
  }

  async load(file: File): Promise<void> {
    const live = this.app.backend.live;
    if (!live) return;
    try {
      const { keys, seconds } = await live.loadPath(file);
      Object.assign(this, { keys, seconds });
      this.app.say(`${counted(keys.length, "key frame")} loaded.`);
      await this.follow();
    } catch (error) { this.app.say(error instanceof Error ? error.message : String(error), true); }
  }
}
