// The current control is proven: a certificate, and the circle test on the machine.

import { look, whenPainted } from "../pictures/look";
import { button, choice, make, renew } from "../parts";
import { Picture } from "../pictures/picture";
import { Report, type Result } from "../result";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

interface Place {
  text: string;
  view: number[]; // of the picture: left, right, and of a plane low, high
}
interface Words {
  ready: boolean;
  axes: string[];
  shown: Record<string, Result & { peaks?: Place[] }>;
}

// Pictures that the room draws itself, beside those of the report, by part and chart.
const PICTURES: Record<string, Record<string, string>> = {
  certificate: {},
  circle: { circle: "Circle test: the deviation, magnified", unrolled: "Deviation over the angle; hollow: quadrant peaks" },
};
const HEADS: Record<string, string> = {
  certificate: "Certificate",
  circle: "Circle test",
};

interface Part {
  section: HTMLElement;
  pictures: Map<string, Picture>;
  list: HTMLElement; // places that can be looked at
  report: Report;
}

export class Prove implements Room {
  readonly name = "prove";
  readonly title = "Prove";
  readonly element = make("div", { class: "prove" });
  private readonly hint = make("p", {}, "Import a machine first: what moves needs its masses and limits.");
  private readonly buttons = make("div", { class: "buttons" });
  private readonly intro = make("div", { class: "empty" });
  private readonly parts = new Map(Object.keys(PICTURES).map((name) => [name, part(name)]));
  private readonly chosen = { x: "", y: "" };
  private last: Received | null = null;

  constructor(private readonly ask: Ask) {
    this.intro.append(
      make("h1", {}, "Prove the loop stable"),
      make(
        "p",
        {},
        "A certificate covers every plant in a disc around the model, with the control as it will run, in exact arithmetic. ",
        "A checker that shares no code with it checks each step.",
      ),
      make("p", {}, "The circle test of ISO 230-4 runs on the simulated machine with the same control."),
    );
    this.element.append(this.hint, this.buttons, this.intro, ...[...this.parts.values()].map((each) => each.section));
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    this.last = received;
    const words = received.said as unknown as Words;
    this.hint.hidden = words.ready;
    this.buttons.hidden = !words.ready;
    this.intro.hidden = !words.ready || Object.keys(words.shown).length > 0;
    this.head(words);
    this.order(Object.keys(words.shown));
    for (const [name, each] of this.parts) {
      const found = words.shown[name];
      each.section.hidden = !found;
      if (!found) continue;
      each.report.show(found);
      if (name === "circle")
        this.list(each, "Quadrant peaks: choose one to look at it", found.peaks ?? [], (at) =>
          zoom(each.pictures.get("unrolled")!, at),
        );
    }
    this.draw();
  }

  shown(): void {
    this.draw();
  }

  // The latest result stands first.
  private order(names: string[]): void {
    const wanted = names.map((name) => this.parts.get(name)!.section).reverse();
    const now = [...this.element.children].filter((each) => wanted.includes(each as HTMLElement));
    if (now.some((each, i) => each !== wanted[i])) this.element.append(...wanted);
  }

  private head(words: Words): void {
    const { chosen } = this;
    const [first = "", second = first] = words.axes;
    if (!words.axes.includes(chosen.x)) chosen.x = first;
    if (!words.axes.includes(chosen.y)) chosen.y = second;
    const select = (label: string, among: string[], key: keyof typeof chosen) => {
      const found = choice(
        label,
        among.map((each): [string, string] => [each, each]),
        (value) => (chosen[key] = value),
      );
      found.querySelector("select")!.value = chosen[key];
      return found;
    };
    const circle = [
      select("x", words.axes, "x"),
      select("y", words.axes, "y"),
      button("Circle test", () => this.ask({ do: "prove.circle", x: chosen.x, y: chosen.y }), { id: "prove-circle" }),
    ];
    renew(this.buttons, words.axes, () => [
      button("Prove stability", () => this.ask({ do: "prove.certify" }), { id: "prove-certify", class: "main" }),
      ...(words.axes.length > 1 ? circle : []),
    ]);
  }

  private list(of: Part, title: string, places: Place[], act: (at: Place) => void): void {
    renew(of.list, places, () => {
      const rows = places.map((each) => {
        const found = button(each.text, () => {
          for (const other of of.list.querySelectorAll("button")) other.setAttribute("aria-pressed", String(other === found));
          act(each);
        }, { class: "worst", "aria-pressed": "false" }); // prettier-ignore
        return make("li", {}, found);
      });
      return places.length ? [make("h3", {}, title), make("ol", {}, ...rows)] : [];
    });
  }

  private draw(): void {
    if (!this.last || this.element.closest("[hidden]")) return;
    for (const [name, { section, pictures, report }] of this.parts) {
      if (!section.hidden) report.draw(this.last);
      for (const [key, picture] of pictures) {
        const chart = section.hidden ? undefined : this.last.said.charts[`${name}.${key}`];
        picture.element.hidden = !chart;
        if (chart) picture.draw(chart, this.last.numbers, look());
      }
    }
  }
}

function part(name: string): Part {
  const pictures = new Map(Object.entries(PICTURES[name]!).map(([key, title]) => [key, new Picture(title)]));
  for (const [key, each] of pictures) each.element.id = `proof-${name}-${key}`;
  const [first, ...others] = [...pictures.values()].map((each) => each.element);
  const [list, report] = [make("div"), new Report(`proof-${name}`, `${name}.`)];
  const grid = first ? [make("div", { class: "grid" }, first, make("div", {}, ...others, list))] : [];
  const section = make(
    "section",
    { id: `proof-${name}`, hidden: "" },
    make("h2", {}, HEADS[name]!),
    report.head,
    ...grid,
    report.body,
  );
  return { section, pictures, list, report };
}

function zoom(picture: Picture, { view: [left, right, low, high] }: Place): void {
  picture.zoom({ low: left!, high: right! }, low === undefined ? null : { low, high: high! });
}
