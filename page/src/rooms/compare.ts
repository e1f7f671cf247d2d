import { make } from "../parts";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

export class Compare implements Room {
  readonly name = "compare";
  readonly title = "Compare laws";
  readonly element = make("div", { class: "compare" });

  constructor(_ask: Ask) {}

  heard(_received: Received): void {}
}
