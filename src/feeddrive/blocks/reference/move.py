"""The base class of all moves: rest to rest, one way or there and back, with dwells."""

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.derivatives import Derivatives
from feeddrive.blocks.reference.stretches import Way
from feeddrive.blocks.sampled import check_duration, check_single
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import Number, choice, parameter


class Move(Reference, ABC):
    """A leg over `distance` between two dwells; with `back`, the return leg and a third dwell follow.

        before | there | after                        or
        before | there | between | home | after

    Every leg starts and ends at rest at the exact positions `start` and `start + distance`.
    """

    distance: Number = parameter("m", "signed travel; 0 m is a dwell", least=-1e6, most=1e6)
    start: Number = parameter("m", "position at the start", default=0, least=-1e6, most=1e6)
    back: bool = choice("whether the move returns to its start", options=(False, True), default=False)
    dwell_before: Number = parameter("s", "standstill before the first leg", default=0, least=0)
    dwell_between: Number | None = parameter(
        "s", "standstill before the way back; absent: as long as dwell_after", default=None, least=0
    )
    dwell_after: Number = parameter("s", "standstill at the end", default=0, least=0)

    @property
    @abstractmethod
    def leg_time(self) -> float:
        """The time of one leg in s, checked against its limits."""

    @abstractmethod
    def leg(self, t: np.ndarray) -> Derivatives:
        """Return travel (m, from 0 to |distance|) and its derivatives at times t (s, shape (n,)) in 0 .. leg_time."""

    def check(self) -> None:
        """Raise StructureError unless the leg stays within its limits and ends in a finite time."""
        check_single(self)
        check_duration(self.kind, self.duration)

    @property
    def duration(self) -> float:
        """The total duration of dwells and legs, s."""
        begins = self._home_at() if self.back else self.dwell_before
        return begins + self.leg_time + self.dwell_after

    def at(self, t: np.ndarray) -> Setpoint:
        """Return the setpoints at times t in s."""
        times = np.asarray(t, dtype=np.float64)
        out = [np.full(times.shape, self.start), *(np.zeros(times.shape) for _ in range(4))]
        for way, last in self.ways():
            moving = np.flatnonzero((times >= way.begins) & (times < way.ends()))
            if moving.size:
                # ascending times form one slice, which is faster than an index array
                run = slice(moving[0], moving[-1] + 1)
                chosen = run if run.stop - run.start == moving.size else moving
                travel = self.leg(way.inside(times[chosen]))  # type: ignore[arg-type]
                for row, values in zip(out, way.placed(travel), strict=True):
                    row[chosen] = values
            # the exact end, without the rounding of the leg
            out[0][times >= way.ends()] = last
        return Setpoint(*out)  # type: ignore[arg-type]

    def ways(self) -> Iterator[tuple[Way, float]]:
        """Yield the leg and, with `back`, the return leg, each with its end position (m)."""
        sense, far = float(np.sign(self.distance)), self.start + self.distance
        yield Way(self.dwell_before, self.leg_time, self.start, sense), far
        if self.back:
            yield Way(self._home_at(), self.leg_time, far, -sense), self.start

    def _home_at(self) -> float:
        """Return the start time of the return leg, s."""
        between = self.dwell_after if self.dwell_between is None else self.dwell_between
        return self.dwell_before + self.leg_time + between
