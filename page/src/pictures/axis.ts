// The scale of an axis, linear or logarithmic: from values to pixels of the canvas and back.

// Where a value stands on an axis: `low` at the pixel `from`, `high` at `to`.
export interface Axis {
  low: number;
  high: number;
  log: boolean;
  from: number;
  to: number;
}

// A value in pixels of the canvas.
export function pixel(axis: Axis, value: number): number {
  const { low, high, from, to } = axis;
  const share = axis.log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  return from + share * (to - from);
}

// The value at a pixel of the canvas.
export function value(axis: Axis, at: number): number {
  const share = (at - axis.from) / (axis.to - axis.from);
  return axis.log ? axis.low * (axis.high / axis.low) ** share : axis.low + share * (axis.high - axis.low);
}

// Values in pixels of the canvas; what has no place on a logarithmic axis, or none at all, is NaN. Far outside they are
// cut, since a canvas draws nothing of a line that reaches beyond what it can count.
export function pixels(axis: Axis, values: Float32Array): Float64Array {
  const placed = new Float64Array(values.length);
  const factor = (axis.to - axis.from) / (axis.log ? Math.log(axis.high / axis.low) : axis.high - axis.low);
  for (let i = 0; i < values.length; i++) {
    const value = values[i]!;
    const at = axis.from + factor * (axis.log ? (value > 0 ? Math.log(value / axis.low) : NaN) : value - axis.low);
    placed[i] = at > 1e5 ? 1e5 : at < -1e5 ? -1e5 : at;
  }
  return placed;
}
