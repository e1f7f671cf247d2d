// Which pictures are drawn, and in which units they and the numbers are read.

import { make } from "../parts";
import type { Ask } from "../room";

export interface Choice {
  name: string;
  title: string;
  chosen: boolean;
  why: string; // it cannot be drawn; empty if it can
}
export interface Unit {
  kind: string;
  chosen: string;
  among: [unit: string, text: string][];
}

export class Choices {
  readonly element = make("details", { id: "see" }, make("summary", {}, "Pictures and units"));
  private readonly place = make("div");

  constructor(private readonly ask: Ask) {
    this.element.append(this.place);
  }

  // Only when the choice is another one: what has the focus keeps it.
  list(choices: Choice[], units: Unit[]): void {
    const held = document.activeElement?.id ?? "";
    const reasons = [...new Set(choices.map((each) => each.why).filter((each) => each !== ""))];
    const boxes = choices.map(({ name, title, chosen, why }) => {
      const box = make("input", { type: "checkbox", id: `see-${name}`, value: name });
      box.checked = chosen && !why;
      box.disabled = why !== "";
      box.addEventListener("change", () => this.choose());
      if (why) box.setAttribute("aria-describedby", `why-${reasons.indexOf(why)}`);
      return make("li", {}, make("label", {}, box, ` ${title}`));
    });
    const notes = reasons.map((each, i) => make("p", { class: "why", id: `why-${i}` }, `What cannot be chosen ${each}.`));
    const lists = units.map(({ kind, chosen, among }) => {
      const select = make("select", { id: `unit-${kind}` }, ...among.map(([value, text]) => make("option", { value }, text)));
      select.value = chosen;
      select.addEventListener("change", () => this.ask({ do: "tune.unit", kind, unit: select.value }));
      return make("label", {}, `${kind} `, select);
    });
    this.place.replaceChildren(
      make("fieldset", {}, make("legend", {}, "Pictures"), make("ul", {}, ...boxes), ...notes),
      make("fieldset", { class: "units" }, make("legend", {}, "Units"), ...lists),
    );
    if (held.startsWith("see-") || held.startsWith("unit-")) document.getElementById(held)?.focus();
  }

  private choose(): void {
    const boxes = [...this.place.querySelectorAll<HTMLInputElement>("input:checked")];
    this.ask({ do: "tune.see", names: boxes.map((each) => each.value) });
  }
}
