// Laws at equal robustness: which are compared, the trade-off, and a law that is chosen to be tuned on.

import { look, whenPainted } from "../pictures/look";
import { button, make, offer, table } from "../parts";
import { Picture } from "../pictures/picture";
import { Report, type Result } from "../result";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

interface Words {
  ready: boolean;
  always?: string;
  box?: string;
  offered?: string[];
  over?: string;
  laws?: { name: string; wanted: boolean; remark: string }[];
  refused?: { name: string; reason: string }[];
  found: (Result & { laws: { name: string; why: string; held: string; drawn: boolean }[]; seed: number }) | null;
  go?: string;
}

export class Compare implements Room {
  readonly name = "compare";
  readonly title = "Compare";
  readonly element = make("div", { class: "compare" });
  private readonly start: HTMLButtonElement;
  private readonly starts = make("input", { type: "number", min: "1", max: "20", value: "2", id: "compare-starts" });
  private readonly box = make("input", { type: "text", size: "28", id: "compare-box" });
  private readonly boxes = make("label", { for: "compare-box" }, "box of plants ", this.box);
  private readonly over = make("p", { id: "compare-over" });
  private readonly laws = make("fieldset", { id: "compare-laws" });
  private readonly refused = make("div");
  private readonly hint = make("p");
  private readonly seed = make("p");
  private readonly picture = new Picture(
    "Trade-off at equal robustness: better is left and up; lines lead to the worst plant of the box. Click a law to tune on with it.",
  );
  private readonly outcome = make("div");
  private readonly report = new Report("compare");
  private last: Received | null = null;

  constructor(private readonly ask: Ask) {
    this.start = button("Compare", () => ask({ do: "compare.start", starts: Number(this.starts.value) }), {
      id: "compare-start",
      class: "main",
    });
    this.picture.element.id = "compare-tradeoff";
    this.picture.onpick = (_x, _y, _panel, key) => key && this.take(key);
    const head = make(
      "div",
      { class: "buttons" },
      this.start,
      make("label", { for: this.starts.id }, "searches for each law ", this.starts),
      this.boxes,
    );
    this.box.title = "The limits of every law hold over it, and figures are shown at the model and at the worst plant";
    this.box.addEventListener("change", () => ask({ do: "compare.over", box: this.box.value }));
    this.element.append(
      head,
      this.laws,
      this.refused,
      this.over,
      this.hint,
      this.seed,
      this.report.head,
      this.picture.element,
      this.outcome,
      this.report.body,
    );
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    this.last = received;
    const words = received.said as unknown as Words;
    const { found } = words;
    const laws = words.laws ?? [];
    this.start.disabled = !words.ready;
    this.start.textContent = `Compare ${laws.filter((each) => each.wanted).length} laws`;
    this.boxes.hidden = !words.ready;
    if (!this.box.list) this.boxes.append(...offer(this.box, words.offered ?? []));
    if (document.activeElement !== this.box) this.box.value = words.box ?? "";
    this.over.textContent = words.over ?? "";
    this.choose(laws, words.always ?? "");
    this.refuse(words.refused ?? []);
    this.hint.hidden = words.ready && found !== null;
    this.hint.textContent = words.ready
      ? "This takes minutes. Laws that are finished are kept: after a cancel the comparison goes on where it was."
      : "Import a machine first: laws cannot be compared on a measured response alone.";
    this.seed.textContent = found ? `Noise of the readings by seed ${found.seed}, the same for all laws.` : "";
    this.outcome.replaceChildren(
      ...(found
        ? [
            table(
              ["law", "ranked", "held back by", ""],
              found.laws.map((law) => [
                law.name,
                `${law.why ? `no: ${law.why}` : "at equal robustness"}${law.drawn ? "" : " (not in the picture)"}`,
                law.held,
                button("Tune on with it", () => this.take(law.name), { "aria-label": `Tune on with ${law.name}` }),
              ]),
            ),
          ]
        : []),
    );
    this.report.show(found);
    this.draw();
    if (words.go) document.dispatchEvent(new CustomEvent("go", { detail: words.go }));
  }

  shown(): void {
    this.draw();
  }

  private take(law: string): void {
    this.ask({ do: "compare.take", law });
  }

  // Check boxes of the laws that can control the axis; the focus stays where it was.
  private choose(laws: NonNullable<Words["laws"]>, always: string): void {
    const focused = document.activeElement?.id;
    this.laws.hidden = !laws.length;
    const tell = (wanted: string[]) => this.ask({ do: "compare.choose", laws: wanted });
    const boxes = laws.map((law, i) => {
      const box = make("input", { type: "checkbox", value: law.name, id: `compare-law-${i}` });
      box.checked = law.wanted;
      box.disabled = law.name === always;
      box.addEventListener("change", () => tell(boxes.filter((each) => each.checked).map((each) => each.value)));
      return box;
    });
    const all = button("All", () => tell(laws.map((each) => each.name)), { id: "compare-all" });
    const none = button(`Only ${always}`, () => tell([]), { id: "compare-none" });
    this.laws.replaceChildren(
      make("legend", {}, "Laws that are compared"),
      make("div", { class: "buttons" }, all, none),
      make(
        "div",
        { class: "choices" },
        ...boxes.map((box, i) => make("label", { for: box.id, title: laws[i]!.remark }, box, ` ${laws[i]!.name}`)),
      ),
    );
    if (focused?.startsWith("compare-")) document.getElementById(focused)?.focus();
  }

  private refuse(laws: { name: string; reason: string }[]): void {
    const rows = laws.map((each) => [each.name, each.reason]);
    this.refused.replaceChildren(
      ...(rows.length
        ? [make("details", {}, make("summary", {}, `${rows.length} laws cannot control this axis`), table(["law", "why"], rows))]
        : []),
    );
  }

  private draw(): void {
    const chart = this.last?.said.charts.tradeoff;
    this.picture.element.hidden = !chart;
    if (chart && !this.element.closest("[hidden]")) this.picture.draw(chart, this.last!.numbers, look());
  }
}
