// Where an axis is divided, and which of these places are named.

export interface Ticks {
  at: number[];
  named: Set<number>;
}

// `room` is how many names there is space for.
export function ticks(range: { low: number; high: number }, log: boolean, degrees: boolean, room: number): Ticks {
  const { low, high } = range;
  if (log && high / low >= 8) return decades(low, high, room);
  const span = high - low;
  const step = degrees ? turned(span / room) : nice(span / room);
  const at: number[] = [];
  for (let i = Math.ceil(low / step - 1e-6); i * step <= high + 1e-6 * step; i++) at.push(Number((i * step).toPrecision(12)));
  return { at, named: new Set(at) };
}

function decades(low: number, high: number, room: number): Ticks {
  const wide = Math.log10(high / low);
  const digits = [9, 3, 1].find((many) => many * wide <= room) ?? 0;
  const shown = { 9: [1, 2, 3, 4, 5, 6, 7, 8, 9], 3: [1, 2, 5], 1: [1], 0: [1] }[digits]!;
  const skip = Math.max(1, Math.ceil(wide / room)); // of very many decades not each is named
  const at: number[] = [];
  const named = new Set<number>();
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
    for (let digit = 1; digit <= 9; digit++) {
      const value = Number(`${digit}e${power}`);
      if (value < low * (1 - 1e-9) || value > high * (1 + 1e-9) || (digit > 1 && wide > 12)) continue;
      at.push(value);
      if (shown.includes(digit) && power % skip === 0) named.add(value);
    }
  }
  return { at, named };
}

// the next of 1, 2, 5, 10 ...
function nice(step: number): number {
  const power = 10 ** Math.floor(Math.log10(step));
  return power * ([1, 2, 5].find((each) => each * power >= step * 0.999) ?? 10);
}

function turned(step: number): number {
  return [1, 2, 5, 10, 15, 30, 45, 90, 180, 360, 720].find((each) => each >= step * 0.999) ?? 360 * Math.ceil(step / 360);
}

// A number as an axis names it.
export function plain(value: number): string {
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-3 || size >= 1e5)
    ? value.toExponential().replace("e+", "e")
    : String(Number(value.toPrecision(6)));
}
