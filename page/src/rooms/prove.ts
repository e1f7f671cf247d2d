import { make } from "../parts";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

export class Prove implements Room {
  readonly name = "prove";
  readonly title = "Prove";
  readonly element = make("div", { class: "prove" });

  constructor(_ask: Ask) {}

  heard(_received: Received): void {}
}
