// Dark or light: one choice for the whole page, first that of the system.

import { LOOKS, type Look } from "./picture";

const painted: (() => void)[] = [];

export function look(): Look {
  return LOOKS[document.documentElement.dataset.look === "dark" ? "dark" : "light"];
}

export function whenPainted(act: () => void): void {
  painted.push(act);
}

export function paint(dark: boolean): void {
  document.documentElement.dataset.look = dark ? "dark" : "light";
  for (const act of painted) act();
}
