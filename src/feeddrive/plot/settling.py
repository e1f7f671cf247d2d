"""How an axis follows and comes to rest: a move, a step of the set position, and a rope that is cut."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.analysis.step_response import settling_time
from feeddrive.language.quantity import DRAWN, Quantity, Units, unit_name
from feeddrive.language.text import Text
from feeddrive.loop.simulate import Run
from feeddrive.plot import style
from feeddrive.plot.chart import Chart, Curve, Level, Mark, Panel

if TYPE_CHECKING:
    from feeddrive.analysis.step_response import StepResponse

_AFTER = 1.6  # settling times that are shown
_LEAST = 0.01  # s that are shown at least
_BEFORE = 0.04  # of what is shown after the cut, that is shown before it
_SEEN = 1e-3  # of the step: an overshoot that is marked
_MS = 1e3


def moves_chart(runs: Mapping[str, Run], units: Units = DRAWN) -> Chart:
    """Following error and force over the same time."""
    micro, newton = (units.of(unit)[1] for unit in ("m", "N"))
    errors, forces = list[Curve](), list[Curve]()
    for i, (name, run) in enumerate(runs.items()):
        error = run["following_error"]
        rms, peak = (Quantity(size, "m") for size in (np.sqrt(np.mean(error**2)), np.max(np.abs(error))))
        errors.append(Curve(run.time, micro * error, name, i, caption=Text(f"RMS {rms}, peak {peak}")))
        forces.append(Curve(run.time, newton * run["force"], number=i))
    panels = (
        Panel(f"following error ({unit_name('m')})", tuple(errors), share=2.0),
        Panel(f"force ({unit_name('N')})", tuple(forces)),
    )
    end = max(float(run.time[-1]) for run in runs.values())
    return Chart("time (s)", panels, low=0.0, high=end, height=4.2)


def step_response_chart(responses: StepResponse | Mapping[str, StepResponse]) -> Chart:
    """Position after a step of the set position, with overshoot and settling time."""
    chosen = style.named(responses)
    curves, marks = list[Curve](), list[Mark]()
    end = max(_LEAST, *(_AFTER * response.settling_time for response in chosen.values()))
    for i, (name, response) in enumerate(chosen.items()):
        caption = Text(
            f"overshoot {Quantity(response.overshoot, 'share'):.1f}, "
            f"settled to {Quantity(response.settled, 'share'):6} in {Quantity(response.settling_time, 's')}"
        )
        there = response.time <= end
        curves.append(Curve(_MS * response.time[there], response.position[there], name, i, caption=caption))
        if response.overshoot > _SEEN:
            marks.append(Mark(_MS * response.overshoot_time, response.final * (1.0 + response.overshoot), i))
        marks.append(Mark(_MS * response.settling_time, _at(response), i, hollow=True))
    near = next(iter(chosen.values())).settled
    levels = Level(1.0), Level(1.0 + near, dashed=True), Level(1.0 - near, dashed=True)
    panel = Panel("position (part of the step)", tuple(curves), marks=tuple(marks), levels=levels)
    return Chart("time (ms)", (panel,), low=0.0, high=_MS * end, columns=1)


def _at(response: StepResponse) -> float:
    return float(np.interp(response.settling_time, response.time, response.position))


def snap_chart(runs: Mapping[str, Run], begin: float, near: float, units: Units = DRAWN) -> Chart:
    """Error of the table after a rope that pulled at it was cut at `begin` (s), and the force.

    near  m: within it the table counts as settled
    """
    micro, newton = (units.of(unit)[1] for unit in ("m", "N"))
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
        rest = "not settled" if np.isinf(settled) else f"settled in {Quantity(settled, 's')}"
        caption = Text(f"peak {Quantity(peak, 'm')}, {rest} to ±{Quantity(near, 'm'):3}")
        there = (run.time >= begin - _BEFORE * end) & (run.time <= begin + end)
        time = _MS * (run.time[there] - begin)
        errors.append(Curve(time, micro * run["tracking_error"][there], name, i, caption=caption))
        forces.append(Curve(time, newton * run["force"][there], number=i))
    levels = Level(0.0, faint=True), Level(micro * near, dashed=True), Level(-micro * near, dashed=True)
    panels = (
        Panel(f"error of the table ({unit_name('m')})", tuple(errors), levels=levels, share=2.0),
        Panel(f"force ({unit_name('N')})", tuple(forces)),
    )
    return Chart("time after the cut (ms)", panels, low=-_MS * _BEFORE * end, high=_MS * end, height=4.2, columns=1)
