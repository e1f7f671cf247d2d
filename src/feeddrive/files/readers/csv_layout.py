"""How a text of columns is laid out: separator, decimal mark, heads, units, and where the numbers begin.

Found from the first lines, by the rule that most of them are rows of numbers; what stands above is heads and preamble.
A text without heads, with one comma in each line and no other separator, is two columns and not a decimal comma.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from dataclasses import dataclass, replace

from feeddrive.files.columns import COUNTS, unit_of

_SAMPLE = 400  # lines
_LINE = 20_000  # characters of a line that are looked at
_SEPARATORS = (";", "\t", ",", "")  # the last one is any run of spaces
_NUMBER = {
    ".": re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE),
    ",": re.compile(r"[+-]?(\d+(,\d+)?|,\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE),
}
_COMMENT = re.compile(r"\s*(#|%|//)")
_HEAD = re.compile(r"(.*?)\s*[\[(]([^\])]*)[\])]\s*")


@dataclass(frozen=True)
class Layout:
    """`first` counts lines from 0; `numeric` says which columns hold numbers."""

    separator: str
    decimal: str
    first: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    numeric: tuple[bool, ...]

    def __str__(self) -> str:
        separator = {"\t": "tab", "": "space"}.get(self.separator, self.separator)
        return f"text, separator '{separator}', decimal '{self.decimal}'"

    def is_number(self, cell: str) -> bool:
        """True for a number in this layout."""
        return _NUMBER[self.decimal].fullmatch(cell) is not None


def split(line: str, separator: str) -> list[str]:
    """The cells of a line, without quotes and spaces around them."""
    if separator == "":
        return line.split()
    if '"' in line:
        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
        except csv.Error:
            pass
    return [cell.strip() for cell in line.split(separator)]


def is_skipped(line: str) -> bool:
    """True for an empty line or a comment."""
    return not line.strip() or _COMMENT.match(line) is not None


def layout_of(text: str) -> Layout | None:
    """The layout of a text, or None if it holds no rows of numbers."""
    lines = [line[:_LINE] for line in text[: _SAMPLE * 2000].split("\n")[:_SAMPLE]]
    rows = [(k, line) for k, line in enumerate(lines) if not is_skipped(line)]
    candidates: list[tuple[tuple[float, bool, int], Layout]] = []
    for separator in _SEPARATORS:
        for decimal in ".," if separator != "," else ".":
            mask = _usual_mask([line for _, line in rows], separator, decimal)
            if any(mask):
                first = _first(rows, separator, decimal, mask)
                heads = _heads(lines[:first], separator, decimal, len(mask))
                layout = Layout(separator, decimal, first, *_names(heads, len(mask)), mask)
                candidates.append(((sum(mask) / len(mask), bool(heads), len(mask)), layout))
    if not candidates:
        return None
    best = max(candidates, key=lambda candidate: candidate[0])[1]
    if best.separator != "," and _has_decimal_comma(rows, best.separator, best.numeric):
        return replace(best, decimal=",")
    return best


def _mask(line: str, separator: str, decimal: str) -> tuple[bool, ...]:
    return tuple(_NUMBER[decimal].fullmatch(cell) is not None for cell in split(line, separator))


def _usual_mask(lines: list[str], separator: str, decimal: str) -> tuple[bool, ...]:
    """Which cells are numbers in most of the lines of the second half; at least two lines, or the only one."""
    half = lines[len(lines) // 2 :]
    usual, count = Counter(_mask(line, separator, decimal) for line in half).most_common(1)[0] if half else ((), 0)
    return usual if count >= min(2, len(half)) else ()


def _has_decimal_comma(rows: list[tuple[int, str]], separator: str, mask: tuple[bool, ...]) -> bool:
    """Whole numbers fit both marks; one number with a comma decides."""
    fitting = [split(line, separator) for _, line in rows if _mask(line, separator, ",") == mask]
    return any("," in cell for cells in fitting for cell, numeric in zip(cells, mask, strict=True) if numeric)


def _first(rows: list[tuple[int, str]], separator: str, decimal: str, mask: tuple[bool, ...]) -> int:
    """The line at which the numbers begin: the first of two usual ones, or an unusual one with numbers above it."""
    fits = [_mask(line, separator, decimal) == mask for _, line in rows]
    start = next((k for k, fit in enumerate(fits) if fit and (k + 1 == len(fits) or fits[k + 1])), fits.index(True, 0))
    while start > 0:
        above = _mask(rows[start - 1][1], separator, decimal)
        if len(above) != len(mask) or not any(above):
            break
        start -= 1
    return rows[start][0]


def _heads(above: list[str], separator: str, decimal: str, count: int) -> list[list[str]]:
    """The one or two lines of heads that stand just above the numbers, as cells; none if there are none."""
    found: list[list[str]] = []
    for line in [line for line in above if line.strip()][:-3:-1]:
        cells = _cells(line, separator)
        if len(cells) != count and _COMMENT.match(line):  # a remark may follow the names, with commas of its own
            cells = _cells(line.split(" (")[0], separator)
        if len(cells) != count or not any(cells) or any(_NUMBER[decimal].fullmatch(cell) for cell in cells):
            break
        found.insert(0, cells)
    return found


def _names(heads: list[list[str]], count: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the columns; the lower of two lines is one of units if all its cells are."""
    names, units = heads[-1] if heads else [""] * count, [""] * count
    if len(heads) == 2 and all(unit_of(cell) is not None or cell.lower() in COUNTS for cell in names):
        names, units = heads[0], [cell if cell.lower() in COUNTS else unit_of(cell) or "" for cell in names]
    found: list[str] = []
    for k in range(count):
        name, unit = _named(names[k])
        units[k] = unit or units[k]
        if not name:
            name = "time" if k == 0 and units[k] in ("s", "ms", "us", "ns") else f"column_{k + 1}"
        while name in found:
            name += "_again"
        found.append(name)
    return tuple(found), tuple(units)


def _cells(line: str, separator: str) -> list[str]:
    comment = _COMMENT.match(line)
    return split(line[comment.end() :] if comment else line, separator)


def _named(head: str) -> tuple[str, str]:
    """`velocity [mm/s]` and `velocity (mm/s)` as name and unit."""
    found = _HEAD.fullmatch(head)
    if found is None:
        return head, ""
    unit = unit_of(found[2])
    if unit is None and "[" in head and len(found[2]) <= 20:
        unit = found[2].strip()
    return (found[1], unit) if unit is not None else (head, "")
