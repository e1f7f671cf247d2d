// The conversation with the server: one request at a time; of requests that wait, those of one drag are one.

import { session, type Request } from "./room";
import { decode, type Received } from "./wire";

const DRAGS = /\.(move|drag|speed|pole)$/;
const STEPS = /\.(step|pole_step)$/; // of keys that are held, and of the wheel: those that wait are added
const MOST = 100; // steps at once
const AGAIN = [1000, 3000]; // ms after which a lost connection is tried again

export class Talk {
  private socket: WebSocket | null = null;
  private waiting: Request[] = [];
  private under_way = false;
  private shows = false; // what is under way only asks what a room shows
  private number = 0;
  private tried = 0; // since the server last said something

  constructor(
    private readonly heard: (received: Received, shows: boolean) => void,
    private readonly opened: () => void,
    private readonly lost: (ended: boolean) => void, // it is tried again, or not any more
  ) {
    this.open();
  }

  ask(request: Request): void {
    const last = this.waiting.at(-1);
    if (last && last.do === request.do && DRAGS.test(request.do) && last.name === request.name && request.first === false) {
      Object.assign(last, { ...request, first: last.first });
    } else if (
      last &&
      last.do === request.do &&
      STEPS.test(request.do) &&
      last.name === request.name &&
      request.first === false
    ) {
      for (const way of ["across", "up"]) {
        last[way] = Math.max(-MOST, Math.min(MOST, Number(last[way]) + Number(request[way])));
      }
    } else {
      this.waiting.push({ ...request });
    }
    this.send();
  }

  private open(): void {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/talk`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.under_way = false;
      this.opened();
      this.send();
    };
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => {
      const received = decode(event.data);
      this.tried = 0;
      if (received.said.number > 0) this.under_way = false;
      if (!this.under_way) this.idle();
      this.heard(received, this.shows);
      this.send();
    };
    socket.onclose = () => {
      const wait = AGAIN[this.tried++];
      this.under_way = false;
      this.idle();
      if (wait !== undefined) setTimeout(() => this.open(), wait);
      this.lost(wait === undefined);
    };
    this.socket = socket;
  }

  private send(): void {
    if (this.under_way || this.socket?.readyState !== WebSocket.OPEN) return;
    const next = this.waiting.shift();
    if (!next) return;
    this.under_way = true;
    this.shows = next.do.endsWith(".show");
    document.documentElement.toggleAttribute("data-asked", true); // for those who wait for an answer, as tests do
    this.number += 1;
    const mine = this.number;
    setTimeout(() => {
      if (this.under_way && this.number === mine) document.documentElement.toggleAttribute("data-busy", true);
    }, 400);
    this.socket.send(JSON.stringify({ ...next, number: this.number, session: session() }));
  }

  private idle(): void {
    for (const each of ["data-asked", "data-busy"]) document.documentElement.toggleAttribute(each, false);
  }
}
