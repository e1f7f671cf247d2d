"""Text with columns: CSV of any separator, decimal point or comma, with heads, units and a preamble, or without.

Comment lines (#, %, //) and empty ones are passed over; columns of text are left out; everything else that is not a row
of numbers is an error with its line.  Up to 500 MB; a larger log is better kept as Parquet.

The text is taken piece by piece: beside the file and its numbers, 8 bytes each, a few pieces are in memory.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from feeddrive.files.columns import Columns, check_size, is_wanted
from feeddrive.files.readers.csv_layout import Layout, is_skipped, layout_of, split
from feeddrive.language.errors import LogError

MOST_BYTES = 500_000_000
PIECE = 2_000_000  # bytes that are taken at once; the layout is found in the first ones


@dataclass(frozen=True)
class Piece:
    """Some whole lines of a text: the number of the first, from 0, and whether they are the last ones."""

    line: int
    text: str
    is_last: bool


@dataclass(frozen=True)
class Text:
    """The bytes of a text and how they are read."""

    content: bytes
    encoding: str

    def pieces(self, first: int = 0) -> Iterator[Piece]:
        """The text from a line of the first piece on, piece by piece."""
        line, at, length = 0, 0, len(self.content)
        while True:
            end = self.content.find(b"\n", at + PIECE) + 1 or length
            text = self.content[at:end].decode(self.encoding, "replace")
            if "\r" in text:
                text = text.replace("\r\n", "\n").replace("\r", "\n")
            if at == 0:
                text = text.removeprefix("\ufeff")
                text, line = text.split("\n", first)[-1], first
            yield Piece(line, text, end >= length)
            line += text.count("\n")
            at = end
            if at >= length:
                return


def text_of(content: bytes) -> Text:
    """The text in some bytes: UTF-8, UTF-16 by its mark, else that of older Windows programs (µ, °)."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        content = content.decode("utf-16", "replace").encode("utf-8", "replace")
    if b"\n" not in content:
        content = content.replace(b"\r", b"\n")
    found = Text(content, "utf-8")
    for piece in found.pieces():
        if "\ufffd" in piece.text:
            return Text(content, "cp1252")
    return found


def read_csv(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """The columns of a text. Raises LogError that names file and line."""
    if len(content) > MOST_BYTES:
        raise LogError(
            f"{name}: has {len(content) / 1e6:,.0f} MB of text, more than the {MOST_BYTES / 1e6:,.0f} MB that are "
            "read; convert it to Parquet or cut it"
        )
    text = text_of(content)
    begin = next(text.pieces()).text
    layout = layout_of(begin)
    if layout is None:
        start = next((line.strip() for line in begin.split("\n", 50) if line.strip()), "")
        shown = f"; it begins with '{start[:40]}'" if start else ""
        raise LogError(f"{name}: holds no rows of numbers{shown}; a log is a table of numbers with one row a sample")
    chosen = [k for k, column in enumerate(layout.names) if layout.numeric[k] and is_wanted(column, wanted)]
    left_out = {column: "text" for column, numeric in zip(layout.names, layout.numeric, strict=True) if not numeric}
    # filled piece by piece; a row has a letter and a separator for each number at least
    room = min(text.content.count(b"\n") + 1, len(text.content) // max(2 * len(layout.names) - 1, 1) + 1)
    columns = [np.empty(room) for _ in chosen]
    rows = 0
    for piece in text.pieces(layout.first) if chosen else ():
        numbers = _numbers(name, piece, layout, chosen)
        check_size(name, len(chosen), rows + len(numbers))
        for i, column in enumerate(columns):
            column[rows : rows + len(numbers)] = numbers[:, i]
        rows += len(numbers)

    def place(row: int) -> str:
        return f"line {_line_of(text, layout.first, row) + 1}"

    values = {layout.names[k]: column[:rows] for k, column in zip(chosen, columns, strict=True)}
    units = {layout.names[k]: layout.units[k] for k in chosen if layout.units[k]}
    unread = tuple(column for column in layout.names if column not in values and column not in left_out)
    return Columns(str(layout), values, units, unread=unread, left_out=left_out, place=place)


def _rows(body: str) -> Iterator[tuple[int, str]]:
    """Number, from 0, and text of the lines that are neither empty nor comments."""
    for k, line in enumerate(io.StringIO(body)):
        if not is_skipped(line):
            yield k, line.rstrip("\n")


def _line_of(text: Text, first: int, row: int) -> int:
    """The line, from 0, of a row of numbers."""
    count = 0
    for piece in text.pieces(first):
        for k, _ in _rows(piece.text):
            if count == row:
                return piece.line + k
            count += 1
    return first + row


def _numbers(name: str, piece: Piece, layout: Layout, chosen: list[int]) -> np.ndarray:
    """The chosen columns as an array of shape (rows, columns): fast if the text is plain, else cell by cell."""
    plain = body = piece.text
    if re.search(r"[#%/]|\n[ \t]+\n|\A\s*\n", body):
        plain = "\n".join(line for _, line in _rows(body))
    if '"' not in plain:
        if layout.decimal == ",":
            plain = plain.replace(",", ".")
        if not plain.strip():
            return np.empty((0, len(chosen)))
        try:
            found = np.loadtxt(
                io.StringIO(plain),
                delimiter=layout.separator or None,
                usecols=None if len(chosen) == len(layout.names) else chosen,
                comments=None,
                ndmin=2,
            )
        except (ValueError, OverflowError, MemoryError):
            found = None
        if found is not None and _is_complete(plain, layout, found):
            return found
    return _numbers_one_by_one(name, piece, layout, chosen)


def _is_complete(plain: str, layout: Layout, found: np.ndarray) -> bool:
    """Whether every row had as many cells as the layout: `usecols` does not look at the rest of a row."""
    if layout.separator == "":
        return found.shape[1] == len(layout.names)
    return plain.count(layout.separator) == len(found) * (len(layout.names) - 1)


def _numbers_one_by_one(name: str, piece: Piece, layout: Layout, chosen: list[int]) -> np.ndarray:
    """The slow way: it knows the line of whatever is wrong, and takes quotes."""
    count = len(layout.names)
    rows: list[list[float]] = []
    total = piece.text.count("\n") + 1
    for k, line in _rows(piece.text):
        where = f"{name}: line {k + piece.line + 1}"
        cells = split(line, layout.separator)
        if len(cells) != count:
            raise LogError(f"{where} {_count_reason(line, len(cells), count, last=piece.is_last and k >= total - 2)}")
        row: list[float] = []
        for i in chosen:
            if not layout.is_number(cells[i]):
                what = f"'{cells[i][:40]}' is not a number" if cells[i] else "is empty"
                raise LogError(f"{where}, column '{layout.names[i]}': {what}; correct or remove that line")
            row.append(float(cells[i].replace(",", ".") if layout.decimal == "," else cells[i]))
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(chosen))


def _count_reason(line: str, found: int, expected: int, *, last: bool) -> str:
    if "overrun" in line.lower():
        return "says that samples were lost ('overrun'); cut the log there, or record it again with a longer period"
    if last and found < expected:
        return f"has {found} cells, the lines above {expected}: the file is cut off there; remove its last line"
    return f"has {found} cells, the lines above {expected}: '{line.strip()[:40]}'; correct or remove that line"
