// The loop as a whole, faster or slower: one slider over the crossover, whose range and meaning the server says.

import { make } from "../parts";

export interface Faster {
  low: number;
  high: number;
  meaning: string;
}

const STEPS = 1000;

export class WholeLoop {
  readonly element: HTMLElement;
  private readonly slider = make("input", { type: "range", min: "0", max: String(STEPS), step: "any", id: "speed" });
  private readonly field = make("input", {
    type: "text",
    inputmode: "decimal",
    id: "speed-field",
    "aria-label": "crossover in Hz",
  });
  private readonly meaning = make("p", { class: "meaning" });
  private range: Faster = { low: 1, high: 2, meaning: "" };
  private held = false;

  constructor(moved: (value: number | string, first: boolean) => void) {
    const label = make("label", { for: "speed" }, "crossover");
    const row = make("div", { class: "number" }, label, this.slider, this.field, make("span", { class: "unit" }, "Hz"));
    this.element = make("fieldset", {}, make("legend", {}, "whole loop"), row, this.meaning);
    let drag = false;
    this.slider.addEventListener("pointerdown", () => (drag = false));
    this.slider.addEventListener("input", () => {
      moved(this.value(Number(this.slider.value)), !drag);
      drag = this.held = true;
    });
    this.slider.addEventListener("change", () => (drag = this.held = false));
    this.slider.addEventListener("keydown", (event) => {
      const way = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10 }[event.key];
      if (way === undefined) return;
      event.preventDefault();
      moved(this.value(Math.min(STEPS, Math.max(0, Number(this.slider.value) + 5 * way))), !event.repeat);
    });
    this.field.addEventListener("input", () => (this.field.dataset.typed = "yes"));
    this.field.addEventListener("change", () => {
      delete this.field.dataset.typed;
      const typed = Number(this.field.value.replace(",", "."));
      moved(this.field.value.trim() !== "" && Number.isFinite(typed) ? typed : this.field.value, true);
    });
  }

  list(range: Faster): void {
    this.range = range;
    this.meaning.textContent = range.meaning;
    this.slider.title = range.meaning;
  }

  // What the crossover is now; null where there is none.
  show(crossover: number | null): void {
    this.slider.disabled = this.field.disabled = crossover === null || this.range.high <= this.range.low;
    if (crossover === null) return;
    const { low, high } = this.range;
    const share = Math.log(crossover / low) / Math.log(high / low);
    if (!this.held) this.slider.value = String(STEPS * Math.min(1, Math.max(0, share)));
    this.slider.setAttribute("aria-valuetext", `${Number(crossover.toPrecision(4))} Hz`);
    if (!this.field.dataset.typed) this.field.value = String(Number(crossover.toPrecision(4)));
  }

  private value(at: number): number {
    const { low, high } = this.range;
    return Number((low * (high / low) ** (at / STEPS)).toPrecision(4));
  }
}
