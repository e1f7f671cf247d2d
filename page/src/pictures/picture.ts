// A chart of the server: panels below each other over the same x, with a legend that tells the figures of each curve.

import { dashes } from "./drawing";
import { scaled_bar } from "./heat";
import { color, look as chosen, NAMED, type Look } from "./look";
import { Panel, type Drawn, type Range } from "./panel";
import { pinch } from "./pinch";
import { Wipe, type Named } from "./wipe";
import { icon, line } from "../icons";
import { button, copy, make } from "../parts";
import type { Chart, Curve, Panel as Content } from "../wire";

const [HEIGHT, MORE] = [280, 80]; // pixels of a picture, as page.css has it, and of each panel beyond two
// How the legend shows a look that is no line.
const SAMPLES: Partial<Record<Curve["look"], string>> = { cross: "cross", ring: "ring", dots: "dots" };
const LARGE = "large";
const NOW = 101; // the number of the control of now, as on the server
const pictures = new WeakMap<Element, Picture>();
const asked: ((label: string, x: Range | null) => void)[] = [];

// A part of x is looked at: the server has more points of it.
export function whenZoomed(act: (label: string, x: Range | null) => void): void {
  asked.push(act);
}

let shown_all = 0; // how often

// Another source: no picture stays zoomed when it is drawn again.
export function showAll(): void {
  shown_all++;
}

export class Picture {
  readonly element = document.createElement("figure");
  onpick: ((x: number, y: number, panel: number, key: string) => void) | null = null; // key: of the mark that was clicked
  oncursor: ((x: number | null) => void) | null = null; // in SI; null where the cursor stands nowhere
  onsvg: ((how: "copy" | "save", x: Range | null) => void) | null = null; // x: what is in view, in the unit of the axis
  hidden: ReadonlySet<number> = new Set(); // numbers of curves that are not drawn
  private readonly followers: (() => void)[] = [];
  private readonly caption = document.createElement("figcaption");
  private readonly field = document.createElement("div"); // the picture, and over it what can be dragged
  private readonly surface = document.createElement("div");
  private readonly legend = document.createElement("ul");
  private readonly spoken = document.createElement("p");
  private panels: Panel[] = [];
  private shape = "";
  private legend_shown = "";
  private chart: Chart | null = null; // as it is drawn
  private whole_chart: Chart | null = null; // with what is hidden
  private numbers: Float32Array = new Float32Array();
  private x: Range | null = null; // what was zoomed to; null for all
  private y = new Map<number, Range>(); // by panel
  private shown_all = shown_all;
  private readonly whole = button("show all", () => (this.zoom(null, null), this.surface.focus()), {
    class: "whole",
    hidden: "",
  });

  private readonly quantities = document.createElement("span"); // of a picture in a tight grid: in place of labels at its axes
  private readonly wipe = new Wipe(
    () => this.redraw(),
    () => this.compare(),
    () => this.panels[0]?.box ?? null,
  );
  private readonly wiping = button("Wipe", () => this.compare(), {
    class: "wiping",
    title: "Compare two controls with a divider between them (W)",
  });
  private readonly menu = make("details", { class: "menu" });
  private readonly reading = document.createElement("span");
  private readonly dot = document.createElement("i"); // a place that another picture points at

  // `tight` for a picture that fills a cell of a grid: labels of the axes stand in its head, and it can be made large.
  constructor(
    readonly title: string,
    private readonly more = MORE,
    private readonly tight = false,
  ) {
    this.whole.setAttribute("aria-label", `show all of ${title}`);
    this.quantities.className = "quantities";
    this.dot.className = "dot";
    this.dot.hidden = true;
    this.caption.append(heading(title), " ", this.quantities, this.whole);
    this.reading.className = "reading";
    if (tight) this.caption.append(this.reading, this.tools());
    this.field.className = "field";
    this.surface.className = "surface";
    this.surface.setAttribute("role", "img");
    this.surface.tabIndex = 0;
    this.surface.title = `Drag or pinch to zoom, double click for the first view. Keys: left and right move the cursor, + and - zoom, 0 shows the first view${tight ? ", Enter makes it large, W compares two controls in it, S copies it as SVG, D its data" : ""}.`;
    this.surface.addEventListener("keydown", (event) => this.key(event));
    pinch(this.surface, {
      area: () => this.panels[0]!.area,
      scale: () => this.panels[0]!.scale(),
      show: (x) => this.look_at(x),
      ended: (x) => this.zoom(x, null),
    });
    this.legend.className = "legend";
    this.spoken.className = "spoken";
    this.spoken.setAttribute("role", "status");
    this.field.append(this.surface, this.dot, this.wipe.element);
    this.element.append(this.caption, this.legend, this.field, this.spoken);
    pictures.set(this.element, this);
    new ResizeObserver(() => this.redraw()).observe(this.field);
  }

  draw(whole: Chart, numbers: Float32Array, look: Look): void {
    const controls = named(whole);
    const wiped = this.wipe.shown(controls);
    const only = (...kept: number[]) =>
      without(whole, new Set(controls.map(([number]) => number).filter((each) => !kept.includes(each))));
    const chart = wiped ? only(wiped.left, wiped.right) : without(whole, this.hidden);
    const halves = wiped && [only(wiped.left).panels, only(wiped.right).panels];
    this.wiping.disabled = controls.length < 2;
    this.keep_zoom(chart);
    this.chart = chart;
    this.whole_chart = whole;
    this.numbers = numbers;
    this.whole.hidden = this.x === null && this.y.size === 0;
    if (!this.tight)
      this.field.style.height = chart.panels.length > 2 ? `${HEIGHT + this.more * (chart.panels.length - 2)}px` : "";
    const [width, height] = [this.field.clientWidth, this.field.clientHeight];
    if (width < 120 || height < 60) return; // not laid out yet
    const x = this.x ?? reach(chart, numbers);
    const names = new Map(
      chart.panels.flatMap(({ curves }) => curves.filter((each) => each.name).map((each) => [each.number, each.name])),
    );
    const drawn: Drawn[] = chart.panels.map((content, i) => ({
      content, numbers, x, look, names,
      y: this.y.get(i) ?? range(content, numbers, x),
      frequency: chart.scale !== "linear", square: chart.square, bare: chart.bare, label: chart.label, tight: this.tight,
      wipe: halves && wiped && { left: halves[0]![i]!, right: halves[1]![i]!, at: wiped.at },
    })); // prettier-ignore
    const sizes = layout(chart, drawn, width, height);
    const shape = JSON.stringify([
      chart.label,
      chart.scale,
      chart.square,
      chart.bare,
      chart.panels.map((each) => [each.label, each.scale, each.said !== ""]),
    ]);
    if (shape !== this.shape) {
      for (const each of this.panels) each.close();
      const link = chart.square ? null : chart.label;
      this.panels = drawn.map((each, i) => {
        const heard = {
          selected: (x: Range | null, y: Range | null) => this.zoom(x, y, i),
          reset: () => this.zoom(null, null),
          picked: (x: number, y: number, key: string) => this.onpick?.(x / this.factor, y, i, key),
          pointed: (x: number | null) => i === 0 && this.read(x),
        };
        return new Panel(this.surface, each, i === drawn.length - 1, ...sizes[i]!, link, heard);
      });
      this.shape = shape;
    } else {
      this.panels.forEach((each, i) => each.draw(drawn[i]!, ...sizes[i]!));
    }
    this.describe(chart, look);
    const labels = [...new Set(chart.panels.map((each) => each.label)), chart.label];
    this.quantities.textContent = this.tight ? labels.map((each) => shortened(each, this.title)).join(" · ") : "";
    this.quantities.title = labels.join("; ");
    this.wipe.place();
    for (const follow of this.followers) follow();
  }

  // The values of now at the cursor, in the head of a picture in a grid.
  private read(x: number | null): void {
    this.oncursor?.(x === null ? null : x / this.factor);
    if (!this.tight || this.chart?.square) return;
    const found = x === null ? [] : this.panels.map((each) => each.valueAt(NOW, x)).filter((each) => each !== null);
    this.reading.textContent = found.map((each) => Number(each.toPrecision(3))).join(", ");
  }

  // Put the cursor at a value of x in SI, here and in the pictures beside this one over the same x.
  putCursor(x: number): void {
    const first = this.panels[0];
    if (!first) return;
    const share = (this.pixel(x) - first.box.left) / first.box.width;
    if (share >= 0 && share <= 1) for (const each of this.panels) each.point(share);
  }

  // Show a place in the first panel, in the units of its axes; null takes it away.
  point(at: { x: number; y: number } | null): void {
    const [left, top] = at ? [this.panels[0]?.across(at.x) ?? NaN, this.pixelHeight(at.y) ?? NaN] : [NaN, NaN];
    this.dot.hidden = Number.isNaN(left + top) || this.at([left, top]) === null;
    this.dot.style.left = `${left}px`;
    this.dot.style.top = `${top}px`;
  }

  // What is drawn, as a table: a row a point, each panel and each curve below the one before.
  csv(): string {
    const rows = ["panel,curve,x,y"];
    for (const panel of this.chart?.panels ?? [])
      for (const curve of panel.curves)
        for (let i = 0; i < curve.n; i++) {
          const [x, y] = [this.numbers[curve.at + i]!, this.numbers[curve.at + curve.n + i]!];
          if (!Number.isNaN(x + y)) rows.push([quoted(panel.label), quoted(curve.name), five(x), five(y)].join(","));
        }
    return `${rows.join("\n")}\n`;
  }

  // Copy or save what is drawn; a picture as SVG is drawn by the server, as in a report.
  private take(how: "data" | "copy" | "save"): void {
    this.menu.open = false;
    if (how === "data") void copy(this.csv(), this.menu);
    else if (this.onsvg) this.onsvg(how, this.x);
  }

  taken(text: string): void {
    void copy(text, this.menu);
  }

  private tools(): HTMLElement {
    const tools = document.createElement("span");
    const large = button("", () => this.enlarge(), { class: "tool", title: "Make large (Enter), or small again" });
    large.setAttribute("aria-label", `Make ${this.title} large`);
    large.append(icon("large"));
    const summary = make("summary", { class: "tool", title: "Copy or save", "aria-label": `Copy or save ${this.title}` });
    summary.append(icon("copy"));
    const entries = make(
      "div",
      {},
      button("Copy as SVG (S)", () => this.take("copy")),
      button("Save as SVG (Shift+S)", () => this.take("save")),
      button("Copy data as CSV (D)", () => this.take("data")),
    );
    this.menu.append(summary, entries);
    this.menu.addEventListener("focusout", (event) => {
      if (!this.menu.contains(event.relatedTarget as Node | null)) this.menu.open = false;
    });
    this.menu.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || !this.menu.open) return;
      event.stopPropagation();
      this.menu.open = false;
      summary.focus();
    });
    tools.className = "tools";
    tools.append(this.wiping, this.menu, large);
    return tools;
  }

  // Fill the grid with this picture, or give the others their places again.
  private enlarge(): void {
    const now = this.element.classList.toggle(LARGE);
    this.wipe.end();
    this.element.parentElement?.classList.toggle("one", now);
  }

  // Begin to compare two controls in the large picture, the first and the last one that are shown, or end it.
  private compare(): void {
    const controls = this.whole_chart ? named(this.whole_chart) : [];
    if (this.wipe.on) {
      this.wipe.end();
      this.surface.focus();
    } else if (controls.length > 1) {
      if (!this.element.classList.contains(LARGE)) this.enlarge();
      const shown = controls.filter(([number]) => !this.hidden.has(number));
      const [first, last] = shown.length > 1 ? [shown[0]!, shown.at(-1)!] : [controls[0]!, controls.at(-1)!];
      this.wipe.begin(first[0], last[0]);
    }
    this.redraw();
  }

  // What lies over the picture finds its place after each drawing.
  whenDrawn(follow: () => void): void {
    this.followers.push(follow);
  }

  // Show a part of x, and of y in one panel; of pictures beside this one over the same x too. Null shows all of it.
  zoom(x: Range | null, y: Range | null, panel = 0): void {
    if (x === null && y === null) this.all();
    if (y) this.y.set(panel, y);
    if (x || y === null) this.look_at(x);
    else this.redraw();
    if (this.chart && !this.chart.square && (x || y === null)) for (const act of asked) act(this.chart.label, x);
  }

  private look_at(x: Range | null): void {
    for (const each of this.linked()) {
      each.x = x;
      each.redraw();
    }
  }

  // x of a place on the picture, in SI whatever unit its axis has; null beside the panels
  at(place: [number, number]): number | null {
    const found = this.panels[0]?.at(...place);
    return found ? found.x / this.factor : null;
  }

  // x at a distance from the left, also beside the panels, in SI; null before something was drawn
  across(place: number): number | null {
    const found = this.panels[0]?.along(place);
    return found === undefined ? null : found / this.factor;
  }

  pixel(x: number): number {
    return this.panels[0]?.across(x * this.factor) ?? 0;
  }

  private get factor(): number {
    return this.chart?.factor ?? 1;
  }

  // y of a height in the first panel, in the unit of its axis; null before something was drawn
  height(place: number): number | null {
    return this.panels[0]?.height(place) ?? null;
  }

  pixelHeight(y: number): number | null {
    return this.panels[0]?.up(y) ?? null;
  }

  // Whether a value of y lies in the first panel.
  holds(y: number): boolean {
    return this.panels[0]?.holds(y) ?? false;
  }

  // Where the content of the first panel lies in the picture, in pixels.
  get box(): DOMRect | null {
    return this.panels[0]?.box ?? null;
  }

  get canvas(): HTMLElement {
    return this.field;
  }

  private redraw(): void {
    if (this.whole_chart) this.draw(this.whole_chart, this.numbers, chosen());
  }

  private all(): void {
    this.x = null;
    this.y.clear();
  }

  // What was zoomed to, as far as it means the same in another chart.
  private keep_zoom(chart: Chart): void {
    const [before, x] = [this.chart, this.x];
    const another = this.shown_all !== shown_all;
    this.shown_all = shown_all;
    if (!before) return;
    if (another) {
      this.all(); // and the server knows
    } else if (before.label !== chart.label || before.scale !== chart.scale) {
      this.all();
      if (x && !before.square) for (const act of asked) act(before.label, null);
    }
    for (const i of [...this.y.keys()]) {
      const [old, fresh] = [before.panels[i], chart.panels[i]];
      if (old?.label !== fresh?.label || old?.scale !== fresh?.scale) this.y.delete(i);
    }
  }

  // This picture and those beside it over the same x.
  private linked(): Picture[] {
    const beside = [...(this.element.parentElement?.children ?? [])].map((each) => pictures.get(each));
    const found = beside.filter(
      (each) => each?.chart && each.chart.label === this.chart?.label && !each.chart.square && !each.element.hidden,
    );
    return this.chart?.square ? [this] : [...new Set([this, ...(found as Picture[])])];
  }

  private key(event: KeyboardEvent): void {
    const first = this.panels[0];
    if (!first || event.ctrlKey || event.metaKey || event.altKey) return;
    const now = first.cursor ?? 0.5;
    const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (way !== undefined) {
      const to = Math.min(1, Math.max(0, now + way * (event.shiftKey ? 0.1 : 0.01)));
      this.spoken.textContent = this.panels.map((each) => each.point(to)).join("; ");
    } else if (event.key === "+") {
      const at = first.scale();
      this.zoom({ low: at(Math.max(0, now - 0.25)), high: at(Math.min(1, now + 0.25)) }, null);
    } else if (event.key === "-" && this.x === null && this.chart?.low !== null) {
      this.zoom(extent(this.chart!, this.numbers), null); // beyond the part that is shown at first
    } else if (this.tight && event.key.toLowerCase() === "w") {
      this.compare();
    } else if (event.key === "Escape" && this.wipe.on) {
      this.compare();
    } else if (["-", "0"].includes(event.key) || (event.key === "Escape" && !this.element.classList.contains(LARGE))) {
      this.zoom(null, null);
    } else if (this.tight && (event.key === "Enter" || event.key === "Escape")) {
      this.enlarge();
    } else if (this.tight && event.key.toLowerCase() === "s") {
      this.take(event.shiftKey ? "save" : "copy");
    } else if (this.tight && event.key.toLowerCase() === "d") {
      this.take("data");
    } else {
      return;
    }
    event.preventDefault();
  }

  private describe(chart: Chart, look: Look): void {
    const curves = chart.panels.flatMap((panel) => panel.curves).filter((curve) => curve.name);
    const bands = chart.panels.flatMap((panel) => panel.bands).filter((band) => band.name);
    const named = [
      ...curves.map(({ number, name, said, look, reach }) => ({
        number,
        kind: reach ? "area" : (SAMPLES[look] ?? "line"),
        said: said ? `${name}: ${said.trim()}` : name,
      })),
      ...bands.map(({ number, name }) => ({ number, kind: "area", said: name })),
    ];
    const heats = chart.panels.flatMap((panel) => panel.heat ?? []);
    const words = [
      ...named.map((each) => each.said),
      ...heats.map(({ label, low, high }) => `${label} as color, ${low} to ${Number(high.toPrecision(3))}`),
    ];
    const shown = JSON.stringify([named, heats, look.ink]);
    if (shown === this.legend_shown) return;
    this.legend_shown = shown;
    this.legend.replaceChildren(
      ...named.map(({ number, kind, said }) => {
        const item = document.createElement("li");
        const sample = document.createElement("span");
        sample.className = `sample ${kind}`;
        sample.style.color = color(number, look);
        if (number >= NAMED && kind !== "area") item.className = number === NOW ? "control now" : "control";
        item.append(kind === "line" ? line(color(number, look), dashes(number)) : sample, said);
        return item;
      }),
      ...heats.map((each) => scaled_bar(each, look)),
    );
    this.surface.setAttribute("aria-label", `${this.title}. ${words.join("; ")}`);
  }
}

function heading(title: string): HTMLElement {
  const found = document.createElement("b");
  found.textContent = title;
  return found;
}

// The label of an axis under a title that says the same quantity: its unit alone.
function shortened(label: string, title: string): string {
  const unit = /\(([^)]*)\)$/.exec(label)?.[1];
  const quantity = label.replace(/ ?\([^)]*\)$/, "");
  if (unit && [title.toLowerCase(), "frequency", "time"].includes(quantity.toLowerCase())) return unit;
  return quantity.toLowerCase().startsWith(`${title.toLowerCase()} `) ? label.slice(title.length + 1) : label;
}

function quoted(text: string): string {
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

function five(value: number): string {
  return String(Number(value.toPrecision(7)));
}

// The controls that a chart compares, by the numbers of their curves.
function named(chart: Chart): Named[] {
  const curves = chart.panels.flatMap((panel) => panel.curves).filter((each) => each.number >= NAMED && each.name);
  return [...new Map(curves.map(({ number, name }) => [number, name]))];
}

// The chart without what belongs to some curves.
function without(chart: Chart, hidden: ReadonlySet<number>): Chart {
  if (hidden.size === 0) return chart;
  const shown = (each: { number: number }) => !hidden.has(each.number);
  const panels = chart.panels.map((panel) => ({
    ...panel,
    curves: panel.curves.filter(shown),
    marks: panel.marks.filter(shown),
    discs: panel.discs.filter(shown),
    notes: panel.notes.filter(shown),
    bands: panel.bands.filter(shown),
  }));
  return { ...chart, panels };
}

// All of x that the curves have.
function extent(chart: Chart, numbers: Float32Array): Range {
  return span(
    chart.panels.flatMap((panel) => panel.curves.map((each) => numbers.subarray(each.at, each.at + each.n))),
    chart.scale !== "linear",
  );
}

// The part of x that is shown at first.
function reach(chart: Chart, numbers: Float32Array): Range {
  const found = chart.low === null || chart.high === null ? extent(chart, numbers) : { low: 0, high: 1 };
  return { low: chart.low ?? found.low, high: chart.high ?? found.high };
}

// y of a panel: as the chart says, or what the curves need where x is shown, with a little room.
function range(panel: Content, numbers: Float32Array, x: Range): Range {
  if (panel.low !== null && panel.high !== null) return { low: panel.low, high: panel.high };
  const log = panel.scale === "log";
  const rows = panel.curves.map((each) => {
    const [across, up] = [each.at, each.at + each.n];
    const found: number[] = [];
    for (let i = 0; i < each.n; i++)
      if (numbers[across + i]! >= x.low && numbers[across + i]! <= x.high) found.push(numbers[up + i]!);
    return found;
  });
  const { low, high } = span(rows, log);
  const room = log ? (high / low) ** 0.06 : 0.06 * (high - low);
  return { low: panel.low ?? (log ? low / room : low - room), high: panel.high ?? (log ? high * room : high + room) };
}

function span(rows: ArrayLike<number>[], log: boolean): Range {
  let [low, high] = [Infinity, -Infinity];
  for (const row of rows) {
    for (let i = 0; i < row.length; i++) {
      const each = row[i]!;
      if (Number.isNaN(each) || (log && each <= 0)) continue;
      if (each < low) low = each;
      if (each > high) high = each;
    }
  }
  if (low > high) return log ? { low: 1, high: 10 } : { low: 0, high: 1 };
  if (low === high)
    return log ? { low: low / 2, high: low * 2 } : { low: low - (Math.abs(low) || 1), high: high + (Math.abs(high) || 1) };
  return { low, high };
}

// Width and height of each panel; of a square chart so that a unit of x is as long as one of y.
function layout(chart: Chart, drawn: Drawn[], width: number, height: number): [number, number][] {
  const around = drawn.map((_, i) => Panel.around(drawn[i]!, i === drawn.length - 1));
  const shares = chart.panels.reduce((sum, panel) => sum + panel.share, 0);
  const free = height - around.reduce((sum, each) => sum + each[1], 0);
  return drawn.map(({ x, y }, i) => {
    const [beside, below] = around[i]!;
    let [wide, tall] = [width - beside, (free * chart.panels[i]!.share) / shares];
    if (chart.square) {
      const unit = Math.min(wide / (x.high - x.low), tall / (y.high - y.low));
      [wide, tall] = [unit * (x.high - x.low), unit * (y.high - y.low)];
    }
    return [Math.round(wide + beside), Math.round(tall + below)];
  });
}
