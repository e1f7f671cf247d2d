"""Tool tables (`.tbl` of LinuxCNC): number, pocket, offsets and diameter of each tool."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from feeddrive.language.errors import FileError, shown
from feeddrive.language.quantity import Quantity

_WORD = re.compile(r"([A-Za-z])([+-]?(?:\d+\.?\d*|\.\d+))\s*")
_AXES = "XYZABCUVW"


@dataclass(frozen=True, slots=True)
class Tool:
    """A tool: `offset` of X Y Z A B C U V W and `diameter` in the unit of the table (mm or inch, and degrees)."""

    number: int
    pocket: int
    offset: tuple[float, ...] = (0.0,) * 9
    diameter: float = 0.0
    front_angle: float = 0.0
    back_angle: float = 0.0
    orientation: int = 0
    remark: str = ""


def read_tools(path: Path | str) -> dict[int, Tool]:
    """The tools of a `.tbl` file by number: lines such as `T1 P1 Z0.5 D0.0625 ;drill`."""
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror or error}") from None
    tools: dict[int, Tool] = {}
    for number, line in enumerate(text.splitlines(), 1):
        entry, _, remark = line.partition(";")
        if entry.strip():
            tool = _tool(file, number, entry.strip(), remark.strip())
            if tool.number in tools:
                raise FileError(
                    f"{file}, line {number}: tool T{tool.number} stands there twice: delete one of the lines"
                )
            tools[tool.number] = tool
    return tools


def _tool(file: Path, number: int, entry: str, remark: str) -> Tool:
    words: dict[str, float] = {}
    at = 0
    while at < len(entry):
        found = _WORD.match(entry, at)
        letter = found[1].upper() if found else ""
        if not found or letter not in f"TPDIJQ{_AXES}" or letter in words or not math.isfinite(float(found[2])):
            raise FileError(
                f"{file}, line {number}, column {at + 1}: {shown(entry[at : at + 20])}: a tool has the words "
                "T P X Y Z A B C U V W D I J Q, each once with a number"
            )
        words[letter] = float(found[2])
        at = found.end()
    for letter in "TPQ":
        value = words.get(letter, 0.0)
        if value != round(value) or not 0 <= value <= 99999:
            raise FileError(
                f"{file}, line {number}: {letter}{Quantity(value):6}: a whole number from 0 to 99999 is expected"
            )
    if "T" not in words:
        raise FileError(f"{file}, line {number}: the tool has no number: write T and its number")
    return Tool(
        round(words["T"]),
        round(words.get("P", words["T"])),
        tuple(words.get(letter, 0.0) for letter in _AXES),
        words.get("D", 0.0),
        words.get("I", 0.0),
        words.get("J", 0.0),
        round(words.get("Q", 0.0)),
        remark,
    )
