"""Text with columns: CSV with any separator, decimal point or comma, with or without headers, units and a preamble.

The layout is detected from the first lines: most of them are rows of numbers, and the lines above are headers and
preamble.  A text without headers, with one comma in each line and no other separator, has two columns and no decimal
comma.

Comment lines (#, %, //) and empty lines are skipped; text columns are left out; any other line that is not a row of
numbers is an error with its line number.  Limit: 500 MB; store a larger log as Parquet.  The text is read in chunks:
memory holds the file, its numbers at 8 bytes each, and a few chunks.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.files.columns import COUNTS, Columns, arrow_numbers, check_size, free_name, is_wanted, unit_of
from feeddrive.language.errors import LogError
from feeddrive.language.quantity import Quantity

_SAMPLE = 400  # lines
_LINE = 20_000  # characters of a line that are looked at
_SEPARATORS = (";", "\t", ",", "")  # the last one is any run of spaces
_NUMBER = {
    ".": re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE),
    ",": re.compile(r"[+-]?(\d+(,\d+)?|,\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE),
}
_COMMENT = re.compile(r"\s*(#|%|//)")
# in brackets anything, in parentheses also such pairs: |G| [rad/(s N m)], G ((m/s)/N)
_HEAD = re.compile(r"(.*?)\s*(?:\[([^\]]*)\]|\(((?:[^()]|\([^()]*\))*)\))\s*")


@dataclass(frozen=True)
class CsvLayout:
    """The layout of a text table. `first` is its first line of numbers, from 0; `numeric` flags numeric columns."""

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
        """Return True if a cell is a number in this layout."""
        return _NUMBER[self.decimal].fullmatch(cell) is not None


def split(line: str, separator: str) -> list[str]:
    """Split a line into cells, stripped of quotes and surrounding spaces."""
    if separator == "":
        return line.split()
    if '"' in line:
        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
        except csv.Error:
            pass
    return [cell.strip() for cell in line.split(separator)]


def is_skipped(line: str) -> bool:
    """Return True for an empty line or a comment."""
    return not line.strip() or _COMMENT.match(line) is not None


def layout_of(text: str) -> CsvLayout | None:
    """Detect the layout of a text; None if it contains no rows of numbers."""
    lines = [line[:_LINE] for line in text[: _SAMPLE * 2000].split("\n")[:_SAMPLE]]
    rows = [(k, line) for k, line in enumerate(lines) if not is_skipped(line)]
    candidates: list[tuple[tuple[float, bool, int], CsvLayout]] = []
    for separator in _SEPARATORS:
        for decimal in ".," if separator != "," else ".":
            mask = _usual_mask([line for _, line in rows], separator, decimal)
            if any(mask):
                first = _first(rows, separator, decimal, mask)
                heads = _heads(lines[:first], separator, decimal, len(mask))
                layout = CsvLayout(separator, decimal, first, *_names(heads, len(mask)), mask)
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
    """Return the commonest mask of numeric cells in the second half of the lines; empty if no two of several agree."""
    half = lines[len(lines) // 2 :]
    usual, count = Counter(_mask(line, separator, decimal) for line in half).most_common(1)[0] if half else ((), 0)
    return usual if count >= min(2, len(half)) else ()


def _has_decimal_comma(rows: list[tuple[int, str]], separator: str, mask: tuple[bool, ...]) -> bool:
    """Return True if any number has a decimal comma; whole numbers match both decimal marks."""
    fitting = [split(line, separator) for _, line in rows if _mask(line, separator, ",") == mask]
    return any("," in cell for cells in fitting for cell, numeric in zip(cells, mask, strict=True) if numeric)


def _first(rows: list[tuple[int, str]], separator: str, decimal: str, mask: tuple[bool, ...]) -> int:
    """Return the line where the numbers begin: the first of two regular rows, or partly numeric rows above them."""
    fits = [_mask(line, separator, decimal) == mask for _, line in rows]
    start = next((k for k, fit in enumerate(fits) if fit and (k + 1 == len(fits) or fits[k + 1])), fits.index(True, 0))
    while start > 0:
        above = _mask(rows[start - 1][1], separator, decimal)
        if len(above) != len(mask) or not any(above):
            break
        start -= 1
    return rows[start][0]


def _heads(above: list[str], separator: str, decimal: str, count: int) -> list[list[str]]:
    """Return the cells of up to two header lines directly above the numbers."""
    heads: list[list[str]] = []
    for line in [line for line in above if line.strip()][:-3:-1]:
        cells = _cells(line, separator)
        if len(cells) != count and _COMMENT.match(line):  # a remark with commas may follow the names
            cells = _cells(line.split(" (")[0], separator)
        if len(cells) != count or not any(cells) or any(_NUMBER[decimal].fullmatch(cell) for cell in cells):
            break
        heads.insert(0, cells)
    return heads


def _names(heads: list[list[str]], count: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units of the columns; the lower of two header lines holds units if all its cells are units."""
    names, units = heads[-1] if heads else [""] * count, [""] * count
    if len(heads) == 2 and all(unit_of(cell) is not None or cell.lower() in COUNTS for cell in names):
        names, units = heads[0], [cell if cell.lower() in COUNTS else unit_of(cell) or "" for cell in names]
    unique: list[str] = []
    taken: dict[str, int] = {}
    for k in range(count):
        name, unit = _named(names[k])
        units[k] = unit or units[k]
        if not name:
            name = "time" if k == 0 and units[k] in ("s", "ms", "us", "ns") else f"column_{k + 1}"
        unique.append(free_name(name, taken))
    return tuple(unique), tuple(units)


def _cells(line: str, separator: str) -> list[str]:
    comment = _COMMENT.match(line)
    return split(line[comment.end() :] if comment else line, separator)


def _named(head: str) -> tuple[str, str]:
    """Split `velocity [mm/s]` and `velocity (mm/s)` into name and unit."""
    match = _HEAD.fullmatch(head)
    if match is None:
        return head, ""
    inside = match[2] if match[2] is not None else match[3]
    unit = unit_of(inside)
    if unit is None and "[" in head and len(inside) <= 20:
        unit = inside.strip()
    return (match[1], unit) if unit is not None else (head, "")


MOST_BYTES = 500_000_000
PIECE = 2_000_000  # bytes that are taken at once; the layout is found in the first ones


@dataclass(frozen=True)
class Piece:
    """A chunk of whole lines of a text, with the number of its first line, from 0, and a flag for the last chunk."""

    line: int
    text: str
    is_last: bool


@dataclass(frozen=True)
class Text:
    """The bytes of a text with their encoding."""

    content: bytes
    encoding: str

    def pieces(self, first: int = 0) -> Iterator[Piece]:
        """Yield the text in chunks, starting at a line of the first chunk."""
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
    """Detect the encoding of a text: UTF-8, UTF-16 by its byte order mark, else that of old Windows programs (µ, °)."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        content = content.decode("utf-16", "replace").encode("utf-8", "replace")
    if b"\n" not in content:
        content = content.replace(b"\r", b"\n")
    text = Text(content, "utf-8")
    for piece in text.pieces():
        if "\ufffd" in piece.text:
            return Text(content, "cp1252")
    return text


def read_csv(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the columns of a text table. Raise LogError with file and line."""
    if len(content) > MOST_BYTES:
        raise LogError(
            f"{name}: has {Quantity(len(content) / 1e6, 'MB'):,.0f} of text, more than the "
            f"{Quantity(MOST_BYTES / 1e6, 'MB'):,.0f} that are read; convert it to Parquet or cut it"
        )
    text = text_of(content)
    begin = next(text.pieces()).text
    layout = layout_of(begin)
    if layout is None:
        raise LogError(f"{name}: holds no rows of numbers; a log is a table of numbers with one row a sample")
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
    """Yield the line number, from 0, and text of each line that is neither empty nor a comment."""
    for k, line in enumerate(io.StringIO(body)):
        if not is_skipped(line):
            yield k, line.rstrip("\n")


def _line_of(text: Text, first: int, row: int) -> int:
    """Return the line number, from 0, of a row of numbers."""
    count = 0
    for piece in text.pieces(first):
        for k, _ in _rows(piece.text):
            if count == row:
                return piece.line + k
            count += 1
    return first + row


def _numbers(name: str, piece: Piece, layout: CsvLayout, chosen: list[int]) -> np.ndarray:
    """Return the chosen columns, of shape (rows, columns), using the fastest parser that accepts the text.

    pyarrow reads plain text 5 times as fast as `np.loadtxt`, with identical results; text that it does not accept (runs
    of spaces, a plus sign) is read by `loadtxt`, and text that `loadtxt` rejects is read cell by cell, which locates
    the faulty line.
    """
    plain = body = piece.text
    if any(mark in body for mark in "#%/") or re.match(r"\s*\n", body) or re.search(r"\n[ \t]+\n", body):
        plain = "\n".join(line for _, line in _rows(body))
    if '"' not in plain:
        if layout.decimal == ",":
            plain = plain.replace(",", ".")
        if not plain.strip():
            return np.empty((0, len(chosen)))
        numbers = plain_numbers(plain, layout, chosen)
        if numbers is not None:
            return numbers
    return _numbers_one_by_one(name, piece, layout, chosen)


def plain_numbers(plain: str, layout: CsvLayout, chosen: list[int]) -> np.ndarray | None:
    """Parse text of rows only, with decimal points and no quotes, into the chosen columns; None if a row is invalid."""
    numbers = _numbers_by_arrow(plain, layout, chosen) if layout.separator else None
    return _numbers_by_loadtxt(plain, layout, chosen) if numbers is None else numbers


def _numbers_by_arrow(plain: str, layout: CsvLayout, chosen: list[int]) -> np.ndarray | None:
    """Parse a purely numeric text with pyarrow; None if a cell is not a number or a row has a different length."""
    import pyarrow as arrow
    from pyarrow import csv as arrow_csv

    names = [str(k) for k in range(len(layout.names))]
    numeric = [names[k] for k in chosen]
    try:
        table = arrow_csv.read_csv(
            io.BytesIO(plain.encode()),
            arrow_csv.ReadOptions(column_names=names, use_threads=False, block_size=max(len(plain) + 1, 1 << 16)),
            arrow_csv.ParseOptions(delimiter=layout.separator, quote_char=False),
            arrow_csv.ConvertOptions(
                column_types=dict.fromkeys(numeric, arrow.float64()), include_columns=numeric, null_values=[]
            ),
        )
    except (arrow.ArrowException, UnicodeError, OverflowError):
        return None
    return np.column_stack([arrow_numbers(table.column(k)) for k in range(len(numeric))])


def _numbers_by_loadtxt(plain: str, layout: CsvLayout, chosen: list[int]) -> np.ndarray | None:
    """Parse the text with numpy; None if it rejects a row."""
    try:
        numbers = np.loadtxt(
            io.StringIO(plain),
            delimiter=layout.separator or None,
            usecols=None if len(chosen) == len(layout.names) else chosen,
            comments=None,
            ndmin=2,
        )
    except (ValueError, OverflowError, MemoryError):
        return None
    return numbers if _is_complete(plain, layout, numbers) else None


def _is_complete(plain: str, layout: CsvLayout, numbers: np.ndarray) -> bool:
    """Return True if every row has as many cells as the layout; `usecols` does not check the rest of a row."""
    if layout.separator == "":
        return numbers.shape[1] == len(layout.names)
    return plain.count(layout.separator) == len(numbers) * (len(layout.names) - 1)


def _numbers_one_by_one(name: str, piece: Piece, layout: CsvLayout, chosen: list[int]) -> np.ndarray:
    """Parse cell by cell: slow, but accepts quotes and locates the line of an error."""
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


def _count_reason(line: str, count: int, expected: int, *, last: bool) -> str:
    if "overrun" in line.lower():
        return "says that samples were lost ('overrun'); cut the log there, or record it again with a longer period"
    if last and count < expected:
        return f"has {count} cells, the lines above {expected}: the file is cut off there; remove its last line"
    return f"has {count} cells, the lines above {expected}: '{line.strip()[:40]}'; correct or remove that line"
