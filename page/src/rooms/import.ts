// Files are brought: dragged on the page or chosen; what each was understood to be, and which column is what.

import { numberOf } from "../controls/field";
import { whenPainted } from "../pictures/look";
import { button, choice, make, renew } from "../parts";
import { Report, tables, type Result, type Table } from "../result";
import { session, type Ask, type Room } from "../room";
import type { Received } from "../wire";
import { Check, type Checked } from "./check";
import { ColumnTable, type Column } from "./columns";

// Fields in the units of the trade: the name in the request, and the value there, in SI.
const SI: Record<string, [string, (value: number) => number]> = {
  pitch: ["lead", (value) => Number((1e-3 * value).toPrecision(12))],
  rate: ["sample_time", (value) => 1 / value],
  delay: ["delay", (value) => Number((1e-3 * value).toPrecision(12))],
};

interface Brought {
  name: string;
  kind: string;
  axes: string[];
  wrong: string;
  no_clock: boolean; // a sample time is all that it lacks
  responses: string[];
  tables: Table[];
}
interface Words {
  bundled: string[];
  files: Brought[];
  open: string;
  queue: string[]; // of files that wait until the open one is done
  roles: Record<string, string>;
  start_from: string;
  offers_tour: boolean;
  columns?: Column[];
  axes?: string[]; // of a log with several
  axis?: string; // of which the columns are shown
  check?: Checked;
  remarks?: string[]; // on roles and units that the samples of the log contradict
  left_out?: string[]; // columns that are no numbers
  made: (Result & { of: string; machine: boolean }) | null;
  ask_axis?: { name: string; axes: string[] };
  go?: string;
}

// The words of this view; what was understood of a file comes from the server.
const TEXT = {
  title: "Start from what you have.",
  drop: "Drop a log, a frequency response, a machine or a part program.",
  choose: "Choose files",
  examples: "Example machines",
  tour: "Tour: your axis in ten minutes",
  tour_line: "from a simulated log to an exported control",
  identify: "Identify axis",
  identify_model: "Identify a model",
  measure: "Measure frequency response (FRF)",
  tune_frf: "Tune on measured FRF",
  tune: "Tune this axis",
  known: "Known machine",
  today: "Today's machine",
  gains: "Gains that ran, if no known machine has them",
  more: "If the file does not say it",
  pitch: "Screw pitch, for angles",
  rotary: " The axis itself turns, without a screw",
  unit_force: "One unit of the command =",
  rate: "Sampling rate, without a clock",
  rate_control: "Sampling rate of the control",
  unit: "Unit, if the file states none",
  delay: "Dead time that it does not hold",
  result: (name: string) => `Result: ${name}`,
  read: "Read it again",
};
// Gains of a P-PI cascade: name, unit and the factor to SI.
const GAINS: [name: string, unit: string, factor: number][] = [
  ["Kv", "1/s", 1],
  ["Kp", "N s/m", 1],
  ["Tn", "ms", 1e-3],
];

export class Import implements Room {
  readonly name = "import";
  readonly title = "Import";
  readonly element = make("div", { class: "import-view fills" });
  private readonly wrong = make("div", { role: "alert", class: "bad" });
  private readonly place = make("div", { class: "drop", tabindex: "-1" });
  private readonly chooses: HTMLButtonElement;
  private readonly bundled = make("div", { class: "buttons" });
  private readonly list = make("ul", { class: "files", "aria-label": "Files" });
  private readonly detail = make("section", { "aria-label": "The open file", class: "opened" });
  private readonly head = make("div");
  private readonly columns: ColumnTable;
  private readonly check = new Check((units) => this.choose(units));
  private readonly fields = make("div");
  private readonly outcome = make("section", { "aria-label": "Result", tabindex: "-1", class: "outcome" });
  private readonly tour = make("p", {});
  private readonly report = new Report("picture-made");
  private readonly given = new Map<string, string>(); // what a person wrote into the fields, by file and field
  private last: Received | null = null;
  private refusals = 0;
  private results = ""; // the result that is shown

  constructor(private readonly ask: Ask) {
    const chooser = make("input", { type: "file", multiple: "", id: "files" });
    chooser.addEventListener("change", () => {
      const files = [...(chooser.files ?? [])];
      chooser.value = ""; // the same file can be chosen again
      void this.send(files);
    });
    chooser.hidden = true; // the button opens it
    chooser.setAttribute("aria-label", TEXT.choose);
    this.chooses = button(TEXT.choose, () => chooser.click(), { id: "choose-files" });
    this.place.append(make("h1", {}, TEXT.title), make("p", {}, TEXT.drop), make("div", {}, this.chooses, chooser));
    this.tour.append(
      button(TEXT.tour, () => this.ask({ do: "import.tour" }), { id: "import-tour" }),
      ` ${TEXT.tour_line}`,
    );
    for (const kind of ["dragover", "drop"]) document.addEventListener(kind, (event) => event.preventDefault());
    document.addEventListener("drop", (event) => void this.send([...(event.dataTransfer?.files ?? [])]));
    this.element.append(
      make(
        "div",
        { class: "begin" },
        make("section", { "aria-label": "Files" }, this.place, this.wrong, this.list),
        make(
          "section",
          { "aria-label": TEXT.examples, class: "examples" },
          make("h2", {}, TEXT.examples),
          this.bundled,
          this.tour,
        ),
      ),
      this.detail,
      this.outcome,
    );
    this.columns = new ColumnTable(ask);
    this.detail.append(
      this.head,
      make("div", { class: "import" }, make("div", {}, this.columns.element, this.fields), this.check.element),
    );
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    const words = received.said as unknown as Words;
    this.last = received;
    this.tour.hidden = !words.offers_tour;
    renew(this.bundled, [words.bundled, words.ask_axis], () => this.begins(words));
    const { made, files, bundled, open, queue, start_from } = words;
    this.element.classList.toggle("without", !files.length && !queue.length);
    this.chooses.classList.toggle("main", !files.length);
    renew(this.list, [files.map(({ name, kind, wrong }) => [name, kind, wrong]), open, queue], () => this.listed(words));
    const file = files.find((each) => each.name === open);
    const shown = file && !file.wrong ? file : undefined;
    renew(this.head, [file?.name, file?.kind, file?.wrong, words.axes, words.axis], () => (file ? this.headed(file, words) : []));
    this.columns.show(
      open,
      shown ? words.columns : undefined,
      words.roles,
      files.map((each) => each.name),
    );
    this.check.show(open, shown ? words.check : undefined, words.remarks ?? [], words.left_out ?? []);
    renew(this.fields, [open, files, bundled, start_from, this.refusals], () => (shown ? this.shows(shown, words) : []));
    this.report.show(made);
    renew(this.outcome, [made, queue[0], open], () => this.result(words));
    const result = JSON.stringify(made);
    if (this.results !== result && this.results !== "" && made) this.outcome.scrollIntoView({ block: "start" });
    this.results = result;
    if (words.go) document.dispatchEvent(new CustomEvent("go", { detail: words.go }));
    this.draw();
  }

  // A field shows what a column is read by, and not what was refused.
  unchanged(): void {
    this.refusals += 1;
    if (this.last) this.heard(this.last);
  }

  shown(): void {
    this.draw();
  }

  private begins({ bundled, ask_axis }: Words): HTMLElement[] {
    const buttons: HTMLElement[] = bundled.map((name) =>
      button(name.replaceAll("_", " "), () => this.ask({ do: "import.bundled", name }), { id: `bundled-${name}` }),
    );
    if (!ask_axis) return buttons;
    const { name, axes } = ask_axis;
    const act = bundled.includes(name) ? "import.bundled" : "import.axis";
    return [
      ...buttons,
      make("span", { role: "status" }, `${name} has several axes: `),
      ...axes.map((axis) => button(`axis ${axis}`, () => this.ask({ do: act, name, axis }), { id: `axis-${axis}` })),
    ];
  }

  private listed({ files, open, queue }: Words): HTMLElement[] {
    const unread = queue.filter((name) => !files.some((each) => each.name === name));
    const rows = [...files, ...unread.map((name) => ({ name, kind: "", wrong: "" }))];
    return rows.map(({ name, kind, wrong }) => {
      const place = queue.indexOf(name);
      const said = wrong ? `cannot be used: ${wrong}` : place < 0 ? kind : waits(kind, place, queue.length);
      const item = make("li", place < 0 ? {} : { class: "waits" });
      item.append(
        kind
          ? button(name, () => this.ask({ do: "import.pick", name }), { "aria-pressed": String(name === open) })
          : make("span", {}, name),
        make("span", wrong ? { class: "bad" } : {}, ` ${said} `),
        button("Remove", () => this.ask({ do: "import.drop", name }), { "aria-label": `Remove ${name}` }),
      );
      return item;
    });
  }

  private draw(): void {
    if (!this.last || this.element.closest("[hidden]")) return;
    this.check.draw(this.last);
    this.report.draw(this.last);
  }

  private async send(files: File[]): Promise<void> {
    this.wrong.replaceChildren();
    const names: string[] = [];
    for (const file of files) {
      const where = `/upload?session=${encodeURIComponent(session())}&name=${encodeURIComponent(file.name)}`;
      try {
        const may = await fetch(`${where}&ask=${file.size}`, { method: "POST" });
        const answer = may.ok ? await fetch(where, { method: "POST", body: file }) : may;
        const said = (await answer.json()) as { name?: string; error?: string };
        if (said.name) names.push(said.name);
        else this.refuse(file.name, said.error ?? "the file was refused");
      } catch {
        this.refuse(file.name, "could not be sent: the server has ended, or the file was changed meanwhile");
      }
    }
    if (names.length) this.ask({ do: "import.look", names });
  }

  // Said where it can be seen, below what was said of other files.
  private refuse(name: string, why: string): void {
    document.dispatchEvent(new CustomEvent("go", { detail: this.name }));
    this.wrong.append(make("p", {}, why.includes(name.slice(0, 60)) ? why : `${name}: ${why}`));
  }

  private shows(file: Brought, words: Words): HTMLElement[] {
    const machines: [string, string][] = [
      ["", "none"],
      ...words.files.filter((each) => each.kind === "machine").map((each): [string, string] => [each.name, each.name]),
    ];
    machines.push(...words.bundled.map((each): [string, string] => [each, `${each.replaceAll("_", " ")} (bundled)`]));
    const name = file.name;
    const others = words.files.filter((each) => each.kind === file.kind && each.name !== name && !each.wrong);
    const kept = (key: string, usual = "") => this.given.get(`${name} ${key}`) ?? usual;
    const keep = (key: string, value: string) => this.given.set(`${name} ${key}`, value);
    const places = others.map((each) => {
      const box = make("input", { type: "checkbox", value: each.name, id: `at-${each.name}` });
      box.checked = kept(`at ${each.name}`) !== "";
      box.addEventListener("change", () => keep(`at ${each.name}`, box.checked ? "yes" : ""));
      return box;
    });
    const at = () => places.filter((each) => each.checked).map((each) => each.value);
    const together =
      file.kind === "log"
        ? "Identify with further logs of the same axis, by these columns: their values are pooled"
        : "The same axis at other positions or loads";
    const also = others.length
      ? [make("fieldset", {}, make("legend", {}, together), ...places.map((each) => make("label", {}, each, ` ${each.value} `)))]
      : [];
    if (file.kind === "machine") {
      const acts = file.axes.map((axis) =>
        button(`Tune axis ${axis}`, () => this.ask({ do: "import.axis", name, axis, at: at() }), { id: `tune-${axis}` }),
      );
      return [make("div", { class: "buttons" }, ...acts), ...also, ...tables(file.tables)];
    }
    if (file.kind === "part program") return [make("p", {}, "It is planned and run on the machine under Program.")];
    // a choice that is kept, as long as it still is among them
    const one_of = (key: string, label: string, among: [string, string][], usual = "") => {
      const made = choice(label, among, (value) => keep(key, value));
      if (!among.some(([value]) => value === kept(key, usual))) keep(key, usual);
      const select = made.querySelector("select")!;
      select.value = kept(key, usual);
      select.id = `import-${key}`;
      return made;
    };
    const start = file.kind === "log" ? words.start_from : "";
    const begins = file.kind === "log" ? TEXT.known : TEXT.today;
    const chosen = one_of("machine", begins, machines, start);
    const fields = new Map<string, HTMLInputElement>();
    const field = (key: string, label: string, unit = ""): HTMLElement => {
      const input = make("input", {
        type: "text",
        inputmode: key === "unit" ? "text" : "decimal",
        size: "6",
        id: `import-${key}`,
      });
      input.value = kept(key);
      input.addEventListener("input", () => keep(key, input.value));
      fields.set(key, input);
      return make("label", { for: input.id }, `${label} `, input, ...(unit ? [" ", make("span", { class: "unit" }, unit)] : []));
    };
    const given = (): Record<string, unknown> => {
      const found: Record<string, unknown> = { machine: kept("machine", start) };
      for (const [key, input] of fields) {
        const typed = numberOf(input.value);
        if (typed === null || GAINS.some(([name]) => name === key)) continue;
        const [name, si] = SI[key] ?? [key, (value: number) => value];
        found[name] = typeof typed === "number" ? si(typed) : typed;
      }
      const gains = GAINS.flatMap(([name, , factor]) => {
        const typed = numberOf(fields.get(name)?.value ?? "");
        return typed === null ? [] : [`${name}=${typeof typed === "number" ? Number((typed * factor).toPrecision(12)) : typed}`];
      });
      if (gains.length) found.law = `cascade_ppi:${gains.join(",")}`;
      return found;
    };
    if (file.kind === "frequency responses") {
      const known = file.responses.map((each): [string, string] => [each, each]);
      const several =
        file.responses.length > 1
          ? [
              one_of("load", "Response of the table", [["", "by its name"], ...known]),
              one_of("motor", "Response of the motor's encoder", [["", "by its name, or none"], ...known]),
            ]
          : [];
      const chosen_roles = () => Object.fromEntries(["load", "motor"].map((key) => [key, kept(key)]).filter(([, one]) => one));
      const more = [
        ...several,
        field("rate", TEXT.rate_control, "Hz"),
        field("unit", TEXT.unit),
        field("delay", TEXT.delay, "ms"),
      ];
      return [
        make(
          "div",
          { class: "buttons" },
          button(TEXT.tune_frf, () => this.ask({ do: "import.responses", name, at: at(), ...given(), ...chosen_roles() }), {
            id: "tune-responses",
            class: "main",
          }),
          button(
            TEXT.identify_model,
            () =>
              this.ask({
                do: "import.identify",
                name,
                ...chosen_roles(),
                machine: kept("machine", start),
                unit: kept("unit").trim(),
              }),
            { id: "identify" },
          ),
        ),
        make("div", { class: "fields" }, chosen, ...more),
        ...also,
        ...tables(file.tables),
      ];
    }
    const turns = make("input", { type: "checkbox", id: "import-rotary" });
    turns.checked = kept("rotary") !== "";
    turns.addEventListener("change", () => keep("rotary", turns.checked ? "yes" : ""));
    const gains = GAINS.map(([name, unit]) => field(name, name, unit));
    const more = [
      field("pitch", TEXT.pitch, "mm per turn"),
      make("label", { for: turns.id }, turns, TEXT.rotary),
      field("force_constant", TEXT.unit_force, "N"),
      field("rate", TEXT.rate, "Hz"),
    ];
    return [
      make(
        "div",
        { class: "buttons" },
        button(TEXT.identify, () => this.ask({ do: "import.identify", name, also: at(), rotary: turns.checked, ...given() }), {
          id: "identify",
          class: "main",
        }),
        button(
          TEXT.measure,
          () => this.ask({ do: "import.estimate", name, all: false, sample_time: given().sample_time ?? null }),
          { id: "estimate" },
        ),
      ),
      ...also,
      make("div", { class: "fields" }, chosen),
      make("fieldset", {}, make("legend", {}, TEXT.gains), make("div", { class: "fields" }, ...gains)),
      make("fieldset", {}, make("legend", {}, TEXT.more), make("div", { class: "fields" }, ...more)),
    ];
  }

  // Units that were in doubt.
  private choose(units: [string, string][]): void {
    const { open } = this.last?.said as unknown as Words;
    for (const [column, unit] of units) this.ask({ do: "import.unit", name: open, column, unit });
  }

  private headed(file: Brought, { axes = [], axis = "" }: Words): HTMLElement[] {
    const { name, kind, wrong, no_clock } = file;
    const head = make("h2", {}, `${name}: ${kind}`);
    if (wrong) return [head, make("p", { class: "bad" }, wrong), ...(no_clock ? [this.clock(name)] : [])];
    if (axes.length < 2) return [head];
    const change = (axis: string) => this.ask({ do: "import.choose_axis", name, axis });
    const among = choice(
      `It has ${axes.length} axes. Show axis`,
      axes.map((each): [string, string] => [each, each]),
      change,
    );
    const select = among.querySelector("select")!;
    select.id = "axis-of-log";
    select.value = axis;
    return [head, among];
  }

  private clock(name: string): HTMLElement {
    const field = make("input", { type: "text", inputmode: "decimal", size: "8", id: "import-clock" });
    const read = () => {
      const rate = numberOf(field.value);
      this.ask({ do: "import.look", names: [name], sample_time: typeof rate === "number" ? 1 / rate : rate });
    };
    field.addEventListener("keydown", (event) => event.key === "Enter" && read());
    return make("p", {}, make("label", { for: field.id }, `${TEXT.rate} `), field, " Hz ", button(TEXT.read, read));
  }

  private result({ made, queue, open }: Words): HTMLElement[] {
    if (!made) return [];
    const take = made.machine
      ? [button(TEXT.tune, () => this.ask({ do: "import.take" }), { id: "take-identified", class: "main" })]
      : [];
    const [name] = queue;
    const next =
      name && name !== open
        ? [button(`Next file: ${name}`, () => this.ask({ do: "import.pick", name }), { id: "next-file" })]
        : [];
    return [
      make("h2", {}, TEXT.result(made.of)),
      this.report.head,
      make("div", { class: "buttons" }, ...take, ...next),
      this.report.body,
    ];
  }
}

function waits(kind: string, place: number, many: number): string {
  const turn = many === 1 ? "waits until the open file is done" : `waits, ${place + 1} of ${many}`;
  return kind ? `${kind}, ${turn}` : "waits to be read";
}
