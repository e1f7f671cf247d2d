"""The pictures of the page: the loop before, by hand and as it was kept, from the same charts as in reports."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from feeddrive.loop.simulate import Run
from feeddrive.plot.chart import Chart, Curve, Panel
from feeddrive.plot.complex_plane import nyquist_chart
from feeddrive.plot.over_frequency import open_loop_chart, sensitivity_chart, stiffness_chart
from feeddrive.tuning.by_hand import Look


def charts(looks: Mapping[str, Look], runs: Mapping[str, Run], *, rotary: bool = False) -> dict[str, Chart]:
    """By name; of several operating points the one that leads: the largest Ms, or one that is not stable.

    rotary  the axis turns: the pictures are then in rad and N m

    A loop that is not stable has an open loop and a Nyquist curve, and neither sensitivity nor stiffness.
    """
    leading = {name: look.leading for name, look in looks.items()}
    margins = {name: each.margins for name, each in leading.items()}
    stable = {name: each for name, each in leading.items() if each.stable}
    found = {"open_loop": open_loop_chart(margins), "nyquist": nyquist_chart(margins)}
    if stable:
        found["sensitivity"] = sensitivity_chart({name: each.margins for name, each in stable.items()})
        found["stiffness"] = stiffness_chart({name: each.stiffness for name, each in stable.items()})
    if runs:
        found["run"] = run_chart(runs)
    return {name: each.turning() for name, each in found.items()} if rotary else found


def run_chart(runs: Mapping[str, Run]) -> Chart:
    """Following error and force over the same time."""
    errors, forces = list[Curve](), list[Curve]()
    for i, (name, run) in enumerate(runs.items()):
        error = 1e6 * run["following_error"]
        said = f"RMS {np.sqrt(np.mean(error**2)):.4g} µm, peak {np.max(np.abs(error)):.4g} µm"
        errors.append(Curve(run.time, error, name, i, said=said))
        forces.append(Curve(run.time, run["force"], number=i))
    panels = Panel("following error (µm)", tuple(errors), share=2.0), Panel("force (N)", tuple(forces))
    end = max(float(run.time[-1]) for run in runs.values())
    return Chart("time (s)", panels, low=0.0, high=end, height=4.2)
