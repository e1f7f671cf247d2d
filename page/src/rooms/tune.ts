// Tuning by hand: the figures that decide, the numbers of the control, and pictures that follow them, all in view.

import { Choices, type Choice, type Unit } from "../controls/choices";
import { FilterAdder } from "../controls/filter_adder";
import { Handles, type Grip } from "../controls/handles";
import { History, type Change } from "../controls/history";
import { Levels, type Level } from "../controls/levels";
import { Numbers } from "../controls/numbers";
import { LETTERS, Snapshots } from "../controls/snapshots";
import { Strip, type Gauge } from "../controls/strip";
import { WholeLoop, type Faster } from "../controls/whole_loop";
import { icon } from "../icons";
import { button, make, save } from "../parts";
import { near } from "../pictures/curve";
import { look, whenPainted } from "../pictures/look";
import { Picture } from "../pictures/picture";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

const TOP = ["open_loop", "nyquist"]; // the first row; all others stand below
const LIMITED = ["sensitivity", "stiffness"]; // pictures whose limit is dragged by its line
const REST = 400; // ms without a change after which a way out of a broken limit is looked for

export class Tune implements Room {
  readonly name = "tune";
  readonly title = "Tune";
  readonly element = make("div", { class: "tune" });
  readonly bar = make("div", { class: "bar" }); // undo, redo and the machine file, beside the title of the page
  private readonly pictures = new Map<string, Picture>(); // in the order of the server
  private readonly grid = make("div", { class: "grid" });
  private readonly see: Choices;
  private readonly shape = make("span", { class: "shape" });
  private readonly verdict = make("p", { id: "verdict", "aria-live": "polite" });
  private readonly headline = make("b");
  private readonly sentence = make("span");
  private readonly remedy = button("", () => this.ask({ do: "tune.speed", value: this.cured, first: true }), {
    id: "remedy",
    hidden: "",
  });
  private readonly notes = make("details", { id: "remarks", hidden: "" });
  private readonly undo: HTMLButtonElement;
  private readonly redo: HTMLButtonElement;
  private readonly file: HTMLButtonElement;
  private readonly strip: Strip;
  private readonly snapshots: Snapshots;
  private readonly history: History;
  private readonly numbers: Numbers;
  private readonly whole: WholeLoop;
  private readonly adder: FilterAdder;
  private readonly handles: Handles;
  private poles: Handles | null = null;
  private readonly figures = make("p", { id: "figures", class: "spoken" });
  private readonly poles_said = make("p", { id: "poles-said", class: "meaning", hidden: "" });
  private readonly hint = make("div", { class: "empty", hidden: "" });
  private readonly levels: Levels[] = [];
  private grips: Grip[] = [];
  private last: Received | null = null;
  private cured = 0; // the crossover at which all limits are kept, Hz
  private waits = 0;
  private cursor: number | null = null; // Hz

  constructor(private readonly ask: Ask) {
    const moved = (name: string, value: number | string, first: boolean) => ask({ do: "tune.move", name, value, first });
    this.undo = this.tool("undo", "Undo", "Ctrl+Z", () => ask({ do: "tune.undo" }));
    this.redo = this.tool("redo", "Redo", "Ctrl+Shift+Z", () => ask({ do: "tune.redo" }));
    this.file = button("Save", () => ask({ do: "tune.file" }), {
      id: "save",
      title: "Save the machine file (Ctrl+S)",
      hidden: "",
    });
    this.bar.append(this.undo, this.redo, this.file);
    this.strip = new Strip(
      ({ key }, value) => ask({ do: "tune.limit", figure: key, value }),
      (frequency) => this.point(frequency),
    );
    this.snapshots = new Snapshots(ask, () => this.draw());
    this.see = new Choices(ask);
    this.whole = new WholeLoop((value, first) => ask({ do: "tune.speed", value, first }));
    this.adder = new FilterAdder((kind, at) => ask({ do: "tune.add", kind, at }));
    this.history = new History((steps) => ask({ do: "tune.go", steps }));
    const [law, cards] = [make("div", { id: "numbers-law" }), make("div", { id: "numbers-filters" })];
    this.numbers = new Numbers(law, cards, moved, {
      removed: (place, off) => ask({ do: off ? "tune.forget" : "tune.remove", place }),
      switched: (place, on) => ask({ do: "tune.switch", place, on }),
    });
    const filters = make(
      "section",
      { "aria-label": "Filters" },
      make("h2", {}, "Filters"),
      this.adder.element,
      cards,
      this.numbers.off,
    );
    const list = make("div", { id: "numbers-list" }, law, filters);
    const side = make(
      "section",
      { id: "numbers", "aria-label": "Parameters", tabindex: "0" },
      this.whole.element,
      list,
      this.history.element,
    );
    const open_loop = this.picture("open_loop", "Open loop");
    open_loop.onpick = (x) => this.adder.pick(x);
    open_loop.oncursor = (x) => this.follow(x);
    const held = {
      dragged: (name: string, x: number, y: number | null, first: boolean) => ask({ do: "tune.drag", name, x, y, first }),
      stepped: (name: string, across: number, up: number, first: boolean) => ask({ do: "tune.step", name, across, up, first }),
      turned: (name: string, steps: number, first: boolean) => {
        const width = name.replace(/[^.]*$/, "width");
        const there = this.grips.some((each) => each.name === width);
        if (there && steps) ask({ do: "tune.step", name: width, across: steps, up: 0, first });
        return there;
      },
      removed: (name: string) => {
        const [list, place] = name.split(".");
        ask({ do: list === "off" ? "tune.forget" : "tune.remove", place: Number(place) });
      },
    };
    this.handles = new Handles(
      open_loop,
      held,
      ({ name }) => (name.endsWith(".width") ? "↔" : name.startsWith("off.") ? "–" : String(Number(name.split(".")[1]) + 1)),
      true,
    );
    this.verdict.append(this.headline, " ", this.sentence);
    const say = make(
      "div",
      { id: "say" },
      this.shape,
      this.verdict,
      this.remedy,
      this.notes,
      this.see.element,
      this.snapshots.element,
    );
    const work = make("section", { id: "pictures", "aria-label": "Pictures" }, this.poles_said, this.grid);
    this.hint.append(
      make("h1", {}, "Tune an axis by hand"),
      make(
        "p",
        {},
        "Every number of the control with a slider, and margins, stiffness and following error beside it as you move it.",
      ),
      button(
        "Import a machine or a measured response",
        () => document.dispatchEvent(new CustomEvent("go", { detail: "bring" })),
        { class: "main" },
      ),
    );
    this.element.append(this.hint, this.strip.element, this.strip.popup, say, this.figures, side, work);
    document.addEventListener("keydown", (event) => this.key(event));
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    const { said } = received;
    if (said.file !== undefined) return save(said.file, said.file_name ?? "machine.toml");
    if (said.svg) return this.drawn(said.svg as { name: string; text: string; how: string });
    if (said.remedy !== undefined) return this.cure(said.remedy as { crossover: number; text: string } | null);
    if (said.knobs) {
      this.numbers.list(said.knobs);
      this.hint.hidden = said.knobs.length > 0; // without numbers nothing here could do anything
      this.element.classList.toggle("without", !this.hint.hidden);
      this.file.hidden = !this.hint.hidden;
    }
    if (said.pictures) {
      const choices = said.pictures as Choice[];
      for (const { name, title } of choices) this.picture(name, title);
      this.poles ??= this.held(this.pictures.get("poles"));
      this.see.list(choices, said.units as Unit[]);
    }
    if (said.off) this.numbers.listOff(said.off as string[]);
    if (said.kinds) this.adder.list(said.kinds as string[]);
    if (said.faster) this.whole.list(said.faster as Faster);
    if (said.speed !== undefined) this.whole.show(said.speed as number | null);
    if (said.grips) this.grips = said.grips as Grip[];
    if (said.judged) this.judge(received);
    if (said.values) {
      this.numbers.show({ ...said.values, ...said.shapes });
      this.last = received;
      this.draw();
      for (const each of this.levels) each.show(said.levels as Level[]);
      this.handles.show(this.grips);
      this.poles?.show((said.poles as Grip[] | undefined) ?? []);
      this.poles_said.textContent = String(said.poles_said ?? "");
      this.poles_said.hidden = !said.poles_said;
    }
  }

  unchanged(): void {
    this.numbers.show();
    const speed = this.last?.said.speed;
    if (speed !== undefined) this.whole.show(speed as number | null);
  }

  shown(): void {
    this.draw();
  }

  private judge({ said }: Received): void {
    this.figures.textContent = String(said.figures ?? "");
    this.undo.disabled = !said.undo;
    this.redo.disabled = !said.redo;
    this.snapshots.show(said.kept ?? []);
    this.strip.show(said.strip as Gauge[]);
    this.history.show(said.history as Change[]);
    const all = said.stable && said.judged!.every((each) => each.keeps);
    const state = !all ? "broken" : said.judged!.length ? "kept" : "free";
    this.headline.textContent = `${String(said.headline)}.`;
    const place = Number(said.places ?? 1) > 1 ? ` Worst of ${said.places} places: ${said.leading}.` : "";
    this.sentence.textContent = `${said.sentence}${place}`;
    this.verdict.title = said.judged!.map((each) => `${each.text}: ${each.keeps ? "kept" : "broken"}`).join("\n");
    this.verdict.className = all ? "good" : "bad";
    if (this.shape.dataset.state !== state) this.shape.replaceChildren(icon(state));
    this.shape.dataset.state = state;
    const remarks = (said.remarks as string[] | undefined) ?? [];
    this.notes.hidden = remarks.length === 0;
    const list = make("ul", { "aria-label": "Remarks" }, ...remarks.map((each) => make("li", {}, each)));
    this.notes.replaceChildren(make("summary", {}, `${remarks.length} remark${remarks.length === 1 ? "" : "s"}`), list);
    this.remedy.hidden = true;
    clearTimeout(this.waits);
    if (!all) this.waits = window.setTimeout(() => this.element.closest("[hidden]") ?? this.ask({ do: "tune.remedy" }), REST);
  }

  // A picture as SVG that was asked for.
  private drawn({ name, text, how }: { name: string; text: string; how: string }): void {
    if (how === "save") save(text, `${name}.svg`, "image/svg+xml");
    else this.pictures.get(name)?.taken(text);
  }

  private cure(found: { crossover: number; text: string } | null): void {
    this.remedy.hidden = found === null;
    if (!found) return;
    this.cured = found.crossover;
    this.remedy.textContent = `Set ${found.crossover} Hz`;
    this.remedy.title = found.text;
  }

  // Put the cursor at a frequency in Hz.
  private point(frequency: number): void {
    this.pictures.get("open_loop")?.putCursor(frequency);
  }

  // The same frequency in the Nyquist picture: L of now from the two curves of the open loop.
  private follow(x: number | null): void {
    this.cursor = x;
    const [chart, numbers] = [this.last?.said.charts.open_loop, this.last?.numbers];
    const nyquist = this.pictures.get("nyquist");
    if (!chart || !numbers || !nyquist) return;
    const [gain, phase] = chart.panels
      .slice(0, 2)
      .map((panel) => panel.curves.find((each) => each.number === 101 && each.look === "line"));
    const found =
      x === null || !gain || !phase ? null : [near(gain, numbers, x * chart.factor), near(phase, numbers, x * chart.factor)];
    if (!found || found.some((each) => each === null)) return nyquist.point(null);
    const size = chart.panels[0]!.scale === "log" ? found[0]! : 10 ** (found[0]! / 20);
    const angle = (found[1]! * Math.PI) / 180;
    nyquist.point({ x: size * Math.cos(angle), y: size * Math.sin(angle) });
  }

  private key(event: KeyboardEvent): void {
    if (this.element.closest("[hidden]") || !this.hint.hidden) return;
    const letter = event.key.toUpperCase();
    const act = (what: () => void) => {
      event.preventDefault();
      what();
    };
    if (event.ctrlKey || event.metaKey) {
      if (letter === "Z") act(() => this.ask({ do: event.shiftKey ? "tune.redo" : "tune.undo" }));
      else if (letter === "S") act(() => this.ask({ do: "tune.file" }));
      return;
    }
    const field = event.target instanceof HTMLElement && event.target.closest("input, select, textarea, [contenteditable]");
    if (event.altKey || field) return;
    if (LETTERS.includes(letter)) {
      if (event.shiftKey) act(() => this.ask({ do: "tune.keep", letter }));
      else if (this.snapshots.has(letter)) act(() => this.snapshots.toggle(letter));
    } else if (letter === "T") act(() => this.snapshots.toggle("today"));
    else if (letter === "N") act(() => this.ask({ do: "tune.add", kind: "notch", at: this.cursor }));
  }

  private tool(name: "undo" | "redo", title: string, keys: string, act: () => void): HTMLButtonElement {
    const made = button("", act, { id: name, class: "tool", title: `${title} (${keys})`, "aria-label": title, disabled: "" });
    made.append(icon(name));
    return made;
  }

  private picture(name: string, title: string): Picture {
    const known = this.pictures.get(name);
    if (known) return known;
    const made = new Picture(title, undefined, true);
    made.element.id = `picture-${name}`;
    made.element.hidden = true;
    made.hidden = this.snapshots.hidden;
    made.onsvg = (how, x) =>
      this.ask({ do: "tune.svg", name, how, hidden: this.snapshots.away, low: x?.low ?? null, high: x?.high ?? null });
    if (LIMITED.includes(name))
      this.levels.push(new Levels(name, made, (figure, height) => this.ask({ do: "tune.limit", figure, height })));
    this.pictures.set(name, made);
    this.grid.append(made.element);
    return made;
  }

  private held(picture: Picture | undefined): Handles | null {
    if (!picture) return null;
    const { ask } = this;
    const placed = {
      dragged: (name: string, x: number, y: number | null, first: boolean) => ask({ do: "tune.pole", name, x, y, first }),
      stepped: (name: string, across: number, up: number, first: boolean) =>
        ask({ do: "tune.pole_step", name, across, up, first }),
    };
    return new Handles(picture, placed, () => "×");
  }

  private draw(): void {
    if (!this.last || this.element.closest("[hidden]")) return;
    const { charts } = this.last.said;
    const [top, below] = [TOP.filter((each) => charts[each]), Object.keys(charts).filter((each) => !TOP.includes(each))];
    this.grid.dataset.top = top.join(" ");
    this.grid.dataset.below = String(Math.min(below.length, 4));
    for (const [name, picture] of this.pictures) picture.element.hidden = !charts[name]; // first: places depend on it
    for (const [name, picture] of this.pictures) if (charts[name]) picture.draw(charts[name], this.last.numbers, look());
    this.follow(this.cursor);
  }
}
