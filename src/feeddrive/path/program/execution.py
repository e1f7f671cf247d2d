"""One run of a part program in any language: its lines in order, the state of the machine, and the commands it makes.

    lines -> language -> switches, motion, state -> commands

A `Language` says what a line means; what does not depend on it stands here and in the parts that it uses: the budget of
lines and commands, the start position, the way to the line from which the program is resumed, and the place of errors.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from feeddrive.path.kinematics import Kinematics
from feeddrive.path.program.aiming import BY_AXES, Turning
from feeddrive.path.program.blocks import BlockError, Line, Parameters, located
from feeddrive.path.program.budget import MOST_AGAIN, MOST_COMMANDS
from feeddrive.path.program.lines import ProgramLines
from feeddrive.path.program.motion import PLANES, Motion
from feeddrive.path.program.moves import Command, Value
from feeddrive.path.program.siemens_splines import MOTIONS, Edges, PointSpline, tangents
from feeddrive.path.program.state import Names, State, Tool
from feeddrive.path.program.switches import Switches


@dataclass(frozen=True)
class Setting:
    """The tables and choices with which a program is run.

    tools        the tool table, by number
    numbered     numbered parameters at the start, such as those of a `.var` file
    tables_inch  tool table and parameters are in inches instead of mm
    skip_deleted True to skip lines that begin with /
    most_again   largest number of lines that loops and calls may repeat
    parameters   values of named parameters or variables
    kinematics   kinematics of the machine, with which the tip of the tool can be moved
    start        position of the machine, mm and degrees
    from_line    line at which the program is resumed; 0: its beginning
    turning      how the tool turns while its tip is moved, where the program does not say
    """

    tools: dict[int, Tool] | None = None
    numbered: dict[int, float] | None = None
    tables_inch: bool = False
    skip_deleted: bool = False
    most_again: int = MOST_AGAIN
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    kinematics: Kinematics | None = None
    start: Sequence[float] = (0.0,) * 9
    from_line: int = 0
    turning: Turning = BY_AXES


class Language(Protocol):
    """What the lines of a program mean."""

    @property
    def loop(self) -> str:
        """The innermost loop that is running in the program itself, with its line; empty if none is."""
        ...

    def begin(self) -> None:
        """Emit the state at the start of the program."""
        ...

    def execute(self, line: Line) -> bool:
        """Execute a line; return True if it ends the program."""
        ...

    def finish(self) -> bool:
        """Act at the end of a file; return True if it ends the program, False for the file of a subprogram."""
        ...

    def words(self) -> str:
        """Return the modal state as the words that set it."""
        ...


class Execution:
    """The run of a program: its lines, the state, and the commands of the line that is being executed.

    names  words of the program's language in messages
    """

    def __init__(self, program: Path, setting: Setting, names: Names | None = None) -> None:
        self.setting = setting
        self.parameters = Parameters(setting.numbered)
        self.state = State(self.parameters, setting.tables_inch, setting.kinematics, names)
        self.state.turning = setting.turning
        self.tools = None if setting.tools is None else dict(setting.tools)
        self.lines = ProgramLines(program, setting.most_again)
        self.line = Line(str(program), 0, "")
        self._main, self._from_line = self.line.file, setting.from_line
        self._out: list[Command] = []
        self._last: tuple[Command, list[float], int] | None = None  # last move, its start and plane
        self._heading: np.ndarray | None = None
        self.motion = Motion(self.state, self.emit, self.lines.moved)
        self.switches = Switches(self.state, self.emit, self.tools, lambda: self.line, self._out_of_turn)

    def emit(self, name: str, *values: Value) -> None:
        """Add a command of the present line; it waits for a corner of the contour, or for the end of a spline."""
        command, state = Command(name, values, self.line), self.state
        if name in MOTIONS:
            if state.spline:
                self.end_spline(tangents(command, state.spline.end, PLANES[state.plane])[0])
            self._last = command, state.position, state.plane
        if state.compensation:
            state.compensation.take(command)
        elif state.spline:
            state.spline.take(command)
        elif state.aiming.busy:
            self._out += state.take(command)
        else:
            if len(self._out) >= MOST_COMMANDS:
                raise BlockError(
                    f"this block makes more than {MOST_COMMANDS} moves and events: make fewer pecks, repeats or points"
                )
            self._out.append(command)

    def begin_spline(self, kind: str, degree: int, edges: Edges) -> PointSpline:
        """Begin a spline at the present position."""
        state = self.state
        if state.leaving:
            raise BlockError(f"the move behind G40 is straight: write G0 or G1 before this {kind}", kind)
        state.settle()
        self._out += state.aiming.taken()
        unit = 1000.0 / state.meters
        spline = PointSpline(kind, state.position, degree, edges, self._heading_now(), unit, self._out_of_turn)
        state.spline = spline
        return spline

    def end_spline(self, behind: np.ndarray | None) -> None:
        """Write a spline whose end is known; `behind`: unit vector along the move behind it, None if there is none."""
        spline, self.state.spline = self.state.spline, None
        if spline:
            self._heading = spline.finish(behind)
            self._last = None

    def _heading_now(self) -> np.ndarray | None:
        """Return the unit vector along the end of the last move in X Y Z; None if there is none."""
        if self._last:
            command, start, plane = self._last
            self._heading = tangents(command, start, PLANES[plane])[1]
        return self._heading

    def forget_heading(self) -> None:
        """Forget the direction of the last move, whose coordinates have turned."""
        self._last = self._heading = None

    def _out_of_turn(self, command: Command) -> None:
        self._out.append(command)

    def _taken(self) -> list[Command]:
        out, self._out = self._out, []
        return out

    def commands(self, language: Language) -> Generator[Command]:
        """Yield the canonical commands in program order."""
        try:
            language.begin()
            ended = False
            while not ended:
                if self._out:
                    yield from self._taken()
                line = self.lines.next_line()
                try:
                    if line is None:
                        ended = language.finish()
                        continue
                    self.line = line
                    if self._from_line and line.number >= self._from_line:
                        self._resume(line, language)
                    ended = language.execute(line)
                except BlockError as fault:
                    raise located(self.line, fault) from None
                except ArithmeticError:
                    reason = "the numbers of this block are too large: check units and parameters"
                    raise located(self.line, BlockError(reason)) from None
            if self._from_line:
                reason = f"the program ends here, before line {self._from_line} (--from-line): name a line that it runs"
                raise located(self.line, BlockError(reason))
            yield from self._taken()
        finally:
            self.lines.close()

    def _resume(self, line: Line, language: Language) -> None:
        """Emit RESUME with the modal state in front of the line from which the program is resumed.

        Raises BlockError if the state there depends on more than the line.
        """
        wanted, state, calls = self._from_line, self.state, self.lines.calls
        if line.file != self._main or (line.number != wanted and calls):
            return
        if line.number > wanted:
            reason = (
                f"line {wanted} (--from-line) is not run on the way to this line: it lies in a subroutine, or in a "
                "branch or loop that is left out; name a line of the program itself that is run, such as the call"
            )
        elif calls:
            reason = f"line {wanted} (--from-line) lies in a subroutine: name the line of its call"
        elif language.loop:
            reason = (
                f"line {wanted} (--from-line) lies in the loop {language.loop}, and which pass is meant is not "
                "known: name the line of the loop, or one behind its end"
            )
        elif state.compensation or state.leaving:
            reason = (
                f"at line {wanted} (--from-line) radius compensation is on, or its last move not yet done, so the "
                "position depends on the moves around it: name a line before G41 or G42, or behind the move after G40"
            )
        elif state.tool_point:
            names = state.names
            reason = (
                f"at line {wanted} (--from-line) the tip of the tool is moved ({names.tool_point}): name a line before "
                f"that word, or behind {names.joints}"
            )
        elif state.nurbs or state.spline:
            reason = f"line {wanted} (--from-line) lies between the control points of a curve: name its first line"
        else:
            self._from_line = 0
            self.emit("RESUME", language.words())
            return
        raise BlockError(reason)
