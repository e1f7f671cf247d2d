"""From a measured response of 2000 lines to tuned gains."""

from __future__ import annotations

import numpy as np
from rounds import machine, measure, table

import feeddrive as fd

ROUNDS = 7


def response(loop: fd.Loop, source: str, reading: str, random: np.random.Generator) -> fd.FRF:
    """One per cent of noise on each of 2000 lines."""
    lines = np.arange(1.0, 2001.0)
    model = fd.linearize(loop, ["cut", "load_force"], [reading])  # with the loop cut, whatever the source
    true = model.response(lines, reading, source).response
    a, b = random.standard_normal((2, lines.size))
    noise = 0.01 * np.abs(true) * (a + 1j * b) / np.sqrt(2.0)
    return fd.FRF(lines, true + noise, source, reading, "m/N", loop.sample_time, variance=(0.01 * np.abs(true)) ** 2)


def main() -> None:
    print(machine(), "\n")
    random = np.random.default_rng(0)
    loop = fd.read_machine("ball_screw").loop("x")
    load, motor, struck, back = (
        response(loop, source, reading, random)
        for source in ("cut", "load_force")
        for reading in ("reading_load", "reading_motor")
    )
    T = loop.sample_time
    limits = fd.tuning.Limits(sensitivity_peak=2.0, compliance_peak_m_per_N=0.2e-6)

    def one() -> fd.tuning.Tuned:
        return fd.tuning.tune_control(
            loop.control, fd.tuning.measured_point(motor, sample_time=T), limits=fd.tuning.Limits(), filters="kept"
        )

    def two() -> fd.tuning.Tuned:
        return fd.tuning.tune_control(
            loop.control,
            fd.tuning.measured_point(load, motor, sample_time=T),
            limits=fd.tuning.Limits(),
            filters="kept",
        )

    def four(filters: str) -> fd.tuning.Tuned:
        point = fd.tuning.measured_point(load, motor, disturbance=(struck, back), sample_time=T)
        return fd.tuning.tune_control(loop.control, point, limits=limits, filters=filters)

    cases = {
        "one response (one encoder), three gains": one,
        "two responses (two encoders), three gains": two,
        "four responses (two encoders, hammer), three gains": lambda: four("kept"),
        "the same, gains and filters": lambda: four("free"),
        "the same, notches placed": lambda: four("placed"),
    }
    taken = measure(cases, ROUNDS)
    table(["2000 lines to tuned gains", "CPU s"], [[name, f"{np.median(taken[name]):.2f}"] for name in cases])


if __name__ == "__main__":
    main()
