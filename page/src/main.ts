// The page: its views in a rail, each with an address of its own, what went wrong, and the work that runs.

import { icon, type Icon } from "./icons";
import { paint } from "./pictures/look";
import { button, make } from "./parts";
import { showAll, whenZoomed } from "./pictures/picture";
import { printable } from "./pictures/print";
import type { Request, Room } from "./room";
import { Bring } from "./rooms/bring";
import { Commission } from "./rooms/commission";
import { Compare } from "./rooms/compare";
import { Goal } from "./rooms/goal";
import { Prove } from "./rooms/prove";
import { Scope } from "./rooms/scope";
import { Take } from "./rooms/take";
import { Tune } from "./rooms/tune";
import { letters, Search } from "./search";
import { Talk, type Lost } from "./talk";
import { Tour, type Step } from "./tour";
import type { Received } from "./wire";
import { seconds, Works } from "./works";

const talk: Talk = new Talk(
  heard,
  () => {
    if (off?.doubtful) fail(`The connection broke while ${off.doubtful} was under way: look whether it was done.`);
    off = null;
    lost.hidden = true;
    document.documentElement.toggleAttribute("data-lost", false);
    talk.ask({ do: "bring.show" });
    if (open) talk.ask({ do: `${open}.show` });
  },
  disconnected,
);
const ask = (request: Request) => talk.ask(request);
const tune = new Tune(ask);
const rooms: Room[] = [
  new Bring(ask),
  new Commission(ask),
  new Scope(ask),
  tune,
  ...[Goal, Compare, Prove, Take].map((Kind) => new Kind(ask)),
];
const titles = new Map(rooms.map((each) => [each.name, each.title]));
const works = new Works(ask, titles, (view, drawing, words) => {
  const shape = tabs.get(view)?.shape;
  if (!shape || shape.dataset.words === words) return;
  shape.dataset.words = words;
  shape.replaceChildren(...(drawing ? [icon(drawing, { role: "img", "aria-label": words })] : []));
  shape.title = words;
});
const search = new Search(ask, titles, go, () => {
  for (const { name } of rooms) if (!seen.has(name)) ask({ do: `${name}.show` });
});
const tour = new Tour(ask, go);
const error = make("p", { id: "error", role: "alert", hidden: "" });
const lost_words = make("span", { role: "alert" });
const lost_time = make("span", { "aria-hidden": "true" }); // each second: seen, and not read aloud
const lost = make(
  "p",
  { id: "lost", hidden: "" },
  button("Load again", () => location.reload()),
  lost_words,
  lost_time,
);
const others = make("span", { id: "pages", class: "unit", hidden: "" }, "2 pages");
const title = document.getElementById("title")!;
const tabs = new Map<string, { room: Room; tab: HTMLButtonElement; panel: HTMLElement; shape: HTMLElement }>();
const LOOK = "feeddrive look";
let epoch = -1;
let open = "";
const seen = new Set<string>(); // views whose content the server has sent
let began = false;
const LONG = 6000; // ms without a server after which it is said what to do
let unkept = "";
let off: Lost | null = null; // the connection
let behind = false; // another page has changed something

const ICONS: Record<string, Icon> = { bring: "import", goal: "goal", take: "take" }; // others are called as their view
const list = make("div", { role: "tablist", "aria-label": "Views", "aria-orientation": "vertical", id: "tabs" });
rooms.forEach((room, i) => {
  const tab = button("", () => go(room.name), {
    role: "tab",
    id: `tab-${room.name}`,
    title: `${room.title} (${i + 1})`,
    "aria-controls": `room-${room.name}`,
  });
  const shape = make("span", { class: "mark" });
  tab.append(icon(ICONS[room.name] ?? (room.name as Icon)), make("span", {}, room.title), shape);
  const panel = make(
    "section",
    { role: "tabpanel", id: `room-${room.name}`, "aria-labelledby": tab.id, hidden: "" },
    room.element,
  );
  tabs.set(room.name, { room, tab, panel, shape });
  list.append(tab);
});
list.addEventListener("keydown", (event) => {
  const way = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
  if (way === undefined) return;
  event.preventDefault();
  const at = rooms.findIndex((each) => each.name === open);
  const next = rooms[(at + way + rooms.length) % rooms.length]!;
  go(next.name);
  tabs.get(next.name)!.tab.focus();
});
document.addEventListener("keydown", (event) => {
  const held = event.ctrlKey || event.metaKey;
  const act = (what: () => void) => {
    event.preventDefault();
    what();
  };
  if (held && event.key.toLowerCase() === "k") return act(() => search.open());
  if (search.element.open) return;
  if (held && event.key === "Enter") return act(() => main()?.click());
  if (event.key === "Escape" && !event.defaultPrevented) return leave(event);
  const room = rooms[Number(event.key) - 1];
  const field = event.target instanceof HTMLElement && event.target.closest("input, select, textarea, [contenteditable]");
  if (room && letters() && !field && !held && !event.altKey) go(room.name);
});

// The filled button of the view that is open: there is one at most.
function main(): HTMLButtonElement | undefined {
  const filled = [...document.querySelectorAll<HTMLButtonElement>(`#room-${open} button.main`)];
  return filled.find((each) => each.getClientRects().length > 0 && !each.disabled);
}

// Escape leaves a field as it was, closes what is open or, in the view of a job, cancels it.
function leave(event: KeyboardEvent): void {
  const at = event.target;
  const typed = at instanceof HTMLInputElement && at.dataset.before !== undefined && at.value !== at.dataset.before;
  if (typed) {
    at.value = at.dataset.before!;
    at.dispatchEvent(new Event("escaped", { bubbles: true }));
    at.select();
  } else if (works.fold()) return;
  else if (!(at instanceof HTMLInputElement) && works.runs && !works.element.hidden) ask({ do: "job.cancel" });
}
document.addEventListener("focusin", ({ target }) => {
  if (target instanceof HTMLInputElement && target.type === "text") target.dataset.before = target.value;
});
const look = button("", dark, {
  id: "dark",
  class: "tool",
  "aria-pressed": "false",
  "aria-label": "Dark",
  title: "Dark or light",
});
look.append(icon("dark"));
const logo = make("span", { class: "logo" });
logo.append(icon("logo", { role: "img", "aria-label": "feeddrive" }));
document.querySelector("header")!.prepend(logo);
const find = button("", () => search.open(), { id: "find", class: "tool", "aria-label": "Search", title: "Search (Ctrl+K)" });
find.append(icon("find"));
document.querySelector("header")!.append(others, works.bar, tune.bar, find, look);
document.querySelector("nav")!.append(list);
document.querySelector("main")!.append(
  works.list,
  tour.element,
  // over the lower edge of the window: what a person works at must not move when a job begins or a value is refused
  make("div", { id: "notices" }, lost, error, works.element),
  works.spoken,
  search.element,
  ...[...tabs.values()].map(({ panel }) => panel),
);
// Back, forward and a bookmark.
addEventListener("popstate", () => {
  const named = location.hash.slice(1);
  if (tabs.has(named) && named !== open) show(named);
});

// Open a view, and put its address into the history of the browser.
export function go(name: string): void {
  if (name === open) return show(name);
  const address = `#${name}`;
  if (open === "") history.replaceState(null, "", address);
  else history.pushState(null, "", address);
  show(name);
}

// Open a view and ask the server what it shows.
function show(name: string): void {
  open = name;
  sessionStorage.setItem("feeddrive room", name);
  for (const [each, { tab, panel }] of tabs) {
    tab.setAttribute("aria-selected", String(each === name));
    tab.tabIndex = each === name ? 0 : -1;
    panel.hidden = each !== name;
  }
  fail("");
  works.at(name);
  tabs.get(name)!.room.shown?.();
  ask({ do: `${name}.show` });
}

whenZoomed((label, x) => ask({ do: "view.window", label, low: x?.low ?? null, high: x?.high ?? null, shows: open }));

// A room may send the person on: new CustomEvent("go", { detail: "tune", bubbles: true })
document.addEventListener("go", (event) => go((event as CustomEvent<string>).detail));

function heard(received: Received, shows: boolean): void {
  const { said } = received;
  works.show(said.job, said.work);
  if (said.work) together(said.work.pages, said.work.lost);
  if (said.changed) behind = true;
  if (said.room === "search" && !said.error) return search.heard(received);
  if (typeof said.go === "string" && !said.room) go(said.go);
  if (said.job) for (const each of rooms) each.worked?.(said.job);
  title.textContent = said.title || "feeddrive";
  if (said.error) fail(said.error);
  else if (said.number > 0 && !said.live && !shows) fail(""); // what runs by, or only shows, takes no words away
  const other = said.epoch !== undefined && said.epoch !== epoch;
  if (other) {
    epoch = said.epoch!;
    showAll();
  }
  if (!said.error && said.room) seen.add(said.room);
  if (!said.error && said.room) tabs.get(said.room)?.room.heard(received);
  else if (said.error && said.room) tabs.get(said.room)?.room.unchanged?.();
  if (!began) {
    began = true;
    const named = location.hash.slice(1);
    const kept = tabs.has(named) ? named : (sessionStorage.getItem("feeddrive room") ?? "");
    const target = tabs.has(kept) ? kept : said.epoch ? "tune" : "bring";
    if (target !== "bring" || open === "") go(target);
  } else if (other && said.room !== open) ask({ do: `${open}.show` });
  tour.heard((said.tour as Step | null | undefined) ?? null);
  // what another page changed, once nothing of this one is under way
  if (behind && talk.rests && began) {
    behind = false;
    ask({ do: `${open}.show` });
  }
}

// Other pages that show the same work, and what of it could not be kept.
function together(pages: number, gone: string[]): void {
  others.hidden = pages < 2;
  others.textContent = `${pages} pages`;
  others.title =
    "This work is open in another page, too: what one changes shows on the other, and Undo takes back the last step of either.";
  const words = gone.join(" ");
  if (words && words !== unkept) fail(words);
  unkept = words;
}

function disconnected(now: Lost): void {
  off = now;
  lost.hidden = false;
  document.documentElement.toggleAttribute("data-lost", true);
  works.lost();
  const long = performance.now() - now.since > LONG;
  const stranger =
    "The server was started anew and does not know this browser: open the address that it printed; your work is found there.";
  const again = "If the server has ended, start feeddrive studio again with the same folder: this page goes on by itself.";
  const kept = now.waiting ? ` ${now.waiting} change${now.waiting > 1 ? "s" : ""} will be sent.` : "";
  const words = now.stranger ? stranger : `Disconnected, trying again. What you type stays.${kept}${long ? ` ${again}` : ""}`;
  if (lost_words.textContent !== words) lost_words.textContent = words;
}
setInterval(() => {
  if (!off) return;
  lost_time.textContent = ` ${seconds((performance.now() - off.since) / 1000)}`;
  disconnected(off);
}, 1000);

function fail(words: string): void {
  error.textContent = words;
  error.hidden = words === "";
}

function dark(): void {
  const now = document.documentElement.dataset.look !== "dark";
  localStorage.setItem(LOOK, now ? "dark" : "light");
  paint(now);
}
printable();
const kept = localStorage.getItem(LOOK);
paint(kept ? kept === "dark" : matchMedia("(prefers-color-scheme: dark)").matches);
