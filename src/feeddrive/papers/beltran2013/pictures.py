"""The paper's kinds of figures, and what it does not show: what the observer leaves over near the teeth."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from feeddrive.loop.linearize import compliance
from feeddrive.loop.simulate import Run
from feeddrive.papers.beltran2013 import limits
from feeddrive.papers.beltran2013.cut import Turn
from feeddrive.papers.beltran2013.mill import AXES, Case, disturbances, loop
from feeddrive.plot import milling
from feeddrive.report.content import Shown

TEETH = (60.0, "teeth pass")  # Hz
STATES = (1, 3, 5)
FREQUENCY = np.geomspace(3.0, 500.0, 400)  # Hz


def pictures(
    turned: Turn,
    without: Mapping[str, Run],
    compensated: Mapping[str, Run],
    sines: Mapping[int, tuple[np.ndarray, np.ndarray]],
) -> tuple[Shown, ...]:
    """All figures, drawn when asked for; `sines` holds frequencies (Hz) and measured |1 - H| by Taylor states."""
    return (
        Shown(
            "force",
            "Cutting force over a turn of the spindle",
            "The tool in a slot with the corrected data; the means are -112.5 N against the feed and 375 N across it.",
            "three forces over the angle of the spindle, each repeating twice in a turn",
            partial(
                milling.turn,
                turned.angle,
                {"along the feed": turned.feed, "normal": turned.normal, "axial": turned.axial},
            ),
        ),
        Shown(
            "without",
            "Tracking error without the estimate",
            "Linear reference, first along y and then along x. The z axis hangs by its weight over omega_c².",
            "tracking errors of three axes in the range of 10 mm",
            partial(_errors, without, 1e3, "tracking error (mm)"),
        ),
        Shown(
            "compensated",
            "Tracking error with the estimate subtracted",
            "The same legs. What is left of x and y comes from the jump of the set velocity, not from the cut.",
            "tracking errors of three axes, of some 100 µm where the reference jumps",
            partial(_errors, compensated, 1e6, "tracking error (µm)"),
        ),
        Shown(
            "disturbance",
            "Disturbance and its estimate",
            "In m/s² over a few turns of the spindle; the estimate has the mean, and at 60 Hz it leads by 28°.",
            "disturbance of three axes and its estimate, which differs from it in phase and shape",
            partial(_disturbance, compensated),
        ),
        Shown(
            "control",
            "Control force",
            "Force at the carriage; torque of the motor is lead / 2π times it.",
            "control force of three axes over time",
            partial(_control, compensated),
        ),
        Shown(
            "leftover",
            "What is left of a disturbance over frequency",
            "|1 - H|: below 1 the estimate helps, above 1 subtracting it makes the disturbance larger. More Taylor "
            "states help below and cost above.",
            "curves that rise from small values to a peak above 1 near 140 Hz",
            partial(_left_over, sines),
        ),
        Shown(
            "stiffness",
            "Compliance of the axis",
            "Position over force on the carriage, closed loop on x, with and without the estimate.",
            "compliance over frequency for no compensation and one, three and five Taylor states",
            _compliance,
        ),
    )


def _errors(runs: Mapping[str, Run], factor: float, quantity: str) -> Any:
    rows = {axis: {"error": factor * runs[axis]["tracking_error"]} for axis in AXES}
    return milling.by_axis(runs["x"].time, rows, quantity)


def _control(runs: Mapping[str, Run]) -> Any:
    return milling.by_axis(runs["x"].time, {axis: {"force": runs[axis]["force"]} for axis in AXES}, "force (N)")


def _disturbance(runs: Mapping[str, Run]) -> Any:
    rows: dict[str, dict[str, np.ndarray]] = {}
    shown = (runs["x"].time >= 0.9) & (runs["x"].time < 1.05)
    for axis in AXES:
        true, estimate = disturbances(axis, Case("with the estimate"), runs[axis])
        rows[axis] = {"true": true[shown], "estimated": estimate[shown]}
    return milling.by_axis(runs["x"].time[shown], rows, "disturbance (m/s²)")


def _left_over(sines: Mapping[int, tuple[np.ndarray, np.ndarray]]) -> Any:
    curves = {_name(n): (FREQUENCY, np.abs(limits.left_over(limits.observer_of(n), FREQUENCY))) for n in STATES}
    return milling.left_over(curves, {_name(n): sines[n] for n in sines}, "left over (1)", TEETH)


def _compliance() -> Any:
    cases = {"not subtracted": Case("", share=0.0), **{_name(n): Case("", taylor_states=n) for n in STATES}}
    curves = {name: (FREQUENCY, 1e6 * compliance(loop("x", case), FREQUENCY).magnitude) for name, case in cases.items()}
    return milling.left_over(curves, {}, "compliance (µm/N)", TEETH, one=False)


def _name(taylor_states: int) -> str:
    return "1 Taylor state" if taylor_states == 1 else f"{taylor_states} Taylor states"
