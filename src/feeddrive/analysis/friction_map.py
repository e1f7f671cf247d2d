"""Friction versus velocity from a recorded motion, and the time window around the worst reversal of a run."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.loop.simulate import Run


@dataclass(frozen=True, eq=False, repr=False)
class FrictionMap(Result):
    """The mean friction force (N), its standard deviation (N) and the number of samples at each velocity (m/s).

    All arrays have shape (m,); the velocities of both directions are in ascending order.
    """

    velocity: np.ndarray
    force: np.ndarray
    deviation: np.ndarray
    count: np.ndarray

    def table(self) -> Table:
        """Return a table with one row per velocity."""
        numbers = zip(self.velocity, self.force, self.deviation, self.count, strict=True)
        rows = [[float(v), float(f), float(d), int(n)] for v, f, d, n in numbers]
        columns = [Column("velocity", "m/s"), Column("force", "N"), Column("deviation", "N", "3"), "samples"]
        return Table("force against the motion", columns, rows)


def friction_map(
    position: np.ndarray, force: np.ndarray, mass: float, sample_time: float, *, window: float = 0.03, bins: int = 24
) -> FrictionMap:
    """Compute the friction of a rigid axis of `mass` (kg) from position (m) and drive force (N), both of shape (n,).

        friction = force - mass · x'',   x' and x'' from a least-squares parabola in a sliding window of the position

    window  length of the smoothing window in s; a longer one blurs reversals, a shorter one passes quantization noise
    bins    number of velocities in each direction

    The force is averaged over the same window.  Samples whose window contains a reversal or a change of acceleration
    are left out.  Gravity and other constant forces are not removed: they appear as an offset in both directions.
    Raises ParameterError if the motion is shorter than three windows.
    """
    half = max(2, round(0.5 * window / sample_time))
    if position.size < 6 * half:
        raise ParameterError(
            f"a friction map needs at least {6 * half} samples for a window of {Quantity(window, 's'):6 SI}, not "
            f"{position.size}"
        )
    offsets = np.arange(-half, half + 1) * sample_time
    # one pseudoinverse serves all windows, so that the fit is a convolution
    fit = np.linalg.pinv(np.vander(offsets, 3, increasing=True))
    velocity = np.convolve(position, fit[1][::-1], mode="valid")
    acceleration = 2.0 * np.convolve(position, fit[2][::-1], mode="valid")
    mean_force = np.convolve(force, np.full(offsets.size, 1.0 / offsets.size), mode="valid")
    friction = mean_force - mass * acceleration
    # no reversal within the window
    away = np.abs(velocity) > np.abs(acceleration) * half * sample_time
    # no parabola fits a window in which the acceleration changes
    spread = np.full(acceleration.size, np.inf)
    spread[half:-half] = np.abs(acceleration[2 * half :] - acceleration[: -2 * half])
    away &= spread < 0.2 * float(np.max(np.abs(acceleration), initial=0.0))
    top = float(np.max(np.abs(velocity), initial=0.0))
    # close to standstill friction depends on the past, not on the velocity
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


# rounding of a stored set position differentiates to velocities that are not quite 0
STANDING = 1e-3  # of the largest set velocity: slower than this does not count as motion


class Window(NamedTuple):
    """A time window of a run, in s, to be shown in detail, and the time of the reversal in it, if there is one."""

    begin: float
    end: float
    reversal: float | None


def set_velocity(run: Run) -> np.ndarray:
    """Return the set velocity in m/s; it is the derivative of the set position if a log does not contain it."""
    recorded = run["set_velocity"]
    if np.any(recorded) or run.time.size < 2:
        return recorded
    return np.gradient(run["set_position"], run.sample_time)


def reversals(velocity: np.ndarray) -> np.ndarray:
    """Return the indices of the samples at which a set velocity resumes with the opposite sign."""
    moving = np.flatnonzero(np.abs(velocity) > STANDING * np.max(np.abs(velocity), initial=0.0))
    signs = np.sign(velocity[moving])
    return moving[1:][signs[1:] != signs[:-1]]


def worst_window(runs: Sequence[Run], signal: str = "following_error") -> Window:
    """Return a time window around the reversal with the largest error of all runs, which must share one reference.

    The error of each run is divided by its peak over the whole run, and these relative errors are added.  If there is
    no reversal, the window surrounds the largest error of the last run.
    """
    first = runs[0]
    T, n = first.sample_time, first.time.size
    half = int(np.clip(0.04 * n, 20, max(20, 0.15 / T)))
    errors = [np.abs(run[signal]) for run in runs]
    places = reversals(set_velocity(first))
    if not places.size:
        centre = int(np.argmax(errors[-1]))
        return _window(first, centre, half, half, None)
    # divided by its own peak: otherwise the worst law alone would choose the reversal
    scores = [sum(float(np.max(e[max(k - half, 0) : k + half]) / (np.max(e) or 1.0)) for e in errors) for k in places]
    centre = int(places[int(np.argmax(scores))])
    return _window(first, centre, half, 2 * half, float(first.time[centre]))


def _window(run: Run, centre: int, before: int, after: int, reversal: float | None) -> Window:
    last = run.time.size - 1
    return Window(float(run.time[max(centre - before, 0)]), float(run.time[min(centre + after, last)]), reversal)
