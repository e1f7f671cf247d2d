// The work that runs on the server: where it stands, how long it has taken, and the button that stops it.

import { button, make } from "./parts";
import type { Ask } from "./room";
import type { Job } from "./wire";

export class JobBar {
  readonly element = make("div", { id: "job", role: "group", "aria-label": "The work that runs", hidden: "" });
  readonly spoken = make("p", { id: "job-said", class: "spoken", role: "status" }); // state and step, not each count
  private readonly words = make("span");
  private readonly bar = make("progress", { "aria-label": "Progress" });
  private readonly remarks = make("pre", { tabindex: "0", "aria-label": "Remarks" });
  private readonly stop: HTMLButtonElement;
  private readonly close: HTMLButtonElement;
  private shown = "";
  private closed = ""; // the ended work that somebody has read

  constructor(ask: Ask) {
    this.stop = button("Cancel", () => ask({ do: "job.cancel" }), { id: "cancel" });
    this.close = button("Close", () => this.away(), { id: "job-close", "aria-label": "Close what is said of this work" });
    // the buttons first: behind the words they would move under the pointer with each step that is reported
    this.element.append(this.stop, this.close, this.bar, this.words, this.remarks);
  }

  show(job: Job | undefined): void {
    if (!job) return;
    const going = job.state === "waiting" || job.state === "running";
    this.shown = JSON.stringify(job);
    this.element.hidden = job.state === "done" || this.shown === this.closed;
    this.element.dataset.state = job.state;
    this.stop.hidden = this.bar.hidden = !going;
    this.close.hidden = going;
    const said = `${job.what}: ${job.state}${going && job.step ? `, ${job.step}` : ""}${job.error ? `: ${job.error}` : ""}`;
    if (this.spoken.textContent !== said) this.spoken.textContent = said;
    const counted = job.done !== null && job.of ? `, ${job.done} of ${job.of}` : "";
    const step = going && job.step ? `: ${job.step}${counted}` : "";
    this.words.textContent = `${job.what}${step}${going ? ` (${job.seconds.toFixed(0)} s)` : ` ${job.state}`}${job.error ? `: ${job.error}` : ""}`;
    this.remarks.textContent = job.state === "failed" ? job.remarks.join("\n") : (job.remarks.at(-1) ?? "");
    this.remarks.hidden = !this.remarks.textContent;
    if (job.done !== null && job.of) {
      this.bar.max = job.of;
      this.bar.value = job.done;
    } else this.bar.removeAttribute("value");
  }

  private away(): void {
    this.closed = this.shown;
    this.element.hidden = true;
    document.querySelector<HTMLElement>('[role="tab"][aria-selected="true"]')?.focus(); // the button is gone
  }
}
