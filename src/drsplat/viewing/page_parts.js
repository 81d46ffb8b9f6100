// Beside the answers of a page: a list of the scene's objects with their pictures, and its annotations.
"use strict";
addEventListener("drsplat", () => {
  const { header, state, hooks, boxed, project, flyTo, paint } = window.drsplat, NOTE = [255, 224, 130];
  const rows = document.getElementById("objects"), notes = document.getElementById("notes");
  const button = (label, picture, act) => {
    const one = document.createElement("button");
    if (picture) { const image = document.createElement("img"); image.setAttribute("src", picture); image.alt = ""; one.append(image); }
    one.append(label);
    one.addEventListener("click", act);
    return one;
  };
  document.getElementById("objects-part").hidden = !header.objects.length;
  document.getElementById("notes-part").hidden = !header.annotations.length;
  const unsure = document.getElementById("unsure"), others = document.getElementById("unsure-objects"), buttons = [];
  const pressed = () => buttons.forEach((one, k) => one.setAttribute("aria-pressed", String(state.mode === "object" && state.object === k + 1)));
  header.objects.forEach((object, k) => {
    buttons.push(button(object.name, object.picture, () => {
      const again = state.mode === "object" && state.object === k + 1;
      state.mode = again ? "photo" : "object";
      state.object = k + 1;
      document.querySelectorAll("#modes button").forEach((one) => one.setAttribute("aria-pressed", "false"));
      pressed();
      paint();
      if (!again) flyTo(object.eye, object.center);
    }));
    (object.unsure ? others : rows).append(buttons[k]);
  });
  unsure.hidden = !others.children.length;
  unsure.open = !rows.children.length;
  document.getElementById("modes").addEventListener("click", pressed);
  document.getElementById("queries").addEventListener("click", pressed);
  header.annotations.forEach((note) => notes.append(button(note.text, "", () => flyTo(note.eye, note.center))));
  hooks.push((pen, cam) => {
    const object = state.mode === "object" && header.objects[state.object - 1];
    if (object && !object.gone) boxed(pen, cam, object, object.name, header.accent);
    for (const note of header.annotations) {
      if (note.extent) { boxed(pen, cam, note, note.text, NOTE); continue; }
      const [x, y, z] = project(note.center, cam);
      if (z < 0.05) continue;
      pen.fillStyle = `rgb(${NOTE})`;
      pen.beginPath();
      pen.arc(x, y, 4, 0, 7);
      pen.fill();
      window.drsplat.label(pen, x, y - 4, note.text, NOTE);
    }
  });
  paint();
});
