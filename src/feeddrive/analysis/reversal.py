"""Reversals of a motion, and the reversal with the largest error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from feeddrive.loop.simulate import Run

STANDING = 1e-3  # of the largest set velocity: slower than this does not count as motion


class Window(NamedTuple):
    """A stretch of a run to be shown in detail, in s, and the reversal in it (None if the motion has none)."""

    begin: float
    end: float
    reversal: float | None


def set_velocity(run: Run) -> np.ndarray:
    """The set velocity in m/s; differenced from the set position where the reference (a log) states none."""
    given = run["set_velocity"]
    if np.any(given) or run.time.size < 2:
        return given
    return np.gradient(run["set_position"], run.sample_time)


def reversals(velocity: np.ndarray) -> np.ndarray:
    """Samples at which a set velocity starts off in the other direction than it last had."""
    moving = np.flatnonzero(np.abs(velocity) > STANDING * np.max(np.abs(velocity), initial=0.0))
    signs = np.sign(velocity[moving])
    return moving[1:][signs[1:] != signs[:-1]]


def worst_window(runs: Sequence[Run], signal: str = "following_error") -> Window:
    """A stretch around the reversal with the largest error, each run counted in shares of its own peak.

    Without a reversal it lies around the largest error of the last run.  All runs have the same reference.
    """
    first = runs[0]
    T, n = first.sample_time, first.time.size
    half = int(np.clip(0.04 * n, 20, max(20, 0.15 / T)))
    errors = [np.abs(run[signal]) for run in runs]
    places = reversals(set_velocity(first))
    if not places.size:
        centre = int(np.argmax(errors[-1]))
        return _window(first, centre, half, half, None)
    scores = [sum(float(np.max(e[max(k - half, 0) : k + half]) / (np.max(e) or 1.0)) for e in errors) for k in places]
    centre = int(places[int(np.argmax(scores))])
    return _window(first, centre, half, 2 * half, float(first.time[centre]))


def _window(run: Run, centre: int, before: int, after: int, reversal: float | None) -> Window:
    last = run.time.size - 1
    return Window(float(run.time[max(centre - before, 0)]), float(run.time[min(centre + after, last)]), reversal)
