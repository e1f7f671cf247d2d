// What a curve says at a place.

import type { Curve } from "../wire";

// y of a curve at x, between its two points there; null beside it and where it is interrupted.
export function near(curve: Curve, numbers: Float32Array, x: number): number | null {
  let [low, high] = [0, curve.n - 1];
  const at = (i: number) => numbers[curve.at + i]!;
  if (curve.n < 2 || !(at(low) <= x && x <= at(high))) return null;
  while (high - low > 1) {
    let middle = (low + high) >> 1;
    while (middle < high && Number.isNaN(at(middle))) middle++; // an interruption has no place of its own
    if (middle === high) high = (low + high) >> 1;
    else if (at(middle) <= x) low = middle;
    else high = middle;
  }
  const [left, right] = [numbers[curve.at + curve.n + low]!, numbers[curve.at + curve.n + high]!];
  const found = at(high) > at(low) ? left + ((right - left) * (x - at(low))) / (at(high) - at(low)) : left;
  return Number.isNaN(found) ? null : found;
}
