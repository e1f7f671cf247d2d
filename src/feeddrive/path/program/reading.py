"""Reading a part program: the front end that can read it, its commands, its moves."""

from __future__ import annotations

import shutil
from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from typing import Literal

from feeddrive.path.program.commands import Command
from feeddrive.path.program.flow import MOST_AGAIN
from feeddrive.path.program.frame import Frame, Travel
from feeddrive.path.program.interpreter import Interpreter
from feeddrive.path.program.moves import Move
from feeddrive.path.program.parameters import read_offsets
from feeddrive.path.program.rs274 import PROGRAM, needs_rs274, rs274_commands
from feeddrive.path.program.tools import read_tools

FrontEnd = Literal["auto", "own", "rs274"]


def read_program(
    program: Path | str,
    *,
    axes: Travel | None = None,
    tools: Path | str | None = None,
    offsets: Path | str | None = None,
    tables_inch: bool = False,
    skip_deleted: bool = False,
    front_end: FrontEnd = "auto",
    most_again: int = MOST_AGAIN,
) -> Generator[Move]:
    """The moves of a part program (RS-274/NGC), one by one in constant memory: m, rad, s, machine coordinates.

    axes          axes of the machine with their travel, such as {"X": (0, 0.5), "Z": None}; None: all, without ends
    tools         tool table (.tbl); without one M6 changes to any tool, and G43 H is refused
    offsets       parameters (.var): work offsets, G28, G30
    tables_inch   whether both tables are in inches instead of mm
    skip_deleted  leave out lines that begin with /
    front_end     own; rs274: LinuxCNC's interpreter; auto: rs274 where a program needs it (G41) and it is installed
    most_again    how many lines loops and calls may read again

    A wrong program ends the iteration with a `ProgramError` of file, line, column, word and reason.
    """
    commands = read_commands(
        program,
        tools=tools,
        offsets=offsets,
        tables_inch=tables_inch,
        skip_deleted=skip_deleted,
        front_end=front_end,
        most_again=most_again,
    )
    return _moves(Frame(axes), commands)


def _moves(frame: Frame, commands: Generator[Command]) -> Generator[Move]:
    """The moves; whatever ends them, the files of the commands are closed."""
    with closing(commands):
        yield from frame.moves(commands)


def read_commands(
    program: Path | str,
    *,
    tools: Path | str | None = None,
    offsets: Path | str | None = None,
    tables_inch: bool = False,
    skip_deleted: bool = False,
    front_end: FrontEnd = "auto",
    most_again: int = MOST_AGAIN,
) -> Generator[Command]:
    """The canonical commands of a part program, in its own units and coordinates; see `read_program`."""
    path = Path(program)
    if front_end == "auto":
        front_end = "rs274" if needs_rs274(path) and shutil.which(PROGRAM) else "own"
    table = None if tools is None else read_tools(tools)
    numbered = None if offsets is None else read_offsets(offsets)
    if front_end == "rs274":
        return rs274_commands(path, table, numbered, tables_inch, skip_deleted)
    return Interpreter(path, table, numbered, tables_inch, skip_deleted, most_again).commands()
