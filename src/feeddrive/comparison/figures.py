"""The figures of one law of the arena, from its linear model and its three runs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from feeddrive.analysis.effort import effort
from feeddrive.analysis.margins import margins
from feeddrive.analysis.opened import Opened
from feeddrive.analysis.recovery import force_noise, rope_snap
from feeddrive.comparison.work import Work
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run

BANDS = ((1.0, 10.0), (10.0, 100.0), (100.0, 1000.0))  # Hz
_LINES = 60  # of a band


def linear(loop: Loop, both: Opened) -> dict[str, float | None]:
    """Margins, rope-snap error, stiffness by band, noise in the force, effort; of a stable loop."""
    found: dict[str, float | None] = dict(effort_of(loop))
    lines = both.lines(200)
    of = margins(both.loop_gain(lines))
    delay = of.delay_margin_samples
    found |= {
        "sensitivity_peak": of.sensitivity_peak,
        "delay_margin_samples": math.inf if delay is None else delay,
        "phase_margin_deg": of.phase_margin_deg,
        "crossover_Hz": of.crossover,
        "rope_snap_ISE_root_m_per_N": rope_snap(both.closed),
        "force_noise_N": _noise(loop, both),
    }
    nyquist = 0.5 / float(loop.sample_time)
    for low, high in BANDS:
        if high <= nyquist:
            band = np.geomspace(low, high, _LINES)
            size = np.abs(both.closed.response(band, "position_load", "load_force").response)
            found[f"stiffness_{low:g}_{high:g}_Hz_N_per_m"] = float(np.exp(-np.mean(np.log(size))))
    inside = lines[lines >= min(BANDS[0][0], 0.01 * nyquist)]
    whole = np.abs(both.closed.response(inside, "position_load", "load_force").response)
    found["stiffness_least_N_per_m"] = float(1.0 / np.max(whole))
    return found


def effort_of(loop: Loop) -> dict[str, float]:
    """Operations of one sample."""
    return {"operations": float(effort(loop).total)}


def _noise(loop: Loop, both: Opened) -> float | None:
    """RMS of the force by counts and noise of the encoders; None if they have neither."""
    axis = loop.axis
    motor, load = _deviation(axis.encoder_motor), _deviation(axis.encoder_load)
    if motor == 0.0 and load == 0.0:
        return None
    alone = (axis.encoder_motor is None) != (axis.encoder_load is None)
    if alone:
        return force_noise(both.closed, 0.0, motor + load, shared=True)
    return force_noise(both.closed, motor, load)


def _deviation(encoder: Any) -> float:
    """Standard deviation in m of a reading: that of its counts, q/√12, and its noise."""
    resolution = getattr(encoder, "resolution", None) or 0.0
    return math.hypot(resolution / math.sqrt(12.0), getattr(encoder, "noise", None) or 0.0)


def counted(run: Run, work: Work) -> Run:
    """The run without the standstill at its start, in which a hanging axis finds its force."""
    skip = int(np.searchsorted(run.time, work.skip))
    signals = {name: values[skip:] for name, values in run.signals.items()}
    return replace(run, time=run.time[skip:], signals=signals, first=run.first + skip)


def tracked(run: Run) -> dict[str, float | None]:
    """Tracking error and force along the move."""
    error, force = run["tracking_error"], run["force"]
    return {
        "tracking_error_rms_m": float(np.sqrt(np.mean(error**2))),
        "tracking_error_peak_m": float(np.max(np.abs(error))),
        "force_rms_N": float(np.sqrt(np.mean(force**2))),
        "force_peak_N": float(np.max(np.abs(force))),
    }


def recovered(run: Run, work: Work, name: str) -> dict[str, float | None]:
    """Largest error after the force changed, and how long it stays further from 0 than `near`; infinite to the end."""
    begin = int(np.searchsorted(run.time, work.begin - 1e-9))
    error = np.abs(run["tracking_error"][begin:])
    far = np.flatnonzero(error > work.near)
    never = far.size > 0 and far[-1] == error.size - 1
    settled = 0.0 if not far.size else math.inf if never else float((far[-1] + 1) * run.sample_time)
    return {f"{name}_peak_m": float(np.max(error)), f"{name}_settling_s": settled}
