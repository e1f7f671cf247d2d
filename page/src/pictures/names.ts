// Names beside marks, each where it covers neither a mark nor another name. One that has no such spot is left out: a mark
// that is pointed at says its name.

import { pixel, type Axis } from "./axis";
import { color, type Look } from "./look";
import type { Mark } from "../wire";

const [STEP, TALL, AROUND] = [11, 13, 6]; // CSS pixels: of a spot, of a line, half of a mark
const AWAY: [number, number][] = [[1, 0], [-1, 0], [0.7, -0.8], [-0.7, -0.8], [0.7, 0.8], [-0.7, 0.8], [0, -1], [0, 1]]; // prettier-ignore
const SPOTS = [1, 1.9, 2.9, 4, 5.5, 7, 9].flatMap((reach) => AWAY.map(([dx, dy]): [number, number] => [reach * dx, reach * dy]));
const NEAR = 16; // CSS pixels in which a mark is pointed at

interface Box {
  left: number;
  top: number;
  right: number;
  bottom: number;
}

export function names(ctx: CanvasRenderingContext2D, marks: Mark[], x: Axis, y: Axis, look: Look, ratio: number): void {
  const at: { px: number; py: number; text: string; tint: string }[] = [];
  for (const mark of marks) {
    const [px, py] = [pixel(x, mark.x), pixel(y, mark.y)];
    if (!mark.name || px < x.from || px > x.to || py < y.to || py > y.from) continue;
    const same = at.find((each) => Math.hypot(each.px - px, each.py - py) < 2 * ratio);
    if (same)
      same.text += `, ${mark.name}`; // marks at one place share a text
    else at.push({ px, py, text: mark.name, tint: color(mark.number, look) });
  }
  const half = AROUND * ratio;
  const taken: Box[] = at.map(({ px, py }) => ({ left: px - half, top: py - half, right: px + half, bottom: py + half }));
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ctx.lineWidth = ratio;
  ctx.setLineDash([]);
  for (const { px, py, text, tint } of at) {
    const wide = ctx.measureText(text).width + 4 * ratio;
    const box = free(px, py, wide, taken, x, y, ratio);
    if (!box) continue;
    taken.push(box);
    ctx.fillStyle = ctx.strokeStyle = tint;
    ctx.fillText(text, (box.left + box.right) / 2, (box.top + box.bottom) / 2);
    const [ex, ey] = [Math.min(Math.max(px, box.left), box.right), Math.min(Math.max(py, box.top), box.bottom)];
    if (Math.hypot(ex - px, ey - py) <= 0.9 * STEP * ratio) continue;
    ctx.beginPath();
    ctx.moveTo(px, py);
    ctx.lineTo(ex, ey);
    ctx.stroke();
  }
  ctx.textBaseline = "alphabetic";
}

// The nearest spot inside the axes that covers nothing that is taken; null if there is none.
function free(px: number, py: number, wide: number, taken: Box[], x: Axis, y: Axis, ratio: number): Box | null {
  for (const [dx, dy] of SPOTS) {
    const left = px + STEP * ratio * dx - wide * (dx > 0 ? 0 : dx < 0 ? 1 : 0.5);
    const top = py + STEP * ratio * dy - 0.5 * TALL * ratio;
    const box = { left, top, right: left + wide, bottom: top + TALL * ratio };
    const inside = box.left >= x.from && box.right <= x.to && box.top >= y.to && box.bottom <= y.from;
    if (inside && taken.every((each) => shared(box, each) === 0)) return box;
  }
  return null;
}

function shared(a: Box, b: Box): number {
  return (
    Math.max(Math.min(a.right, b.right) - Math.max(a.left, b.left), 0) *
    Math.max(Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top), 0)
  );
}

// The mark that is pointed at, of those that say something; null if none is near.
export function pointed(marks: Mark[], x: Axis, y: Axis, px: number, py: number, ratio: number): Mark | null {
  let [found, least]: [Mark | null, number] = [null, NEAR * ratio];
  for (const mark of marks) {
    const away = Math.hypot(pixel(x, mark.x) - px, pixel(y, mark.y) - py);
    if (away < least && (mark.said || mark.key)) [found, least] = [mark, away];
  }
  return found;
}
