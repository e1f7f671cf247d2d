"""Derivatives of a sampled command by central differences, where they are more than its rounding."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import LogError

LARGEST_ROUNDING = 0.05  # of a derivative's RMS in motion: what its differences may hold of rounding

# weights over samples k-2 .. k+2, and the power of T below them; each is of second order
_WEIGHTS = {
    "velocity": ((0.0, -0.5, 0.0, 0.5, 0.0), 1),
    "acceleration": ((0.0, 1.0, -2.0, 1.0, 0.0), 2),
    "jerk": ((-0.5, 1.0, 0.0, -1.0, 0.5), 3),
    "snap": ((1.0, -4.0, 6.0, -4.0, 1.0), 4),
}


def differenced(name: str, position: np.ndarray, sample_time: float, needed: Sequence[str]) -> Setpoint:
    """The setpoint of sampled positions in m; what is not needed is 0, and so are two samples at each end.

    All are differences about the same sample, so that they belong together, and nothing is filtered.
    Raises LogError for fewer than six rows, and for positions whose rounding would be a large part of a derivative.
    """
    if position.size < 6:
        raise LogError(f"{name}: {position.size} rows are too few for a fourth difference: at least 6 are needed")
    rounding = _rounding(position)
    rests = np.ptp(np.lib.stride_tricks.sliding_window_view(position, 5), axis=1) == 0.0
    found: dict[str, np.ndarray] = {}
    for each, (weights, order) in _WEIGHTS.items():
        values = np.zeros(position.size)
        if each in needed:
            taken = np.convolve(position, weights[::-1], mode="valid") / sample_time**order
            values[2:-2] = np.where(rests, 0.0, taken)
            _check_rounding(name, each, values, rounding, float(np.linalg.norm(weights)) / sample_time**order)
        found[each] = values
    return Setpoint(position, **found)  # type: ignore[arg-type]


def _rounding(position: np.ndarray) -> float:
    """RMS of the rounding of positions, m: what fifth differences show while the axis accelerates.

    Those of a motion in pieces of constant snap are 0 but for a few samples, which the median leaves out; at constant
    velocity rounding repeats itself and does not show.
    """
    second, fifth = np.abs(np.diff(position, 2)), np.abs(np.diff(position, 5))
    accelerates = second[1:-2] > 1e-2 * np.max(second, initial=0.0)
    return float(np.median(fifth[accelerates])) / (0.6745 * np.sqrt(252.0)) if np.any(accelerates) else 0.0


def _check_rounding(name: str, derivative: str, values: np.ndarray, rounding: float, gain: float) -> None:
    moving = values[np.abs(values) > 1e-9 * np.max(np.abs(values), initial=0.0)]
    if not moving.size:
        return
    rms = float(np.sqrt(np.mean(moving**2)))
    share = gain * rounding / rms
    if share > LARGEST_ROUNDING:
        raise LogError(
            f"{name}: its set positions are rounded by about {rounding:.2g} m RMS, which is {100.0 * share:.3g} % of "
            f"their {derivative} by differences; at most {100.0 * LARGEST_ROUNDING:g} % is admitted, "
            f"{rounding * LARGEST_ROUNDING / share:.2g} m: give the job that was run, for exact derivatives, "
            f"or leave out the regressor"
        )
