// One panel of a picture: axes, cursor and zoom by uPlot, the content by drawing.ts.

import uPlot from "uplot";

import { pixel, value, type Axis } from "./axis";
import { near } from "./curve";
import { paint } from "./drawing";
import type { Look } from "./look";
import { pointed } from "./names";
import { plain, ticks, type Ticks } from "./ticks";
import type { Panel as Content } from "../wire";

// pixels of the axis at the left, the same for all panels so that they stand in line, and below; tight: without labels
const LEFT = { roomy: 66, tight: 44 };
const BELOW = { roomy: 42, tight: 22, other: 10 };
const [TOP, RIGHT, SAID] = [6, 14, 20]; // above, with a line above, and at the right

export interface Range {
  low: number;
  high: number;
}
// What a panel tells its picture.
export interface Heard {
  selected: (x: Range | null, y: Range | null) => void;
  reset: () => void;
  picked: (x: number, y: number, key: string) => void;
  pointed: (x: number | null) => void; // where the cursor stands
}
// What is drawn: content of the panel, numbers of its curves, both ranges and scales.
export interface Drawn {
  content: Content;
  numbers: Float32Array;
  x: Range;
  y: Range;
  frequency: boolean;
  square: boolean;
  bare: boolean;
  tight: boolean; // no labels at the axes
  label: string;
  names: Map<number, string>; // of curves, by number: panels below the first do not name them again
  look: Look;
  wipe: { left: Content; right: Content; at: number } | null; // the content at both sides of a line, at a share of the width
}

export class Panel {
  private readonly plot: uPlot;
  private readonly readout = document.createElement("div");
  private drawn: Drawn;

  // Pixels beside the content: across, and up and down.
  static around({ content, bare, tight }: Drawn, last: boolean): [number, number] {
    const [top, kind] = [content.said ? SAID : TOP, tight ? "tight" : "roomy"] as const;
    if (bare) return [2 * RIGHT, top + RIGHT];
    return [LEFT[kind] + RIGHT, top + (last ? BELOW[kind] : BELOW.other)];
  }

  constructor(place: HTMLElement, drawn: Drawn, last: boolean, width: number, height: number, link: string | null, heard: Heard) {
    this.drawn = drawn;
    const ink = () => this.drawn.look.ink;
    const grid = { stroke: () => this.drawn.look.line, width: 1 };
    const shared = {
      stroke: ink,
      grid,
      ticks: { ...grid, size: 4 },
      font: "11px system-ui, sans-serif",
      labelFont: "12px system-ui, sans-serif",
    };
    const divided = (range: () => Range, log: () => boolean, degrees: () => boolean, pixels: () => number, apart: number) => {
      const found = (): Ticks => ticks(range(), log(), degrees(), Math.max(2, pixels() / apart));
      return {
        splits: () => found().at,
        filter: (_: uPlot, at: number[]) => at.map((each) => (found().named.has(each) ? each : null)),
        values: (_: uPlot, at: (number | null)[]) => at.map((each) => (each === null ? "" : plain(each))),
      };
    };
    const x = divided(
      () => this.drawn.x,
      () => this.drawn.frequency,
      () => false,
      () => this.plot.bbox.width / uPlot.pxRatio,
      75,
    );
    const y = divided(
      () => this.drawn.y,
      () => this.drawn.content.scale === "log",
      () => this.drawn.content.scale === "degrees",
      () => this.plot.bbox.height / uPlot.pxRatio,
      26,
    );
    const top = drawn.content.said ? SAID : TOP;
    const beside = drawn.tight ? {} : { label: drawn.content.label, labelSize: 20, labelGap: 0 };
    const under = drawn.tight ? {} : { label: drawn.label, labelSize: 20, labelGap: 0 };
    const below = last
      ? { size: drawn.tight ? BELOW.tight : BELOW.roomy - 20, ...under }
      : { size: BELOW.other, values: () => [] };
    this.plot = new uPlot(
      {
        width,
        height,
        padding: drawn.bare ? [top, RIGHT, RIGHT, RIGHT] : [top, RIGHT, 0, 0],
        legend: { show: false },
        scales: {
          x: { time: false, distr: drawn.frequency ? 3 : 1, range: () => [this.drawn.x.low, this.drawn.x.high] },
          y: { distr: drawn.content.scale === "log" ? 3 : 1, range: () => [this.drawn.y.low, this.drawn.y.high] },
        },
        series: [{}, { paths: () => null, points: { show: false } }],
        axes: [
          { ...shared, ...x, ...below, show: !drawn.bare },
          { ...shared, ...y, show: !drawn.bare, size: drawn.tight ? LEFT.tight : LEFT.roomy - 20, ...beside },
        ],
        cursor: {
          y: drawn.square,
          points: { show: false },
          drag: { x: true, y: true, uni: 24, setScale: false },
          bind: { dblclick: () => () => (heard.reset(), null) },
          ...(link === null
            ? {}
            : { sync: { key: link, scales: ["x", null] as [string, null], setSeries: false, filters: { pub: still } } }),
        },
        hooks: {
          draw: [() => this.paint()],
          setCursor: [() => heard.pointed(this.read())],
          setSelect: [() => this.select(heard)],
        },
      },
      this.corners(),
      place,
    );
    this.readout.className = "readout";
    this.readout.hidden = true;
    this.plot.over.append(this.readout);
    this.plot.over.addEventListener("pointerenter", () => this.plot.syncRect(true)); // it may have been moved on the page
    let pressed = { x: 0, y: 0 };
    this.plot.over.addEventListener("mousedown", (event) => (pressed = { x: event.clientX, y: event.clientY }));
    this.plot.over.addEventListener("click", (event) => {
      if (Math.hypot(event.clientX - pressed.x, event.clientY - pressed.y) > 4) return; // the end of a drag
      const box = this.plot.over.getBoundingClientRect();
      const { x, y } = this.axes();
      const { left, top } = this.plot.bbox;
      const [px, py] = [left + (event.clientX - box.left) * uPlot.pxRatio, top + (event.clientY - box.top) * uPlot.pxRatio];
      heard.picked(value(x, px), value(y, py), pointed(this.drawn.content.marks, x, y, px, py, uPlot.pxRatio)?.key ?? "");
    });
  }

  draw(drawn: Drawn, width: number, height: number): void {
    this.drawn = drawn;
    if (this.plot.width !== width || this.plot.height !== height) this.plot.setSize({ width, height });
    this.plot.setData(this.corners());
  }

  // Where the content lies within the picture, in pixels of CSS.
  get box(): DOMRect {
    const { left, top, width, height } = this.plot.bbox;
    const ratio = uPlot.pxRatio;
    return new DOMRect(this.left + left / ratio, this.top + top / ratio, width / ratio, height / ratio);
  }

  // Pixels of CSS within the picture: of a value of x, and of y.
  across(x: number): number {
    return this.left + pixel(this.axes().x, x) / uPlot.pxRatio;
  }

  up(y: number): number {
    return this.top + pixel(this.axes().y, y) / uPlot.pxRatio;
  }

  // Values at a place within the picture; null beside the panel.
  at(px: number, py: number): { x: number; y: number } | null {
    const { x, y } = this.axes();
    const [across, up] = [(px - this.left) * uPlot.pxRatio, (py - this.top) * uPlot.pxRatio];
    const inside = across >= x.from && across <= x.to && up >= y.to && up <= y.from;
    return inside ? { x: value(x, across), y: value(y, up) } : null;
  }

  // Whether a value of y lies in the panel, or a pixel beside it.
  holds(value: number): boolean {
    const { y } = this.axes();
    const up = pixel(y, value);
    return up >= y.to - uPlot.pxRatio && up <= y.from + uPlot.pxRatio;
  }

  // The value of x at a distance from the left, also beside the panel.
  along(px: number): number {
    return value(this.axes().x, (px - this.left) * uPlot.pxRatio);
  }

  // The value of y at a height, also above and below the panel.
  height(py: number): number {
    return value(this.axes().y, (py - this.top) * uPlot.pxRatio);
  }

  // Where the cursor stands, as a share of the width; null if it stands nowhere.
  get cursor(): number | null {
    const left = this.plot.cursor.left ?? -1;
    return left < 0 ? null : (left * uPlot.pxRatio) / this.plot.bbox.width;
  }

  // Put the cursor at a share of the width; what stands there in words.
  point(share: number): string {
    const { width, height } = this.plot.bbox;
    this.plot.setCursor({ left: (share * width) / uPlot.pxRatio, top: height / uPlot.pxRatio / 2 });
    return this.readout.textContent ?? "";
  }

  // y of the line with a number, at x; null beside it.
  valueAt(number: number, x: number): number | null {
    const curve = this.drawn.content.curves.find((each) => each.number === number && each.look === "line");
    return curve ? near(curve, this.drawn.numbers, x) : null;
  }

  // x at a share of the width, as it is shown now.
  scale(): (share: number) => number {
    const { x } = this.axes();
    return (share) => value(x, x.from + share * (x.to - x.from));
  }

  get area(): DOMRect {
    return this.plot.over.getBoundingClientRect();
  }

  close(): void {
    this.plot.destroy();
  }

  private get top(): number {
    return this.plot.root.offsetTop;
  }

  private get left(): number {
    return this.plot.root.offsetLeft; // a square picture stands in the middle of a wide field
  }

  // uPlot takes its ranges from data: two corners of what is shown.
  private corners(): uPlot.AlignedData {
    const { x, y } = this.drawn;
    return [
      [x.low, x.high],
      [y.low, y.high],
    ];
  }

  private axes(): { x: Axis; y: Axis } {
    const { left, top, width, height } = this.plot.bbox;
    const { x, y, frequency, content } = this.drawn;
    return {
      x: { ...x, log: frequency, from: left, to: left + width },
      y: { ...y, log: content.scale === "log", from: top + height, to: top },
    };
  }

  private paint(): void {
    const { content, numbers, look, wipe } = this.drawn;
    const { x, y } = this.axes();
    const { ctx } = this.plot;
    if (!wipe) return paint(ctx, content, numbers, x, y, look, uPlot.pxRatio);
    const middle = x.from + wipe.at * (x.to - x.from);
    for (const [half, from, to] of [
      [wipe.left, x.from, middle],
      [wipe.right, middle, x.to],
    ] as const) {
      ctx.save();
      ctx.beginPath();
      ctx.rect(from, y.to, to - from, y.from - y.to);
      ctx.clip();
      paint(ctx, half, numbers, x, y, look, uPlot.pxRatio);
      ctx.restore();
    }
  }

  private select(heard: Heard): void {
    const { left, top, width, height } = this.plot.select;
    if (width === 0 && height === 0) return;
    this.plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    const { bbox, over } = this.plot;
    const { x, y } = this.axes();
    const ratio = uPlot.pxRatio;
    const wide = width < over.clientWidth && width > 4;
    const tall = height < over.clientHeight && height > 4;
    heard.selected(
      wide ? { low: value(x, bbox.left + left * ratio), high: value(x, bbox.left + (left + width) * ratio) } : null,
      tall ? { low: value(y, bbox.top + (top + height) * ratio), high: value(y, bbox.top + top * ratio) } : null,
    );
  }

  // Show the values under the cursor in words; x there, null without a cursor.
  private read(): number | null {
    const { left = -1, top = -1 } = this.plot.cursor;
    this.readout.hidden = left < 0;
    if (left < 0) return null;
    const { bbox } = this.plot;
    const { x, y } = this.axes();
    const at = value(x, bbox.left + left * uPlot.pxRatio);
    const { content, numbers, square, bare, names } = this.drawn;
    const up = bbox.top + top * uPlot.pxRatio;
    const mark = pointed(content.marks, x, y, bbox.left + left * uPlot.pxRatio, up, uPlot.pxRatio);
    this.plot.over.style.cursor = mark?.key ? "pointer" : "";
    const rows = bare ? [] : [five(at)];
    if (square && !bare) rows[0] += `, ${five(value(y, up))}`;
    else if (!square)
      for (const curve of content.curves.filter((each) => each.look === "line" || each.look === "dots")) {
        const found = near(curve, numbers, at);
        if (found !== null) rows.push(`${names.get(curve.number) ?? ""} ${five(found)}`.trim());
      }
    if (mark) rows.push([mark.name, mark.said].filter((each) => each).join(": "));
    this.readout.textContent = rows.join("\n");
    this.readout.hidden = rows.length === 0;
    this.readout.classList.toggle("right", left < this.plot.over.clientWidth / 2);
    return at;
  }
}

// The cursor is linked, and a drag is not: what it selects is shown by the picture.
function still(type: string, plot: uPlot): boolean {
  return type === "mouseleave" || (type === "mousemove" && !(plot.cursor.event && plot.cursor.event.buttons));
}

function five(value: number): string {
  return String(Number(value.toPrecision(5)));
}
