// All laws at equal robustness: the trade-off, and a law that is chosen to be tuned on.

import { button, image, make, table } from "../parts";
import { result, type Result } from "../result";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

interface Words {
  ready: boolean;
  found: (Result & { laws: { name: string; why: string; held: string }[]; rule: string; seed: number }) | null;
  images?: Record<string, string>;
  go?: string;
}

export class Compare implements Room {
  readonly name = "compare";
  readonly title = "Compare laws";
  readonly element = make("div", { class: "compare" });

  constructor(private readonly ask: Ask) {}

  heard(received: Received): void {
    const words = received.said as unknown as Words;
    const starts = make("input", { type: "number", min: "1", max: "20", value: "2", id: "compare-starts" });
    const start = button("Compare all laws", () => this.ask({ do: "compare.start", laws: [], starts: Number(starts.value) }), { id: "compare-start", class: "main" });
    start.disabled = !words.ready;
    const head = make("div", { class: "buttons" }, start, make("label", { for: starts.id }, "searches for each law ", starts));
    const { found } = words;
    this.element.replaceChildren(head);
    if (!words.ready) this.element.append(make("p", {}, "Bring a machine first: a measured response alone has no laws to compare."));
    else if (!found) this.element.append(make("p", {}, "This takes minutes. Laws that are finished are kept: after a cancel the comparison goes on where it was."));
    if (found) {
      const rows = found.laws.map((law) => [
        law.name,
        law.why || "at equal robustness",
        law.held,
        button("Tune on with it", () => this.ask({ do: "compare.take", law: law.name }), { "aria-label": `Tune on with ${law.name}` }),
      ]);
      this.element.append(
        make("p", {}, `Rule: ${found.rule} Seed ${found.seed}.`),
        image(words.images?.tradeoff ?? "", "Stiffness over tracking error: better is left and up"),
        table(["law", "ranked", "held back by", ""], rows),
        ...result(found),
      );
    }
    if (words.go) document.dispatchEvent(new CustomEvent("go", { detail: words.go }));
  }
}
