// Frequencies of filters as lines in the open loop that can be dragged.

import type { Moved } from "./numbers";
import type { Picture } from "./picture";
import type { Knob } from "./wire";

export class Handles {
  private readonly lines = new Map<string, { knob: Knob; line: HTMLElement }>();
  private values: Record<string, number> = {};

  constructor(
    private readonly picture: Picture,
    private readonly moved: Moved,
  ) {
    picture.whenDrawn(() => this.show(this.values));
  }

  list(knobs: Knob[]): void {
    for (const { line } of this.lines.values()) line.remove();
    this.lines.clear();
    for (const knob of knobs.filter((each) => each.dragged)) {
      const line = document.createElement("div");
      line.className = "handle";
      line.title = `${knob.name}: drag to move`;
      const name = document.createElement("span");
      name.textContent = knob.block.replaceAll("_", " ");
      line.append(name);
      let held = false;
      line.addEventListener("pointerdown", (event) => {
        line.setPointerCapture(event.pointerId);
        held = false;
      });
      line.addEventListener("pointermove", (event) => {
        if (!line.hasPointerCapture(event.pointerId)) return;
        const box = this.picture.canvas.getBoundingClientRect();
        const x = this.picture.at([event.clientX - box.left, 40]);
        if (x === null) return;
        const wanted = Math.min(knob.high, Math.max(knob.low, Number(x.toPrecision(4))));
        this.moved(knob.name, wanted, !held);
        held = true;
      });
      this.picture.canvas.append(line);
      this.lines.set(knob.name, { knob, line });
    }
  }

  show(values: Record<string, number>): void {
    this.values = values;
    for (const [name, { line }] of this.lines) {
      const value = values[name];
      if (value !== undefined) line.style.left = `${this.picture.pixel(value)}px`;
    }
  }
}
