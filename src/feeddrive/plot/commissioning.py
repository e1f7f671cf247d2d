"""Pictures of a commissioning: strokes, responses over the model, and the trial as it was predicted and measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.commissioning.trial import acting_force
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot.chart import DASHED, NEUTRAL, PANELS, PLAIN, WIDE, Chart, Curve, Panel
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.over_frequency import Overlay, overlay_chart
from feeddrive.plot.style import POINTS, envelope

if TYPE_CHECKING:
    from feeddrive.commissioning.evidence import Modelled
    from feeddrive.commissioning.record import Commissioned
    from feeddrive.files.log import Log


def commissioned_chart(commissioned: Commissioned) -> Chart:
    """Plot the last that was measured: the trial, or the responses over the model, or the strokes.

    Raises ParameterError for a commissioning that ended before it had any of them.
    """
    found = commissioned.evidence
    if "alone" in found.runs and "pushed" in found.runs:
        return commissioning_trial_chart(found.runs)
    if found.responses:
        return commissioning_responses_chart(found.responses)
    if found.strokes is not None:
        return strokes_chart(found.strokes)
    raise ParameterError("the commissioning ended before the first strokes: there is nothing to show")


def strokes_chart(log: Log) -> Chart:
    """Plot set position, following error and commanded force of strokes."""
    error = log["set_position"] - log["reading_load"]
    panels = (
        Panel(f"set position\n({unit_name('m', 'mm')})", (_curve(log, 1e3 * log["set_position"], "", 0),)),
        Panel(f"following error\n({unit_name('m')})", (_curve(log, 1e6 * error, "", 0),), caption=_sizes(error)),
        Panel(f"force\n({unit_name('N')})", (_curve(log, _force(log), "", 1),)),
    )
    return Chart("time (s)", panels, height=5.0, legend=PANELS)


strokes = figure_of(strokes_chart)


def commissioning_responses_chart(responses: Mapping[str, Modelled]) -> Chart:
    """Plot the measured responses with the model over them: magnitude, phase, their distance and the coherence."""
    several = len(responses) > 1
    rows = list[Overlay]()
    for name, (measured, model) in responses.items():
        # a distance needs both on the same lines
        same = model is not None and model.frequency.size == measured.frequency.size
        rows.append(Overlay(name.replace("_", " ") if several else "", measured, model if same else None, model))
    return overlay_chart(rows)


commissioning_responses = figure_of(commissioning_responses_chart)


def commissioning_trial_chart(runs: Mapping[str, Log]) -> Chart:
    """Plot following error and force of a trial, and its deflection by a pulse of force: predicted over measured."""
    errors, forces, deflections = list[Curve](), list[Curve](), list[Curve]()
    alone = runs["alone"]
    # the thin line of the prediction lies on the wide one that was measured
    for number, (name, before, look) in enumerate((("measured", "", WIDE), ("predicted", "predicted_", PLAIN))):
        if f"{before}alone" not in runs:
            continue
        log, pushed = runs[f"{before}alone"], runs[f"{before}pushed"]
        errors.append(_curve(log, 1e6 * (log["set_position"] - log["reading_load"]), name, number, look))
        forces.append(_curve(pushed, _force(pushed), "", number, look))
        away = pushed["reading_load"] - log["reading_load"]
        deflections.append(_curve(log, 1e6 * (away - np.mean(away[:10])), "", number, look))
    velocity = 1e3 * np.gradient(alone["set_position"], alone.sample_time)
    panels = (
        Panel(f"following error\n({unit_name('m')})", tuple(errors), share=2.0),
        Panel(f"deflection\n({unit_name('m')})", tuple(deflections), share=2.0),
        Panel(f"force\n({unit_name('N')})", tuple(forces), share=1.5),
        Panel(f"velocity\n({unit_name('m/s')})", (_curve(alone, velocity, "", NEUTRAL, DASHED),)),
    )
    return Chart("time (s)", panels, height=7.0, legend=PANELS)


commissioning_trial = figure_of(commissioning_trial_chart)


def _curve(log: Log, values: np.ndarray, name: str, number: int, look: str = PLAIN) -> Curve:
    size = min(log.time.size, values.size)
    return Curve(*envelope(log.time[:size], values[:size], POINTS), name, number, look)


def _force(log: Log) -> np.ndarray:
    """Return the force, N; see `acting_force`."""
    return acting_force(log)


def _sizes(error: np.ndarray) -> str:
    rms, largest = float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error)))
    return Text(f"measured: RMS {Quantity(rms, 'm'):3}, largest {Quantity(largest, 'm'):3}")
