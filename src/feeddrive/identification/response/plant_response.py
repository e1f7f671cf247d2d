"""Frequency responses of a plant's mechanics and their exact slopes in its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.families import Plant
from feeddrive.language import tree

_STEP = 1e-4  # of a parameter: matrices are polynomials of low degree in it, so that only rounding is left
_ALIASES = 4  # on either side, at most
_ALIAS = 3e-5  # of the response: aliases that are smaller are left out


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


def _aliases(frequency: np.ndarray, T: float) -> int:
    """How many count on either side; of a mass behind a hold they fall as (f/f_alias)³."""
    share = float(np.max(frequency)) * T
    first = range(1, _ALIASES)
    return next((m for m in first if (share / (m + 1.0 - share)) ** 3 < _ALIAS), _ALIASES)


class PlantResponse:
    """x/f = e^(-s·dead_time) / (1 + s/ω) · s^order · Sᵢ (M s² + C s + K)⁻¹ S_driveᵀ with its slopes.

    The parameters are leaves of the plant by name, then "dead_time" (s) and "current_loop" (Hz) of the actuator.  Of a
    sampled response, from a command that is held over each sample, the sum over its aliases is taken:

        (1 - e^(-jωT))/T Σ G(jω + jmω_s)/(jω + jmω_s),   |m| <= 4, or fewer where the lines are low
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
        changes = {column: np.column_stack([each.ravel() for each in slope[:3]]) for column, slope in slopes.items()}
        inverses: dict[tuple[bytes, float | None], tuple[np.ndarray, np.ndarray]] = {}
        found: list[tuple[np.ndarray, np.ndarray]] = []
        for each in self.asked:
            T = None if each.order else each.sample_time
            key = each.frequency.tobytes(), T
            if key not in inverses:  # encoders on the same lines share them
                inverses[key] = self._inverse(each.frequency, T, made)
            found.append(self._one(each, T, *inverses[key], made[3], slopes, changes, late, corner))
        return found

    @staticmethod
    def _inverse(frequency: np.ndarray, T: float | None, made: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
        """s at all lines, for all aliases of them if there are such, and (M s² + C s + K)⁻¹ there."""
        mass, damping, stiffness, _ = made
        aliases = np.zeros(1) if T is None else np.arange(-(most := _aliases(frequency, T)), most + 1) / T
        s = 2j * np.pi * (frequency + aliases[:, None]).ravel()
        line = s[:, None, None]
        return s, np.linalg.inv((line * mass + damping) * line + stiffness)

    def _one(
        self,
        asked: Asked,
        T: float | None,
        s: np.ndarray,
        inverse: np.ndarray,
        rows: np.ndarray,
        slopes: dict[int, tuple[np.ndarray, ...]],
        changes: dict[int, np.ndarray],
        late: float,
        corner: float | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        row = 1 if asked.sensor == "motor" else 2
        right, left = inverse @ rows[0], rows[row] @ inverse
        factor = np.exp(-s * late) * s**asked.order
        if corner is not None:
            factor = factor / (1.0 + s / (2.0 * np.pi * corner))
        if T is not None:
            held = (1.0 - np.exp(-2j * np.pi * asked.frequency * T)) / T
            factor = factor * np.tile(held, s.size // held.size) / s
        response = (right @ rows[row]) * factor
        found = np.zeros((s.size, len(self.names)), complex)
        if slopes:
            both = (left[:, :, None] * right[:, None, :]).reshape(s.size, -1)
            # bilinear in left and right: M, C and K of all parameters in one product
            moved = both @ np.hstack(list(changes.values())).astype(complex)
            moved = moved.reshape(s.size, -1, 3)
            scaled = moved[:, :, 0] * (s * s)[:, None] + moved[:, :, 1] * s[:, None] + moved[:, :, 2]
            for place, (column, (_, _, _, dr)) in enumerate(slopes.items()):
                turned = right @ dr[row] + left @ dr[0] if np.any(dr) else 0.0
                found[:, column] = (turned - scaled[:, place]) * factor
        for column, name in enumerate(self.names):
            if name == "dead_time":
                found[:, column] = -s * response
            elif name == "current_loop" and corner is not None:
                found[:, column] = response * s / (2.0 * np.pi * corner**2) / (1.0 + s / (2.0 * np.pi * corner))
        if T is None:
            return response, found
        shape = (s.size // asked.frequency.size, asked.frequency.size)
        return response.reshape(shape).sum(axis=0), found.reshape((*shape, len(self.names))).sum(axis=0)
