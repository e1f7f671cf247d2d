"""The lines of the part program along the parts of a plan."""

from __future__ import annotations

from collections import deque

import numpy as np

from feeddrive.path.motion import Changes, Part, Section


class _Run:
    """Where the line changes along a run, whose parts are yielded one after the other."""

    def __init__(self) -> None:
        self.length = 0.0  # m, known so far
        self.changes: list[Changes] = []
        self.passed = 0.0  # m, up to the first piece of the next part
        self.known = Changes(np.zeros(0), np.zeros(0, np.int64))

    def add(self, section: Section) -> None:
        """Add the next section of the run."""
        if section.lines is not None:
            at, line = section.lines
            self.changes.append(Changes(at + self.length, line) if self.length else section.lines)
        self.length += _whole(section.pieces.length)

    def within(self, length: float) -> Changes:
        """Return the changes from `passed` on over a length, m."""
        if self.changes:
            known = [self.known, *self.changes] if len(self.known.at) else self.changes
            columns = zip(*known, strict=True)
            self.known = known[0] if len(known) == 1 else Changes._make(map(np.concatenate, columns))
            self.changes = []
        at, line = self.known
        if not self.passed and len(at) == 1:
            return self.known
        first = max(int(at.searchsorted(self.passed, side="right")) - 1, 0)
        # what has been passed is dropped, since a run may go on for as long as the program does
        self.known = Changes(at[first:], line[first:])
        last = int(at.searchsorted(self.passed + length, side="right"))
        return Changes(at[first:last] - self.passed, line[first:last])


class LinesAlong:
    """The lines along the runs whose sections are joined and whose parts are not yet yielded."""

    def __init__(self) -> None:
        self._runs: deque[_Run] = deque()
        self._open = False

    def add(self, section: Section) -> None:
        """Add the next section."""
        if not self._open:
            self._runs.append(_Run())
        self._runs[-1].add(section)
        self._open = not section.ends

    def told(self, part: Part) -> Part:
        """Return the next part with the lines along its pieces."""
        run, length = self._runs[0], part.pieces.length
        changes = run.within(_whole(length))
        # the next part begins on the piece on which this one ends
        run.passed += _whole(length[:-1])
        if part.ends:
            self._runs.popleft()
        entering = part.entering
        if entering is not None:
            entering = entering._replace(lines=self._runs[0].within(_whole(entering.pieces.length)))
        return part._replace(lines=changes, entering=entering)


def _whole(length: np.ndarray) -> float:
    """Return the length of a path from those of its pieces, m."""
    # thousands of runs have one piece each, and numpy's sum is slow for one number
    return float(length[0]) if len(length) == 1 else float(length.sum())
