// Changes of what is selected: each can be undone, none touches the scene's file.

import type { App, Tab } from "./app";
import { button, counted, download, drawer, h } from "./dom";

export class EditTab implements Tab {
  readonly name = "edit";
  readonly label = "Edit";
  private color = "#3a86ff";
  private by = ["0", "0", "0.3"];
  private factor = "1.5";
  private degrees = "45";
  private note = "";
  private compared: string | null = null;

  constructor(private readonly app: App) {}

  show(): Node[] {
    return [this.selected(), h("p", { class: "faint", id: "shared" }, "Edits, notes and names are shared: everyone who has this viewer open sees them."), this.changes(), drawer("More changes", ...this.more()), drawer("Annotations", ...this.notes()), drawer("Before and after", ...this.compare()), this.list(), drawer("Save as", ...this.saving())];
  }

  private change(change: string, more: object = {}): () => void {
    return () => void this.app.act({ act: "edit", change, ...more }).then((done) => {
      if (done) this.app.say(`Done: ${change}. It is kept beside the scene; the scene's own file stays as it is.`);
    });
  }

  /** Two edits, as filling alone leaves the thing where it is. */
  private async fill(): Promise<void> {
    const done = await this.app.act({ act: "edit", change: "remove" }) && await this.app.act({ act: "edit", change: "fill" });
    if (done) this.app.say("Removed, and the hole is filled: two edits, which Undo takes back one by one.");
  }

  private selected(): Node {
    const { selection, chosen, results } = this.app.state, name = chosen?.name ?? results.map((result) => result.text).join(", ");
    const text = selection ? `Selected: ${name || "what you drew around"}, ${counted(selection, "Gaussian")}` : this.app.header.can.ask ? "Nothing is selected: ask, click something, or draw around it." : "Nothing is selected: draw around what you mean.";
    return h("div", { class: "selected" }, h("p", {}, text), h("div", { class: "chips" },
      button("Box", () => this.app.lasso?.begin("box"), { title: "Drag a box around what you mean" }), button("Lasso", () => this.app.lasso?.begin("lasso"), { title: "Draw around what you mean" }),
      selection ? button("Let go", () => void this.app.act({ act: "clear" })) : null));
  }

  private changes(): Node {
    const none = !this.app.state.selection;
    return h("div", { class: "grid" }, button("Cut out", this.change("isolate"), { class: "primary", disabled: none, title: "Keep nothing but this" }),
      button("Remove", this.change("remove"), { disabled: none }), button("Remove and fill", () => void this.fill(), { disabled: none, title: "Fill the hole with what is around it" }),
      button("Undo", () => void this.app.act({ act: "undo" }), { disabled: !this.app.state.can_undo }), button("Redo", () => void this.app.act({ act: "redo" }), { disabled: !this.app.state.can_redo }));
  }

  private more(): Node[] {
    const none = !this.app.state.selection;
    const color = h("input", { type: "color", value: this.color, "aria-label": "Colour", oninput: () => { this.color = color.value; } });
    const numbers = this.by.map((value, k) => {
      const input = h("input", { type: "number", step: 0.05, value, "aria-label": `By along ${"xyz"[k]}`, oninput: () => { this.by[k] = input.value; } });
      return input;
    });
    const factor = h("input", { type: "number", step: 0.1, value: this.factor, "aria-label": "Factor", oninput: () => { this.factor = factor.value; } });
    const degrees = h("input", { type: "number", step: 5, value: this.degrees, "aria-label": "Degrees", oninput: () => { this.degrees = degrees.value; } });
    const by = () => ({ by: this.by.map(Number) }), run = (change: string, more: () => object) => () => this.change(change, more())();
    return [
      h("div", { class: "line" }, color, button("Recolour", run("recolour", () => ({ color: this.color })), { disabled: none })),
      h("div", { class: "line" }, ...numbers), h("div", { class: "line" }, button("Move", run("move", by), { disabled: none }), button("Duplicate", run("duplicate", by), { disabled: none })),
      h("div", { class: "line" }, degrees, button("Turn", run("turn", () => ({ number: Number(this.degrees) })), { disabled: none })),
      h("div", { class: "line" }, factor, button("Scale", run("scale", () => ({ number: Number(this.factor) })), { disabled: none }), button("Opacity", run("opacity", () => ({ number: Number(this.factor) })), { disabled: none })),
    ];
  }

  private notes(): Node[] {
    const input = h("input", { type: "text", value: this.note, placeholder: "A note", "aria-label": "Text of the annotation", maxlength: 200, oninput: () => { this.note = input.value; } });
    const keep = (at: string) => () => { if (this.note.trim()) void this.app.act({ act: "annotate", text: this.note.trim(), at }).then((done) => { if (done) { this.note = ""; this.app.render(); } }); };
    const listed = this.app.state.annotations.map((one, k) => h("div", { class: "line" }, button(one.text, () => this.app.camera.flyTo(one.eye, one.center), { class: "grow" }),
      button("Drop", () => void this.app.act({ act: "drop_annotation", number: k + 1 }), { "aria-label": `Drop the annotation ${one.text}` })));
    return [input, h("div", { class: "line" }, button("At the selection", keep("selection")), button("At the click", keep("click"))), ...listed];
  }

  /** Both sides from where one looks now, with a border to move. */
  private compare(): Node[] {
    const make = () => void this.file("/view/before-after", { camera: this.app.place }).then((made) => { if (made) { this.compared = URL.createObjectURL(made.blob); this.app.render(); } });
    const split = this.compared ? h("div", { class: "split", style: "--at:50%" }) : null;
    if (split && this.compared) {
      const range = h("input", { type: "range", min: 0, max: 100, value: 50, "aria-label": "Border between before and after", oninput: () => split.style.setProperty("--at", `${range.value}%`) });
      split.append(h("div", { class: "side before", style: `background-image:url(${this.compared})` }), h("div", { class: "side after", style: `background-image:url(${this.compared})` }), range);
    }
    return [button("Draw both", make, { disabled: !this.app.state.can_undo }), split ?? h("span")];
  }

  private list(): Node {
    const { edits } = this.app.state;
    return edits.length ? h("ol", { class: "edits" }, ...edits.map((edit) => h("li", { class: edit.done ? "" : "undone" }, `${edit.what} ${edit.target}${edit.done ? "" : " (undone)"}`))) : h("p", { class: "faint" }, "No edits yet.");
  }

  private saving(): Node[] {
    const camera = this.app.place, save = (what: string, format = ".ply") => () => void this.save("/view/save", { what, format, camera });
    return [h("div", { class: "grid" }, button("Scene (PLY)", save("scene")), button("Selection (PLY)", save("selection"), { disabled: !this.app.state.selection }),
      button("Scene (GLB)", save("scene", ".glb")), button("Selection (GLB)", save("selection", ".glb"), { disabled: !this.app.state.selection }),
      button("Picture (PNG)", () => void this.save("/view/picture", { camera: this.app.place })), button("Swing (GIF)", save("swing")), button("Page (HTML)", () => void this.save("/view/page", {})))];
  }

  async file(path: string, body: unknown): Promise<{ blob: Blob; name: string; saved: string } | null> {
    const live = this.app.backend.live;
    if (!live) return null;
    this.app.busy(1);
    try { return await live.file(path, body); } catch (error) { this.app.say(error instanceof Error ? error.message : String(error), true); return null; } finally { this.app.busy(-1); }
  }

  async save(path: string, body: unknown): Promise<void> {
    const made = await this.file(path, body);
    if (!made) return;
    download(made.blob, made.name);
    this.app.say(made.saved ? `Saved as ${made.saved}` : `Sent as ${made.name}`);
  }
}
