// Over which plants limits hold: a choice of boxes or one's own tolerances, each a number with its unit.

import { make } from "../parts";
import { numberOf } from "./field";

const WORDS: Record<string, string> = {
  auto: "as identified, or the standard",
  standard: "stiffness ±20 %, mass ±30 %, 1 sample",
  identified: "by the errors of the identification",
  none: "the model alone",
};
const OWN = "own";
// Key, label, unit, the factor to the number of the box, and the suffix there.
const PARTS: [key: string, label: string, unit: string, factor: number, suffix: string][] = [
  ["stiffness", "Stiffness ±", "%", 0.01, ""],
  ["mass", "Mass ±", "%", 0.01, ""],
  ["dead_time", "Dead time +", "samples", 1, "sample"],
];

export class Tolerances {
  readonly element: HTMLElement;
  private readonly select: HTMLSelectElement;
  private readonly own = make("div", { class: "own", hidden: "" });
  private readonly fields = new Map<string, HTMLInputElement>();

  // `changed`: with the text of the box, as the server reads it
  constructor(id: string, changed: (box: string) => void) {
    const among = [...Object.entries(WORDS), [OWN, "tolerances of your own"]] as [string, string][];
    this.select = make("select", { id }, ...among.map(([value, text]) => make("option", { value }, text)));
    this.select.addEventListener("change", () => {
      if (this.select.value !== OWN) return changed(this.select.value);
      this.own.hidden = false;
      if (!this.text()) this.show("stiffness=0.2,mass=0.3,dead_time=1sample");
      changed(this.text());
    });
    for (const [key, label, unit] of PARTS) {
      const field = make("input", { type: "text", inputmode: "decimal", size: "4", id: `${id}-${key}` });
      field.addEventListener("change", () => changed(this.text() || "none"));
      this.fields.set(key, field);
      const entry = make("span", { class: "entry" }, field, make("span", { class: "unit" }, unit));
      this.own.append(make("label", { for: field.id }, label), entry);
    }
    this.element = make("div", { class: "tolerances" }, this.select, this.own);
  }

  show(box: string): void {
    const known = box in WORDS;
    if (document.activeElement !== this.select) this.select.value = known ? box : OWN;
    this.own.hidden = this.select.value !== OWN;
    if (known) return;
    for (const [key, , , factor] of PARTS) {
      const found = new RegExp(`(?:^|,) *${key} *= *([0-9.]+) *(%?)`).exec(box);
      const field = this.fields.get(key)!;
      if (document.activeElement === field) continue;
      field.value = found ? String(Number((Number(found[1]) / (found[2] ? 1 : factor)).toPrecision(4))) : "";
    }
  }

  // What was typed that is no number goes to the server as it is, which refuses it by name.
  private text(): string {
    return PARTS.flatMap(([key, , , factor, suffix]) => {
      const value = numberOf(this.fields.get(key)!.value);
      if (value === null || value === 0) return [];
      return [`${key}=${typeof value === "number" ? Number((value * factor).toPrecision(6)) : value}${suffix}`];
    }).join(",");
  }
}
