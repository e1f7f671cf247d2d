// A view without content: what it is for, its one filled button, and a real example that says it is one.

import { button, make } from "./parts";

export interface Empty {
  title: string;
  sentence: string; // what the view gives
  act?: HTMLButtonElement; // its one filled button
  note?: string; // how long it takes, or what it does not need
  more?: (string | Node)[]; // below the button
  example?: { of: HTMLElement; shows: Node }; // `of`: whose it is, as a badge
}

export function empty({ title, sentence, act, note = "", more = [], example }: Empty): HTMLElement {
  const words = make("div", { class: "words" }, make("h1", {}, title), make("p", {}, sentence));
  if (act) {
    act.classList.add("main");
    words.append(act);
  }
  if (note) words.append(make("p", { class: "note" }, note));
  words.append(...more);
  return make(
    "div",
    { class: "empty" },
    words,
    ...(example ? [make("div", { class: "example" }, example.of, example.shows)] : []),
  );
}

// The button of a view that needs an axis, and there is none yet.
export function imports(text = "Import an axis"): HTMLButtonElement {
  return button(text, () => document.dispatchEvent(new CustomEvent("go", { detail: "import" })), { class: "main" });
}

// "Example: the bundled ball screw", on the example.
export function badge(of: string): HTMLElement {
  return make("span", { class: "badge" }, of ? `Example: ${of}` : "Example");
}
