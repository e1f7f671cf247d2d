// Signals are followed while they are recorded. The page asks for the next picture when it has drawn the last one, so
// that a slow browser gets fewer of them and none late.

import { look, whenPainted } from "../pictures/look";
import { button, make, table } from "../parts";
import { badge, empty } from "../empty";
import { Picture } from "../pictures/picture";
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
interface Channel {
  name: string;
  shown: boolean;
  states: boolean;
  unit: string;
  in_unit: string;
  units: string[];
}
interface Frame {
  live: boolean;
  following: boolean;
  failed: boolean;
  state: string;
  rate: number;
  held: boolean;
  of: string[];
  look: string;
  readout: string[][];
  cursors: [number, number] | null;
  span?: [number, number];
}
interface Words extends Frame {
  sources: { name: string; kind: string }[];
  example: string;
  hint: string;
  chosen: string;
  fields: Field[];
  mode: string;
  modes: Record<string, string>;
  trigger: string;
  saved: string;
  channels: Channel[];
  import?: string;
}

// The words of this view; states and fields come from the server.
const TEXT = {
  start: "Start",
  stop: "Stop",
  arm: "Arm",
  hold: "Hold",
  go_on: "Run",
  clear: "Clear cursors",
  save: "Save capture",
  between: "Save between cursors",
  cursors: "Cursors: click in the picture, or move them here",
  title: "See what the drive does, while it does it.",
  sentence:
    "The scope shows signals as they are recorded, from a file that grows, a pipe or a drive, with trigger and cursors. A capture is a log that Import can identify.",
  example: "Run the example",
  note: "It plays on this computer and moves nothing.",
  signals: "Signals",
  heads: ["shown", "channel", "unit", "shown in"],
};
const EXAMPLE = "example"; // the bundled source, as on the server
const OFTEN = 50; // ms from one picture to the next: 20 a second
const PANEL = 130; // pixels of a panel more
const STEPS = 1000; // of the slider of a cursor
const OF_TRIGGER = ["level", "before", "hysteresis", "hold"];

export class Scope implements Room {
  readonly name = "scope";
  readonly title = "Scope";
  readonly element = make("div", { class: "scope fills" });
  private readonly source = make("select", { id: "scope-source" });
  private readonly follow: HTMLButtonElement;
  private readonly state = make("p", { id: "scope-state" });
  private readonly hint = make("p", { class: "hint" });
  private readonly cursors: HTMLElement;
  private readonly trouble = make("p", { id: "scope-trouble", class: "bad", role: "alert", hidden: "" });
  private readonly trigger = make("select", { id: "scope-trigger" });
  private readonly mode = make("select", { id: "scope-mode" });
  private readonly meaning = make("p", { class: "hint" });
  private readonly edge = make("div");
  private readonly of_trigger = make("div");
  private readonly of_time = make("div");
  private readonly arm: HTMLButtonElement;
  private readonly channels = make("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Channels" });
  private readonly picture = new Picture("Signals", PANEL);
  private readonly looking = make("p", { id: "scope-look" });
  private readonly hold: HTMLButtonElement;
  private readonly off: HTMLButtonElement;
  private readonly between: HTMLButtonElement;
  private readonly sliders: HTMLInputElement[];
  private readonly clicks: HTMLInputElement[];
  private readonly readout = make("div", {
    id: "scope-readout",
    class: "scroll",
    tabindex: "0",
    role: "region",
    "aria-label": "What the cursors read",
  });
  private last: Received | null = null;
  private words: Words | null = null;
  private known = ""; // channels of the settings that are shown
  private timer = 0;
  private read = "";
  private readonly shows = new Picture(TEXT.signals, undefined, true);
  private readonly nothing = make("div", { class: "pane", hidden: "" });
  private readonly work: HTMLElement;
  private readonly badged: (name: string) => void;

  constructor(private readonly ask: Ask) {
    this.follow = button(TEXT.start, () => this.start(), { id: "scope-follow" });
    this.arm = button(TEXT.arm, () => ask({ do: "scope.arm" }), { id: "scope-arm" });
    this.hold = button(TEXT.hold, () => ask({ do: "scope.hold", on: !this.words?.held }), {
      id: "scope-pause",
    });
    this.off = button(TEXT.clear, () => ask({ do: "scope.move", name: "1", x: null }), { id: "scope-off" });
    const keep = button(TEXT.save, () => ask({ do: "scope.save", between: false }), { id: "scope-save" });
    this.between = button(TEXT.between, () => ask({ do: "scope.save", between: true }), {
      id: "scope-between",
    });
    const run = button(TEXT.example, () => ask({ do: "scope.follow", name: EXAMPLE }), { id: "scope-example" });
    const of = make("div");
    this.badged = (name) => of.replaceChildren(badge(name));
    const { title, sentence, note } = TEXT;
    this.nothing.append(empty({ title, sentence, note, act: run, example: { of, shows: this.shows.element } }));
    this.sliders = ["1", "2"].map((which) => this.slider(which));
    this.clicks = ["1", "2"].map((which, i) =>
      make("input", { type: "radio", name: "scope-click", id: `scope-click-${which}`, ...(i === 0 ? { checked: "" } : {}) }),
    );
    for (const input of [this.trigger, this.mode]) {
      input.addEventListener("change", () => ask({ do: "scope.look", mode: this.mode.value, channel: this.trigger.value }));
    }
    const settings = make(
      "section",
      { "aria-label": "Settings", class: "side settings" },
      labelled("Source", this.source),
      make("div", { class: "buttons" }, this.follow),
      this.state,
      this.hint,
      make(
        "fieldset",
        {},
        make("legend", {}, "Trigger"),
        labelled("channel", this.trigger),
        labelled("mode", this.mode),
        this.meaning,
        this.edge,
        this.of_trigger,
        this.arm,
      ),
      make("fieldset", {}, make("legend", {}, "Time"), this.of_time),
    );
    this.cursors = make(
      "fieldset",
      { class: "cursors" },
      make("legend", {}, TEXT.cursors),
      ...this.sliders.map((slider, i) => make("label", {}, make("span", {}, `cursor ${i + 1}`), slider)),
      make(
        "div",
        { class: "buttons" },
        "a click sets ",
        ...this.clicks.flatMap((each, i) => [make("label", {}, each, ` cursor ${i + 1} `)]),
        this.off,
      ),
      this.readout,
    );
    this.picture.element.id = "picture-scope";
    this.picture.onpick = (x) => this.click(x);
    this.work = make(
      "section",
      { "aria-label": TEXT.signals, class: "pane signals" },
      make("div", { class: "buttons" }, this.hold, keep, this.between),
      this.trouble,
      this.looking,
      this.picture.element,
      this.cursors,
      this.channels,
    );
    this.element.append(settings, this.nothing, this.work);
    document.addEventListener("visibilitychange", () => this.next());
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    const frame = received.said as unknown as Frame;
    if (Object.keys(received.said.charts).length || !frame.live) this.last = received;
    const words = frame.live ? { ...this.words!, ...frame } : (received.said as unknown as Words);
    if (!frame.live) this.settings(words);
    this.words = words;
    if (frame.live && frame.of.join("\n") !== this.known) this.ask({ do: "scope.show" });
    this.stands(words);
    this.draw();
    if (words.import && !frame.live) {
      this.ask({ do: "import.look", names: [words.import] });
      document.dispatchEvent(new CustomEvent("go", { detail: "import" }));
    }
    this.next();
  }

  shown(): void {
    this.draw();
  }

  // Ask for the next picture, if somebody can see it.
  private next(): void {
    if (this.timer || !this.words?.following || !this.visible()) return;
    this.timer = window.setTimeout(() => {
      this.timer = 0;
      if (this.visible()) this.ask({ do: "scope.frame" });
    }, OFTEN);
  }

  private visible(): boolean {
    return !this.element.closest("[hidden]") && !document.hidden;
  }

  private start(): void {
    if (this.words?.following && this.source.value === this.words.chosen) this.ask({ do: "scope.stop" });
    else this.ask({ do: "scope.follow", name: this.source.value });
  }

  private settings(words: Words): void {
    this.known = [...words.of].join("\n");
    options(
      this.source,
      words.sources.map((each) => [each.name, `${each.name} (${each.kind})`]),
      words.chosen,
    );
    options(
      this.trigger,
      [["", "none"], ...words.channels.map((each): [string, string] => [each.name, each.name])],
      words.trigger,
    );
    options(
      this.mode,
      Object.keys(words.modes).map((mode) => [mode, mode]),
      words.mode,
    );
    text(this.meaning, words.modes[words.mode] ?? "");
    const fields = new Map(words.fields.map((field) => [field.name, field]));
    this.place(this.edge, [fields.get("edge")!]);
    this.place(
      this.of_trigger,
      OF_TRIGGER.map((name) => fields.get(name)!),
    );
    this.place(
      this.of_time,
      words.fields.filter((field) => field.name !== "edge" && !OF_TRIGGER.includes(field.name)),
    );
    // the example is an example only until something runs
    this.nothing.hidden = !words.example;
    this.work.hidden = Boolean(words.example);
    this.follow.classList.toggle("main", !words.example);
    if (words.example) this.badged(words.example);
    text(this.hint, words.hint);
    this.arm.disabled = !words.trigger;
    this.listed(words.channels);
    this.source.onchange = () => this.stands(this.words!);
  }

  // Fields stay while somebody writes into them.
  private place(where: HTMLElement, fields: Field[]): void {
    const names = fields.map((field) => `${field.name} ${field.unit}`).join();
    if (where.dataset.fields !== names) {
      where.dataset.fields = names;
      where.replaceChildren(
        ...fields.map((field) => {
          const id = `scope-field-${field.name}`;
          const list: [string, string][] = field.options.map((each) => [each, each]);
          if (list.length && !field.value) list.unshift(["", "as it is stated"]);
          const input = list.length
            ? make("select", { id })
            : make("input", { id, type: "text", size: "8", inputmode: "decimal" });
          if (input instanceof HTMLSelectElement) options(input, list, field.value);
          input.title = field.meaning;
          input.addEventListener("change", () => this.ask({ do: "scope.set", field: field.name, value: input.value }));
          return make(
            "label",
            { for: id, title: field.meaning },
            make("span", {}, `${field.label} `),
            input,
            field.unit ? ` ${field.unit}` : "",
          );
        }),
      );
    }
    for (const field of fields) {
      const input = where.querySelector<HTMLInputElement | HTMLSelectElement>(`#scope-field-${field.name}`)!;
      if (document.activeElement !== input || input instanceof HTMLSelectElement) input.value = field.value;
    }
  }

  private listed(channels: Channel[]): void {
    const focus = document.activeElement?.id ?? "";
    const rows = channels.map((each, i) => {
      const drawn = make("input", { type: "checkbox", id: `scope-shown-${i}`, "aria-label": `Show ${each.name}` });
      drawn.checked = each.shown;
      const stated = make("input", { type: "text", size: "6", id: `scope-stated-${i}`, "aria-label": `Unit of ${each.name}` });
      stated.value = each.unit;
      const unit = make("select", { id: `scope-unit-${i}`, "aria-label": `Unit in which ${each.name} is shown` });
      options(
        unit,
        each.units.map((name) => [name, name]),
        each.in_unit,
      );
      const set = () =>
        this.ask({
          do: "scope.channel",
          name: each.name,
          shown: drawn.checked,
          stated: each.states ? "" : stated.value.trim(),
          unit: unit.value,
        });
      for (const part of [drawn, stated, unit]) part.addEventListener("change", set);
      return [drawn, each.name, each.states ? each.unit : stated, each.units.length ? unit : ""];
    });
    this.channels.replaceChildren(...(rows.length ? [table(TEXT.heads, rows)] : []));
    if (focus.startsWith("scope-")) document.getElementById(focus)?.focus();
  }

  // What changes with every picture.
  private stands(words: Words): void {
    const again = words.following && this.source.value === words.chosen;
    text(this.follow, again ? TEXT.stop : TEXT.start);
    this.follow.disabled = !this.source.value;
    const rate = words.following && words.rate ? `, ${words.rate.toFixed(0)} rows/s` : "";
    text(this.state, words.failed || !words.state ? "" : `${words.state}${rate}`);
    this.state.className = words.following && !words.failed ? "live" : "";
    this.trouble.hidden = !words.failed;
    text(this.trouble, words.failed ? words.state : "");
    text(this.looking, words.look);
    text(this.hold, words.held ? TEXT.go_on : TEXT.hold);
    this.off.disabled = this.between.disabled = !words.cursors;
    const [low, high] = words.span ?? [0, 0];
    this.sliders.forEach((slider, i) => {
      const at = words.cursors?.[i];
      if (document.activeElement !== slider && high > low) slider.value = String(((at ?? low) - low) * (STEPS / (high - low)));
      slider.setAttribute("aria-valuetext", at === undefined ? "not set" : `${Number(at.toPrecision(5))}`);
      slider.disabled = !(high > low);
    });
    const read = JSON.stringify(words.readout);
    if (read !== this.read) {
      this.read = read;
      this.readout.replaceChildren(...(words.readout.length ? [table(["", "at 1", "at 2", "difference"], words.readout)] : []));
    }
  }

  private slider(which: string): HTMLInputElement {
    const slider = make("input", {
      type: "range",
      min: "0",
      max: String(STEPS),
      step: "1",
      id: `scope-cursor-${which}`,
      "aria-label": `Cursor ${which}`,
    });
    slider.addEventListener("input", () => {
      const [low, high] = this.words?.span ?? [0, 1];
      this.ask({ do: "scope.move", name: which, first: false, x: low + (Number(slider.value) / STEPS) * (high - low) });
    });
    return slider;
  }

  private click(x: number): void {
    const place = this.clicks[1]!.checked ? 1 : 0;
    this.ask({ do: "scope.move", name: String(place + 1), x });
    this.clicks[1 - place]!.checked = true; // the next click sets the other one
  }

  private draw(): void {
    const example = this.last?.said.charts.example;
    if (example && this.visible()) this.shows.draw(example, this.last!.numbers, look());
    const chart = this.last?.said.charts.scope;
    this.picture.element.hidden = this.cursors.hidden = !chart;
    if (!chart || !this.visible()) return;
    this.picture.draw(chart, this.last!.numbers, look());
  }
}

function labelled(name: string, input: HTMLElement): HTMLElement {
  return make("label", { for: input.id }, make("span", {}, `${name} `), input);
}

// The options of a choice, written anew only where they changed, so that an open list stays.
function options(select: HTMLSelectElement, among: [value: string, text: string][], value: string): void {
  const now = JSON.stringify(among);
  const kept = select.value;
  if (select.dataset.among !== now) {
    select.dataset.among = now;
    select.replaceChildren(...among.map(([each, said]) => make("option", { value: each }, said)));
    select.value = among.some(([each]) => each === kept) ? kept : (among[0]?.[0] ?? "");
  }
  if (among.some(([each]) => each === value) && (value || select.value === "")) select.value = value;
}

function text(where: HTMLElement, said: string): void {
  if (where.textContent !== said) where.textContent = said;
}
