import { make } from "../parts";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

export class Take implements Room {
  readonly name = "take";
  readonly title = "Take away";
  readonly element = make("div", { class: "take" });

  constructor(_ask: Ask) {}

  heard(_received: Received): void {}
}
