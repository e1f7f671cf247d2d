"""Canonical commands: what a block asks of a machine, in the units and coordinates of the program, and their text.

The names and the text are those of the stand-alone interpreter of LinuxCNC, so that two front ends give one stream.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

from feeddrive.path.program.lines import Line

Value = float | str
"""A number, or a word such as CANON_EXACT_PATH; whole numbers that name something are int."""


class Command(NamedTuple):
    """A canonical command: its name, its values, and the line that caused it."""

    name: str
    values: tuple[Value, ...]
    line: Line


def _listed(values: tuple[Value, ...]) -> str:
    return ", ".join(f"{value:.4f}" if isinstance(value, float) else str(value) for value in values)


def _six(values: tuple[Value, ...]) -> str:
    return _listed(values[:6])


def _quoted(values: tuple[Value, ...]) -> str:
    return f'"{values[0]}"'


def _mode(values: tuple[Value, ...]) -> str:
    return str(values[0]) if len(values) == 1 else f"{values[0]}, {values[1]:.6f}"


def _offsets(values: tuple[Value, ...]) -> str:
    return ", ".join(" ".join(f"{value:.4f}" for value in values[i : i + 3]) for i in (0, 3, 6))


def _entry(values: tuple[Value, ...]) -> str:
    pocket, tool, *offset = values[:11]
    return f"{pocket}, {tool}, {' '.join(f'{value:.4f}' for value in offset)}, {_listed(values[11:])}"


_TEXT: dict[str, Callable[[tuple[Value, ...]], str]] = {
    "STRAIGHT_TRAVERSE": _six,
    "STRAIGHT_FEED": _six,
    "ARC_FEED": lambda values: _listed(values[:9]),
    "SET_G5X_OFFSET": lambda values: _listed(values[:7]),
    "SET_G92_OFFSET": _six,
    "COMMENT": _quoted,
    "MESSAGE": _quoted,
    "LOG": _quoted,
    "SET_MOTION_CONTROL_MODE": _mode,
    "USE_TOOL_LENGTH_OFFSET": _offsets,
    "SET_SPINDLE_MODE": lambda values: f"{values[0]} {values[1]:.4f}",
    "SET_TOOL_TABLE_ENTRY": _entry,
    "SET_MOTION_OUTPUT_VALUE": lambda values: f"{values[0]},{values[1]:.6f}",
    "SET_AUX_OUTPUT_VALUE": lambda values: f"{values[0]},{values[1]:.6f}",
    "START_SPEED_FEED_SYNC": lambda values: f"{values[0]:.6f},{values[1]}",
}


def canonical_text(command: Command) -> str:
    """Return the text of a command as LinuxCNC's interpreter prints it, without the line number; PRINT has no text
    there.
    """
    if command.name == "PRINT":
        return ""
    return f"{command.name}({_TEXT.get(command.name, _listed)(command.values)})"


_COMMAND = re.compile(r"([A-Z_][A-Z_0-9]*)\((.*)\)$")


def read_command(text: str, line: Line) -> Command | None:
    """Parse the text of a command; None if it is no command."""
    match = _COMMAND.fullmatch(text)
    if not match:
        return None
    if match[2].startswith('"'):
        return Command(match[1], (match[2][1:-1],), line)
    return Command(match[1], tuple(_value(value) for value in re.split(r"[,\s]+", match[2]) if value), line)


def _value(text: str) -> Value:
    try:
        return float(text) if "." in text else int(text)
    except ValueError:
        return text
