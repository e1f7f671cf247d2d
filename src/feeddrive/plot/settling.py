"""How an axis follows and comes to rest: a move, a step of the set position, and a rope that is cut."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.analysis.step_response import settling_time
from feeddrive.language.quantity import DRAWN, Quantity, Units
from feeddrive.language.text import Text
from feeddrive.loop.simulate import Run
from feeddrive.plot import style
from feeddrive.plot.chart import Chart, Curve, Level, Mark, Panel
from feeddrive.plot.drawing import drawn

if TYPE_CHECKING:
    from feeddrive.analysis.step_response import StepResponse

_AFTER = 1.6  # settling times that are shown
_LEAST = 0.01  # s that are shown at least
_BEFORE = 0.04  # of what is shown after the cut, that is shown before it
_SEEN = 1e-3  # of the step: an overshoot that is marked
_MS = 1e3


def run_chart(runs: Mapping[str, Run], units: Units = DRAWN) -> Chart:
    """Following error and force over the same time."""
    (length, micro), (force, newton) = units.of("m"), units.of("N")
    errors, forces = list[Curve](), list[Curve]()
    for i, (name, run) in enumerate(runs.items()):
        error = micro * run["following_error"]
        said = f"RMS {np.sqrt(np.mean(error**2)):.4g} {length}, peak {np.max(np.abs(error)):.4g} {length}"
        errors.append(Curve(run.time, error, name, i, said=said))
        forces.append(Curve(run.time, newton * run["force"], number=i))
    panels = Panel(f"following error ({length})", tuple(errors), share=2.0), Panel(f"force ({force})", tuple(forces))
    end = max(float(run.time[-1]) for run in runs.values())
    return Chart("time (s)", panels, low=0.0, high=end, height=4.2)


def step_response(found: StepResponse | Mapping[str, StepResponse]) -> Any:
    """Position after a step of the set position, with overshoot and settling time."""
    return drawn(step_chart(found))


def step_chart(responses: StepResponse | Mapping[str, StepResponse]) -> Chart:
    """What `step_response` shows."""
    chosen = style.named(responses)
    curves, marks = list[Curve](), list[Mark]()
    end = max(_LEAST, *(_AFTER * each.settling_time for each in chosen.values()))
    for i, (name, found) in enumerate(chosen.items()):
        said = Text(
            f"overshoot {Quantity(found.overshoot, 'share'):.1f}, settled to {Quantity(found.settled, 'share'):6} in "
            f"{_MS * found.settling_time:.4g} ms"
        )
        there = found.time <= end
        curves.append(Curve(_MS * found.time[there], found.position[there], name, i, said=said))
        if found.overshoot > _SEEN:
            marks.append(Mark(_MS * found.overshoot_time, found.final * (1.0 + found.overshoot), i))
        marks.append(Mark(_MS * found.settling_time, _at(found), i, hollow=True))
    near = next(iter(chosen.values())).settled
    levels = Level(1.0), Level(1.0 + near, dashed=True), Level(1.0 - near, dashed=True)
    panel = Panel("position (part of the step)", tuple(curves), marks=tuple(marks), levels=levels)
    return Chart("time (ms)", (panel,), low=0.0, high=_MS * end, columns=1)


def _at(found: StepResponse) -> float:
    return float(np.interp(found.settling_time, found.time, found.position))


def snap_chart(runs: Mapping[str, Run], begin: float, near: float, units: Units = DRAWN) -> Chart:
    """Error of the table after a rope that pulled at it was cut at `begin` (s), and the force.

    near  m: within it the table counts as settled
    """
    (length, micro), (force, newton) = units.of("m"), units.of("N")
    known = dict[str, tuple[float, float]]()
    for name, run in runs.items():
        after = run.time >= begin - 0.5 * run.sample_time
        error = run["tracking_error"][after]
        known[name] = float(np.max(np.abs(error))), settling_time(run.time[after] - begin, error, near)
    last = max(float(run.time[-1]) - begin for run in runs.values())
    end = min(max(_LEAST, *(_AFTER * settled for _, settled in known.values())), last)
    errors, forces = list[Curve](), list[Curve]()
    for i, (name, run) in enumerate(runs.items()):
        peak, settled = known[name]
        rest = "not settled" if np.isinf(settled) else f"settled in {_MS * settled:.4g} ms"
        said = f"peak {micro * peak:.4g} {length}, {rest} to ±{micro * near:.3g} {length}"
        there = (run.time >= begin - _BEFORE * end) & (run.time <= begin + end)
        time = _MS * (run.time[there] - begin)
        errors.append(Curve(time, micro * run["tracking_error"][there], name, i, said=said))
        forces.append(Curve(time, newton * run["force"][there], number=i))
    levels = Level(0.0, faint=True), Level(micro * near, dashed=True), Level(-micro * near, dashed=True)
    panels = (
        Panel(f"error of the table ({length})", tuple(errors), levels=levels, share=2.0),
        Panel(f"force ({force})", tuple(forces)),
    )
    return Chart("time after the cut (ms)", panels, low=-_MS * _BEFORE * end, high=_MS * end, height=4.2, columns=1)
