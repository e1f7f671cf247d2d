// A part program: planned, run on the machine, corrected; path, feed, deviation and axes under one cursor.

import { SHAPES, type State } from "../controls/strip";
import { empty } from "../empty";
import { icon, line } from "../icons";
import { button, choice, make, renew } from "../parts";
import { dashes } from "../pictures/drawing";
import { color, look, whenPainted } from "../pictures/look";
import { Picture } from "../pictures/picture";
import { instant, Space, type Scene } from "../pictures/space";
import { Report, type Result } from "../result";
import { result, type Ask, type Room } from "../room";
import type { Received } from "../wire";

interface Figure {
  key: string;
  title: string;
  value: string;
  unit: string;
  note: string;
  state: State;
}
interface Listed {
  line: number;
  time: number;
  text: string;
  said: string | string[];
}
interface Words {
  ready: boolean;
  machine: string;
  programs: string[];
  chosen: string;
  source: string; // file and version of the program
  stages: string[];
  next: string;
  refused: string; // why it cannot be corrected
  tip: boolean;
  figures: Figure[];
  verdict: string;
  found: Result | null;
  falls: Listed[];
  places: Listed[];
  runs: string[];
  heats: Record<string, number>; // µm at the end of the scale
  letters?: string;
  cycle?: number;
  tool?: { radius: number; length: number };
  magnified?: number;
  archive?: string;
  text?: { source: string; lines: string[] };
}

const RUNS: Record<string, number> = { today: 100, now: 101, corrected: 105 }; // numbers of their curves
const PICTURES = { place: "Close-up, true scale", feed: "Feed", deviation: "Deviation", axes: "Axes" };
const FEED = "feed";
const TALL = 18; // pixels of a line of the program
const SPEEDS = ["1", "0.3", "0.1"];
// rows of the plan, before the positions of its axes
const [TIME, LINE, PLACE, AXIS, BELOW, JOINTS] = [0, 1, 2, 5, 8, 9];

export class Program implements Room {
  readonly name = "program";
  readonly title = "Program";
  readonly element = make("div", { class: "program fills" });
  private readonly intro: HTMLElement;
  private readonly head = make("div", { class: "head" });
  private readonly verdict = make("p", { id: "program-verdict", role: "status" });
  private readonly more = make("details", { id: "program-more" }, make("summary", {}, "Report"));
  private readonly figures = make("div", { class: "figures", role: "group", "aria-label": "Figures of the program" });
  private readonly strip = make("div", { class: "cursor", role: "group", "aria-label": "Cursor" });
  private readonly play = button("", () => this.playing(!this.runs), { class: "tool", id: "program-play" });
  private readonly slider = make("input", { type: "range", id: "program-time", "aria-label": "Time", min: "0", step: "any" });
  private readonly speed = choice(
    "",
    SPEEDS.map((each) => [each, `${each} ×`]),
    () => undefined,
  );
  private readonly reading = make("output", { for: "program-time" });
  private readonly colors = make("span", { class: "colors", role: "group", "aria-label": "Color of the path" });
  private readonly text = make("div", { class: "lines", tabindex: "0", role: "group", "aria-label": "Program text" });
  private readonly rows = make("div");
  private readonly lists = make("div", { class: "lists" });
  private readonly grid = make("div", { class: "grid" });
  private readonly wait = make("div", { class: "wait" });
  private readonly space = new Space("Path");
  private readonly pictures = new Map(Object.entries(PICTURES).map(([key, title]) => [key, new Picture(title, 40, true)]));
  private readonly report = new Report("program");
  private lines: { source: string; lines: string[] } = { source: "", lines: [] };
  private asked = ""; // program whose text was asked for
  private place = 0; // worst place that is shown close up
  private shade = ""; // run whose deviation colors the path, or the feed; empty: the latest
  private at = 0;
  private runs = false; // along time
  private points = false; // the cursor is being put
  private last: Received | null = null;
  private words: Words | null = null;
  private plan: Float32Array[] = [];

  constructor(private readonly ask: Ask) {
    this.intro = empty({
      title: "See a part program before it cuts.",
      sentence:
        "How long it takes, where the feed falls and why, how far the tool leaves its path and in which line, and what a correction makes of it. Of a five-axis machine the tip and the direction of the tool are judged.",
      act: button("Example: S curve on a five-axis machine", () => this.ask({ do: "program.example" }), {
        id: "program-example",
      }),
      note: "A machine of your own needs the axes that the program moves: import it first.",
    });
    const speed = this.speed.querySelector("select")!;
    speed.id = "program-speed";
    speed.setAttribute("aria-label", "Speed of playing");
    this.strip.append(this.play, this.speed, this.slider, this.reading, this.colors);
    this.text.append(this.rows);
    this.more.append(make("div", {}, this.report.head, this.report.body));
    this.space.element.id = "program-path";
    for (const [key, each] of this.pictures) each.element.id = `program-${key}`;
    this.grid.append(this.space.element, ...[...this.pictures.values()].map((each) => each.element));
    const side = make("div", { class: "source" }, this.text, this.lists);
    const bar = make("div", { class: "bar" }, this.verdict, this.more);
    this.element.append(this.intro, this.head, bar, this.figures, this.strip, side, this.grid, this.wait);
    this.slider.addEventListener("input", () => this.point(Number(this.slider.value)));
    this.text.addEventListener("scroll", () => this.listed());
    this.text.addEventListener("keydown", (event) => {
      const way = { ArrowUp: -1, ArrowDown: 1 }[event.key];
      if (way === undefined) return;
      event.preventDefault();
      this.go(this.line + way);
    });
    this.space.oncursor = (time) => !this.runs && this.point(time);
    this.space.onpick = (key) => this.look(Number(key));
    // a cursor that a person moves: one that is put, or drawn again, is none
    for (const each of this.pictures.values())
      each.oncursor = (x) =>
        x !== null && !this.points && !this.runs && each.element.matches(":hover, :focus-within") && this.point(x);
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    this.last = received;
    const words = received.said as unknown as Words;
    const before = this.words;
    this.words = words;
    const [at, m, n] = received.said.rows?.plan ?? [0, 0, 0];
    this.plan = Array.from({ length: m }, (_, k) => received.numbers.subarray(at + k * n, at + (k + 1) * n));
    this.element.dataset.state = !words.ready ? "empty" : m ? "planned" : "open";
    if (words.text) this.lines = words.text;
    if (before?.chosen !== words.chosen || JSON.stringify(before.stages) !== JSON.stringify(words.stages)) {
      this.place = 0;
      // the tool where it is worst, or where the first feed begins
      const first = m ? this.plan[BELOW]!.findIndex((each) => !Number.isNaN(each)) : 0;
      this.at = words.places[0]?.time ?? (m ? (this.plan[TIME]![Math.max(0, first)] ?? 0) : 0);
    }
    if (before && before.runs.length !== words.runs.length) this.shade = "";
    this.header(words);
    this.slider.max = String(words.cycle ?? 1);
    this.verdict.textContent = words.verdict;
    this.more.hidden = !words.found;
    this.report.show(words.found);
    this.filled(words);
    this.listing(words);
    this.shading(words);
    renew(this.wait, [words.chosen, words.tip, words.machine], () => [
      make("h1", {}, words.chosen),
      make(
        "p",
        {},
        `Plan it within the limits of ${words.machine.split(",")[0] ?? ""}: cycle time, where the feed falls and why, and a proof that every limit is kept.`,
      ),
    ]);
    if (words.ready && words.source !== this.lines.source && words.source !== this.asked) {
      this.asked = words.source;
      this.ask({ do: "program.text", name: words.chosen });
    }
    this.draw();
  }

  shown(): void {
    this.draw();
  }

  private header(words: Words): void {
    const { chosen, next, stages } = words;
    renew(this.head, [words.programs, chosen, next, stages, words.refused, words.archive], () => {
      const picked = choice(
        "Part program",
        words.programs.map((each): [string, string] => [each, each]),
        (name) => this.ask({ do: "program.choose", name }),
      );
      const select = picked.querySelector("select")!;
      select.id = "program-chosen";
      select.value = chosen;
      const act = (stage: string, text: string, title: string) => {
        const done = stages.includes(stage);
        const found = button(done ? `${text} again` : text, () => this.ask({ do: `program.${stage}`, name: chosen }), {
          id: `program-${stage}-now`,
          title,
          class: stage === next ? "main" : "",
        });
        if (stage !== "plan" && !stages.includes("plan")) {
          found.disabled = true;
          found.title = "Plan it first";
        }
        if (stage === "correct" && words.refused) {
          found.disabled = true;
          found.title = words.refused;
        }
        return found;
      };
      const link = make(
        "a",
        { href: result(words.archive ?? ""), download: words.archive ?? "", id: "program-archive" },
        "Download",
      );
      return [
        picked,
        act("plan", "Plan", "Within the limits of the machine, with a proof"),
        act("run", "Run on the machine", "On the simulated machine, under today's control and the one of now"),
        act("correct", "Correct", "Set positions and force offsets that make up for friction, judged on machines of a box"),
        ...(words.archive ? [link] : []),
      ];
    });
  }

  private filled({ figures }: Words): void {
    renew(this.figures, figures, () =>
      figures.map(({ key, title, value, unit, note, state }) => {
        const [drawing, word] = SHAPES[state];
        const shape = make("span", { class: "shape" });
        if (state !== "free") shape.append(icon(drawing, { role: "img", "aria-label": word }));
        return make(
          "div",
          { class: "gauge", "data-figure": key, "data-state": state },
          make("span", { class: "name", title }, title),
          shape,
          make("span", { class: "value" }, make("b", {}, value), make("small", {}, unit ? ` ${unit}` : "")),
          make("span", { class: "today", title: note }, note),
        );
      }),
    );
  }

  // Places of the program: where the tool is worst, and where the feed falls.
  private listing({ places, falls, runs }: Words): void {
    renew(this.lists, [places, falls, runs], () => {
      const names = runs.slice(-2);
      const worst = places.map((each, i) => {
        const sizes = each.said as string[];
        return make(
          "li",
          {},
          button(`line ${each.line}: ${sizes.join(" → ")}`, () => this.look(i), {
            class: "place",
            title: names.join(", then "),
            "aria-pressed": String(i === this.place),
          }),
        );
      });
      const slow = falls.map((each) =>
        make(
          "li",
          {},
          button(`line ${each.line}: ${each.text}, ${String(each.said)}`, () => this.point(each.time), {
            class: "place",
            title: String(each.said),
          }),
        ),
      );
      return [
        ...(worst.length ? [make("h2", {}, "Worst places"), make("ol", { id: "program-worst" }, ...worst)] : []),
        ...(slow.length ? [make("h2", {}, "Time lost against the feed"), make("ol", { id: "program-falls" }, ...slow)] : []),
      ];
    });
  }

  private shading({ runs }: Words): void {
    renew(this.colors, [runs, look().ink, this.shaded], () =>
      [FEED, ...runs].map((each) => {
        const number = RUNS[each];
        const found = button(each === FEED ? "Feed" : `${each[0]!.toUpperCase()}${each.slice(1)}`, () => {
          this.shade = each;
          if (this.words) this.shading(this.words);
          this.draw();
        }, { class: "chip", "aria-pressed": String(each === this.shaded), id: `program-color-${each}` }); // prettier-ignore
        if (number !== undefined) found.prepend(line(color(number, look()), dashes(number)));
        return found;
      }),
    );
  }

  private get shaded(): string {
    const runs = this.words?.runs ?? [];
    return this.shade === FEED || runs.includes(this.shade) ? this.shade : (runs.at(-1) ?? FEED);
  }

  private look(i: number): void {
    const place = this.words?.places[i];
    if (!place) return;
    this.place = i;
    this.lists.querySelectorAll("#program-worst button").forEach((each, k) => each.setAttribute("aria-pressed", String(k === i)));
    this.draw();
    this.point(place.time);
  }

  // Put the cursor at an instant, everywhere.
  private point(time: number): void {
    const { plan } = this;
    if (!plan.length) return;
    this.at = Math.max(0, Math.min(this.words?.cycle ?? 0, time));
    this.slider.value = String(this.at);
    this.space.cursor(this.at);
    this.points = true;
    for (const each of this.pictures.values()) if (each.element.id !== "program-place") each.putCursor(this.at);
    this.points = false;
    this.listed(true);
    this.read();
  }

  private read(): void {
    const { plan, words } = this;
    if (!plan.length || !words) return;
    const [k, share] = instant(plan[TIME]!, this.at);
    const value = (row: number) =>
      plan[row]![k]! + share * (plan[row]![Math.min(k + 1, plan[row]!.length - 1)]! - plan[row]![k]!);
    const place = ["X", "Y", "Z"].map((name, i) => `${name} ${value(PLACE + i).toFixed(3)}`);
    const turned = [...(words.letters ?? "")].flatMap((letter, i) =>
      "ABC".includes(letter) ? [`${letter} ${value(JOINTS + i).toFixed(2)}°`] : [],
    );
    const below = value(BELOW);
    const feed = Number.isNaN(below) ? "no feed" : `${(100 - below).toFixed(0)} % of the feed`;
    const off = words.runs.flatMap((name) => {
      const rows = this.run(name);
      if (!rows) return [];
      const [j] = instant(rows[0]!, this.at);
      return Number.isNaN(rows[4]![j]!) ? [] : [`${name} ${Number(rows[4]![j]!.toPrecision(3))} µm`];
    });
    this.reading.replaceChildren(
      make("b", {}, `${this.at.toFixed(3)} s, line ${this.line}`),
      ` ${[...place, ...turned].join("  ")}  ${feed}${off.length ? `  ${off.join(", ")}` : ""}`,
    );
  }

  private run(name: string): Float32Array[] | null {
    const found = this.last?.said.rows?.[name];
    if (!found || !this.last) return null;
    const [at, m, n] = found;
    return Array.from({ length: m }, (_, k) => this.last!.numbers.subarray(at + k * n, at + (k + 1) * n));
  }

  // The line of the program under the cursor.
  private get line(): number {
    const { plan } = this;
    return plan.length ? plan[LINE]![instant(plan[TIME]!, this.at)[0]]! : 0;
  }

  // Put the cursor where a line begins, or the first one behind it that moves.
  private go(number: number): void {
    const { plan } = this;
    if (!plan.length) return;
    let found = plan[LINE]!.indexOf(number);
    if (found < 0) found = plan[LINE]!.findIndex((each) => each >= number);
    if (found >= 0) this.point(plan[TIME]![found]!);
  }

  // The lines of the program that are in view, and the one under the cursor in the middle of it if it was moved.
  private listed(moved = false): void {
    const { lines } = this.lines;
    const now = this.line;
    this.rows.style.height = `${TALL * lines.length}px`;
    if (moved && now > 0) {
      const top = TALL * (now - 1);
      const { scrollTop, clientHeight } = this.text;
      if (top < scrollTop + TALL || top > scrollTop + clientHeight - 2 * TALL) this.text.scrollTop = top - clientHeight / 2;
    }
    const first = Math.max(0, Math.floor(this.text.scrollTop / TALL) - 4);
    const last = Math.min(lines.length, first + Math.ceil(this.text.clientHeight / TALL) + 8);
    const shown = JSON.stringify([this.lines.source, first, last, now]);
    if (shown === this.listed_now) return;
    this.listed_now = shown;
    this.rows.replaceChildren(
      ...lines.slice(first, last).map((text, k) => {
        const number = first + k + 1;
        const row = make(
          "div",
          { class: "line-row", ...(number === now ? { "aria-current": "true" } : {}) },
          make("i", {}, String(number)),
          text,
        );
        row.style.top = `${TALL * (number - 1)}px`;
        row.addEventListener("click", () => this.go(number));
        return row;
      }),
    );
  }
  private listed_now = "";

  private playing(on: boolean): void {
    this.runs = on;
    this.play.replaceChildren(icon(on ? "pause" : "play"));
    this.play.setAttribute("aria-label", on ? "Pause" : "Play along time");
    this.play.title = on ? "Pause" : "Play along time";
    if (!on) return;
    const cycle = this.words?.cycle ?? 0;
    if (this.at >= cycle) this.at = 0;
    let before = performance.now();
    const step = (now: number) => {
      if (!this.runs || this.element.closest("[hidden]")) return this.playing(false);
      const speed = Number(this.speed.querySelector("select")!.value);
      this.point(this.at + 1e-3 * (now - before) * speed);
      before = now;
      if (this.at >= cycle) this.playing(false);
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  private draw(): void {
    const { last, words, plan } = this;
    if (!last || !words || this.element.closest("[hidden]")) return;
    if (!this.play.childElementCount) this.playing(false);
    this.listed();
    this.shading(words);
    this.report.draw(last);
    if (!plan.length) return;
    this.space.draw(this.scene(words), words.chosen, this.said(words));
    const ran = words.runs.length > 0;
    this.grid.dataset.runs = ran ? "yes" : "no";
    for (const [key, picture] of this.pictures) {
      const chart = last.said.charts[key === "place" ? `place_${this.place}` : key];
      picture.element.hidden = !chart;
      if (chart) picture.draw(chart, last.numbers, look());
    }
    this.point(this.at);
  }

  private said(words: Words): string {
    if (!words.ready) return `example: ${words.chosen} on ${words.machine}, as programmed; tool not to scale`;
    const off = this.shaded === FEED ? "" : `, deviation × ${words.magnified}`;
    return `mm${words.tip ? ", tip in the frame of the workpiece" : ""}${off}; tool not to scale`;
  }

  private scene(words: Words): Scene {
    const { plan } = this;
    const three = (rows: Float32Array[], from: number) => [rows[from]!, rows[from + 1]!, rows[from + 2]!] as Scene["place"];
    const rows = this.shaded === FEED ? null : this.run(this.shaded);
    return {
      time: plan[TIME]!,
      place: three(plan, PLACE),
      axis: three(plan, AXIS),
      at_feed: plan[BELOW]!,
      flat: !words.tip,
      colored: rows
        ? {
            place: three(rows, 1),
            values: rows[4]!,
            heat: { label: "contour error (µm)", low: 0, high: Math.max(words.heats[this.shaded] ?? 0, 1e-9) },
          }
        : words.ready
          ? { place: three(plan, PLACE), values: plan[BELOW]!, heat: { label: "below the feed (%)", low: 0, high: 100 } }
          : null,
      off: rows ? { place: three(rows, 1), vector: three(rows, 5), counted: rows[4]!, factor: words.magnified ?? 1 } : null,
      marks: words.places.map((each, i) => ({ time: each.time, text: String(each.line), key: String(i) })),
      tool: words.tool ?? { radius: 1, length: 10 },
    };
  }
}
