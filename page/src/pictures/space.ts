// A path in space on a canvas, seen in parallel projection: turned by dragging and keys, with values as color, the
// deviation magnified, worst places, and the tool at the cursor.

import { heated, scaled_bar } from "./heat";
import { color, look } from "./look";
import { plain, ticks } from "./ticks";
import { icon } from "../icons";
import { button, copy, make } from "../parts";
import type { Heat } from "../wire";

type Row = Float32Array;
type Vector = [number, number, number];

export interface Scene {
  time: Row;
  place: [Row, Row, Row]; // mm
  axis: [Row, Row, Row]; // from the tip of the tool to its spindle
  at_feed: Row; // not a number on a traverse
  flat: boolean; // seen from above at first
  colored: { place: [Row, Row, Row]; values: Row; heat: Heat } | null;
  // the tool beside its path: vectors in µm, drawn `factor` times as long
  off: { place: [Row, Row, Row]; vector: [Row, Row, Row]; counted: Row; factor: number } | null;
  marks: { time: number; text: string; key: string }[];
  tool: { radius: number; length: number };
}

const VIEWS: Record<string, [yaw: number, pitch: number]> = { Top: [0, 90], Front: [0, 0], Side: [90, 0], Space: [-35, 32] };
const [STEP, NEAR, MOVED] = [5, 26, 4]; // degrees of a key; pixels in which the path is pointed at, and of a click
const EDGE = 28; // pixels around the path: for labels, axes and scale
const LARGE = "large";

export class Space {
  readonly element = document.createElement("figure");
  oncursor: ((time: number) => void) | null = null;
  onpick: ((key: string) => void) | null = null;
  private readonly field = make("div", { class: "field" });
  private readonly canvas = make("canvas", { class: "surface", role: "img", tabindex: "0" });
  private readonly legend = make("ul", { class: "legend" });
  private readonly views = make("span", { class: "views", role: "group", "aria-label": "View" });
  private readonly note = make("span", { class: "quantities" });
  private readonly spoken = make("p", { class: "spoken", role: "status" });
  private scene: Scene | null = null;
  private key = ""; // of what is shown: another one is seen from its usual side
  private time = 0;
  private yaw = 0;
  private pitch = 90;
  private zoom = 1;
  private shift: [number, number] = [0, 0]; // of the middle, in pixels
  private center: Vector = [0, 0, 0];
  private scale = 1; // pixels of a mm
  private seen: [Float64Array, Float64Array] = [new Float64Array(), new Float64Array()];
  private asked = false;

  constructor(readonly title: string) {
    const data = button("", () => void copy(this.csv(), data), { class: "tool", title: "Copy the data as CSV" });
    data.setAttribute("aria-label", `Copy the data of ${title}`);
    data.append(icon("copy"));
    const large = button("", () => this.enlarge(), { class: "tool", title: "Make large (Enter), or small again" });
    large.setAttribute("aria-label", `Make ${title} large`);
    large.append(icon("large"));
    for (const name of Object.keys(VIEWS)) this.views.append(button(name, () => this.look_from(name), { class: "view" }));
    this.canvas.title =
      "Drag to turn, with Shift to move, wheel to zoom, double click for the first view. Keys: arrows turn (Shift: move), + and - zoom, 0 shows the first view, Enter makes it large.";
    this.field.append(this.canvas);
    const heading = document.createElement("b");
    heading.textContent = title;
    this.element.append(
      make("figcaption", {}, heading, this.note, this.views, make("span", { class: "tools" }, data, large)),
      this.legend,
      this.field,
      this.spoken,
    );
    new ResizeObserver(() => this.redraw()).observe(this.field);
    this.listen();
  }

  // `key` names the program: with another one the view begins anew.
  draw(scene: Scene, key: string, said: string): void {
    this.scene = scene;
    if (key !== this.key) {
      this.key = key;
      this.first();
    }
    this.note.textContent = said;
    const heat = scene.colored?.heat;
    this.legend.replaceChildren(...(heat ? [scaled_bar(heat, look())] : []));
    this.canvas.setAttribute("aria-label", `${this.title}. ${said}${heat ? `; ${heat.label} as color` : ""}`);
    this.redraw();
  }

  // The tool at an instant.
  cursor(time: number): void {
    this.time = time;
    this.redraw();
  }

  private first(): void {
    [this.zoom, this.shift] = [1, [0, 0]];
    this.look_from(this.scene?.flat ? "Top" : "Space");
  }

  private look_from(name: string): void {
    [this.yaw, this.pitch] = VIEWS[name]!;
    this.redraw();
  }

  private enlarge(): void {
    const now = this.element.classList.toggle(LARGE);
    this.element.parentElement?.classList.toggle("one", now);
  }

  private csv(): string {
    const { scene } = this;
    if (!scene) return "";
    const rows = ["t (s),x (mm),y (mm),z (mm),i,j,k"];
    for (let n = 0; n < scene.time.length; n++)
      rows.push([scene.time, ...scene.place, ...scene.axis].map((row) => Number(row[n]!.toPrecision(7))).join(","));
    return `${rows.join("\n")}\n`;
  }

  private listen(): void {
    const { canvas } = this;
    let from: { x: number; y: number; moved: boolean } | null = null;
    canvas.addEventListener("pointerdown", (event) => {
      from = { x: event.clientX, y: event.clientY, moved: false };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return this.point(event);
      const [dx, dy] = [event.clientX - from.x, event.clientY - from.y];
      if (!from.moved && Math.hypot(dx, dy) < MOVED) return;
      from = { x: event.clientX, y: event.clientY, moved: true };
      if (event.shiftKey) this.move(dx, dy);
      else this.turn(-0.4 * dx, 0.4 * dy);
    });
    canvas.addEventListener("pointerup", (event) => {
      if (from && !from.moved) this.pick(event);
      from = null;
    });
    canvas.addEventListener("pointercancel", () => (from = null));
    canvas.addEventListener("dblclick", () => this.first());
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const { left, top, width, height } = canvas.getBoundingClientRect();
        this.magnify(Math.exp(-0.0015 * event.deltaY), event.clientX - left - width / 2, event.clientY - top - height / 2);
      },
      { passive: false },
    );
    canvas.addEventListener("keydown", (event) => this.pressed(event));
  }

  private pressed(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const way: [number, number] | undefined = {
      ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1],
    }[event.key] as [number, number] | undefined; // prettier-ignore
    if (way && event.shiftKey) this.move(20 * way[0], 20 * way[1]);
    else if (way) this.turn(-STEP * way[0], STEP * way[1]);
    else if (event.key === "+") this.magnify(1.25, 0, 0);
    else if (event.key === "-") this.magnify(0.8, 0, 0);
    else if (event.key === "0") this.first();
    else if (event.key === "Enter" || (event.key === "Escape" && this.element.classList.contains(LARGE))) this.enlarge();
    else return;
    event.preventDefault();
    this.spoken.textContent = `seen from ${Math.round(this.yaw)}° around, ${Math.round(this.pitch)}° above`;
  }

  private turn(around: number, up: number): void {
    this.yaw = ((((this.yaw + around + 180) % 360) + 360) % 360) - 180;
    this.pitch = Math.max(-90, Math.min(90, this.pitch + up));
    this.redraw();
  }

  private move(across: number, down: number): void {
    this.shift = [this.shift[0] + across, this.shift[1] + down];
    this.redraw();
  }

  // Zoom about a place, as pixels from the middle of the picture.
  private magnify(by: number, x: number, y: number): void {
    const zoom = Math.max(0.2, Math.min(400, this.zoom * by));
    const share = zoom / this.zoom;
    this.shift = [x - share * (x - this.shift[0]), y - share * (y - this.shift[1])];
    this.zoom = zoom;
    this.redraw();
  }

  // The instant of the path nearest to the pointer; of passes that are equally near, the one nearest in time.
  private nearest(event: PointerEvent): number | null {
    const { left, top } = this.canvas.getBoundingClientRect();
    const [px, py] = [event.clientX - left, event.clientY - top];
    const [u, v] = this.seen;
    let [found, least] = [-1, NEAR];
    for (let n = 0; n < u.length; n++) {
      const away = Math.hypot(u[n]! - px, v[n]! - py);
      if (away < least) [found, least] = [n, away];
    }
    return found < 0 ? null : this.scene!.time[found]!;
  }

  private point(event: PointerEvent): void {
    const time = this.nearest(event);
    if (time !== null) this.oncursor?.(time);
  }

  private pick(event: PointerEvent): void {
    const time = this.nearest(event);
    if (time === null) return;
    this.oncursor?.(time);
    const { left, top } = this.canvas.getBoundingClientRect();
    const mark = this.scene!.marks.find((each) => {
      const [u, v] = this.project(this.placed(each.time));
      return Math.hypot(u - event.clientX + left, v - event.clientY + top) < 12;
    });
    if (mark) this.onpick?.(mark.key);
  }

  // Once a frame, however often the cursor moves.
  private redraw(): void {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.paint();
    });
  }

  // Directions to the right and up in the picture, and towards the eye.
  private get frame(): [Vector, Vector, Vector] {
    const [yaw, pitch] = [(this.yaw * Math.PI) / 180, (this.pitch * Math.PI) / 180];
    const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
    return [
      [cy, sy, 0],
      [-sy * sp, cy * sp, cp],
      [sy * cp, -cy * cp, sp],
    ];
  }

  private project(point: Vector): [number, number] {
    const [right, up] = this.frame;
    const from: Vector = [point[0] - this.center[0], point[1] - this.center[1], point[2] - this.center[2]];
    const [width, height] = [this.field.clientWidth, this.field.clientHeight];
    return [width / 2 + this.shift[0] + this.scale * dot(from, right), height / 2 + this.shift[1] - this.scale * dot(from, up)];
  }

  private projected(place: [Row, Row, Row]): [Float64Array, Float64Array] {
    const n = place[0].length;
    const [u, v] = [new Float64Array(n), new Float64Array(n)];
    for (let k = 0; k < n; k++) [u[k], v[k]] = this.project([place[0][k]!, place[1][k]!, place[2][k]!]);
    return [u, v];
  }

  private placed(time: number): Vector {
    return this.between(this.scene!.place, time);
  }

  // Rows over time at an instant.
  private between(rows: [Row, Row, Row], time: number): Vector {
    const [k, share] = instant(this.scene!.time, time);
    const last = Math.min(k + 1, rows[0].length - 1);
    return rows.map((row) => row[k]! + share * (row[last]! - row[k]!)) as Vector;
  }

  // Middle and scale, so that what moves at a feed fills the picture whatever it is seen from.
  private fit(scene: Scene): void {
    const [right, up, eye] = this.frame;
    const [low, high]: [Vector, Vector] = [
      [Infinity, Infinity, Infinity],
      [-Infinity, -Infinity, -Infinity],
    ];
    let [left, wide, below, above] = [Infinity, -Infinity, Infinity, -Infinity];
    const every = scene.at_feed.every((each) => Number.isNaN(each));
    const room = scene.flat ? 0 : scene.tool.length; // the tool stands above the path
    for (let k = 0; k < scene.time.length; k++) {
      if (!every && Number.isNaN(scene.at_feed[k]!)) continue;
      const at: Vector = [scene.place[0][k]!, scene.place[1][k]!, scene.place[2][k]!];
      for (const i of [0, 1, 2] as const) [low[i], high[i]] = [Math.min(low[i], at[i]), Math.max(high[i], at[i])];
      const [u, v] = [dot(at, right), dot(at, up)];
      [left, wide] = [Math.min(left, u), Math.max(wide, u)];
      [below, above] = [Math.min(below, v), Math.max(above, v + room * up[2])];
    }
    this.box = [low, high];
    const [u, v, w] = [(left + wide) / 2, (below + above) / 2, dot([0, 0, low[2]], eye)];
    this.center = sum(sum(sum([0, 0, 0], right, u), up, v), eye, w);
    const [width, height] = [this.field.clientWidth - 2 * EDGE, this.field.clientHeight - 2 * EDGE];
    this.scale = this.zoom * Math.min(width / Math.max(wide - left, 1e-6), height / Math.max(above - below, 1e-6));
  }
  private box: [Vector, Vector] = [
    [0, 0, 0],
    [0, 0, 0],
  ];

  private paint(): void {
    const { scene, canvas } = this;
    const [width, height] = [this.field.clientWidth, this.field.clientHeight];
    if (!scene || width < 60 || height < 60) return;
    const [ratio, shown] = [devicePixelRatio || 1, look()];
    [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    const ctx = canvas.getContext("2d")!;
    ctx.scale(ratio, ratio);
    ctx.lineJoin = ctx.lineCap = "round";
    ctx.font = "11px system-ui, sans-serif";
    this.fit(scene);
    this.floor(ctx);
    this.seen = this.projected(scene.place);
    const [u, v] = this.seen;
    const path = (traverse: boolean) => {
      ctx.beginPath();
      for (let k = 0; k + 1 < u.length; k++) {
        if (Number.isNaN(scene.at_feed[k]!) !== traverse) continue;
        ctx.moveTo(u[k]!, v[k]!);
        ctx.lineTo(u[k + 1]!, v[k + 1]!);
      }
      ctx.stroke();
    };
    ctx.strokeStyle = shown.muted;
    ctx.lineWidth = 0.8;
    ctx.setLineDash([4, 3]);
    path(true);
    ctx.setLineDash([]);
    if (!scene.colored) [ctx.strokeStyle, ctx.lineWidth] = [color(101, shown), 2];
    path(false);
    if (scene.off) {
      const { place, vector, factor, counted } = scene.off; // where it is not a number the line is interrupted
      const beside = place.map((row, i) => row.map((each, k) => each + 1e-3 * factor * vector[i]![k]! + 0 * counted[k]!)) as [
        Row,
        Row,
        Row,
      ];
      const [a, b] = this.projected(beside);
      ctx.strokeStyle = color(101, shown);
      ctx.lineWidth = 1;
      stroke(ctx, a, b);
    }
    if (scene.colored) {
      const [a, b] = this.projected(scene.colored.place);
      heated(ctx, a, b, scene.colored.values, scene.colored.heat, shown, 1);
    }
    this.marks(ctx, scene);
    this.tool(ctx, scene);
    this.axes(ctx, width, height);
  }

  // A grid under the path.
  private floor(ctx: CanvasRenderingContext2D): void {
    const [low, high] = this.box;
    const span = Math.max(high[0] - low[0], high[1] - low[1], 1e-6);
    const step = ticks({ low: 0, high: span }, false, false, 6).at;
    const each = step.length > 1 ? step[1]! - step[0]! : span;
    const ends = [0, 1].map((i) => [Math.floor(low[i]! / each) * each, Math.ceil(high[i]! / each) * each] as const);
    const [[left, right], [near, far]] = ends as [readonly [number, number], readonly [number, number]];
    ctx.strokeStyle = look().line;
    ctx.lineWidth = 1;
    ctx.beginPath();
    const line = (a: Vector, b: Vector) => (ctx.moveTo(...this.project(a)), ctx.lineTo(...this.project(b)));
    for (let x = left; x <= right + 1e-9; x += each) line([x, near, low[2]], [x, far, low[2]]);
    for (let y = near; y <= far + 1e-9; y += each) line([left, y, low[2]], [right, y, low[2]]);
    ctx.stroke();
  }

  private marks(ctx: CanvasRenderingContext2D, scene: Scene): void {
    const shown = look();
    const named: [number, number][] = []; // where a name stands already
    for (const mark of scene.marks) {
      const [u, v] = this.project(this.placed(mark.time));
      ctx.beginPath();
      for (const [dx, dy] of [[0, -6], [6, 0], [0, 6], [-6, 0]]) ctx.lineTo(u + dx!, v + dy!); // prettier-ignore
      ctx.closePath();
      ctx.fillStyle = shown.paper;
      ctx.strokeStyle = shown.alert;
      ctx.lineWidth = 1.4;
      ctx.fill();
      ctx.stroke();
      if (named.some(([x, y]) => Math.abs(x - u) < 34 && Math.abs(y - v) < 24)) continue;
      named.push([u, v]);
      ctx.fillStyle = shown.ink;
      ctx.textAlign = "center";
      ctx.textBaseline = "middle";
      ctx.fillText(mark.text, u, v - 13);
    }
  }

  // A cylinder along the tool, with its tip on the path.
  private tool(ctx: CanvasRenderingContext2D, scene: Scene): void {
    const shown = look();
    const [tip, way] = [this.placed(this.time), unit(this.between(scene.axis, this.time))];
    const [right, , eye] = this.frame;
    const { radius, length } = scene.tool;
    const end = sum(tip, way, length);
    let side = cross(way, eye);
    const size = Math.hypot(...side);
    side = size > 1e-3 ? (side.map((each) => each / size) as Vector) : right;
    const other = cross(way, side);
    const disc = (at: Vector) => {
      ctx.beginPath();
      for (let k = 0; k <= 32; k++) {
        const [c, s] = [Math.cos((k * Math.PI) / 16), Math.sin((k * Math.PI) / 16)];
        ctx.lineTo(...this.project(sum(sum(at, side, radius * c), other, radius * s)));
      }
    };
    ctx.strokeStyle = shown.ink;
    ctx.lineWidth = 1.2;
    ctx.fillStyle = shown.paper;
    const fill = (alpha: number) => {
      ctx.globalAlpha = alpha;
      ctx.fill();
      ctx.globalAlpha = 1;
      ctx.stroke();
    };
    const up = dot(way, eye) > 0; // the end is nearer to the eye than the tip
    disc(up ? tip : end);
    fill(0.7);
    ctx.beginPath();
    for (const [at, by] of [[tip, radius], [end, radius], [end, -radius], [tip, -radius]] as const) ctx.lineTo(...this.project(sum(at, side, by))); // prettier-ignore
    ctx.closePath();
    fill(0.7);
    disc(up ? end : tip);
    fill(0.85);
    const [u, v] = this.project(tip);
    ctx.beginPath();
    ctx.arc(u, v, 3.5, 0, 2 * Math.PI);
    ctx.fillStyle = color(101, shown);
    ctx.fill();
  }

  // The directions of X, Y and Z, and a length.
  private axes(ctx: CanvasRenderingContext2D, width: number, height: number): void {
    const shown = look();
    const [right, up] = this.frame;
    const [ox, oy] = [34, height - 30];
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    ctx.lineWidth = 1.4;
    for (const [i, name] of ["X", "Y", "Z"].entries()) {
      const [dx, dy] = [right[i]!, -up[i]!];
      if (Math.hypot(dx, dy) < 0.15) continue;
      ctx.strokeStyle = ctx.fillStyle = shown.muted;
      ctx.beginPath();
      ctx.moveTo(ox, oy);
      ctx.lineTo(ox + 20 * dx, oy + 20 * dy);
      ctx.stroke();
      ctx.fillText(name, ox + 27 * dx, oy + 27 * dy);
    }
    const room = 110 / this.scale;
    const length =
      [1, 2, 5]
        .map((each) => each * 10 ** Math.floor(Math.log10(room)))
        .filter((each) => each <= room)
        .at(-1) ?? room;
    const [to, y] = [width - 14, height - 12];
    ctx.strokeStyle = ctx.fillStyle = shown.muted;
    ctx.beginPath();
    ctx.moveTo(to - this.scale * length, y - 4);
    ctx.lineTo(to - this.scale * length, y);
    ctx.lineTo(to, y);
    ctx.lineTo(to, y - 4);
    ctx.stroke();
    ctx.textAlign = "right";
    ctx.fillText(length >= 1e-2 ? `${plain(length)} mm` : `${plain(1e3 * length)} µm`, to, y - 10);
  }
}

// Place in rows of increasing time: index, and share of the way to the next one.
export function instant(time: Row, at: number): [number, number] {
  let [low, high] = [0, time.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (time[middle]! <= at) low = middle;
    else high = middle;
  }
  const wide = time[high]! - time[low]!;
  return [low, wide > 0 ? Math.max(0, Math.min(1, (at - time[low]!) / wide)) : 0];
}

function stroke(ctx: CanvasRenderingContext2D, u: Float64Array, v: Float64Array): void {
  let pen = false;
  ctx.beginPath();
  for (let k = 0; k < u.length; k++) {
    if (Number.isNaN(u[k]! + v[k]!)) pen = false;
    else if (pen) ctx.lineTo(u[k]!, v[k]!);
    else [pen] = [true, ctx.moveTo(u[k]!, v[k]!)];
  }
  ctx.stroke();
}

function dot(a: Vector, b: Vector): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function cross(a: Vector, b: Vector): Vector {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function sum(a: Vector, b: Vector, by: number): Vector {
  return [a[0] + by * b[0], a[1] + by * b[1], a[2] + by * b[2]];
}

function unit(a: Vector): Vector {
  const size = Math.hypot(...a) || 1;
  return [a[0] / size, a[1] / size, a[2] / size];
}
