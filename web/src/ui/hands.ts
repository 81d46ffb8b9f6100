// What hands do: drag, wheel, two fingers, keys.

import type { App } from "./app";
import { byId } from "./dom";

const TURN = 0.006, CLICK_PIXELS = 5, KEY_TURN = 0.08, KEY_TILT = 0.06;

export function hands(app: App): void {
  const stage = byId("stage"), fingers = new Map<number, [number, number]>(), { camera } = app;
  let moved = 0, touches = 0;
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("pointerdown", (event) => {
    if (app.lasso?.isDrawing) return;
    stage.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    touches = Math.max(touches, fingers.size);
    if (fingers.size === 1) { moved = 0; touches = 1; }
    if (camera.isFlying) camera.fly(null);
    if (document.activeElement instanceof HTMLInputElement) document.activeElement.blur();
  });
  stage.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before[0], dy = event.clientY - before[1];
    moved += Math.abs(dx) + Math.abs(dy);
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)?.[1] ?? before;
      camera.shift(dx / 2, dy / 2);
      camera.nearer(Math.hypot(before[0] - other[0], before[1] - other[1]) / Math.max(1, Math.hypot(event.clientX - other[0], event.clientY - other[1])));
    } else if (event.buttons & 2 || event.shiftKey) camera.shift(dx, dy);
    else camera.turn(-TURN * dx, TURN * dy);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  const lifted = (event: PointerEvent) => {
    const was = fingers.delete(event.pointerId);
    if (!was || moved >= CLICK_PIXELS || touches > 1 || event.type !== "pointerup" || event.button !== 0) return;
    const { left, top } = stage.getBoundingClientRect();
    void app.act({ act: "click", origin: camera.eye, direction: camera.ray(event.clientX - left, event.clientY - top) }).then((done) => {
      if (done && app.tab.name === "film" && app.state.clicked) app.open(app.asking);
    });
  };
  stage.addEventListener("pointerup", lifted);
  stage.addEventListener("pointercancel", lifted);
  stage.addEventListener("wheel", (event) => { event.preventDefault(); camera.nearer(Math.exp(0.001 * event.deltaY)); }, { passive: false });
  walking(app);
  keys(app);
}

function walking(app: App): void {
  const held = new Set<string>(), { camera } = app;
  let timer = 0;
  const walk = () => {
    const { ahead, right } = camera.pose(), step = 0.02 * Math.max(1, camera.distance), { up } = camera;
    const along = { w: [ahead, 1], s: [ahead, -1], d: [right, 1], a: [right, -1], e: [up, 1], q: [up, -1] } as const;
    for (const key of held) { const [direction, sign] = along[key as keyof typeof along]; camera.walk(direction, sign * step); }
  };
  const let_go = () => { held.clear(); clearInterval(timer); timer = 0; };
  addEventListener("keydown", (event) => {
    const key = event.key.toLowerCase();
    if (key.length !== 1 || !"wasdeq".includes(key) || isTyping(event) || event.ctrlKey || event.metaKey) return;
    held.add(key);
    timer ||= window.setInterval(walk, 16);
  });
  addEventListener("keyup", (event) => { held.delete(event.key.toLowerCase()); if (!held.size) let_go(); });
  addEventListener("blur", let_go);
}

const isTyping = (event: KeyboardEvent): boolean => event.target instanceof HTMLElement && /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName);

function keys(app: App): void {
  const { camera } = app, select = byId<HTMLSelectElement>("colours");
  const acts: Record<string, () => void> = {
    "/": () => app.prompt.focus(), " ": () => app.film.play(), k: () => app.film.add(), r: () => app.home(), l: () => byId("look").click(), b: () => { app.overlay.visible = !app.overlay.visible; app.stage.draw(); },
    c: () => { select.selectedIndex = (select.selectedIndex + 1) % select.options.length; select.dispatchEvent(new Event("change")); },
    t: () => { if (app.moves) { app.moves.run(!app.moves.isRunning); app.render(); } }, "+": () => camera.nearer(0.9), "=": () => camera.nearer(0.9), "-": () => camera.nearer(1 / 0.9),
    ArrowLeft: () => camera.turn(-KEY_TURN, 0), ArrowRight: () => camera.turn(KEY_TURN, 0), ArrowUp: () => camera.turn(0, KEY_TILT), ArrowDown: () => camera.turn(0, -KEY_TILT),
    "?": () => byId("help").click(),
  };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) {
      if (event.key.toLowerCase() === "z" && app.header.can.edit && !isTyping(event)) { event.preventDefault(); void app.act({ act: event.shiftKey ? "redo" : "undo" }); }
      return;
    }
    if (event.key === "Escape") { app.lasso?.stop(); return; } // what is open closes by itself
    if (isTyping(event) || (event.target instanceof HTMLButtonElement && (event.key === " " || event.key === "Enter"))) return;
    const number = "123456789".indexOf(event.key), word = app.header.words[number];
    const act = number >= 0 && word ? () => app.prompt.ask(word) : acts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
}
