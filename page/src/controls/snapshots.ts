// Today, now and what was kept: the legend of all pictures, and the way back to each.

import { icon, line } from "../icons";
import { dashes } from "../pictures/drawing";
import { color, look, whenPainted } from "../pictures/look";
import { button, make } from "../parts";
import type { Ask } from "../room";

export const LETTERS = ["A", "B", "C"];
const NUMBERS: Record<string, number> = { today: 100, now: 101, A: 102, B: 103, C: 104 }; // as on the server

export class Snapshots {
  readonly element = make("div", { class: "snapshots", role: "group", "aria-label": "Controls that are compared" });
  readonly hidden = new Set<number>();
  private kept: string[] = [];

  constructor(
    private readonly ask: Ask,
    private readonly changed: () => void,
  ) {
    whenPainted(() => this.draw());
    this.draw();
  }

  show(kept: string[]): void {
    if (String(kept) === String(this.kept)) return;
    this.kept = kept;
    this.draw();
  }

  // Show or hide a control in all pictures.
  toggle(name: string): void {
    const number = NUMBERS[name]!;
    if (!this.hidden.delete(number)) this.hidden.add(number);
    this.draw();
    this.changed();
  }

  // The names of those that are hidden.
  get away(): string[] {
    return Object.keys(NUMBERS).filter((name) => this.hidden.has(NUMBERS[name]!));
  }

  has(letter: string): boolean {
    return this.kept.includes(letter);
  }

  private draw(): void {
    const held = document.activeElement?.id ?? "";
    const chips = [this.chip("today", "Today", "reset", () => this.ask({ do: "tune.reset" }), "Go back to today's control")];
    for (const letter of this.kept)
      chips.push(this.chip(letter, letter, `take-${letter}`, () => this.ask({ do: "tune.take", letter }), `Go to ${letter}`));
    const next = LETTERS.find((each) => !this.kept.includes(each));
    if (next)
      chips.push(
        button(`Keep as ${next}`, () => this.ask({ do: "tune.keep", letter: next }), {
          class: "chip keep",
          id: "keep",
          title: `Keep the numbers of now as ${next} (Shift+${next})`,
        }),
      );
    chips.push(this.chip("now", "Now"));
    this.element.replaceChildren(...chips);
    if (held && !document.getElementById(held)?.contains(document.activeElement)) document.getElementById(held)?.focus();
  }

  private chip(name: string, text: string, id = "", go: (() => void) | null = null, why = ""): HTMLElement {
    const number = NUMBERS[name]!;
    const tint = color(number, look());
    const shown = !this.hidden.has(number);
    const eye = button("", () => this.toggle(name), {
      id: `show-${name}`,
      "aria-pressed": String(shown),
      title: `Show or hide ${text} in all pictures${name === "now" ? "" : ` (${name === "today" ? "T" : name})`}`,
    });
    eye.append(line(tint, dashes(number)), make("b", {}, text));
    const found = make("span", { class: "chip" }, eye);
    found.style.setProperty("--of", tint);
    found.classList.toggle("off", !shown);
    if (go) {
      const back = button("", go, { id, class: "go", title: why, "aria-label": why });
      back.append(icon("undo"));
      found.append(back);
    }
    return found;
  }
}
