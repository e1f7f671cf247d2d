// Small drawings on a 20 x 20 grid, in the color of the text beside them.

const SVG = "http://www.w3.org/2000/svg";

export const ICONS = {
  logo: "M2 16h16M4 16l3-10M9.500 16l3-10M15 16l3-10",
  import: "M10 2.500v9M6.500 8l3.500 3.500L13.500 8M3 13v4h14v-4",
  commission: "M11 2.500L5 11h4.500L8.500 17.500 15 9h-4.500z",
  scope: "M2.500 4.500h15v11h-15zM5 10h2l1.500-3 2.500 6 1.500-3H15",
  tune: "M3 5.500h7M14 5.500h3M12 3.500v4M3 10h2M9 10h8M7 8v4M3 14.500h8M15 14.500h2M13 12.500v4",
  optimize: "M10 3a7 7 0 1 0 7 7M10 7a3 3 0 1 0 3 3M10 10l6.500-6.500M13.500 3.500l3 0 0 3",
  compare: "M3 17V9M8 17V4M13 17v-6M18 17V7",
  prove: "M10 2.500l6 2v5c0 4-2.500 6.500-6 8-3.500-1.500-6-4-6-8v-5zM7 10l2.200 2.200L13 8",
  program: "M3 15.500c3.500 0 2-10 6-10s2 8 5.500 8M14.500 13.500V4M12.500 4h4M3 15.500v.010",
  play: "M6 4l10 6-10 6z",
  pause: "M7 4v12M13 4v12",
  export: "M10 11.500v-9M6.500 6L10 2.500 13.500 6M3 13v4h14v-4",
  undo: "M7.500 4L4 7.500 7.500 11M4 7.500h8a4 4 0 0 1 0 8H8",
  redo: "M12.500 4L16 7.500 12.500 11M16 7.500H8a4 4 0 0 0 0 8h4",
  dark: "M16 12A6.500 6.500 0 0 1 8 4a6.500 6.500 0 1 0 8 8z",
  large: "M11.500 3H17v5.500M17 3l-5.500 5.500M8.500 17H3v-5.500M3 17l5.500-5.500",
  copy: "M7 7h10v10H7zM13 7V3H3v10h4",
  remove: "M5 5l10 10M15 5L5 15",
  kept: "M10 2a8 8 0 1 0 .01 0zM6.500 10.200l2.500 2.500 4.500-5",
  close: "M10 3l8 14H2zM10 8.500v3.500M10 14.500v.01",
  broken: "M10 1.500L18.500 10 10 18.500 1.500 10zM7.500 7.500l5 5M12.500 7.500l-5 5",
  free: "M6 10h8",
  unrun: "M10 2a8 8 0 1 0 .01 0z",
} as const;
export type Icon = keyof typeof ICONS;

export function icon(name: Icon, attributes: Record<string, string> = {}): SVGSVGElement {
  const drawing = document.createElementNS(SVG, "svg");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", ICONS[name]);
  for (const [key, value] of Object.entries({
    viewBox: "0 0 20 20",
    class: "icon",
    "aria-hidden": "true",
    "data-icon": name,
    ...attributes,
  }))
    drawing.setAttribute(key, value);
  drawing.append(path);
  return drawing;
}

// A shape that is filled, with its sign in the color of the ground: a verdict that gray print still shows.
export function solid(name: "kept" | "broken"): SVGSVGElement {
  const drawing = icon(name, { class: "icon solid", "data-icon": name });
  const [outline = "", ...sign] = ICONS[name].split(/(?=M)/);
  const ground = document.createElementNS(SVG, "path");
  ground.setAttribute("d", outline);
  ground.setAttribute("class", "ground");
  drawing.querySelector("path")!.setAttribute("d", sign.join(""));
  drawing.prepend(ground);
  return drawing;
}

// A sample of a line with its dashes, as in the pictures.
export function line(color: string, dashes: number[]): SVGSVGElement {
  const drawing = document.createElementNS(SVG, "svg");
  const stroke = document.createElementNS(SVG, "line");
  for (const [key, value] of Object.entries({ viewBox: "0 0 22 8", class: "line", "aria-hidden": "true" }))
    drawing.setAttribute(key, value);
  for (const [key, value] of Object.entries({ x1: "0", x2: "22", y1: "4", y2: "4", "stroke-width": "2.4" }))
    stroke.setAttribute(key, value);
  stroke.setAttribute("stroke", color);
  stroke.setAttribute("stroke-dasharray", dashes.join(" "));
  drawing.append(stroke);
  return drawing;
}
