// The rated value of a column in percent, A or V, from which the server computes its factor as `feeddrive force` does.

import { Field, numberOf } from "../controls/field";
import { make } from "../parts";
import type { Ask } from "../room";

export type Entered = Record<string, number | string | boolean | null>;
// What a column says of its rated value.
export interface Signal {
  role: string;
  signal: string; // percent, A or V, if a rated value gives the factor; else empty
  entered: Entered; // of which the factor was computed
}

// Fields of the data sheet: the name in the request, label, unit, and when it is shown, by signal and unit of the rated value.
interface Entry {
  key: string;
  label: string;
  unit: string;
  units?: string[]; // to choose from; the first one is usual
  wanted: (signal: string, chosen: string) => boolean;
}
const volts = (signal: string) => signal === "V" || signal === "pid.output";
const shares = (signal: string) => signal === "percent" || signal === "per-mille";
const ENTRIES: Entry[] = [
  { key: "rated", label: "Rated value", unit: "", units: ["N", "N m", "A"], wanted: shares },
  { key: "full", label: "full command", unit: "", wanted: volts },
  { key: "at_full", label: "gives", unit: "", units: ["N", "N m", "A"], wanted: volts },
];
const CONSTANTS: [string, string][] = [
  ["motor_constant", "N/A"],
  ["torque_constant", "N m/A"],
];

export class Rated {
  readonly element = make("div", { class: "rated", hidden: "" });
  private readonly fields = new Map<string, { field: Field; unit: HTMLSelectElement | null; line: HTMLElement; entry: Entry }>();
  private readonly constant: { field: Field; unit: HTMLSelectElement; line: HTMLElement };
  private readonly screw: Field;
  private readonly gear: Field;
  private readonly amplitude = make("input", { type: "checkbox" });
  private readonly inverted = make("input", { type: "checkbox" });
  private readonly head = new Map<string, HTMLElement>();
  private readonly peak = make("label", {}, this.amplitude, " the log has peak values of the current");
  readonly more: HTMLDetailsElement; // what is rarely needed, beside the factor
  private begun = false;
  private signal = "";
  private filled = "{}";

  constructor(
    private readonly ask: Ask,
    private readonly file: string,
    private readonly column: string,
  ) {
    const changed = () => this.send();
    const list = (label: string, among: string[]) => {
      const select = make("select", { "aria-label": label }, ...among.map((each) => make("option", { value: each }, each)));
      select.addEventListener("change", changed);
      return select;
    };
    for (const entry of ENTRIES) {
      const label = `${entry.label} of ${column}`;
      const field = new Field(label, "6", changed, true);
      const unit = entry.units ? list(`Unit of ${label}`, entry.units) : null;
      const head = make("span", {}, entry.label);
      const line = make("div", {}, head, " ", field.input, ...(unit ? [" ", unit] : []));
      this.head.set(entry.key, head);
      this.fields.set(entry.key, { field, unit, line, entry });
    }
    const field = new Field(`Motor constant of ${column}`, "6", changed, true);
    const unit = list(
      `Unit of the motor constant of ${column}`,
      CONSTANTS.map(([, each]) => each),
    );
    this.constant = { field, unit, line: make("div", {}, "constant ", field.input, " ", unit) };
    this.screw = new Field(`Screw pitch for ${column}`, "6", changed, true);
    this.gear = new Field(`Gear for ${column}`, "6", changed, true);
    for (const box of [this.amplitude, this.inverted]) box.addEventListener("change", changed);
    this.more = make(
      "details",
      {},
      make("summary", {}, "gear, sign"),
      this.peak,
      make("div", {}, "screw pitch ", this.screw.input, " mm per turn"),
      make("div", {}, "gear ", this.gear.input, " motor turns per screw turn"),
      make("label", {}, this.inverted, " the sign is reversed"),
    );
    this.element.append(...[...this.fields.values()].map(({ line }) => line), this.constant.line);
  }

  show({ role, signal, entered }: Signal): void {
    this.signal = signal;
    if (signal && !this.begun) {
      this.begun = true;
      const usual = { torque: "N m", current: "A" }[role] ?? "N";
      for (const { unit } of this.fields.values()) if (unit) unit.value = usual;
    }
    this.fill(entered);
    this.element.hidden = this.more.hidden = signal === "";
    this.head.get("rated")!.textContent = signal === "per-mille" ? "1000 ‰ =" : "100 % =";
    this.arrange();
  }

  // What was entered before, as on a page that is loaded again.
  private fill(entered: Entered): void {
    const filled = JSON.stringify(entered);
    if (filled === this.filled) return;
    this.filled = filled;
    const text = (key: string) => (entered[key] === null || entered[key] === undefined ? "" : String(entered[key]));
    for (const [key, { field, unit }] of this.fields) {
      if (entered[key] === undefined) continue;
      field.fill(text(key));
      if (unit) unit.value = text(`${key}_unit`);
    }
    for (const [key, unit] of CONSTANTS) {
      if (entered[key] === undefined) continue;
      this.constant.field.fill(text(key));
      this.constant.unit.value = unit;
    }
    this.screw.fill(text("lead_mm"));
    this.gear.fill(text("gear"));
    this.amplitude.checked = entered.amplitude === true;
    this.inverted.checked = entered.inverted === true;
  }

  // The unit of what the drive gives: of a current the constant of the motor is needed, too.
  private get chosen(): string {
    if (this.signal === "A") return "A";
    const key = volts(this.signal) ? "at_full" : "rated";
    return this.fields.get(key)!.unit!.value;
  }

  private arrange(): void {
    for (const { line, entry } of this.fields.values()) line.hidden = !entry.wanted(this.signal, this.chosen);
    this.constant.line.hidden = this.peak.hidden = this.chosen !== "A";
  }

  private send(): void {
    this.arrange();
    const request: Record<string, unknown> = { amplitude: this.amplitude.checked && this.chosen === "A" };
    let complete = true;
    for (const [key, { field, unit, line }] of this.fields) {
      if (line.hidden) continue;
      const value = numberOf(field.input.value);
      if (value === null) {
        complete &&= key === "full"; // 10 V, unless another value is entered
        continue;
      }
      request[key] = value;
      if (unit) request[`${key}_unit`] = unit.value;
    }
    if (!this.constant.line.hidden) {
      const key = CONSTANTS.find(([, unit]) => unit === this.constant.unit.value)![0];
      request[key] = numberOf(this.constant.field.input.value);
      complete &&= request[key] !== null;
    }
    request.lead_mm = numberOf(this.screw.input.value);
    request.gear = numberOf(this.gear.input.value);
    request.inverted = this.inverted.checked;
    // half of the data is no error: the rest is still to be entered
    if (complete) this.ask({ do: "import.scale", name: this.file, column: this.column, signal: this.signal, ...request });
  }
}
