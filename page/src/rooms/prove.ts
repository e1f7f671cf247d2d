// The control of now is proven: a certificate, the circle test, and a part program on the machine.

import { button, choice, image, make } from "../parts";
import { result, type Result } from "../result";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

interface Words {
  ready: boolean;
  axes: string[];
  programs: string[];
  shown: Record<string, Result & { worst?: { image: string; text: string }[] }>;
  images: Record<string, string>;
}

const CAPTIONS: Record<string, string> = {
  "certificate.certificate": "What is proven, over frequency",
  "certificate.discs": "Discs of the loop in the complex plane",
  "circle.circle": "Circle test: the deviation, magnified",
  "circle.unrolled": "Deviation over the angle",
  "program.contour": "Contour error as color on the path",
};

export class Prove implements Room {
  readonly name = "prove";
  readonly title = "Prove";
  readonly element = make("div", { class: "prove" });

  constructor(private readonly ask: Ask) {}

  heard(received: Received): void {
    const words = received.said as unknown as Words;
    if (!words.ready) {
      this.element.replaceChildren(make("p", {}, "Bring a machine first: what moves on the machine needs its masses and limits."));
      return;
    }
    let [x, y] = [words.axes[0] ?? "", words.axes[1] ?? ""];
    let program = words.programs[0] ?? "";
    const axes = words.axes.map((each): [string, string] => [each, each]);
    const circle = [
      choice("x", axes, (value) => (x = value)),
      choice("y", [...axes.slice(1), ...axes.slice(0, 1)], (value) => (y = value)),
      button("Circle test", () => this.ask({ do: "prove.circle", x, y }), { id: "prove-circle" }),
    ];
    this.element.replaceChildren(
      make(
        "div",
        { class: "buttons" },
        button("Certify", () => this.ask({ do: "prove.certify" }), { id: "prove-certify", class: "main" }),
        choice("Part program", words.programs.map((each): [string, string] => [each, each]), (value) => (program = value)),
        button("Run it on the machine", () => this.ask({ do: "prove.program", name: program }), { id: "prove-program" }),
        ...(words.axes.length > 1 ? circle : []),
      ),
    );
    for (const [name, found] of Object.entries(words.shown)) {
      const drawn = Object.entries(CAPTIONS).filter(([key]) => key.startsWith(`${name}.`) && words.images[key]);
      this.element.append(
        make("h2", {}, { certificate: "Certificate", circle: "Circle test", program: "Part program" }[name] ?? name),
        make("div", { class: "grid" }, ...drawn.map(([key, caption]) => image(words.images[key]!, caption))),
        ...this.worst(found.worst ?? [], words.images),
        ...result(found),
      );
    }
  }

  private worst(places: { image: string; text: string }[], images: Record<string, string>): HTMLElement[] {
    if (!places.length) return [];
    const zoom = make("div", { "aria-live": "polite" });
    const list = places.map((each) =>
      make("li", {}, button(each.text, () => zoom.replaceChildren(image(images[`program.${each.image}`] ?? "", each.text)), { class: "worst" })),
    );
    return [make("h3", {}, "Worst places: choose one to see it enlarged"), make("ol", {}, ...list), zoom];
  }
}
