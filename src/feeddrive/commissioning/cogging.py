"""A force that repeats along the travel, such as the cogging of a motor, from the strokes of a commissioning.

The momentum balance is taken in weak form, over windows with a smooth weight w, so that nothing is differentiated:

    ∫ w F dt = m ∫ w'' x dt - b ∫ w' x dt + c ∫ w sgn v dt + s ∫ w sgn v e^(-|v|/u) dt + F0 ∫ w dt - ∫ w g(x) dt
    g(x) = Σ_n  a_n sin(2π n x/P) + b_n cos(2π n x/P)                     n = 1 ... ORDERS

with the force as it acts, a dead time after it was commanded.  For each period P of a grid it is a linear least-squares
problem; the period that leaves least is taken, if g as it is found in one direction of motion explains the other one,
too: vibrations and friction, which the best of so many periods fits as well, do not repeat with the position.  Nor is a
force taken that the windows average away, whose size would be extrapolated from what they leave of it.  A travel
that is shorter than a period tells the force along it all the same, and not what repeats beyond it.

Source: the weighted integrals, Shinbrot 1957 (modulating functions).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from feeddrive.blocks.force.cogging import Cogging
from feeddrive.blocks.force.harmonic import Harmonic
from feeddrive.files.log import Log
from feeddrive.loop.loop import Loop

ORDERS = 3  # harmonics of a period
KEPT = 0.5  # of the squares of one direction: what a force that was found in the other must leave less of
SHOWN = 0.03  # of the squares of a force: what the windows must show of it, which average fast waves away
_WINDOW, _ROW = 0.06, 2e-3  # s of a window, and of the means that it weighs
_SLOW, _STICKY = 0.02, 0.05  # of the largest set speed: slower rows are left out; over which friction falls
_LONGEST, _SHORTEST, _STEP = 0.5, 100.0, 0.1  # periods in the travel that are tried, and their step
_FINER = 10  # steps between two of the grid


def periodic_force(log: Log, dead_time: float) -> Cogging | None:
    """Return the force that repeats with the reading of a log of strokes; None if there is no clear one.

    log        set_position, reading_load, commanded
    dead_time  s from the command to the force
    """
    balance = _Balance(log, dead_time)
    if balance.fewest < 2 * (balance.others.shape[1] + 2 * ORDERS):
        return None
    grid = np.arange(_LONGEST, _SHORTEST, _STEP)
    rough = grid[int(np.argmin([balance.left(waves) for waves in grid]))]
    fine = rough + _STEP * np.linspace(-1.0, 1.0, 2 * _FINER + 1)
    fine = fine[fine >= _LONGEST]
    best = float(fine[int(np.argmin([balance.left(waves) for waves in fine]))])
    return balance.cogging(best) if balance.kept(best) < KEPT and balance.shown(best) > SHOWN else None


class _Balance:
    """The balance of a log in windows: the forces of all, and columns of what is linear beside a periodic force."""

    def __init__(self, log: Log, dead_time: float) -> None:
        T = log.sample_time
        block = max(1, round(_ROW / T))
        rows = len(log) // block
        step = block * T
        time = np.arange(len(log)) * T
        late = np.interp(time - dead_time, time, log["commanded"])

        def means(values: np.ndarray) -> np.ndarray:
            return values[: rows * block].reshape(rows, block).mean(axis=1)

        force, position = means(late), means(log["reading_load"])
        speed = means(np.gradient(log["set_position"], T))
        length = max(4, round(_WINDOW / step))
        s = np.linspace(-1.0, 1.0, length)
        half = 0.5 * (length - 1) * step
        # (1 - s²)⁴ and its derivatives over time
        weight = (1.0 - s**2) ** 4
        slope = -8.0 * s * (1.0 - s**2) ** 3 / half
        bend = (-8.0 * (1.0 - s**2) ** 3 + 48.0 * s**2 * (1.0 - s**2) ** 2) / half**2
        self._begins = np.arange(0, rows - length + 1, length // 2)
        windows = self._begins[:, None] + np.arange(length)
        fastest = float(np.max(np.abs(speed)))
        moving = np.min(np.abs(speed)[windows], axis=1) > _SLOW * fastest
        self._windows, self._weight = windows[moving], weight
        self._forth = speed[self._begins[moving]] > 0.0
        self._position = position
        # from the middle of each window, as a bend sums to zero only nearly
        near = position[self._windows]
        near = near - near.mean(axis=1, keepdims=True)
        way = np.sign(speed)[self._windows]
        sticky = way * np.exp(-np.abs(speed[self._windows]) / (_STICKY * fastest))
        self.force = force[self._windows] @ weight
        self.others = np.column_stack(
            [near @ bend, -near @ slope, way @ weight, sticky @ weight, np.full(len(near), weight.sum())]
        )
        self.fewest = min(int(np.sum(self._forth)), int(np.sum(~self._forth)))
        self.span = float(np.ptp(position))
        # what the other columns explain is taken out of force and waves alike
        self._base = np.linalg.qr(self.others / np.linalg.norm(self.others, axis=0))[0]

    def _waves(self, waves: float) -> np.ndarray:
        angle = 2.0 * np.pi * waves / self.span * self._position
        columns = []
        for order in range(1, ORDERS + 1):
            columns += [np.sin(order * angle)[self._windows] @ self._weight]
            columns += [np.cos(order * angle)[self._windows] @ self._weight]
        return np.column_stack(columns)

    def _rest(self, columns: np.ndarray) -> np.ndarray:
        return columns - self._base @ (self._base.T @ columns)

    def left(self, waves: float) -> float:
        """Return the sum of the squares of what is left of the forces, with so many periods in the travel."""
        force, columns = self._rest(self.force), self._rest(self._waves(waves))
        force = force - columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
        return float(force @ force)

    def kept(self, waves: float) -> float:
        """Return what a force along the travel, found in one direction, leaves of the other, as a share."""
        columns, without, left = self._waves(waves), 0.0, 0.0
        for known in (self._forth, ~self._forth):
            linear = np.column_stack([self.others, columns])[known]
            found = _solved(linear, self.force[known])[self.others.shape[1] :]
            without += self._left_of(~known, 0.0)
            left += self._left_of(~known, columns[~known] @ found)
        return left / without if without > 0.0 else 1.0

    def shown(self, waves: float) -> float:
        """Return the mean square of a force along the travel in the windows over that of its largest harmonic, A²/2."""
        columns = self._waves(waves)
        found = np.linalg.lstsq(self._rest(columns), self._rest(self.force), rcond=None)[0]
        seen = columns @ found / self._weight.sum()
        largest = float(np.max(np.hypot(found[::2], found[1::2])))
        return float(np.mean(seen**2)) / (0.5 * largest**2) if largest > 0.0 else 0.0

    def _left_of(self, rows: np.ndarray, pull: np.ndarray | float) -> float:
        force, others = self.force[rows] - pull, self.others[rows]
        left = force - others @ _solved(others, force)
        return float(left @ left)

    def cogging(self, waves: float) -> Cogging:
        """Return the force with so many periods in the travel."""
        columns = self._rest(self._waves(waves))
        pairs = -np.linalg.lstsq(columns, self._rest(self.force), rcond=None)[0].reshape(ORDERS, 2)
        sizes = np.hypot(pairs[:, 0], pairs[:, 1])
        largest = float(np.max(sizes))
        harmonics = tuple(
            Harmonic(order=order, share=float(size / largest), phase=float(np.arctan2(cosine, sine)))
            for order, (sine, cosine), size in zip(range(1, ORDERS + 1), pairs, sizes, strict=True)
        )
        return Cogging(force=largest, period=self.span / waves, harmonics=harmonics)


def _solved(columns: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return the least-squares solution for columns of different units."""
    sizes = np.linalg.norm(columns, axis=0)
    sizes[sizes == 0.0] = 1.0
    return np.linalg.lstsq(columns / sizes, force, rcond=None)[0] / sizes


def described(along: Cogging) -> dict[str, float]:
    """Return the numbers of a force along the travel by name, for a record; `stated` makes the force of them."""
    told = {"along_force": float(along.force), "along_period": float(along.period)}
    for each in along.harmonics:
        told |= {f"along_share_{each.order}": float(each.share), f"along_phase_{each.order}": float(each.phase)}
    return told


def stated(facts: Mapping[str, float]) -> Cogging | None:
    """Return the force along the travel of a record; None if there is none."""
    if "along_force" not in facts:
        return None
    harmonics = tuple(
        Harmonic(order=order, share=facts[f"along_share_{order}"], phase=facts[f"along_phase_{order}"])
        for order in range(1, ORDERS + 1)
    )
    return Cogging(force=facts["along_force"], period=facts["along_period"], harmonics=harmonics)


def acting(log: Log, along: Cogging, dead_time: float) -> Log:
    """Return a log with the column `acting`: what is commanded and, a dead time sooner, the force along the travel.

        acting(t) = commanded(t) + g(x(t + dead_time))

    Mass, friction and responses from it are those of the axis without that force, which acts where the motor does.
    """
    time = np.arange(len(log)) * log.sample_time
    position = np.interp(time + dead_time, time, log["reading_load"])
    channels = {**log.channels, "acting": log["commanded"] + along.at(position)}
    return replace(log, channels=channels, units={**log.units, "acting": log.units["commanded"]})


def moved(loop: Loop, position: float) -> Loop:
    """Return a loop that begins at a position (m) of the encoder by which the periodic forces of its axis count."""
    forces = tuple(
        replace(
            force,
            harmonics=tuple(
                replace(each, phase=each.phase + 2.0 * np.pi * each.order * (position / force.period % 1.0))
                for each in force.harmonics
            ),
        )
        if isinstance(force, Cogging)
        else force
        for force in loop.axis.forces
    )
    return replace(loop, axis=replace(loop.axis, forces=forces))
