// Many scenes: the objects of all of them that a text means; a press opens the scene of one.

import type { App, Tab } from "./app";
import { h } from "./dom";

export class CatalogueTab implements Tab {
  readonly name = "catalogue";
  readonly label = "All scenes";
  private text = "";
  private summary = "Search the objects of all scenes.";
  private entries: { number: number; title: string; scene: string; score: number }[] = [];

  constructor(private readonly app: App) {}

  show(): Node[] {
    const { live } = this.app.backend, input = h("input", { type: "text", value: this.text, placeholder: "Search all scenes", "aria-label": "Search all scenes", oninput: () => { this.text = input.value; } });
    const form = h("form", { class: "line", onsubmit: (event: Event) => { event.preventDefault(); void this.search(); } }, input, h("button", { class: "primary" }, "Search"));
    const open = (number: number) => () => void this.app.act({ act: "open_entry", number });
    return [form, h("p", { class: "faint", id: "catalogue-summary" }, this.summary), h("div", { class: "things" }, ...this.entries.map((one) =>
      h("button", { type: "button", class: "thing", onclick: open(one.number) }, live ? h("img", { src: live.cataloguePicture(one.number), alt: "" }) : null, h("span", {}, `${one.title} · ${one.scene} · ${one.score.toFixed(2)}`))))];
  }

  private async search(): Promise<void> {
    const { live } = this.app.backend;
    if (!live || !this.text.trim()) return;
    try {
      const { summary, entries } = await live.catalogue(this.text.trim());
      Object.assign(this, { summary, entries });
    } catch (error) { this.summary = error instanceof Error ? error.message : String(error); }
    this.app.render();
  }
}
