// The viewer: one state, shown as a picture, a panel and a line of words. Parts ask it to act; it shows what came of it.

import { Camera } from "../camera";
import { Stage } from "../drawing/stage";
import { GoneError } from "../live_backend";
import { Moves } from "../moves";
import { Overlay } from "../overlay";
import { PageBackend } from "../page_backend";
import { painted } from "../painting";
import { TileSet, type Shown } from "../tiles";
import type { Act, Backend, CameraPlace, Growing, Header, Mode, Paint, Place, Splats, State } from "../protocol";
import { AskTab } from "./ask";
import { CatalogueTab } from "./catalogue";
import { byId, counted } from "./dom";
import { EditTab } from "./edit";
import { loadAgain } from "./link";
import { FilmTab } from "./film";
import type { Lasso } from "./lasso";
import { ObjectsTab } from "./objects";
import { Prompt } from "./prompt";

const LOOK_MS = 150; // after the last movement
const EDITS = new Set(["edit", "undo", "redo", "restore"]);

export interface Tab { readonly name: string; readonly label: string; show(): Node[] }

export class App {
  readonly camera: Camera;
  readonly stage: Stage;
  readonly overlay: Overlay;
  readonly prompt: Prompt;
  readonly film: FilmTab;
  readonly edit: EditTab;
  readonly moves: Moves | null;
  readonly tabs: Tab[];
  tab: Tab;
  splats: Splats | null = null;
  paint: Paint | null = null;
  light = false;
  isWhole = false; // whether all rows that there is room for are here
  lasso: Lasso | null = null;
  private colors: Uint8Array | null = null;
  private acting: Promise<void> = Promise.resolve();
  private changing: Promise<void> = Promise.resolve();
  private working = 0; // acts and files that are waited for
  private showing: Promise<void> = Promise.resolve();
  private tiles: TileSet | null = null; // of a scene that comes part by part
  private looking = 0;
  private loading = 0; // which of the scenes that were begun is wanted

  constructor(readonly backend: Backend, public header: Header, public state: State) {
    this.camera = new Camera(header.up, header.fov, () => { this.stage?.moves(); this.look(); });
    this.stage = new Stage(byId<HTMLCanvasElement>("splats"), this.camera);
    this.overlay = new Overlay(byId<HTMLCanvasElement>("labels"), this.camera);
    this.stage.over = (pose) => this.overlay.draw(pose, this.state);
    this.camera.stand(header.eye, header.target);
    if (header.tiles && backend.live) this.tiles = new TileSet(backend.live, header.tiles, this.camera, (shown, isWhole) => this.present(shown, isWhole), () => { this.isWhole = true; }, (error) => this.say(error instanceof Error ? error.message : String(error), true));
    this.moves = backend instanceof PageBackend && backend.file.clock ? new Moves(this, backend) : null;
    this.prompt = new Prompt(this);
    this.film = new FilmTab(this);
    this.edit = new EditTab(this);
    this.tabs = [
      ...(header.can.catalogue ? [new CatalogueTab(this)] : []), ...(header.can.ask ? [new AskTab(this)] : []), ...(header.objects.length ? [new ObjectsTab(this)] : []),
      ...(header.can.edit ? [this.edit] : []), this.film,
    ];
    this.tab = state.results.length ? this.asking : this.tabs[0];
  }

  /** Where answers are listed; of a scene that cannot be asked, the first tab. */
  get asking(): Tab { return this.tabs.find((tab) => tab.name === "ask") ?? this.tabs[0]; }

  async begin(): Promise<void> {
    await this.inTurn(() => this.show(this.state, true));
    this.backend.listen((state) => void this.take(state));
  }

  /** Do one act after the other, and show what came of each. A refusal is said; it leaves all as it was. Edits wait for
   * each other alone: the service computes them beside what it shows. */
  act(act: Act): Promise<boolean> {
    const ask = () => this.backend.act(act);
    if (!EDITS.has(act.act)) return this.run(ask);
    const done = this.doneAfter(this.changing, ask);
    this.changing = done.then(() => undefined);
    return done;
  }

  run(ask: () => Promise<State>): Promise<boolean> {
    const done = this.doneAfter(this.acting, ask);
    this.acting = done.then(() => undefined);
    return done;
  }

  /** Show for as long as something lasts that it is being worked on. */
  busy(by: 1 | -1): void {
    this.working += by;
    document.body.classList.toggle("busy", this.working > 0);
  }

  private doneAfter(before: Promise<unknown>, ask: () => Promise<State>): Promise<boolean> {
    return before.then(async () => {
      this.forgive();
      this.busy(1);
      try {
        const state = await ask();
        if (state.revision >= this.state.revision) await this.take(state); // else what came later is shown already
        this.say(state.results.length ? "" : state.message);
        return true;
      } catch (error) {
        if (error instanceof GoneError) loadAgain(this);
        this.say(error instanceof Error ? error.message : String(error), true);
        return false;
      } finally {
        this.busy(-1);
      }
    });
  }

  /** Show one thing after the other: each leaves rows and colours that belong together. */
  private inTurn(show: () => Promise<void>): Promise<void> {
    const done = this.showing.then(show);
    this.showing = done.catch(() => undefined);
    return done;
  }

  private take(state: State): Promise<void> { return this.inTurn(() => this.show(state)); }

  /** Show a state; what has not changed since the last one is not fetched again. */
  private async show(state: State, first = false): Promise<void> {
    const before = this.state;
    if (!first && state.scene !== before.scene) { location.assign(location.pathname); return; }
    if (!first && state.header !== before.header) this.header = await this.backend.header();
    this.state = state;
    if (first || state.geometry !== before.geometry) await this.load();
    else if (this.tiles && (state.paint !== before.paint || state.mode !== before.mode)) await this.tiles.repaint();
    else if (state.paint !== before.paint || state.mode !== before.mode) { await this.fetchPaint(this.splats?.count ?? 0); this.repaint(); }
    this.render();
  }

  /** Show the first rows of a scene; the others come while people look around. */
  private async load(): Promise<void> {
    if (this.tiles) { void this.tiles.stream(); return; }
    const own = ++this.loading, scenes = this.backend.splats(), first = await scenes.next();
    if (first.done) return;
    await this.grow(first.value, 0);
    void this.rest(scenes, own).catch((error: unknown) => this.say(error instanceof Error ? error.message : String(error), true));
  }

  private async rest(scenes: AsyncGenerator<Growing>, own: number): Promise<void> {
    for await (const scene of scenes) {
      await this.inTurn(async () => { if (own === this.loading) await this.grow(scene, this.splats?.count ?? 0); });
      if (own !== this.loading) return;
    }
  }

  /** Take more rows, with their colours. */
  private async grow({ splats, room, all }: Growing, from: number): Promise<void> {
    await this.fetchPaint(splats.count);
    this.splats = splats;
    this.stage.hold(splats, this.header.antialiased, from, room);
    this.repaint();
    this.isWhole = splats.count === room;
    const left = room < all ? ` This browser has room for ${room.toLocaleString("en")} of ${counted(all, "Gaussian")}.` : "";
    byId("rows").textContent = `${this.header.about}${left}${this.isWhole ? "" : ` Here so far: ${splats.count.toLocaleString("en")}.`}`;
  }

  /** Let tiles come where the camera stands, once it stands. */
  private look(): void {
    if (!this.tiles) return;
    this.isWhole = false;
    clearTimeout(this.looking);
    this.looking = window.setTimeout(() => {
      if (this.camera.isFlying) this.look();
      else void this.tiles?.stream();
    }, LOOK_MS);
  }

  /** Show the parts of tiles that are here. */
  private present({ splats, paint, colors }: Shown, isWhole: boolean): void {
    Object.assign(this, { splats, paint, colors, isWhole });
    this.stage.hold(splats, this.header.antialiased);
    this.repaint();
    const number = this.header.tiles?.tiles.length ?? 0;
    byId("rows").textContent = `${this.header.about} Here are ${counted(splats.count, "Gaussian")}: all tiles coarsely, ${this.tiles?.numWhole ?? 0} of ${number} wholly, those near the camera. Answers are of all.`;
  }

  private async fetchPaint(count: number): Promise<void> {
    const { mode } = this.state;
    this.paint = await this.backend.paint(count);
    this.colors = mode === "features" || mode === "classes" ? await this.backend.colors(mode, count) : null;
  }

  repaint(): void {
    if (!this.splats || !this.paint) return;
    const { rgba, marks } = painted(this.header, this.state, this.splats, this.paint, this.colors, this.light);
    this.stage.paint(rgba);
    this.stage.mark(marks);
  }

  /** Write the panel anew. */
  render(): void {
    const bar = byId("tabs");
    bar.replaceChildren(...this.tabs.map((tab) => {
      const made = document.createElement("button");
      Object.assign(made, { type: "button", textContent: tab.label, id: `tab-${tab.name}` });
      made.setAttribute("role", "tab");
      made.setAttribute("aria-selected", String(tab === this.tab));
      made.setAttribute("aria-controls", "content");
      made.addEventListener("click", () => this.open(tab));
      return made;
    }));
    bar.hidden = this.tabs.length < 2;
    byId("content").replaceChildren(...this.tab.show());
    byId("content").setAttribute("aria-labelledby", `tab-${this.tab.name}`);
    byId<HTMLSelectElement>("colours").value = this.state.mode;
    this.prompt.follow();
    this.stage.draw();
  }

  open(tab: Tab): void {
    this.tab = tab;
    this.forgive();
    document.body.classList.remove("low");
    this.render();
    byId(`tab-${tab.name}`).focus({ preventScroll: true });
  }

  /** Take back what was refused: something else is asked or looked at. */
  private forgive(): void { if (byId("message").classList.contains("fault")) this.say(""); }

  /** Say something until the next act. */
  say(text: string, isFault = false): void {
    const line = byId("message");
    line.textContent = text;
    line.classList.toggle("fault", isFault);
    line.hidden = !text;
  }

  setMode(mode: Mode): void { void this.act({ act: "mode", mode }); }

  flyTo(place: Place): void { if (!place.gone) this.camera.flyTo(place.eye, place.center); }

  home(): void {
    this.camera.fov = this.header.fov;
    this.camera.flyTo(this.header.eye, this.header.target);
  }

  get place(): CameraPlace {
    const { eye, target, fov, width, height } = this.camera;
    return { eye, target, fov, width: Math.round(width), height: Math.round(height) };
  }
}
