// The current control is proven: a certificate, and the circle test on the machine.
// The verdict stands first, the pictures beside it, then what it covers and does not cover, and the files last.

import { badge, empty, imports } from "../empty";
import { icon, solid } from "../icons";
import { look, whenPainted } from "../pictures/look";
import { button, choice, copy, make, renew } from "../parts";
import { Picture } from "../pictures/picture";
import { Report, type Result } from "../result";
import { result, type Ask, type Room } from "../room";
import type { Received } from "../wire";

// The words of this view; what depends on a result comes from the server.
const TEXT = {
  list: "Proofs of this loop",
  parts: { certificate: "Stability", circle: "Circle test" },
  proven: "Proven",
  not: "Not proven",
  none: "Not run",
  done: "Run",
  earlier: "Of an earlier control",
  one_axis: (axis: string) => `Needs two axes; this machine has ${axis} only`,
  rooms: "Room by control",
  mark: "The mark is what is needed, 1 ×",
  wrong: "The model may be wrong by",
  again: "Prove again",
  room: "the room that is needed",
  needed: "needed, 1 ×",
  most: "3 ×",
  covers: "What this covers",
  tried: "What was tried",
  outside: "What it does not cover",
  would: "What a proof would not cover",
  instead: (percent: number) => `Prove for ${percent} % instead`,
  show: (frequency: string) => `Show ${frequency} in Tune`,
  tune: "Change it in Tune",
  check: "feeddrive check certificate.json",
  copy: "Copy the command that checks the file",
  details: "Assumptions, numbers and tables",
  margin: "Room at each frequency",
  discs: "Where L may lie",
  circle: "Circle test (ISO 230-4)",
  unrolled: "Deviation by angle; hollow: quadrant peaks",
  peaks: "Quadrant peaks: choose one to look at it",
  nothing: {
    title: "Nothing is proven of this loop yet.",
    sentence:
      "A proof says how far your axis may differ from its model, at each frequency, before the loop could become unstable. It holds for all axes in between, not for the tried ones only.",
    act: "Prove this loop",
    note: "About a second. Limits of Tune that are exceeded do not stop a proof: it asks for stability alone.",
  },
  no_circle: {
    title: "No circle was run yet.",
    sentence:
      "The circle test of ISO 230-4 runs two axes of the simulated machine with this control and shows its quadrant peaks.",
    act: "Run circle test",
  },
  no_axis: "Import a machine first: a proof needs its masses, springs and dead time.",
};
const MOST = 3; // times the needed room, the end of the meters

interface Place {
  text: string;
  view: number[]; // of the picture: left, right, and of a plane low, high
}
interface Proof {
  proven: boolean;
  head: string;
  sentence: string;
  room: number | null;
  tightest: string;
  frequency: number | null;
  instead: number | null;
  covers: [string, boolean][];
  outside: string[];
  rooms: { name: string; room: number | null }[];
  files: { title: string; name: string; kind: string }[];
}
type Found = Result & { proof?: Proof; peaks?: Place[] };
interface Words {
  ready: boolean;
  axes: string[];
  model_error: number;
  example?: string;
  shown: Record<string, Found>;
}

export class Prove implements Room {
  readonly name = "prove";
  readonly title = "Prove";
  readonly element = make("div", { class: "prove fills" });
  private readonly side = make("aside", { class: "side", "aria-label": TEXT.list });
  private readonly panes = new Map(
    Object.keys(TEXT.parts).map((name) => [name, make("div", { class: "pane", id: `proof-${name}` })]),
  );
  private readonly tight: Record<string, Map<string, Picture>> = {
    certificate: cells("certificate", { margin: TEXT.margin, discs: TEXT.discs }),
    circle: cells("circle", { circle: TEXT.circle, unrolled: TEXT.unrolled }),
    example: cells("example", { margin: TEXT.margin }),
  };
  private readonly reports = new Map(["certificate", "circle"].map((name) => [name, new Report(`proof-${name}`, `${name}.`)]));
  private readonly chosen = { x: "", y: "" };
  private open = "certificate";
  private latest = ""; // result, of which the pane was opened
  private last: Received | null = null;

  constructor(private readonly ask: Ask) {
    this.element.append(this.side, ...this.panes.values());
    whenPainted(() => this.draw());
  }

  heard(received: Received): void {
    this.last = received;
    const words = received.said as unknown as Words;
    const names = Object.keys(words.shown);
    const latest = names.at(-1) ?? "";
    const now = JSON.stringify([latest, words.shown[latest]?.verdict, words.shown[latest]?.proof]);
    if (latest && now !== this.latest) this.open = latest;
    this.latest = now;
    this.select(words);
    this.listed(words);
    this.certificate(words);
    this.circle(words);
    this.draw();
  }

  shown(): void {
    this.draw();
  }

  private go(name: string): void {
    this.open = name;
    if (this.last) this.heard(this.last);
  }

  // The proofs, each with its result in a word, and below them what a proof is asked for.
  private listed(words: Words): void {
    const { axes, shown, ready, model_error: error } = words;
    for (const [name, pane] of this.panes) pane.hidden = name !== this.open;
    const proof = shown.certificate?.proof;
    renew(this.side, [axes, shown, ready, error, this.open], () => {
      const rows = Object.entries(TEXT.parts).map(([name, title]) => {
        const found = shown[name];
        const [shape, said] = state(name, found, axes);
        const row = button("", () => this.go(name), {
          id: `proofs-${name}`,
          "aria-pressed": String(name === this.open),
          class: "row",
        });
        row.append(shape, make("span", {}, make("b", {}, title), make("small", {}, said)));
        return row;
      });
      const more = proof ? [rooms(proof.rooms), this.asks(error, true)] : ready ? [this.asks(error, false)] : [];
      return [make("h2", {}, TEXT.list), ...rows, make("div", { class: "more" }, ...more)];
    });
  }

  // What the model may be wrong by, as a number; a proof that was run can be run again.
  private asks(error: number, again: boolean): HTMLElement {
    const field = make("input", {
      type: "text",
      inputmode: "decimal",
      id: "prove-error",
      value: String(Number(error.toPrecision(3))),
    });
    const typed = () => Number(field.value.replace(",", "."));
    const run = () => this.ask({ do: "prove.certify", model_error: Number.isFinite(typed()) ? typed() : field.value });
    field.addEventListener("keydown", (event) => event.key === "Enter" && run());
    const entry = make("span", { class: "entry" }, field, make("span", { class: "unit" }, "%"));
    return make(
      "div",
      { class: "asks" },
      make("label", { for: field.id }, TEXT.wrong),
      entry,
      ...(again ? [button(TEXT.again, run, { id: "prove-certify" })] : []),
    );
  }

  private certificate({ ready, shown, example = "" }: Words): void {
    const pane = this.panes.get("certificate")!;
    const found = shown.certificate;
    const report = this.reports.get("certificate")!;
    if (found?.proof) report.show(found);
    renew(pane, [ready, found, example], () => {
      if (!found?.proof) {
        const error = () => document.querySelector<HTMLInputElement>("#prove-error")?.value.replace(",", ".");
        const act = button(TEXT.nothing.act, () => this.ask({ do: "prove.certify", model_error: Number(error()) }), {
          id: "prove-certify",
        });
        const shows = this.tight.example!.get("margin")!.element;
        const { title, sentence, note } = TEXT.nothing;
        const without = ready ? { act, note } : { act: imports(), note: TEXT.no_axis };
        return [empty({ title, sentence, ...without, example: { of: badge(example), shows } })];
      }
      const { proof } = found;
      return [
        hero(proof.proven, proof.proven ? TEXT.proven : TEXT.not, proof.head, proof.sentence, found.said, distance(proof)),
        pictures(this.tight.certificate!),
        make("div", { class: "foot" }, covered(proof), outside(proof), this.next(proof)),
        folded(report.body),
      ];
    });
  }

  // What comes after the verdict: the files, or what can be proven instead and the way to Tune.
  private next(proof: Proof): HTMLElement {
    if (proof.proven) {
      const links = proof.files.map(({ title, name, kind }, i) =>
        make(
          "a",
          { href: result(name), download: name, class: i ? "file" : "file main", id: `proof-file-${i}` },
          icon("import"),
          make("b", {}, title),
          make("span", {}, kind),
        ),
      );
      const again = button("", () => void copy(TEXT.check, again), { class: "tool", title: TEXT.copy, "aria-label": TEXT.copy });
      again.append(icon("copy"));
      return make("div", { class: "files" }, ...links, make("div", { class: "command" }, make("code", {}, TEXT.check), again));
    }
    const { instead, frequency } = proof;
    const less =
      instead === null
        ? []
        : [
            button(TEXT.instead(instead), () => this.ask({ do: "prove.certify", model_error: instead }), {
              id: "prove-instead",
              class: "main",
            }),
          ];
    const said = frequency === null ? TEXT.tune : TEXT.show(`${Number(frequency.toPrecision(3))} Hz`);
    const tune = button(
      said,
      () => {
        document.dispatchEvent(new CustomEvent("go", { detail: "tune" }));
        if (frequency !== null) document.dispatchEvent(new CustomEvent("frequency", { detail: frequency }));
      },
      { id: "prove-tune", class: less.length ? "" : "main" },
    );
    return make("div", { class: "files" }, ...less, tune);
  }

  private circle({ ready, axes, shown }: Words): void {
    const pane = this.panes.get("circle")!;
    const found = shown.circle;
    const report = this.reports.get("circle")!;
    if (found) report.show(found);
    renew(pane, [ready, axes, found], () => {
      const run = (main: boolean) =>
        button(TEXT.no_circle.act, () => this.ask({ do: "prove.circle", x: this.chosen.x, y: this.chosen.y }), {
          id: "prove-circle",
          ...(main ? { class: "main" } : {}),
        });
      const select = (key: "x" | "y") => this.choose(key, axes, key);
      const { title, sentence } = TEXT.no_circle;
      if (!found && axes.length < 2)
        return [empty({ title, sentence, ...(ready ? { note: TEXT.one_axis(axes[0] ?? "") } : { act: imports() }) })];
      const ask = make("div", { class: "buttons asked" }, select("x"), select("y"));
      if (!found) return [empty({ title, sentence, act: run(true), more: [ask] })];
      ask.append(run(false));
      const [head = "", ...rest] = found.verdict;
      const list = make("div", { class: "peaks" });
      this.list(list, TEXT.peaks, found.peaks ?? [], (at) => zoom(this.tight.circle!.get("unrolled")!, at));
      return [
        hero(!found.bad, "", head, [found.failure, ...rest].filter((each) => each).join(" "), found.said, ask),
        pictures(this.tight.circle!),
        make("div", { class: "foot one" }, list),
        folded(report.body),
      ];
    });
  }

  private select({ axes }: Words): void {
    const { chosen } = this;
    const [first = "", second = first] = axes;
    if (!axes.includes(chosen.x)) chosen.x = first;
    if (!axes.includes(chosen.y)) chosen.y = second;
  }

  private choose(label: string, among: string[], key: "x" | "y"): HTMLElement {
    const found = choice(
      label,
      among.map((each): [string, string] => [each, each]),
      (value) => (this.chosen[key] = value),
    );
    found.querySelector("select")!.value = this.chosen[key];
    return found;
  }

  private list(where: HTMLElement, title: string, places: Place[], act: (at: Place) => void): void {
    renew(where, [title, places], () => {
      const rows = places.map((each) => {
        const found = button(each.text, () => {
          for (const other of where.querySelectorAll("button")) other.setAttribute("aria-pressed", String(other === found));
          act(each);
        }, { class: "worst", "aria-pressed": "false" }); // prettier-ignore
        return make("li", {}, found);
      });
      return places.length ? [make("h3", {}, title), make("ol", {}, ...rows)] : [];
    });
  }

  private draw(): void {
    if (!this.last || this.element.closest("[hidden]")) return;
    const { charts } = this.last.said;
    for (const [name, of] of Object.entries(this.tight))
      for (const [key, picture] of of) {
        const chart = charts[`${name}.${key}`];
        picture.element.hidden = !chart;
        if (chart && picture.element.isConnected && !picture.element.closest("[hidden]"))
          picture.draw(chart, this.last.numbers, look());
      }
    for (const [name, report] of this.reports) if (!this.panes.get(name)!.hidden) report.draw(this.last);
  }
}

function state(name: string, found: Found | undefined, axes: string[]): [SVGSVGElement, string] {
  if (name === "circle" && axes.length === 1) return [icon("free"), TEXT.one_axis(axes[0]!)];
  if (!found) return [icon("unrun"), TEXT.none];
  const { proof } = found;
  const times = proof && proof.room !== null ? `, ${ratio(proof.room)} × room` : "";
  const word = proof ? `${proof.proven ? TEXT.proven : TEXT.not}${times}` : TEXT.done;
  const good = proof ? proof.proven : !found.bad;
  return [solid(good ? "kept" : "broken"), found.said.length ? TEXT.earlier : word];
}

function hero(good: boolean, word: string, head: string, sentence: string, notes: string[], beside: HTMLElement): HTMLElement {
  const strong = word ? [make("b", {}, `${word}.`), " "] : [];
  const words = make("div", {}, make("h2", { class: word ? "" : "plain" }, ...strong, head), make("p", {}, sentence));
  for (const each of notes) words.append(make("p", { class: "earlier" }, each));
  return make(
    "div",
    { class: "hero", "data-state": good ? "kept" : "broken", "aria-live": "polite" },
    solid(good ? "kept" : "broken"),
    words,
    beside,
  );
}

function distance({ room, tightest }: Proof): HTMLElement {
  if (room === null) return make("div", { class: "distance" });
  const [figure, what] = [make("strong", {}, `${ratio(room)} ×`), make("span", {}, TEXT.room)];
  const scale = make(
    "div",
    { class: "scale", "aria-hidden": "true" },
    make("span", {}, TEXT.needed),
    make("span", {}, TEXT.most),
  );
  return make("div", { class: "distance" }, make("p", {}, figure, " ", what), meter(room), scale, make("small", {}, tightest));
}

function meter(room: number | null): HTMLElement {
  const made = make("div", { class: "meter", "aria-hidden": "true" }, make("i"));
  made.dataset.state = room === null || room > 1 ? "kept" : "broken";
  made.style.setProperty("--share", String(Math.min(room ?? MOST, MOST) / MOST));
  return made;
}

function rooms(found: Proof["rooms"]): HTMLElement {
  const rows = found.map(({ name, room }) =>
    make("li", {}, make("span", {}, name), meter(room), make("b", {}, room === null ? "any" : `${ratio(room)} ×`)),
  );
  return make("div", { class: "rooms" }, make("h3", {}, TEXT.rooms), make("ul", {}, ...rows), make("small", {}, TEXT.mark));
}

function covered({ proven, covers }: Proof): HTMLElement {
  const rows = covers.map(([text, kept]) => {
    const row = make("li", { "data-state": kept ? "kept" : "broken" }, text);
    row.prepend(solid(kept ? "kept" : "broken"));
    return row;
  });
  return make("section", {}, make("h3", {}, proven ? TEXT.covers : TEXT.tried), make("ul", {}, ...rows));
}

function outside({ proven, outside }: Proof): HTMLElement {
  const rows = outside.map((text) => make("li", {}, icon("free"), text));
  return make("section", {}, make("h3", {}, proven ? TEXT.outside : TEXT.would), make("ul", {}, ...rows));
}

function folded(body: HTMLElement): HTMLElement {
  return make("details", { class: "folded" }, make("summary", {}, TEXT.details), body);
}

function pictures(of: Map<string, Picture>): HTMLElement {
  return make("div", { class: "cells" }, ...[...of.values()].map((each) => each.element));
}

function cells(part: string, titles: Record<string, string>): Map<string, Picture> {
  const made = new Map(Object.entries(titles).map(([key, title]) => [key, new Picture(title, undefined, true)]));
  for (const [key, each] of made) each.element.id = `proof-${part}-${key}`;
  return made;
}

function ratio(room: number): string {
  return String(Number(room.toPrecision(2)));
}

function zoom(picture: Picture, { view: [left, right, low, high] }: Place): void {
  picture.zoom({ low: left!, high: right! }, low === undefined ? null : { low, high: high! });
}
