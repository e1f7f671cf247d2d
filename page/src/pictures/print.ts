// On paper: light colors, and all pictures drawn again in the width of a sheet.

import { paint } from "./look";

export function printable(): void {
  const page = document.documentElement;
  let dark = false;
  addEventListener("beforeprint", () => {
    dark = page.dataset.look === "dark";
    page.dataset.paper = "";
    paint(false);
  });
  addEventListener("afterprint", () => {
    delete page.dataset.paper;
    paint(dark);
  });
}
