"""What a controller is tried with: random samples that reach every branch, with live changes of parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.loop.routine import Controller, Routine, Variable

BROKEN = (np.nan, np.inf, -np.inf, 1e300, -1e200, 5e-324, 1e-310)  # what no encoder should say, and what few do


@dataclass(frozen=True, eq=False)
class Trial:
    """Inputs (n, inputs), and other parameters, by sample and dotted name, that hold from that sample on."""

    inputs: np.ndarray
    changes: Mapping[int, Mapping[str, float]]


def trial(routine: Routine, count: int, seed: int = 0, *, change_every: int = 2000, broken: float = 0.002) -> Trial:
    """`count` samples of a wandering axis under a wandering set motion, from a seed.

    The reading follows the set position with errors from a count of an encoder to more than any bound, so that limits,
    trips and a quiet loop all occur; `broken` is the share of readings and setpoints that are no numbers or absurd.
    The enable is taken away now and then, which clears trips.  Every `change_every` samples up to three parameters
    move by up to a quarter, where their bounds and their block allow it.
    """
    random = np.random.default_rng(seed)
    T = routine.sample_time
    speed = np.cumsum(random.normal(0.0, 0.02, count)) * 0.99
    speed = 0.5 * np.sin(speed)
    position = np.cumsum(speed * T)
    acceleration = np.gradient(speed, T) if count > 1 else np.zeros(count)
    scale = 10.0 ** np.repeat(random.uniform(-8.0, -3.0, count // 200 + 1), 200)[:count]
    rows: dict[str, np.ndarray] = {
        "set_position": position,
        "set_velocity": speed,
        "set_acceleration": np.clip(acceleration, -50.0, 50.0),
        "set_jerk": random.normal(0.0, 100.0, count),
        "set_snap": random.normal(0.0, 1e4, count),
        "enable": np.where(np.repeat(random.random(count // 50 + 1) < 0.05, 50)[:count], 0.0, 1.0),
    }
    for name in ("reading", "reading_motor", "reading_load"):
        rows[name] = position + scale * np.cumsum(random.normal(0.0, 0.2, count)) / (1.0 + np.arange(count) % 200)
    inputs = np.column_stack([rows[variable.name] for variable in routine.inputs])
    holes = random.random(inputs.shape) < broken
    inputs[holes] = random.choice(np.array(BROKEN), int(holes.sum()))
    return Trial(inputs, _changes(routine, count, change_every, random))


def _changes(routine: Routine, count: int, every: int, random: np.random.Generator) -> dict[int, dict[str, float]]:
    """Parameters that move by up to a quarter, where the block still holds together."""
    both = Controller(control=routine.origin.control, motor=routine.origin.axis.actuator.motor)
    first = {variable.path: variable for variable in routine.parameters}
    found: dict[int, dict[str, float]] = {}
    for sample in range(every, count, every):
        chosen = random.choice(len(first), size=min(3, len(first)), replace=False)
        moved = {variable.path: _moved(variable, random) for variable in (list(first.values())[i] for i in chosen)}
        try:
            both = tree.vary(both, moved)
            both.control.fits(routine.sample_time)
        except FeeddriveError:
            continue
        found[sample] = moved
    return found


def _moved(variable: Variable, random: np.random.Generator) -> float:
    return float(variable.value * random.uniform(0.8, 1.25))
