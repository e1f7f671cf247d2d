// The guided tour: a panel above all rooms, with the step that the server is at, and a mark at what is next.

import { button, make } from "./parts";
import type { Ask } from "./room";

export interface Step {
  label: string;
  number: number;
  of: number;
  title: string;
  text: string;
  room: string;
  marked: string[];
  next: string;
}

export class Tour {
  readonly element = make("section", { id: "tour", "aria-label": "Guided tour", hidden: "" });
  private readonly head = make("strong", { id: "tour-title" });
  private readonly text = make("p", { id: "tour-text", "aria-live": "polite" });
  private readonly back: HTMLButtonElement;
  private readonly next: HTMLButtonElement;
  private step: Step | null = null;
  private leading = false; // the room of the step was opened: what is next is focused once the server has said it
  private sought = false; // a step has begun, and what is next in it was not there yet

  constructor(
    ask: Ask,
    private readonly go: (room: string) => void,
  ) {
    this.back = button("Back", () => ask({ do: "tour.back" }), { id: "tour-back" });
    this.next = button("Next", () => ask({ do: "tour.next" }), { id: "tour-next" });
    const show = button("Show it", () => this.show(), { id: "tour-show", "aria-describedby": "tour-text" });
    const leave = button("Leave the tour", () => ask({ do: "tour.leave" }), { id: "tour-leave" });
    this.element.append(this.head, this.text, make("div", { class: "buttons" }, show, this.back, this.next, leave));
  }

  // What the server says with each answer; without a word of it there is no tour.
  heard(step: Step | null): void {
    const other = step?.number !== this.step?.number;
    this.step = step;
    this.element.hidden = step === null;
    if (step && other) {
      this.head.textContent = `${step.label} · step ${step.number} of ${step.of}: ${step.title}`;
      this.text.textContent = step.text;
      this.back.disabled = step.number === 1;
      this.next.textContent = step.next;
    }
    if (other) this.sought = true;
    this.mark();
    if (this.leading) this.focus();
    this.leading = false;
  }

  // Rooms draw their buttons anew, so that the mark is set again after each answer.
  mark(): void {
    const wanted = this.marked();
    for (const each of document.querySelectorAll(".tour-marked")) {
      if (wanted.includes(each as HTMLElement)) continue;
      each.classList.remove("tour-marked");
      each.removeAttribute("aria-describedby");
    }
    for (const each of wanted) {
      each.classList.add("tour-marked");
      each.setAttribute("aria-describedby", "tour-text");
    }
    const first = wanted.find((each) => each !== this.next && each.offsetParent !== null);
    if (!this.sought || !first) return;
    this.sought = false;
    first.scrollIntoView({ block: "nearest" });
  }

  private marked(): HTMLElement[] {
    return (this.step?.marked ?? []).map((id) => document.getElementById(id)).filter((each) => each !== null);
  }

  // Open the room of the step, and go to what is next there.
  private show(): void {
    if (!this.step) return;
    this.leading = document.getElementById(`room-${this.step.room}`)?.hidden ?? false;
    if (this.leading) this.go(this.step.room);
    else this.focus();
  }

  private focus(): void {
    const first = this.marked().find((each) => each !== this.next && each.offsetParent !== null) ?? this.next;
    first.scrollIntoView({ block: "center" });
    first.focus();
  }
}
