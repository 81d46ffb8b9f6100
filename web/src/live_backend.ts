// A running viewer: the service that this page came from.

import type { Act, Backend, Film, Header, KeyFrame, Live, Mode, Paint, Photo, SceneObject, Splats, State } from "./protocol";

const KINDS = { f4: Float32Array, f2: Uint16Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
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

  async splats(): Promise<Splats> {
    const { centers, covariances, rgb, opacity } = await this.arrays("/view/splats");
    return { count: opacity?.length ?? 0, centers: centers as Float32Array, covariances: covariances as Uint16Array, rgb: rgb as Uint8Array, opacity: opacity as Uint8Array };
  }

  async paint(): Promise<Paint> {
    const { heat, owner, match, object } = await this.arrays("/view/paint");
    return { heat: heat as Uint8Array, owner: owner as Uint8Array, match: (match as Uint16Array) ?? null, object: (object as Uint16Array) ?? null };
  }

  async colors(mode: Mode): Promise<Uint8Array> { return (await this.arrays(`/view/colors?mode=${mode}`)).rgb as Uint8Array; }

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

  flight(keys: KeyFrame[], seconds: number | null): Promise<Film> { return this.json("/view/flight", { keys, ...(seconds === null ? {} : { seconds }) }); }

  async loadPath(file: File): Promise<{ keys: KeyFrame[]; seconds: number | null }> {
    return (await this.sent("/view/load-path", await file.text(), "application/json")).json() as Promise<{ keys: KeyFrame[]; seconds: number | null }>;
  }

  catalogue(text: string): Promise<{ said: string; entries: { number: number; title: string; scene: string; score: number }[] }> { return this.json("/view/catalogue", { text }); }

  private async json<T>(path: string, body?: unknown): Promise<T> {
    const reply = body === undefined ? await checked(await fetch(path)) : await this.sent(path, JSON.stringify(body), "application/json");
    return reply.json() as Promise<T>;
  }

  private async sent(path: string, body: BodyInit, type = "application/octet-stream"): Promise<Response> {
    return checked(await fetch(path, { method: "POST", body, headers: { "content-type": type } }));
  }

  private async arrays(path: string): Promise<Arrays> {
    const reply = await checked(await fetch(path)), layout = JSON.parse(reply.headers.get("x-drsplat-arrays") ?? "[]") as [string, keyof typeof KINDS, number, number][];
    const buffer = await reply.arrayBuffer();
    return Object.fromEntries(layout.map(([name, kind, offset, count]) => [name, new KINDS[kind](buffer, offset, count)]));
  }
}

/** Return the reply. Throws an Error with the service's own sentence where it refuses. */
async function checked(reply: Response): Promise<Response> {
  if (reply.ok) return reply;
  const said = await reply.json().then((body: { error?: string }) => body.error, () => undefined);
  throw new Error(said ?? `the viewer answered with ${reply.status}`);
}
