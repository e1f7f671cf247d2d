"""Frequency responses of a plant's mechanics and their exact slopes in its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.families import Plant
from feeddrive.language import tree

_STEP = 1e-4  # of a parameter: matrices are polynomials of low degree in it, so that only rounding is left
_ALIASES = 4


@dataclass(frozen=True)
class Asked:
    """One response that is wanted: frequency in Hz, from which body, which derivative of the position, how sampled."""

    frequency: np.ndarray
    sensor: str  # "motor" or "load"
    order: int = 0
    sample_time: float | None = None  # of a response from a held command to samples of the position


def matrices(plant: Plant, values: Sequence[float]) -> tuple[np.ndarray, ...]:
    """M, C, K, and the rows of S for drive, motor and load, of a plant with other leaves, which are not checked."""
    made = tree.rebuild(plant, iter(values)).mechanics()
    shape = np.array(made.shape, float)
    rows = shape[[made.drive, made.motor, made.load]]
    return np.array(made.mass, float), np.array(made.damping, float), np.array(made.stiffness, float), rows


class PlantResponse:
    """x/f = e^(-s·dead_time) / (1 + s/ω) · s^order · Sᵢ (M s² + C s + K)⁻¹ S_driveᵀ with its slopes.

    The parameters are leaves of the plant by name, then "dead_time" (s) and "current_loop" (Hz) of the actuator.  Of a
    sampled response, from a command that is held over each sample, the sum over its aliases is taken:

        (1 - e^(-jωT))/T Σ G(jω + jmω_s)/(jω + jmω_s),   m = -4 ... 4
    """

    def __init__(self, plant: Plant, names: Sequence[str], asked: Sequence[Asked], fixed: dict[str, float]) -> None:
        leaves = list(tree.leaves(plant))
        self.plant, self.names, self.asked, self.fixed = plant, tuple(names), tuple(asked), fixed
        self.leaves = [fixed.get(name, float(value)) for name, value in leaves]
        places = {name: i for i, (name, _) in enumerate(leaves)}
        self.places = [places.get(name) for name in names]

    def values(self, parameters: np.ndarray) -> list[float]:
        """All leaves of the plant."""
        found = list(self.leaves)
        for place, value in zip(self.places, parameters, strict=True):
            if place is not None:
                found[place] = float(value)
        return found

    def __call__(self, parameters: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Response and slopes of each that is asked."""
        leaves = self.values(parameters)
        made = matrices(self.plant, leaves)
        slopes: dict[int, tuple[np.ndarray, ...]] = {}
        for column, place in enumerate(self.places):
            if place is None:
                continue
            # matrices are linear in what may be zero, such as damping
            step = _STEP * abs(leaves[place]) if abs(leaves[place]) > 1e-9 else 1e-3
            up, down = (
                matrices(self.plant, [*leaves[:place], leaves[place] + sign * step, *leaves[place + 1 :]])
                for sign in (1.0, -1.0)
            )
            slopes[column] = tuple((a - b) / (2.0 * step) for a, b in zip(up, down, strict=True))
        given = dict(zip(self.names, parameters, strict=True))
        late = float(given.get("dead_time", self.fixed.get("dead_time", 0.0)))
        corner = given.get("current_loop", self.fixed.get("current_loop"))
        return [self._one(each, made, slopes, late, corner) for each in self.asked]

    def _one(
        self,
        asked: Asked,
        made: tuple[np.ndarray, ...],
        slopes: dict[int, tuple[np.ndarray, ...]],
        late: float,
        corner: float | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        T = asked.sample_time
        if T is None or asked.order:
            return self._continuous(asked, 2j * np.pi * asked.frequency, made, slopes, late, corner)
        held, total = (1.0 - np.exp(-2j * np.pi * asked.frequency * T)) / T, None
        for alias in range(-_ALIASES, _ALIASES + 1):
            s = 2j * np.pi * (asked.frequency + alias / T)
            response, slope = self._continuous(asked, s, made, slopes, late, corner)
            part = response * held / s, slope * (held / s)[:, None]
            total = part if total is None else (total[0] + part[0], total[1] + part[1])
        assert total is not None
        return total

    def _continuous(
        self,
        asked: Asked,
        s: np.ndarray,
        made: tuple[np.ndarray, ...],
        slopes: dict[int, tuple[np.ndarray, ...]],
        late: float,
        corner: float | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        mass, damping, stiffness, rows = made
        row = 1 if asked.sensor == "motor" else 2
        square, line = (s * s)[:, None, None], s[:, None, None]
        inverse = np.linalg.inv(square * mass + line * damping + stiffness)
        right, left = inverse @ rows[0], rows[row] @ inverse
        factor = np.exp(-s * late) * s**asked.order
        if corner is not None:
            factor = factor / (1.0 + s / (2.0 * np.pi * corner))
        response = (right @ rows[row]) * factor
        found = np.zeros((s.size, len(self.names)), complex)
        for column, (dm, dc, dk, dr) in slopes.items():
            change = square * dm + line * dc + dk
            moved = -np.einsum("fi,fij,fj->f", left, change, right) + right @ dr[row] + left @ dr[0]
            found[:, column] = moved * factor
        for column, name in enumerate(self.names):
            if name == "dead_time":
                found[:, column] = -s * response
            elif name == "current_loop" and corner is not None:
                found[:, column] = response * s / (2.0 * np.pi * corner**2) / (1.0 + s / (2.0 * np.pi * corner))
        return response, found
