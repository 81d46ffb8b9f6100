// A path through the scene: the page's own, or key frames that one adds.

import type { Film, KeyFrame } from "../protocol";
import { clamp, mix } from "../vectors";
import type { App, Tab } from "./app";
import { button, byId, counted, download, drawer, h } from "./dom";

const SECONDS_A_KEY = 2;

export class FilmTab implements Tab {
  readonly name = "film";
  readonly label = "Film";
  keys: KeyFrame[] = [];
  private seconds: number | null = null;
  private share = 0;
  private playing = false;
  private format = "";

  constructor(private readonly app: App) { this.format = app.header.can.film_formats[0] ?? ""; }

  get isPlaying(): boolean { return this.playing; }

  /** What is played: key frames where there are two, else the page's own path. */
  get film(): Film | null {
    if (this.keys.length < 2) return this.app.header.film;
    return { seconds: this.seconds ?? SECONDS_A_KEY * (this.keys.length - 1), eyes: this.keys.map((key) => key.eye), targets: this.keys.map((key) => key.target), fovs: this.keys.map((key) => key.fov) };
  }

  show(): Node[] {
    const { film } = this, slider = h("input", { type: "range", id: "at", min: 0, max: 1000, value: Math.round(1000 * this.share), "aria-label": "Place in the film", disabled: !film });
    slider.addEventListener("input", () => { this.stop(); this.app.camera.fly(null); this.at(Number(slider.value) / 1000); });
    return [
      h("div", { class: "line" }, button(this.playing ? "Stop" : "Play", () => this.play(), { id: "play", class: "primary", disabled: !film }), slider),
      ...this.time(), h("p", { class: "faint" }, this.keys.length ? counted(this.keys.length, "key frame") : film ? "Plays the path that came with the scene." : "Add two key frames to make a film."),
      h("div", { class: "chips" }, button("Add key frame", () => this.add()), button("Drop the last", () => { this.keys.pop(); this.app.render(); }, { disabled: !this.keys.length })),
      ...(this.app.backend.live ? [drawer("Save or load", ...this.saving())] : []),
    ];
  }

  private time(): Node[] {
    const { app } = this, { times } = app.header;
    if (app.moves) {
      const { moves } = app, slider = h("input", { type: "range", id: "time", min: 0, max: 1000, value: Math.round(1000 * moves.share), "aria-label": "Time" });
      slider.addEventListener("input", () => { moves.run(false); moves.stand(Number(slider.value) / 1000); });
      return [h("h2", {}, "Time ", h("span", { id: "now" }, moves.said)), h("div", { class: "line" }, button(moves.isRunning ? "Stop" : "Play time", () => { moves.run(!moves.isRunning); app.render(); }, { id: "run" }), slider)];
    }
    if (!times || !app.state.time) return [];
    const slider = h("input", { type: "range", id: "time", min: times.first, max: times.last, step: "any", value: app.state.time.at, "aria-label": "Time" });
    slider.addEventListener("change", () => void app.act({ act: "time", at: Number(slider.value) }));
    return [h("h2", {}, `Time ${Number(app.state.time.at.toPrecision(4))}`), slider];
  }

  add(): void {
    const { eye, target, fov } = this.app.camera;
    this.keys.push({ eye, target, fov });
    this.app.say(`${counted(this.keys.length, "key frame")}. ${this.keys.length < 2 ? "Go elsewhere and add another." : "Play flies through them."}`);
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
      h("div", { class: "line" }, choice, button("Save the film", () => void app.edit.save("/view/film", { ...path(), format: this.format }), { disabled: few })),
      h("div", { class: "line" }, button("Save the path", () => void app.edit.save("/view/path", path()), { disabled: few }), button("Load a path", () => byId<HTMLInputElement>("path-file").click())),
    ];
  }

  async load(file: File): Promise<void> {
    const live = this.app.backend.live;
    if (!live) return;
    try {
      const { keys, seconds } = await live.loadPath(file);
      Object.assign(this, { keys, seconds, share: 0 });
      this.app.say(`${counted(keys.length, "key frame")} loaded.`);
      this.app.render();
    } catch (error) { this.app.say(error instanceof Error ? error.message : String(error), true); }
  }

  /** Take a picture as the canvas shows it, where nobody can draw a better one. */
  snapshot(): void { byId<HTMLCanvasElement>("splats").toBlob((blob) => { if (blob) download(blob, "drsplat.png"); }); }
}
