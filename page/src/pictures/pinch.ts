// Two fingers on a picture zoom it, as on a map; one finger scrolls the page.

import type { Range } from "./panel";

interface Zoomed {
  area: () => DOMRect; // of the plot, within which fingers count
  scale: () => (share: number) => number; // x at a share of its width, as it is shown now
  show: (x: Range) => void; // while the fingers move
  ended: (x: Range | null) => void; // when one was lifted; null for all, after they came together
}

export function pinch(surface: HTMLElement, picture: Zoomed): void {
  const fingers = new Map<number, number>(); // share of the width, by pointer
  let begun: { shares: [number, number]; at: (share: number) => number } | null = null;
  let shown: Range | null = null;
  let together = false;
  const share = (event: PointerEvent): number => {
    const { left, width } = picture.area();
    return (event.clientX - left) / width;
  };
  const both = (): [number, number] => [...fingers.values()].sort((a, b) => a - b) as [number, number];
  const lifted = (event: PointerEvent): void => {
    fingers.delete(event.pointerId);
    if (begun && together) picture.ended(null);
    else if (begun && shown) picture.ended(shown);
    begun = shown = null;
    together = false;
  };
  surface.style.touchAction = "pan-x pan-y"; // the browser does not zoom the page here
  surface.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "touch") return;
    fingers.set(event.pointerId, share(event));
    begun = fingers.size === 2 ? { shares: both(), at: picture.scale() } : null;
  });
  surface.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    fingers.set(event.pointerId, share(event));
    if (!begun) return;
    const [a, b] = begun.shares;
    const [c, d] = both();
    if (b - a < 0.02 || d - c < 0.02) return; // above each other
    const wide = (b - a) / (d - c);
    together = wide > 1;
    if (together) return;
    const from = Math.max(0, a - c * wide);
    shown = { low: begun.at(from), high: begun.at(Math.min(1, from + wide)) };
    picture.show(shown);
  });
  for (const name of ["pointerup", "pointercancel"] as const) surface.addEventListener(name, lifted);
}
