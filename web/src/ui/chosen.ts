// An object that was chosen: how large it is, its parts, and the name that one gives it.

import type { App } from "./app";
import { button, counted, h } from "./dom";

export function about(app: App): Node {
  const { chosen } = app.state, { can } = app.header;
  if (!chosen) return h("p");
  const facts = [chosen.num_gaussians ? counted(chosen.num_gaussians, "Gaussian") : "", chosen.photos ? `seen in ${counted(chosen.photos, "photo")}` : ""].filter(Boolean).join(", ");
  const act = (what: string) => () => void app.act({ act: what });
  const input = h("input", { type: "text", placeholder: "Name it", "aria-label": "Name of this object", maxlength: 60 });
  const keep = (event: Event) => { event.preventDefault(); if (input.value.trim()) void app.act({ act: "name", text: input.value.trim() }); };
  return h("div", { class: "about" }, h("p", { class: "faint" }, facts),
    app.backend.live ? h("div", { class: "chips" }, button("Smaller part", act("smaller"), { disabled: !chosen.smaller }), button("Larger group", act("larger"), { disabled: !chosen.larger })) : null,
    can.name ? h("form", { class: "line", onsubmit: keep }, input, h("button", {}, "Keep")) : null);
}
