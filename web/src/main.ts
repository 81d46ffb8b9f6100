// Where the client begins: in a page with answers inside it, or before a running viewer.

import { LiveBackend } from "./live_backend";
import { PageBackend } from "./page_backend";
import type { Backend } from "./protocol";
import { App } from "./ui/app";
import { byId } from "./ui/dom";
import { hands } from "./ui/hands";
import { Lasso } from "./ui/lasso";
import { follow } from "./ui/link";
import { tools } from "./ui/tools";

declare global { interface Window { drsplat?: App } }

async function start(): Promise<void> {
  const backend: Backend = document.getElementById("header") ? await PageBackend.read() : new LiveBackend();
  const [header, state] = await Promise.all([backend.header(), backend.state()]);
  document.title = header.title;
  byId("title").textContent = header.title;
  const app = new App(backend, header, state);
  if (backend.live && header.can.edit) app.lasso = new Lasso(app);
  tools(app);
  hands(app);
  await app.begin();
  const placed = await follow(app), first = app.state.results.flatMap((result) => result.matches)[0];
  if (!placed && backend.live && first) app.camera.stand(first.eye, first.center);
  if (!placed && header.plays && !matchMedia("(prefers-reduced-motion: reduce)").matches) app.film.play();
  document.body.classList.remove("loading");
  window.drsplat = app;
}

start().catch((error: unknown) => {
  document.body.classList.remove("loading");
  const line = byId("message");
  line.hidden = false;
  line.className = "fault";
  line.textContent = `This scene cannot be shown: ${error instanceof Error ? error.message : String(error)}`;
});
