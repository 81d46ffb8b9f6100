// What was found, and what was clicked.

import type { Match, Result } from "../protocol";
import type { App, Tab } from "./app";
import { button, counted, drawer, h } from "./dom";
import { about } from "./chosen";
import { askedOf } from "./link";
import { photosOf } from "./photos";

const LISTED = 8, MOST_OTHERS = 6, STEP = 0.001, KNOWN = "Words that this page knows";

export class AskTab implements Tab {
  readonly name = "ask";
  readonly label = "Ask";

  constructor(private readonly app: App) {}

  show(): Node[] {
    const { results, clicked } = this.app.state;
    return [
      ...(results.length ? results.map((result, k) => this.result(result, k)) : [this.start()]), ...this.present(),
      ...(clicked ? [this.thing()] : []), ...(results.length ? this.others() : []), ...this.classes(), ...photosOf(this.app), ...this.known(),
    ];
  }

  private start(): Node {
    const words = this.app.header.words.slice(0, 4), ask = (word: string) => () => this.app.prompt.ask(word);
    return h("div", { class: "start" }, h("p", { class: "faint" }, "Type what you look for, or click something in the scene."),
      h("div", { class: "chips", id: "try" }, ...words.map((word) => button(word, ask(word), { class: "chip" }))));
  }

  /** A switch for who knows that it is there: the best place is shown, even where other words fit better. */
  private present(): Node[] {
    const { app } = this, asked = askedOf(app);
    if (!app.backend.live || !asked.length) return [];
    const box = h("input", { type: "checkbox", id: "present", checked: Boolean(app.state.present), onchange: () => app.prompt.ask(asked.join("; "), box.checked) });
    return [h("label", { class: "check", for: "present", title: "Show the best place, even where other words fit better" }, box, "I know it is there")];
  }

  /** What a page can be asked, before anyone types. */
  private known(): Node[] {
    const { header, backend } = this.app;
    if (!header.knows) return [];
    const words = (backend.known?.() ?? []).flatMap(([head, all]) => [h("h3", {}, head), h("p", { class: "faint" }, all.join(", "))]);
    return [h("p", { class: "faint", id: "knows" }, header.knows), drawer(KNOWN, ...words)];
  }

  /** Further words that have answers here. */
  private others(): Node[] {
    const asked = new Set(this.app.state.results.flatMap((result) => [result.text, ...(result.instead ?? [])])), words = this.app.header.words.filter((word) => !asked.has(word)).slice(0, MOST_OTHERS);
    return words.length ? [h("div", { class: "chips", "aria-label": "Other queries" }, ...words.map((word) => button(word, () => this.app.prompt.ask(word), { class: "chip" })))] : [];
  }

  private result(result: Result, number: number): Node {
    const { matches, accent, text, num_matches, doubt } = result, chosen = this.app.state.chosen;
    const title = h("h2", {}, h("span", { class: "dot", style: `background:rgb(${accent.join(",")})` }), chosen ? chosen.name : text);
    const sure = matches.filter((match) => match.sure !== false).length, some = sure < matches.length && !this.app.backend.live && !chosen ? `, ${sure} sure` : "";
    const found = matches.length ? `${counted(num_matches, "match", "matches")}${some}` : `No match for “${text}”`;
    const summary = [found, doubt].filter(Boolean).join(". ");
    const shown = matches.slice(0, LISTED).map((match, k) => this.match(match, k, matches.length));
    const more = matches.slice(LISTED).map((match, k) => this.match(match, k + LISTED, matches.length));
    return h("section", { class: "result" }, title, chosen ? about(this.app) : h("p", { class: "faint" }, summary), this.instead(result),
      h("div", { class: "matches" }, ...shown), more.length ? drawer(`${counted(more.length, "more match", "more matches")} of ${text}`, h("div", { class: "matches" }, ...more)) : null,
      this.app.backend.live && !result.exact ? this.threshold(result, number) : null);
  }

  /** Words that do match, where this one does not. */
  private instead({ instead, matches }: Result): Node | null {
    if (matches.length || !instead?.length) return null;
    return h("div", { class: "chips instead" }, h("span", { class: "faint" }, "Matches here:"), ...instead.map((word) => button(word, () => this.app.prompt.ask(word), { class: "chip" })));
  }

  private match(match: Match, k: number, of: number): Node {
    const words = [match.size, match.num_gaussians ? counted(match.num_gaussians, "Gaussian") : ""].filter(Boolean).join(" · ");
    const score = this.app.state.chosen ? null : h("span", { class: "score" }, match.score.toFixed(2));
    return h("button", { type: "button", class: "match", onclick: () => this.app.flyTo(match), title: match.place ? `at ${match.place}` : "" },
      h("b", {}, of > 1 ? `${k + 1}` : "Go there"), h("span", { class: "faint" }, words), score);
  }

  /** The number that cuts, for who wants to move it. */
  private threshold(result: Result, number: number): Node {
    const [low, high] = result.limits, input = h("input", { type: "range", min: low, max: high, step: STEP, value: result.threshold, "aria-label": `Threshold of ${result.text}` });
    let wanted: number | null = null;
    const cut = () => {
      const first = wanted === null;
      wanted = Number(input.value);
      if (first) setTimeout(() => { const value = wanted; wanted = null; void this.app.act({ act: "threshold", query: number, value }); }, 60);
    };
    input.addEventListener("change", cut);
    const own = button("as chosen", () => void this.app.act({ act: "threshold", query: number, value: result.automatic }), { class: "quiet" });
    return drawer(`Threshold of ${result.text}`, h("div", { class: "slider" }, input, h("output", {}, result.threshold.toFixed(3))),
      h("p", { class: "faint" }, `${result.measure} above which a Gaussian is selected; ${result.threshold_rule} chose ${result.automatic.toFixed(3)}.`), own);
  }

  private thing(): Node {
    const { clicked } = this.app.state, live = this.app.backend.live;
    if (!clicked) return h("p");
    const others = clicked.words.slice(1).map((word) => word.text).join(", ");
    return h("section", { class: "result", id: "what" }, h("h2", {}, "What is this?"),
      h("p", {}, h("b", {}, clicked.name || "No word here fits it.")), others ? h("p", { class: "faint" }, `or ${others}`) : null, clicked.place ? h("p", { class: "faint" }, clicked.place) : null,
      clicked.photo && live ? h("img", { class: "photo", src: live.clickedPhoto(), alt: "The photo that shows it best" }) : null,
      clicked.support.length ? drawer("Where it is known from", ...clicked.support.map((one) => h("p", { class: "faint" }, `${one.view}, mask ${one.mask} (${Math.round(100 * one.share)} %)`))) : null,
      live ? button("More like this", () => void this.app.act({ act: "more_like_this" })) : null);
  }

  private classes(): Node[] {
    const { classes } = this.app.state;
    if (!this.app.backend.live) return [];
    const input = h("input", { type: "text", placeholder: "mug, bowl, table", "aria-label": "Classes" });
    const form = h("form", { class: "line", onsubmit: (event: Event) => { event.preventDefault(); void this.app.act({ act: "classify", text: input.value }); } }, input, h("button", {}, "Colour"));
    const legend = (classes ?? []).map((one) => h("p", {}, h("span", { class: "dot", style: `background:rgb(${one.color.join(",")})` }), `${one.name}: ${counted(one.count, "Gaussian")}`));
    return [drawer("Colour by classes", form, ...legend)];
  }
}
