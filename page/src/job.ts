// The work that runs on the server: where it stands, how long it has taken, and the button that stops it.

import { button, make } from "./parts";
import type { Ask } from "./room";
import type { Job } from "./wire";

export class JobBar {
  readonly element = make("div", { id: "job", role: "status", hidden: "" });
  private readonly words = make("span");
  private readonly bar = make("progress", { "aria-label": "Progress" });
  private readonly remarks = make("pre", { tabindex: "0", "aria-label": "Remarks" });
  private readonly stop: HTMLButtonElement;

  constructor(ask: Ask) {
    this.stop = button("Cancel", () => ask({ do: "job.cancel" }), { id: "cancel" });
    this.element.append(this.bar, this.words, this.stop, this.remarks);
  }

  show(job: Job | undefined): void {
    if (!job) return;
    const going = job.state === "waiting" || job.state === "running";
    this.element.hidden = job.state === "done";
    this.element.dataset.state = job.state;
    this.stop.hidden = this.bar.hidden = !going;
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
}
