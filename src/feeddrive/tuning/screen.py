"""A screen of many plants of a box under one control, in array operations: which of them come near a limit.

An examination of one plant on all its lines takes 3 ms, most of it for the calls of many small operations.  A screen
computes Ms, delay margin and force noise of hundreds of plants at once, on fewer lines and without interpolation, to
find those that are then examined one by one.
"""

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from typing import NamedTuple, Self

import numpy as np

from feeddrive.figures.figure import Limit
from feeddrive.figures.of_loops import DELAY_MARGIN, FORCE_NOISE, SENSITIVITY_PEAK
from feeddrive.figures.slopes import lower_between
from feeddrive.loop.box import Corner
from feeddrive.tuning.closed_loop import growing
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Bound, Limits
from feeddrive.tuning.sampled_plants import Held, SampledPlants

SCREENED = (SENSITIVITY_PEAK.key, DELAY_MARGIN.key, FORCE_NOISE.key)
_LOWEST = 1e-4  # of Nyquist: lowest line
_LINES = 320  # lines that all plants share
_BESIDE = np.linspace(-4.0, 4.0, 17)  # half widths of a resonance at which a plant has lines of its own
_LOCAL, WIDE = 65, 0.25  # lines around the frequency at which a limit is used most, and their reach in ln f
_MARGIN = 0.5  # of a bound of Ms: peaks of |S| above it are computed between lines
_AHEAD = 1e-9  # rad: smallest distance to -1 used for a crossover


class Used(NamedTuple):
    """The utilization of each screened limit at many plants, and the frequency in Hz at which it is used most.

    Both by the key of the figure, of shape (plants,).
    """

    used: Mapping[str, np.ndarray]
    where: Mapping[str, np.ndarray]


class Places(NamedTuple):
    """Frequencies in Hz at which plants use a limit: the number of each plant, and the utilization there."""

    plant: np.ndarray
    frequency: np.ndarray
    used: np.ndarray

    def largest(self, count: int) -> np.ndarray:
        """Return the utilization of each of so many plants at its worst frequency; 0 for one without any."""
        used = np.zeros(count)
        np.maximum.at(used, self.plant, self.used)
        return used


def can_screen(control: ControlResponse, limits: Limits) -> bool:
    """Return True if a screen computes all limits of a control."""
    return control.period == 1 and all(limit.figure.key in SCREENED for limit in limits.limits)


class Plants(NamedTuple):
    """Plants with their responses from the command to both readings.

    corners    the plants
    held, late  their sampled models, and the additional samples of dead time of each
    frequency  lines in Hz, rising, shape (plants, lines)
    shared     number of the lines that all plants share; `own` are those of each plant, shape (plants, lines)
    order      the place of each line among the shared and the own ones
    response   shape (plants, 2, lines)
    """

    corners: tuple[Corner, ...]
    held: Held
    late: np.ndarray
    frequency: np.ndarray
    shared: np.ndarray
    own: np.ndarray
    order: np.ndarray
    response: np.ndarray


class Screen:
    """The plants of a box, of which many are judged at once."""

    def __init__(self, sampled: SampledPlants) -> None:
        self.sampled, self.T = sampled, sampled.T
        nyquist = 0.5 / self.T
        self.shared = np.geomspace(_LOWEST * nyquist, nyquist * (1.0 - 1e-6), _LINES)
        self.beside_modes = _BESIDE

    def sparse(self) -> Self:
        """Return the screen with half of the lines, for looks: what they find is searched on all lines of a point."""
        other = copy(self)
        other.shared, other.beside_modes = self.shared[1::2], self.beside_modes[::2]
        return other

    def plants(self, corners: Sequence[Corner]) -> Plants:
        """Return plants on lines that are dense at the resonances of each."""
        sampled = self.sampled.held(np.array([corner.place for corner in corners]).reshape(len(corners), -1))
        late = np.array([corner.late for corner in corners])
        poles = np.log(np.linalg.eigvals(sampled.A) + 0j) / self.T
        # of each pair of poles one; sorted, so that the modes of all plants have their columns
        pairs = poles.shape[1] // 2
        poles = np.take_along_axis(poles, np.argsort(-poles.imag, axis=1)[:, :pairs], axis=1)
        near = np.abs(poles.imag)[..., None] + np.abs(poles.real)[..., None] * self.beside_modes
        own = np.clip(near.reshape(len(corners), -1) / (2.0 * np.pi), self.shared[0], self.shared[-1])
        lines = np.concatenate([np.tile(self.shared, (len(corners), 1)), own], axis=1)
        order = np.argsort(lines, axis=1)
        lines = np.take_along_axis(lines, order, axis=1)
        return Plants(tuple(corners), sampled, late, lines, self.shared, own, order, sampled.at(lines, late))

    def beside(self, corners: Sequence[Corner], middles: np.ndarray) -> Plants:
        """Return plants on lines around a frequency of each in Hz."""
        sampled = self.sampled.held(np.array([corner.place for corner in corners]).reshape(len(corners), -1))
        late = np.array([corner.late for corner in corners])
        lines = middles[:, None] * np.exp(np.linspace(-WIDE, WIDE, _LOCAL))
        lines = np.clip(lines, self.shared[0], self.shared[-1])
        order = np.tile(np.arange(_LOCAL), (len(corners), 1))
        return Plants(tuple(corners), sampled, late, lines, np.zeros(0), lines, order, sampled.at(lines, late))

    def unstable(self, plants: Plants, matrix: np.ndarray) -> np.ndarray:
        """Return for each plant whether its loop with a single-rate control is unstable; `matrix`: [A B; c d] of it."""
        out = np.zeros(len(plants.corners), bool)
        for late in np.unique(plants.late):
            of_late = np.flatnonzero(plants.late == late)
            some = plants.held._replace(
                A=plants.held.A[of_late],
                new=plants.held.new[of_late],
                old=plants.held.old[of_late],
                pushed=plants.held.pushed[of_late],
            )
            A, B, C = some.delayed(int(late))
            out[of_late] = growing(A, B[:, :, 0], C[:2], matrix)
        return out

    def used(self, plants: Plants, control: ControlResponse, matrix: np.ndarray, limits: Limits) -> Used:
        """Return the utilization of each limit by a single-rate control at plants where its loop is stable.

        matrix  [A B; c d] of the control
        """
        found = {limit.figure.key: both for limit, both in self.each_used(plants, control, matrix, limits)}
        return Used({key: used for key, (used, _) in found.items()}, {key: where for key, (_, where) in found.items()})

    def each_used(
        self, plants: Plants, control: ControlResponse, matrix: np.ndarray, limits: Limits
    ) -> Iterator[tuple[Limit, tuple[np.ndarray, np.ndarray]]]:
        """Yield each limit with its utilization at plants where the loop is stable, and the frequency in Hz.

        |S|/Ms,    ω T n/angle that a delay may use up at a crossover,    force noise/its bound
        """
        f, every = plants.frequency, np.arange(len(plants.corners))
        for limit, places in self.each_place(plants, control, matrix, limits):
            used, where = np.zeros(every.size), np.full(every.size, f[0, -1])
            order = np.argsort(places.used)
            # the largest of each plant is written last
            used[places.plant[order]], where[places.plant[order]] = places.used[order], places.frequency[order]
            yield limit, (used, where)

    def each_place(
        self, plants: Plants, control: ControlResponse, matrix: np.ndarray, limits: Limits
    ) -> Iterator[tuple[Limit, Places]]:
        """Yield each limit with the frequencies at which plants use it, where the loop is stable.

        Of Ms each peak of |S| and of a delay margin each crossover is a place of its own: from plant to plant these
        change smoothly, and the largest of them does not.  A force noise has one place.
        """
        count = len(plants.corners)
        lines = np.concatenate([plants.shared, plants.own.ravel()])
        values = control.of_model(matrix, lines).value
        first = plants.shared.size
        both = np.concatenate(
            [np.broadcast_to(values[:, None, :first], (2, count, first)), values[:, first:].reshape(2, count, -1)],
            axis=2,
        )
        C = np.take_along_axis(both, plants.order[None], axis=2)
        f = plants.frequency
        L = -(C[0] * plants.response[:, 0] + C[1] * plants.response[:, 1])
        every = np.arange(count)
        for limit in limits.limits:
            key, bound = limit.figure.key, limit.bound
            if key == SENSITIVITY_PEAK.key:
                row, k, least = _least_between(f, 1.0 + L, 1.0 / (_MARGIN * bound))
                yield limit, Places(row, f[row, k], 1.0 / (bound * least))
            elif key == DELAY_MARGIN.key:
                yield limit, self._delay(f, L, bound)
            elif key == FORCE_NOISE.key:
                motor, load = limits.reading_noise
                if self.sampled.one_encoder:
                    power = max(motor, load) ** 2 * np.abs(C[0] + C[1]) ** 2
                else:
                    power = motor**2 * np.abs(C[0]) ** 2 + load**2 * np.abs(C[1]) ** 2
                power = power / np.abs(1.0 + L) ** 2
                summed = np.sum(0.5 * (power[:, 1:] + power[:, :-1]) * np.diff(f, axis=1), axis=1)
                noise = np.sqrt(2.0 * self.T * (summed + power[:, 0] * f[:, 0]))
                yield limit, Places(every, f[every, np.argmax(power, axis=1)], noise / bound)

    def _delay(self, f: np.ndarray, L: np.ndarray, bound: float) -> Places:
        """Return the utilization of a delay margin in samples at the crossovers."""
        level = np.log(np.maximum(np.abs(L), np.finfo(float).tiny))
        crosses = level[:, :-1] * level[:, 1:] < 0.0
        row, k = np.nonzero(crosses)
        part = level[row, k] / (level[row, k] - level[row, k + 1])
        turn = np.angle(L[row, k + 1] * np.conj(L[row, k]))
        ahead = np.maximum((np.angle(-L[row, k]) + part * turn) % (2.0 * np.pi), _AHEAD)
        there = f[row, k] ** (1.0 - part) * f[row, k + 1] ** part
        return Places(row, there, 2.0 * np.pi * there * self.T * bound / ahead)


def _least_between(f: np.ndarray, w: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the local minima of |w| below `near` and the least of each row: rows, lines, and |w| between the lines.

    As the slacks of a search are: a resonance traces a circle, whose point nearest to 0 may lie between lines.
    """
    size = np.abs(w)
    row, k = np.nonzero((size[:, 1:-1] <= size[:, :-2]) & (size[:, 1:-1] <= size[:, 2:]) & (size[:, 1:-1] < near))
    beside = (k, k + 1, k + 2)
    x, values = (np.array([part[row, i] for i in beside]) for part in (np.log(f), w))
    every, at = np.arange(len(f)), np.argmin(size, axis=1)
    return (
        np.concatenate([every, row]),
        np.concatenate([at, k + 1]),
        np.concatenate([size[every, at], size[row, k + 1] * lower_between(x, values)]),
    )


class ScreenedPlants:
    """Some plants of a box for the looks of a search."""

    def __init__(self, screen: Screen, corners: Sequence[Corner]) -> None:
        self._screen = screen.sparse()
        self._plants = self._screen.plants(corners)

    def bounds(self, control: ControlResponse, matrix: np.ndarray, limits: Limits) -> Iterator[Bound]:
        """Yield for each limit the bound of the plant that uses it most; `matrix`: [A B; c d] of the control."""
        for limit, (used, where) in self._screen.each_used(self._plants, control, matrix, limits):
            worst = int(np.argmax(used))
            slack = -float(np.log(max(used[worst], np.finfo(float).tiny)))
            key = limit.figure.key, 0, worst
            yield Bound(limit.figure, 0, float(where[worst]), slack, np.zeros(0), 0.0, key)

    def unstable(self, matrix: np.ndarray) -> bool:
        """Return True if the loop is unstable at any of the plants."""
        return bool(np.any(self._screen.unstable(self._plants, matrix)))
