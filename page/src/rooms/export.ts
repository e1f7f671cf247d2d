// What is taken away: files to download, exports, and all that was done as commands, Python and a job.

import { button, copied, make, renew } from "../parts";
import { Report, type Result } from "../result";
import { result, type Ask, type Room } from "../room";
import type { Received } from "../wire";

interface Words {
  ready: boolean;
  targets: string[];
  results: { name: string; said: string }[]; // said: that it is of another control
  exports: Record<string, Result & { archive: string }>;
  verified: Record<string, Result>;
  commands: string;
  python: string;
  job_file: string;
  bounds: { name: string; meaning: string; unit: string }[];
  give?: string;
}

export class Export implements Room {
  readonly name = "export";
  readonly title = "Export";
  readonly element = make("div", { class: "export" });

  private readonly given = new Map<string, string>(); // what a person wrote into the fields of the guard

  constructor(private readonly ask: Ask) {}

  heard(received: Received): void {
    const words = received.said as unknown as Words;
    const { ready, targets, results, exports, verified, commands, python, job_file, bounds } = words;
    renew(this.element, [ready, targets, results, exports, verified, commands, python, job_file, bounds], () =>
      this.content(words),
    );
    if (words.give) {
      const link = make("a", { href: result(words.give), download: words.give });
      link.click();
    }
  }

  private content(words: Words): HTMLElement[] {
    const machine = button("Machine file", () => this.ask({ do: "export.machine" }), { id: "export-machine", class: "main" });
    machine.disabled = !words.ready;
    const results = words.results.map(({ name, said }) => {
      const give = button(`Report: ${name}`, () => this.ask({ do: "export.result", name }), { id: `export-result-${name}` });
      if (!said) return give;
      give.setAttribute("aria-describedby", `export-said-${name}`);
      return make("span", {}, give, make("span", { id: `export-said-${name}` }, ` ${said}`));
    });
    const targets = words.targets.map((target) => {
      const found = button(`Export: ${target}`, () => this.ask({ do: "export.export", target }), {
        id: `export-target-${target}`,
      });
      found.disabled = !words.ready;
      return found;
    });
    const content = [
      ...(words.ready ? [] : [make("p", {}, "Import a machine first: a control is exported for an axis of a machine file.")]),
      make("div", { class: "buttons" }, machine, ...results),
      ...this.guard(words.bounds),
      make("h2", {}, "Exports"),
      make("div", { class: "buttons" }, ...targets),
    ];
    for (const [target, found] of Object.entries(words.exports)) {
      const proof = words.verified[target];
      content.push(
        make("h3", {}, target),
        make(
          "div",
          { class: "buttons" },
          make(
            "a",
            { href: result(found.archive), download: found.archive, id: `export-archive-${target}` },
            `Download ${found.archive}`,
          ),
          button("Verify with this machine's compiler", () => this.ask({ do: "export.verify", target }), {
            "aria-label": `Verify with this machine's compiler: ${target}`,
          }),
        ),
        ...told(found),
        ...(proof ? told(proof) : []),
      );
    }
    content.push(
      make("h2", {}, "The same without this page"),
      copied("Commands", words.commands || "Nothing was done yet.", "recipe-commands"),
      copied("Python", words.python, "recipe-python"),
      copied("Job file", words.job_file || "A job needs a machine.", "recipe-job"),
    );
    return content;
  }

  // Fields for a control without a guard: what is written into them goes to the server as it is.
  private guard(bounds: Words["bounds"]): HTMLElement[] {
    if (!bounds.length) return [];
    const inputs = bounds.map((each) => {
      const input = make("input", { id: `guard-${each.name}`, type: "text", inputmode: "decimal", size: "8" });
      input.value = this.given.get(each.name) ?? "";
      input.addEventListener("input", () => this.given.set(each.name, input.value));
      return input;
    });
    const labels = bounds.map((each, i) =>
      make("label", { for: inputs[i]!.id }, `${each.meaning} `, inputs[i]!, ` ${each.unit}`),
    );
    const add = () => {
      const request: Record<string, unknown> = {};
      for (const [i, each] of bounds.entries()) {
        const text = inputs[i]!.value.trim();
        const value = Number(text.replace(",", "."));
        if (text) request[each.name] = Number.isFinite(value) ? value : text;
      }
      this.ask({ do: "export.guard", ...request });
    };
    return [
      make("h2", {}, "Guard"),
      make(
        "p",
        {},
        "This control has no guard yet, and an export needs one: bounds of your machine beyond which the loop trips. Leave out what it need not watch.",
      ),
      make("div", { class: "fields" }, ...labels),
      make("div", { class: "buttons" }, button("Add the guard", add, { id: "guard-add" })),
    ];
  }
}

function told(found: Result): HTMLElement[] {
  const report = new Report("take");
  report.show(found);
  return [report.head, report.body];
}
