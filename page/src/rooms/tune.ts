// Tuning by hand: numbers at the left, pictures that follow them, and what the limits say.

import { FilterAdder } from "../controls/filter_adder";
import { WholeLoop, type Faster } from "../controls/whole_loop";
import { Handles, type Grip } from "../controls/handles";
import { Numbers } from "../controls/numbers";
import { Picture } from "../pictures/picture";
import { button, make, save } from "../parts";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";
import { look, whenPainted } from "../pictures/look";
import { Choices, type Choice, type Unit } from "../controls/choices";

const LETTERS = ["A", "B", "C"];

export class Tune implements Room {
  readonly name = "tune";
  readonly title = "Tune by hand";
  readonly element = make("div", { class: "tune" });
  private readonly pictures = new Map<string, Picture>(); // in the order of the server
  private readonly grid = make("div", { class: "grid" });
  private readonly see: Choices;
  private readonly verdict = make("p", { id: "verdict", "aria-live": "polite" });
  private readonly remarks = make("ul", { "aria-label": "Remarks" });
  private readonly undo: HTMLButtonElement;
  private readonly redo: HTMLButtonElement;
  private readonly takes = new Map<string, HTMLButtonElement>();
  private readonly numbers: Numbers;
  private readonly whole: WholeLoop;
  private readonly adder: FilterAdder;
  private readonly handles: Handles;
  private poles: Handles | null = null;
  private readonly figures = make("p", { id: "figures" });
  private readonly poles_said = make("p", { id: "poles-said", class: "meaning", hidden: "" });
  private readonly hint = make("p", { class: "hint", hidden: "" }, "Bring a machine or a measured response first.");
  private grips: Grip[] = [];
  private last: Received | null = null;

  constructor(private readonly ask: Ask) {
    const moved = (name: string, value: number | string, first: boolean) => ask({ do: "tune.move", name, value, first });
    const section = make("section", { id: "numbers", "aria-label": "Numbers of the control", tabindex: "0" });
    const list = make("div", { id: "numbers-list" });
    this.whole = new WholeLoop((value, first) => ask({ do: "tune.speed", value, first }));
    this.adder = new FilterAdder((kind, at) => ask({ do: "tune.add", kind, at }));
    this.numbers = new Numbers(list, moved, (place) => ask({ do: "tune.remove", place }));
    section.append(this.whole.element, this.adder.element, list);
    this.undo = button("Undo", () => ask({ do: "tune.undo" }), { id: "undo", title: "Ctrl+Z" });
    this.redo = button("Redo", () => ask({ do: "tune.redo" }), { id: "redo", title: "Ctrl+Shift+Z" });
    const buttons = make("div", { class: "buttons" }, this.undo, this.redo);
    buttons.append(button("Today's values", () => ask({ do: "tune.reset" }), { id: "reset" }));
    for (const letter of LETTERS) {
      const take = button(letter, () => ask({ do: "tune.take", letter }), {
        id: `take-${letter}`,
        "aria-label": `Go to ${letter}`,
      });
      this.takes.set(letter, take);
      buttons.append(
        button(`Keep as ${letter}`, () => ask({ do: "tune.keep", letter })),
        take,
      );
    }
    buttons.append(button("Save machine file", () => ask({ do: "tune.file" }), { id: "save" }));
    this.see = new Choices(ask);
    const open_loop = this.picture("open_loop", "Open loop");
    open_loop.onpick = (x) => this.adder.pick(x);
    const held = {
      dragged: (name: string, x: number, y: number | null, first: boolean) => ask({ do: "tune.drag", name, x, y, first }),
      stepped: (name: string, across: number, up: number, first: boolean) => ask({ do: "tune.step", name, across, up, first }),
      turned: (name: string, steps: number, first: boolean) => {
        const width = name.replace(/[^.]*$/, "width");
        const there = this.grips.some((each) => each.name === width);
        if (there && steps) ask({ do: "tune.step", name: width, across: steps, up: 0, first });
        return there;
      },
      removed: (name: string) => ask({ do: "tune.remove", place: Number(name.split(".")[1]) }),
    };
    this.handles = new Handles(open_loop, held, (grip) => (grip.name.endsWith(".width") ? "↔" : grip.name.split(".")[1]!));
    this.element.append(
      this.hint,
      section,
      make(
        "section",
        { id: "pictures", "aria-label": "Pictures" },
        buttons,
        this.see.element,
        this.verdict,
        this.figures,
        this.poles_said,
        this.grid,
        this.remarks,
      ),
    );
    document.addEventListener("keydown", (event) => {
      if (
        this.element.closest("[hidden]") ||
        !this.hint.hidden ||
        !(event.ctrlKey || event.metaKey) ||
        event.key.toLowerCase() !== "z"
      )
        return;
      event.preventDefault();
      ask({ do: event.shiftKey ? "tune.redo" : "tune.undo" });
    });
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    const { said } = received;
    if (said.file !== undefined) return save(said.file, said.file_name ?? "machine.toml");
    if (said.knobs) {
      this.numbers.list(said.knobs);
      this.hint.hidden = said.knobs.length > 0; // without numbers nothing here could do anything
      for (const each of this.element.children) if (each !== this.hint) (each as HTMLElement).hidden = !this.hint.hidden;
    }
    if (said.pictures) {
      const choices = said.pictures as Choice[];
      for (const { name, title } of choices) this.picture(name, title);
      this.poles ??= this.held(this.pictures.get("poles"));
      this.see.list(choices, said.units as Unit[]);
    }
    if (said.values) this.numbers.show(said.values);
    if (said.kinds) this.adder.list(said.kinds as string[]);
    if (said.faster) this.whole.list(said.faster as Faster);
    if (said.speed !== undefined) this.whole.show(said.speed as number | null);
    if (said.grips) this.grips = said.grips as Grip[];
    if (said.judged) {
      this.figures.textContent = String(said.figures ?? "");
      this.undo.disabled = !said.undo;
      this.redo.disabled = !said.redo;
      for (const [letter, take] of this.takes) take.disabled = !said.kept?.includes(letter);
      const all = said.stable && said.judged.every((each) => each.keeps);
      const words = said.judged.map((each) => (each.keeps ? each.text : `${each.text}: broken`)).join("; ");
      const place = Number(said.places ?? 1) > 1 ? ` Worst of ${said.places} places: ${said.leading}.` : "";
      this.verdict.textContent = `${said.stable ? words : `Not stable. ${words}`}${place}`;
      this.remarks.replaceChildren(...((said.remarks as string[] | undefined) ?? []).map((each) => make("li", {}, each)));
      this.verdict.className = all ? "good" : "bad";
    }
    if (said.values) {
      this.last = received;
      this.draw();
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

  private picture(name: string, title: string): Picture {
    const known = this.pictures.get(name);
    if (known) return known;
    const made = new Picture(title);
    made.element.id = `picture-${name}`;
    made.element.hidden = true;
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
    for (const [name, picture] of this.pictures) {
      const chart = this.last.said.charts[name];
      picture.element.hidden = !chart;
      if (chart) picture.draw(chart, this.last.numbers, look());
    }
  }
}
