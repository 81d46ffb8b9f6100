// The scene's objects with their pictures.

import type { SceneObject } from "../protocol";
import type { App, Tab } from "./app";
import { about } from "./chosen";
import { counted, drawer, h } from "./dom";

export class ObjectsTab implements Tab {
  readonly name = "objects";
  readonly label = "Objects";

  private readonly pictures = new Map<string, HTMLImageElement>(); // by their addresses, so that a new list has them at once

  constructor(private readonly app: App) {}

  private picture(address: string): Node {
    if (!address) return h("span", { class: "blank" });
    const known = this.pictures.get(address), made = known ?? h("img", { loading: "lazy", src: address, alt: "" });
    this.pictures.set(address, made);
    return made;
  }

  show(): Node[] {
    const { objects } = this.app.header, sure = objects.filter((one) => !one.unsure), unsure = objects.filter((one) => one.unsure);
    const grid = (some: SceneObject[]) => h("div", { class: "things" }, ...some.map((one) => this.thing(one)));
    const { chosen } = this.app.state;
    return [
      ...(chosen && this.app.backend.live ? [h("section", { class: "result" }, h("h2", {}, chosen.name), about(this.app))] : []),
      h("p", { class: "faint" }, `${counted(sure.length, "thing")} that the photos agree on.`), grid(sure),
      unsure.length ? drawer(`${unsure.length} more, that photos agree less on`, grid(unsure)) : h("span"),
    ];
  }

  private thing(object: SceneObject): Node {
    const { app } = this, isChosen = app.state.chosen?.number === object.number, picture = app.backend.objectPicture(object);
    const press = () => void app.act(isChosen ? { act: "clear" } : { act: "choose", number: object.number }).then((done) => { if (done && !isChosen) app.flyTo(object); });
    const name = isChosen ? app.state.chosen?.name ?? object.name : object.name;
    return h("button", { type: "button", class: "thing", "aria-pressed": String(isChosen), onclick: press, title: object.size },
      this.picture(picture), h("span", {}, name));
  }
}
