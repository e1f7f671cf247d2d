// The page: numbers at the left, pictures that follow them, and what the limits say.

import { Handles } from "./handles";
import { Numbers } from "./numbers";
import { LOOKS, Picture } from "./picture";
import { Talk } from "./talk";
import type { Received } from "./wire";

const TITLES: Record<string, string> = {
  open_loop: "Open loop",
  nyquist: "Nyquist",
  stiffness: "Dynamic stiffness",
  sensitivity: "Sensitivity",
  run: "Move, then a force on the table",
};
const LETTERS = ["A", "B", "C"];

function element<Kind extends HTMLElement>(id: string): Kind {
  return document.getElementById(id) as Kind;
}

const grid = element("grid");
const pictures = new Map(Object.entries(TITLES).map(([name, title]) => [name, new Picture(title)]));
for (const [name, picture] of pictures) {
  picture.element.id = `picture-${name}`;
  grid.append(picture.element);
}
const talk = new Talk(heard, () => fail("The server has ended. Start feeddrive studio again, and open its new address."));
const moved = (name: string, value: number, first: boolean) => talk.ask({ do: "move", name, value, first });
const numbers = new Numbers(element("numbers"), moved);
const handles = new Handles(pictures.get("open_loop")!, moved);
let last: Received | null = null;

function heard(received: Received): void {
  const { said } = received;
  if (said.knobs) {
    numbers.list(said.knobs);
    handles.list(said.knobs);
    return;
  }
  if (said.file !== undefined) {
    save(said.file, said.file_name ?? "machine.toml");
    return;
  }
  fail(said.error ?? "");
  if (said.title) element("title").textContent = said.title;
  if (said.values) numbers.show(said.values);
  element<HTMLButtonElement>("undo").disabled = !said.undo;
  element<HTMLButtonElement>("redo").disabled = !said.redo;
  for (const letter of LETTERS) {
    element<HTMLButtonElement>(`take-${letter}`).disabled = !said.kept?.includes(letter);
  }
  if (said.judged) {
    const all = said.stable && said.judged.every((each) => each.keeps);
    const words = said.judged.map((each) => (each.keeps ? each.text : `${each.text}: broken`)).join("; ");
    const verdict = element("verdict");
    verdict.textContent = said.stable ? words : `Not stable. ${words}`;
    verdict.className = all ? "good" : "bad";
  }
  if (Object.keys(said.charts).length) {
    last = received;
    draw();
    handles.show(said.values ?? {});
  }
}

function draw(): void {
  if (!last) return;
  const look = LOOKS[document.documentElement.dataset.look === "dark" ? "dark" : "light"];
  for (const [name, picture] of pictures) {
    const chart = last.said.charts[name];
    picture.element.hidden = !chart;
    if (chart) picture.draw(chart, last.numbers, look);
  }
}

function fail(words: string): void {
  const place = element("error");
  place.textContent = words;
  place.hidden = words === "";
}

function save(text: string, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "application/toml" }));
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}

function snapshot(letter: string): HTMLElement {
  const group = document.createElement("span");
  const keep = document.createElement("button");
  const take = document.createElement("button");
  keep.type = take.type = "button";
  keep.textContent = `Keep as ${letter}`;
  take.textContent = letter;
  take.id = `take-${letter}`;
  take.disabled = true;
  take.setAttribute("aria-label", `Go to ${letter}`);
  keep.addEventListener("click", () => talk.ask({ do: "keep", letter }));
  take.addEventListener("click", () => talk.ask({ do: "take", letter }));
  group.append(keep, take);
  return group;
}

element("snapshots").append(...LETTERS.map(snapshot));
element("undo").addEventListener("click", () => talk.ask({ do: "undo" }));
element("redo").addEventListener("click", () => talk.ask({ do: "redo" }));
element("reset").addEventListener("click", () => talk.ask({ do: "reset" }));
element("save").addEventListener("click", () => talk.ask({ do: "file" }));
document.addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z") return;
  event.preventDefault();
  talk.ask({ do: event.shiftKey ? "redo" : "undo" });
});

function paint(dark: boolean): void {
  document.documentElement.dataset.look = dark ? "dark" : "light";
  element("dark").setAttribute("aria-pressed", String(dark));
  draw();
}
element("dark").addEventListener("click", () => paint(document.documentElement.dataset.look !== "dark"));
paint(matchMedia("(prefers-color-scheme: dark)").matches);
