// The photos of a scene: fly to where one was taken, or click in it.

import type { Photo } from "../protocol";
import type { App } from "./app";
import { button, byId, drawer, h } from "./dom";

const SIDE = 1200, SMALL = 160;

export function photosOf(app: App): Node[] {
  const live = app.backend.live;
  if (!live || !app.header.photos.length) return [];
  const shelf = h("div", { class: "shelf" });
  const made = drawer("Photos", shelf), fill = () => {
    if (made.open && !shelf.children.length) shelf.append(...app.header.photos.map((photo) => h("button", { type: "button", title: photo.name, onclick: () => look(app, photo) }, h("img", { loading: "lazy", src: live.photo(photo, SMALL), alt: photo.name }))));
  };
  made.addEventListener("toggle", fill);
  fill();
  return [made];
}

/** Show a photo; a click in it is a click at what it shows. */
function look(app: App, photo: Photo): void {
  const live = app.backend.live;
  if (!live) return;
  app.camera.flyTo(photo.eye, photo.target);
  const dialog = byId<HTMLDialogElement>("photo"), image = h("img", { src: live.photo(photo, SIDE), alt: photo.name, class: "large" });
  image.addEventListener("click", (event) => {
    const { width, height } = image.getBoundingClientRect();
    void app.act({ act: "click_photo", photo: photo.name, x: (event.offsetX / width) * photo.width, y: (event.offsetY / height) * photo.height }).then((done) => { if (done) dialog.close(); });
  });
  dialog.replaceChildren(h("p", {}, `${photo.name}: click what you mean`), image, button("Close", () => dialog.close()));
  dialog.showModal();
}
