// A drive is commissioned: its steps with their state, what moves and how to stop it, the question that is open, and what
// the step that is looked at will do, found, and how it is undone.

import { numberOf } from "../controls/field";
import { icon, type Icon } from "../icons";
import { look, whenPainted } from "../pictures/look";
import { Picture } from "../pictures/picture";
import { button, choice, make, renew, table } from "../parts";
import { Report, type Result } from "../result";
import { result, type Ask, type Room } from "../room";
import type { Job, Question, Received } from "../wire";

type State = "todo" | "runs" | "done" | "refused" | "undone";
interface Step {
  name: string;
  title: string;
  state: State;
  word: string;
  does: string;
  moves: string; // empty: nothing moves
  asks: string;
  undone: string;
  picture: string; // its chart, empty: none
  says: string;
  figures: [title: string, value: string][];
}
interface Words {
  sources: { name: string; kind: "virtual" | "drive" }[];
  goals: string[];
  goal: string;
  targets: string[];
  steps: Step[];
  safety: { title: string; value: string; note: string }[];
  chosen: string; // the drive that is commissioned next
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
const SHAPES: Record<State, Icon> = { todo: "unrun", runs: "play", done: "kept", refused: "broken", undone: "undo" };
const PICTURES = { trial: "Trial: predicted and measured", responses: "Frequency responses and model", strokes: "Strokes" };

export class Commission implements Room {
  readonly name = "commission";
  readonly title = "Commission";
  readonly element = make("div", { class: "commission fills" });
  private readonly head = make("div", { class: "head" });
  private readonly safety = make("div", {
    class: "safety",
    role: "group",
    "aria-label": "Safety: what moves, and how to stop it",
  });
  private readonly cells = make("div", { class: "limits" });
  private readonly stop = button("Stop the axis (Esc)", () => this.ask({ do: "job.cancel" }), {
    id: "commission-stop",
    class: "stop",
  });
  private readonly question = make("section", { id: "commission-question", role: "alertdialog", hidden: "" });
  private readonly steps = make("ol", { id: "commission-steps" });
  private readonly told = make("div", { class: "told" });
  private readonly overview = make("div", { class: "overview", tabindex: "0", role: "group", "aria-label": "All steps" });
  private readonly pictures = new Map(Object.entries(PICTURES).map(([key, title]) => [key, new Picture(title, 40, true)]));
  private readonly grid = make("div", { class: "grid" });
  private readonly after = make("div", { class: "after" });
  private readonly place = make("p", { class: "hint", id: "commission-place" });
  private readonly report = new Report("commission");
  private readonly chosen = { goal: "", target: "c", yes: false };
  private mine = false; // this tab has begun what runs: a page that is loaded anew has not
  private heard_of = ""; // of the work, when the room was last asked for
  private looked = ""; // the step that is looked at; empty: the one that runs, or the last one
  private words: Words | null = null;
  private last: Received | null = null;

  constructor(private readonly ask: Ask) {
    for (const [key, each] of this.pictures) each.element.id = `commission-${key}`;
    this.grid.append(...[...this.pictures.values()].map((each) => each.element));
    this.safety.append(this.cells, this.stop);
    const side = make("nav", { class: "steps", "aria-label": "Steps" }, this.steps);
    const evidence = make(
      "div",
      { class: "evidence" },
      this.report.head,
      this.question,
      make("div", { class: "about" }, this.told, this.report.body),
      this.grid,
      this.overview,
      this.after,
      this.place,
    );
    this.element.append(this.head, this.safety, side, evidence);
    document.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || !this.words?.going) return;
      event.preventDefault();
      this.ask({ do: "job.cancel" });
    });
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    this.last = received;
    const words = received.said as unknown as Words;
    if (words.going !== this.words?.going) this.looked = "";
    this.words = words;
    if (!this.chosen.goal) this.chosen.goal = words.goal;
    this.settings(words);
    this.warned(words);
    this.list(words);
    this.ending(words);
    this.tell(words);
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
    if (told !== this.heard_of && this.words) {
      this.heard_of = told;
      this.ask({ do: "commission.show" });
    }
  }

  shown(): void {
    this.draw();
  }

  private settings(words: Words): void {
    const { chosen } = this;
    const kind = words.sources.find((each) => each.name === words.chosen)?.kind ?? "virtual";
    const again = words.source === words.chosen && words.found !== null && !words.going;
    const kept = again && words.steps.every((each) => each.state === "done");
    renew(this.head, [words.sources, words.chosen, words.going, kind, again, kept, chosen], () => {
      const select = (label: string, among: [string, string][], value: string, changed: (value: string) => void) => {
        const found = choice(label, among, changed);
        const box = found.querySelector("select")!;
        box.id = `commission-${label.toLowerCase().replace("drive", "source").replace("export", "target")}`;
        box.value = value;
        box.disabled = words.going;
        return found;
      };
      const named = words.sources.map(({ name, kind }): [string, string] => [
        name,
        kind === "virtual" ? `virtual drive: ${name}` : `drive: ${name}`,
      ]);
      const plain = (among: string[]): [string, string][] => among.map((each) => [each, each]);
      const yes = make("input", { type: "checkbox", id: "commission-yes" });
      yes.checked = chosen.yes && kind === "virtual";
      yes.addEventListener("change", () => (chosen.yes = yes.checked));
      return [
        select("Drive", named, words.chosen, (source) => this.ask({ do: "commission.choose", source })),
        select("Goal", plain(words.goals), chosen.goal, (goal) => (chosen.goal = goal)),
        select("Export", plain(words.targets), chosen.target, (target) => (chosen.target = target)),
        ...(kind === "virtual" && !words.going ? [make("label", {}, yes, " answer every question with yes")] : []),
        ...(words.going
          ? []
          : [
              button(again ? "Go on" : "Begin", () => this.begin(kind, false), {
                id: "commission-start",
                class: kept ? "" : "main",
              }),
            ]),
        ...(again ? [button("Begin anew", () => this.begin(kind, true), { id: "commission-anew" })] : []),
      ];
    });
    this.head.title = words.hint;
  }

  private begin(kind: string, anew: boolean): void {
    const { goal, target, yes } = this.chosen;
    this.mine = true;
    this.ask({ do: "commission.start", source: this.words?.chosen ?? "", goal, target, yes: yes && kind === "virtual", anew });
  }

  // What moves, how far, how fast, and the way to stop it: never out of view.
  private warned({ safety, going }: Words): void {
    renew(this.cells, safety, () =>
      safety.map(({ title, value, note }) =>
        make(
          "div",
          { class: "gauge" },
          make("span", { class: "name" }, title),
          make("span", { class: "value", title: value }, make("b", {}, value)),
          make("span", { class: "today", title: note }, note),
        ),
      ),
    );
    this.stop.disabled = !going;
    this.stop.title = going ? "Brakes the axis and puts back what was in the drive" : "Nothing moves";
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

  // The step that is looked at: the one that somebody chose, the one that runs, or the last one with a result.
  private get step(): Step | undefined {
    const steps = this.words?.steps ?? [];
    const with_result = steps.filter((each) => each.says || each.state === "undone");
    return (
      steps.find((each) => each.name === this.looked) ??
      steps.find((each) => each.state === "runs") ??
      with_result.at(-1) ??
      steps[0]
    );
  }

  private list({ steps }: Words): void {
    const chosen = this.step?.name;
    renew(this.steps, [steps.map(({ name, state }) => [name, state]), chosen], () =>
      steps.map(({ name, title, state, word }) => {
        const shape = make("span", { class: "shape" });
        shape.append(icon(SHAPES[state]));
        const found = button("", () => this.choose(name), {
          class: "step",
          id: `commission-step-${name}`,
          "aria-pressed": String(name === chosen),
        });
        found.append(shape, make("strong", {}, title), make("span", { class: "word" }, word));
        return make("li", { "data-state": state, ...(state === "runs" ? { "aria-current": "step" } : {}) }, found);
      }),
    );
  }

  private choose(name: string): void {
    this.looked = name;
    if (!this.words) return;
    this.list(this.words);
    this.tell(this.words);
    this.draw();
  }

  // The step that is looked at: what it will do, what it found, how it is undone.
  private tell(words: Words): void {
    const { step } = this;
    if (!step) return;
    const found = words.found;
    const figures = (found?.sections ?? [])
      .filter((each) => each.key === "figures")
      .map((each) => ({ ...each, parts: each.parts.filter((part) => part.kind === "table") }));
    const trial = step.picture === "trial" && step.says !== "";
    this.report.show(found && { ...found, picture: null, sections: trial ? figures : [] });
    renew(this.told, step, () => [
      make("h1", {}, `${step.title[0]!.toUpperCase()}${step.title.slice(1)}`, make("small", { "data-state": step.state }, step.word)),
      make(
        "dl",
        {},
        ...pair("It will", step.does),
        ...pair("Moves", step.moves || "nothing"),
        ...(step.asks ? pair("It asks", step.asks) : []),
        ...pair("Undone", step.undone),
        ...(step.says ? pair("Found", step.says) : []),
      ),
      ...(step.figures.length
        ? [
            make(
              "dl",
              { class: "cards" },
              ...step.figures.map(([title, value]) => make("div", {}, make("dt", {}, title), make("dd", {}, make("strong", {}, value)))),
            ),
          ]
        : []),
    ]); // prettier-ignore
    renew(this.overview, words.steps, () => [
      table(
        ["step", "moves", "asks"],
        words.steps.map((each) => [each.title, each.moves || "nothing", each.asks || "nothing"]),
      ),
    ]);
  }

  private ending(words: Words): void {
    renew(this.after, [words.archive, words.machine, words.going], () => [
      ...(words.machine
        ? [
            button("Tune on with this axis", () => this.ask({ do: "commission.open" }), {
              id: "commission-open",
              class: words.steps.every((each) => each.state === "done") ? "main" : "",
            }),
          ]
        : []),
      ...(words.archive
        ? [
            make(
              "a",
              { href: result(words.archive), download: words.archive, id: "commission-archive" },
              `Download ${words.archive}`,
            ),
          ]
        : []),
    ]);
    this.place.textContent = words.folder ? `Files: ${words.folder}. It goes on there without this page, too: ${words.line}` : "";
    this.place.title = this.place.textContent;
  }

  // The picture of the step, or the latest one before it; without any, what all steps move and ask.
  private draw(): void {
    const { last, step } = this;
    if (!last || this.element.closest("[hidden]")) return;
    this.report.draw(last);
    const wanted = step?.says || step?.state === "runs" ? step.picture : "";
    const shown = wanted && last.said.charts[wanted] ? wanted : "";
    for (const [key, picture] of this.pictures) {
      picture.element.hidden = key !== shown;
      if (key === shown) picture.draw(last.said.charts[key]!, last.numbers, look());
    }
    this.grid.hidden = !shown;
    this.overview.hidden = shown !== "";
  }
}

function pair(title: string, text: string): HTMLElement[] {
  return [make("dt", {}, title), make("dd", { title: text }, text)];
}

// A button that takes no click yet.
function calm(found: HTMLButtonElement): HTMLButtonElement {
  found.disabled = true;
  setTimeout(() => (found.disabled = false), CALM);
  return found;
}
