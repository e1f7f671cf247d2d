// Dark or light: one choice for the whole page, first that of the system.

// the colors of the reports (plot/style.py), brighter ones on dark paper
export interface Look {
  paper: string;
  ink: string;
  muted: string;
  line: string;
  alert: string;
  curves: string[];
  heat: string[]; // from small to large values
}
const LOOKS: Record<"light" | "dark", Look> = {
  light: {
    paper: "#ffffff", ink: "#1c2329", muted: "#5a6772", line: "#d9dfe4", alert: "#b3261e",
    curves: ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"],
    heat: ["#54b0d7", "#4197db", "#5e79d3", "#8554b2", "#98277f", "#8a0c47", "#6c0b1b"],
  }, // prettier-ignore
  dark: {
    paper: "#14191e", ink: "#e6eaee", muted: "#a2adb8", line: "#39424b", alert: "#ff8a80",
    curves: ["#56b4e9", "#ff9d5c", "#35c79b", "#e7a8cb", "#f0c04d", "#9ad2f2"],
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

// The color of a curve by its number: -1 is muted, -2 is an alert.
export function color(number: number, look: Look): string {
  if (number === -2) return look.alert;
  return number < 0 ? look.muted : look.curves[number % look.curves.length]!;
}
