// The work on the server: in its own view and in the top bar where it stands, how long it takes, what waits behind it,
// and what the end of the server interrupted. On the rail a shape says of each view that it runs, is done or has failed.

import { icon, type Icon } from "./icons";
import { button, make, renew } from "./parts";
import type { Ask } from "./room";
import type { Job, Task, Work } from "./wire";

const MARKS: Record<string, [Icon, string] | undefined> = {
  running: ["running", "runs"],
  waiting: ["waiting", "waits for its turn"],
  done: ["kept", "has a result"],
  failed: ["broken", "failed"],
  broken_off: ["waiting", "was interrupted"],
};
const NEAR = 1; // s: a shorter rest is not worth a word

export class Works {
  readonly element = make("div", { id: "job", role: "group", "aria-label": "The work that runs", hidden: "" });
  readonly spoken = make("p", { id: "job-said", class: "spoken", role: "status" }); // state and step, not each count
  readonly bar = make("div", { id: "works", hidden: "" }); // in the top bar
  readonly list = make("section", { id: "works-list", "aria-label": "Jobs", hidden: "" });
  private readonly words = make("span");
  private readonly progress = make("progress", { "aria-label": "Progress" });
  private readonly remarks = make("pre", { tabindex: "0", "aria-label": "Remarks" });
  private readonly stop: HTMLButtonElement;
  private readonly close: HTMLButtonElement;
  private readonly chip: HTMLButtonElement;
  private readonly cancel: HTMLButtonElement;
  private readonly said = make("span");
  private readonly shape = make("span", { class: "shape" });
  private job: Job | null = null;
  private work: Work | null = null;
  private open = "";
  private unknown = false;
  private heard = 0; // performance.now() of the last word of the job
  private shown = "";
  private closed = ""; // the ended work that somebody has read

  constructor(
    private readonly ask: Ask,
    private readonly titles: ReadonlyMap<string, string>, // of the views
    private readonly mark: (view: string, drawing: Icon | null, words: string) => void,
  ) {
    const cancel = () => ask({ do: "job.cancel" });
    this.stop = button("Cancel", cancel, { id: "cancel" });
    this.close = button("Close", () => this.away(), { id: "job-close", "aria-label": "Close what is said of this work" });
    this.chip = button("", () => this.toggle(), { id: "works-open", "aria-expanded": "false", "aria-controls": "works-list" });
    this.chip.append(this.shape, this.said);
    this.cancel = button("Cancel", cancel, { id: "works-cancel" });
    this.bar.append(this.chip, this.cancel);
    // the buttons first: behind the words they would move under the pointer with each step that is reported
    this.element.append(this.stop, this.close, this.progress, this.words, this.remarks);
    setInterval(() => this.tick(), 1000);
  }

  // The view that is open: only there the work stands below the pictures.
  at(view: string): void {
    this.open = view;
    this.list.hidden = true;
    this.chip.setAttribute("aria-expanded", "false");
    this.place();
  }

  // Without a server nobody knows how its work stands.
  lost(): void {
    this.unknown = true;
    this.told();
  }

  // Whether a job is running that Esc may cancel.
  get runs(): boolean {
    return this.job?.state === "waiting" || this.job?.state === "running";
  }

  // Close the list; false if it was closed already.
  fold(): boolean {
    if (this.list.hidden) return false;
    this.toggle();
    this.chip.focus();
    return true;
  }

  show(job: Job | undefined, work: Work | undefined): void {
    this.unknown = false;
    if (work) this.listed(work);
    if (!job) {
      // the server has none: another one ended with its work
      if (work) this.job = null;
      this.place();
      return this.told();
    }
    this.job = job;
    this.heard = performance.now();
    const going = this.runs;
    this.shown = JSON.stringify(job);
    this.element.dataset.state = job.state;
    this.stop.hidden = this.progress.hidden = !going;
    this.close.hidden = going;
    this.place();
    const said = `${job.what}: ${job.state}${going && job.step ? `, ${job.step}` : ""}${job.error ? `: ${job.error}` : ""}`;
    if (this.spoken.textContent !== said) this.spoken.textContent = said;
    this.remarks.textContent = job.state === "failed" ? job.remarks.join("\n") : (job.remarks.at(-1) ?? "");
    this.remarks.hidden = !this.remarks.textContent;
    if (job.done !== null && job.of) {
      this.progress.max = job.of;
      this.progress.value = job.done;
    } else this.progress.removeAttribute("value");
    this.tick();
    this.told();
  }

  private place(): void {
    const { job } = this;
    this.element.hidden = !job || job.state === "done" || job.room !== this.open || this.shown === this.closed;
  }

  // What is said of the job, with the seconds of now.
  private tick(): void {
    const { job } = this;
    if (!job) return;
    const counted = job.done !== null && job.of ? `, ${job.done} of ${job.of}` : "";
    const step = this.runs && job.step ? `: ${job.step}${counted}` : "";
    const end = this.runs ? ` (${this.time(job)})` : ` ${job.state}`;
    this.words.textContent = `${job.what}${step}${end}${job.error ? `: ${job.error}` : ""}`;
    this.told();
  }

  private time(job: Job): string {
    if (this.unknown) return "disconnected";
    const since = (performance.now() - this.heard) / 1000;
    const left = job.left === null ? 0 : job.left - since;
    return `${seconds(job.seconds + since)}${left > NEAR ? `, about ${seconds(left)} left at this rate` : ""}`;
  }

  // The chip of the top bar.
  private told(): void {
    const { job, work } = this;
    const waiting = work?.queue.length ?? 0;
    const off = work?.broken_off.length ?? 0;
    this.bar.hidden = !this.runs && !waiting && !off;
    this.cancel.hidden = !this.runs || this.unknown;
    if (this.bar.hidden) return void (this.list.hidden = true);
    const behind = waiting ? `, ${waiting} waiting` : "";
    const name = job && this.runs ? `${this.titles.get(job.room) ?? job.what}` : "";
    const step = job?.step ? `: ${job.step}` : "";
    this.said.textContent = job && this.runs ? `${name}${step}, ${this.time(job)}${behind}` : `${off} interrupted${behind}`;
    this.chip.title = job && this.runs ? job.what : "Jobs that the end of the server interrupted";
    const state = this.runs ? "running" : "broken_off";
    if (this.shape.dataset.state !== state) this.shape.replaceChildren(icon(MARKS[state]![0]));
    this.shape.dataset.state = state;
  }

  private listed(work: Work): void {
    this.work = work;
    for (const [view, title] of this.titles) {
      const off = work.broken_off.some((each) => each.room === view);
      const state = work.marks[view] ?? (off ? "broken_off" : "");
      const known = MARKS[state];
      const why = state === "failed" ? `: ${work.failures[view] ?? ""}` : "";
      this.mark(view, known?.[0] ?? null, known ? `${title} ${known[1]}${why}` : "");
    }
    const { queue, broken_off } = work;
    renew(this.list, [queue, broken_off], () => [
      ...(queue.length ? [make("h2", {}, "Waiting"), this.rows(queue, (each, i) => this.waits(each, i))] : []),
      ...(broken_off.length
        ? [make("h2", {}, "Interrupted by the end of the server"), this.rows(broken_off, (each) => this.broken(each))]
        : []),
      ...(queue.length || broken_off.length ? [] : [make("p", {}, "Nothing waits behind the work that runs.")]),
    ]);
  }

  private rows(tasks: Task[], buttons: (task: Task, place: number) => HTMLElement[]): HTMLElement {
    const row = (task: Task, i: number) =>
      make(
        "li",
        {},
        make("span", {}, make("small", {}, this.titles.get(task.room) ?? task.room), ` ${task.what}`),
        ...buttons(task, i),
      );
    return make("ol", {}, ...tasks.map(row));
  }

  private waits({ number, what }: Task, place: number): HTMLElement[] {
    const sooner = button("Sooner", () => this.ask({ do: "job.sooner", task: number }), {
      id: `sooner-${number}`,
      "aria-label": `Sooner: ${what}`,
    });
    sooner.disabled = place === 0;
    if (place === 0) sooner.title = "it is the next one already";
    const gone = button("Remove", () => this.ask({ do: "job.remove", task: number }), {
      id: `remove-${number}`,
      "aria-label": `Remove: ${what}`,
    });
    return [sooner, gone];
  }

  private broken({ number, what, moves }: Task): HTMLElement[] {
    const on = button(moves ? "Go there" : "Go on", () => this.ask({ do: "job.resume", task: number }), {
      id: `resume-${number}`,
      "aria-label": `${moves ? "Go there" : "Go on"}: ${what}`,
      title: moves ? "It moves an axis: it is begun in its own view" : "With the control for which it was asked",
    });
    const gone = button("Discard", () => this.ask({ do: "job.remove", task: number }), {
      id: `discard-${number}`,
      "aria-label": `Discard: ${what}`,
    });
    return [on, gone];
  }

  private toggle(): void {
    this.list.hidden = !this.list.hidden;
    this.chip.setAttribute("aria-expanded", String(!this.list.hidden));
  }

  private away(): void {
    this.closed = this.shown;
    this.element.hidden = true;
    document.querySelector<HTMLElement>('[role="tab"][aria-selected="true"]')?.focus(); // the button is gone
  }
}

// 48 s, or 3 min 20 s.
export function seconds(time: number): string {
  const whole = Math.round(time);
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}
