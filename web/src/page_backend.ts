// Answers that are in the page's own file: nothing is fetched, nobody is asked.

import { glbOf } from "./glb";
import { pick } from "./picking";
import type { Act, Backend, Growing, Header, Mode, Paint, Result, SceneObject, Splats, State } from "./protocol";
import { splatsOf } from "./spz";
import type { Vec } from "./vectors";

import { Search, type Arrays, type Found, type SearchFile } from "./search/search";

type Layout = [string, "f4" | "f2" | "u1" | "u2" | "u4", number, number][];
const KINDS = { f4: Float32Array, f2: Uint16Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array }, MOST_SUGGESTED = 6;

/** What a page's file says beside a header: its answers, in the order of its arrays heat0, owner0, heat1, ... */
export interface PageFile extends Header {
  answers: Result[]; arrays: Layout; frame: { center: Vec; scale: number };
  annotations: State["annotations"]; clock: Clock | null; search: SearchFile | null;
}

/** Times of a scene that moves; see `Moves`. */
export interface Clock { at: number[]; count: number; low: Vec; step: Vec; seconds: number }

export class PageBackend implements Backend {
  readonly live = null;
  private readonly results: Result[];
  private object = -1; // index of the object that was chosen
  private now: State;
  private readonly scene: Promise<Splats>;
  readonly search: Promise<Search> | null;
  private searching: Search | null = null; // once it is ready
  private readonly found = new Map<Result, Found>();
  private changed: (state: State) => void = () => {};

  private constructor(readonly file: PageFile, readonly arrays: Arrays, scene: Promise<Splats>) {
    this.scene = scene;
    const { search, frame, up } = file;
    this.search = search ? scene.then((splats) => (this.searching = new Search(search, arrays, splats, up, frame.scale))) : null;
    void this.search?.then((ready) => this.prepare(ready));
    this.results = file.answers;
    const mode: Mode = file.answers.length && !file.plays ? "answer" : "as it is";
    this.now = {
      revision: 0, scene: 0, header: 0, geometry: 0, paint: 0, mode, message: "", selection: 0, results: file.answers.slice(0, 1), clicked: null, chosen: null,
      classes: null, edits: [], can_undo: false, can_redo: false, annotations: file.annotations, time: null, kept: false,
    };
  }

  /** Read what is in the document. */
  static async read(): Promise<PageBackend> {
    const text = (id: string) => document.getElementById(id)?.textContent ?? "";
    const file = JSON.parse(text("header")) as PageFile;
    const buffer = await inflated(text("blob"), "deflate");
    const arrays = Object.fromEntries(file.arrays.map(([name, kind, offset, length]) => [name, new KINDS[kind](buffer, offset, length)]));
    const scene = inflated(sceneText(), "gzip").then((bytes) => splatsOf(bytes, file.frame));
    return new PageBackend(file, arrays, scene);
  }

  /** Do what a first question needs, a step at a time between pictures. */
  private async prepare(search: Search): Promise<void> {
    for (const _ of search.preparing()) await new Promise((done) => setTimeout(done, 0));
  }

  header(): Promise<Header> { return Promise.resolve(this.file); }
  state(): Promise<State> { return Promise.resolve(this.now); }
  async *splats(): AsyncGenerator<Growing> { const splats = await this.scene; yield { splats, room: splats.count, all: splats.count }; }
  listen(changed: (state: State) => void): void { this.changed = changed; }
  objectPicture(object: SceneObject): string { return object.picture ?? ""; }
  colors(): Promise<Uint8Array> { return Promise.resolve(this.arrays.features as Uint8Array); }

  async paint(): Promise<Paint> {
    const { count } = await this.scene, object = (this.arrays.objects as Uint16Array | undefined) ?? null;
    const heat = new Uint8Array(count), owner = new Uint8Array(count);
    if (this.object >= 0 && object) for (let i = 0; i < count; i++) { if (object[i] === this.object + 1) { owner[i] = 1; heat[i] = 255; } }
    else {
      this.now.results.forEach((result, k) => {
        const found = this.found.get(result), number = this.results.indexOf(result), warm = found?.heat ?? this.arrays[`heat${number}`], own = found?.owner ?? this.arrays[`owner${number}`];
        if (!warm || !own) return;
        for (let i = 0; i < count; i++) { heat[i] = Math.max(heat[i], warm[i]); if (own[i] && !owner[i]) owner[i] = k + 1; }
      });
    }
    return { heat, owner, object };
  }

  async act(act: Act): Promise<State> {
    const change = await this.change(act);
    this.now = { ...this.now, ...change, revision: this.now.revision + 1, paint: this.now.paint + 1 };
    return this.now;
  }

  private async change(act: Act): Promise<Partial<State>> {
    switch (act.act) {
      case "ask": return this.ask(String(act.text));
      case "choose": return this.choose(this.file.objects.findIndex((one) => one.number === act.number));
      case "click": return this.click(act.origin as Vec, act.direction as Vec);
      case "mode": return { mode: act.mode as Mode };
      case "clear":
        this.object = -1;
        return { results: [], mode: "as it is", clicked: null, chosen: null, message: "" };
      default: throw new Error("This page was made to look at: open the scene with drsplat view to change it.");
    }
  }

  suggest(typed: string): string[] { return typed ? this.searching?.suggest(typed, MOST_SUGGESTED) ?? [] : []; }
  known(): [string, string[]][] { return this.searching?.words.listed ?? []; }

  /** Answer with what the page has, several queries with ";" between them: answers, names of objects, words that it knows. */
  private async ask(text: string): Promise<Partial<State>> {
    const asked = text.split(";").map((part) => part.trim()).filter(Boolean), results: Result[] = [], search = await this.search;
    this.found.clear();
    for (const one of asked) {
      const same = (other: string) => other.toLowerCase() === one.toLowerCase(), result = this.results.find((answer) => same(answer.text));
      if (result) results.push(result);
      else {
        const object = this.file.objects.findIndex((thing) => same(thing.name));
        if (object >= 0 && asked.length === 1) return this.choose(object);
        if (search) { results.push(this.answered(search, one, results.length)); continue; }
        throw new Error(`This page has no answer to “${one}”. It knows: ${[...this.results.map((answer) => answer.text), ...this.file.objects.map((thing) => thing.name)].slice(0, 8).join(", ")}.`);
      }
    }
    this.object = -1;
    return { results, mode: "answer", clicked: null, chosen: null, message: results.map((result) => result.summary).join(" ") };
  }

  /** Answer words that nobody asked when the page was written. */
  private answered(search: Search, text: string, number: number): Result {
    const found = search.find(text, number);
    this.found.set(found.result, found);
    if (!found.result.matches.length) void this.offer(search, found.result);
    return found.result;
  }

  /** Name words that do match beside an answer without one, once it is shown, a step at a time between pictures. */
  private async offer(search: Search, result: Result): Promise<void> {
    const looking = search.instead(result.text);
    for (let step = looking.next(); ; step = looking.next()) {
      await new Promise((done) => setTimeout(done, 0));
      if (!this.now.results.includes(result)) return;
      if (step.done) { result.instead = step.value; break; }
    }
    this.now = { ...this.now, revision: this.now.revision + 1 };
    this.changed(this.now);
  }

  private choose(index: number): Partial<State> {
    const object = this.file.objects[index];
    if (!object) throw new Error("This page has no such object.");
    this.object = index;
    const match = { ...object, score: 1, place: "" };
    const result: Result = {
      text: object.name, summary: "", doubt: "", accent: [255, 170, 30], matches: [match], num_matches: 1, threshold: 0, automatic: 0, limits: [0, 1], measure: "", threshold_rule: "", exact: true,
    };
    const chosen = { name: object.name, number: object.number, smaller: false, larger: false, num_gaussians: object.num_gaussians, photos: 0, label: false };
    return { results: [result], mode: "answer", chosen, message: object.name };
  }

  private async click(eye: Vec, direction: Vec): Promise<Partial<State>> {
    const row = pick(await this.scene, eye, direction), search = await this.search, objects = this.arrays.objects;
    if (row < 0) return { clicked: null };
    const words = search?.wordsOf(row) ?? [], object = objects ? objects[row] - 1 : -1;
    const clicked = { name: words[0]?.text ?? "", words, place: "", support: [], photo: false };
    const of = this.results.filter((_, k) => (this.arrays[`owner${k}`] as Uint8Array)[row]).map((result) => result.text);
    return { ...(object >= 0 ? this.choose(object) : {}), clicked: { ...clicked, place: of.length ? `match of: ${of.join(", ")}` : "" } };
  }

  /** Return the scene as a file of its own, as others read it. */
  static spz(): Blob { return new Blob([bytesOf(sceneText())], { type: "application/octet-stream" }); }

  /** Return the scene with its named objects. */
  async glb(): Promise<Blob> {
    const { title, objects, frame, antialiased } = this.file;
    return glbOf(await inflated(sceneText(), "gzip"), { title, objects, numbers: (this.arrays.objects as Uint16Array | undefined) ?? null, frame, antialiased });
  }
}

function sceneText(): string { return document.getElementById("scene")?.textContent ?? ""; }

function bytesOf(base64: string): Uint8Array<ArrayBuffer> { return Uint8Array.from(atob(base64.trim()), (c) => c.charCodeAt(0)); }

async function inflated(base64: string, format: CompressionFormat): Promise<ArrayBuffer> {
  return new Response(new Blob([bytesOf(base64)]).stream().pipeThrough(new DecompressionStream(format))).arrayBuffer();
}
