// Text fields that the server fills, and what is typed into them.

import { make } from "../parts";

// What was typed, as a number; text that is none is sent as it is, so that the server refuses it by name.
export function numberOf(typed: string): number | string | null {
  const text = typed.trim();
  const value = Number(text.replace(",", "."));
  return text === "" ? null : Number.isFinite(value) ? value : text;
}

// A text field that is filled by the server unless somebody is writing into it.
export class Field {
  readonly input: HTMLInputElement;
  private dirty = false; // written into, and not yet sent

  constructor(label: string, size: string, changed: () => void, decimal = false) {
    this.input = make("input", { type: "text", size, "aria-label": label, ...(decimal ? { inputmode: "decimal" } : {}) });
    this.input.addEventListener("input", () => (this.dirty = true));
    this.input.addEventListener("escaped", () => (this.dirty = false));
    this.input.addEventListener("change", () => {
      this.dirty = false;
      changed();
    });
  }

  fill(text: string): void {
    if (!this.dirty && this.input.value !== text) this.input.value = text;
  }
}
