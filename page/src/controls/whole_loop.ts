// The loop as a whole, faster or slower: one slider over the crossover, whose range and meaning the server says.

import { make } from "../parts";
import { follow } from "./slider";

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
  private readonly label = make("label", { for: "speed" }, "Crossover");
  private range: Faster = { low: 1, high: 2, meaning: "" };
  private held = false;

  constructor(moved: (value: number | string, first: boolean) => void) {
    const unit = make("span", { class: "unit" }, "Hz");
    const row = make("div", { class: "number" }, this.label, make("span", { class: "entry" }, this.field, unit));
    row.append(make("span", { class: "change" }), make("span", { class: "track" }, this.slider));
    this.element = make("div", { class: "whole-loop" }, row);
    this.slider.addEventListener("input", () => (this.held = true));
    this.slider.addEventListener("change", () => (this.held = false));
    follow(
      this.slider,
      this.field,
      (at) => this.value(at),
      (typed) => typed,
      moved,
    );
  }

  list(range: Faster): void {
    this.range = range;
    for (const each of [this.label, this.slider]) each.title = range.meaning;
  }

  // What the crossover is now; null where there is none.
  show(crossover: number | null): void {
    this.slider.disabled = this.field.disabled = crossover === null || this.range.high <= this.range.low;
    if (crossover === null) return;
    const { low, high } = this.range;
    const share = Math.min(1, Math.max(0, Math.log(crossover / low) / Math.log(high / low)));
    if (!this.held) this.slider.value = String(STEPS * share);
    this.slider.style.setProperty("--at", `${100 * share}%`);
    this.slider.setAttribute("aria-valuetext", `${Number(crossover.toPrecision(4))} Hz`);
    if (!this.field.dataset.typed) this.field.value = String(Number(crossover.toPrecision(4)));
  }

  private value(at: number): number {
    const { low, high } = this.range;
    return Number((low * (high / low) ** (at / STEPS)).toPrecision(4));
  }
}
