// A chart of the server drawn by ECharts: panels below each other over the same x.

import { LineChart, ScatterChart } from "echarts/charts";
import { AxisPointerComponent, GridComponent, TooltipComponent } from "echarts/components";
import { init, use, type ECharts } from "echarts/core";
import { CanvasRenderer } from "echarts/renderers";

import { points, sum, type Chart, type Panel } from "./wire";

use([LineChart, ScatterChart, GridComponent, TooltipComponent, AxisPointerComponent, CanvasRenderer]);

// the colors and dashes of the reports (plot/style.py), brighter ones on dark paper
const LIGHT = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
const DARK = ["#56b4e9", "#ff9d5c", "#35c79b", "#e7a8cb", "#f0c04d", "#9ad2f2"];
const DASHES: (string | number[])[] = ["solid", [7, 2], [2, 1.5], [7, 2, 2, 2], [12, 3], [4, 1.5, 1, 1.5]];
const SYMBOLS = ["circle", "rect", "triangle", "diamond", "pin", "roundRect"];

export interface Look {
  ink: string;
  muted: string;
  line: string;
  alert: string;
  curves: string[];
}
export const LOOKS: Record<"light" | "dark", Look> = {
  light: { ink: "#1c2329", muted: "#5a6772", line: "#d9dfe4", alert: "#b3261e", curves: LIGHT },
  dark: { ink: "#e6eaee", muted: "#a2adb8", line: "#39424b", alert: "#ff8a80", curves: DARK },
};

export class Picture {
  readonly element = document.createElement("figure");
  private readonly caption = document.createElement("figcaption");
  private readonly field = document.createElement("div"); // the picture, and over it what can be dragged
  private readonly surface = document.createElement("div");
  private readonly legend = document.createElement("ul");
  private readonly drawing: ECharts;
  private shape = "";
  private ids = "";
  private look: Look | null = null;
  private seen = new Map<string, string>();

  constructor(readonly title: string) {
    this.caption.textContent = title;
    this.field.className = "field";
    this.surface.className = "surface";
    this.surface.setAttribute("role", "img");
    this.field.append(this.surface);
    this.legend.className = "legend";
    this.element.append(this.caption, this.legend, this.field);
    this.drawing = init(this.surface, null, { renderer: "canvas" });
    new ResizeObserver(() => this.drawing.resize()).observe(this.field);
  }

  // Only what has changed is given to ECharts: axes that stay and curves with the same points are left as they are.
  draw(chart: Chart, numbers: Float32Array, look: Look): void {
    const axes = frame(chart, look, this.field.clientWidth, this.field.clientHeight);
    const series = chart.panels.flatMap((panel, i) => lines(panel, i, chart, numbers, look));
    const shape = JSON.stringify([axes, look.ink]);
    const ids = series.map((each) => each.id).join();
    const seen = new Map(series.map((each) => [each.id, each.content]));
    const changed = series.filter((each) => each.content !== this.seen.get(each.id));
    if (ids !== this.ids || look !== this.look) {
      this.drawing.setOption({ ...axes, series: series.map((each) => each.option()) }, { notMerge: true, lazyUpdate: false });
    } else if (shape !== this.shape) {
      this.drawing.setOption({ ...axes, series: changed.map((each) => each.option()) });
    } else if (changed.length) {
      this.drawing.setOption({ series: changed.map((each) => each.option()) });
    }
    this.ids = ids;
    this.look = look;
    this.shape = shape;
    this.seen = seen;
    this.describe(chart, look);
  }

  // x of a place on the picture, in the unit of its axis; null beside the panels
  at(pixel: [number, number]): number | null {
    if (!this.drawing.containPixel({ gridIndex: 0 }, pixel)) return null;
    return this.drawing.convertFromPixel({ xAxisIndex: 0 }, pixel[0]) as unknown as number;
  }

  pixel(x: number): number {
    return this.drawing.convertToPixel({ xAxisIndex: 0 }, x) as unknown as number;
  }

  // y of a height in the first panel, in the unit of its axis; null before something was drawn
  height(pixel: number): number | null {
    const found = this.drawing.convertFromPixel({ yAxisIndex: 0 }, pixel) as unknown as number;
    return Number.isFinite(found) ? found : null;
  }

  pixelHeight(y: number): number | null {
    const found = this.drawing.convertToPixel({ yAxisIndex: 0 }, y) as unknown as number;
    return Number.isFinite(found) ? found : null;
  }

  get canvas(): HTMLElement {
    return this.field;
  }

  private describe(chart: Chart, look: Look): void {
    const curves = chart.panels.flatMap((panel) => panel.curves).filter((curve) => curve.name);
    this.legend.replaceChildren(
      ...curves.map((curve) => {
        const item = document.createElement("li");
        const sample = document.createElement("span");
        sample.className = `sample dash${curve.number % DASHES.length}`;
        sample.style.color = color(curve.number, look);
        item.append(sample, `${curve.name}: ${curve.said.trim()}`);
        return item;
      }),
    );
    this.surface.setAttribute("aria-label", `${this.title}. ${curves.map((c) => `${c.name}: ${c.said.trim()}`).join("; ")}`);
  }
}

function color(number: number, look: Look): string {
  if (number === -2) return look.alert;
  return number < 0 ? look.muted : look.curves[number % look.curves.length]!;
}

// Panels and axes of a chart.
function frame(chart: Chart, look: Look, width: number, height: number): Record<string, unknown> {
  const shares = chart.panels.reduce((sum, panel) => sum + panel.share, 0);
  const [top, bottom, between] = [8, 42, 14];
  const free = Math.max(height, 120) - top - bottom - between * (chart.panels.length - 1);
  let y = top;
  const grids = chart.panels.map((panel) => {
    const tall = (free * panel.share) / shares;
    const grid = { left: 70, top: y, height: tall, width: across(chart, panel, width - 70 - 22, tall), outerBoundsMode: "none" };
    y += tall + between;
    return grid;
  });
  const last = chart.panels.length - 1;
  return {
    animation: false,
    grid: grids,
    axisPointer: { link: [{ xAxisIndex: "all" }] },
    tooltip: { trigger: "axis", renderMode: "richText", confine: true, axisPointer: { type: "line" }, formatter: says },
    xAxis: chart.panels.map((_, i) => ({
      gridIndex: i,
      type: chart.scale === "frequency" ? "log" : "value",
      min: chart.low ?? "dataMin",
      max: chart.high ?? "dataMax",
      name: i === last ? chart.label : "",
      nameLocation: "middle",
      nameGap: 26,
      nameTextStyle: { color: look.ink },
      axisLabel: { show: i === last, color: look.ink, formatter: plain },
      axisLine: { lineStyle: { color: look.muted }, onZero: false },
      splitLine: { lineStyle: { color: look.line } },
      minorSplitLine: { show: chart.scale === "frequency", lineStyle: { color: look.line, opacity: 0.5 } },
    })),
    yAxis: chart.panels.map((panel, i) => ({
      gridIndex: i,
      type: panel.scale === "log" ? "log" : "value",
      ...range(panel),
      name: panel.label,
      nameLocation: "middle",
      nameGap: 50,
      nameTextStyle: { color: look.ink },
      splitNumber: (grids[i]?.height ?? 0) < 90 ? 3 : 5,
      axisLabel: { color: look.ink, formatter: plain, hideOverlap: true },
      axisLine: { show: true, lineStyle: { color: look.muted }, onZero: false },
      splitLine: { lineStyle: { color: look.line } },
    })),
  };
}

// Width of a panel: all there is, or with a square chart what makes both units equally long.
function across(chart: Chart, panel: Panel, room: number, tall: number): number {
  if (!chart.square || chart.low === null || chart.high === null || panel.low === null || panel.high === null) return room;
  return Math.min(room, (tall * (chart.high - chart.low)) / (panel.high - panel.low));
}

function range(panel: Panel): Record<string, unknown> {
  if (panel.scale === "degrees" && panel.low !== null && panel.high !== null) {
    const span = panel.high - panel.low;
    const step = [15, 30, 45, 90, 180, 360].find((each) => span / each <= 6) ?? 720;
    return { min: step * Math.floor(panel.low / step), max: step * Math.ceil(panel.high / step - 1e-9), interval: step };
  }
  return { min: panel.low ?? undefined, max: panel.high ?? undefined, scale: true };
}

// One series for ECharts: `content` tells whether it has changed; its points are unpacked only then.
interface Series {
  id: string;
  content: string;
  option: () => Record<string, unknown>;
}

function lines(panel: Panel, i: number, chart: Chart, numbers: Float32Array, look: Look): Series[] {
  const place = { xAxisIndex: i, yAxisIndex: i, silent: true, animation: false };
  const line = { ...place, type: "line", symbol: "none", showSymbol: false, emphasis: { disabled: true }, clip: true, tooltip: { show: false } };
  const found: Series[] = [];
  const add = (kind: string, number: number, content: string, option: Record<string, unknown>): void => {
    const id = `${i} ${kind} ${found.length}`;
    // what stays while somebody drags has a canvas of its own, which is not drawn again
    const made = (): Record<string, unknown> => {
      const { data } = option;
      return { id, zlevel: number <= 0 ? 0 : 1, ...option, data: typeof data === "function" ? (data as () => unknown)() : data };
    };
    found.push({ id, content: `${content} ${option.symbolSize ?? ""}`, option: made });
  };
  const low = chart.low ?? -1e9;
  const high = chart.high ?? 1e9;
  for (const level of panel.levels) {
    add("level", -1, JSON.stringify(level), {
      ...line,
      data: level.upright
        ? [[level.value, panel.low ?? -1e9], [level.value, panel.high ?? 1e9]]
        : [[low, level.value], [high, level.value]],
      lineStyle: { color: level.dashed || level.faint ? look.muted : look.ink, width: 1, type: level.dashed ? "dashed" : "solid" },
      endLabel: { show: level.text !== "", formatter: level.text, color: look.muted },
    });
  }
  for (const disc of panel.discs) {
    const tint = color(disc.number, look);
    const data = Array.from({ length: 97 }, (_, k) => {
      const turn = (2 * Math.PI * k) / 96;
      return [disc.x + disc.radius * Math.cos(turn), disc.y + disc.radius * Math.sin(turn)];
    });
    add("disc", disc.number, JSON.stringify(disc), {
      ...line,
      data,
      lineStyle: { color: tint, width: 1, type: disc.number < 0 ? "dashed" : dash(disc.number) },
    });
  }
  for (const curve of panel.curves) {
    const tint = color(curve.number, look);
    const data = () => points(curve, numbers);
    const content = `${sum(curve, numbers)} ${curve.name} ${curve.number}`;
    if (curve.look === "dots" || curve.look === "plus") {
      const plus = curve.look === "plus";
      const symbol = plus ? "path://M-1,0 L1,0 M0,-1 L0,1" : "circle";
      const style = plus ? { color: "none", borderColor: tint, borderWidth: 2 } : { color: tint, opacity: 0.6 };
      add("points", curve.number, content, { ...place, type: "scatter", symbol, symbolSize: plus ? 12 : 3, data, itemStyle: style });
      continue;
    }
    const width = { line: 1.6, thin: 0.7, bar: 3 }[curve.look];
    add(curve.look, curve.number, content, {
      ...line,
      data,
      name: curve.look === "line" ? curve.name || panel.label : "",
      tooltip: { show: curve.look === "line" },
      lineStyle: { color: tint, width, type: curve.look === "line" ? dash(curve.number) : "solid", opacity: curve.look === "line" ? 1 : 0.6 },
      itemStyle: { color: tint },
    });
  }
  for (const mark of panel.marks) {
    const tint = color(mark.number, look);
    add("mark", mark.number, JSON.stringify(mark), {
      ...place,
      type: "scatter",
      symbol: SYMBOLS[mark.number % SYMBOLS.length],
      symbolSize: 7,
      data: [[mark.x, mark.y]],
      itemStyle: { color: mark.hollow ? "transparent" : tint, borderColor: tint, borderWidth: 1.2 },
    });
  }
  return found;
}

function dash(number: number): string | number[] {
  return DASHES[number % DASHES.length]!;
}

function plain(value: number): string {
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-4 || size >= 1e5) ? value.toExponential(0) : String(Number(value.toPrecision(4)));
}

interface Told {
  seriesName: string;
  value: number[];
}

function says(given: unknown): string {
  const rows = (Array.isArray(given) ? given : [given]) as Told[];
  const first = rows[0];
  if (!first) return "";
  const lines = rows.filter((row) => row.seriesName).map((row) => `${row.seriesName}  ${Number(row.value[1]!.toPrecision(4))}`);
  return [String(Number(first.value[0]!.toPrecision(5))), ...lines].join("\n");
}
