// The conversation with the server: one request at a time; of requests that wait, moves of the same number are one.

import { decode, type Received } from "./wire";

export type Request = { do: string; name?: string; value?: number; first?: boolean; letter?: string };

const KEY = "feeddrive session";

function session(): string {
  const known = sessionStorage.getItem(KEY);
  if (known) return known;
  const fresh = crypto.randomUUID();
  sessionStorage.setItem(KEY, fresh);
  return fresh;
}

export class Talk {
  private socket: WebSocket | null = null;
  private waiting: Request[] = [];
  private under_way = false;
  private number = 0;

  constructor(
    private readonly heard: (received: Received) => void,
    private readonly lost: () => void,
  ) {
    this.open();
  }

  ask(request: Request): void {
    const last = this.waiting.at(-1);
    if (last && last.do === "move" && request.do === "move" && last.name === request.name && !request.first) {
      last.value = request.value;
    } else {
      this.waiting.push(request);
    }
    this.send();
  }

  private open(): void {
    const socket = new WebSocket(`ws://${location.host}/talk`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.under_way = false;
      this.ask({ do: "show" });
    };
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => {
      const received = decode(event.data);
      if (received.said.number > 0) this.under_way = false;
      this.heard(received);
      this.send();
    };
    socket.onclose = () => this.lost();
    this.socket = socket;
  }

  private send(): void {
    if (this.under_way || this.socket?.readyState !== WebSocket.OPEN) return;
    const next = this.waiting.shift();
    if (!next) return;
    this.under_way = true;
    this.number += 1;
    this.socket.send(JSON.stringify({ number: this.number, session: session(), ...next }));
  }
}
