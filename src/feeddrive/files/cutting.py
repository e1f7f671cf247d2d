"""The cutting process of a part program: tools, depths and widths of cut and spindle speed, by [process] of a job.

[process.tool.1]                   # of `T1 M6` in the program; a program without T uses the only one
kind = "mechanistic_cutter"
teeth = 4

Comments in the program set the engagement of the following lines, in mm, until the next such comment:

(finishing: ap=4 ae=0.3 down)      ap along the spindle; ae across the feed with up or down, without ae a slot
(cut off)                          no cut

or the job sets it for a range of lines, overriding any comment:

[[process.section]]
first_line = 12
last_line = 20
axial_depth_mm = 4
radial_depth_mm = 0.3
milling = "down"
spindle_speed = 8000               # in place of S of the program

Traverses (G0) never cut.  Lines are numbered as in the file, also within a subroutine.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.coupling.cut_sections import CutSections
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.cutting.engagement import arc
from feeddrive.blocks.machine_families import Cutter
from feeddrive.files.section import Section, named
from feeddrive.language.block import Number, choice, parameter, part
from feeddrive.language.errors import ParameterError, ProgramError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.path.program.moves import Arc, Move, Spindle, Spline, Straight, ToolChange

_COMMENT = re.compile(r"\(([^()]*)\)|;(.*)")
_WORD = re.compile(r"\b(ap|ae)\s*=\s*(\S*)", re.IGNORECASE)
_NUMBER = re.compile(r"\d*\.?\d+|\d+\.")
_SIDE = re.compile(r"\b(up|down|slot)\b", re.IGNORECASE)
_OFF = re.compile(r"\s*cut\s+off\s*", re.IGNORECASE)
_MM = 1e-3
_SURFACES = 3  # that a tooth may meet


class CutSection(Section, kind="cut_section"):
    """Lines of a part program that cut, and their cutting conditions."""

    first_line: int = choice("first line of the part program", least=1, most=10**9)
    last_line: int = choice("last line of it", least=1, most=10**9)
    axial_depth: Number = parameter("m", "depth of cut along the spindle", above=0)
    radial_depth: Number | None = parameter(
        "m", "width of cut across the feed; absent: a slot, the whole diameter", above=0, default=None
    )
    milling: str = choice("whether the chip starts thin (up) or ends thin (down)", options=("up", "down"), default="up")
    spindle_speed: Number | None = parameter(
        "rpm", "turns of the spindle; absent: S of the program", above=0, default=None
    )

    def check(self) -> None:
        """Raise ParameterError if the last line is before the first."""
        if self.last_line < self.first_line:
            raise self.error(
                f"{self.dotted()}: section.last_line = {self.last_line} must be >= section.first_line = "
                f"{self.first_line}"
            )


class ProcessSection(Section):
    """The cutting process of a part program."""

    tool: Mapping[str, Cutter] = named(
        "tools by their numbers in the program: [process.tool.1]",
        least=1,
        pattern="0*[1-9][0-9]{0,5}",
        example="a tool has a number of the program, as [process.tool.1]",
    )
    section: tuple[CutSection, ...] = part(
        "cutting conditions of lines, in place of those in comments: (ap=4 ae=0.3 down)", default=()
    )

    def check(self) -> None:
        """Raise ParameterError if a line belongs to two sections."""
        ordered = sorted(self.section, key=lambda section: section.first_line)
        for one, other in pairwise(ordered):
            if other.first_line <= one.last_line:
                raise self.error(
                    f"two of [[process.section]] hold line {other.first_line}: lines {one.first_line} to "
                    f"{one.last_line} and {other.first_line} to {other.last_line}",
                    "section",
                )


class Cut(NamedTuple):
    """The cutting conditions from a start time: `tool` number, depths in m (0: no cut), side, spindle speed in rpm."""

    begin: float
    line: int
    tool: int
    axial_depth: float
    radial_depth: float | None
    milling: str
    spindle_speed: float


_AIR = (0.0, None, "up")


@dataclass(frozen=True)
class Process:
    """The cutting process, defined by the section [process] and the comments of the program.

    comments  first line with its depth, width and side, in order
    """

    program: str
    tools: Mapping[int, Cutter]
    sections: tuple[CutSection, ...]
    comments: tuple[tuple[int, tuple[float, float | None, str]], ...]
    spindle: SpindleOfLines

    def cuts(self, times: np.ndarray, line: np.ndarray, traverse: np.ndarray) -> tuple[Cut, ...]:
        """Return the cuts over time, given for each sample its program line and a flag for traverses.

        Raises ProgramError at a line that cuts with a stopped spindle, an unknown tool or an impossible engagement.
        """
        changes = np.flatnonzero((np.diff(line) != 0) | (np.diff(traverse.astype(np.int8)) != 0)) + 1
        cuts: list[Cut] = []
        for first in (0, *changes.tolist()) if len(line) else ():
            cut = self._cut(float(times[first]), int(line[first]), bool(traverse[first]))
            if not cuts or cut[2:] != cuts[-1][2:]:
                cuts.append(cut)
        return tuple(cuts)

    def _cut(self, begin: float, line: int, traverse: bool) -> Cut:
        own = next((section for section in self.sections if section.first_line <= line <= section.last_line), None)
        depth, width, side = self._by_comment(line) if own is None else (own.axial_depth, own.radial_depth, own.milling)
        speed, tool = self.spindle.at(line)
        if own is not None and own.spindle_speed is not None:
            speed = float(own.spindle_speed)
        if traverse or not depth:
            return Cut(begin, line, tool or next(iter(self.tools)), *_AIR, abs(speed or 0.0))
        if speed is None or tool is None:
            raise self._error(
                line,
                "it is run more than once, with different tools or spindle speeds, while it cuts: the line of a "
                "sample does not tell them apart. Write it out, or give the speed in a [[process.section]]",
            )
        if speed == 0.0:
            raise self._error(line, "the tool cuts while the spindle stands: S and M3 come before it")
        if speed < 0.0:
            raise self._error(line, "the tool cuts while the spindle turns counterclockwise (M4): its teeth need M3")
        if tool == 0 and len(self.tools) == 1:
            tool = next(iter(self.tools))
        if tool not in self.tools:
            there = ", ".join(f"[process.tool.{number}]" for number in self.tools)
            raise self._error(line, f"tool {tool} cuts, of which the job says nothing: it has {there}")
        self._fits(line, self.tools[tool], float(depth), None if width is None else float(width))
        return Cut(begin, line, tool, float(depth), None if width is None else float(width), side, speed)

    def _fits(self, line: int, cutter: Cutter, depth: float, width: float | None) -> None:
        """Raise ProgramError for an engagement that is impossible with the tool."""
        edge = cutter.edge()
        flute, diameter = edge.flute_length, float(edge.diameter)
        if flute is not None and depth > flute:
            raise self._error(
                line,
                Text(
                    f"a depth of cut of {Quantity(depth, 'm'):6 mm} is more than the tool's flute_length of "
                    f"{Quantity(flute, 'm'):6 mm}: cut in two passes, or take a longer tool"
                ),
            )
        if width is not None and width > diameter:
            raise self._error(
                line,
                Text(
                    f"a width of cut of {Quantity(width, 'm'):6 mm} is more than the tool's diameter of "
                    f"{Quantity(diameter, 'm'):6 mm}: at most the diameter, or no ae for a slot"
                ),
            )

    def couplings(self, cuts: Sequence[Cut], axes: Sequence[str], substep: float) -> tuple[MillingCut, ...]:
        """Return a milling cut between the axes for each active tool, its conditions as sections over time.

        substep  in s

        Raises ParameterError for a machine without x and y.
        """
        if "x" not in axes or "y" not in axes:
            raise ParameterError(f"a cut needs axes x and y, the program moves {', '.join(axes)}")
        return tuple(
            self._coupling(number, cuts, "z" if "z" in axes else None, substep)
            for number in self.tools
            if any(cut.tool == number and cut.axial_depth > 0.0 for cut in cuts)
        )

    def _coupling(self, number: int, cuts: Sequence[Cut], along_z: str | None, substep: float) -> MillingCut:
        cutter = self.tools[number]
        diameter = float(cutter.edge().diameter)
        rows: list[tuple[float, float, float, float, float]] = []
        speed = next(cut.spindle_speed for cut in cuts if cut.tool == number and cut.axial_depth > 0.0)
        for cut in cuts:
            here = cut.tool == number and cut.axial_depth > 0.0
            speed = cut.spindle_speed if here else speed  # in the air the speed does not matter
            entry, leave = arc(cut.milling, cut.radial_depth if here else None, diameter)
            row = (cut.begin, cut.axial_depth if here else 0.0, float(entry), float(leave), speed)
            if not rows or row[1:] != rows[-1][1:]:
                rows.append(row)
        if len(rows) == 1:
            rows.append((rows[0][0] + 1.0, *rows[0][1:]))
        columns: Any = [np.array(column) for column in zip(*rows, strict=True)]
        start, depth, entries, exits, speeds = columns
        longest = 60.0 / (cutter.teeth * float(np.min(speeds)))
        return MillingCut(
            cutter=cutter,
            spindle_speed=float(speeds[0]),
            along_z=along_z,
            sections=CutSections(start=start, axial_depth=depth, entry=entries, exit=exits, spindle_speed=speeds),
            remembered=int((max(_SURFACES, cutter.teeth) + 1) * longest / substep) + 8,
            surfaces=_SURFACES,
        )

    def _by_comment(self, line: int) -> tuple[float, float | None, str]:
        """Return depth, width and side from the last comment before a line."""
        place = bisect_right(self.comments, line, key=lambda comment: comment[0])
        return self.comments[place - 1][1] if place else _AIR

    def _error(self, line: int, reason: str) -> ProgramError:
        return ProgramError(self.program, line, 0, "", reason)


class SpindleOfLines:
    """The spindle speed (rpm, negative counterclockwise) and tool number of each line of a program that moves."""

    def __init__(self) -> None:
        self._found: dict[int, tuple[float | None, int | None]] = {}
        self._speed, self._tool = 0.0, 0

    def noted(self, moves: Iterable[Move]) -> Iterator[Move]:
        """Yield the moves unchanged, recording spindle speed and tool of their lines."""
        for move in moves:
            if isinstance(move, Spindle):
                self._speed = move.spindle_speed * move.direction
            elif isinstance(move, ToolChange):
                self._tool = move.number
            elif isinstance(move, Straight | Arc | Spline):
                now = self._speed, self._tool
                before = self._found.setdefault(move.source.number, now)
                if before != now:  # the same line again, otherwise
                    self._found[move.source.number] = None, None
            yield move

    def at(self, line: int) -> tuple[float | None, int | None]:
        """Return spindle speed and tool at a line; None for a value that differed between executions of the line."""
        return self._found.get(line, (0.0, 0))


def process_of(section: ProcessSection, program: Path) -> Process:
    """Return the cutting process of a section and its program. Raise ProgramError at a malformed comment."""
    tools = {int(name): cutter for name, cutter in section.tool.items()}
    return Process(program.name, tools, section.section, tuple(_comments(program)), SpindleOfLines())


def _comments(program: Path) -> Iterator[tuple[int, tuple[float, float | None, str]]]:
    with program.open(encoding="latin-1") as file:
        for number, text in enumerate(file, 1):
            if "(" not in text and ";" not in text:
                continue
            for match in _COMMENT.finditer(text):
                comment = match[1] if match[1] is not None else match[2]
                if _OFF.fullmatch(comment):
                    yield number, _AIR
                elif _WORD.search(comment):
                    yield number, _engagement(comment, program.name, number, match.start() + 1)


def _engagement(comment: str, program: str, line: int, column: int) -> tuple[float, float | None, str]:
    """Parse a comment such as `ap=4 ae=0.3 down` into depth and width in m, and the side."""

    def wrong(reason: str) -> ProgramError:
        return ProgramError(program, line, column, f"({comment})", f"{reason}: as in (ap=4 ae=0.3 down), in mm")

    words: dict[str, float] = {}
    for match in _WORD.finditer(comment):
        name, value = match[1].lower(), match[2].rstrip(",")
        if name in words:
            raise wrong(f"{name} is given twice")
        if not _NUMBER.fullmatch(value) or not 0.0 < float(value) < 1e6:
            raise wrong(f"{name}={value} must be a number of mm > 0")
        words[name] = float(value) * _MM
    if "ap" not in words:
        raise wrong("ae has no ap, the depth along the spindle, beside it")
    sides = {side.lower() for side in _SIDE.findall(comment)}
    if "ae" not in words:
        if sides - {"slot"}:
            raise wrong(f"{' and '.join(sorted(sides))} has no ae, the width across the feed, beside it")
        return words["ap"], None, "up"
    if len(sides) != 1 or "slot" in sides:
        raise wrong("with ae it is either up or down milling, one of the words")
    return words["ap"], words["ae"], sides.pop()
