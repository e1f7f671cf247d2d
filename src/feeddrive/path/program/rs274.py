"""The interpreter of LinuxCNC as front end: the program `rs274` runs, and its canonical text is read.

It knows cutter compensation and the rest of the language. It prints four decimals of the program's unit: 0.1 um in mm,
2.5 um in inches; and no U, V and W.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from feeddrive.language.errors import MissingProgramError, ProgramError, plain
from feeddrive.path.program.blocks import AXES
from feeddrive.path.program.commands import Command, read_command
from feeddrive.path.program.lines import BlockError, Line, LineReader, compact, located
from feeddrive.path.program.state import G92, G92_ON, HOME_1, HOME_2, INCH, LINEAR, SYSTEM, SYSTEMS
from feeddrive.path.program.tools import Tool

PROGRAM, PACKAGE = "rs274", "linuxcnc-uspace"
LONGEST_RUN = 600.0
"""s"""

_NEEDED = re.compile(r"g0*(?:4[12](?:\.1)?|[78]|76|8[78])(?![\d.])|m0*(?:19|7[0-3])(?![\d.])")
_CANDIDATE = re.compile(
    rb"[gG][ \t0]*(?:4[ \t]*[12]|7[ \t]*6|8[ \t]*[78]|[78][ \t]*(?![0-9 \t]))|[mM][ \t0]*(?:1[ \t]*9|7[ \t]*[0-3])"
)
_NAME = re.compile(r"<[^>]*>")
_NUMBER = re.compile(r"\s*(/?)\s*(?:[nN][\s\d.]*)?")
_PRINTED = re.compile(r"\s*\d+ N(\d+|\.+)\s+(.*)")
_AXES = re.compile(r"[uvw](?=[-+\d.#\[])")


def needs_rs274(program: Path) -> bool:
    """Whether a program has codes that only the interpreter of LinuxCNC knows, such as G41."""
    reader = LineReader(program)
    try:
        if not _may_need(program):
            return False
        while line := reader.read():
            try:
                text = compact(line.text)[0]
            except BlockError:
                return False  # the own reader says what is wrong
            if ("g" in text or "m" in text) and _NEEDED.search(_NAME.sub("", text)):
                return True
    finally:
        reader.close()
    return False


def _may_need(program: Path) -> bool:
    """The same, quickly, at the cost of a yes too many."""
    end = b""
    with program.open("rb") as file:
        while chunk := file.read(2**20):
            if _CANDIDATE.search(end + chunk):
                return True
            end = chunk[-200:]
    return False


def rs274_commands(
    program: Path,
    tools: dict[int, Tool] | None = None,
    numbered: dict[int, float] | None = None,
    tables_inch: bool = False,
    skip_deleted: bool = False,
) -> Iterator[Command]:
    """The canonical commands of a program as the interpreter of LinuxCNC prints them; see `Interpreter`."""
    if shutil.which(PROGRAM) is None:
        raise MissingProgramError(PROGRAM, PACKAGE, f"{program}: cutter compensation")
    with tempfile.TemporaryDirectory() as folder:
        lines = _numbered(program, Path(folder) / "program.ngc")
        command = [PROGRAM, "-g", *(["-b"] if skip_deleted else [])]
        unit = 1.0 if tables_inch else INCH
        for option, text in (("-t", _tool_table(tools, unit)), ("-v", _parameter_file(numbered, unit))):
            if text:
                table = Path(folder) / f"table{option}"
                table.write_text(text)
                command += [option, str(table)]
        output = Path(folder) / "canonical.txt"
        try:
            done = subprocess.run(
                [*command, str(Path(folder) / "program.ngc"), str(output)],
                cwd=program.parent,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=LONGEST_RUN,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise ProgramError(
                str(program), 1, 1, "", f"{PROGRAM} had not ended after {LONGEST_RUN:g} s: does a loop never end?"
            ) from None
        yield from _read(program, lines, output, done.stderr.decode("utf-8", "replace"), done.returncode)


def _tool_table(tools: dict[int, Tool] | None, unit: float) -> str:
    """A tool table in inches, which the stand-alone interpreter expects."""
    lines: list[str] = []
    for tool in (tools or {}).values():
        offset = [value / unit if axis in LINEAR else value for axis, value in enumerate(tool.offset)]
        words = "".join(f" {letter.upper()}{value:.10f}" for letter, value in zip(AXES, offset, strict=True) if value)
        angles = f" I{tool.front_angle:.10f} J{tool.back_angle:.10f} Q{tool.orientation}"
        lines.append(f"T{tool.number} P{tool.pocket}{words} D{tool.diameter / unit:.10f}{angles}\n")
    return "".join(lines)


def _parameter_file(numbered: dict[int, float] | None, unit: float) -> str:
    """A parameter file in inches, with all numbers that the interpreter asks for, in their order."""
    if numbered is None:
        return ""
    firsts = (HOME_1, HOME_2, G92, *(SYSTEM + 1 + 20 * system for system in range(SYSTEMS)))
    lengths = {first + axis for first in firsts for axis in LINEAR}
    asked = {*range(HOME_1, HOME_1 + 9), *range(HOME_2, HOME_2 + 9), *range(G92_ON, SYSTEM + 1 + 20 * SYSTEMS)}
    values = dict.fromkeys(asked, 0.0) | {SYSTEM: 1.0} | numbered
    return "".join(f"{n}\t{values[n] / unit if n in lengths else values[n]:.10f}\n" for n in sorted(values))


def _numbered(program: Path, copy: Path) -> list[str]:
    """Write a copy in which each line has its number as N; gives the lines."""
    reader = LineReader(program)
    lines: list[str] = []
    try:
        with copy.open("w", encoding="utf-8") as file:
            while line := reader.read():
                lines.append(line.text)
                try:
                    text = compact(line.text)[0]
                except BlockError as fault:
                    raise located(line, fault) from None
                if _AXES.search(_NAME.sub("", text)):
                    raise located(
                        line,
                        BlockError(f"{PROGRAM} prints no U, V and W: this program cannot be read by it", text[:20], 0),
                    )
                start = _NUMBER.match(line.text)
                assert start is not None
                rest = line.text[start.end() :]
                numbered = line.text if text in ("", "%") else f"{start[1]}N{line.number} {rest}"
                file.write(numbered + "\n")
    finally:
        reader.close()
    return lines


def _read(program: Path, lines: list[str], output: Path, complaint: str, code: int) -> Iterator[Command]:
    name = str(program)
    last = 0
    with output.open(encoding="utf-8", errors="replace") as file:
        for printed in file:
            found = _PRINTED.match(printed)
            if not found:
                continue
            if found[1].isdigit() and 1 <= int(found[1]) <= len(lines):
                last = int(found[1])
            command = read_command(found[2].rstrip(), Line(name, last, lines[last - 1] if last else ""))
            if command is not None:
                yield command
    unended = "File ended with no percent sign or program end" in complaint
    if unended:
        yield Command("FINISH", (), Line(name, len(lines), lines[-1] if lines else ""))
    said = [text for text in complaint.splitlines() if text.strip() and text.strip() != "executing"]
    if said and code and not unended:
        raise _refused(name, lines, said, last)


def _refused(name: str, lines: list[str], said: list[str], last: int) -> ProgramError:
    """The error of the interpreter, at the line that it prints with it."""
    number, word = last or 1, ""
    for text in said[1:]:
        found = re.match(r"/?N(\d+)\s", text)
        if found and 1 <= int(found[1]) <= len(lines):
            number = int(found[1])
            word = plain(lines[number - 1].strip())[:40]
    column = 1 + len(lines[number - 1]) - len(lines[number - 1].lstrip()) if lines else 1
    return ProgramError(name, number, column, word, f"{PROGRAM} refuses it: {plain(said[0])}")
