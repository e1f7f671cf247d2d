// A limit as a line over a picture that can be dragged up and down, or moved by the arrow keys.

import { make } from "../parts";
import type { Picture } from "../pictures/picture";

export interface Level {
  field: string;
  picture: string;
  at: number;
  text: string;
}

export class Levels {
  private readonly line = make("div", {
    class: "level",
    role: "slider",
    tabindex: "0",
    hidden: "",
    "aria-orientation": "vertical",
  });
  private readonly name = make("span");
  private level: Level | null = null;

  constructor(
    private readonly of: string,
    private readonly picture: Picture,
    moved: (field: string, value: number) => void,
  ) {
    this.line.append(this.name);
    const to = (y: number): void => {
      const value = this.picture.height(y);
      if (this.level && value !== null) moved(this.level.field, value);
    };
    this.line.addEventListener("pointerdown", (event) => this.line.setPointerCapture(event.pointerId));
    this.line.addEventListener("pointermove", (event) => {
      if (!this.line.hasPointerCapture(event.pointerId)) return;
      this.line.style.top = `${event.clientY - this.picture.canvas.getBoundingClientRect().top}px`;
    });
    this.line.addEventListener("pointerup", (event) => to(event.clientY - this.picture.canvas.getBoundingClientRect().top));
    this.line.addEventListener("keydown", (event) => {
      const way = { ArrowUp: -4, ArrowDown: 4 }[event.key];
      if (way === undefined) return;
      event.preventDefault();
      to(Number.parseFloat(this.line.style.top) + way);
    });
    picture.canvas.append(this.line);
    picture.whenDrawn(() => this.place());
  }

  show(levels: Level[]): void {
    this.level = levels.find((each) => each.picture === this.of) ?? null;
    this.line.hidden = this.level === null;
    if (!this.level) return;
    this.name.textContent = this.level.text;
    this.line.setAttribute("aria-label", this.level.text);
    this.line.setAttribute("aria-valuenow", String(this.level.at));
    this.line.setAttribute("aria-valuetext", this.level.text);
    this.place();
  }

  private place(): void {
    const y = this.level && this.picture.pixelHeight(this.level.at);
    if (y !== null) this.line.style.top = `${y}px`;
  }
}
