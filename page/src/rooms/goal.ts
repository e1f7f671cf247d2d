import { make } from "../parts";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

export class Goal implements Room {
  readonly name = "goal";
  readonly title = "Tune by goal";
  readonly element = make("div", { class: "goal" });

  constructor(_ask: Ask) {}

  heard(_received: Received): void {}
}
