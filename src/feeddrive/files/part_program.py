"""Part programs of a job: the section [program], and the cutting process in [process].

The section [program] of a job.  The planned part program is the reference of all axes that it moves:

[program]
file = "part.ngc"                  # beside the job, or a bundled one: circle_diamond_square.ngc
tools = "tool.tbl"                 # optional; also offsets, dialect, tolerance, orientation ... as `feeddrive plan`
limits = "limits.toml"             # in place of [axis.x.limits] of the machine file

or the recorded setpoints of another planner, smoothed (`path/smoothing.py`):

[program]
recorded = "log.csv.gz"
columns = { x = "x_mm", y = "y_mm" }
sample_time_ms = 1                 # sample time of a log without a time column
average_ms = 4                     # length of each of four moving averages

The cutting process: tools, depths and widths of cut and spindle speed.

[process.tool.1]                   # tool of `T1 M6` in the program; a program without T uses the only tool
kind = "mechanistic_cutter"
teeth = 4

A comment in the program sets the engagement, in mm, of the lines from there to the next such comment:

(finishing: ap=4 ae=0.3 down)      ap along the spindle; ae across the feed, with up or down; no ae for a slot
(cut off)                          no cut

or the job sets it for a range of lines, where it overrides any comment:

[[process.section]]
first_line = 12
last_line = 20
axial_depth_mm = 4
radial_depth_mm = 0.3
milling = "down"
spindle_speed = 8000               # replaces S of the program

Traverses (G0) never cut.  Lines are numbered as in the file, also within a subroutine.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feeddrive.blocks.coupling.cut_sections import CutSections
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.cutting.engagement import arc
from feeddrive.blocks.families import Coupling, Cutter
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.files.columns import Column
from feeddrive.files.machine import BUNDLED, MachineFile, planned_kinematics, planned_limits
from feeddrive.files.section import Section, file_name, named, text
from feeddrive.files.toml_file import TomlTable
from feeddrive.language.block import Number, choice, declarations, parameter, part
from feeddrive.language.errors import FeeddriveError, NotPlannedError, ParameterError, ProgramError, nearest
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.simulate import samples
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.plan_options import NAMED, named_values, read_start, turning_of, turning_within
from feeddrive.path.program.blocks import BlockError, located
from feeddrive.path.program.dialects import DIALECTS, FRONT_ENDS
from feeddrive.path.program.moves import ORIENTATIONS, Arc, Move, Spindle, Spline, Straight, ToolChange, ToolPoint
from feeddrive.path.purpose import PURPOSES, read_dynamics, settings, with_tolerance

if TYPE_CHECKING:
    from feeddrive.path.planned import Planned
    from feeddrive.path.setpoints import Samples, Standstill

_COMMENT = re.compile(r"\(([^()]*)\)|;(.*)")
_WORD = re.compile(r"\b(ap|ae)\s*=\s*(\S*)", re.IGNORECASE)
_NUMBER = re.compile(r"\d*\.?\d+|\d+\.")
_SIDE = re.compile(r"\b(up|down|slot)\b", re.IGNORECASE)
_OFF = re.compile(r"\s*cut\s+off\s*", re.IGNORECASE)
_MM = 1e-3
_SURFACES = 3  # that a tooth may meet


class CutSection(Section, kind="cut_section"):
    """A range of cutting lines of a part program, and their cutting conditions."""

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
    """The cutting conditions from a start time onward: tool number, depths in m (0: no cut), side, speed in rpm."""

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

    comments  for each engagement set by a comment, in order: line of the comment, and depth, width and side of the cut
    """

    program: str
    tools: Mapping[int, Cutter]
    sections: tuple[CutSection, ...]
    comments: tuple[tuple[int, tuple[float, float | None, str]], ...]
    spindle: SpindleOfLines

    def cuts(self, times: np.ndarray, line: np.ndarray, traverse: np.ndarray) -> tuple[Cut, ...]:
        """Return the cuts in time order, from the program line of each sample and a flag that is True in traverses.

        Raises ProgramError at a line that cuts with a stopped or counterclockwise spindle, an unknown tool or an
        impossible engagement.
        """
        changes = np.flatnonzero((np.diff(line) != 0) | (np.diff(traverse.astype(np.int8)) != 0)) + 1
        cuts: list[Cut] = []
        for first in (0, *changes.tolist()) if len(line) else ():
            cut = self._cut(float(times[first]), int(line[first]), bool(traverse[first]))
            # Compared without begin and line: equal conditions on consecutive lines are one cut.
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
        """Return a milling cut that acts on the axes for each tool that cuts, with its cutting conditions over time.

        substep  substep of the machine, s

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
            # In the air the speed does not matter: keeping the last one avoids a change of the sections.
            speed = cut.spindle_speed if here else speed
            entry, leave = arc(cut.milling, cut.radial_depth if here else None, diameter)
            row = (cut.begin, cut.axial_depth if here else 0.0, float(entry), float(leave), speed)
            if not rows or row[1:] != rows[-1][1:]:
                rows.append(row)
        if len(rows) == 1:
            # CutSections needs two rows: repeating the only one changes nothing.
            rows.append((rows[0][0] + 1.0, *rows[0][1:]))
        columns: Any = [np.array(column) for column in zip(*rows, strict=True)]
        start, depth, entries, exits, speeds = columns
        longest = 60.0 / (cutter.teeth * float(np.min(speeds)))
        return MillingCut(
            cutter=cutter,
            spindle_speed=float(speeds[0]),
            along_z=along_z,
            sections=CutSections(start=start, axial_depth=depth, entry=entries, exit=exits, spindle_speed=speeds),
            # At the lowest speed a tooth period is longest; the surfaces that a tooth may meet must still be in the
            # history.
            remembered=int((max(_SURFACES, cutter.teeth) + 1) * longest / substep) + 8,
            surfaces=_SURFACES,
        )

    def _by_comment(self, line: int) -> tuple[float, float | None, str]:
        """Return the depth, width and side set by the last comment before a line."""
        place = bisect_right(self.comments, line, key=lambda comment: comment[0])
        return self.comments[place - 1][1] if place else _AIR

    def _error(self, line: int, reason: str) -> ProgramError:
        return ProgramError(self.program, line, 0, "", reason)


class SpindleOfLines:
    """The spindle speed (rpm, negative if counterclockwise) and tool number of each line that contains a motion."""

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
                # A line of a loop or subroutine may run more than once, with other conditions.
                if before != now:
                    self._found[move.source.number] = None, None
            yield move

    def at(self, line: int) -> tuple[float | None, int | None]:
        """Return the spindle speed and tool at a line; None for a value that differs between executions of the line."""
        return self._found.get(line, (0.0, 0))


def process_of(section: ProcessSection, program: Path) -> Process:
    """Build the cutting process from its section and the program. Raise ProgramError at a malformed comment."""
    tools = {int(name): cutter for name, cutter in section.tool.items()}
    return Process(program.name, tools, section.section, tuple(_comments(program)), SpindleOfLines())


def _comments(program: Path) -> Iterator[tuple[int, tuple[float, float | None, str]]]:
    # Every byte is a character in Latin-1, so that umlauts in comments of any encoding cannot fail.
    with program.open(encoding="latin-1") as file:
        for number, text in enumerate(file, 1):
            # Most lines have no comment; this test is much faster than a regular expression.
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
        # `float` alone would also accept nan, inf and 1_000.
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


MOST = 4_000_000
"""The largest number of samples of a program in a job, all of which are held in memory with every signal."""


class ProgramSection(Section):
    """The reference of several axes of a job: a planned part program, or recorded setpoints."""

    @classmethod
    def choose(cls, table: TomlTable) -> type[Section]:
        """Return the section class for a table: recorded setpoints if it has the key `recorded`, otherwise a part
        program.
        """
        return RecordedSection if "recorded" in table.values else PartProgramSection


class PartProgramSection(ProgramSection):
    """A part program that is planned and moves all axes that it names."""

    file: str = file_name("the part program, beside the job or a bundled one", example='"part.ngc"')
    tools: str | None = file_name("table of tools", default=None)
    offsets: str | None = file_name("table of offsets", default=None)
    limits: str | None = file_name("limits of the axes in place of those of the machine file", default=None)
    tables_inch: bool = choice("tools and offsets are in inches", default=False)
    skip_deleted: bool = choice("leave out lines that begin with /", default=False)
    dialect: str = choice("language of the program", options=tuple(DIALECTS), default="linuxcnc")
    front_end: str = choice("reader of the program", options=FRONT_ENDS, default="auto")
    parameters: str | None = text(
        "values of named parameters that the program does not set", default=None, example=f'"{NAMED}"', shortest=1
    )
    purpose: str | None = choice(
        "what is machined: sets tolerance and dynamics, as `feeddrive plan --for`",
        options=tuple(PURPOSES),
        default=None,
    )
    tolerance: Number | None = parameter(
        "m", "tolerance of corners where the program states none", above=0, default=None
    )
    angle_tolerance: Number | None = parameter(
        "rad", "tolerance of all rotary axes, in place of those among the limits of the axes", above=0, default=None
    )
    dynamics: str | None = text(
        "shares of the limits of acceleration, jerk and snap in %", default=None, example='"100,50,50"', shortest=1
    )
    orientation: str = choice(
        "how the tool turns in a block while its tip is moved and the program does not say",
        options=ORIENTATIONS,
        default="axes",
    )
    override: str | None = text(
        "steps of the feed in % from these times on, in s", default=None, example='"1:50, 2:0, 3.5:120"', shortest=1
    )
    from_line: int | None = choice("line at which the program is resumed", least=1, default=None)
    start: str | None = text(
        "where the machine stands, in its coordinates, mm and degrees; at 0 if left out, or where from_line begins",
        default=None,
        example='"X=10, Y=-5, C=90"',
        shortest=1,
    )


SAME_OPTIONS = (
    "dialect",
    "front_end",
    "parameters",
    "purpose",
    "tolerance",
    "angle_tolerance",
    "dynamics",
    "orientation",
    "override",
    "from_line",
    "start",
)
"""The keys of [program] that are options of `feeddrive plan`, with the same values in SI."""


class RecordedSection(ProgramSection):
    """Setpoints of another planner, smoothed by four moving averages."""

    recorded: str = file_name("log of the setpoints, beside the job or a bundled one")
    columns: Mapping[str, str] = named("names of the columns by axis", least=1)
    sample_time: Number | None = parameter(
        "s", "sample time of a log without a column of time", above=0, below=1e9, default=None
    )
    average: Number = parameter("s", "length of one of the four averages", above=0, below=1e9, default=4e-3)


FILES = tuple(
    name
    for section in (PartProgramSection, RecordedSection)
    for name, declared in declarations(section).items()
    if declared.role == "file"
)
"""The keys of [program] that name a file."""


@dataclass(frozen=True, eq=False)
class PlannedProgram:
    """A part program as the references of its axes, by their names in the machine file.

    description  text for reports
    file         file of the program; this field and those below are not set for recorded setpoints
    planned      the result of the planner
    line         line of the program by sample, shape (samples,)
    counted      mask of the samples in cut or, without a [process], at feed rate, shape (samples,)
    cuts         cutting conditions over time, from the section [process]
    process      the cutting process of the section [process]
    kinematics   of a five-axis machine with the tool whose tip is judged: that of G43.4 or G43.5, otherwise that of the
                 machine file
    """

    references: Mapping[str, Recorded]
    description: str
    file: Path | None = None
    planned: Planned | None = None
    line: np.ndarray | None = None
    counted: np.ndarray | None = None
    cuts: tuple[Cut, ...] = ()
    process: Process | None = None
    kinematics: Kinematics | None = None

    @property
    def moves_tip(self) -> bool:
        """True if the program moves the tip of the tool (G43.4, G43.5)."""
        return self.planned is not None and self.planned.tip is not None

    def couplings(self, substep: float) -> tuple[Coupling, ...]:
        """Return the cuts as couplings of a machine with this substep (s). Raise ParameterError if the machine lacks x
        or y.
        """
        return () if self.process is None else self.process.couplings(self.cuts, tuple(self.references), substep)


def planned_program(
    section: ProgramSection,
    place: Path,
    machine: MachineFile,
    process: ProcessSection | None = None,
    reserve: Sequence[float] = (),
) -> PlannedProgram:
    """Plan the program of a section within the limits of the machine, prove it, and return it with its cuts.

    reserve  shares of the limits of velocity, acceleration, jerk and snap that are kept back; default: none

    Raises ParameterError or FileError for an invalid section or file, ProgramError at a line of the program,
    NotPlannedError if the program is too long or the proof of the plan fails.
    """
    if isinstance(section, RecordedSection):
        if reserve:
            raise section.error(
                "recorded setpoints were planned elsewhere, and keep no reserve of the limits back for a change of the "
                "path: add a force (--method force), or give the part program with file = ..."
            )
        if process is not None:
            raise process.error("[process] goes with a part program, whose lines it speaks of, not with recorded = ...")
        return _recorded(section, place, machine)
    assert isinstance(section, PartProgramSection)
    # imported late: most jobs have no part program
    from feeddrive.path.planned import planned_of
    from feeddrive.path.program.reading import read_program
    from feeddrive.path.schedule.override import read_steps
    from feeddrive.path.setpoints import Setpoints

    program = _path(section, place, "file")
    tools, offsets, own_limits = (
        None if getattr(section, name) is None else _path(section, place, name)
        for name in ("tools", "offsets", "limits")
    )
    try:
        limits = planned_limits(machine, own_limits)
    except FeeddriveError as error:
        raise section.error(f"{error}", kind=type(error)) from None
    with _at(section, "dynamics"):
        dynamics = None if section.dynamics is None else read_dynamics(section.dynamics, section.dotted("dynamics"))
    used = settings(section.purpose, section.tolerance, dynamics)
    limits = used.dynamics.of(limits.less(reserve) if reserve else limits)
    unfit = "" if used.tolerance is None else limits.unfit(used.tolerance)
    if unfit:
        key = "purpose" if section.tolerance is None else "tolerance"
        raise section.error(f"{section.dotted(key)}: {unfit}", key)
    if section.angle_tolerance is not None:
        with _at(section, "angle_tolerance"):
            limits = turning_within(limits, section.angle_tolerance, section.dotted("angle_tolerance"))
    with _at(section, "override"):
        override = None if section.override is None else read_steps(section.override, section.dotted("override"))
    with _at(section, "parameters"):
        parameters = (
            None if section.parameters is None else named_values(section.dotted("parameters"), section.parameters)
        )
    with _at(section, "start"):
        start = None if section.start is None else read_start(section.dotted("start"), section.start, limits.letters)
    T = float(next(iter(machine.loops.values())).sample_time)
    kept: list[np.ndarray] = []
    lines: list[np.ndarray] = []
    kinematics = planned_kinematics(machine, limits)
    moves = read_program(
        program,
        axes=limits.travel,
        tools=tools,
        offsets=offsets,
        tables_inch=section.tables_inch,
        skip_deleted=section.skip_deleted,
        front_end=section.front_end,  # type: ignore[arg-type]
        parameters=parameters,
        dialect=section.dialect,  # type: ignore[arg-type]
        kinematics=kinematics,
        start=start,
        from_line=section.from_line or 0,
        turning=turning_of(section.orientation, limits, used.tolerance),
    )
    # Closing ends the generator that reads the program, also after an error of the planner.
    with closing(moves):
        cut_process = None if process is None else process_of(process, program)
        of_one_tool = _of_one_tool(moves)
        stated = of_one_tool if used.tolerance is None else with_tolerance(of_one_tool, used.tolerance)
        noted = stated if cut_process is None else cut_process.spindle.noted(stated)
        setpoints = Setpoints(noted, limits, T, override, used)

        def keep(samples: Samples, _: Sequence[Standstill]) -> None:
            kept.append(samples.values)
            # The sign marks traverses, which saves a second array of the same length.
            lines.append(np.where(np.isinf(samples.feed), -samples.line, samples.line).astype(np.int32))
            if setpoints.samples > MOST:
                raise section.error(
                    f"{program.name} lasts longer than {Quantity(MOST * T, 's'):6 SI}, {MOST:,} samples, which a job "
                    "does not hold in memory: cut the program, or take feeddrive plan for its setpoints",
                    kind=NotPlannedError,
                )
            if not samples.proven:
                raise section.error(
                    f"{program.name}: the motion could not be proven to keep its limits: "
                    f"{limits.named(str(setpoints.prover.proof().faults[0]))}. This is a fault of feeddrive, not of "
                    "the program",
                    kind=NotPlannedError,
                )

        planned = planned_of(setpoints, program.name, machine.name, keep)
    rows, line = np.concatenate(kept), np.concatenate(lines)
    names = {name.upper(): name for name in machine.loops}
    references = {names[letter]: _reference(rows[:, i], T) for i, letter in enumerate(limits.letters)}
    # A follower, such as the second drive of a gantry, repeats the motion of its leader.
    references |= {name: references[leader] for name, leader in machine.followers().items() if leader in references}
    if process is not None and kinematics is not None:
        _require_upright(process, program, machine, references, np.abs(line))
    times = np.arange(len(line)) * T
    cuts = () if cut_process is None else cut_process.cuts(times, np.abs(line), line < 0)
    return PlannedProgram(
        references,
        Text(
            f"part program {program.name}, {planned.blocks:,} blocks in {Quantity(planned.cycle_time, 's'):6 SI}, "
            f"planned and proven"
        ),
        program,
        planned,
        np.abs(line),
        line > 0 if cut_process is None else _cutting(cuts, times),
        cuts,
        cut_process,
        planned.kinematics or kinematics,
    )


@contextmanager
def _at(section: PartProgramSection, key: str) -> Generator[None]:
    """Raise a ParameterError at the line of a key."""
    try:
        yield
    except ParameterError as error:
        raise section.error(str(error), key) from None


def _of_one_tool(moves: Iterable[Move]) -> Iterator[Move]:
    """Yield the moves; refuse those of the tip of a second tool, since a run is judged at one tip."""
    tool = None
    for move in moves:
        if isinstance(move, ToolPoint) and move.kinematics is not None:
            if tool is not None and move.kinematics.tool != tool:
                reason = (
                    "this moves the tip of a second tool, and a job judges a run at the tip of one: write a program "
                    "and a job for each tool"
                )
                raise located(move.source, BlockError(reason, "G"))
            tool = move.kinematics.tool
        yield move


def _require_upright(
    process: ProcessSection, program: Path, machine: MachineFile, references: Mapping[str, Recorded], line: np.ndarray
) -> None:
    """Raise ParameterError for a cut in a program that tilts the tool or turns the workpiece."""
    for name, reference in references.items():
        if machine.loops[name].axis.rotary and np.any(reference.position != 0.0):
            first = int(line[np.argmax(reference.position != 0.0)])
            raise process.error(
                f"process: {program.name} moves the rotary joint {name.upper()} (line {first}), and the forces of a "
                "tilted tool on a turned workpiece are not modelled: leave out [process], which judges the motion of "
                "the tip in air, or keep all rotary joints at 0"
            )


def _cutting(cuts: Sequence[Cut], times: np.ndarray) -> np.ndarray:
    """Return a mask that is True at the times when the tool is cutting."""
    begins = np.array([cut.begin for cut in cuts])
    depths = np.array([cut.axial_depth for cut in cuts])
    # rounding of k T must not put a sample before the begin of its cut
    return depths[np.searchsorted(begins, times + 1e-9, side="right") - 1] > 0.0


def _reference(rows: np.ndarray, T: float) -> Recorded:
    """Return a reference that replays `rows`, with columns of position, velocity, acceleration, jerk and snap."""
    position, velocity, acceleration, jerk, snap = (np.ascontiguousarray(column) for column in rows.T)
    return Recorded(
        position=position, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap, sample_time=T
    )


def _recorded(section: RecordedSection, place: Path, machine: MachineFile) -> PlannedProgram:
    """Read the setpoints recorded from another planner, and smooth those of each axis that has a column."""
    # imported late: programs of other jobs need no reader of logs
    from feeddrive.files.read_log import OpenedFile, read_log
    from feeddrive.path.smoothing import reach, smoothed

    path = _path(section, place, "recorded")
    file = OpenedFile(path)
    unknown = next((name for name in section.columns if name not in machine.loops), None)
    if unknown is not None:
        raise section.error(
            f"key '{section.dotted('columns')}.{unknown}' is not known{nearest(unknown, machine.loops)}", "columns"
        )
    T = float(next(iter(machine.loops.values())).sample_time)
    references: dict[str, Recorded] = {}
    farthest, rows = 0.0, 0
    for axis, name in section.columns.items():
        log = read_log(file, {"setpoint_position": Column(name=name)}, sample_time=section.sample_time)
        average = max(1, round(section.average / log.sample_time))
        # The averages reach that far beyond both ends: the motion then begins and ends at rest.
        early = reach(average) * log.sample_time
        ends = log.sample_time * (len(log) - 1)
        instants = np.arange(samples(ends + 2.0 * early, T)) * T - early
        smooth = smoothed(log["setpoint_position"], log.sample_time, average, instants)
        references[axis] = _reference(smooth, T)
        recorded = np.interp(instants, np.arange(len(log)) * log.sample_time, log["setpoint_position"])
        farthest, rows = max(farthest, float(np.max(np.abs(smooth[:, 0] - recorded)))), average
    return PlannedProgram(
        references,
        Text(
            f"setpoints recorded in {path.name}, averaged four times over {rows} rows as control points of a spline of "
            f"fifth degree; an axis is at most {Quantity(farthest, 'm')} from the record"
        ),
    )


def _path(section: ProgramSection, place: Path, name: str) -> Path:
    """Return the path of the file named by a key, next to the job or bundled. Raise ParameterError if it is missing."""
    value = str(getattr(section, name))
    beside, bundled = place.parent / value, BUNDLED / "programs" / value
    if beside.is_file():
        return beside
    if not bundled.is_file():
        raise section.error(f"{section.dotted(name)} = {value!r}: there is no such file beside the job", name)
    return bundled
