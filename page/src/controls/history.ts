// What was changed, the last step first; a click goes there, back or forth.

import { button, make, renew } from "../parts";

export interface Change {
  text: string;
  steps: number; // to undo to get there; negative: to redo
}

export class History {
  readonly element = make("section", { class: "history", "aria-label": "History" });
  private readonly list = make("ol", { id: "history" });

  constructor(private readonly go: (steps: number) => void) {
    this.element.append(make("h2", {}, "History"), this.list);
  }

  show(changes: Change[]): void {
    renew(this.list, changes, () =>
      changes.map(({ text, steps }) => {
        const words = steps === 0 ? "now" : steps < 0 ? "undone" : "";
        const step = button(text, () => steps && this.go(steps), steps === 0 ? { "aria-current": "step" } : {});
        return make("li", { class: steps < 0 ? "undone" : "" }, step, make("span", {}, words));
      }),
    );
  }
}
