"""Random set motions and readings, to compare a block with an independent evaluation of its paper's equations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint

SAMPLES = 80
RANDOM = f"{SAMPLES} samples of random readings and forces, seed 7, along a set motion of the fourth degree"


class RandomMotion:
    """A set motion x(t), a random polynomial of fourth degree with exact derivatives; x in m, t in s."""

    def __init__(self, seed: int = 7) -> None:
        # each derivative has the size that it has on a machine: m, m/s, m/s², m/s³, m/s⁴
        sizes = np.array([1e-2, 0.1, 1.0, 30.0, 800.0])
        whole = np.poly1d((sizes * np.random.default_rng(seed).normal(size=5))[::-1])
        self.derivatives: list[Callable[[Any], Any]] = [whole.deriv(i) if i else whole for i in range(5)]

    def __call__(self, order: int, t: np.ndarray) -> np.ndarray:
        """Return the derivative of an order at times t."""
        return np.asarray(self.derivatives[order](t), dtype=float)

    def setpoints(self, t: np.ndarray) -> list[Setpoint]:
        """Return the setpoints at times t."""
        return [Setpoint(*row) for row in np.stack([self(i, t) for i in range(5)], axis=1).tolist()]


class RandomReadings:
    """Random readings of two encoders (m), and forces applied and requested (N), each of shape (n,); the forces are
    initially 0.
    """

    def __init__(self, way: RandomMotion, t: np.ndarray, seed: int = 7, size: float = 1e-4) -> None:
        random = np.random.default_rng(seed)
        self.motor, self.load = (way(0, t) + size * random.normal(size=t.size) for _ in range(2))
        self.applied, self.requested = 50.0 * random.normal(size=(2, t.size))
        # a law starts without a force, which the paper's equations take for granted
        self.applied[0] = self.requested[0] = 0.0

    def readings(self) -> list[Reading]:
        """Return the readings as the blocks' input type."""
        rows = np.stack([self.motor, self.load, self.applied, self.requested], axis=1).tolist()
        return [Reading(*row) for row in rows]


def stepped(
    law: Law, T: float, setpoints: Sequence[Setpoint], readings: Sequence[Reading]
) -> tuple[list[Any], np.ndarray]:
    """Return states and forces of a law that starts at the first reading; both from the second sample on."""
    prepared = law.prepare(T)
    state = law.start(prepared, setpoints[0], readings[0])
    states, forces = [], []
    for setpoint, reading in zip(setpoints[1:], readings[1:], strict=True):
        state, force = law.step(prepared, state, setpoint, reading, T)
        states.append(state)
        forces.append(force)
    return states, np.array(forces)


def misfit(actual: Sequence[Any] | np.ndarray, expected: np.ndarray) -> float:
    """Return the largest absolute difference relative to the largest expected value."""
    return float(np.max(np.abs(np.asarray(actual, dtype=float) - expected)) / np.max(np.abs(expected)))
