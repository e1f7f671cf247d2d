// The numbers of the control: a slider and a field each, by block; the page knows no law, all comes from declarations.

import { icon } from "../icons";
import { button, make, renew } from "../parts";
import type { Knob } from "../wire";
import { follow, type Moved } from "./slider";

// What is done with a filter, by its place: one that is on, or one that is off.
export interface Filters {
  removed(place: number, off: boolean): void;
  switched(place: number, on: boolean): void;
}

interface Row {
  knob: Knob;
  element: HTMLElement;
  slider: HTMLInputElement;
  field: HTMLInputElement;
  change: HTMLElement;
}

const STEPS = 1000;

export class Numbers {
  readonly off = make("div", { id: "filters-off" });
  private readonly rows = new Map<string, Row>();
  private last: Record<string, number> = {};

  constructor(
    private readonly law: HTMLElement,
    private readonly cards: HTMLElement,
    private readonly moved: Moved,
    private readonly filters: Filters,
  ) {}

  // The same knobs once more, as after a lost connection, leave the fields alone: somebody may be writing into one.
  list(knobs: Knob[]): void {
    const groups = new Map<string, Knob[]>();
    for (const knob of knobs) {
      const held = knob.name.split(".").slice(0, -1).join(".");
      groups.set(held, [...(groups.get(held) ?? []), knob]);
    }
    const places = [...groups].filter(([held]) => held.startsWith("filters."));
    const others = [...groups].filter(([held]) => !held.startsWith("filters."));
    const known = new Set(knobs.map((each) => each.name));
    for (const name of this.rows.keys()) if (!known.has(name)) this.rows.delete(name);
    renew(this.law, others, () => others.map(([held, of]) => this.group(held, of)));
    renew(this.cards, places, () => places.map(([held, of]) => this.card(held, of)));
  }

  // Filters that were taken out of the loop: their numbers stay.
  listOff(texts: string[]): void {
    renew(this.off, texts, () =>
      texts.map((text, place) => {
        const tools = this.tools(text, place, true);
        return make(
          "div",
          { class: "card off" },
          make("header", {}, make("span", { class: "tag" }, "–"), make("b", {}, text), ...tools),
        );
      }),
    );
  }

  // The numbers of now; without any those that were shown last, as after one that was refused.
  show(values: Record<string, number> = this.last): void {
    this.last = values;
    for (const [name, value] of Object.entries(values)) {
      const row = this.rows.get(name);
      if (!row) continue;
      const { knob, slider, field } = row;
      slider.value = String(place(knob, value));
      slider.style.setProperty("--at", `${place(knob, value) / (STEPS / 100)}%`);
      slider.setAttribute("aria-valuetext", `${written(knob, value)} ${knob.unit}`);
      if (!field.dataset.typed) field.value = written(knob, value);
      row.change.textContent = changed(knob.today, value);
      row.element.classList.toggle("changed", value !== knob.today);
      row.element.closest<HTMLElement>(".card")?.dispatchEvent(new CustomEvent("filled"));
    }
  }

  private group(held: string, knobs: Knob[]): HTMLElement {
    const name = held === "law" ? titled(knobs[0]!.title) : `${titled(held.replaceAll(".", " "))} (${titled(knobs[0]!.title)})`;
    const title = held === "law" || held === "" ? name : titled(held.split(".")[0]!);
    return make(
      "fieldset",
      { "data-held": held },
      make("legend", { title: name }, title),
      ...knobs.map((each) => this.row(each)),
    );
  }

  private card(held: string, knobs: Knob[]): HTMLElement {
    const number = Number(held.split(".")[1]);
    const kind = knobs[0]!.title;
    const legend = make("legend", { class: "spoken" }, `${held} (${kind})`);
    const at = make("i");
    const tag = make("span", { class: "tag" }, String(number + 1));
    const head = make(
      "header",
      {},
      tag,
      make("b", {}, `${titled(kind)} `, at),
      ...this.tools(`${held} (${kind})`, number, false),
    );
    const [exact, others] = [knobs.filter((each) => each.exact), knobs.filter((each) => !each.exact)];
    const rows = others.map((each) => this.row(each));
    if (exact.length)
      rows.push(make("details", { class: "exact" }, make("summary", {}, "Exact"), ...exact.map((each) => this.row(each))));
    const card = make("fieldset", { class: "card", "data-held": held }, legend, head, ...rows);
    const first = knobs.find((each) => each.dragged);
    card.addEventListener("filled", () => {
      if (first) at.textContent = `${written(first, this.last[first.name] ?? first.today)} ${first.unit}`;
    });
    return card;
  }

  private tools(name: string, place: number, off: boolean): HTMLElement[] {
    const on = button("", () => this.filters.switched(place, off), {
      class: "switch",
      role: "switch",
      "aria-checked": String(!off),
      "aria-label": `${name} in the loop`,
      title: off ? "Put it back into the loop" : "Take it out of the loop; its numbers stay",
    });
    const gone = button("", () => this.filters.removed(place, off), {
      class: "tool",
      "aria-label": `Remove ${name}`,
      title: "Remove",
    });
    gone.append(icon("remove"));
    return [on, gone];
  }

  private row(knob: Knob): HTMLElement {
    const id = `number-${knob.name}`;
    const label = make("label", { for: id, title: `${knob.name}: ${knob.meaning}` }, titled(knob.name.split(".").at(-1)!));
    const slider = make("input", { type: "range", min: "0", max: String(STEPS), step: "any" });
    const field = make("input", { type: "text", inputmode: "decimal", id });
    const change = make("span", { class: "change" });
    slider.setAttribute("aria-label", `${knob.name}, ${knob.meaning}`);
    const tick = make("i", { class: "tick" }); // where today's value stands
    tick.style.setProperty("--at", String(place(knob, knob.today) / STEPS));
    follow(
      slider,
      field,
      (at) => value(knob, at),
      (typed) => typed / knob.factor,
      (at, first) => this.moved(knob.name, at, first),
    );
    const unit = make("span", { class: "unit" }, knob.unit);
    const element = make(
      "div",
      { class: "number" },
      label,
      make("span", { class: "entry" }, field, unit),
      change,
      make("span", { class: "track" }, slider, tick),
    );
    this.rows.set(knob.name, { knob, element, slider, field, change });
    return element;
  }
}

// A name as a title: `velocity_feedforward` is Velocity feedforward, and Kv stays.
function titled(name: string): string {
  const text = name.replaceAll("_", " ");
  return text.slice(0, 1).toUpperCase() + text.slice(1);
}

// The change to today in percent, or in numbers where today's value is 0.
function changed(today: number, value: number): string {
  if (value === today) return "same";
  if (today === 0) return "new";
  const share = (100 * (value - today)) / Math.abs(today);
  const size = Math.abs(share) >= 9.95 ? Math.abs(share).toFixed(0) : Math.abs(share).toFixed(1);
  return Math.abs(share) >= 1000 ? `${(value / today).toPrecision(3)} x` : `${share < 0 ? "−" : "+"}${size} %`;
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
