// Dark or light: one choice for the whole page, first that of the system.

// the colors of the reports (plot/style.py), brighter ones on dark paper
export interface Look {
  paper: string;
  ink: string;
  muted: string;
  line: string;
  alert: string;
  curves: string[];
  named: string[]; // of curves with a number from NAMED on: today, now, A, B, C, found, worst plant of it
  heat: string[]; // from small to large values
}
const LOOKS: Record<"light" | "dark", Look> = {
  light: {
    paper: "#ffffff", ink: "#12171c", muted: "#5a6570", line: "#e6eaee", alert: "#b81f2b",
    curves: ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"],
    named: ["#66717c", "#0a5fc4", "#00735f", "#8a3fb5", "#995200", "#00735f", "#8a3fb5"],
    heat: ["#54b0d7", "#4197db", "#5e79d3", "#8554b2", "#98277f", "#8a0c47", "#6c0b1b"],
  }, // prettier-ignore
  dark: {
    paper: "#14181d", ink: "#eef2f5", muted: "#98a4af", line: "#29313a", alert: "#ff8583",
    curves: ["#56b4e9", "#ff9d5c", "#35c79b", "#e7a8cb", "#f0c04d", "#9ad2f2"],
    named: ["#9aa6b1", "#5ab0ff", "#3ccfab", "#cf9bf5", "#eeb062", "#3ccfab", "#cf9bf5"],
    heat: ["#256acf", "#a066ce", "#e464b6", "#ff7c97", "#ffa28d", "#ffc28b", "#fce26c"],
  }, // prettier-ignore
};

const painted: (() => void)[] = [];

export function look(): Look {
  return LOOKS[document.documentElement.dataset.look === "dark" ? "dark" : "light"];
}

export function whenPainted(act: () => void): void {
  painted.push(act);
}

export function paint(dark: boolean): void {
  document.documentElement.dataset.look = dark ? "dark" : "light";
  document.getElementById("dark")?.setAttribute("aria-pressed", String(dark));
  for (const act of painted) act();
}

export const NAMED = 100; // the least number of a curve whose color and dashes stay, whatever other curves there are

// The color of a curve by its number: -1 is muted, -2 is an alert.
export function color(number: number, look: Look): string {
  if (number === -2) return look.alert;
  if (number >= NAMED) return look.named[(number - NAMED) % look.named.length]!;
  return number < 0 ? look.muted : look.curves[number % look.curves.length]!;
}
