"""Friction over velocity from a recorded motion: the drive force minus mass times acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Result, Table


@dataclass(frozen=True, eq=False, repr=False)
class FrictionMap(Result):
    """Mean force against the motion (N) by velocity (m/s), its standard deviation (N) and how many samples it has.

    All of shape (m,), velocities rising, both directions.
    """

    velocity: np.ndarray
    force: np.ndarray
    deviation: np.ndarray
    count: np.ndarray

    def table(self) -> Table:
        """One row a velocity."""
        columns = zip(self.velocity, self.force, self.deviation, self.count, strict=True)
        rows = [[f"{1e3 * v:.4g}", f"{f:.4g}", f"{d:.3g}", f"{int(n)}"] for v, f, d, n in columns]
        return Table("force against the motion", ["velocity mm/s", "N", "deviation N", "samples"], rows)


def friction_map(
    position: np.ndarray, force: np.ndarray, mass: float, sample_time: float, *, window: float = 0.03, bins: int = 24
) -> FrictionMap:
    """Friction of a rigid axis of `mass` (kg) from its position (m) and drive force (N), both of shape (n,).

        friction = force - mass · x'',   x' and x'' from the parabola that fits a sliding window of the position best

    window  s over which position is smoothed; a longer one blurs reversals, a shorter one lets encoder counts through
    bins    velocities in each direction

    The force is averaged over the same window.  Samples whose window holds a reversal or a change of acceleration are
    left out.  Gravity and every other constant force stay in: they show as a shift of both directions.
    Raises ParameterError if the motion is shorter than three windows.
    """
    half = max(2, round(0.5 * window / sample_time))
    if position.size < 6 * half:
        raise ParameterError(
            f"a friction map needs at least {6 * half} samples for a window of {window:g} s, not {position.size}"
        )
    offsets = np.arange(-half, half + 1) * sample_time
    fit = np.linalg.pinv(np.vander(offsets, 3, increasing=True))
    velocity = np.convolve(position, fit[1][::-1], mode="valid")
    acceleration = 2.0 * np.convolve(position, fit[2][::-1], mode="valid")
    mean_force = np.convolve(force, np.full(offsets.size, 1.0 / offsets.size), mode="valid")
    friction = mean_force - mass * acceleration
    away = np.abs(velocity) > np.abs(acceleration) * half * sample_time
    # where the acceleration changes within the window no parabola fits
    spread = np.full(acceleration.size, np.inf)
    spread[half:-half] = np.abs(acceleration[2 * half :] - acceleration[: -2 * half])
    away &= spread < 0.2 * float(np.max(np.abs(acceleration), initial=0.0))
    top = float(np.max(np.abs(velocity), initial=0.0))
    away &= np.abs(velocity) > 0.02 * top
    edges = np.linspace(-top, top, 2 * bins + 1)
    place = np.clip(np.digitize(velocity, edges) - 1, 0, 2 * bins - 1)
    rows = []
    for i in range(2 * bins):
        inside = away & (place == i)
        if np.count_nonzero(inside) >= 3:
            picked = friction[inside]
            rows.append((np.mean(velocity[inside]), np.mean(picked), np.std(picked), picked.size))
    table = np.array(rows, dtype=float).reshape(-1, 4)
    return FrictionMap(table[:, 0], table[:, 1], table[:, 2], table[:, 3])
