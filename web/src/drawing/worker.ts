// Beside the page's thread: sorts for a graphics card, or draws where there is none.

import { Raster, type Marks } from "./raster";
import { Sorter, type Held, type Lens } from "./project";

export type Order =
  | { do: "hold"; held: Held }
  | { do: "move"; centers: Float32Array; covariances: Float32Array } // of the first rows
  | { do: "paint"; rgba: Uint8Array }
  | { do: "mark"; marks: Marks[] }
  | { do: "sort"; lens: Lens; limit: number }
  | { do: "draw"; lens: Lens; limit: number; background: number[] };

export type Reply =
  | { done: "sort"; rows: Uint32Array }
  | { done: "draw"; picture: Uint8ClampedArray<ArrayBuffer>; lens: Lens; ms: number };

const scope = self as unknown as { onmessage: (event: MessageEvent<Order>) => void; postMessage(message: Reply, transfer: Transferable[]): void };
const sorter = new Sorter(), raster = new Raster();
let held: Held | null = null, marks: Marks[] = [];

let latest = 0; // number of the newest order to draw: older ones are given up

/** Let orders in that have come meanwhile; a timer would wait for milliseconds. */
const channel = new MessageChannel();
let waiting: (() => void) | null = null;
channel.port1.onmessage = () => waiting?.();
const pause = () => new Promise<void>((done) => { waiting = done; channel.port2.postMessage(null); });

async function draw(held: Held, { lens, limit, background }: Extract<Order, { do: "draw" }>): Promise<void> {
  const begin = performance.now(), own = ++latest, steps = raster.draw(held, lens, background, limit);
  let step = steps.next();
  for (; !step.done; step = steps.next()) {
    await pause();
    if (own !== latest) return;
  }
  raster.outline(step.value, held, lens, marks, Math.max(1, Math.round(lens.height / 350)));
  scope.postMessage({ done: "draw", picture: step.value, lens, ms: performance.now() - begin }, [step.value.buffer]);
}

scope.onmessage = ({ data: order }) => {
  if (order.do === "hold") held = order.held;
  else if (order.do === "mark") marks = order.marks;
  else if (!held) return;
  else if (order.do === "move") {
    held.centers.set(order.centers);
    held.covariances.set(order.covariances);
  } else if (order.do === "paint") held.rgba = order.rgba;
  else if (order.do === "sort") {
    const rows = sorter.sorted(held, order.lens, order.limit).slice().reverse(); // a card blends back to front
    scope.postMessage({ done: "sort", rows }, [rows.buffer]);
  } else void draw(held, order);
};
