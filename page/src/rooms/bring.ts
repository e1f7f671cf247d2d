import { make } from "../parts";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

export class Bring implements Room {
  readonly name = "bring";
  readonly title = "Bring";
  readonly element = make("div", { class: "bring" });

  constructor(_ask: Ask) {}

  heard(_received: Received): void {}
}
