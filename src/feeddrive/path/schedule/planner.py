"""Motions along sections at one feed: schedule, lifting, and corners in time."""

from collections.abc import Iterable, Iterator

import numpy as np

from feeddrive.path.motion import Limits, Part, Section
from feeddrive.path.schedule.corner import Crossings
from feeddrive.path.schedule.lift import Lifter
from feeddrive.path.schedule.run import Schedule, Start


def at_factor(section: Section, factor: float) -> Section:
    """Return a section whose feed is multiplied by a factor."""
    pieces = section.pieces
    return section if factor == 1.0 else section._replace(pieces=pieces._replace(feed=pieces.feed * factor))


def limits_at(limits: np.ndarray, factor: float) -> np.ndarray:
    """Return the limits, shape (N, 4), at a feed factor.

    On a traverse the velocity limits are the feed: a factor below 1 lowers them, one above 1 must not raise them.
    """
    return np.ascontiguousarray(limits * np.array(Limits(min(factor, 1.0), 1.0, 1.0, 1.0)))


class Planner:
    """The planner of consecutive sections at one feed factor.

    limits  limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    factor  feed factor
    start   where the motion begins, if it is not at rest at the start of a run
    before  motion up to the start, which is lifted together with what follows
    """

    def __init__(
        self, limits: np.ndarray, factor: float = 1.0, start: Start | None = None, before: Part | None = None
    ) -> None:
        limits = limits_at(limits, factor)
        self._factor = factor
        self._schedule, self._lifter, self._crossings = Schedule(limits, start=start), Lifter(limits), Crossings(limits)
        self._lifter.hand = before

    def along(self, sections: Iterable[Section], ends: bool) -> Iterator[Part]:
        """Yield the parts that are final after these sections of a chain: all of them if it `ends`."""
        for part in self._along(sections, ends):
            yield part._replace(factor=self._factor)

    def _along(self, sections: Iterable[Section], ends: bool) -> Iterator[Part]:
        for each in sections:
            section = at_factor(each, self._factor)
            line = self._crossings.add_line(section) if self._schedule.rests else None
            if line is not None:
                yield from line
                continue
            for part in self._schedule.add(section):
                for lifted in self._lifter.add(part):
                    yield from self._crossings.add(lifted, section.tolerance)
        if ends:
            yield from self._crossings.end()
