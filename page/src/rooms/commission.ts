// A drive is commissioned: which one, what each step will do and found, the question that is open, and what was measured.

import { numberOf } from "../controls/field";
import { whenPainted } from "../pictures/look";
import { button, choice, make, renew } from "../parts";
import { Report, type Result } from "../result";
import { result, type Ask, type Room } from "../room";
import type { Job, Question, Received } from "../wire";

interface Words {
  sources: { name: string; kind: "virtual" | "drive" }[];
  goals: string[];
  goal: string;
  targets: string[];
  steps: { name: string; does: string; says: string }[];
  going: boolean;
  rulers: Record<string, string[]>; // units in which a person measures, the usual one first
  source: string; // of the commissioning that is shown
  folder: string;
  line: string;
  found: Result | null;
  archive: string;
  machine: boolean;
  hint: string;
  go?: string;
}

const CALM = 700; // ms in which a new question takes no answer: the click may be meant for the one before
const PER: Record<string, number> = { mm: 1e3, deg: 180 / Math.PI, in: 1 / 0.0254 };

export class Commission implements Room {
  readonly name = "commission";
  readonly title = "Commission";
  readonly element = make("div", { class: "commission" });
  private readonly head = make("div", { class: "buttons" });
  private readonly hint = make("p", { class: "hint" });
  private readonly question = make("section", { id: "commission-question", role: "alertdialog", hidden: "" });
  private readonly steps = make("ol", { id: "commission-steps" });
  private readonly after = make("div", { class: "buttons" });
  private readonly place = make("p", { class: "hint", id: "commission-place" });
  private readonly report = new Report("commission");
  private readonly chosen = { source: "", goal: "", target: "c", yes: false };
  private mine = false; // this tab has begun what runs: a page that is loaded anew has not
  private told = ""; // of the work, when the room was last asked for
  private words: Words | null = null;
  private last: Received | null = null;

  constructor(private readonly ask: Ask) {
    this.element.append(
      make("div", { class: "lead" }, this.head, this.hint, this.question, this.steps, this.after, this.place),
      make("div", { class: "evidence" }, this.report.head, this.report.body),
    );
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    this.last = received;
    const words = received.said as unknown as Words;
    this.words = words;
    if (!this.chosen.goal) this.chosen.goal = words.goal;
    if (!words.sources.some((each) => each.name === this.chosen.source))
      this.chosen.source = words.source || (words.sources[0]?.name ?? "");
    this.settings(words);
    this.list(words);
    this.hint.textContent = words.hint;
    this.ending(words);
    this.report.show(words.found);
    this.draw();
    if (words.go) document.dispatchEvent(new CustomEvent("go", { detail: words.go }));
  }

  // What the work says: the question at once, the steps as often as another one has ended.
  worked(job: Job): void {
    if (job.room !== this.name) return;
    const going = job.state === "waiting" || job.state === "running";
    if (!going) this.mine = false;
    this.asked(going ? job.question : null);
    const told = JSON.stringify([job.state, job.remarks.length, job.question?.number]);
    if (told !== this.told && this.words) {
      this.told = told;
      this.ask({ do: "commission.show" });
    }
  }

  shown(): void {
    this.draw();
  }

  private settings(words: Words): void {
    const { chosen } = this;
    const kind = words.sources.find((each) => each.name === chosen.source)?.kind ?? "virtual";
    const again = words.source === chosen.source && words.found !== null && !words.going;
    renew(this.head, [words.sources, words.going, kind, again, chosen], () => {
      if (words.going)
        return [button("Stop the axis", () => this.ask({ do: "job.cancel" }), { id: "commission-stop", class: "stop" })];
      const select = (label: string, among: [string, string][], key: "source" | "goal" | "target") => {
        const found = choice(label, among, (value) => {
          chosen[key] = value;
          this.settings(words);
        });
        const box = found.querySelector("select")!;
        box.id = `commission-${key}`;
        box.value = chosen[key];
        return found;
      };
      const named = words.sources.map(({ name, kind }): [string, string] => [
        name,
        kind === "virtual" ? `virtual drive: ${name}` : `drive: ${name}`,
      ]);
      const yes = make("input", { type: "checkbox", id: "commission-yes" });
      yes.checked = chosen.yes && kind === "virtual";
      yes.addEventListener("change", () => (chosen.yes = yes.checked));
      return [
        select("Drive", named, "source"),
        select(
          "Goal",
          words.goals.map((each) => [each, each]),
          "goal",
        ),
        select(
          "Export",
          words.targets.map((each) => [each, each]),
          "target",
        ),
        ...(kind === "virtual" ? [make("label", {}, yes, " answer every question with yes")] : []),
        button(again ? "Go on" : "Begin", () => this.begin(kind, false), { id: "commission-start", class: "main" }),
        ...(again ? [button("Begin anew", () => this.begin(kind, true), { id: "commission-anew" })] : []),
      ];
    });
  }

  private begin(kind: string, anew: boolean): void {
    const { source, goal, target, yes } = this.chosen;
    this.mine = true;
    this.ask({ do: "commission.start", source, goal, target, yes: yes && kind === "virtual", anew });
  }

  // The question that is open. Only the tab that began may answer; it is the server that keeps to this.
  private asked(question: Question | null): void {
    const { mine } = this;
    this.question.hidden = !question;
    renew(this.question, [question, mine], () => {
      if (!question) return [];
      const words = make("p", { id: "commission-asked" }, question.text);
      this.question.setAttribute("aria-labelledby", words.id);
      if (!mine) return [words, make("p", { class: "hint" }, "Answer it in the tab that began this commissioning.")];
      const send = (more: Record<string, unknown>) => this.ask({ do: "commission.answer", question: question.number, ...more });
      if (question.expected === null)
        return [
          words,
          make(
            "div",
            { class: "buttons" },
            calm(button("Yes", () => send({ yes: true }), { id: "commission-answer-yes", class: "main" })),
            button("No", () => send({ yes: false }), { id: "commission-answer-no" }),
          ),
        ];
      const among = this.words?.rulers[question.unit] ?? [question.unit];
      const unit = choice(
        "",
        among.map((each) => [each, each]),
        () => undefined,
      );
      const box = unit.querySelector("select")!;
      box.id = "commission-unit";
      box.setAttribute("aria-label", "Unit");
      const expected = question.expected * (PER[among[0]!] ?? 1);
      const value = make("input", {
        type: "text",
        inputmode: "decimal",
        size: "10",
        id: "commission-value",
        "aria-label": "Measured value",
        placeholder: `counted: ${expected.toPrecision(4)}`,
      });
      const answer = () => send({ value: numberOf(value.value), unit: box.value });
      value.addEventListener("keydown", (event) => event.key === "Enter" && value.value.trim() && answer());
      return [
        words,
        make(
          "div",
          { class: "buttons" },
          value,
          unit,
          button("That was measured", () => value.value.trim() && answer(), { id: "commission-answer-value", class: "main" }),
          button("It was not measured", () => send({ value: null }), { id: "commission-answer-none" }),
        ),
      ];
    });
  }

  private list({ steps, going }: Words): void {
    const now = going ? steps.find((each) => !each.says)?.name : undefined;
    renew(this.steps, [steps, now], () =>
      steps.map(({ name, does, says }) =>
        make(
          "li",
          { "data-state": says ? "done" : name === now ? "now" : "open", ...(name === now ? { "aria-current": "step" } : {}) },
          make("strong", {}, name.replaceAll("_", " ")),
          make("span", { class: "does" }, ` ${does}`),
          ...(says ? [make("p", {}, says)] : []),
        ),
      ),
    );
  }

  private ending(words: Words): void {
    renew(this.after, [words.archive, words.machine], () => [
      ...(words.archive
        ? [
            make(
              "a",
              { href: result(words.archive), download: words.archive, id: "commission-archive" },
              `Download ${words.archive}`,
            ),
          ]
        : []),
      ...(words.machine
        ? [button("Tune on with this axis", () => this.ask({ do: "commission.open" }), { id: "commission-open" })]
        : []),
    ]);
    this.place.textContent = words.folder ? `Files: ${words.folder}. It goes on there without this page, too: ${words.line}` : "";
  }

  private draw(): void {
    if (this.last && !this.element.closest("[hidden]")) this.report.draw(this.last);
  }
}

// A button that takes no click yet.
function calm(found: HTMLButtonElement): HTMLButtonElement {
  found.disabled = true;
  setTimeout(() => (found.disabled = false), CALM);
  return found;
}
