// What the points of a curve have beside their places: values as color and width, or radii of discs as one pale area.

import type { Look } from "./look";
import { make } from "../parts";
import type { Heat } from "../wire";

const STEPS = 12;
const [COLD, HOT] = [1.3, 3.2]; // width of the smallest and the largest value, CSS pixels
const PALE = 0.22;

// The colors of the steps, between those of the look.
function steps(look: Look): string[] {
  const known = look.heat.map(parts);
  return Array.from({ length: STEPS }, (_, k) => {
    const at = (k * (known.length - 1)) / (STEPS - 1);
    const first = Math.min(Math.floor(at), known.length - 2);
    return mixed(known[first]!, known[first + 1]!, at - first);
  });
}

function parts(tint: string): number[] {
  return [1, 3, 5].map((k) => Number.parseInt(tint.slice(k, k + 2), 16));
}

function mixed(one: number[], other: number[], share: number): string {
  return `rgb(${one.map((each, i) => Math.round(each + share * (other[i]! - each))).join(" ")})`;
}

// A line in steps of color and width; the largest values are drawn last. What is not finite interrupts it.
export function heated(
  ctx: CanvasRenderingContext2D,
  x: Float64Array,
  y: Float64Array,
  values: Float32Array,
  scale: Heat,
  look: Look,
  ratio: number,
): void {
  const colors = steps(look);
  const paths = colors.map(() => new Path2D());
  let last = -1;
  for (let i = 0; i + 1 < values.length; i++) {
    const larger = Math.max(values[i]!, values[i + 1]!);
    if (Number.isNaN(larger) || Number.isNaN(x[i]! + y[i]! + x[i + 1]! + y[i + 1]!)) {
      last = -1;
      continue;
    }
    const step = Math.min(STEPS - 1, Math.max(0, Math.floor((STEPS * (larger - scale.low)) / (scale.high - scale.low))));
    if (step !== last) paths[step]!.moveTo(x[i]!, y[i]!);
    paths[step]!.lineTo(x[i + 1]!, y[i + 1]!);
    last = step;
  }
  ctx.setLineDash([]);
  ctx.lineCap = "round";
  paths.forEach((path, k) => {
    ctx.strokeStyle = colors[k]!;
    ctx.lineWidth = (COLD + ((HOT - COLD) * k) / (STEPS - 1)) * ratio;
    ctx.stroke(path);
  });
  ctx.lineCap = "butt";
}

// Discs as one area of one color: where they overlap nothing is more likely. `across` is the length of a unit of x in pixels.
export function spread(
  ctx: CanvasRenderingContext2D,
  x: Float64Array,
  y: Float64Array,
  radii: Float32Array,
  across: number,
  tint: string,
  look: Look,
): void {
  const path = new Path2D();
  for (let i = 0; i < radii.length; i++) {
    const r = radii[i]! * across;
    if (Number.isNaN(x[i]! + y[i]! + r)) continue;
    path.moveTo(x[i]! + r, y[i]!);
    path.arc(x[i]!, y[i]!, r, 0, 2 * Math.PI);
  }
  ctx.fillStyle = mixed(parts(look.paper), parts(tint), PALE);
  ctx.fill(path);
}

// The bar of the legend that says which value is which.
export function scaled_bar(scale: Heat, look: Look): HTMLLIElement {
  const bar = make("span", { class: "heat", "aria-hidden": "true" });
  steps(look).forEach((tint, k) => {
    const part = make("span");
    part.style.background = tint;
    part.style.height = `${5 + (8 * k) / (STEPS - 1)}px`;
    bar.append(part);
  });
  return make("li", {}, `${scale.label}: ${Number(scale.low.toPrecision(3))} `, bar, ` ${Number(scale.high.toPrecision(3))}`);
}
