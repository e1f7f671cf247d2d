// One more filter: of which kind, and at which frequency; the server knows the kinds, and a frequency if none is given.

import { button, make, renew } from "../parts";

export class FilterAdder {
  readonly element: HTMLElement;
  private readonly kind = make("select", { id: "add-kind" });
  private readonly at = make("input", { id: "add-at", type: "text", inputmode: "decimal", size: "7" });

  constructor(add: (kind: string, at: number | null) => void) {
    this.at.title = "Hz; empty: at the highest resonance beyond the crossover. A click into the open loop fills it in.";
    const press = button("Add filter", () => {
      const typed = this.at.value.trim().replace(",", ".");
      if (typed !== "" && !Number.isFinite(Number(typed))) return this.at.focus();
      add(this.kind.value, typed === "" ? null : Number(typed));
      this.at.value = "";
    }, { id: "add-filter" }); // prettier-ignore
    const kind = make("label", { for: "add-kind" }, "filter ", this.kind);
    const at = make("label", { for: "add-at" }, "at ", this.at, " Hz");
    const hint = make(
      "p",
      { class: "meaning" },
      "A click into the open loop picks the frequency; without one it begins where the loop is likely to want it.",
    );
    this.element = make("fieldset", { class: "adder" }, make("legend", {}, "one more filter"), kind, at, press, hint);
  }

  list(kinds: string[]): void {
    const now = this.kind.value || "notch";
    renew(this.kind, kinds, () => kinds.map((each) => make("option", { value: each }, each.replaceAll("_", " "))));
    this.kind.value = kinds.includes(now) ? now : (kinds[0] ?? "");
  }

  pick(frequency: number): void {
    this.at.value = String(Number(frequency.toPrecision(4)));
  }
}
