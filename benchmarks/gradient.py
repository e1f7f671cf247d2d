"""The gradient of a 40,000-sample tracking cost to 6 gains, as a multiple of a plain run of the same loop.

The smooth loop has no quantiser, no force limit and regularised friction, so that central differences have a meaning.
Native time is what passes inside the machine code; call time is all of `gradient(...)` and `simulate(...)`.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from rounds import machine, measure, ratio, table
from workload import loop, reference

from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.language import tree
from feeddrive.loop.engine.llvm import Native
from feeddrive.loop.gradient import gradient
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

GAINS = (
    "axis.x.control.law.Kv",
    "axis.x.control.law.Kp",
    "axis.x.control.law.Tn",
    "axis.x.control.filters.0.frequency",
    "axis.x.control.feedforward.0.mass",
    "axis.x.control.feedforward.0.viscous",
)
ROUNDS = 41
_spent = [0]


@contextmanager
def counted() -> Iterator[None]:
    """Adds up the CPU time inside machine code."""
    plain = Native.run

    def run(self: Native, *given: object) -> None:
        begun = time.thread_time_ns()
        plain(self, *given)  # type: ignore[arg-type]
        _spent[0] += time.thread_time_ns() - begun

    Native.run = run  # type: ignore[method-assign]
    try:
        yield
    finally:
        Native.run = plain  # type: ignore[method-assign]


def smooth_loop() -> Loop:
    """The loop of the speed bars without quantisers and force limit, and with friction that has a slope everywhere."""
    plain = loop()
    friction = Regularised(
        coulomb=250.0, breakaway=400.0, stribeck_velocity=0.002, transition_velocity=0.0002, viscous=700.0
    )
    axis = dataclasses.replace(plain.axis, encoder_motor=None, encoder_load=None, friction_load=friction)
    return dataclasses.replace(plain, axis=axis, control=dataclasses.replace(plain.control, force_limit=None))


def main() -> None:
    print(machine(), "\n")
    path, smooth = reference(), smooth_loop()
    rows = []
    for name, subject in (("as in the speed bars", loop()), ("smooth", smooth)):

        def run(subject: Loop = subject) -> None:
            simulate(subject, path, record=("tracking_error",))

        def slope(subject: Loop = subject) -> None:
            gradient(subject, path, GAINS)

        both = {"run": run, "gradient": slope}
        calls = measure(both, ROUNDS)
        with counted():
            inside = measure(both, ROUNDS, clock=lambda: _spent[0])
        for what, taken in (("native code", inside), ("whole call", calls)):
            medians = [f"{1e3 * np.median(taken[each]):.2f}" for each in both]
            rows.append([f"{name}: {what}", *medians, f"{ratio(taken, 'gradient', 'run'):.2f}"])
    table(["loop, CPU time", "run ms", "gradient ms", "ratio"], rows)

    def cost(name: str, value: float) -> float:
        error = simulate(tree.vary(smooth, {name: value}), path, record=("tracking_error",))["tracking_error"]
        return float(np.mean(error**2))

    found = gradient(smooth, path, GAINS)
    rows = []
    for name in GAINS:
        value = found.values[name]
        wide, narrow = (
            (cost(name, value + h) - cost(name, value - h)) / (2.0 * h) for h in (2e-4 * value, 1e-4 * value)
        )
        differences = (4.0 * narrow - wide) / 3.0  # Richardson: takes the curvature out
        off = found.gradient[name] / differences - 1.0
        rows.append([name, f"{found.gradient[name]:.6e}", f"{differences:.6e}", f"{off:+.1e}"])
    table(["gain", "gradient", "central differences", "relative difference"], rows)


if __name__ == "__main__":
    main()
