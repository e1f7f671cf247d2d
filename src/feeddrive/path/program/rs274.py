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
from feeddrive.path.program.commands import Command, read_command
from feeddrive.path.program.lines import BlockError, Line, LineReader, compact, located

PROGRAM, PACKAGE = "rs274", "linuxcnc-uspace"
LONGEST_RUN = 600.0
"""s"""

_NEEDED = re.compile(r"g0*(?:4[12](?:\.1)?|[78]|76|8[78])(?![\d.])|m0*(?:19|7[0-3])(?![\d.])")
_NUMBER = re.compile(r"\s*(/?)\s*(?:[nN][\s\d.]*)?")
_PRINTED = re.compile(r"\s*\d+ N(\d+|\.+)\s+(.*)")
_AXES = re.compile(r"[uvw](?=[-+\d.#\[])")


def needs_rs274(program: Path) -> bool:
    """Whether a program has codes that only the interpreter of LinuxCNC knows, such as G41."""
    reader = LineReader(program)
    try:
        while line := reader.read():
            if not line.text or line.text.isspace():
                continue
            try:
                text = compact(line.text)[0]
            except BlockError:
                return False  # the own reader says what is wrong
            if ("g" in text or "m" in text) and _NEEDED.search(text) and not re.search(r"<[^>]*[gm]", text):
                return True
    finally:
        reader.close()
    return False


def rs274_commands(program: Path, tools: Path | None = None, offsets: Path | None = None) -> Iterator[Command]:
    """The canonical commands of a program as the interpreter of LinuxCNC prints them."""
    if shutil.which(PROGRAM) is None:
        raise MissingProgramError(PROGRAM, PACKAGE, f"{program}: cutter compensation")
    with tempfile.TemporaryDirectory() as folder:
        lines = _numbered(program, Path(folder) / "program.ngc")
        command = [PROGRAM, "-g"]
        for option, file in (("-t", tools), ("-v", offsets)):
            if file is not None:
                copy = Path(folder) / f"table{file.suffix}"  # it writes its parameters back
                copy.write_bytes(file.read_bytes())
                command += [option, str(copy)]
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
                if _AXES.search(re.sub(r"<[^>]*>", "", text)):
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
