// The viewer: one state, shown as a picture, a panel and a line of words. Parts ask it to act; it shows what came of it.

import { Camera } from "../camera";
import { Stage } from "../drawing/stage";
import { Moves } from "../moves";
import { Overlay } from "../overlay";
import { PageBackend } from "../page_backend";
import { painted } from "../painting";
import type { Act, Backend, CameraPlace, Header, Mode, Paint, Place, Splats, State } from "../protocol";
import { AskTab } from "./ask";
import { CatalogueTab } from "./catalogue";
import { byId } from "./dom";
import { EditTab } from "./edit";
import { FilmTab } from "./film";
import type { Lasso } from "./lasso";
import { ObjectsTab } from "./objects";
import { Prompt } from "./prompt";

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
  lasso: Lasso | null = null;
  private colors: Uint8Array | null = null;
  private acting: Promise<void> = Promise.resolve();

  constructor(readonly backend: Backend, public header: Header, public state: State) {
    this.camera = new Camera(header.up, header.fov, () => this.stage?.moves());
    this.stage = new Stage(byId<HTMLCanvasElement>("splats"), this.camera);
    this.overlay = new Overlay(byId<HTMLCanvasElement>("labels"), this.camera);
    this.stage.over = (pose) => this.overlay.draw(pose, this.state);
    this.camera.stand(header.eye, header.target);
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
    this.splats = await this.backend.splats();
    this.stage.hold(this.splats, this.header.antialiased);
    await this.take(this.state, true);
    this.backend.listen((state) => void this.take(state));
  }

  /** Do one act after the other, and show what came of each. A refusal is said; it leaves all as it was. */
  act(act: Act): Promise<boolean> { return this.run(() => this.backend.act(act)); }

  run(ask: () => Promise<State>): Promise<boolean> {
    const done = this.acting.then(async () => {
      document.body.classList.add("busy");
      try {
        await this.take(await ask());
        this.say("");
        return true;
      } catch (error) {
        this.say(error instanceof Error ? error.message : String(error), true);
        return false;
      } finally {
        document.body.classList.remove("busy");
      }
    });
    this.acting = done.then(() => undefined);
    return done;
  }

  /** Show a state; what has not changed since the last one is not fetched again. */
  private async take(state: State, first = false): Promise<void> {
    const before = this.state;
    if (!first && state.scene !== before.scene) { location.assign(location.pathname); return; }
    if (!first && state.geometry !== before.geometry) {
      this.splats = await this.backend.splats();
      this.stage.hold(this.splats, this.header.antialiased);
    }
    if (!first && state.header !== before.header) this.header = await this.backend.header();
    const changed = first || state.paint !== before.paint || state.geometry !== before.geometry || state.mode !== before.mode;
    this.state = state;
    if (changed) {
      this.paint = await this.backend.paint();
      this.colors = state.mode === "features" || state.mode === "classes" ? await this.backend.colors(state.mode) : null;
      this.repaint();
    }
    this.render();
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
    document.body.classList.remove("low");
    this.render();
    byId(`tab-${tab.name}`).focus({ preventScroll: true });
  }

  /** Say something until the next act. */
  say(text: string, isFault = false): void {
    const line = byId("said");
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
