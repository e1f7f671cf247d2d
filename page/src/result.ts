// The report of a work, in the order of its page in HTML: verdict, picture, sections; details are folded.

import { look } from "./pictures/look";
import { Picture } from "./pictures/picture";
import { make, renew, table } from "./parts";
import type { Received } from "./wire";

export interface Table {
  title: string;
  heads: string[];
  rows: string[][];
}
interface Shown {
  kind: "picture";
  key: string;
  title: string;
  caption: string;
}
type Part =
  | Shown
  | ({ kind: "table" | "grid"; best?: (number | null)[]; alert?: number[] } & Table)
  | { kind: "facts"; pairs: [string, string][] }
  | { kind: "remarks"; head: string; warns: boolean; sentences: string[] }
  | { kind: "code"; title: string; text: string }
  | { kind: "text"; text: string };
interface Section {
  key: string;
  title: string;
  folded: boolean;
  parts: Part[];
}
// A bad judgment of a command on its own result is shown as bad; `said` is what the page itself has to say of it.
export interface Result {
  verdict: string[];
  failure: string;
  bad: boolean;
  said: string[];
  picture: Shown | null;
  sections: Section[];
}

// The report of the latest work of one kind; its charts have the names of its pictures behind `prefix`.
export class Report {
  readonly head = make("div", { "aria-live": "polite" });
  readonly body = make("div", { class: "report" });
  private readonly pictures = new Map<string, Picture>();

  constructor(
    private readonly id: string,
    private readonly prefix = "",
  ) {}

  show(found: Result | null): void {
    renew(this.head, found && [found.verdict, found.failure, found.bad, found.said], () => (found ? judged(found) : []));
    renew(this.body, found && [found.picture, found.sections], () =>
      found ? [...(found.picture ? this.part(found.picture) : []), ...this.sections(found)] : [],
    );
  }

  draw({ said, numbers }: Received): void {
    for (const [key, picture] of this.pictures) {
      const chart = said.charts[this.prefix + key];
      if (chart && picture.element.isConnected && !picture.element.closest("details:not([open])"))
        picture.draw(chart, numbers, look());
    }
  }

  private sections({ sections }: Result): HTMLElement[] {
    return sections.map(({ title, folded, parts }) =>
      folded
        ? make("details", {}, make("summary", {}, title), ...parts.flatMap((each) => this.part(each)))
        : make("section", {}, make("h3", {}, title), ...parts.flatMap((each) => this.part(each))),
    );
  }

  private part(part: Part): HTMLElement[] {
    switch (part.kind) {
      case "picture":
        return [make("div", {}, this.picture(part).element, make("p", { class: "caption" }, part.caption))];
      case "table":
      case "grid":
        return [marked(part, part.best ?? [], part.alert ?? [])];
      case "facts": {
        const pairs = part.pairs.flatMap(([name, fact]) => [make("dt", {}, name), make("dd", {}, fact)]);
        return pairs.length ? [make("dl", {}, ...pairs)] : [];
      }
      case "remarks": {
        const sentences = part.sentences.map((each) => make("li", {}, each));
        if (!sentences.length) return [];
        return [...(part.head ? [make("h4", {}, part.head)] : []), make("ul", {}, ...sentences)];
      }
      case "code":
        return [make("h4", {}, part.title), make("pre", { tabindex: "0", "aria-label": part.title }, part.text)];
      case "text":
        return part.text ? [make("p", {}, part.text)] : [];
    }
  }

  private picture({ key, title }: Shown): Picture {
    const known = this.pictures.get(key);
    if (known?.title === title) return known;
    const fresh = new Picture(title);
    fresh.element.id = `${this.id}-${key}`;
    this.pictures.set(key, fresh);
    return fresh;
  }
}

function judged({ verdict, failure, bad, said }: Result): HTMLElement[] {
  const sentences = verdict.map((each, i) => make("p", i ? {} : { class: bad ? "verdict bad" : "verdict" }, each));
  return [
    ...sentences,
    ...(failure ? [make("p", { class: "bad" }, failure)] : []),
    ...(said.length ? [make("ul", {}, ...said.map((each) => make("li", {}, each)))] : []),
  ];
}

// The best cell of a column, and rows that need attention, stand out as in HTML.
function marked({ title, heads, rows }: Table, best: (number | null)[], alert: number[]): HTMLElement {
  const found = table(heads, rows);
  if (title) found.prepend(make("caption", {}, title));
  [...found.tBodies[0]!.rows].forEach((row, number) => {
    if (alert.includes(number)) row.classList.add("bad");
    best.forEach((place, column) => place === number && row.cells[column + 1]?.classList.add("best"));
  });
  return make("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": title }, found);
}

export function tables(found: Table[]): HTMLElement[] {
  return found.map((each, i) =>
    make("details", i < 2 ? { open: "" } : {}, make("summary", {}, each.title), table(each.heads, each.rows)),
  );
}
