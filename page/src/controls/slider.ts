// A slider and a text field that say the same number.

export type Moved = (name: string, value: number | string, first: boolean) => void;

const KEYS: Record<string, number> = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10 };
const STEP = 5; // of the range of 1000: a key
const BY_KEY = { usual: 0.01, shift: 0.1, alt: 0.001 }; // of a value, in a field

// `at` turns a place on the slider into a value, `read` what was typed; `moved` hears of both, `first` of a new step to undo.
export function follow(
  slider: HTMLInputElement,
  field: HTMLInputElement,
  at: (place: number) => number,
  read: (typed: number) => number,
  moved: (value: number | string, first: boolean) => void,
): void {
  let held = false;
  slider.addEventListener("pointerdown", () => (held = false));
  slider.addEventListener("input", () => {
    moved(at(Number(slider.value)), !held);
    held = true;
  });
  slider.addEventListener("change", () => (held = false));
  slider.addEventListener("keydown", (event) => {
    const way = KEYS[event.key];
    if (way === undefined) return;
    event.preventDefault();
    const most = Number(slider.max);
    moved(at(Math.min(most, Math.max(0, Number(slider.value) + STEP * way))), !event.repeat); // a held key is one step to undo
  });
  field.addEventListener("input", () => (field.dataset.typed = "yes")); // what is being typed is not written over
  field.addEventListener("escaped", () => delete field.dataset.typed);
  field.addEventListener("change", () => {
    delete field.dataset.typed;
    const typed = Number(field.value.replace(",", "."));
    const known = field.value.trim() !== "" && Number.isFinite(typed);
    moved(known ? read(typed) : field.value, true); // the server says what is no number
  });
  field.addEventListener("keydown", (event) => {
    const way = { ArrowUp: 1, ArrowDown: -1 }[event.key];
    const now = Number(field.value.replace(",", "."));
    if (way === undefined || !Number.isFinite(now)) return;
    event.preventDefault();
    const share = event.shiftKey ? BY_KEY.shift : event.altKey ? BY_KEY.alt : BY_KEY.usual;
    moved(read(Number((now + way * share * Math.abs(now || 1)).toPrecision(6))), !event.repeat);
  });
}
