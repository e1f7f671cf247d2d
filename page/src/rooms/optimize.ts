// Tuning by goal: fields and lines in the pictures set the limits, the tuner searches, and a person accepts or rejects.

import { Levels, type Level } from "../controls/levels";
import { look, whenPainted } from "../pictures/look";
import { button, make, offer, renew } from "../parts";
import { Picture } from "../pictures/picture";
import { Report, type Result } from "../result";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

interface Field {
  name: string;
  label: string;
  meaning: string;
  unit: string;
  options: string[];
  offered: string[];
  value: string;
}
interface Words {
  fields: Field[];
  ready: boolean;
  levels?: Level[];
  best?: boolean;
  found?: Result | null;
  unfinished?: boolean;
  begins?: string;
  over?: string;
  go?: string;
}

const TITLES: Record<string, string> = {
  sensitivity: "Sensitivity: drag the line to set Ms",
  stiffness: "Dynamic stiffness: drag the line to set the least",
  open_loop: "Open loop",
  search: "The search",
};

export class Optimize implements Room {
  readonly name = "optimize";
  readonly title = "Optimize";
  readonly element = make("div", { class: "optimize" });
  private readonly form = make("div", { class: "fields" });
  private readonly buttons = make("div", { class: "buttons" });
  private readonly verdict = make("div", { "aria-live": "polite" });
  private readonly report = new Report("optimize-found");
  private readonly pictures = new Map(Object.entries(TITLES).map(([name, title]) => [name, new Picture(title)]));
  private readonly levels: Levels[];
  private readonly tune: HTMLButtonElement;
  private readonly accept: HTMLButtonElement;
  private readonly reject: HTMLButtonElement;
  private last: Received | null = null;

  constructor(private readonly ask: Ask) {
    const grid = make("div", { class: "grid" });
    for (const [name, picture] of this.pictures) {
      picture.element.id = `optimize-${name}`;
      grid.append(picture.element);
    }
    this.levels = ["sensitivity", "stiffness"].map(
      (name) => new Levels(name, this.pictures.get(name)!, (field, value) => ask({ do: "optimize.level", field, value })),
    );
    this.tune = button("Start", () => ask({ do: "optimize.tune" }), { id: "tune-start", class: "main" });
    this.accept = button("Use result", () => ask({ do: "optimize.accept" }), { id: "optimize-accept" });
    this.reject = button("Discard", () => ask({ do: "optimize.reject" }), { id: "optimize-reject" });
    this.buttons.append(this.tune, this.accept, this.reject);
    this.element.append(
      make("section", { class: "settings", "aria-label": "Goal and limits" }, make("h2", {}, "Goal and limits"), this.form),
      make("section", { "aria-label": "Search" }, this.buttons, this.verdict, this.report.head, grid, this.report.body),
    );
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    const words = received.said as unknown as Words;
    this.last = received;
    this.place(words.fields);
    this.tune.disabled = !words.ready;
    this.accept.disabled = this.reject.disabled = !words.best;
    const accept = words.unfinished ? "Use best so far (not proven)" : words.found?.bad ? "Use it all the same" : "Use result";
    if (this.accept.textContent !== accept) this.accept.textContent = accept;
    const { ready, begins, over, unfinished, found = null } = words;
    renew(this.verdict, [ready, begins, over, unfinished], () => [
      ...(ready ? [] : [make("p", {}, "Import a machine or a measured response first.")]),
      ...(begins ? [make("p", {}, begins)] : []),
      ...(over ? [make("p", { id: "optimize-over" }, over)] : []),
      ...(unfinished ? [make("p", {}, "The search has not finished: what is shown is the best so far, and is not proven.")] : []),
    ]);
    this.report.show(found);
    if (words.go) document.dispatchEvent(new CustomEvent("go", { detail: words.go }));
    this.draw();
  }

  shown(): void {
    this.draw();
  }

  // Fields stay while somebody writes into them.
  private place(fields: Field[]): void {
    const made = fields.map(({ value: _value, ...rest }) => rest);
    renew(this.form, made, () => fields.map((field) => this.field(field)));
    for (const { name, value } of fields) {
      const input = this.form.querySelector<HTMLInputElement | HTMLSelectElement>(`#optimize-field-${name}`)!;
      if (document.activeElement !== input || input instanceof HTMLSelectElement) input.value = value;
    }
  }

  private field(field: Field): HTMLElement {
    const id = `optimize-field-${field.name}`;
    const set = (value: string) => this.ask({ do: "optimize.set", field: field.name, value });
    let input: HTMLSelectElement | HTMLInputElement;
    if (field.options.length) {
      input = make("select", { id }, ...field.options.map((value) => make("option", { value }, value)));
    } else input = make("input", { id, type: "text", size: field.offered.length ? "28" : "8" });
    const offered = offer(input, field.offered);
    const meaning = make("small", { id: `${id}-meaning` }, field.meaning);
    input.setAttribute("aria-describedby", meaning.id);
    input.addEventListener("change", () => set(input.value));
    return make(
      "div",
      { class: "setting" },
      make("label", { for: id }, field.label),
      make("span", {}, input, ...offered, make("span", { class: "unit" }, field.unit)),
      meaning,
    );
  }

  private draw(): void {
    if (!this.last || this.element.closest("[hidden]")) return;
    for (const [name, picture] of this.pictures) {
      const chart = this.last.said.charts[name];
      picture.element.hidden = !chart;
      if (chart) picture.draw(chart, this.last.numbers, look());
    }
    this.report.draw(this.last);
    for (const each of this.levels) each.show((this.last.said.levels as Level[] | undefined) ?? []);
  }
}
