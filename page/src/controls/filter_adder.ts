// One more filter: of which kind, and at which frequency; the server knows the kinds, and a frequency if none is given.

import { button, make, renew } from "../parts";

export class FilterAdder {
  readonly element: HTMLElement;
  private readonly kind = make("select", { id: "add-kind", "aria-label": "Kind of the filter to add" });
  private readonly at = make("input", { id: "add-at", type: "text", inputmode: "decimal", size: "6", placeholder: "auto" });

  constructor(private readonly add: (kind: string, at: number | null) => void) {
    this.at.title =
      "Frequency in Hz. Empty: at the resonance beyond the crossover that comes closest to -1. A click into the open loop fills it in.";
    this.at.setAttribute("aria-label", "Frequency of the filter to add, Hz");
    const press = button("Add", () => this.send(), { id: "add-filter", title: "Add this filter (N: at the cursor)" });
    this.element = make("div", { class: "adder" }, this.kind, this.at, make("span", { class: "unit" }, "Hz"), press);
  }

  list(kinds: string[]): void {
    const now = this.kind.value || "notch";
    renew(this.kind, kinds, () => kinds.map((each) => make("option", { value: each }, each.replaceAll("_", " "))));
    this.kind.value = kinds.includes(now) ? now : (kinds[0] ?? "");
  }

  pick(frequency: number): void {
    this.at.value = String(Number(frequency.toPrecision(4)));
  }

  private send(): void {
    const typed = this.at.value.trim().replace(",", ".");
    if (typed !== "" && !Number.isFinite(Number(typed))) return this.at.focus();
    this.add(this.kind.value, typed === "" ? null : Number(typed));
    this.at.value = "";
  }
}
