// Elements, made in one call.

type Props = Record<string, string | number | boolean | ((event: never) => void) | null>;

/** Make an element. Props are attributes, `on...` are listeners; text is never read as markup. */
export function h<K extends keyof HTMLElementTagNameMap>(tag: K, props: Props = {}, ...children: (Node | string | null)[]): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (typeof value === "function") made.addEventListener(name.slice(2), value as unknown as EventListener);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null) made.setAttribute(name, String(value));
  }
  made.append(...children.filter((child): child is Node | string => child !== null));
  return made;
}

export const byId = <T extends HTMLElement = HTMLElement>(id: string): T => {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as T;
};

export function button(label: string, act: () => void, props: Props = {}): HTMLButtonElement {
  return h("button", { type: "button", onclick: act, ...props }, label);
}

/** A part that is folded until it is wanted; stays as it was left when it is made again. */
export function drawer(title: string, ...children: (Node | string | null)[]): HTMLDetailsElement {
  const made = h("details", { class: "drawer" }, h("summary", {}, title), ...children);
  made.open = unfolded.has(title);
  made.addEventListener("toggle", () => { if (made.open) unfolded.add(title); else unfolded.delete(title); });
  return made;
}
const unfolded = new Set<string>();

/** Offer a file to be kept. */
export function download(blob: Blob, name: string): void {
  const link = h("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

export const counted = (number: number, one: string, many = `${one}s`): string => `${number.toLocaleString("en")} ${number === 1 ? one : many}`;
