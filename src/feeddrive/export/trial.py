"""Test inputs for a controller: random samples that reach every branch, with parameter changes during the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.loop.guard import Guard
from feeddrive.loop.routine import Routine, Variable, on_target

_DRAWS = 5  # attempts until the block accepts a change
BROKEN = (np.nan, np.inf, -np.inf, 1e300, -1e200, 5e-324, 1e-310)  # invalid readings, which some encoders return


@dataclass(frozen=True, eq=False)
class Trial:
    """The inputs, of shape (n, inputs), and the parameter changes by sample and dotted name."""

    inputs: np.ndarray
    changes: Mapping[int, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class Answers:
    """The outputs of an exported program in a trial, shape (n, outputs), and how it was built and run."""

    outputs: np.ndarray
    program: str
    how: str


def trial(routine: Routine, count: int, seed: int = 0, *, changes: int = 50, broken: float = 2e-4) -> Trial:
    """Return `count` random samples of set motion and readings for a seed.

    The reading follows the set position with an error and a jitter whose sizes change every 40 samples, from less than
    one encoder count to more than any limit, so that a quiet loop, limits and trips all occur; `broken` is the
    probability that a reading is NaN or absurdly large for one to four samples.  Every 20 samples, enable may drop for
    two samples, which clears trips.
    At `changes` samples up to three parameters change by up to 25 %, within their bounds and the checks of their block.
    """
    random = np.random.default_rng(seed)
    pairs = zip(routine.origin.ports(), routine.origin.loops().values(), strict=True)
    rows: dict[str, np.ndarray] = {}
    for port, loop in pairs:
        wandering = _wandering(loop.control.guard or Guard(), routine.sample_time, count, random)
        rows |= {f"{port}{name}": row for name, row in wandering.items()}
    inputs = np.column_stack([rows[variable.path] for variable in routine.inputs])
    for column in range(inputs.shape[1]):
        for place in np.flatnonzero(random.random(count) < broken):
            inputs[place : place + random.integers(1, 5), column] = random.choice(np.array(BROKEN))
    places = sorted({int(k) for k in np.linspace(0, count, changes + 2)[1:-1]} - {0})
    return Trial(inputs, _changes(routine, places, random))


def _wandering(guard: Guard, T: float, count: int, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the inputs of one axis by name."""
    far = 1e-3 if guard.following_error_limit is None else float(guard.following_error_limit)
    fast = 1.0 if guard.velocity_limit is None else float(guard.velocity_limit)

    def held(values: np.ndarray, samples: int) -> np.ndarray:
        return np.repeat(values, samples)[:count]

    blocks = count // 40 + 1
    least, most = (0.5 * sign if end is None else float(end) for sign, end in _ends(guard))
    middle, half = 0.5 * (least + most), 0.502 * (most - least)  # slightly beyond the travel
    turning = 0.4 * fast / half * np.sin(0.002 * np.cumsum(random.normal(0.0, 1.0, count)))
    angle = T * np.cumsum(turning)
    position, speed = middle + half * np.sin(angle), half * turning * np.cos(angle)
    error = held(far * 10.0 ** random.uniform(-6.0, 0.05, blocks), 40) * np.sin(0.03 * np.arange(count))
    jitter = held(fast * T * 10.0 ** random.uniform(-6.0, -0.4, blocks), 40)
    rows: dict[str, np.ndarray] = {
        "set_position": position,
        "set_velocity": speed,
        "set_acceleration": random.normal(0.0, 5.0, count),
        "set_jerk": random.normal(0.0, 100.0, count),
        "set_snap": random.normal(0.0, 1e4, count),
        "enable": np.where(held(random.random(count // 20 + 1) < 0.4, 20) & (np.arange(count) % 20 < 2), 0.0, 1.0),
    }
    for name in ("reading", "reading_motor", "reading_load"):
        rows[name] = position + error + jitter * random.normal(0.0, 1.0, count)
    return rows


def _ends(guard: Guard) -> tuple[tuple[float, Any], tuple[float, Any]]:
    return (-1.0, guard.travel_least), (1.0, guard.travel_most)


def _changes(routine: Routine, places: list[int], random: np.random.Generator) -> dict[int, dict[str, float]]:
    """Return random parameter changes of up to 25 % that pass the checks of their blocks."""
    both = on_target(routine.origin)
    first = {variable.path: variable for variable in routine.parameters}
    changes: dict[int, dict[str, float]] = {}
    for sample in places:
        for _ in range(_DRAWS):
            chosen = random.choice(len(first), size=min(3, len(first)), replace=False)
            moved = {variable.path: _moved(variable, random) for variable in (list(first.values())[i] for i in chosen)}
            try:
                after = tree.vary(both, moved)
                tree.check_sampled(after, routine.sample_time)
            except FeeddriveError:
                continue
            both, changes[sample] = after, moved
            break
    return changes


def _moved(variable: Variable, random: np.random.Generator) -> float:
    return float(variable.value * random.uniform(0.8, 1.25))
