// The small tools at the picture's edge: colours, look, share, help, files that are dropped, the sheet of a phone.

import { PageBackend } from "../page_backend";
import type { Mode } from "../protocol";
import type { App } from "./app";
import { button, byId, counted, download, h } from "./dom";
import { share } from "./link";

const DARK = [0.08, 0.09, 0.11], LIGHT = [0.93, 0.94, 0.95], LOOKS = ["system", "dark", "light"] as const;
const MODE_NAMES: Record<Mode, string> = { answer: "Answer", "heat map": "Heat map", "as it is": "As it is", features: "Features", classes: "Classes", objects: "Every object" };
const SCENES = ".ply,.spz,.sog,.splat,.ksplat,.zip";

export function tools(app: App): void {
  const select = byId<HTMLSelectElement>("colours");
  select.append(...app.header.modes.map((mode) => h("option", { value: mode }, MODE_NAMES[mode])));
  select.addEventListener("change", () => app.setMode(select.value as Mode));
  byId("home").addEventListener("click", () => app.home());
  byId("share").addEventListener("click", () => void share(app));
  const help = byId<HTMLDialogElement>("keys");
  byId("help").addEventListener("click", () => { if (help.open) help.close(); else help.showModal(); });
  look(app);
  sheet();
  about(app);
  if (app.backend.live && app.header.can.open) dropping(app);
  byId("path-file").addEventListener("change", (event) => { const file = (event.target as HTMLInputElement).files?.[0]; if (file) void app.film.load(file); });
  if (app.header.can.ask_picture) asking(app);
}

/** Dark or light: as the system is set, until somebody chooses. */
function look(app: App): void {
  const wished = matchMedia("(prefers-color-scheme: light)");
  let chosen: (typeof LOOKS)[number] = "system";
  const dress = () => {
    app.light = chosen === "light" || (chosen === "system" && wished.matches);
    document.documentElement.dataset.look = app.light ? "light" : "dark";
    app.stage.background = app.light ? LIGHT : DARK;
    byId("look").setAttribute("aria-label", `Look: ${chosen}`);
    byId("look").title = `Look: ${chosen}`;
    app.repaint();
    app.stage.moves();
  };
  wished.addEventListener("change", dress);
  byId("look").addEventListener("click", () => { chosen = LOOKS[(LOOKS.indexOf(chosen) + 1) % LOOKS.length]; dress(); });
  dress();
}

function sheet(): void {
  const handle = byId("sheet");
  const told = () => handle.setAttribute("aria-expanded", String(!document.body.classList.contains("low")));
  handle.addEventListener("click", () => { document.body.classList.toggle("low"); told(); });
  let from: number | null = null;
  handle.addEventListener("pointerdown", (event) => { from = event.clientY; });
  handle.addEventListener("pointerup", (event) => {
    const by = from === null ? 0 : event.clientY - from;
    from = null;
    if (Math.abs(by) < 20) return;
    document.body.classList.toggle("low", by > 0);
    document.body.classList.toggle("high", by < -160);
    told();
  });
}

function about(app: App): void {
  byId("about").replaceChildren(h("span", { id: "rows" }, app.header.about));
  if (!(app.backend instanceof PageBackend)) return;
  const { backend } = app, take = (name: string, id: string, file: () => Promise<Blob> | Blob) =>
    button(name, async () => download(await file(), `scene.${id}`), { class: "quiet", id: `take-${id}` });
  const objects = app.header.objects.length ? "with its objects, " : "";
  byId("about").append(" ", take("Download the scene (SPZ)", "spz", () => PageBackend.spz()), " ", take(`Download it ${objects}for 3D programs (GLB)`, "glb", () => backend.glb()));
}

// --- files that are dropped ---

function dropping(app: App): void {
  const veil = byId("veil"), input = h("input", { type: "file", accept: SCENES, hidden: true, id: "scene-file" });
  document.body.append(input);
  input.addEventListener("change", () => { if (input.files?.[0]) void open(app, [{ name: input.files[0].name, file: input.files[0] }]); });
  byId("about").append(" ", button("Open a file", () => input.click(), { class: "quiet" }));
  addEventListener("dragover", (event) => { event.preventDefault(); veil.hidden = false; });
  addEventListener("dragleave", (event) => { if (!event.relatedTarget) veil.hidden = true; });
  addEventListener("drop", (event) => {
    event.preventDefault();
    veil.hidden = true;
    const entries = [...(event.dataTransfer?.items ?? [])].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
    void Promise.all(entries.map((entry) => filesOf(entry, ""))).then((files) => open(app, files.flat()));
  });
}

async function filesOf(entry: FileSystemEntry, folder: string): Promise<{ name: string; file: File }[]> {
  const name = folder + entry.name;
  if (entry.isFile) return [{ name, file: await new Promise<File>((done, failed) => (entry as FileSystemFileEntry).file(done, failed)) }];
  const reader = (entry as FileSystemDirectoryEntry).createReader(), inside: FileSystemEntry[] = [];
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((done, failed) => reader.readEntries(done, failed));
    if (!some.length) break;
    inside.push(...some);
  }
  return (await Promise.all(inside.map((one) => filesOf(one, `${name}/`)))).flat();
}

async function open(app: App, files: { name: string; file: File }[]): Promise<void> {
  const { live } = app.backend;
  if (!live || !files.length) return;
  app.say(`Opening ${files.length === 1 ? files[0].name : counted(files.length, "file")} …`);
  await app.run(() => live.open(files));
}

function asking(app: App): void {
  const input = h("input", { type: "file", accept: "image/*", hidden: true, id: "picture-file" }), { live } = app.backend;
  input.addEventListener("change", () => { const file = input.files?.[0]; if (file && live) void app.run(() => live.askPicture(file)); });
  byId("prompt").append(input);
  const picture = byId("by-picture");
  picture.hidden = false;
  picture.addEventListener("click", () => input.click());
}
