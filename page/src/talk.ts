// The conversation with the server: one request at a time; of requests that wait, those of one drag are one.

import { session, type Request } from "./room";
import { decode, type Received } from "./wire";

const DRAGS = /\.(move|drag|speed|pole)$/;
const STEPS = /\.(step|pole_step)$/; // of keys that are held, and of the wheel: those that wait are added
const SAME = /\.(show|move|drag|speed|pole|set|level|role|unit|axis|see|window|find)$/; // asked twice is asked once
const MOST = 100; // steps at once
const AGAIN = [500, 1000, 2000, 3000]; // ms after which a lost connection is tried again; then always the last

// What is known of a lost connection.
export interface Lost {
  since: number; // performance.now()
  tried: number;
  stranger: boolean; // a server is there again, and does not know this browser
  waiting: number; // requests that are sent once it is back
  doubtful: string; // what was asked when it broke, and may not be asked twice
}

export class Talk {
  private socket: WebSocket | null = null;
  private waiting: Request[] = [];
  private under_way: Request | null = null;
  private number = 0;
  private lost: Lost | null = null;

  constructor(
    private readonly heard: (received: Received, shows: boolean) => void,
    private readonly opened: () => void,
    private readonly broken: (lost: Lost) => void,
  ) {
    this.open();
  }

  ask(request: Request): void {
    const last = this.waiting.at(-1);
    const more = last && last.do === request.do && last.name === request.name && request.first === false;
    if (more && DRAGS.test(request.do)) Object.assign(last, { ...request, first: last.first });
    else if (more && STEPS.test(request.do)) {
      for (const way of ["across", "up"]) {
        last[way] = Math.max(-MOST, Math.min(MOST, Number(last[way]) + Number(request[way])));
      }
    } else this.waiting.push({ ...request });
    this.tell();
    this.send();
  }

  // Whether nothing waits for an answer.
  get rests(): boolean {
    return !this.under_way && this.waiting.length === 0;
  }

  private open(): void {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/talk`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      const asked = this.waiting; // what was shown is asked for anew, behind it all that was changed meanwhile
      this.waiting = [];
      this.lost = null;
      this.opened();
      this.waiting.push(...asked.filter((each) => !each.do.endsWith(".show")));
      this.send();
    };
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => {
      const received = decode(event.data);
      const shows = this.under_way?.do.endsWith(".show") ?? false;
      if (received.said.number > 0) this.under_way = null;
      if (!this.under_way) this.idle();
      this.heard(received, shows);
      this.send();
    };
    socket.onclose = () => {
      const asked = this.under_way;
      this.under_way = null;
      this.idle();
      this.lost ??= { since: performance.now(), tried: 0, stranger: false, waiting: 0, doubtful: "" };
      if (asked && SAME.test(asked.do)) this.waiting.unshift(asked);
      else if (asked) this.lost.doubtful = asked.do;
      const wait = AGAIN[Math.min(this.lost.tried++, AGAIN.length - 1)];
      setTimeout(() => this.open(), wait);
      if (this.lost.tried > 1) void this.look();
      this.tell();
    };
    this.socket = socket;
  }

  // A socket that is refused does not say why: whether a server is there that wants another cookie.
  private async look(): Promise<void> {
    const status = await fetch("/", { cache: "no-store" }).then(
      (answer) => answer.status,
      () => 0,
    );
    if (this.lost) this.lost.stranger = status === 403;
    this.tell();
  }

  private tell(): void {
    if (!this.lost) return;
    this.lost.waiting = this.waiting.filter((each) => !each.do.endsWith(".show")).length;
    this.broken(this.lost);
  }

  private send(): void {
    if (this.under_way || this.socket?.readyState !== WebSocket.OPEN) return;
    const next = this.waiting.shift();
    if (!next) return;
    this.under_way = next;
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
