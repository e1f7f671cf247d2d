import { make } from "../parts";
import type { Ask, Room } from "../room";
import type { Received } from "../wire";

export class Scope implements Room {
  readonly name = "scope";
  readonly title = "Scope";
  readonly element = make("div", { class: "scope" });

  constructor(_ask: Ask) {}

  heard(_received: Received): void {}
}
