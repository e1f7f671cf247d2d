// Tuning by goal: fields and lines in the pictures set the limits, the tuner searches, and a person accepts or rejects.

import { Levels, type Level } from "../controls/levels";
import { Tolerances } from "../controls/tolerances";
import { badge, empty, imports } from "../empty";
import { look, whenPainted } from "../pictures/look";
import { button, make, renew } from "../parts";
import { Picture } from "../pictures/picture";
import { Report, type Result } from "../result";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

// The words of this view; labels and lines of the fields come from the server.
const TEXT = {
  settings: "Goal and limits",
  search: "Search",
  start: "Start",
  use: "Use result",
  use_bad: "Use it all the same",
  use_best: "Use best so far (not proven)",
  discard: "Discard",
  unfinished: "The search has not finished: what is shown is the best so far, and is not proven.",
  title: "What should this axis be best at?",
  sentence:
    "Choose a goal and the limits that must hold. The optimizer finds gains and filters within them and shows what gets better and what gets worse, before anything is changed.",
  no_axis: "It needs a machine or a measured frequency response.",
  details: "Numbers, limits and proof",
  to: "to",
  more: "More limits, noise and attempts",
  pictures: {
    sensitivity: "Sensitivity",
    stiffness: "Dynamic stiffness",
    open_loop: "Open loop",
    search: "Search",
  } as Record<string, string>,
  example: "Dynamic stiffness",
};

interface Field {
  name: string;
  kind: "choice" | "number" | "range" | "slider" | "box";
  label: string;
  meaning: string;
  unit: string;
  options: [value: string, text: string][];
  most: number;
  rare: boolean; // folded
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
  example?: string;
  go?: string;
}

export class Optimize implements Room {
  readonly name = "optimize";
  readonly title = "Optimize";
  readonly element = make("div", { class: "optimize fills" });
  private readonly form = make("div", { class: "settings-list" });
  private readonly buttons = make("div", { class: "buttons" });
  private readonly verdict = make("div", { "aria-live": "polite", class: "said" });
  private readonly report = new Report("optimize-found");
  private readonly pictures = new Map(
    Object.entries(TEXT.pictures).map(([name, title]) => [name, new Picture(title, undefined, true)]),
  );
  private readonly folded = make("details", { class: "folded" }, make("summary", {}, TEXT.details), this.report.body);
  private readonly shows = new Picture(TEXT.example, undefined, true);
  private readonly nothing = make("div", { class: "pane" });
  private readonly levels: Levels[];
  private readonly shown_by = new Map<string, (value: string) => void>(); // of each field, how its value is shown
  private readonly tune: HTMLButtonElement;
  private readonly accept: HTMLButtonElement;
  private readonly reject: HTMLButtonElement;
  private last: Received | null = null;

  constructor(private readonly ask: Ask) {
    const grid = make("div", { class: "cells" });
    for (const [name, picture] of this.pictures) {
      picture.element.id = `optimize-${name}`;
      grid.append(picture.element);
    }
    this.levels = ["sensitivity", "stiffness"].map(
      (name) => new Levels(name, this.pictures.get(name)!, (field, value) => ask({ do: "optimize.level", field, value })),
    );
    this.tune = button(TEXT.start, () => ask({ do: "optimize.tune" }), { id: "tune-start", class: "main" });
    this.accept = button(TEXT.use, () => ask({ do: "optimize.accept" }), { id: "optimize-accept" });
    this.reject = button(TEXT.discard, () => ask({ do: "optimize.reject" }), { id: "optimize-reject" });
    this.buttons.append(this.tune, this.accept, this.reject);
    const head = make("div", { class: "top" }, make("div", { class: "said" }, this.verdict, this.report.head), this.buttons);
    this.element.append(
      this.nothing,
      make("aside", { class: "side", "aria-label": TEXT.settings, tabindex: "0" }, make("h2", {}, TEXT.settings), this.form),
      make("section", { class: "pane work", "aria-label": TEXT.search }, head, grid, this.folded),
    );
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    const words = received.said as unknown as Words;
    const { ready, begins, over, unfinished, found = null, example = "" } = words;
    this.last = received;
    this.place(words.fields);
    this.element.classList.toggle("bare", !ready);
    renew(this.nothing, [ready, example], () => {
      const { title, sentence, no_axis: note } = TEXT;
      const of = badge(example);
      return ready ? [] : [empty({ title, sentence, note, act: imports(), example: { of, shows: this.shows.element } })];
    });
    this.accept.disabled = this.reject.disabled = !words.best;
    // the way on is the filled button: to start, and then to use what was found
    this.tune.classList.toggle("main", !words.best);
    this.accept.classList.toggle("main", Boolean(words.best));
    const accept = unfinished ? TEXT.use_best : found?.bad ? TEXT.use_bad : TEXT.use;
    if (this.accept.textContent !== accept) this.accept.textContent = accept;
    renew(this.verdict, [begins, over, unfinished, found !== null], () => [
      ...(begins ? [make("p", {}, begins)] : []),
      ...(over && !found ? [make("p", { id: "optimize-over" }, over)] : []),
      ...(unfinished ? [make("p", {}, TEXT.unfinished)] : []),
    ]);
    this.report.show(found);
    this.folded.hidden = !found;
    if (words.go) document.dispatchEvent(new CustomEvent("go", { detail: words.go }));
    this.draw();
  }

  shown(): void {
    this.draw();
  }

  // Fields stay while somebody writes into them.
  private place(fields: Field[]): void {
    const made = fields.map(({ value: _value, ...rest }) => rest);
    renew(this.form, made, () => {
      this.shown_by.clear();
      const [usual, rare] = [fields.filter((each) => !each.rare), fields.filter((each) => each.rare)];
      const more = make("details", { id: "optimize-more" }, make("summary", {}, TEXT.more));
      more.append(...rare.map((field) => this.field(field)));
      return [...usual.map((field) => this.field(field)), more];
    });
    for (const { name, value } of fields) this.shown_by.get(name)?.(value);
  }

  private field(field: Field): HTMLElement {
    const id = `optimize-field-${field.name}`;
    const set = (value: string) => this.ask({ do: "optimize.set", field: field.name, value });
    const meaning = make("small", { id: `${id}-meaning` }, field.meaning);
    const [entry, show] = this.entry(field, id, set);
    this.shown_by.set(field.name, show);
    entry.querySelector(`#${id}`)?.setAttribute("aria-describedby", meaning.id);
    return make("div", { class: `setting of-${field.kind}` }, make("label", { for: id }, field.label), entry, meaning);
  }

  // What a value is chosen or entered by, and how it is shown there.
  private entry(
    { kind, options, unit, most }: Field,
    id: string,
    set: (value: string) => void,
  ): [HTMLElement, (value: string) => void] {
    const text = (of: string) => make("input", { id: of, type: "text", inputmode: "decimal", size: "5" });
    const filled = (input: HTMLInputElement, value: string) => {
      if (document.activeElement !== input) input.value = value;
    };
    switch (kind) {
      case "choice": {
        const select = make("select", { id }, ...options.map(([value, said]) => make("option", { value }, said)));
        select.addEventListener("change", () => set(select.value));
        return [make("span", {}, select), (value) => (select.value = value)];
      }
      case "box": {
        const box = new Tolerances(id, set);
        return [box.element, (value) => box.show(value)];
      }
      case "slider": {
        const slider = make("input", { id, type: "range", min: "1", max: String(most) });
        const count = make("output", { for: id });
        slider.addEventListener("input", () => (count.textContent = slider.value));
        slider.addEventListener("change", () => set(slider.value));
        return [make("span", {}, slider, count), (value) => (count.textContent = slider.value = value)];
      }
      case "range": {
        const [low, high] = [text(id), text(`${id}-to`)];
        high.setAttribute("aria-label", "to, in Hz");
        const send = () => {
          const both = [low, high].map((each) => each.value.trim().replace(",", "."));
          // half of a range is no mistake: the other end is still to be entered
          if (both.every((each) => each) || !both.some((each) => each)) set(both[0] ? both.join("..") : "");
        };
        for (const each of [low, high]) each.addEventListener("change", send);
        const show = (value: string) => {
          const [from = "", to = ""] = value.split("..");
          if (value || (low.value && high.value)) [low, high].forEach((each, i) => filled(each, [from, to][i]!));
        };
        return [make("span", {}, low, TEXT.to, high, make("span", { class: "unit" }, "Hz")), show];
      }
      case "number": {
        const input = text(id);
        input.addEventListener("change", () => set(input.value));
        return [make("span", {}, input, make("span", { class: "unit" }, unit)), (value) => filled(input, value)];
      }
    }
  }

  private draw(): void {
    if (!this.last || this.element.closest("[hidden]")) return;
    const { charts } = this.last.said;
    const example = charts.example;
    if (example) this.shows.draw(example, this.last.numbers, look());
    for (const [name, picture] of this.pictures) {
      const chart = charts[name];
      picture.element.hidden = !chart;
    }
    for (const [name, picture] of this.pictures) if (charts[name]) picture.draw(charts[name], this.last.numbers, look());
    this.report.draw(this.last);
    for (const each of this.levels) each.show((this.last.said.levels as Level[] | undefined) ?? []);
  }
}
