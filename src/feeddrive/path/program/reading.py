"""Reading of a part program with a suitable front end, as canonical commands or as moves.

The front ends are the built-in interpreter and that of LinuxCNC: its program `rs274` is run, and the canonical text
that it prints is parsed. The latter supports cutter compensation and the rest of the language, but prints only four
decimals of the program unit (0.1 um in mm, 2.5 um in inches), and no U, V or W words.
"""

import os
import re
import shutil
import subprocess
import tempfile
import time
from array import array
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from math import degrees
from pathlib import Path

from feeddrive.language.errors import MissingProgramError, ParameterError, ProgramError, plain
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.program import blocks
from feeddrive.path.program.aiming import BY_AXES, Turning
from feeddrive.path.program.blocks import BlockError, Line, LineReader, Place
from feeddrive.path.program.budget import MOST_AGAIN, check_lines
from feeddrive.path.program.dialects import DialectName, FrontEnd
from feeddrive.path.program.execution import Setting
from feeddrive.path.program.frame import Frame, Travel
from feeddrive.path.program.interpreter import Interpreter
from feeddrive.path.program.moves import Begin, Command, Move, Point, read_command
from feeddrive.path.program.resume import resumed
from feeddrive.path.program.state import G92, G92_ON, HOME_1, HOME_2, INCH, LINEAR, SYSTEM, SYSTEMS, Tool, read_tools

PROGRAM, PACKAGE = "rs274", "linuxcnc-uspace"
LONGEST_RUN, LARGEST_OUTPUT = 300.0, 2e9
"""The longest run of `rs274`, s, and the largest size of its output, bytes."""

_NEEDED = re.compile(r"g0*(?:[78](?![\d.])|7[0-2](?!\d)|96(?![\d.]))")
_CANDIDATE = re.compile(rb"[gG][ \t0]*(?:7[ \t]*[012]|9[ \t]*6|[78][ \t]*(?![0-9 \t]))")
_NAME = re.compile(r"<[^>]*>")
_NUMBER = re.compile(r"\s*(/?)\s*(?:[nN][\s\d.]*)?")
_PRINTED = re.compile(r"\s*\d+ N(\d+|\.+)\s+(.*)")
_AXES = re.compile(r"[uvw](?=[-+\d.#\[])")
# LinuxCNC's interpreter runs the comments (py,CODE), (pyrun,FILE) and (pyreload) as Python; a `;` begins one, too
_PYTHON = re.compile(r"[(;]\s*py(?:,|run|reload)", re.IGNORECASE)
_O_WORD = re.compile(r"o\s*(?:<([^>]+)>|(\d+))", re.IGNORECASE)


def needs_rs274(program: Path) -> bool:
    """Return True if a program has codes that only the interpreter of LinuxCNC supports: those of lathes."""
    reader = LineReader(program)
    try:
        if not _may_need(program):
            return False
        while line := reader.read():
            try:
                text = blocks.compact(line.text)[0]
            except BlockError:
                return False  # our own reader reports the error
            if ("g" in text or "m" in text) and _NEEDED.search(_NAME.sub("", text)):
                return True
    finally:
        reader.close()
    return False


def _may_need(program: Path) -> bool:
    """Return True if a quick search finds signs of codes that only LinuxCNC's interpreter supports; false positives are
    possible. The search ends at an overlong line, which `LineReader` refuses.
    """
    end, since = b"", 0
    with program.open("rb") as file:
        while since <= blocks.LONGEST_LINE and (chunk := file.read(2**15)):
            if _CANDIDATE.search(end + chunk):
                return True
            # a code may lie across the border of two chunks
            end = chunk[-200:]
            ended = chunk.rfind(b"\n")
            since = since + len(chunk) if ended < 0 else len(chunk) - ended
    return False


def rs274_commands(
    program: Path,
    tools: dict[int, Tool] | None = None,
    numbered: dict[int, float] | None = None,
    tables_inch: bool = False,
    skip_deleted: bool = False,
) -> Generator[Command]:
    """Yield the canonical commands of a program as LinuxCNC's interpreter prints them; see `Interpreter`.

    The interpreter runs in a folder of copies: of the program, and of the subroutine files beside it that it calls.
    Comments that it would run as Python are refused, and so are subroutines in other folders.
    """
    if shutil.which(PROGRAM) is None:
        raise MissingProgramError(PROGRAM, PACKAGE, f"{program}: codes of lathes")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "program.ngc"
        source = _Source(program, copy)
        command = [PROGRAM, "-g", *(["-b"] if skip_deleted else [])]
        unit = 1.0 if tables_inch else INCH
        for option, text in (("-t", _tool_table(tools, unit)), ("-v", _parameter_file(numbered, unit))):
            # an empty table rather than none: rs274 would take tools of its own, and compensate for their diameter
            if text or option == "-t":
                table = Path(folder) / f"table{option}"
                table.write_text(text, encoding="utf-8")
                command += [option, str(table)]
        output, called = Path(folder) / "canonical.txt", Path(folder) / "called"
        called.mkdir()
        try:
            _copy_called(source.called, program.parent, called)
            code, complaint = _run([*command, str(copy), str(output)], program, called, output)
            yield from _read(source, output, complaint, code, tools is None)
        finally:
            source.close()


def _copy_called(called: set[str], beside: Path, folder: Path) -> None:
    """Copy the files of subroutines that a program calls, directly or not, from the folder beside it to another one.

    Raises the errors of `_called`.
    """
    left = sorted(called)
    while left:
        name = left.pop()
        file, copy = beside / f"{name}.ngc", folder / f"{name}.ngc"
        if copy.exists() or not file.is_file():
            continue
        reader = LineReader(file)
        try:
            with copy.open("w", encoding="utf-8") as copied:
                while line := reader.read():
                    left += _called(line)
                    copied.write(line.text + "\n")
        finally:
            reader.close()


def _called(line: Line) -> set[str]:
    """Return the names of O words in a line, each of which may be a file.

    Raises ProgramError for a comment that the interpreter would run as Python, and for a file in another folder.
    """
    if match := _PYTHON.search(line.text):
        reason = f"{PROGRAM} would run this comment as Python, and no code in a program is run: remove it"
        raise blocks.located(line, BlockError(reason, line.text[match.start() :][:20], column=match.start() + 1))
    names = set[str]()
    for match in _O_WORD.finditer(line.text):
        # the interpreter ignores case and blanks in names
        name = "".join((match[1] or match[2]).lower().split())
        if "/" in name:
            reason = f"{PROGRAM} may open subroutines beside the program only: copy the file there"
            raise blocks.located(line, BlockError(reason, match[0][:20], column=match.start() + 1))
        names.add(name)
    return names


def _run(command: list[str], program: Path, folder: Path, output: Path) -> tuple[int, str]:
    """Run the interpreter in a folder; return its exit status and its messages."""
    with tempfile.TemporaryFile() as errors:
        # it keeps its tool table in $HOME/.tool.mmap, which a LinuxCNC that runs, and every other rs274, has open
        at_home = {**os.environ, "HOME": str(folder)}
        # errors go to a file, as a pipe that is not read while the program runs would fill up and block it
        run = subprocess.Popen(
            command, cwd=folder, env=at_home, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors
        )
        begun = time.monotonic()
        try:
            while True:
                try:
                    run.wait(0.5)
                    break
                except subprocess.TimeoutExpired:
                    large = output.exists() and output.stat().st_size > LARGEST_OUTPUT
                    if large or time.monotonic() - begun > LONGEST_RUN:
                        bound = Text(
                            f"after {Quantity(LONGEST_RUN, 's'):6 SI} or {Quantity(LARGEST_OUTPUT / 1e9, 'GB')} of "
                            "output"
                        )
                        reason = Text(f"{PROGRAM} had not ended {bound}: does a loop never end?")
                        raise ProgramError(str(program), 1, 1, "", reason) from None
        finally:
            # also after an interrupt: it would go on writing to a folder that is removed
            run.kill()
            run.wait()
        errors.seek(0)
        return run.returncode, errors.read().decode("utf-8", "replace")


def _tool_table(tools: dict[int, Tool] | None, unit: float) -> str:
    """Write a tool table in inches, which the stand-alone interpreter expects."""
    lines: list[str] = []
    for tool in (tools or {}).values():
        offset = [value / unit if axis in LINEAR else value for axis, value in enumerate(tool.offset)]
        words = "".join(
            f" {letter.upper()}{value:.10f}" for letter, value in zip(blocks.AXES, offset, strict=True) if value
        )
        angles = f" I{tool.front_angle:.10f} J{tool.back_angle:.10f} Q{tool.orientation}"
        lines.append(f"T{tool.number} P{tool.pocket}{words} D{tool.diameter / unit:.10f}{angles}\n")
    return "".join(lines)


def _parameter_file(numbered: dict[int, float] | None, unit: float) -> str:
    """Write a parameter file in inches with all numbers that the interpreter requires, in order."""
    if numbered is None:
        return ""
    firsts = (HOME_1, HOME_2, G92, *(SYSTEM + 1 + 20 * system for system in range(SYSTEMS)))
    lengths = {first + axis for first in firsts for axis in LINEAR}
    asked = {*range(HOME_1, HOME_1 + 9), *range(HOME_2, HOME_2 + 9), *range(G92_ON, SYSTEM + 1 + 20 * SYSTEMS)}
    values = dict.fromkeys(asked, 0.0) | {SYSTEM: 1.0} | numbered
    return "".join(f"{n}\t{values[n] / unit if n in lengths else values[n]:.10f}\n" for n in sorted(values))


class _Source:
    """The lines of a program, by number; only their positions are held in memory."""

    def __init__(self, program: Path, copy: Path) -> None:
        """Write a copy of the program in which the N word of each line is the number of the line."""
        self._reader = LineReader(program)
        self._offsets = array("q")
        self._line = Line(self._reader.name, 0, "")
        self.called = set[str]()  # names of its O words, each of which may be a file
        try:
            with copy.open("w", encoding="utf-8") as file:
                while line := self._reader.read():
                    self._offsets.append(self._reader.last.offset)
                    self.called |= _called(line)
                    file.write(_with_number(line) + "\n")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def line(self, number: int) -> Line:
        """Return a line by its number; for an unknown number return the last line accessed."""
        if number != self._line.number and 1 <= number <= len(self._offsets):
            self._reader.go(Place(self._offsets[number - 1], number - 1))
            self._line = self._reader.read() or self._line
        return self._line

    def last(self) -> Line:
        """Return the last line."""
        return self.line(len(self._offsets))


def _with_number(line: Line) -> str:
    try:
        text = blocks.compact(line.text)[0]
    except BlockError as fault:
        raise blocks.located(line, fault) from None
    if _AXES.search(_NAME.sub("", text)):
        reason = f"{PROGRAM} prints no U, V and W: this program cannot be read by it"
        raise blocks.located(line, BlockError(reason, text[:20], 0))
    if text in ("", "%"):
        return line.text
    start = _NUMBER.match(line.text)
    assert start is not None
    # numbers written in the program are replaced: they may repeat, and rs274 prints them with its commands
    return f"{start[1]}N{line.number} {line.text[start.end() :]}"


def _read(source: _Source, output: Path, complaint: str, code: int, no_tools: bool) -> Iterator[Command]:
    line = source.line(0)
    if output.exists():
        with output.open(encoding="utf-8", errors="replace") as file:
            for printed in file:
                match = _PRINTED.match(printed)
                if not match:
                    continue
                # commands before the first line have dots in place of its number
                if match[1].isdigit():
                    line = source.line(int(match[1]))
                command = read_command(match[2].rstrip(), line)
                if command is not None:
                    yield command
    # rs274 refuses such a program; here the end of the file ends it
    if "File ended with no percent sign or program end" in complaint:
        yield Command("FINISH", (), source.last())
    elif code:
        raise _refused(source, line, complaint, code, no_tools)


def _refused(source: _Source, line: Line, complaint: str, code: int, no_tools: bool) -> ProgramError:
    """Return the interpreter's error, located at the line that it reports."""
    messages = [text for text in complaint.splitlines() if text.strip() and text.strip() != "executing"]
    for text in messages[1:]:
        match = re.match(r"/?N(\d+)\s", text)
        if match:
            line = source.line(int(match[1]))
    word = plain(line.text.strip())[:40]
    column = 1 + len(line.text) - len(line.text.lstrip())
    reason = plain(messages[0]) if messages else f"it ended with status {code} and no message"
    if no_tools and "tool table" in reason:
        reason += "; give the tool table"
    return ProgramError(line.file, line.number, column, word, f"{PROGRAM} refuses it: {reason}")


"""The readers of a program."""


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
    parameters: Mapping[str, float] | None = None,
    dialect: DialectName = "linuxcnc",
    kinematics: Kinematics | None = None,
    start: Mapping[str, float] | None = None,
    from_line: int = 0,
    turning: Turning = BY_AXES,
) -> Generator[Move]:
    """Yield the moves of a part program (RS-274/NGC) in constant memory: m, rad, s, machine coordinates.

    axes          axes of the machine with their travel, such as {"X": (0, 0.5), "Z": None}; None: all nine, without
                  travel limits
    tools         tool table (.tbl); without one, M6 accepts any tool, and G43 H is refused
    offsets       parameter file (.var): work offsets, G28, G30
    tables_inch   both tables are in inches instead of mm
    skip_deleted  skip lines that begin with /
    front_end     own: the built-in interpreter; rs274: that of LinuxCNC; auto: rs274 if
                  it is installed and the program needs it (G7)
    most_again    largest number of lines that loops and calls may repeat
    parameters    values of named parameters that the program does not set, such as {"_hal[plasmac.cut-feed-rate]": 40}
    dialect       linuxcnc: RS-274/NGC; grbl; marlin: a 3D printer, whose E is the axis U; siemens: SINUMERIK
    kinematics    kinematics of the machine, with which G43.4 and G43.5 move the tip of the tool
    start         where the machine stands, in machine coordinates, m and rad: {"X": 0.1}; other axes at its zero
    from_line     line at which the program is resumed, with the modal state of the lines before it; 0: its beginning.
                  The machine stands where this line begins, or at `start`, and goes there by a traverse
    turning       how the tool turns under G43.4 and G43.5, where the program does not say

    The first move is a `Begin` if either of the last two is given; the built-in interpreter then reads the program.

    An invalid program ends the iteration with a `ProgramError` stating file, line, column, word and reason.
    """
    frame = Frame(axes, kinematics, start if not from_line else None)
    place = None if start is None else frame.place(start)
    commands = read_commands(
        program,
        tools=tools,
        offsets=offsets,
        tables_inch=tables_inch,
        skip_deleted=skip_deleted,
        front_end=front_end,
        most_again=most_again,
        parameters=parameters,
        dialect=dialect,
        kinematics=kinematics,
        start=None if from_line else place,
        from_line=from_line,
        turning=turning,
    )
    if from_line:
        return resumed(_moves(frame, commands), place)
    return _moves(frame, commands, None if place is None else Begin(Line(str(program), 1, ""), place))


def _moves(frame: Frame, commands: Generator[Command], begin: Begin | None = None) -> Generator[Move]:
    """Yield the moves; always close the files of the commands at the end."""
    with closing(commands):
        if begin is not None:
            yield begin
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
    parameters: Mapping[str, float] | None = None,
    dialect: DialectName = "linuxcnc",
    kinematics: Kinematics | None = None,
    start: Point | None = None,
    from_line: int = 0,
    turning: Turning = BY_AXES,
) -> Generator[Command]:
    """Yield the canonical commands of a part program, in its own units and coordinates; see `read_program`."""
    path = Path(program)
    check_lines(path)
    if start is not None or from_line:
        if front_end == "rs274":
            raise ParameterError(
                f"{PROGRAM} starts at the zero of the machine and line 1: take the front end auto or own"
            )
        front_end = "own"
    if dialect != "linuxcnc":
        if front_end == "rs274":
            raise ParameterError(
                f"{PROGRAM} reads no programs in the dialect {dialect}: take the front end auto or own"
            )
        front_end = "own"
    if parameters:
        if front_end == "rs274":
            raise ParameterError(f"{PROGRAM} takes no parameters from outside: take the front end auto or own")
        front_end = "own"
    if front_end == "auto":
        front_end = "rs274" if needs_rs274(path) and shutil.which(PROGRAM) else "own"
    table = None if tools is None else read_tools(tools)
    numbered = None if offsets is None else blocks.read_offsets(offsets)
    if front_end == "rs274":
        return rs274_commands(path, table, numbered, tables_inch, skip_deleted)
    stands = [0.0] * 9 if start is None else [1e3 * x if k in LINEAR else degrees(x) for k, x in enumerate(start)]
    setting = Setting(
        table, numbered, tables_inch, skip_deleted, most_again, parameters or {}, kinematics, stands, from_line, turning
    )
    if dialect == "siemens":
        # imported late: another language, with an interpreter of its own
        from feeddrive.path.program.siemens import SiemensInterpreter

        return SiemensInterpreter(path, setting).commands()
    return Interpreter(path, setting, dialect).commands()
