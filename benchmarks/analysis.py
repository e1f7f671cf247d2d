"""Margins of a loop gain of 2000 lines against python-control, and what a report costs."""

from __future__ import annotations

import dataclasses

import control
import numpy as np
from rounds import machine, measure, ratio, table

from feeddrive.artefacts.files.job import read_job
from feeddrive.artefacts.report import build
from feeddrive.artefacts.study.comparison import compare
from feeddrive.engineer.analysis.margins import margins
from feeddrive.loop.linearize import linearize, loop_gain

ROUNDS = 15


def main() -> None:
    print(machine(), "\n")
    job = read_job("ball_screw")
    loop = job.loops["today"]
    frequency = np.geomspace(1.0, 0.5 / loop.sample_time, 2000)
    L = loop_gain(loop, frequency)
    theirs = control.frd(L.response, 2.0 * np.pi * frequency)
    model = linearize(loop, ["cut"], ["force"])
    state_space = model.to_control()
    z = np.exp(2j * np.pi * frequency * loop.sample_time)
    taken = measure(
        {
            "margins": lambda: margins(L),
            "python-control stability_margins": lambda: control.stability_margins(theirs),
            "response": lambda: model.response(frequency),
            "python-control response": lambda: state_space(z),
        },
        ROUNDS,
    )
    rows = [
        [name, f"{1e3 * np.median(seconds):.3f}", f"{ratio(taken, name, base):.1f}"]
        for name, seconds, base in (
            ("margins", taken["margins"], "margins"),
            ("python-control stability_margins", taken["python-control stability_margins"], "margins"),
            ("response", taken["response"], "response"),
            ("python-control response", taken["python-control response"], "response"),
        )
    ]
    table(["2000 lines", "CPU ms", "ratio"], rows)
    study = compare(dataclasses.replace(job)).study()
    report = measure({"report": lambda: build(study)}, 5)
    table(["report of three laws", "CPU s"], [["build", f"{np.median(report['report']):.2f}"]])


if __name__ == "__main__":
    main()
