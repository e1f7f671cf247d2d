"""The frequency view of each contribution: how far the table follows its setpoint as if nothing were between."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from feeddrive.language.table import Table
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import tracking
from feeddrive.loop.simulate import simulate
from feeddrive.papers.claims import Claim
from feeddrive.papers.gordon2013.setting import (
    CASCADE,
    FULL,
    GAINS,
    LONG,
    PLACED,
    RIGID,
    SOFTER,
    Part,
    cascade,
    placed,
    rms,
    with_prefilter,
)
from feeddrive.plot import style
from feeddrive.report.content import Shown
from feeddrive.tuning.trajectory_prefilter import tune_prefilter

LINES = np.geomspace(2.0, 150.0, 1500)
EVEN = ("acceleration", "snap")


def frequency_view() -> Part:
    """Tracking with and without the contributions, and the band in which it is right to a per cent or a degree."""
    parts = {
        "feedback alone": placed(SOFTER, ()),
        "rigid inverse, compatible": placed(SOFTER, (RIGID,)),
        "full inverse, x1r = x2r": placed(replace(SOFTER, commands="rigid"), (FULL,)),
        "full inverse, compatible": placed(SOFTER, (FULL,)),
    }
    contributions = {name: tracking(loop, LINES) for name, loop in parts.items()}
    filtered: dict[str, FRF] = {}
    errors: dict[str, float] = {}
    for law, loop in ((PLACED, placed()), (CASCADE, cascade())):
        filtered[law] = tracking(loop, LINES)
        errors[law] = rms(simulate(loop, LONG, record=("tracking_error",))["tracking_error"])
        for words, regressors in (("a and s only", EVEN), ("v, a, j, s", ("velocity", "acceleration", "jerk", "snap"))):
            fit = tune_prefilter(loop, LONG, runs=1, regressors=regressors)[0]
            name, held = f"{law}, {words}", with_prefilter(loop, fit)
            filtered[name] = tracking(held, LINES)
            errors[name] = rms(simulate(held, LONG, record=("tracking_error",))["tracking_error"])
    bands = {name: band(response) for name, response in {**contributions, **filtered}.items()}
    rule = f"table over setpoint, derivatives exact; prefilter fitted once on the 300 mm move; {GAINS}"
    whole, even = f"{PLACED}, v, a, j, s", f"{CASCADE}, a and s only"
    both = f"{CASCADE}, v, a, j, s"
    claims = [
        Claim("2.c band", "The prefilter widens the band in which tracking is right to 1 %", rule,
              bands[whole][0] / bands[PLACED][0], 1.15, None, "", "widens the tracking transfer function"),
        Claim("2.c phase", "It brings the phase to zero over a wider band", f"within 1°; {rule}",
              bands[whole][1] / bands[PLACED][1], 1.15, None, "", "phase near zero"),
        Claim("2.c band, P-PI", "The same under P-PI", rule, bands[both][0] / bands[CASCADE][0], 1.15, None, "",
              "widens the tracking transfer function"),
        Claim("2.c phase, P-PI", "And its phase", f"within 1°; {rule}", bands[both][1] / bands[CASCADE][1], 1.15,
              None, "", "phase near zero"),
        Claim("2.c a and s", "Acceleration and snap alone leave the phase of P-PI as bad as it was", f"within 1°; "
              f"{rule}", bands[even][1] / bands[CASCADE][1], None, 1.05, "", "even powers of s turn no phase"),
        Claim("2.c a and s, placed", "Under pole placement these two alone do as well: its error is mostly snap",
              f"RMS on the 300 mm move; {rule}", errors[f"{PLACED}, a and s only"] / errors[whole], None, 1.1, "",
              "the correlation with snap is the largest"),
    ]  # fmt: skip
    rows = [
        [name, f"{a:.3g}", f"{b:.3g}", f"{errors[name]:.3g}" if name in errors else "-"]
        for name, (a, b) in bands.items()
    ]
    heads = ["contributions", "|H - 1| < 1 % up to, Hz", "phase within 1° up to, Hz", "RMS on the move, µm"]
    pictures = [
        Shown("contributions", "Frequency view of the contributions", "Table over setpoint with the softer gains. The "
              "full inverse and compatible commands keep it at 1.", "Magnitude and phase of tracking for four "
              "combinations of contributions.", lambda: _drawn(contributions)),
        Shown("prefilter", "Frequency view of the prefilter", "Table over setpoint. Acceleration and "
              "snap alone turn no phase; beyond its band the prefilter makes it worse.",
              "Magnitude and phase of tracking without and with prefilter, both laws.", lambda: _drawn(filtered)),
    ]  # fmt: skip
    return Part(claims, [Table("Tracking over frequency", heads, rows)], pictures)


def band(response: FRF) -> tuple[float, float]:
    """Up to which frequency in Hz |H - 1| stays below 1 %, and the phase within 1°."""
    off = np.abs(response.response - 1.0) > 0.01
    turned = np.abs(response.phase_deg) > 1.0
    return tuple(float(LINES[np.argmax(bad)]) if bad.any() else float(LINES[-1]) for bad in (off, turned))  # type: ignore[return-value]


def _drawn(responses: Mapping[str, FRF]) -> Any:
    figure, axes = style.picture(2, height=4.6)
    for i, (name, response) in enumerate(responses.items()):
        axes[0].plot(LINES, style.decibel(response.magnitude), label=name, **style.curve(i))
        axes[1].plot(LINES, response.phase_deg, **style.curve(i))
    axes[0].set_ylim(-3.0, 3.0)
    axes[1].set_ylim(-15.0, 15.0)
    style.labels(axes[0], None, "position /\nset position (dB)")
    style.labels(axes[1], "frequency (Hz)", "phase (deg)")
    style.frequency_axis(axes[1], float(LINES[0]), float(LINES[-1]))
    style.frequency_grid(axes)
    style.legend(figure, axes[0], 2)
    return figure
