// Tuning by goal: fields and lines in the pictures set the limits, the tuner searches, and a person accepts or rejects.

import { Levels, type Level } from "../controls/levels";
import { look, whenPainted } from "../pictures/look";
import { button, make } from "../parts";
import { Picture } from "../pictures/picture";
import { tables } from "../result";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

interface Field {
  name: string;
  label: string;
  meaning: string;
  unit: string;
  options: string[];
  value: string;
}
interface Words {
  fields: Field[];
  ready: boolean;
  levels?: Level[];
  best?: boolean;
  said?: string[];
  tables?: { title: string; heads: string[]; rows: string[][] }[];
  verdict?: string;
  failure?: string;
  unfinished?: boolean;
  begins?: string;
  go?: string;
}

const TITLES: Record<string, string> = {
  sensitivity: "Sensitivity: drag the line to set Ms",
  stiffness: "Dynamic stiffness: drag the line to set the least",
  open_loop: "Open loop",
  search: "The search",
};

export class Goal implements Room {
  readonly name = "goal";
  readonly title = "Tune by goal";
  readonly element = make("div", { class: "goal" });
  private readonly form = make("div", { class: "fields" });
  private readonly buttons = make("div", { class: "buttons" });
  private readonly verdict = make("div", { "aria-live": "polite" });
  private readonly outcome = make("section", { "aria-label": "What was found" });
  private readonly pictures = new Map(Object.entries(TITLES).map(([name, title]) => [name, new Picture(title)]));
  private readonly levels: Levels[];
  private last: Received | null = null;

  constructor(private readonly ask: Ask) {
    const grid = make("div", { class: "grid" });
    for (const [name, picture] of this.pictures) {
      picture.element.id = `goal-${name}`;
      grid.append(picture.element);
    }
    this.levels = ["sensitivity", "stiffness"].map(
      (name) => new Levels(name, this.pictures.get(name)!, (field, value) => ask({ do: "goal.level", field, value })),
    );
    this.element.append(this.form, this.buttons, this.verdict, grid, this.outcome);
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    const words = received.said as unknown as Words;
    this.last = received;
    this.form.replaceChildren(...words.fields.map((field) => this.field(field)));
    const tune = button("Tune", () => this.ask({ do: "goal.tune" }), { id: "tune-start", class: "main" });
    const accept = button(words.unfinished ? "Accept the best so far" : "Accept", () => this.ask({ do: "goal.accept" }), {
      id: "goal-accept",
    });
    const reject = button("Reject", () => this.ask({ do: "goal.reject" }), { id: "goal-reject" });
    tune.disabled = !words.ready;
    accept.disabled = reject.disabled = !words.best;
    this.buttons.replaceChildren(tune, accept, reject);
    this.verdict.replaceChildren(
      ...(words.ready ? [] : [make("p", {}, "Bring a machine or a measured response first.")]),
      ...(words.begins ? [make("p", {}, words.begins)] : []),
      ...(words.verdict ? [make("p", { class: "verdict" }, words.verdict)] : []),
      ...(words.failure ? [make("p", { class: "bad" }, words.failure)] : []),
      ...(words.unfinished
        ? [make("p", {}, "The search has not finished: what is shown is the best so far, and is not proven.")]
        : []),
    );
    this.outcome.replaceChildren(
      make("ul", {}, ...(words.said ?? []).filter((each) => each !== words.verdict).map((each) => make("li", {}, each))),
      ...tables(words.tables ?? []),
    );
    if (words.go) document.dispatchEvent(new CustomEvent("go", { detail: words.go }));
    this.draw();
  }

  shown(): void {
    this.draw();
  }

  private field(field: Field): HTMLElement {
    const id = `goal-field-${field.name}`;
    const set = (value: string) => this.ask({ do: "goal.set", field: field.name, value });
    let input: HTMLSelectElement | HTMLInputElement;
    if (field.options.length) {
      input = make("select", { id }, ...field.options.map((value) => make("option", { value }, value)));
    } else input = make("input", { id, type: "text", size: "8" });
    input.value = field.value;
    input.title = field.meaning;
    input.addEventListener("change", () => set(input.value));
    return make("label", { for: id, title: field.meaning }, `${field.label} `, input, field.unit ? ` ${field.unit}` : "");
  }

  private draw(): void {
    if (!this.last || this.element.closest("[hidden]")) return;
    for (const [name, picture] of this.pictures) {
      const chart = this.last.said.charts[name];
      picture.element.hidden = !chart;
      if (chart) picture.draw(chart, this.last.numbers, look());
    }
    for (const each of this.levels) each.show((this.last.said.levels as Level[] | undefined) ?? []);
  }
}
