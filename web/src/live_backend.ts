// A running viewer: the service that this page came from.

import type { Act, Backend, Film, Growing, Header, KeyFrame, Live, Mode, Paint, Photo, SceneObject, Splats, State } from "./protocol";

const KINDS = { f4: Float32Array, f2: Uint16Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
const EACH: Record<string, number> = { centers: 3, covariances: 6, rgb: 3 }; // numbers of a row
const BYTES_A_ROW = 128; // of the page's copy and the worker's, with what both keep of it
const MEMORY = ((navigator as { deviceMemory?: number }).deviceMemory ?? 4) * 2 ** 30; // of the machine, as far as browsers say: a power of two, 8 GiB or more
const ROOM = Math.floor(MEMORY / 6 / BYTES_A_ROW); // rows: a sixth of the memory
type Arrays = Record<string, Float32Array | Uint16Array | Uint8Array | Uint32Array | undefined>;

const NOTHING: Omit<Header, "can"> = {
  title: "drsplat", about: "", eye: [8, 8, 6], target: [0, 0, 0], up: [0, 0, 1], fov: 55, heat: [], look: { dim: 1, floor: 0, greyed: 0, tint: 0 }, antialiased: false, words: [], modes: ["as it is"], objects: [], photos: [],
  times: null, film: null, plays: false,
};

export class LiveBackend implements Backend, Live {
  readonly live: Live = this;

  /** Of a catalogue no scene is open at first: its header says only what can be done. */
  async header(): Promise<Header> { return { ...NOTHING, ...(await this.json<Header>("/view/header")) }; }
  state(): Promise<State> { return this.json("/view/state"); }

  async *splats(): AsyncGenerator<Growing> {
    let splats: Splats | null = null, shown = 0;
    for await (const { arrays, begin, count, all } of this.pieces("/view/splats", ROOM)) {
      const room = Math.min(all, ROOM);
      splats ??= { count: 0, centers: new Float32Array(3 * room), covariances: new Uint16Array(6 * room), rgb: new Uint8Array(3 * room), opacity: new Uint8Array(room) };
      for (const [name, each] of [["centers", 3], ["covariances", 6], ["rgb", 3], ["opacity", 1]] as const) splats[name].set(arrays[name] as Float32Array, each * begin);
      splats.count = begin + count;
      if (splats.count < Math.min(room, 2 * shown)) continue; // so that all that is done for each is done twice at most
      shown = splats.count;
      yield { splats: firstOf(splats), room, all };
    }
  }

  async paint(count: number): Promise<Paint> {
    const { heat, owner, object } = await this.whole("/view/paint", count);
    return { heat: heat as Uint8Array, owner: owner as Uint8Array, object: (object as Uint16Array | undefined) ?? null };
  }

  async colors(mode: Mode, count: number): Promise<Uint8Array> { return (await this.whole(`/view/colors?mode=${mode}`, count)).rgb as Uint8Array; }

  readonly room = ROOM;

  async tiles(parts: number[]): Promise<Splats> {
    const { centers, covariances, rgb, opacity } = await this.all(`/view/tiles?parts=${parts}`);
    return { count: (opacity as Uint8Array).length, centers: centers as Float32Array, covariances: covariances as Uint16Array, rgb: rgb as Uint8Array, opacity: opacity as Uint8Array };
  }

  async tilesPaint(parts: number[]): Promise<{ paint: Paint; colors: Uint8Array | null }> {
    const { heat, owner, object, rgb } = await this.all(`/view/tiles-paint?parts=${parts}`);
    return { paint: { heat: heat as Uint8Array, owner: owner as Uint8Array, object: (object as Uint16Array | undefined) ?? null }, colors: (rgb as Uint8Array | undefined) ?? null };
  }

  act(act: Act): Promise<State> { return this.json("/view/do", act); }

  /** Hear of changes while the page is seen: browsers open few connections to a host. */
  listen(changed: (state: State) => void): void {
    let events: EventSource | null = null, wanted = false;
    const fetch = () => {
      if (wanted) return;
      wanted = true;
      setTimeout(() => { wanted = false; void this.state().then(changed, () => undefined); }, 30);
    };
    const follow = () => {
      events?.close();
      events = null;
      if (document.hidden) return;
      events = new EventSource("/view/events");
      events.onmessage = fetch;
      fetch();
    };
    document.addEventListener("visibilitychange", follow);
    follow();
  }

  objectPicture(object: SceneObject): string { return `/view/object-picture?number=${object.number}`; }
  photo(photo: Photo, side: number): string { return `/view/photo?name=${encodeURIComponent(photo.name)}&side=${side}`; }
  clickedPhoto(): string { return `/view/clicked-photo?${Date.now()}`; }
  cataloguePicture(number: number): string { return `/view/catalogue-picture?number=${number}&${Date.now()}`; }

  async askPicture(file: File): Promise<State> { return (await this.sent(`/view/ask-picture?name=${encodeURIComponent(file.name)}`, file)).json() as Promise<State>; }

  /** Open one scene's file, or the files of a folder. */
  async open(files: { name: string; file: File }[]): Promise<State> {
    if (files.length === 1 && !files[0].name.includes("/")) return (await this.sent(`/view/open?name=${encodeURIComponent(files[0].name)}`, files[0].file)).json() as Promise<State>;
    const batch = Array.from(crypto.getRandomValues(new Uint32Array(3)), (x) => x.toString(36)).join("");
    for (const { name, file } of files.filter((one) => !/(^|\/)\./.test(one.name))) await this.sent(`/view/upload?batch=${batch}&name=${encodeURIComponent(name)}`, file);
    return this.act({ act: "open", batch });
  }

  async file(path: string, body: unknown): Promise<{ blob: Blob; name: string; saved: string }> {
    const reply = await this.sent(path, JSON.stringify(body), "application/json");
    const name = /filename="?([^";]+)"?/.exec(reply.headers.get("content-disposition") ?? "")?.[1] ?? "drsplat";
    return { blob: await reply.blob(), name, saved: reply.headers.get("x-drsplat-saved") ?? "" };
  }

  filmProgress(job: string): Promise<{ done: number; count: number }> { return this.json(`/view/film-progress?job=${job}`); }

  flight(keys: KeyFrame[], seconds: number | null): Promise<Film> { return this.json("/view/flight", { keys, ...(seconds === null ? {} : { seconds }) }); }

  async loadPath(file: File): Promise<{ keys: KeyFrame[]; seconds: number | null }> {
    return (await this.sent("/view/load-path", await file.text(), "application/json")).json() as Promise<{ keys: KeyFrame[]; seconds: number | null }>;
  }

  catalogue(text: string): Promise<{ summary: string; entries: { number: number; title: string; scene: string; score: number }[] }> { return this.json("/view/catalogue", { text }); }

  private async json<T>(path: string, body?: unknown): Promise<T> {
    const reply = body === undefined ? await checked(await fetch(path)) : await this.sent(path, JSON.stringify(body), "application/json");
    return reply.json() as Promise<T>;
  }

  private async sent(path: string, body: BodyInit, type = "application/octet-stream"): Promise<Response> {
    return checked(await fetch(path, { method: "POST", body, headers: { "content-type": type } }));
  }

  /** Yield the arrays of the first rows, up to `most` of them, piece by piece. */
  private async *pieces(path: string, most: number): AsyncGenerator<{ arrays: Arrays; begin: number; count: number; all: number }> {
    for (let begin = 0, all = 1; begin < Math.min(all, most);) {
      const reply = await checked(await fetch(`${path}${path.includes("?") ? "&" : "?"}from=${begin}`));
      const layout = JSON.parse(reply.headers.get("x-drsplat-arrays") ?? "[]") as [string, keyof typeof KINDS, number, number][];
      all = Number(reply.headers.get("x-drsplat-rows"));
      const buffer = await reply.arrayBuffer(), [, , , first] = layout[layout.length - 1], count = Math.min(layout[layout.length - 1][0] === "rgb" ? first / 3 : first, most - begin);
      const arrays = Object.fromEntries(layout.map(([name, kind, offset, length]) => [name, new KINDS[kind](buffer, offset, Math.min(length, (EACH[name] ?? 1) * count))]));
      yield { arrays, begin, count, all };
      if (!count) return;
      begin += count;
    }
  }

  /** Return all arrays of one answer. */
  private async all(path: string): Promise<Arrays> {
    const reply = await checked(await fetch(path)), buffer = await reply.arrayBuffer();
    const layout = JSON.parse(reply.headers.get("x-drsplat-arrays") ?? "[]") as [string, keyof typeof KINDS, number, number][];
    return Object.fromEntries(layout.map(([name, kind, offset, length]) => [name, new KINDS[kind](buffer, offset, length)]));
  }

  private async whole(path: string, count: number): Promise<Arrays> {
    const parts: Arrays[] = [];
    for await (const { arrays } of this.pieces(path, count)) parts.push(arrays);
    if (parts.length === 1) return parts[0];
    return Object.fromEntries(Object.keys(parts[0]).map((name) => [name, joined(parts.map((part) => part[name] as Uint8Array | Uint16Array))]));
  }
}

function joined(parts: (Uint8Array | Uint16Array)[]): Uint8Array | Uint16Array {
  const length = parts.reduce((sum, part) => sum + part.length, 0), out = parts[0] instanceof Uint16Array ? new Uint16Array(length) : new Uint8Array(length);
  let at = 0;
  for (const part of parts) { out.set(part, at); at += part.length; }
  return out;
}

/** Return the rows that are there so far; arrays are those of the whole. */
function firstOf({ count, centers, covariances, rgb, opacity }: Splats): Splats {
  return { count, centers: centers.subarray(0, 3 * count), covariances: covariances.subarray(0, 6 * count), rgb: rgb.subarray(0, 3 * count), opacity: opacity.subarray(0, count) };
}

/** What the service throws where it no longer knows what this browser asked: the page has to be loaded again. */
export class GoneError extends Error {}

/** Return the reply. Throws an Error with the service's own sentence where it refuses. */
async function checked(reply: Response): Promise<Response> {
  if (reply.ok) return reply;
  const refusal = await reply.json().then((body: { error?: string }) => body.error, () => undefined);
  throw new (reply.status === 410 ? GoneError : Error)(refusal ?? `the viewer answered with ${reply.status}`);
}
