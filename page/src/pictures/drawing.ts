// Curves, marks and limits of one panel on a canvas, within its axes.

import { pixel, pixels, type Axis } from "./axis";
import { heated, spread } from "./heat";
import { color, NAMED, type Look } from "./look";
import { names } from "./names";
import type { Band, Curve, Disc, Mark, Panel } from "../wire";

// the dashes and markers of the reports (plot/style.py); widths and sizes in CSS pixels
export const DASHES: number[][] = [[], [7, 2], [2, 1.5], [7, 2, 2, 2], [12, 3], [4, 1.5, 1, 1.5]];
// of today, now, A, B, C, found and its worst plant
const NAMED_DASHES: number[][] = [[6, 3], [], [1.5, 3], [8, 3, 1.5, 3], [12, 3], [], [6, 3]];
const NAMED_WIDTHS = [1.6, 2.2, 1.6, 1.5, 1.5, 2.2, 1.6];
const WIDTHS = { line: 1.6, thin: 0.9, bar: 2 };
const [MARK, MARK_WITH_NAME] = [3.5, 5];
const SINGLE = { dots: 1.5, plus: 6, cross: 4.5, ring: 4 };
const SHAPES: ((path: Path2D, x: number, y: number, r: number) => void)[] = [
  (path, x, y, r) => path.arc(x, y, r, 0, 2 * Math.PI),
  (path, x, y, r) => path.rect(x - r, y - r, 2 * r, 2 * r),
  (path, x, y, r) => polygon(path, x, y, r * 1.2, 3),
  (path, x, y, r) => polygon(path, x, y, r * 1.2, 4),
  (path, x, y, r) => polygon(path, x, y, r * 1.1, 5),
  (path, x, y, r) => polygon(path, x, y, r * 1.1, 6),
];

// The content of a panel; `ratio` is the number of pixels of the canvas for one of CSS.
export function paint(
  ctx: CanvasRenderingContext2D,
  panel: Panel,
  numbers: Float32Array,
  x: Axis,
  y: Axis,
  look: Look,
  ratio: number,
): void {
  ctx.save();
  ctx.beginPath();
  ctx.rect(x.from, y.to, x.to - x.from, y.from - y.to);
  ctx.clip();
  ctx.lineJoin = "round";
  ctx.font = `${11 * ratio}px system-ui, sans-serif`;
  for (const each of panel.bands) band(ctx, each, numbers, x, y, look);
  for (const level of panel.levels) {
    const at = pixel(level.upright ? x : y, level.value);
    const limit = level.number === -2;
    ctx.strokeStyle = limit ? look.alert : level.dashed || level.faint || level.text ? look.muted : look.ink;
    ctx.lineWidth = (limit ? 1.4 : 1) * ratio;
    ctx.setLineDash(level.dashed ? [5 * ratio, 3 * ratio] : []);
    ctx.beginPath();
    ctx.moveTo(level.upright ? at : x.from, level.upright ? y.from : at);
    ctx.lineTo(level.upright ? at : x.to, level.upright ? y.to : at);
    ctx.stroke();
    if (!level.text) continue;
    ctx.textAlign = "left";
    if (level.upright) {
      said(ctx, level.text, at + 4 * ratio, y.to + 12 * ratio, look.muted, look, ratio);
      continue;
    }
    // above the line at the left, or where there is no room below it at the right
    const below = at - y.to < 16 * ratio;
    if (below) ctx.textAlign = "right";
    const place = [below ? x.to - 6 * ratio : x.from + 8 * ratio, at + (below ? 14 : -5) * ratio] as const;
    said(ctx, level.text, ...place, limit ? look.alert : look.muted, look, ratio);
  }
  for (const each of panel.discs) disc(ctx, each, x, y, look, ratio);
  for (const each of panel.curves) curve(ctx, each, panel, numbers, x, y, look, ratio);
  for (const each of panel.marks) mark(ctx, each, x, y, look, ratio);
  ctx.setLineDash([]);
  for (const note of panel.notes) {
    ctx.fillStyle = color(note.number, look);
    ctx.textAlign = note.middle ? "center" : note.right ? "left" : "right";
    const lines = note.text.split("\n");
    const [off, down] = note.middle ? [0, 4 - 7 * (lines.length - 1)] : note.right ? [5, -5] : [-5, 13];
    lines.forEach((line, i) => ctx.fillText(line, pixel(x, note.x) + off * ratio, pixel(y, note.y) + (down + 14 * i) * ratio));
  }
  names(ctx, panel.marks, x, y, look, ratio);
  ctx.restore();
  if (!panel.said) return; // above the panel
  ctx.font = `${11 * ratio}px system-ui, sans-serif`;
  ctx.textAlign = "right";
  ctx.fillStyle = look.muted;
  ctx.fillText(panel.said, x.to, y.to - 5 * ratio);
}

// Words on a ground of their own, so that they can be read over curves.
function said(ctx: CanvasRenderingContext2D, text: string, x: number, y: number, ink: string, look: Look, ratio: number): void {
  const width = ctx.measureText(text).width;
  const left = ctx.textAlign === "right" ? x - width : ctx.textAlign === "center" ? x - width / 2 : x;
  ctx.globalAlpha = 0.85;
  ctx.fillStyle = look.paper;
  ctx.fillRect(left - 3 * ratio, y - 11 * ratio, width + 6 * ratio, 15 * ratio);
  ctx.globalAlpha = 1;
  ctx.fillStyle = ink;
  ctx.fillText(text, x, y);
}

function disc(ctx: CanvasRenderingContext2D, disc: Disc, x: Axis, y: Axis, look: Look, ratio: number): void {
  const [cx, cy] = [pixel(x, disc.x), pixel(y, disc.y)];
  ctx.beginPath();
  ctx.ellipse(
    cx,
    cy,
    Math.abs(pixel(x, disc.x + disc.radius) - cx),
    Math.abs(pixel(y, disc.y + disc.radius) - cy),
    0,
    0,
    2 * Math.PI,
  );
  const tint = disc.faint ? look.line : color(disc.number, look);
  if (disc.filled) {
    ctx.globalAlpha = disc.number === -2 ? 0.07 : disc.number >= NAMED ? 0 : 0.18;
    ctx.fillStyle = tint;
    ctx.fill();
    ctx.globalAlpha = 1;
  }
  ctx.strokeStyle = tint;
  ctx.lineWidth = ratio;
  ctx.setLineDash(disc.faint || disc.number === -2 ? [] : disc.number < 0 ? [5 * ratio, 3 * ratio] : scaled(disc.number, ratio));
  ctx.stroke();
}

function curve(
  ctx: CanvasRenderingContext2D,
  curve: Curve,
  panel: Panel,
  numbers: Float32Array,
  x: Axis,
  y: Axis,
  look: Look,
  ratio: number,
): void {
  const across = pixels(x, numbers.subarray(curve.at, curve.at + curve.n));
  const up = pixels(y, numbers.subarray(curve.at + curve.n, curve.at + 2 * curve.n));
  const tint = color(curve.number, look);
  const third = numbers.subarray(curve.at + 2 * curve.n, curve.at + 3 * curve.n);
  if (curve.heat) return panel.heat ? heated(ctx, across, up, third, panel.heat, look, ratio) : undefined;
  if (curve.reach) return spread(ctx, across, up, third, (x.to - x.from) / (x.high - x.low), tint, look);
  ctx.strokeStyle = tint;
  ctx.fillStyle = tint;
  const kind = curve.look;
  ctx.globalAlpha = kind === "thin" || kind === "bar" || kind === "dots" ? 0.6 : 1;
  if (kind === "dots" || kind === "plus" || kind === "cross" || kind === "ring") {
    const path = new Path2D();
    const r = SINGLE[kind] * ratio;
    for (let i = 0; i < curve.n; i++) {
      const [px, py] = [across[i]!, up[i]!];
      if (Number.isNaN(px + py)) continue;
      if (kind === "dots") path.rect(px - r, py - r, 2 * r, 2 * r);
      else if (kind === "ring") {
        path.moveTo(px + r, py);
        path.arc(px, py, r, 0, 2 * Math.PI);
      } else {
        const slant = kind === "cross" ? r : 0;
        path.moveTo(px - r, py - slant);
        path.lineTo(px + r, py + slant);
        path.moveTo(px - slant, py + r);
        path.lineTo(px + slant, py - r);
      }
    }
    ctx.lineWidth = (kind === "ring" ? 1.4 : 2) * ratio;
    ctx.setLineDash([]);
    if (kind === "dots") ctx.fill(path);
    else ctx.stroke(path);
  } else if (kind === "solid") {
    ctx.beginPath();
    for (let i = 0; i < curve.n; i++) ctx.lineTo(across[i]!, up[i]!);
    ctx.fill();
  } else {
    ctx.lineWidth = (kind === "line" ? width(curve.number) : WIDTHS[kind]) * ratio;
    ctx.setLineDash(kind === "line" ? scaled(curve.number, ratio) : []);
    ctx.beginPath();
    let pen = false; // what is not finite interrupts the line
    for (let i = 0; i < curve.n; i++) {
      const [px, py] = [across[i]!, up[i]!];
      if (Number.isNaN(px + py)) pen = false;
      else if (pen) ctx.lineTo(px, py);
      else {
        ctx.moveTo(px, py);
        pen = true;
      }
    }
    ctx.stroke();
  }
  ctx.globalAlpha = 1;
}

// What is not finite interrupts it; each piece is one shape, along its upper end and back along the lower one.
function band(ctx: CanvasRenderingContext2D, band: Band, numbers: Float32Array, x: Axis, y: Axis, look: Look): void {
  const row = (k: number) => numbers.subarray(band.at + k * band.n, band.at + (k + 1) * band.n);
  const [across, low, high] = [pixels(x, row(0)), pixels(y, row(1)), pixels(y, row(2))];
  ctx.fillStyle = color(band.number, look);
  ctx.globalAlpha = band.number === -2 ? 0.08 : 0.18; // the side of a limit that is forbidden lies under curves
  ctx.beginPath();
  let first = 0;
  for (let i = 0; i <= band.n; i++) {
    if (i < band.n && !Number.isNaN(across[i]! + low[i]! + high[i]!)) continue;
    for (let k = first; k < i; k++) k === first ? ctx.moveTo(across[k]!, high[k]!) : ctx.lineTo(across[k]!, high[k]!);
    for (let k = i - 1; k >= first; k--) ctx.lineTo(across[k]!, low[k]!);
    if (i > first) ctx.closePath();
    first = i + 1;
  }
  ctx.fill();
  ctx.globalAlpha = 1;
}

function mark(ctx: CanvasRenderingContext2D, mark: Mark, x: Axis, y: Axis, look: Look, ratio: number): void {
  const path = new Path2D();
  const shape = mark.number === -2 ? 3 : mark.number >= NAMED ? 0 : mark.number;
  SHAPES[(shape + SHAPES.length) % SHAPES.length]!(
    path,
    pixel(x, mark.x),
    pixel(y, mark.y),
    (mark.name ? MARK_WITH_NAME : MARK) * ratio,
  );
  ctx.setLineDash([]);
  ctx.lineWidth = 1.4 * ratio;
  ctx.fillStyle = mark.hollow ? look.paper : color(mark.number, look);
  ctx.strokeStyle = color(mark.number, look);
  ctx.fill(path);
  ctx.stroke(path);
}

// The dashes of a curve by its number, in CSS pixels.
export function dashes(number: number): number[] {
  if (number >= NAMED) return NAMED_DASHES[(number - NAMED) % NAMED_DASHES.length]!;
  return DASHES[number < 0 ? 0 : number % DASHES.length]!;
}

function scaled(number: number, ratio: number): number[] {
  return dashes(number).map((each) => each * ratio);
}

function width(number: number): number {
  return number >= NAMED ? NAMED_WIDTHS[(number - NAMED) % NAMED_WIDTHS.length]! : WIDTHS.line;
}

function polygon(path: Path2D, x: number, y: number, r: number, corners: number): void {
  for (let i = 0; i < corners; i++) {
    const turn = (2 * Math.PI * i) / corners - Math.PI / 2;
    path.lineTo(x + r * Math.cos(turn), y + r * Math.sin(turn));
  }
  path.closePath();
}
