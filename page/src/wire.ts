// What the server sends: a header in JSON and the numbers of all curves as 32-bit floats (studio/server.py).

export interface Curve {
  name: string;
  number: number;
  look: "line" | "thin" | "bar" | "dots" | "plus" | "cross" | "ring" | "solid";
  said: string;
  at: number;
  n: number;
  heat: boolean; // n values follow y: they are shown as color and width
  reach: boolean; // n radii follow y: of discs, which together are one pale area
}
// An area: n numbers of x, then n of its lower and n of its upper end.
export interface Band {
  name: string;
  number: number;
  at: number;
  n: number;
}
export interface Mark {
  x: number;
  y: number;
  number: number;
  hollow: boolean;
  name: string; // beside it
  said: string; // for who points at it
  key: string; // what a click on it means; empty: nothing
}
export interface Level {
  value: number;
  text: string;
  upright: boolean;
  dashed: boolean;
  faint: boolean;
  number: number;
}
export interface Disc {
  x: number;
  y: number;
  radius: number;
  number: number;
  filled: boolean;
  faint: boolean;
}
export interface Note {
  x: number;
  y: number;
  text: string;
  number: number;
  right: boolean;
  middle: boolean;
}
// The scale of the values of curves that are shown as color.
export interface Heat {
  label: string;
  low: number;
  high: number;
}
export interface Panel {
  label: string;
  scale: "linear" | "log" | "degrees";
  low: number | null;
  high: number | null;
  share: number;
  curves: Curve[];
  marks: Mark[];
  levels: Level[];
  discs: Disc[];
  notes: Note[];
  bands: Band[];
  said: string;
  heat: Heat | null;
}
export interface Chart {
  label: string;
  scale: "linear" | "log" | "frequency";
  low: number | null;
  high: number | null;
  square: boolean;
  bare: boolean; // without axes
  factor: number; // from what is dragged, in SI, to the numbers of the axis of x
  panels: Panel[];
}
export interface Knob {
  name: string;
  block: string;
  title: string; // of the block
  unit: string;
  factor: number;
  low: number;
  high: number;
  logarithmic: boolean;
  meaning: string;
  today: number;
  dragged: boolean;
  exact: boolean; // a number that two others stand for: shown on demand
}
// The work waits for its answer: yes or no or, if a value is expected, a number in `unit`, which is SI.
export interface Question {
  number: number;
  text: string;
  expected: number | null;
  unit: string;
}
export interface Job {
  room: string;
  what: string;
  state: "waiting" | "running" | "done" | "failed" | "canceled";
  step: string;
  done: number | null;
  of: number | null;
  remarks: string[];
  error: string;
  seconds: number;
  question: Question | null;
}
// What a room says stands beside these, under the names that its file on the server gives.
export interface Message {
  [word: string]: unknown;
  number: number;
  room?: string;
  epoch?: number;
  job?: Job;
  error?: string;
  title?: string;
  knobs?: Knob[];
  values?: Record<string, number>;
  shapes?: Record<string, number>; // depth and width of each notch, which stand for its dampings
  judged?: { text: string; keeps: boolean }[];
  stable?: boolean;
  undo?: number;
  redo?: number;
  kept?: string[];
  file?: string;
  file_name?: string;
  charts: Record<string, Chart>;
}
export interface Received {
  said: Message;
  numbers: Float32Array;
}

export function decode(data: ArrayBuffer): Received {
  const length = new DataView(data).getUint32(0, true);
  const said = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))) as Message;
  return { said, numbers: new Float32Array(data, 4 + length) };
}
