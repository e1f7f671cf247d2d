// The figures that decide, always in view: now, limit, today, and inside or outside by shape, word and color.

import { icon, type Icon } from "../icons";
import { button, make, renew } from "../parts";

export type State = "kept" | "close" | "broken" | "free" | "open";
export interface Gauge {
  key: string;
  title: string;
  meaning: string;
  unit: string;
  value: string;
  today: string;
  option: string; // of the goal that holds the limit; empty: it cannot have one
  limit: string;
  bound: string;
  higher: boolean;
  state: Exclude<State, "open">;
  used: number;
  frequency: number | null;
}

export const SHAPES: Record<State, [Icon, string]> = {
  kept: ["kept", "limit kept"],
  close: ["close", "limit kept, less than 5 % left"],
  broken: ["broken", "limit broken"],
  free: ["free", "no limit"],
  open: ["unrun", "not computed yet"],
};

export class Strip {
  readonly element = make("div", { id: "strip", role: "group", "aria-label": "Figures that decide" });
  private readonly editor = make("form", { id: "limit-editor", hidden: "" });
  private readonly field = make("input", { type: "text", inputmode: "decimal", size: "6", id: "limit-field" });
  private readonly words = make("label", { for: "limit-field" });
  private edited: Gauge | null = null;
  private gauges: Gauge[] = [];

  constructor(
    private readonly limit: (gauge: Gauge, bound: string) => void,
    private readonly point: (frequency: number) => void,
  ) {
    const clear = button("No limit", () => this.send(""), { id: "limit-clear" });
    const close = button("Cancel", () => this.close(), { id: "limit-cancel" });
    this.editor.append(this.words, this.field, make("button", { type: "submit", class: "main" }, "Set"), clear, close);
    this.editor.addEventListener("submit", (event) => {
      event.preventDefault();
      this.send(this.field.value.trim());
    });
    this.editor.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.close();
    });
  }

  get popup(): HTMLElement {
    return this.editor;
  }

  show(gauges: Gauge[]): void {
    this.gauges = gauges;
    renew(
      this.element,
      gauges.map(({ key, title, meaning }) => [key, title, meaning]),
      () => gauges.map((each) => this.made(each)),
    );
    gauges.forEach((gauge, i) => this.fill(this.element.children[i] as HTMLElement, gauge));
  }

  // Put the cursor at the frequency that decides, and open the field of the limit below the figure.
  edit(gauge: Gauge): void {
    if (gauge.frequency !== null) this.point(gauge.frequency);
    if (!gauge.option) return;
    this.edited = gauge;
    this.words.textContent = `${gauge.title} ${gauge.higher ? "at least" : "at most"} (${gauge.unit || "no unit"}) `;
    this.field.value = gauge.bound;
    const place = this.element.querySelector<HTMLElement>(`[data-figure="${gauge.key}"]`)!;
    this.editor.hidden = false;
    const most = this.element.clientWidth - this.editor.offsetWidth;
    this.editor.style.left = `${Math.max(0, Math.min(place.offsetLeft, most))}px`;
    this.field.focus();
    this.field.select();
  }

  private made(gauge: Gauge): HTMLElement {
    const made = button("", () => this.edit(this.gauges.find((each) => each.key === gauge.key)!), {
      class: "gauge",
      "data-figure": gauge.key,
      title: gauge.option ? `${gauge.meaning}. Click to set its limit.` : gauge.meaning,
    });
    const shape = make("span", { class: "shape" });
    const value = make("span", { class: "value" }, make("b"), make("small"));
    made.append(make("span", { class: "name" }, gauge.title), shape, value);
    made.append(make("span", { class: "limit" }), make("span", { class: "today" }), make("i"));
    return made;
  }

  private fill(place: HTMLElement, gauge: Gauge): void {
    const [drawing, word] = SHAPES[gauge.state];
    const part = <Kind extends HTMLElement>(of: string) => place.querySelector<Kind>(of)!;
    if (place.dataset.state !== gauge.state) part(".shape").replaceChildren(icon(drawing, { role: "img", "aria-label": word }));
    place.dataset.state = gauge.state;
    part("b").textContent = gauge.value;
    part("small").textContent = gauge.unit ? ` ${gauge.unit}` : "";
    part(".limit").textContent = gauge.limit || "no limit";
    part(".today").textContent = `today ${gauge.today}`;
    part("i").style.width = `${100 * gauge.used}%`;
    place.setAttribute(
      "aria-label",
      `${gauge.title} ${gauge.value} ${gauge.unit}, ${gauge.limit ? `limit ${gauge.limit}, ` : ""}${word}, today ${gauge.today}`,
    );
  }

  private send(bound: string): void {
    const gauge = this.edited;
    this.close();
    if (gauge) this.limit(gauge, bound);
  }

  private close(): void {
    this.editor.hidden = true;
    if (this.edited) this.element.querySelector<HTMLElement>(`[data-figure="${this.edited.key}"]`)?.focus();
    this.edited = null;
  }
}
