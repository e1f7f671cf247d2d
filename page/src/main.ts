// The page: its views in a rail, each with an address of its own, what went wrong, and the work that runs.

import { icon, type Icon } from "./icons";
import { JobBar } from "./job";
import { paint } from "./pictures/look";
import { button, make } from "./parts";
import { showAll, whenZoomed } from "./pictures/picture";
import { printable } from "./pictures/print";
import type { Request, Room } from "./room";
import { Import } from "./rooms/import";
import { Commission } from "./rooms/commission";
import { Compare } from "./rooms/compare";
import { Optimize } from "./rooms/optimize";
import { Program } from "./rooms/program";
import { Prove } from "./rooms/prove";
import { Scope } from "./rooms/scope";
import { Export } from "./rooms/export";
import { Tune } from "./rooms/tune";
import { Talk } from "./talk";
import { Tour, type Step } from "./tour";
import type { Received } from "./wire";

const talk: Talk = new Talk(
  heard,
  () => {
    lost.hidden = true;
    talk.ask({ do: "import.show" });
    if (open) talk.ask({ do: `${open}.show` });
  },
  (ended) => {
    const why = "The server has ended: start feeddrive studio again and open its new address.";
    lost_words.textContent = ended ? why : "The connection to the server was lost. It is tried again.";
    lost.hidden = false;
  },
);
const ask = (request: Request) => talk.ask(request);
const tune = new Tune(ask);
const rooms: Room[] = [
  new Import(ask),
  new Commission(ask),
  new Scope(ask),
  tune,
  ...[Optimize, Compare, Prove, Program, Export].map((Kind) => new Kind(ask)),
];
const job = new JobBar(ask);
const tour = new Tour(ask, go);
const error = make("p", { id: "error", role: "alert", hidden: "" });
const lost_words = make("span", { role: "alert" });
const lost = make(
  "p",
  { id: "lost", hidden: "" },
  lost_words,
  button("Load again", () => location.reload()),
);
const title = document.getElementById("title")!;
const tabs = new Map<string, { room: Room; tab: HTMLButtonElement; panel: HTMLElement }>();
const LOOK = "feeddrive look";
let epoch = -1;
let open = "";
let began = false;

const list = make("div", { role: "tablist", "aria-label": "Views", "aria-orientation": "vertical", id: "tabs" });
rooms.forEach((room, i) => {
  const tab = button("", () => go(room.name), {
    role: "tab",
    id: `tab-${room.name}`,
    title: `${room.title} (${i + 1})`,
    "aria-controls": `room-${room.name}`,
  });
  tab.append(icon(room.name as Icon), make("span", {}, room.title));
  const panel = make(
    "section",
    { role: "tabpanel", id: `room-${room.name}`, "aria-labelledby": tab.id, hidden: "" },
    room.element,
  );
  tabs.set(room.name, { room, tab, panel });
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
  const room = rooms[Number(event.key) - 1];
  const field = event.target instanceof HTMLElement && event.target.closest("input, select, textarea, [contenteditable]");
  if (room && !field && !event.ctrlKey && !event.metaKey && !event.altKey) go(room.name);
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
document.querySelector("header")!.append(tune.bar, look);
document.querySelector("nav")!.append(list);
document.querySelector("main")!.append(
  lost,
  tour.element,
  // over the lower edge of the window: what a person works at must not move when a job begins or a value is refused
  make("div", { id: "notices" }, error, job.element),
  job.spoken,
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
  tabs.get(name)!.room.shown?.();
  ask({ do: `${name}.show` });
}

whenZoomed((label, x) => ask({ do: "view.window", label, low: x?.low ?? null, high: x?.high ?? null, shows: open }));

// A room may send the person on: new CustomEvent("go", { detail: "tune", bubbles: true })
document.addEventListener("go", (event) => go((event as CustomEvent<string>).detail));

function heard(received: Received, shows: boolean): void {
  const { said } = received;
  job.show(said.job);
  if (said.job) for (const each of rooms) each.worked?.(said.job);
  title.textContent = said.title || "feeddrive";
  if (said.error) fail(said.error);
  else if (said.number > 0 && !said.live && !shows) fail(""); // what runs by, or only shows, takes no words away
  const other = said.epoch !== undefined && said.epoch !== epoch;
  if (other) {
    epoch = said.epoch!;
    showAll();
  }
  if (!said.error && said.room) tabs.get(said.room)?.room.heard(received);
  else if (said.error && said.room) tabs.get(said.room)?.room.unchanged?.();
  if (!began) {
    began = true;
    const named = location.hash.slice(1);
    const kept = tabs.has(named) ? named : (sessionStorage.getItem("feeddrive room") ?? "");
    const target = tabs.has(kept) ? kept : said.epoch ? "tune" : "import";
    if (target !== "import" || open === "") go(target);
  } else if (other && said.room !== open) ask({ do: `${open}.show` });
  tour.heard((said.tour as Step | null | undefined) ?? null);
}

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
