"""Draws docs/images/tuning.svg: dynamic stiffness of the ball screw today, and tuned from its noisy response."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import feeddrive as fd
from feeddrive import plot


def measured(loop: fd.Loop, random: np.random.Generator) -> fd.tuning.OperatingPoint:
    """Two encoders, drive and hammer, one per cent of noise on each of 2000 lines."""
    lines = np.arange(1.0, 2001.0)
    model = fd.linearize(loop, ["cut", "load_force"], ["reading_load", "reading_motor"])
    found = {}
    for source in model.inputs:
        for reading in model.outputs:
            true = model.response(lines, reading, source).response
            a, b = random.standard_normal((2, lines.size))
            values = true + 0.01 * np.abs(true) * (a + 1j * b) / np.sqrt(2.0)
            variance = (0.01 * np.abs(true)) ** 2
            found[source, reading] = fd.FRF(lines, values, source, reading, "m/N", loop.sample_time, variance=variance)
    struck = (found["load_force", "reading_load"], found["load_force", "reading_motor"])
    return fd.tuning.measured_point(
        found["cut", "reading_load"], found["cut", "reading_motor"], disturbance=struck, sample_time=loop.sample_time
    )


def main() -> None:
    """Draw it."""
    loop = fd.read_machine("ball_screw").loop("x")
    point = measured(loop, np.random.default_rng(0))
    limits = fd.tuning.Limits(sensitivity_peak=2.0, compliance_peak_m_per_N=0.2e-6)
    free = fd.tuning.tune_control(loop.control, point, limits=limits, filters="placed")
    soft = fd.tuning.tune_control(loop.control, point, goal="bandwidth", limits=limits, filters="kept")
    curves = {
        "today": free.before[0],
        "for bandwidth, gains alone": soft.after[0],
        "for rope snap, with a notch": free.after[0],
    }
    figure = plot.stiffness({name: each.stiffness for name, each in curves.items()})
    figure.savefig(Path(__file__).parent / "images" / "tuning.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
