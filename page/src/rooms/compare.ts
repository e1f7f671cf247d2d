// Laws at equal robustness: the likeliest first, a row as each is finished, the trade-off, and a law to tune on with.

import { Tolerances } from "../controls/tolerances";
import { badge, empty, imports } from "../empty";
import { look, whenPainted } from "../pictures/look";
import { button, make, renew, table } from "../parts";
import { Picture } from "../pictures/picture";
import { Report, type Result } from "../result";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

// The words of this view; what depends on a result comes from the server.
const TEXT = {
  laws: "Laws",
  likeliest: "Likeliest",
  others: (many: number) => `${many} more laws`,
  rule: (rule: string) => `Chosen: ${rule}.`,
  refused: (many: number) => `${many} laws cannot control this axis`,
  all: (many: number) => `Compare all ${many} laws`,
  start: (many: number) => `Compare ${many} laws`,
  attempts: "Attempts for each law",
  plants: "Plants to hold for",
  title: "Which law suits this axis?",
  sentence:
    "Each law is tuned as well as it can be within the same Ms, delay margin and force noise; then all do the same work on the same machines.",
  note: "The four likeliest laws take some minutes, and each row appears when it is finished. After a cancel the comparison goes on where it was.",
  no_axis: "Laws are compared on a machine: a measured response alone moves nothing.",
  tradeoff: "Trade-off: better is left and up; click a law to tune with it",
  tune: (law: string) => `Tune with ${law}`,
  ranked: "yes",
  coming: "to come",
  running: "in work",
  heads: ["law", "ranked"],
  partial: (done: number, of: number) => `${done} of ${of} laws are finished; those to come may be better.`,
  seed: (seed: number) => `Encoder noise by seed ${seed}, the same for all laws.`,
  example: (unit: string) => `Rope-snap error in ${unit}: less is better`,
  details: "All figures, limits and reasons",
};

interface Law {
  name: string;
  why: string;
  held: string;
  drawn: boolean;
  figures: string[];
}
interface Words {
  ready: boolean;
  always?: string;
  rule?: string;
  likeliest?: string[];
  box?: string;
  over?: string;
  laws?: { name: string; wanted: boolean; remark: string }[];
  refused?: { name: string; reason: string }[];
  to_come?: string[];
  partial?: boolean;
  example?: { of: string; unit: string; rows: [string, number, string][] };
  found: (Result & { laws: Law[]; heads: string[]; seed: number }) | null;
  go?: string;
}

export class Compare implements Room {
  readonly name = "compare";
  readonly title = "Compare";
  readonly element = make("div", { class: "compare fills" });
  private readonly start: HTMLButtonElement;
  private readonly all: HTMLButtonElement;
  private readonly starts = make("input", { type: "range", min: "1", max: "20", value: "2", id: "compare-starts" });
  private readonly count = make("output", { for: "compare-starts" }, "2");
  private readonly box: Tolerances;
  private readonly over = make("p", { id: "compare-over", class: "meaning" });
  private readonly laws = make("div", { id: "compare-laws" });
  private readonly side = make("aside", { class: "side", "aria-label": TEXT.laws });
  private readonly pane = make("div", { class: "pane" });
  private readonly picture = new Picture(TEXT.tradeoff, undefined, true);
  private readonly report = new Report("compare");
  private last: Received | null = null;

  constructor(private readonly ask: Ask) {
    this.start = button("", () => this.run(false), { id: "compare-start" });
    this.all = button("", () => this.run(true), { id: "compare-everything" });
    this.picture.element.id = "compare-tradeoff";
    this.picture.onpick = (_x, _y, _panel, key) => key && this.take(key);
    this.box = new Tolerances("compare-box", (box) => ask({ do: "compare.over", box }));
    this.starts.addEventListener("input", () => (this.count.textContent = this.starts.value));
    this.side.append(
      this.laws,
      make(
        "div",
        { class: "more" },
        make("label", { for: "compare-box" }, TEXT.plants),
        this.box.element,
        this.over,
        make("label", { for: this.starts.id }, `${TEXT.attempts} `, this.count),
        this.starts,
      ),
    );
    this.element.append(this.side, this.pane);
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    this.last = received;
    const words = received.said as unknown as Words;
    const { found, ready, laws = [] } = words;
    const wanted = laws.filter((each) => each.wanted).length;
    this.start.textContent = TEXT.start(wanted);
    this.all.textContent = TEXT.all(laws.length);
    this.all.hidden = wanted === laws.length;
    this.element.classList.toggle("bare", !ready);
    this.side.hidden = !ready;
    this.box.show(words.box ?? "auto");
    this.over.textContent = words.over ?? "";
    this.choose(words);
    this.report.show(found);
    const rows = words.to_come?.length || found;
    this.start.classList.toggle("main", true);
    renew(this.pane, [ready, found, words.to_come, words.partial, words.example], () =>
      rows ? this.rows(words) : [this.empty(words)],
    );
    this.draw();
    if (words.go) document.dispatchEvent(new CustomEvent("go", { detail: words.go }));
  }

  shown(): void {
    this.draw();
  }

  private run(all: boolean): void {
    this.ask({ do: "compare.start", starts: Number(this.starts.value), all });
  }

  private take(law: string): void {
    this.ask({ do: "compare.take", law });
  }

  private empty({ ready, example }: Words): HTMLElement {
    const { title, sentence } = TEXT;
    const act = ready ? { act: this.start, note: TEXT.note, more: [this.all] } : { act: imports(), note: TEXT.no_axis };
    return empty({ title, sentence, ...act, ...(example ? { example: { of: badge(example.of), shows: bars(example) } } : {}) });
  }

  // A row for each law, those to come too; the verdict stands above them once all are finished.
  private rows({ found, to_come = [], partial = false }: Words): HTMLElement[] {
    const laws = found?.laws ?? [];
    const going = to_come.length > 0;
    const head = make("div", { class: "said", "aria-live": "polite" });
    if (partial || going)
      head.append(
        make(
          "p",
          { class: "verdict" },
          TEXT.partial(laws.length - (laws.length ? 1 : 0), to_come.length + laws.length - (laws.length ? 1 : 0)),
        ),
      );
    else head.append(this.report.head);
    if (found) head.append(make("p", { class: "meaning" }, TEXT.seed(found.seed)));
    const heads = [TEXT.heads[0]!, ...(found?.heads ?? []), ...TEXT.heads.slice(1), ""];
    const width = found?.heads.length ?? 0;
    const done = laws.map((law) => [
      law.name,
      ...law.figures,
      law.why ? make("span", { title: law.why }, `no: ${law.why.split(/[,;]/)[0]}`) : TEXT.ranked,
      button(TEXT.tune(law.name), () => this.take(law.name), { class: "with" }),
    ]);
    const waiting = to_come.map((law, i) => [law, ...Array<string>(width).fill(""), i ? TEXT.coming : TEXT.running, ""]);
    const list = table(heads, [...done, ...waiting]);
    list.id = "compare-rows";
    const acts = make("div", { class: "buttons" }, this.start, this.all);
    return [
      make("div", { class: "top" }, head, acts),
      make("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": TEXT.laws }, list),
      make("div", { class: "cells" }, this.picture.element),
      ...(found && !partial ? [make("details", { class: "folded" }, make("summary", {}, TEXT.details), this.report.body)] : []),
    ];
  }

  // Check boxes of the laws that can control the axis; the focus stays where it was.
  private choose({ laws = [], always = "", likeliest = [], rule = "", refused = [] }: Words): void {
    const open = this.laws.querySelector("details")?.open ?? false;
    renew(this.laws, [laws, always, likeliest, refused], () => {
      const tell = () => {
        const boxes = [...this.laws.querySelectorAll<HTMLInputElement>("input:checked")];
        this.ask({ do: "compare.choose", laws: boxes.map((each) => each.value) });
      };
      const row = ({ name, wanted, remark }: (typeof laws)[number]) => {
        const box = make("input", {
          type: "checkbox",
          value: name,
          id: `compare-law-${laws.findIndex((each) => each.name === name)}`,
        });
        box.checked = wanted;
        box.disabled = name === always;
        box.addEventListener("change", tell);
        return make("label", { for: box.id, title: remark }, box, ` ${name}`);
      };
      const [first, others] = [
        laws.filter(({ name }) => likeliest.includes(name)),
        laws.filter(({ name }) => !likeliest.includes(name)),
      ];
      const more = make("details", open ? { open: "" } : {}, make("summary", {}, TEXT.others(others.length)), ...others.map(row));
      const none = make("details", {}, make("summary", {}, TEXT.refused(refused.length)));
      none.append(...refused.map(({ name, reason }) => make("p", {}, make("b", {}, name), `: ${reason}`)));
      return [
        make("h2", {}, TEXT.likeliest),
        ...first.map(row),
        make("p", { class: "meaning" }, TEXT.rule(rule)),
        ...(others.length ? [more] : []),
        ...(refused.length ? [none] : []),
      ];
    });
  }

  private draw(): void {
    const chart = this.last?.said.charts.tradeoff;
    this.picture.element.hidden = !chart;
    if (!chart || this.element.closest("[hidden]")) return;
    this.picture.draw(chart, this.last!.numbers, look());
    this.report.draw(this.last!);
  }
}

// The errors of the example, the least with the shortest bar.
function bars({ unit, rows }: NonNullable<Words["example"]>): HTMLElement {
  const most = Math.max(...rows.map(([, value]) => value));
  const lines = rows.map(([name, value, text]) => {
    const bar = make("i");
    bar.style.width = `${(100 * value) / most}%`;
    return make("li", {}, make("span", {}, name), make("div", { class: "bar" }, bar), make("b", {}, text));
  });
  return make("div", { class: "bars" }, make("h2", {}, TEXT.example(unit)), make("ul", {}, ...lines));
}
