// Two controls in one large picture: left of a line the one, right of it the other; the line is dragged across.

import { make } from "../parts";

export type Named = [number: number, name: string];
export interface Wiped {
  left: number; // numbers of their curves
  right: number;
  at: number; // where the line stands, as a share of the width
}

const [FINE, COARSE] = [0.01, 0.1]; // shares of the width: a step of an arrow key, and with Shift

export class Wipe {
  readonly element = make("div", { class: "wipe", hidden: "" });
  private readonly line = make("div", {
    class: "divider",
    role: "slider",
    tabindex: "0",
    "aria-label": "Divider between the two controls",
    "aria-valuemin": "0",
    "aria-valuemax": "100",
    title: "Drag it, or use the arrow keys; Esc ends the comparison.",
  });
  private readonly left = make("select", { "aria-label": "Control at the left" });
  private readonly right = make("select", { "aria-label": "Control at the right" });
  private at: number | null = null; // null: nothing is compared
  private offered = "";

  // `ended` and `moved` draw the picture again; `box` is where its content lies.
  constructor(
    private readonly moved: () => void,
    private readonly ended: () => void,
    private readonly box: () => DOMRect | null,
  ) {
    this.element.append(this.left, this.right, this.line);
    for (const each of [this.left, this.right]) each.addEventListener("change", () => this.moved());
    this.line.addEventListener("pointerdown", (event) => {
      this.line.setPointerCapture(event.pointerId);
      event.stopPropagation();
    });
    this.line.addEventListener("pointermove", (event) => {
      const [area, box] = [this.element.parentElement?.getBoundingClientRect(), this.box()];
      if (area && box && this.line.hasPointerCapture(event.pointerId))
        this.to((event.clientX - area.left - box.left) / box.width);
    });
    this.element.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (event.key === "Escape") this.ended();
      else if (way !== undefined && event.target === this.line) this.to(this.at! + way * (event.shiftKey ? COARSE : FINE));
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
  }

  get on(): boolean {
    return this.at !== null;
  }

  // Begin with two controls, or end.
  begin(left: number, right: number): void {
    this.at = 0.5;
    this.element.hidden = false;
    this.offered = "";
    [this.left.dataset.first, this.right.dataset.first] = [String(left), String(right)];
    this.moved();
    this.line.focus();
  }

  end(): void {
    this.at = null;
    this.element.hidden = true;
  }

  // What is compared now, of the controls that a picture has.
  shown(controls: Named[]): Wiped | null {
    if (this.at === null || controls.length < 2) return null;
    if (this.offered !== String(controls)) {
      for (const each of [this.left, this.right]) {
        const held = each.dataset.first ?? each.value;
        delete each.dataset.first;
        each.replaceChildren(...controls.map(([number, name]) => make("option", { value: String(number) }, name)));
        if (controls.some(([number]) => String(number) === held)) each.value = held;
      }
      this.offered = String(controls);
    }
    return { left: Number(this.left.value), right: Number(this.right.value), at: this.at };
  }

  // Put the line where it belongs; the two names stand at its sides.
  place(): void {
    const box = this.box();
    if (this.at === null || !box) return;
    this.element.style.left = `${box.left + this.at * box.width}px`;
    const names = [this.left, this.right].map((each) => each.selectedOptions[0]?.textContent ?? "");
    this.line.setAttribute("aria-valuenow", String(Math.round(100 * this.at)));
    this.line.setAttribute("aria-valuetext", `${names[0]} in the left ${Math.round(100 * this.at)} %, ${names[1]} beside it`);
  }

  private to(share: number): void {
    this.at = Math.min(1, Math.max(0, share));
    this.moved();
  }
}
