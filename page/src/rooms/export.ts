// What is taken away: files to download, exports, and all that was done as commands, Python and a job.

import { badge, empty, imports } from "../empty";
import { button, copied, make, renew } from "../parts";
import { Report, type Result } from "../result";
import { result, type Ask, type Room } from "../room";
import type { Received } from "../wire";

// The words of this view; results come from the server.
const TEXT = {
  title: "Take the tuned control to your machine.",
  sentence:
    "The control leaves as a machine file, as code for your controller or as numbers to enter, and each export is checked against the simulation.",
  example: "From the C source: the P-PI cascade, one sample",
  machine: "Machine file",
  report: (name: string) => `Report: ${name}`,
  targets: "For your controller",
  download: (name: string) => `Download ${name}`,
  verify: "Compile and compare, bit for bit",
  limits: "Safety limits",
  no_limits:
    "This control has no safety limits yet, and an export needs some: values of your machine beyond which the loop trips. Leave out what it need not watch.",
  add: "Add",
  repeat: "Repeat this without the page",
  command_line: "Command line",
  python: "Python",
  job: "Job file",
  none: "No steps yet",
  no_job: "A job needs a machine.",
};
const TARGETS: Record<string, [title: string, line: string]> = {
  c: ["C source", "one function for each sample"],
  linuxcnc: ["LinuxCNC component", "runs in the servo thread"],
  "linuxcnc-pid": ["LinuxCNC pid", "numbers for the pid that is there"],
  fmu2: ["FMU 2.0", "for co-simulation"],
  fmu3: ["FMU 3.0", "for co-simulation"],
  "cortex-m": ["Cortex-M", "C for a microcontroller"],
  st: ["Structured text", "for a PLC, IEC 61131-3"],
  parameters: ["Parameters", "numbers as makers of drives name them"],
};

interface Words {
  ready: boolean;
  targets: string[];
  of: string; // whose code the example is
  example: string;
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
    if (!words.ready) {
      const code = make("pre", { tabindex: "0", "aria-label": TEXT.example }, words.example);
      const shows = make("div", { class: "code" }, make("h2", {}, TEXT.example), code);
      const example = { of: badge(words.of), shows };
      return [empty({ title: TEXT.title, sentence: TEXT.sentence, act: imports(), example })];
    }
    const machine = button(TEXT.machine, () => this.ask({ do: "export.machine" }), { id: "export-machine", class: "main" });
    machine.disabled = !words.ready;
    const results = words.results.map(({ name, said }) => {
      const give = button(TEXT.report(name), () => this.ask({ do: "export.result", name }), { id: `export-result-${name}` });
      if (!said) return give;
      give.setAttribute("aria-describedby", `export-said-${name}`);
      return make("span", {}, give, make("span", { id: `export-said-${name}` }, ` ${said}`));
    });
    const targets = words.targets.map((target) => {
      const [title, line] = TARGETS[target] ?? [target, ""];
      const act = () => this.ask({ do: "export.export", target });
      const found = button("", act, { id: `export-target-${target}`, class: "target" });
      found.append(make("b", {}, title), make("small", {}, line));
      return found;
    });
    const content = [
      make("div", { class: "buttons" }, machine, ...results),
      ...this.guard(words.bounds),
      make("h2", {}, TEXT.targets),
      make("div", { class: "targets" }, ...targets),
    ];
    for (const [target, found] of Object.entries(words.exports)) {
      const proof = words.verified[target];
      content.push(
        make("h3", {}, TARGETS[target]?.[0] ?? target),
        make(
          "div",
          { class: "buttons" },
          make(
            "a",
            { href: result(found.archive), download: found.archive, id: `export-archive-${target}` },
            TEXT.download(found.archive),
          ),
          button(TEXT.verify, () => this.ask({ do: "export.verify", target }), {
            id: `export-verify-${target}`,
            "aria-label": `${TEXT.verify}: ${target}`,
          }),
        ),
        ...told(found),
        ...(proof ? told(proof) : []),
      );
    }
    content.push(
      make("h2", {}, TEXT.repeat),
      copied(TEXT.command_line, words.commands.trim() || TEXT.none, "recipe-commands"),
      copied(TEXT.python, words.python, "recipe-python"),
      copied(TEXT.job, words.job_file || TEXT.no_job, "recipe-job"),
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
      make("h2", {}, TEXT.limits),
      make("p", {}, TEXT.no_limits),
      make("div", { class: "fields" }, ...labels),
      make("div", { class: "buttons" }, button(TEXT.add, add, { id: "guard-add" })),
    ];
  }
}

function told(found: Result): HTMLElement[] {
  const report = new Report("take");
  report.show(found);
  return [report.head, report.body];
}
