// Ctrl+K: views, parameters, figures, actions, commands and the documentation by the words of the trade. The server
// knows the places (studio/rooms/search.py); what stands on the page, the page finds itself.

import { button, make, renew } from "./parts";
import type { Ask } from "./room";
import type { Received } from "./wire";

interface Place {
  title: string;
  kind: string;
  detail: string;
  view: string;
  element: string;
  page: string;
  heading: string;
}
interface Reading {
  title: string;
  page: string;
  parts: { kind: "text" | "code" | "row"; text: string }[];
}

const LETTERS = "feeddrive letters"; // whether letters and digits are keys
const OWN = 5; // places of the page at most
const TRIES = 40; // of 50 ms: what a view shows comes with the answer of the server

// Whether letters and digits act where no field has the focus.
export function letters(): boolean {
  return localStorage.getItem(LETTERS) !== "off";
}

export class Search {
  readonly element = make("dialog", { id: "search", "aria-label": "Search" });
  private readonly field = make("input", {
    type: "text",
    id: "search-field",
    role: "combobox",
    "aria-label": "Search views, parameters, actions, commands and documentation",
    "aria-controls": "search-found",
    "aria-expanded": "true",
    "aria-autocomplete": "list",
    placeholder: "rope snap, notch, backlash, Kv, lag ...",
    autocomplete: "off",
    spellcheck: "false",
  });
  private readonly list = make("ul", { id: "search-found", role: "listbox", "aria-label": "Found" });
  private readonly text = make("article", { id: "search-text", tabindex: "0", "aria-label": "Documentation", hidden: "" });
  private readonly said = make("p", { role: "status", class: "meaning" });
  private theirs: Place[] = [];
  private places: Place[] = [];
  private at = 0;

  constructor(
    private readonly ask: Ask,
    private readonly titles: ReadonlyMap<string, string>, // of the views
    private readonly go: (view: string) => void,
    private readonly begun: () => void, // views that were not open yet show what they have
  ) {
    const keys = make("input", { type: "checkbox", id: "letters" });
    keys.checked = letters();
    keys.addEventListener("change", () => localStorage.setItem(LETTERS, keys.checked ? "on" : "off"));
    const close = button("Close", () => this.element.close(), { "aria-label": "Close the search" });
    this.element.append(
      make("header", {}, this.field, close),
      this.said,
      this.list,
      this.text,
      make("footer", {}, make("label", {}, keys, " Letters and digits are keys where no field has the focus")),
    );
    this.field.addEventListener("input", () => this.seek());
    this.field.addEventListener("keydown", (event) => this.key(event));
    this.element.addEventListener("click", (event) => {
      if (event.target === this.element) this.element.close(); // beside it
    });
  }

  open(): void {
    if (this.element.open) return this.field.select();
    this.element.showModal();
    this.begun();
    this.field.select();
    this.seek();
  }

  heard({ said }: Received): void {
    if (said.reading) return this.read(said.reading as Reading);
    if (said.found === undefined || said.sought !== this.field.value.trim().slice(0, 80)) return;
    this.theirs = said.found as Place[];
    this.draw();
  }

  private seek(): void {
    this.text.hidden = true;
    this.list.hidden = false;
    this.theirs = [];
    this.at = 0;
    const text = this.field.value.trim();
    if (text.length > 1) this.ask({ do: "search.find", text: text.slice(0, 80) });
    this.draw();
  }

  // Buttons, fields and views whose name has all words.
  private own(): Place[] {
    const words = this.field.value.toLowerCase().split(/\s+/).filter(Boolean);
    if (!words.length) return [...this.titles].map(([view, title]) => place(title, "view", "", view, ""));
    const found: Place[] = [...this.titles]
      .filter(([, title]) => has(title, words))
      .map(([view, title]) => place(title, "view", "", view, ""));
    for (const each of document.querySelectorAll<HTMLElement>(
      "main button[id], main input[id], main select[id], header button[id]",
    )) {
      if (each.hidden || each.closest("#notices, #works, #works-list, dialog")) continue;
      const view = each.closest<HTMLElement>('[role="tabpanel"]')?.id.replace("room-", "") ?? "";
      const name = called(each);
      if (name && has(`${name} ${each.title}`, words))
        found.push(place(name, "on the page", each.title, view, `#${CSS.escape(each.id)}`));
    }
    return found.slice(0, OWN);
  }

  private draw(): void {
    const own = this.own();
    const known = new Set(own.map((each) => each.element || each.view));
    const titled = this.theirs.map((each) =>
      each.kind === "view" ? { ...each, title: this.titles.get(each.view) ?? "" } : each,
    );
    // a parameter or figure of that name before the buttons
    const first = titled.filter((each) => ["parameter", "figure", "limit"].includes(each.kind));
    const rest = titled.filter(
      (each) => !first.includes(each) && !known.has(each.kind === "view" ? each.view : each.element || "-"),
    );
    const elements = new Set([...first, ...titled.filter((each) => each.kind === "picture")].map((each) => each.element));
    const boxes = new Set([...elements].map((each) => each.replace("#picture-", "#see-"))); // where a picture is chosen
    this.places = [
      ...first,
      ...own.filter((each) => !each.element || !(elements.has(each.element) || boxes.has(each.element))),
      ...rest,
    ];
    this.at = Math.min(this.at, Math.max(0, this.places.length - 1));
    const empty = this.field.value.trim().length > 1 && !this.places.length;
    this.said.textContent = empty ? "Nothing is called so; try another word of the trade." : "";
    renew(this.list, this.places, () => this.places.map((each, i) => this.row(each, i)));
    this.choose(this.at);
  }

  private row(each: Place, i: number): HTMLElement {
    const where = each.view ? (this.titles.get(each.view) ?? "") : each.page ? "to read" : "";
    const row = make(
      "li",
      { role: "option", id: `found-${i}`, "aria-selected": "false" },
      make("b", {}, each.title),
      make("small", {}, [each.kind, each.kind === "view" ? "" : where].filter(Boolean).join(" · ")),
      make("span", {}, each.detail.slice(0, 140)),
    );
    row.addEventListener("click", () => this.take(i));
    return row;
  }

  private choose(i: number): void {
    this.at = i;
    for (const [k, row] of [...this.list.children].entries()) row.setAttribute("aria-selected", String(k === i));
    this.field.setAttribute("aria-activedescendant", this.places.length ? `found-${i}` : "");
    this.list.children[i]?.scrollIntoView({ block: "nearest" });
  }

  private key(event: KeyboardEvent): void {
    const way = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (way !== undefined && this.places.length) {
      event.preventDefault();
      this.choose((this.at + way + this.places.length) % this.places.length);
    } else if (event.key === "Enter" && !event.ctrlKey) {
      event.preventDefault();
      this.take(this.at);
    }
  }

  private take(i: number): void {
    const found = this.places[i];
    if (!found) return;
    if (found.view || found.element) {
      this.element.close();
      if (found.view) this.go(found.view);
      void focus(found);
    } else if (found.page) this.ask({ do: "search.read", page: found.page, heading: found.heading });
  }

  private read({ title, page, parts }: Reading): void {
    this.list.hidden = true;
    this.text.hidden = false;
    const lines = parts.map(({ kind, text }) =>
      make(kind === "code" ? "pre" : "p", kind === "row" ? { class: "row" } : {}, text),
    );
    this.text.replaceChildren(
      make("h2", {}, title),
      ...(page ? [make("p", { class: "meaning" }, `docs/${page}.md`)] : []),
      ...lines,
    );
    this.text.scrollTop = 0;
    this.text.focus();
  }
}

function place(title: string, kind: string, detail: string, view: string, element: string): Place {
  return { title, kind, detail, view, element, page: "", heading: "" };
}

function has(text: string, words: string[]): boolean {
  const known = text.toLowerCase().split(/[^\p{L}\p{N}]+/u);
  return words.every((word) => known.some((each) => each.startsWith(word)));
}

function called(element: HTMLElement): string {
  const labels = element instanceof HTMLButtonElement ? [] : [...((element as HTMLInputElement).labels ?? [])];
  const label = labels.map((each) => each.textContent?.trim() ?? "").join(" ");
  return element.getAttribute("aria-label") || label || (element instanceof HTMLButtonElement ? element.textContent!.trim() : "");
}

// Focus a place as soon as its view shows it; what has no focus of its own has one inside.
async function focus({ view, element }: Place): Promise<void> {
  for (let tried = 0; tried < TRIES; tried++) {
    const panel = view ? document.getElementById(`room-${view}`) : document.body;
    const found = element
      ? document.querySelector<HTMLElement>(element)
      : panel?.querySelector<HTMLElement>("button, input, select");
    if (found && found.getClientRects().length) {
      const inside = 'button:not(:disabled), input:not(:disabled), select, [tabindex="0"]';
      const target = found.matches("button, input, select, [tabindex]") ? found : found.querySelector<HTMLElement>(inside);
      found.closest("details")?.setAttribute("open", "");
      found.scrollIntoView({ block: "nearest" });
      target?.focus();
      if (target === document.activeElement) {
        if (target instanceof HTMLInputElement && target.type === "text") target.select();
        return;
      }
    }
    await new Promise((done) => setTimeout(done, 50));
  }
  // a picture that is not shown: where it is chosen
  const name = element.replace("#picture-", "");
  const box = document.getElementById(`see-${name}`);
  box?.closest("details")?.setAttribute("open", "");
  (box ?? document.querySelector<HTMLElement>(`#tab-${view}`))?.focus();
}
