// The one line to type into, with what could be meant below it: words that have matches, objects, earlier queries.

import { byId, h } from "./dom";
import type { App } from "./app";

const MOST = 7, MOST_RECENT = 8;

interface Offer { text: string; kind: "has matches" | "object" | "recent" | "word"; number?: number }

export class Prompt {
  private readonly input = byId<HTMLInputElement>("query");
  private readonly list = byId("suggestions");
  private readonly key: string;
  private offers: Offer[] = [];
  private at = -1;
  private shown = ""; // what the state is an answer to

  constructor(private readonly app: App) {
    this.key = `drsplat recent ${app.header.title}`;
    byId("prompt").hidden = !app.header.can.ask;
    byId("prompt").addEventListener("submit", (event) => { event.preventDefault(); this.take(); });
    byId("clear").addEventListener("click", () => { this.input.value = ""; this.input.focus(); void app.act({ act: "clear" }); });
    this.input.addEventListener("input", () => this.offer());
    this.input.addEventListener("focus", () => this.offer());
    this.input.addEventListener("blur", () => setTimeout(() => this.close(), 150));
    this.input.addEventListener("keydown", (event) => this.pressed(event));
    const words = app.header.words.slice(0, 2).map((word) => `“${word}”`).join(" or ");
    this.input.placeholder = words ? `Ask for ${words}` : "Ask for anything, such as “red mug”";
  }

  focus(): void { this.input.select(); }

  /** Keep the line true to what is shown: a click or an object takes the place of an old query. */
  follow(): void {
    const { results, chosen } = this.app.state, text = chosen?.name ?? results.map((result) => result.text).join("; ");
    if (text !== this.shown && document.activeElement !== this.input) this.input.value = text;
    this.shown = text;
    byId("clear").hidden = !this.input.value && !results.length;
  }

  private recent(): string[] {
    try { return JSON.parse(localStorage.getItem(this.key) ?? "[]") as string[]; } catch { return []; }
  }

  private remember(text: string): void {
    try { localStorage.setItem(this.key, JSON.stringify([text, ...this.recent().filter((one) => one !== text)].slice(0, MOST_RECENT))); } catch { /* a page of a file may keep nothing */ }
  }

  private offer(): void {
    byId("clear").hidden = !this.input.value;
    const own = this.input.value === this.shown ? "" : this.input.value, typed = own.split(";").pop()?.trim().toLowerCase() ?? "", fits = (text: string) => text.toLowerCase().includes(typed) && text.toLowerCase() !== typed;
    const every: Offer[] = [
      ...this.recent().map((text): Offer => ({ text, kind: "recent" })), ...this.app.header.words.map((text): Offer => ({ text, kind: "has matches" })),
      ...this.app.header.objects.map(({ name, number }): Offer => ({ text: name, kind: "object", number })),
      ...(this.app.backend.suggest?.(typed) ?? []).map((text): Offer => ({ text, kind: "word" })),
    ];
    const known = new Set<string>();
    this.offers = every.filter(({ text }) => fits(text) && !known.has(text.toLowerCase()) && known.add(text.toLowerCase())).slice(0, MOST);
    this.at = -1;
    this.write();
  }

  private write(): void {
    const open = this.offers.length > 0 && document.activeElement === this.input;
    this.list.hidden = !open;
    this.input.setAttribute("aria-expanded", String(open));
    this.input.setAttribute("aria-activedescendant", this.at >= 0 ? `offer-${this.at}` : "");
    this.list.replaceChildren(...this.offers.map((offer, k) =>
      h("li", { role: "option", id: `offer-${k}`, "aria-selected": String(k === this.at), onpointerdown: (event: Event) => { event.preventDefault(); this.choose(offer); } },
        h("span", {}, offer.text), h("small", {}, offer.kind))));
  }

  private close(): void {
    this.offers = [];
    this.write();
  }

  private pressed(event: KeyboardEvent): void {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (step && this.offers.length) {
      event.preventDefault();
      this.at = (this.at + step + this.offers.length + (this.at < 0 && step < 0 ? 1 : 0)) % this.offers.length;
      this.write();
    } else if (event.key === "Escape") { this.close(); this.input.blur(); }
  }

  private take(): void {
    if (this.at >= 0) { this.choose(this.offers[this.at]); return; }
    const text = this.input.value.trim();
    this.close();
    if (text) this.ask(text);
  }

  private choose(offer: Offer): void {
    const own = this.input.value === this.shown ? "" : this.input.value, before = own.split(";").slice(0, -1).map((part) => part.trim()), text = [...before, offer.text].join("; ");
    this.input.value = text;
    this.close();
    this.input.blur();
    if (offer.number !== undefined && !before.length) {
      const object = this.app.header.objects.find((one) => one.number === offer.number);
      void this.app.act({ act: "choose", number: offer.number }).then((done) => { if (done && object) this.app.flyTo(object); });
    } else this.ask(text);
  }

  ask(text: string, present = false): void {
    this.input.value = text;
    this.shown = text;
    void this.app.act({ act: "ask", text, ...(present ? { present } : {}) }).then((done) => {
      if (!done) { // nothing is answered, and what was typed can be mended
        this.input.value = text;
        this.shown = "";
        return;
      }
      this.remember(text);
      const first = this.app.state.results.flatMap((result) => result.matches)[0];
      if (first) this.app.flyTo(first);
      if (["objects", "catalogue"].includes(this.app.tab.name)) this.app.open(this.app.asking);
    });
  }
}
