// The numbers of the control: a slider and a field each, by block; the page knows no law, all comes from declarations.

import { button, renew } from "../parts";
import type { Knob } from "../wire";

export type Moved = (name: string, value: number | string, first: boolean) => void;

const STEPS = 1000;

export class Numbers {
  private readonly rows = new Map<string, { knob: Knob; slider: HTMLInputElement; field: HTMLInputElement }>();

  private last: Record<string, number> = {};

  constructor(
    private readonly section: HTMLElement,
    private readonly moved: Moved,
    private readonly removed: (place: number) => void = () => {},
  ) {}

  // The same knobs once more, as after a lost connection, leave the fields alone: somebody may be writing into one.
  list(knobs: Knob[]): void {
    renew(this.section, knobs, () => this.groups(knobs));
  }

  private groups(knobs: Knob[]): HTMLElement[] {
    this.rows.clear();
    const groups: HTMLElement[] = [];
    let group: HTMLFieldSetElement | null = null;
    let where = "";
    for (const knob of knobs) {
      const held = knob.name.split(".").slice(0, -1).join(".");
      if (held !== where || !group) {
        where = held;
        group = document.createElement("fieldset");
        const legend = document.createElement("legend");
        legend.textContent = `${held || "control"} (${knob.block.replaceAll("_", " ")})`;
        group.append(legend);
        const place = /^filters\.(\d+)$/.exec(held)?.[1];
        if (place)
          group.append(
            button("Remove", () => this.removed(Number(place)), {
              class: "remove",
              "aria-label": `Remove ${legend.textContent}`,
            }),
          );
        groups.push(group);
      }
      group.append(this.row(knob));
    }
    return groups;
  }

  // The numbers of now; without any those that were shown last, as after one that was refused.
  show(values: Record<string, number> = this.last): void {
    this.last = values;
    for (const [name, value] of Object.entries(values)) {
      const row = this.rows.get(name);
      if (!row) continue;
      row.slider.value = String(place(row.knob, value));
      row.slider.setAttribute("aria-valuetext", `${written(row.knob, value)} ${row.knob.unit}`);
      if (!row.field.dataset.typed) row.field.value = written(row.knob, value);
      row.slider.parentElement?.classList.toggle("changed", value !== row.knob.today);
    }
  }

  private row(knob: Knob): HTMLElement {
    const row = document.createElement("div");
    row.className = "number";
    const label = document.createElement("label");
    const slider = document.createElement("input");
    const field = document.createElement("input");
    const unit = document.createElement("span");
    const id = `number-${knob.name}`;
    label.htmlFor = id;
    label.textContent = knob.name.split(".").at(-1)!.replaceAll("_", " ");
    label.title = knob.meaning;
    slider.type = "range";
    slider.min = "0";
    slider.max = String(STEPS);
    slider.step = "any";
    slider.setAttribute("aria-label", `${knob.name}, ${knob.meaning}`);
    field.type = "text";
    field.inputMode = "decimal";
    field.id = id;
    unit.className = "unit";
    unit.textContent = knob.unit;
    let held = false;
    slider.addEventListener("pointerdown", () => (held = false));
    slider.addEventListener("input", () => {
      this.moved(knob.name, value(knob, Number(slider.value)), !held);
      held = true;
    });
    slider.addEventListener("change", () => (held = false));
    slider.addEventListener("keydown", (event) => {
      const way = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10 }[event.key];
      if (way === undefined) return;
      event.preventDefault();
      const to = Math.min(STEPS, Math.max(0, Number(slider.value) + 5 * way));
      this.moved(knob.name, value(knob, to), !event.repeat); // a key that is held is one step to undo
    });
    field.addEventListener("input", () => (field.dataset.typed = "yes")); // what is being typed is not written over
    field.addEventListener("change", () => {
      delete field.dataset.typed;
      const typed = Number(field.value.replace(",", "."));
      const known = field.value.trim() !== "" && Number.isFinite(typed);
      this.moved(knob.name, known ? typed / knob.factor : field.value, true); // the server says what is no number
    });
    row.append(label, slider, field, unit);
    this.rows.set(knob.name, { knob, slider, field });
    return row;
  }
}

function place(knob: Knob, value: number): number {
  const share = knob.logarithmic
    ? Math.log(value / knob.low) / Math.log(knob.high / knob.low)
    : (value - knob.low) / (knob.high - knob.low);
  return STEPS * Math.min(1, Math.max(0, share));
}

function value(knob: Knob, at: number): number {
  const share = at / STEPS;
  const found = knob.logarithmic ? knob.low * (knob.high / knob.low) ** share : knob.low + share * (knob.high - knob.low);
  return Number(found.toPrecision(4));
}

function written(knob: Knob, value: number): string {
  return String(Number((value * knob.factor).toPrecision(6)));
}
