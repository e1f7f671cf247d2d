// Peak figures of a log in the units of its columns, beside its table: does this look like the machine of the user?

import { button, make, renew, table } from "../parts";
import { look } from "../pictures/look";
import { Picture } from "../pictures/picture";
import type { Table } from "../result";
import type { Received } from "../wire";

export interface Checked {
  figures: Table | null; // what it is, its value, and what feed drives have
  outside: string[]; // figures that no feed drive has
  readings: Table | null; // the two likeliest units, if those of the columns are in doubt
  choices: [column: string, unit: string][][]; // the same, to be chosen
  notes: number; // how many of the sentences, the last ones, are no contradictions
}

export class Check {
  readonly element = make("section", { class: "check", "aria-labelledby": "check-question", hidden: "" });
  private readonly question = make("h3", { id: "check-question" });
  private readonly figures = make("div");
  private readonly doubts = make("div", { role: "status" });
  private readonly picture = new Picture("The log with these roles", 40);

  constructor(private readonly choose: (units: [column: string, unit: string][]) => void) {
    this.picture.element.id = "picture-columns";
    this.element.append(this.question, this.figures, this.doubts, this.picture.element);
  }

  // `file`: its columns are shown; `doubts`: sentences on roles and units that its samples contradict
  show(file: string, check: Checked | undefined, doubts: string[], left_out: string[]): void {
    this.element.hidden = check === undefined;
    if (!check) return;
    const { figures, outside, readings, choices, notes } = check;
    const certain = doubts.length - notes;
    this.question.textContent = figures ? "Does this look like your machine?" : "Columns over time";
    renew(this.figures, [file, figures, outside], () => (figures ? [cards(figures, outside)] : []));
    renew(this.doubts, [file, doubts, notes, readings, choices, left_out, figures === null], () => [
      ...doubts.map((each, i) => make("p", { class: i < certain ? "bad" : "note" }, each)),
      ...(readings ? [table(readings.heads, readings.rows)] : []),
      ...(choices.length ? [make("div", { class: "buttons" }, ...choices.map((each) => this.choice(each)))] : []),
      ...(figures
        ? []
        : [make("p", {}, "Choose which column is the position: then its travel, speed and acceleration are shown.")]),
      ...(left_out.length ? [make("p", {}, `Not read: ${left_out.join(", ")}.`)] : []),
    ]);
  }

  private choice(units: [string, string][]): HTMLButtonElement {
    const text = units.map(([column, unit]) => `${column} is in ${unit}`).join(", ");
    return button(text.replace("percent", "%"), () => this.choose(units));
  }

  draw({ said, numbers }: Received): void {
    const chart = said.charts.check;
    if (chart && !this.element.hidden) this.picture.draw(chart, numbers, look());
  }
}

// What a figure is in other units stands in brackets behind it; what feed drives have is said where it is something else.
function cards({ rows }: Table, outside: string[]): HTMLElement {
  return make(
    "dl",
    { class: "cards" },
    ...rows.map(([name = "", value = "", usual = ""]) => {
      const [figure = "", other] = value.split(" (");
      const wrong = outside.includes(name);
      const more = wrong ? `not ${usual}` : (other?.replace(")", "") ?? "");
      return make(
        "div",
        wrong ? { class: "bad" } : {},
        make("dt", {}, name),
        make("dd", {}, make("strong", {}, figure), make("small", {}, more)),
      );
    }),
  );
}
