// A room of the page: what `main.ts` needs of it to be a tab.

import type { Job, Received } from "./wire";

export type Request = { do: string; [name: string]: unknown };
export type Ask = (request: Request) => void;

export interface Room {
  readonly name: string; // as on the server: `tune`
  readonly title: string; // on its tab
  readonly element: HTMLElement;
  heard(received: Received): void; // what the server says of it
  unchanged?(): void; // the last request was refused: what is shown is as it was
  worked?(job: Job): void; // what the work that runs says, of whatever room
  shown?(): void; // its tab was opened: pictures may be measured
}

const KEY = "feeddrive session";

// The name of the session of this tab; it stays when the page is loaded again.
export function session(): string {
  const known = sessionStorage.getItem(KEY);
  if (known) return known;
  const fresh = crypto.randomUUID?.() ?? Array.from(crypto.getRandomValues(new Uint32Array(4)), String).join("-");
  sessionStorage.setItem(KEY, fresh);
  return fresh;
}

// Show the work of another session in this tab.
export function take(name: string): void {
  sessionStorage.setItem(KEY, name);
  history.replaceState(null, "", "/"); // it begins where its axis is
  sessionStorage.removeItem("feeddrive room");
  location.reload();
}

// The address of a result of this session.
export function result(name: string): string {
  return `/file/${encodeURIComponent(name)}?session=${encodeURIComponent(session())}`;
}
