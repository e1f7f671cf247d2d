// The table of the columns of a log: which role each has and why, its unit, and its factor or rated value.
// A row is made once and changed in place, so that it stays where it is and keeps focus and text while roles change.

import { Field, numberOf } from "../controls/field";
import { make } from "../parts";
import type { Ask } from "../room";
import { Rated, type Signal } from "./rated";

export interface Column extends Signal {
  column: string;
  unit: string;
  factor: number | null;
  stated: string; // the unit that the file states
  why: string;
  missing: boolean; // its factor is still needed
  other_axis: boolean; // it has a role in the table of another axis
  doubted: boolean; // the samples contradict its role
  open: boolean; // the samples neither confirm nor contradict its role
  scale: string; // what the rated value gave: "1 of 'load' is 8.5 N"
  course: number[]; // of the column over the log, 0 to 100
  low: string; // its ends, in the unit in which it is read
  high: string;
}

// Roles in the words of the trade; one that a package adds has its own name.
const ROLES: Record<string, string> = {
  time: "Time",
  setpoint_position: "Set position",
  setpoint_velocity: "Set velocity",
  position_motor: "Actual position (motor)",
  position_load: "Actual position (linear scale)",
  velocity_motor: "Actual velocity (motor)",
  velocity_load: "Actual velocity (linear scale)",
  acceleration_load: "Acceleration of the table",
  force: "Drive force",
  command: "Command to the drive",
  load_force: "Force on the table",
  excitation: "Excitation",
  setpoint_angle: "Set angle",
  setpoint_speed: "Set speed",
  angle_motor: "Actual angle (motor)",
  angle_load: "Actual angle (load encoder)",
  speed_motor: "Actual speed (motor)",
  speed_load: "Actual speed (load encoder)",
  torque: "Drive torque",
  current: "Motor current",
};

class Row {
  private static made = 0;
  readonly element = make("tr");
  private readonly role: HTMLSelectElement;
  private readonly unit: Field;
  private readonly factor: Field;
  private readonly why = make("div", { class: "why" });
  private readonly rated: Rated;
  private readonly line = svg("polyline");
  private readonly ends = [make("span"), make("span")] as const;
  private shown: Column;

  constructor(
    private readonly ask: Ask,
    private readonly file: string,
    roles: Record<string, string>,
    column: Column,
  ) {
    const name = column.column;
    this.shown = column;
    const among = Object.entries(roles).map(([role, unit]): [string, string] => [
      role,
      ROLES[role] ?? `${role.replaceAll("_", " ")}${unit ? ` (${unit})` : ""}`,
    ]);
    this.role = make(
      "select",
      { "aria-label": `Role of ${name}` },
      ...[["", "not used"] as [string, string], ...among].map(([value, text]) => make("option", { value }, text)),
    );
    // the reason, with the mark of a role that is wrong, missing a value, or open, is read with the choice
    this.why.id = `why-of-column-${++Row.made}`;
    this.role.setAttribute("aria-describedby", this.why.id);
    this.unit = new Field(`Unit of ${name}`, "6", () => this.send());
    this.factor = new Field(`Factor of ${name}`, "6", () => this.send(), true);
    this.rated = new Rated(ask, file, name);
    this.role.addEventListener("change", () => {
      const before = roles[this.shown.role];
      // unit and factor were those of another quantity
      if (this.shown.role && before !== roles[this.role.value]) this.unit.input.value = this.factor.input.value = "";
      this.send();
    });
    this.element.append(
      make("th", { scope: "row" }, make("div", {}, name)),
      make("td", {}, this.role, this.why),
      make("td", {}, this.unit.input, this.rated.element),
      make("td", {}, this.factor.input, this.rated.more),
      make("td", { class: "course" }, drawn(this.line), make("div", {}, ...this.ends)),
    );
    this.show(column);
  }

  show(column: Column): void {
    this.shown = column;
    this.role.value = column.role;
    this.unit.input.placeholder = column.stated;
    // what was typed of a column that is not used stays until it is
    if (column.role) {
      this.unit.fill(column.unit);
      this.factor.fill(column.factor === null ? "" : String(column.factor));
    }
    if (this.why.textContent !== column.why) this.why.textContent = this.why.title = column.why;
    this.element.classList.toggle("missing", column.missing || column.doubted);
    this.element.classList.toggle("open", column.open);
    this.role.setAttribute("aria-invalid", String(column.doubted));
    this.element.classList.toggle("unused", column.role === "");
    this.rated.show(column);
    this.element.classList.toggle("other", column.other_axis);
    this.factor.input.title = column.scale;
    const points = column.course.map((y, i) => `${(84 * i) / (column.course.length - 1 || 1)},${46 - 0.44 * y}`).join(" ");
    if (this.line.getAttribute("points") !== points) this.line.setAttribute("points", points);
    [column.high, column.low].forEach((end, i) => (this.ends[i]!.textContent = end));
  }

  private send(): void {
    this.ask({
      do: "import.role",
      name: this.file,
      column: this.shown.column,
      role: this.role.value,
      unit: this.unit.input.value.trim(),
      factor: numberOf(this.factor.input.value),
    });
  }
}

export class ColumnTable {
  private readonly body = make("tbody");
  readonly element = make(
    "div",
    { id: "columns-of-log", hidden: "" },
    make("h2", {}, "What each column is"),
    make(
      "table",
      { class: "columns" },
      make(
        "thead",
        {},
        make(
          "tr",
          {},
          ...["Column", "Is the", "Unit", "Factor", "In this unit"].map((each) => make("th", { scope: "col" }, each)),
        ),
      ),
      this.body,
    ),
  );
  private readonly rows = new Map<string, Map<string, Row>>(); // by file and column
  private readonly all = make("input", { type: "checkbox", id: "columns-of-all-axes" });
  private readonly others = make("label", {}, this.all, " Show the columns of the other axes too");

  constructor(private readonly ask: Ask) {
    this.element.append(this.others);
    this.all.addEventListener("change", () => this.body.classList.toggle("all", this.all.checked));
  }

  // `files`: of which what was typed is kept
  show(file: string, columns: Column[] | undefined, roles: Record<string, string>, files: string[]): void {
    for (const known of this.rows.keys()) if (!files.includes(known)) this.rows.delete(known);
    this.element.hidden = columns === undefined;
    if (!columns) return;
    this.others.hidden = !columns.some((each) => each.other_axis);
    const known = this.rows.get(file) ?? new Map<string, Row>();
    this.rows.set(file, known);
    const wanted = columns.map((each) => {
      const row = known.get(each.column) ?? new Row(this.ask, file, roles, each);
      known.set(each.column, row);
      row.show(each);
      return row.element;
    });
    // an element that is put in its place again would lose the focus
    if (wanted.length !== this.body.rows.length || wanted.some((each, i) => each !== this.body.rows[i]))
      this.body.replaceChildren(...wanted);
  }
}

function svg<Kind extends keyof SVGElementTagNameMap>(kind: Kind): SVGElementTagNameMap[Kind] {
  return document.createElementNS("http://www.w3.org/2000/svg", kind);
}

function drawn(line: SVGElement): SVGElement {
  const found = svg("svg");
  found.setAttribute("viewBox", "0 0 84 48");
  found.setAttribute("aria-hidden", "true"); // the ends are said beside it
  found.append(line);
  return found;
}
