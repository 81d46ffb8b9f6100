// Time in a page: what moves is put where it is, on straight lines between the times that the page has.
"use strict";
addEventListener("drsplat", () => {
  const own = window.drsplat, { header, arrays, half } = own, clock = header.times, $ = (id) => document.getElementById(id);
  if (!clock) return;
  const { places, turns, fades, centers, covariances, opacity } = arrays, count = clock.count, last = clock.at.length - 1;
  const halves = Float32Array.from({ length: 65536 }, (_, bits) => half(bits)), real = new Float32Array(1), bits = new Uint32Array(real.buffer);
  for (const one of [places, turns, fades]) {  // each time is written as what it differs in from the one before
    const each = one.length / (last + 1);
    for (let i = each; i < one.length; i++) one[i] += one[i - each];
  }
  const things = [...header.answers.flatMap((answer) => answer.matches), ...header.objects].filter((one) => one.boxes && one.boxes.length);
  let share = 0, running = false;

  function halfOf(x) {
    const sign = x < 0 ? 0x8000 : 0, size = Math.abs(x);
    if (size < 2 ** -14) return sign | Math.round(size * 2 ** 24);
    real[0] = size;
    return sign | Math.min(0x7bff, (bits[0] - 0x38000000 + 0x1000) >>> 13);
  }
  function stand(part) {
    share = Math.min(1, Math.max(0, part));
    const at = share * last, low = Math.min(Math.floor(at), last - 1), t = at - low;
    const p = 3 * count * low, c = 6 * count * low, o = count * low;
    for (let i = 0; i < 3 * count; i++) centers[i] = clock.low[i % 3] + clock.step[i % 3] * (places[p + i] * (1 - t) + places[p + i + 3 * count] * t);
    for (let i = 0; i < 6 * count; i++) {
      const one = turns[c + i], other = turns[c + i + 6 * count];
      covariances[i] = one === other ? one : halfOf(halves[one] * (1 - t) + halves[other] * t);
    }
    for (let i = 0; i < count; i++) opacity[i] = fades[o + i] * (1 - t) + fades[o + i + count] * t + 0.5;
    for (const thing of things) follow(thing, low, t);
    own.moved(count);
    $("time").value = String(Math.round(1000 * share));
    $("now").textContent = Number((clock.at[low] * (1 - t) + clock.at[low + 1] * t).toPrecision(4)).toString();
  }
  function follow(thing, low, t) {  // its box, and the place to see it from
    const one = thing.boxes[low], other = thing.boxes[low + 1], near = t < 0.5 ? one : other;
    thing.gone = !near;
    if (!near) return;
    const center = one && other ? [0, 1, 2].map((i) => one[i] * (1 - t) + other[i] * t) : near.slice(0, 3);
    thing.eye = thing.eye.map((x, i) => x + center[i] - thing.center[i]);
    Object.assign(thing, { center, axes: [near.slice(3, 6), near.slice(6, 9), near.slice(9, 12)], extent: near.slice(12) });
  }
  function run(on) {
    if (on === running) return;
    running = on;
    $("run").textContent = on ? "Stop" : "Play";
    let before = null;
    const step = (now) => {
      if (!running) return;
      const part = share + (before === null ? 0 : (now - before) / (1000 * clock.seconds));
      before = now;
      stand(part > 1 ? 0 : part);  // from the first time again
      requestAnimationFrame(step);
    };
    if (on) requestAnimationFrame(step);
  }
  $("time-part").hidden = $("time-key").hidden = false;
  $("run").addEventListener("click", () => run(!running));
  $("time").addEventListener("input", () => { run(false); stand($("time").value / 1000); });
  Object.assign(own, { moment: (part) => { run(false); stand(part); }, run: () => run(!running), isRunning: () => running });
  stand(0);
});
