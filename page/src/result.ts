// What a work came to: its verdict, its sentences and its tables.

import { make, table } from "./parts";

export interface Table {
  title: string;
  heads: string[];
  rows: string[][];
}
// The judgment of a command on its own result; a bad one is shown as bad.
export interface Judged {
  verdict?: string;
  failure?: string;
  bad?: boolean;
}
export interface Result extends Judged {
  said: string[];
  tables: Table[];
}

export function judged({ verdict, failure, bad }: Judged): HTMLElement[] {
  return [
    ...(verdict ? [make("p", { class: bad ? "verdict bad" : "verdict" }, verdict)] : []),
    ...(failure ? [make("p", { class: "bad" }, failure)] : []),
  ];
}

export function tables(found: Table[]): HTMLElement[] {
  return found.map((each, i) =>
    make("details", i < 2 ? { open: "" } : {}, make("summary", {}, each.title), table(each.heads, each.rows)),
  );
}

export function result(found: Result): HTMLElement[] {
  return [
    ...judged(found),
    ...(found.said.length ? [make("ul", {}, ...found.said.map((each) => make("li", {}, each)))] : []),
    ...tables(found.tables),
  ];
}
