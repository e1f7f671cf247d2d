"""Motions along sections at one feed: schedule, lifting, and corners in time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feeddrive.path.motion import Limits, Part, Section
from feeddrive.path.schedule.crossings import MANY, Crossings, Lines, is_line
from feeddrive.path.schedule.lift import Lifter
from feeddrive.path.schedule.run import Schedule, Start

if TYPE_CHECKING:
    from concurrent.futures import Executor


def at_factor(section: Section, factor: float) -> Section:
    """Return a section whose feed is multiplied by a factor."""
    pieces = section.pieces
    return section if factor == 1.0 else section._replace(pieces=pieces._replace(feed=pieces.feed * factor))


def limits_at(limits: np.ndarray, factor: float) -> np.ndarray:
    """Return the limits, shape (N, 4), at a feed factor.

    On a traverse the velocity limits are the feed: a factor below 1 lowers them, one above 1 must not raise them.
    """
    return np.ascontiguousarray(limits * np.array(Limits(min(factor, 1.0), 1.0, 1.0, 1.0)))


class Scheduled(NamedTuple):
    """A part as scheduled, which is not yet lifted, with the tolerance of the corner at its end, m."""

    part: Part
    tolerance: float


class Planner:
    """The planner of consecutive sections at one feed factor.

    limits   limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    factor   feed factor
    start    where the motion begins, if it is not at rest at the start of a run
    before   motion up to the start, which is lifted together with what follows
    workers  lift what does not depend on each other; None: one after the other
    """

    def __init__(
        self,
        limits: np.ndarray,
        factor: float = 1.0,
        start: Start | None = None,
        before: Part | None = None,
        workers: Executor | None = None,
    ) -> None:
        limits = limits_at(limits, factor)
        self._factor = factor
        self._schedule, self._crossings = Schedule(limits, start=start), Crossings(limits)
        self._lifter = Lifter(limits, workers)
        self._lifter.hand = before

    def along(self, sections: Iterable[Section], ends: bool) -> Iterator[Part]:
        """Yield the parts that are final after these sections of a chain: all of them if it `ends`."""
        for scheduled in self.scheduled(sections):
            yield from self.lifted(scheduled)
        if ends:
            yield from self.end()

    def scheduled(self, sections: Iterable[Section]) -> Iterator[Scheduled | Lines]:
        """Yield the parts that the schedule makes of these sections, and runs along single lines.

        Another thread may `lift` the earlier ones.
        """
        lines = list[Section]()
        for each in sections:
            section = at_factor(each, self._factor)
            if self._schedule.rests and is_line(section):
                lines.append(section)
                if len(lines) < MANY:
                    continue
                yield from self._along_lines(lines)
                lines = []
            else:
                yield from self._along_lines(lines)
                lines = []
                yield from self._along(section)
        yield from self._along_lines(lines)

    def _along(self, section: Section) -> Iterator[Scheduled]:
        for part in self._schedule.add(section):
            yield Scheduled(part, section.tolerance)

    def _along_lines(self, sections: Sequence[Section]) -> Iterator[Scheduled | Lines]:
        while sections:
            lines = self._crossings.lines(sections)
            if lines.sections:
                yield lines
            # a line without a motion in closed form is planned as any other section
            rest = sections[len(lines.sections) :]
            for section in rest[:1]:
                yield from self._along(section)
            sections = rest[1:]

    def lifted(self, scheduled: Scheduled | Lines) -> Iterator[Part]:
        """Yield the parts that are final after the next part or lines of the schedule."""
        if isinstance(scheduled, Scheduled):
            for lifted in self._lifter.add(scheduled.part):
                yield from self._final(self._crossings.add(lifted, scheduled.tolerance))
        else:
            yield from self._final(self._crossings.add_lines(scheduled))

    def end(self) -> Iterator[Part]:
        """Yield the remaining parts, at the end of a chain."""
        yield from self._final(self._crossings.end())

    def _final(self, parts: Iterable[Part]) -> Iterator[Part]:
        for part in parts:
            yield part if part.factor == self._factor else part._replace(factor=self._factor)
