// The page's film, its looks, its sheet on a phone and its keys, all by what `window.drsplat` offers.
"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const LIGHT = [0.93, 0.94, 0.95], LOOKS = ["system", "dark", "light"];
  function start() {
    const own = window.drsplat, { state, header, fly } = own, film = header.film, dark = header.background, fov = header.fov;

    // --- the film ---
    let playing = false, share = 0;
    const mix = (a, b, t) => a.map((x, i) => x + (b[i] - x) * t);
    function show(part) {
      const last = film.eyes.length - 1, at = Math.min(1, Math.max(0, part)) * last, low = Math.min(Math.floor(at), Math.max(0, last - 1)), high = Math.min(low + 1, last), t = at - low;
      share = part;
      if (own.moment) own.moment(part);  // a film goes from the first time to the last
      header.fov = film.fovs[low] + (film.fovs[high] - film.fovs[low]) * t;
      own.stand(mix(film.eyes[low], film.eyes[high], t), mix(film.targets[low], film.targets[high], t));
      $("at").value = String(Math.round(1000 * part));
    }
    function stopped() {
      playing = false;
      $("play").textContent = "Play";
    }
    function play() {
      if (playing) { stopped(); fly(null); return; }
      playing = true;
      $("play").textContent = "Stop";
      let begin = null;
      const from = share >= 1 ? 0 : share;
      fly((now) => {
        if (begin === null) begin = now - 1000 * from * film.seconds;
        show(Math.min(1, (now - begin) / (1000 * film.seconds)));
        if (share >= 1) stopped();
        return share >= 1;
      }, stopped);
    }
    if (film) {
      $("play").addEventListener("click", play);
      $("at").addEventListener("input", () => { stopped(); fly(null); show($("at").value / 1000); });
    } else $("film").hidden = true;

    // --- dark and light: as the system is set, until somebody chooses ---
    const wished = matchMedia("(prefers-color-scheme: light)");
    let look = "system";
    function dress() {
      const light = look === "light" || (look === "system" && wished.matches);
      document.documentElement.dataset.look = light ? "light" : "dark";
      header.background = light ? LIGHT : dark;
      $("look").textContent = `Look: ${look}`;
      own.draw();
    }
    function turn() { look = LOOKS[(LOOKS.indexOf(look) + 1) % LOOKS.length]; dress(); }
    wished.addEventListener("change", dress);
    $("look").addEventListener("click", turn);

    // --- a sheet on a phone ---
    function pull() {
      const open = document.body.classList.toggle("low");
      $("sheet").setAttribute("aria-expanded", String(!open));
    }
    $("sheet").addEventListener("click", pull);

    // --- keys ---
    const press = (row, number) => { const button = $(row).children[number]; if (button) button.click(); };
    const pressed = (row) => [...$(row).children].findIndex((one) => one.getAttribute("aria-pressed") === "true");
    const tilt = (yaw, pitch) => { state.yaw += yaw; state.pitch = Math.max(-1.45, Math.min(1.45, state.pitch + pitch)); own.draw(); };
    const nearer = (by) => { state.distance = Math.max(0.05, state.distance * by); own.draw(); };
    const help = (open) => { $("keys").hidden = open === undefined ? !$("keys").hidden : !open; };
    const acts = {
      " ": () => film && play(), t: () => own.run && own.run(), ArrowLeft: () => tilt(-0.08, 0), ArrowRight: () => tilt(0.08, 0), ArrowUp: () => tilt(0, 0.06), ArrowDown: () => tilt(0, -0.06),
      "+": () => nearer(0.9), "=": () => nearer(0.9), "-": () => nearer(1 / 0.9), c: () => press("modes", (pressed("modes") + 1) % $("modes").children.length),
      l: turn, r: () => { header.fov = fov; own.flyTo(header.eye, header.target); }, "?": () => help(), h: () => help(), Escape: () => help(false),
    };
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "INPUT") return;
      if (event.target.tagName === "BUTTON" && (event.key === " " || event.key === "Enter")) return;
      const number = "123456789".indexOf(event.key), act = number >= 0 ? () => press("queries", number) : acts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      if (!act) return;
      event.preventDefault();
      act();
    });
    $("help").addEventListener("click", () => help());
    Object.assign(own, { play, show, isPlaying: () => playing });
    dress();
    if (film && header.plays && !matchMedia("(prefers-reduced-motion: reduce)").matches) play();
  }
  if (window.drsplat) start();
  else addEventListener("drsplat", start, { once: true });
})();
