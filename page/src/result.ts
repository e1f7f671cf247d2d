// What a work came to: its verdict, its sentences and its tables.

import { make, table } from "./parts";

export interface Table {
  title: string;
  heads: string[];
  rows: string[][];
}
export interface Result {
  said: string[];
  tables: Table[];
  verdict: string;
  failure: string;
}

export function tables(found: Table[]): HTMLElement[] {
  return found.map((each, i) =>
    make("details", i < 2 ? { open: "" } : {}, make("summary", {}, each.title), table(each.heads, each.rows)),
  );
}

export function result(found: Result): HTMLElement[] {
  return [
    ...(found.verdict ? [make("p", { class: "verdict" }, found.verdict)] : []),
    ...(found.failure ? [make("p", { class: "bad" }, found.failure)] : []),
    ...(found.said.length ? [make("ul", {}, ...found.said.map((each) => make("li", {}, each)))] : []),
    ...tables(found.tables),
  ];
}
