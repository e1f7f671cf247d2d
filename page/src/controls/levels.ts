// A limit as a line over a picture that can be dragged up and down, or moved by the arrow keys.

import { make } from "../parts";
import type { Picture } from "../pictures/picture";

export interface Level {
  field: string;
  picture: string;
  at: number;
  text: string;
}

const STILL = 3; // pixels: a click that moves no further drags nothing

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
  private held: { from: number; moved: boolean } | null = null; // while it is dragged

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
    this.line.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !event.isPrimary) return;
      this.held = { from: event.clientY, moved: false };
      this.line.setPointerCapture(event.pointerId);
    });
    const drag = (event: PointerEvent): number | null => {
      if (!this.held || !this.line.hasPointerCapture(event.pointerId)) return null;
      this.held.moved ||= Math.abs(event.clientY - this.held.from) > STILL;
      return this.held.moved ? event.clientY - this.picture.canvas.getBoundingClientRect().top : null;
    };
    this.line.addEventListener("pointermove", (event) => {
      const y = drag(event);
      if (y !== null) this.line.style.top = `${y}px`;
    });
    this.line.addEventListener("pointerup", (event) => {
      if (event.button !== 0) return;
      const y = drag(event);
      this.held = null;
      if (y !== null) to(y);
    });
    this.line.addEventListener("pointercancel", () => {
      this.held = null;
      this.place();
    });
    this.line.addEventListener("keydown", (event) => {
      const way = { ArrowUp: -4, ArrowDown: 4 }[event.key];
      if (way === undefined) return;
      event.preventDefault();
      to(Number.parseFloat(this.line.style.top) + way);
    });
    // A zoom goes on below the line: a pointer that comes upon it would end it.
    const still = (on: boolean) => (this.line.style.pointerEvents = on ? "none" : "");
    picture.canvas.addEventListener("pointerdown", (event) => still(!this.line.contains(event.target as Node)));
    for (const end of ["pointerup", "pointercancel"]) addEventListener(end, () => setTimeout(() => still(false)));
    picture.canvas.append(this.line);
    picture.whenDrawn(() => this.place());
  }

  show(levels: Level[]): void {
    this.level = levels.find((each) => each.picture === this.of) ?? null;
    if (!this.level) {
      this.line.hidden = true;
      return;
    }
    this.name.textContent = this.level.text;
    this.line.setAttribute("aria-label", this.level.text);
    this.line.setAttribute("aria-valuenow", String(this.level.at));
    this.line.setAttribute("aria-valuetext", this.level.text);
    this.place();
  }

  private place(): void {
    if (this.held) return;
    const y = this.level && this.picture.pixelHeight(this.level.at);
    this.line.hidden = y === null || !this.picture.holds(this.level!.at); // it may have been zoomed out of sight
    if (y !== null) this.line.style.top = `${y}px`;
  }
}
