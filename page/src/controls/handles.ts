// Places in a picture by which something is held: dragged across and up, or moved by the arrow keys.

import { make } from "../parts";
import type { Picture } from "../pictures/picture";

// Where it is, in SI across and in the unit of the picture up, and what it says.
export interface Grip {
  name: string;
  x: number;
  y: number;
  low: number; // between which x may lie
  high: number;
  label: string;
  text: string;
}

export interface Held {
  dragged(name: string, x: number, y: number | null, first: boolean): void; // y is null with Shift: only across
  stepped(name: string, across: number, up: number, first: boolean): void; // not first: of a key that is held
  turned?(name: string, steps: number, first: boolean): boolean; // by the wheel; false if it means nothing here
  removed?(name: string): void; // by the key Delete
}

const KEYS: Record<string, [number, number]> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowDown: [0, -1],
  ArrowUp: [0, 1],
  PageDown: [0, -10],
  PageUp: [0, 10],
};

const NOTCH = 100; // pixels of a notch of the wheel, which is one step: a trackpad sends few at a time
const PAUSE = 300; // ms after which turning it is another step to undo

export class Handles {
  private readonly shown = new Map<string, { grip: Grip; element: HTMLElement }>();

  constructor(
    private readonly picture: Picture,
    private readonly held: Held,
    private readonly sign: (grip: Grip) => string, // a letter or two on it
    private readonly at_edge = false, // one beyond the edge stands at the edge, with an arrow
  ) {
    picture.whenDrawn(() => this.place());
  }

  show(grips: Grip[]): void {
    const names = new Set(grips.map((each) => each.name));
    for (const [name, { element }] of this.shown) {
      if (names.has(name)) continue;
      element.remove();
      this.shown.delete(name);
    }
    for (const grip of grips) {
      const known = this.shown.get(grip.name) ?? { grip, element: this.made(grip) };
      known.grip = grip;
      this.shown.set(grip.name, known);
      known.element.title = `${grip.label}: ${grip.text}\nDrag it, with Shift across only; or use the arrow keys.${this.held.removed ? " Delete removes it." : ""}`;
      known.element.setAttribute("aria-label", grip.label);
      known.element.setAttribute("aria-valuemin", String(grip.low));
      known.element.setAttribute("aria-valuemax", String(grip.high));
      known.element.setAttribute("aria-valuenow", String(grip.x));
      known.element.setAttribute("aria-valuetext", grip.text);
    }
    this.place();
  }

  private made(grip: Grip): HTMLElement {
    const { name } = grip;
    const element = make(
      "div",
      { class: "grip", role: "slider", tabindex: "0", "data-grip": name },
      make("span", {}, this.sign(grip)),
    );
    let [off, first] = [[0, 0], true];
    let turned = { at: -Infinity, by: 0, first: true }; // the wheel: when it was last, and what is left of a step
    element.addEventListener("pointerdown", (event) => {
      const box = element.getBoundingClientRect();
      off = [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2];
      first = true;
      element.setPointerCapture(event.pointerId);
      event.stopPropagation();
    });
    element.addEventListener("pointermove", (event) => {
      if (!element.hasPointerCapture(event.pointerId)) return;
      const box = this.picture.canvas.getBoundingClientRect();
      const [across, up] = [event.clientX - box.left - off[0]!, event.clientY - box.top - off[1]!];
      const [x, y] = [this.picture.across(across), this.picture.height(up)];
      if (x === null || y === null) return;
      this.held.dragged(name, x, event.shiftKey ? null : y, first);
      first = false;
    });
    element.addEventListener("keydown", (event) => {
      if (event.key === "Delete") this.held.removed?.(name);
      const way = KEYS[event.key];
      if (!way || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      event.stopPropagation();
      this.held.stepped(name, way[0] * (event.shiftKey ? 10 : 1), way[1], !event.repeat);
    });
    element.addEventListener(
      "wheel",
      (event) => {
        if (event.timeStamp - turned.at > PAUSE) turned = { at: 0, by: 0, first: true };
        const by = turned.by - event.deltaY;
        const steps = Math.trunc(by / NOTCH);
        if (this.held.turned?.(name, steps, turned.first)) event.preventDefault();
        turned = { at: event.timeStamp, by: by - steps * NOTCH, first: turned.first && steps === 0 };
      },
      { passive: false },
    );
    this.picture.canvas.append(element);
    return element;
  }

  private place(): void {
    const area = this.at_edge ? this.picture.box : null;
    for (const { grip, element } of this.shown.values()) {
      const [left, top] = [this.picture.pixel(grip.x), this.picture.pixelHeight(grip.y)];
      const edge = area && top !== null ? kept(left, top, area) : null;
      const beyond = edge !== null && edge.way !== "" && !grip.name.endsWith(".width");
      element.hidden = top === null || (!beyond && this.picture.at([left, top]) === null); // it may have been zoomed out of sight
      element.dataset.beyond = beyond ? edge.way : "";
      element.style.left = `${beyond ? edge.left : left}px`;
      element.style.top = `${(beyond ? edge.top : top) ?? 0}px`;
    }
  }
}

// A place within an area, and the way to what lies beyond its edge.
function kept(left: number, top: number, area: DOMRect): { left: number; top: number; way: string } {
  const [x, y] = [Math.min(Math.max(left, area.left), area.right), Math.min(Math.max(top, area.top), area.bottom)];
  const way = left > x + 0.5 ? "right" : left < x - 0.5 ? "left" : top > y + 0.5 ? "down" : top < y - 0.5 ? "up" : "";
  return { left: x, top: y, way };
}
