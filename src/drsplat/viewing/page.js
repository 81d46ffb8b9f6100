// A scene of Gaussians with precomputed answers, in one page: no server, nothing fetched.
// Frames: the scene is in the page's units; cameras have +x right, +y down, +z ahead.
"use strict";
(async () => {
  const $ = (id) => document.getElementById(id);
  const header = JSON.parse($("header").textContent);
  const arrays = await unpacked($("blob").textContent, header.arrays);
  const { centers, covariances, rgb, opacity, features, words } = arrays;
  const count = opacity.length, up = header.up, [east, north] = floor(up);
  const state = { answer: 0, mode: header.answers.length ? "answer" : "photo", target: header.target.slice(), yaw: 0, pitch: 0, distance: 1, width: 1, height: 1 };
  const stage = $("stage"), marks = $("marks"), painted = new Uint8Array(4 * count), order = new Uint32Array(count);
  const painter = webgl($("splats")) || flat($("splats"));
  const tags = [];  // names in this picture: middle, foot, width
  const hooks = [];  // drawn over the picture, before boxes of answers
  let wanted = false, flying = null, interrupted = null;
  lookFrom(header.eye, header.target);

  async function unpacked(text, layout) {
    const packed = Uint8Array.from(atob(text.trim()), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const buffer = await new Response(stream).arrayBuffer();
    const kinds = { f4: Float32Array, f2: Uint16Array, u1: Uint8Array, u2: Uint16Array };
    return Object.fromEntries(layout.map(([name, kind, offset, length]) => [name, new kinds[kind](buffer, offset, length)]));
  }

  // --- vectors ---
  function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
  function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }
  function plus(a, b, s) { return [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]; }
  function unit(a) { const l = Math.hypot(...a) || 1; return a.map((x) => x / l); }
  function floor(axis) { const e = unit(cross(Math.abs(axis[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], axis)); return [e, cross(axis, e)]; }

  // --- the camera: around a target, never upside down ---
  function away() {
    const c = Math.cos(state.pitch), flatly = plus(east.map((x) => x * Math.cos(state.yaw)), north, Math.sin(state.yaw));
    return plus(flatly.map((x) => x * c), up, Math.sin(state.pitch));
  }
  function camera() {
    const back = away(), eye = plus(state.target, back, state.distance), ahead = back.map((x) => -x);
    const right = unit(cross(ahead, up)), down = cross(ahead, right);
    const focal = state.height / (2 * Math.tan((header.fov * Math.PI) / 360));
    return { eye, right, down, ahead, focal };
  }
  function pose(eye, target) {
    const back = plus(eye, target, -1), distance = Math.hypot(...back), height = dot(back, up) / distance;
    return { target: target.slice(), distance, pitch: Math.asin(Math.max(-0.99, Math.min(0.99, height))), yaw: Math.atan2(dot(back, north), dot(back, east)) };
  }
  function lookFrom(eye, target) { Object.assign(state, pose(eye, target)); draw(); }
  function fly(step, stopped = null) {  // step: says whether that was all; null stops what flies
    if (interrupted) interrupted();
    interrupted = stopped;
    flying = step && ((now) => { if (step(now)) flying = interrupted = null; });
    draw();
  }
  function flyTo(eye, target) {
    const from = { ...state, target: state.target.slice() }, to = pose(eye, target), start = performance.now();
    fly(null);
    to.yaw = from.yaw + Math.atan2(Math.sin(to.yaw - from.yaw), Math.cos(to.yaw - from.yaw));
    flying = (now) => {
      const t = Math.min(1, (now - start) / 700), s = t * t * (3 - 2 * t), mix = (a, b) => a + (b - a) * s;
      state.target = from.target.map((x, i) => mix(x, to.target[i]));
      for (const key of ["distance", "pitch", "yaw"]) state[key] = mix(from[key], to[key]);
      if (t >= 1) flying = null;
    };
    draw();
  }
  function project(point, cam = camera()) {
    const p = plus(point, cam.eye, -1), z = dot(p, cam.ahead);
    return [state.width / 2 + (cam.focal * dot(p, cam.right)) / z, state.height / 2 + (cam.focal * dot(p, cam.down)) / z, z];
  }

  // --- colours: as drsplat.viewing.painting has them ---
  function warm(heat) {
    const stops = header.heat, at = Math.min(1, Math.max(0, heat)) * (stops.length - 1), low = Math.min(stops.length - 2, Math.floor(at));
    return stops[low].map((x, i) => x + (stops[low + 1][i] - x) * (at - low));
  }
  function paint() {
    const look = header.look, answer = header.answers[state.answer], mode = answer || state.mode === "features" || state.mode === "object" ? state.mode : "photo";
    const heat = answer && arrays["heat" + state.answer], owner = answer && arrays["owner" + state.answer];
    const table = Array.from({ length: 256 }, (_, i) => warm(i / 255));
    for (let i = 0; i < count; i++) {
      let r = rgb[3 * i] / 255, g = rgb[3 * i + 1] / 255, b = rgb[3 * i + 2] / 255;
      if (mode === "features") { r = features[3 * i] / 255; g = features[3 * i + 1] / 255; b = features[3 * i + 2] / 255; }
      else if (mode === "heat") [r, g, b] = table[heat[i]];
      else if ((mode === "answer" && owner[i]) || (mode === "object" && arrays.objects[i] === state.object)) {
        const gain = Math.max(0.001, r, g, b) ** -look.glow;
        r *= gain; g *= gain; b *= gain;
      } else if (mode === "answer" || mode === "object") {
        const near = mode === "answer" ? heat[i] : 0, grey = look.floor + look.dim * (0.299 * r + 0.587 * g + 0.114 * b), w = look.warmth * Math.max(0, near / 255 - 0.25), c = table[near];
        r = grey * (1 - w) + c[0] * w; g = grey * (1 - w) + c[1] * w; b = grey * (1 - w) + c[2] * w;
      }
      painted[4 * i] = 255 * r; painted[4 * i + 1] = 255 * g; painted[4 * i + 2] = 255 * b; painted[4 * i + 3] = opacity[i];
    }
    painter.recolor();
    draw();
  }

  function moved(upto) {  // the first Gaussians are elsewhere
    for (let i = 0; i < upto; i++) painted[4 * i + 3] = opacity[i];
    painter.reshape(upto);
    painter.recolor();
    draw();
  }

  // --- drawing ---
  function sorted(cam) {  // counting sort of depth, farthest first
    const buckets = 65536, keys = sorted.keys || (sorted.keys = new Uint16Array(count)), depth = sorted.depth || (sorted.depth = new Float32Array(count));
    const [ax, ay, az] = cam.ahead;
    let low = Infinity, high = -Infinity;
    for (let i = 0; i < count; i++) {
      const d = (depth[i] = centers[3 * i] * ax + centers[3 * i + 1] * ay + centers[3 * i + 2] * az);
      if (d < low) low = d;
      if (d > high) high = d;
    }
    const scale = (buckets - 1) / Math.max(high - low, 1e-9), starts = new Uint32Array(buckets + 1);
    for (let i = 0; i < count; i++) { keys[i] = (high - depth[i]) * scale; starts[keys[i] + 1]++; }
    for (let k = 0; k < buckets; k++) starts[k + 1] += starts[k];
    for (let i = 0; i < count; i++) order[starts[keys[i]]++] = i;
  }
  function draw() {
    if (wanted) return;
    wanted = true;
    requestAnimationFrame((now) => {
      wanted = false;
      if (flying) flying(now);
      const ratio = Math.min(2, devicePixelRatio || 1), w = stage.clientWidth, h = stage.clientHeight;
      Object.assign(state, { width: w, height: h });
      for (const canvas of [$("splats"), marks]) if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
      const cam = camera();
      sorted(cam);
      painter.draw(cam, ratio);
      annotate(cam, ratio);
      window.drsplat.frames += 1;
      if (flying || keys.size) draw();
    });
  }
  function half(h) {
    const e = (h >> 10) & 31, f = h & 1023, s = h & 32768 ? -1 : 1;
    return s * (e === 0 ? f * 2 ** -24 : 2 ** (e - 15) * (1 + f / 1024));
  }

  function webgl(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (!gl) return null;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    gl.useProgram(program);
    const across = 1024, rows = Math.max(1, Math.ceil(count / across)), shape = new Uint32Array(across * rows * 8), bits = new Uint32Array(centers.buffer, centers.byteOffset, 3 * count);
    const shaped = (upto) => {
      for (let i = 0; i < upto; i++) {
        for (let k = 0; k < 3; k++) shape[8 * i + k] = bits[3 * i + k];
        for (let k = 0; k < 3; k++) shape[8 * i + 4 + k] = covariances[6 * i + 2 * k] | (covariances[6 * i + 2 * k + 1] << 16);
      }
    };
    shaped(count);
    const texture = (unit, inner, w, format, type, data) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
      gl.texImage2D(gl.TEXTURE_2D, 0, inner, w, rows, 0, format, type, data);
    };
    texture(0, gl.RGBA32UI, 2 * across, gl.RGBA_INTEGER, gl.UNSIGNED_INT, shape);
    const full = new Uint8Array(4 * across * rows);
    texture(1, gl.RGBA8, across, gl.RGBA, gl.UNSIGNED_BYTE, full);
    const at = (name) => gl.getUniformLocation(program, name), buffer = (name, size, integer) => {
      const one = gl.createBuffer(), place = gl.getAttribLocation(program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, one);
      gl.enableVertexAttribArray(place);
      if (integer) { gl.vertexAttribIPointer(place, size, gl.UNSIGNED_INT, 0, 0); gl.vertexAttribDivisor(place, 1); }
      else gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
      return one;
    };
    buffer("corner", 2, false);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    const which = buffer("which", 1, true);
    gl.uniform1i(at("shape"), 0);
    gl.uniform1i(at("paint"), 1);
    gl.uniform1i(at("antialiased"), header.antialiased ? 1 : 0);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    return {
      reshape(upto) {
        shaped(upto);
        gl.activeTexture(gl.TEXTURE0);
        gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 2 * across, Math.ceil(upto / across), gl.RGBA_INTEGER, gl.UNSIGNED_INT, shape);
      },
      recolor() {
        full.set(painted);
        gl.activeTexture(gl.TEXTURE1);
        gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, across, rows, gl.RGBA, gl.UNSIGNED_BYTE, full);
      },
      draw(cam, ratio) {
        gl.viewport(0, 0, canvas.width, canvas.height);
        gl.clearColor(...header.background, 1);
        gl.clear(gl.COLOR_BUFFER_BIT);
        gl.uniform3fv(at("eye"), cam.eye);
        gl.uniformMatrix3fv(at("world_to_camera"), true, [...cam.right, ...cam.down, ...cam.ahead]);
        gl.uniform1f(at("focal"), cam.focal * ratio);
        gl.uniform2f(at("viewport"), canvas.width, canvas.height);
        gl.bindBuffer(gl.ARRAY_BUFFER, which);
        gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
      },
    };
  }

  // Without WebGL2: each Gaussian as a round spot of its own size.
  function flat(canvas) {
    const pen = canvas.getContext("2d"), sizes = new Float32Array(count);
    const reshape = (upto) => { for (let i = 0; i < upto; i++) sizes[i] = 2 * Math.sqrt((half(covariances[6 * i]) + half(covariances[6 * i + 3]) + half(covariances[6 * i + 5])) / 3); };
    reshape(count);
    return {
      reshape,
      recolor() {},
      draw(cam, ratio) {
        pen.setTransform(ratio, 0, 0, ratio, 0, 0);
        pen.fillStyle = `rgb(${header.background.map((x) => 255 * x)})`;
        pen.fillRect(0, 0, state.width, state.height);
        for (const i of order) {
          const [x, y, z] = project([centers[3 * i], centers[3 * i + 1], centers[3 * i + 2]], cam);
          if (z < 0.05 || x < -50 || y < -50 || x > state.width + 50 || y > state.height + 50) continue;
          const size = Math.min(80, Math.max(1, (cam.focal * sizes[i]) / z));
          pen.fillStyle = `rgba(${painted[4 * i]},${painted[4 * i + 1]},${painted[4 * i + 2]},${painted[4 * i + 3] / 255})`;
          pen.beginPath();
          pen.arc(x, y, size, 0, 7);
          pen.fill();
        }
      },
    };
  }

  // --- boxes and names over the picture ---
  function annotate(cam, ratio) {
    const pen = marks.getContext("2d"), answer = header.answers[state.answer];
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, state.width, state.height);
    tags.length = 0;
    for (const hook of hooks) hook(pen, cam);
    if (!answer || state.mode !== "answer") return;
    answer.matches.forEach((match, number) => match.gone || boxed(pen, cam, match, answer.matches.length > 1 ? `${number + 1} ${answer.text}` : answer.text, answer.accent));
  }
  function boxed(pen, cam, box, label, color) {
    const corners = [...Array(8).keys()].map((k) => project(box.axes.reduce((p, axis, a) => plus(p, axis, ((k >> a) & 1 ? 0.5 : -0.5) * box.extent[a]), box.center), cam));
    if (corners.some((c) => c[2] < 0.05)) return;
    pen.strokeStyle = `rgb(${color})`;
    pen.lineWidth = 1.5;
    pen.beginPath();
    for (let i = 0; i < 8; i++) for (const bit of [1, 2, 4]) if (!(i & bit)) { pen.moveTo(corners[i][0], corners[i][1]); pen.lineTo(corners[i | bit][0], corners[i | bit][1]); }
    pen.stroke();
    const top = corners.reduce((a, b) => (b[1] < a[1] ? b : a));
    label && tag(pen, top[0], top[1], label, color);
  }
  function tag(pen, x, y, label, color) {
    pen.font = "13px system-ui, sans-serif";
    const wide = pen.measureText(label).width, meets = (other) => Math.abs(other[0] - x) < (other[2] + wide) / 2 + 12 && Math.abs(other[1] - y) < 20;
    for (let tries = 0, other; tries < 6 && (other = tags.find(meets)); tries++) y = other[1] - 21;  // above the name that is there
    tags.push([x, y, wide]);
    pen.fillStyle = "rgba(20,22,27,.85)";
    pen.fillRect(x - wide / 2 - 6, y - 26, wide + 12, 20);
    pen.fillStyle = `rgb(${color})`;
    pen.fillText(label, x - wide / 2, y - 11);
  }

  // --- what a click meets ---
  function pick(x, y) {
    const cam = camera(), d = unit(plus(plus(cam.ahead, cam.right, (x - state.width / 2) / cam.focal), cam.down, (y - state.height / 2) / cam.focal));
    const met = [];
    for (let i = 0; i < count; i++) {
      const p = [centers[3 * i] - cam.eye[0], centers[3 * i + 1] - cam.eye[1], centers[3 * i + 2] - cam.eye[2]], z = dot(p, d);
      if (z <= 0) continue;
      const apart = dot(p, p) - z * z, c = 6 * i, most = half(covariances[c]) + half(covariances[c + 3]) + half(covariances[c + 5]);
      if (apart > 9 * most) continue;
      const alpha = (opacity[i] / 255) * Math.exp(-0.5 * mahalanobis(p, d, c));
      if (alpha > 1 / 255) met.push([z, Math.min(0.99, alpha), i]);
    }
    met.sort((a, b) => a[0] - b[0]);
    let through = 1, best = -1, weight = 0;
    for (const [, alpha, i] of met) {
      if (through * alpha > weight) [best, weight] = [i, through * alpha];
      through *= 1 - alpha;
    }
    return best;
  }
  function mahalanobis(p, d, c) {  // least along the ray, of the 2x2 covariance seen along it
    const [e, n] = floor(d), S = [0, 1, 2, 3, 4, 5].map((k) => half(covariances[c + k]));
    const times = (v) => [S[0] * v[0] + S[1] * v[1] + S[2] * v[2], S[1] * v[0] + S[3] * v[1] + S[4] * v[2], S[2] * v[0] + S[4] * v[1] + S[5] * v[2]];
    const se = times(e), sn = times(n), a = dot(e, se) + 1e-7, b = dot(e, sn), g = dot(n, sn) + 1e-7, u = dot(p, e), v = dot(p, n), det = a * g - b * b;
    return det > 0 ? (g * u * u - 2 * b * u * v + a * v * v) / det : Infinity;
  }
  function tell(i) {
    const what = $("what"), word = i >= 0 && words && words[i] ? header.words[words[i] - 1] : null;
    what.textContent = "";
    const name = document.createElement("b"), note = document.createElement("p");
    name.textContent = i < 0 ? "Nothing there" : word || "None of the words that this page knows";
    note.className = "faint";
    const found = i < 0 ? [] : header.answers.filter((_, k) => arrays["owner" + k][i]).map((answer) => answer.text);
    note.textContent = found.length ? `match of: ${found.join(", ")}` : "";
    what.append(name, note);
  }

  // --- the panel ---
  const FIRST = 12;
  function panel() {
    $("about").textContent = header.about;
    const press = (row, chosen) => [...row.children].forEach((button, k) => button.setAttribute("aria-pressed", String(k === chosen)));
    const button = (label, act, color) => {
      const one = document.createElement("button");
      if (color) { const spot = document.createElement("span"); spot.className = "swatch"; spot.style.background = `rgb(${color})`; one.append(spot); }
      one.append(label);
      one.addEventListener("click", act);
      return one;
    };
    const modes = [["answer", "answer"], ["heat", "heat map"], ["photo", "as it is"], ["features", "features"]].filter(([key]) => (key === "features" ? features : key === "photo" || header.answers.length));
    const show = (k) => { state.mode = modes[k][0]; press($("modes"), k); paint(); };
    const ask = (k) => {
      state.answer = k;
      press($("queries"), k);
      const answer = header.answers[k], list = $("matches");
      list.textContent = "";
      if (!answer) return;
      if (!answer.matches.length) { const p = document.createElement("p"); p.textContent = `No match for "${answer.text}".`; list.append(p); }
      const named = answer.matches.map((match, number) => button(answer.matches.length > 1 ? `${number + 1} · ${match.said}` : match.said, () => flyTo(match.eye, match.center), answer.accent));
      list.append(...named.slice(0, FIRST));
      if (named.length > FIRST) {
        const more = document.createElement("details"), count = document.createElement("summary");
        count.textContent = `${named.length - FIRST} more`;
        more.append(count, ...named.slice(FIRST));
        list.append(more);
      }
      paint();
    };
    header.answers.forEach((answer, k) => $("queries").append(button(answer.text, () => { if (state.mode === "photo" || state.mode === "features") show(0); ask(k); }, answer.accent)));
    modes.forEach(([, label], k) => $("modes").append(button(label, () => show(k))));
    show(header.plays ? modes.findIndex(([key]) => key === "photo") : 0);
    ask(0);
  }

  // --- hands ---
  const keys = new Set(), fingers = new Map();
  function hands() {
    let moved = 0, walking = null;
    stage.addEventListener("contextmenu", (event) => event.preventDefault());
    stage.addEventListener("pointerdown", (event) => { stage.setPointerCapture(event.pointerId); fingers.set(event.pointerId, [event.offsetX, event.offsetY]); moved = 0; fly(null); });
    stage.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const dx = event.offsetX - before[0], dy = event.offsetY - before[1];
      moved += Math.abs(dx) + Math.abs(dy);
      if (fingers.size === 2) {
        const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
        const cam = camera(), step = state.distance / cam.focal / 2;
        state.target = plus(plus(state.target, cam.right, -dx * step), cam.down, -dy * step);
        state.distance *= Math.hypot(before[0] - other[0], before[1] - other[1]) / Math.max(1, Math.hypot(event.offsetX - other[0], event.offsetY - other[1]));
      } else if (event.buttons & 2 || event.shiftKey) {
        const cam = camera(), step = state.distance / cam.focal;
        state.target = plus(plus(state.target, cam.right, -dx * step), cam.down, -dy * step);
      } else {
        state.yaw -= 0.006 * dx;
        state.pitch = Math.max(-1.45, Math.min(1.45, state.pitch + 0.006 * dy));
      }
      fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
      draw();
    });
    const lifted = (event) => {
      if (fingers.delete(event.pointerId) && moved < 4 && event.type === "pointerup" && event.button === 0) tell(pick(event.offsetX, event.offsetY));
    };
    stage.addEventListener("pointerup", lifted);
    stage.addEventListener("pointercancel", lifted);
    stage.addEventListener("wheel", (event) => { event.preventDefault(); state.distance = Math.max(0.05, state.distance * Math.exp(0.001 * event.deltaY)); draw(); }, { passive: false });
    const walk = () => {
      const cam = camera(), step = 0.02 * Math.max(1, state.distance), along = { w: [cam.ahead, 1], s: [cam.ahead, -1], d: [cam.right, 1], a: [cam.right, -1], e: [up, 1], q: [up, -1] };
      for (const key of keys) state.target = plus(state.target, along[key][0], step * along[key][1]);
      draw();
    };
    addEventListener("keydown", (event) => { const key = event.key.toLowerCase(); if ("wasdeq".includes(key) && !event.ctrlKey && !event.metaKey) { keys.add(key); walking = walking || setInterval(walk, 16); } });
    addEventListener("keyup", (event) => { keys.delete(event.key.toLowerCase()); if (!keys.size) { clearInterval(walking); walking = null; } });
    addEventListener("blur", () => { keys.clear(); clearInterval(walking); walking = null; });
    new ResizeObserver(draw).observe(stage);
  }
  window.drsplat = {
    frames: 0, state, header, project: (point, cam) => project(point, cam), pick, flyTo, fly, stand: lookFrom, draw, painter,
    hooks, boxed, label: tag, paint, arrays, half, moved,
  };
  panel();
  hands();
  dispatchEvent(new Event("drsplat"));
})();

const VERTEX = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D shape;
uniform sampler2D paint;
uniform vec3 eye;
uniform mat3 world_to_camera;
uniform float focal;
uniform vec2 viewport;
uniform bool antialiased;
in vec2 corner;
in uint which;
out vec4 color;
out vec2 at;
void main() {
  ivec2 place = ivec2(int(which) % 1024, int(which) / 1024);
  uvec4 spread = texelFetch(shape, ivec2(2 * place.x + 1, place.y), 0);
  vec3 p = world_to_camera * (uintBitsToFloat(texelFetch(shape, ivec2(2 * place.x, place.y), 0).xyz) - eye);
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  color = texelFetch(paint, place, 0);
  at = vec2(0.0);
  if (p.z < 0.05 || color.a < 0.004) return;
  vec2 a = unpackHalf2x16(spread.x), b = unpackHalf2x16(spread.y), c = unpackHalf2x16(spread.z);
  mat3 world = mat3(a.x, a.y, b.x, a.y, b.y, c.x, b.x, c.x, c.y);
  mat3 S = world_to_camera * world * transpose(world_to_camera);
  vec2 lens = 0.65 * viewport / focal, ray = clamp(p.xy / p.z, -lens, lens);
  vec3 jx = vec3(focal / p.z, 0.0, -focal * ray.x / p.z), jy = vec3(0.0, focal / p.z, -focal * ray.y / p.z);
  float xx = dot(jx, S * jx), yy = dot(jy, S * jy), xy = dot(jx, S * jy), sharp = xx * yy - xy * xy;
  xx += 0.3;
  yy += 0.3;
  if (antialiased) color.a *= sqrt(clamp(sharp / (xx * yy - xy * xy), 0.0, 1.0));
  float middle = 0.5 * (xx + yy), apart = length(vec2(0.5 * (xx - yy), xy));
  float large = middle + apart, small = max(middle - apart, 0.1);
  vec2 axis = abs(xy) < 1e-6 ? (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0)) : normalize(vec2(xy, large - xx));
  vec2 offset = 3.0 * (corner.x * min(sqrt(large), 512.0) * axis + corner.y * min(sqrt(small), 512.0) * vec2(-axis.y, axis.x));
  vec2 pixel = focal * p.xy / p.z;
  if (any(greaterThan(abs(pixel), 1.3 * 0.5 * viewport + 512.0))) return;
  at = 3.0 * corner;
  gl_Position = vec4(2.0 * (pixel + offset) / viewport * vec2(1.0, -1.0), 0.0, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec4 color;
in vec2 at;
out vec4 pixel;
void main() {
  float far = dot(at, at);
  if (far > 9.0) discard;
  float alpha = color.a * exp(-0.5 * far);
  pixel = vec4(color.rgb * alpha, alpha);
}`;
