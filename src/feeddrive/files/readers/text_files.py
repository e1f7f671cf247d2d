"""Text files with columns: CSV, EPOS Studio, LinuxCNC's halscope and halsampler, TwinCAT Scope View, Klipper and Duet.

A CSV file may have any separator, a decimal point or comma, and optionally headers, units and a preamble.  The layout
is detected from the first lines: most of them are rows of numbers, and the lines above are headers and preamble.  A
file without headers, with one comma in each line and no other separator, has two columns and no decimal comma.

Comment lines (#, %, //) and empty lines are skipped, and text columns are left out; any other line that is not a row of
numbers raises an error that states its line number.  Limit: 500 MB; store a larger log as Parquet.  The text is read
in chunks: memory holds the file, its numbers at 8 bytes each, and a few chunks.

An EPOS Studio file (maxon) states sampling period and number of rows; the reader checks both.  Torque is in percent of
the motor's nominal torque, current in mA, position in counts.

    Date:;2020-07-08 21:13:16
    EPOS Studio Version:;3.6.1.0
    Recorded samples:;500
    Sampling period:;12.800                ms
    ;Velocity actual value averaged;Torque actual value averaged
    ms;rpm;%
    0.000;-101;-24.1

LinuxCNC has two layouts of halscope, and one of halsampler:

    # Sampling period is 1000000 ns        halscope since 2.9: names, two lines of display settings, rows with ';'
    joint.0.motor-pos-cmd;joint.0.motor-pos-fb
    # Position: 0.500000;0.500000
    # Scale: 0;0

    Sampling period is 1000000 ns          halscope before 2.9: name and value alternate
    joint.0.motor-pos-cmd +0.0 joint.0.motor-pos-fb +0.0

    17 0.000000 1.250000 0                 halsampler: no names, a sample number only with its option -t

halsampler prints six decimals: positions in mm are then exact to a nanometer, but small signals in SI units have a
coarse resolution.  It writes `overrun` where samples were lost.

TwinCAT Scope View (3.4 and its documentation) has a header with one entry for each channel, then alternating times and
values:

    Name<tab>Scope1                            the project, its file, start and end of the export
    Name<tab>Axis 1.ActPos<tab>Name<tab>...    one row for each property, its key before each value
    SampleTime[ms]<tab>0,25<tab>SampleTime[ms]<tab>...
    Unit<tab>mm<tab>Unit<tab>...

    0<tab>12,5<tab>0<tab>...                   time in ms (or a FILETIME in 100 ns), value, time, value
    EOF                                        optional

A time column may be shared by the channels that follow it.  Only channels with one sample time are read, that of most
requested channels; the others are left out, with their sample time as the reason.  As a float, a FILETIME is exact
only to 3 us; the stated sample time compensates for this.

Klipper's ACCELEROMETER_MEASURE writes accelerations in mm/s², and Duet's M569.5 the motion of a closed-loop stepper in
full steps, with the time in ms:

    #time,accel_x,accel_y,accel_z
    Sample,Timestamp,Measured Motor Steps,Target Motor Steps,PID Control Signal
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from feeddrive.files.columns import COUNTS, Columns, Reader, arrow_numbers, check_size, free_name, is_wanted, unit_of
from feeddrive.language.errors import LogError
from feeddrive.language.quantity import Quantity

# The second half of these lines determines the layout, so that a preamble may have half of them.
_SAMPLE = 400  # lines
_LINE = 20_000  # characters of a line that are examined
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
    """The layout of a text table. `first` is the index of its first numeric line; `numeric` flags numeric columns."""

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
            # An unbalanced quote: the line is split plainly, and the bad cell is reported.
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
    """Return the most frequent mask of numeric cells in the second half of the lines; empty if no two masks agree."""
    half = lines[len(lines) // 2 :]
    usual, count = Counter(_mask(line, separator, decimal) for line in half).most_common(1)[0] if half else ((), 0)
    return usual if count >= min(2, len(half)) else ()


def _has_decimal_comma(rows: list[tuple[int, str]], separator: str, mask: tuple[bool, ...]) -> bool:
    """Return True if any number contains a decimal comma; whole numbers do not show the decimal mark."""
    fitting = [split(line, separator) for _, line in rows if _mask(line, separator, ",") == mask]
    return any("," in cell for cells in fitting for cell, numeric in zip(cells, mask, strict=True) if numeric)


def _first(rows: list[tuple[int, str]], separator: str, decimal: str, mask: tuple[bool, ...]) -> int:
    """Return the index of the line at which the numbers begin.

    It is the first of two consecutive rows that match the mask, or the first of the partly numeric rows above them.
    """
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
        # A remark with commas may follow the names.
        if len(cells) != count and _COMMENT.match(line):
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
    """Split a header such as `velocity [mm/s]`, `velocity (mm/s)` or `velocity/mm/s` into name and unit."""
    match = _HEAD.fullmatch(head)
    if match is None:
        return _divided(head)
    inside = match[2] if match[2] is not None else match[3]
    unit = unit_of(inside)
    if unit is None and "[" in head and len(inside) <= 20:
        unit = inside.strip()
    return (match[1].removesuffix("/").strip(), unit) if unit is not None else (head, "")


def _divided(head: str) -> tuple[str, str]:
    """Split a header of a quantity divided by its unit, `t/s` or `v/(mm/s)`; in `re m/N` the whole end is a unit.

    Source: DIN 1313 and ISO 80000-1, which use this form for table headers.
    """
    time, _, unit = head.partition("/")
    if time == "t" and unit in ("s", "ms", "us"):  # and no tonnes per second
        return time, unit
    starts = [0, *(k + 1 for k, letter in enumerate(head) if letter in " _")]
    if any("/" in head[start:] and unit_of(head[start:]) is not None for start in starts):
        return head, ""
    for k, letter in enumerate(head):
        unit = unit_of(head[k + 1 :]) if letter == "/" and k > 0 else None
        if unit is not None:
            return head[:k].strip(), unit
    return head, ""


MOST_BYTES = 500_000_000
PIECE = 2_000_000  # bytes of a chunk; the layout is detected in the first one


@dataclass(frozen=True)
class Piece:
    """A chunk of whole lines of a text, with the index of its first line and a flag for the last chunk."""

    line: int
    text: str
    is_last: bool


@dataclass(frozen=True)
class Text:
    """The bytes of a text file, with its encoding."""

    content: bytes
    encoding: str

    def pieces(self, first: int = 0) -> Iterator[Piece]:
        """Yield the text in chunks, from line `first` on, which must lie in the first chunk."""
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
    """Detect the encoding of a text: UTF-16 by its byte order mark, UTF-8 if valid, otherwise Windows-1252 (µ, °)."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        content = content.decode("utf-16", "replace").encode("utf-8", "replace")
    if b"\n" not in content:
        content = content.replace(b"\r", b"\n")
    text = Text(content, "utf-8")
    for piece in text.pieces():
        # µ or ° in cp1252 is a lone byte, which is never valid in UTF-8
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
    """Parse a text of rows, with decimal points and no quotes, into the chosen columns; None if a row is invalid."""
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
    """Return True if every row has as many cells as the layout, which `usecols` of numpy does not check."""
    if layout.separator == "":
        return numbers.shape[1] == len(layout.names)
    return plain.count(layout.separator) == len(numbers) * (len(layout.names) - 1)


def _numbers_one_by_one(name: str, piece: Piece, layout: CsvLayout, chosen: list[int]) -> np.ndarray:
    """Parse cell by cell, which is slow but accepts quotes and locates the line of an error."""
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


_EPOS_HEAD = 4096  # bytes at the start that hold the statements
_EPOS_VERSION = re.compile(rb"^EPOS Studio Version:", re.MULTILINE)
_EPOS_PERIOD = re.compile(rb"^Sampling period:;([0-9]{1,9}(?:[.,][0-9]{0,9})?)\s*$", re.MULTILINE)
_EPOS_ROW = re.compile(
    rb"^((?:[+-]?[0-9]+(?:[.,][0-9]+)?;)+[+-]?[0-9]+(?:[.,][0-9]+)?)((?=[;,\r\n])([^\r\n]*))(?=\r?$)", re.MULTILINE
)
_EPOS_ROWS = re.compile(rb"^Recorded samples:;([0-9]{1,9})\s*$", re.MULTILINE)


def is_epos(content: bytes) -> bool:
    """Return True for a recording of EPOS Studio."""
    return _EPOS_VERSION.search(content[:_EPOS_HEAD]) is not None


def read_epos(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the channels of an EPOS Studio recording. Raise LogError with file and line, also for missing rows."""
    content, written = _without_remarks(content)
    columns = read_csv(name, content, wanted)
    rows = max((column.size for column in columns.values.values()), default=0)
    stated = _EPOS_ROWS.search(content[:_EPOS_HEAD])
    if stated is not None and columns.values and rows != int(stated[1]):
        raise LogError(
            f"{name}: states {int(stated[1])} recorded samples and holds {rows}; it is cut off or was edited: "
            "export it again, or correct the line 'Recorded samples'"
        )
    period = _EPOS_PERIOD.search(content[:_EPOS_HEAD])
    # the period is a decimal in ms; its product with 1e-3 is off by a rounding
    seconds = 0.0 if period is None else round(float(period[1].replace(b",", b".")) * 1e-3, 12)
    left_out = {
        **columns.left_out,
        **({"after the last channel": f"remarks in {written} row{'s' * (written != 1)}"} if written else {}),
    }
    metadata = {"sample_time": seconds} if seconds > 0.0 else {}
    return replace(columns, format="EPOS Studio", left_out=left_out, metadata=metadata)


def _without_remarks(content: bytes) -> tuple[bytes, int]:
    """Strip remarks to the right of the last channel; return the recording and the number of rows with such a remark.

    Spreadsheet programs pad all lines with commas to the length of the longest one (`-24.1,,`), and some lines contain
    a remark there.
    """
    rows = list(_EPOS_ROW.finditer(content))
    if not any(row[3] for row in rows):
        return content, 0
    counts = Counter(row[1].count(b";") for row in rows)
    width = counts.most_common(1)[0][0]
    head, body = content[: rows[0].start()], content[rows[0].start() :]
    lines = [
        _to_width(line, width) if line.startswith((b";", b"ms;")) else line.rstrip(b",;\r \t")
        for line in head.split(b"\n")
    ]
    cut = _EPOS_ROW.sub(lambda row: row[1] if row[1].count(b";") == width else row[0], body)
    return b"\n".join(lines) + cut, sum(bool(row[3].strip(b",; \t")) for row in rows)


def _to_width(line: bytes, width: int) -> bytes:
    """Truncate a header line to `width` + 1 cells, and the last of these at its first comma."""
    cells = line.rstrip(b"\r").split(b";")[: width + 1]
    return b";".join([*cells[:-1], cells[-1].split(b",")[0]])


_HALSCOPE_PERIOD = re.compile(rb"(?:# *)?Sampling period is (-?\d{1,18}) n(?:s|Sec)[ \t]*\r?\n")
_HALSCOPE_SCREEN = re.compile(rb"^# (?:Position|Scale): [^\n]*", re.MULTILINE)
_HALSAMPLER = re.compile(rb"(?:overrun\n){0,3}(?:(?:-?\d{1,20}(?:\.\d{6})?|-?nan|-?inf) ){1,64}\n")
_HALSAMPLER_OVERRUNS = re.compile(rb"(?:overrun\n)+")
COUNTER = "sample"


def is_halscope(content: bytes) -> bool:
    """Return True for a halscope log."""
    return _HALSCOPE_PERIOD.match(content) is not None


def is_halsampler(content: bytes) -> bool:
    """Return True for a halsampler log: numbers with six decimals or none, each followed by a space."""
    return _HALSAMPLER.match(content) is not None


def read_halscope(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the channels of a halscope log, with its sample time. Raise LogError with file and line."""
    head = _HALSCOPE_PERIOD.match(content)
    assert head is not None
    period = int(head[1])
    if period <= 0:
        raise LogError(f"{name}: states a sampling period of {period} ns, which must be > 0 ns; give the sample time")
    metadata = {"sample_time": period / 1e9}
    if content.startswith(b"#"):
        # the lines of the screen, between names and numbers, are emptied: line numbers stay right
        body = b"\n" + _HALSCOPE_SCREEN.sub(b"", content[head.end() :])
        columns = read_csv(name, body, wanted)
        return replace(columns, format="halscope", metadata=metadata)
    # an empty line in place of the first one: line numbers of errors stay right
    columns = read_csv(name, b"\n" + content[head.end() :], None)
    names = _names_between(name, content[head.end() :])
    places = {f"column_{2 * k + 2}": label for k, label in enumerate(names)}
    if set(columns.values) != set(places):
        raise LogError(f"{name}: is a halscope log whose lines are not names and numbers by turns; export it as CSV")
    rows = max(values.size for values in columns.values.values())
    for label in names:
        word = label.encode("utf-8", "replace")
        if content.count(word + b" +") + content.count(word + b" -") < rows:
            raise LogError(f"{name}: '{label[:40]}' is not in every line; export it again")
    kept = {places[key]: values for key, values in columns.values.items() if wanted is None or places[key] in wanted}
    unread = tuple(label for label in names if label not in kept)
    return replace(columns, format="halscope", values=kept, left_out={}, unread=unread, metadata=metadata)


def _names_between(name: str, body: bytes) -> list[str]:
    """Return the channel names in the first line of a pre-2.9 halscope log. Raise LogError for a repeated name."""
    line = next((line for line in body.split(b"\n", 100) if line.strip()), b"")
    names = line.decode("utf-8", "replace").split()[::2]
    if len(set(names)) != len(names):
        raise LogError(f"{name}: records '{max(names, key=names.count)[:40]}' twice; record each channel once")
    return names


def read_halsampler(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the pins of a halsampler log as column_1, column_2, ...; sample numbers, if present, give the time.

    An `overrun` before the first row is skipped, since no sample within the log is lost; anywhere else it raises
    LogError with the line number.
    """
    late = _HALSAMPLER_OVERRUNS.match(content)
    lines = 0 if late is None else late[0].count(b"\n")
    columns = read_csv(name, b"\n" * lines + content[0 if late is None else late.end() :], None)
    values = dict(columns.values)
    first = values.get("column_1")
    metadata: dict[str, str] = {}
    if first is not None and len(values) > 1 and counts_samples(first):
        del values["column_1"]
        values = {COUNTER: first, **values}
        metadata["counter"] = COUNTER
    kept = {
        key: column for key, column in values.items() if wanted is None or key in wanted or key in metadata.values()
    }
    unread = tuple(key for key in values if key not in kept)
    return replace(columns, format="halsampler", values=kept, unread=unread, metadata=metadata)


def counts_samples(numbers: np.ndarray) -> bool:
    """Return True if the numbers can be sample numbers: whole numbers that increase, mostly by one."""
    steps = np.diff(numbers)
    return bool(
        steps.size >= 2 and np.all(numbers == np.floor(numbers)) and np.all(steps >= 1) and np.median(steps) == 1.0
    )


# the first piece of a text, in which the properties of the channels are read
_TWINCAT_HEAD_BYTES = 2_000_000
_TWINCAT_HEAD = re.compile(rb"\s*(?:\xef\xbb\xbf)?\"?Name\"?([\t;,])")
_TWINCAT_KEYS = ("SampleTime[ms]", "SymbolComment", "Data-Type", "SymbolName", "VariableSize")
# 1e15 ms are 31,700 years, and 1e15 ticks were over in 1604: no recording lies near
_FILETIME = 1e15  # ticks of 100 ns since 1601; an offset in ms never comes near
_UNITLESS = ("(None)", "None", "")


def is_twincat(content: bytes) -> bool:
    """Return True for an export of TwinCAT Scope View, identified by its header."""
    begin = content[:_TWINCAT_HEAD_BYTES]
    return _TWINCAT_HEAD.match(begin) is not None and b"SampleTime[ms]" in begin


@dataclass
class _TwincatChannel:
    """A channel of a TwinCAT export: the indices of its time and value columns, and its properties."""

    time: int
    place: int
    name: str
    properties: dict[str, str] = field(default_factory=dict[str, str])


def read_twincat(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read those channels of a TwinCAT export that share one sample time, and their time column.

    Raises LogError with file and line.
    """
    if len(content) > MOST_BYTES:
        raise LogError(
            f"{name}: has more than the {Quantity(MOST_BYTES / 1e6, 'MB'):,.0f} of text that are read; export a part"
        )
    head = _TWINCAT_HEAD.match(content)
    assert head is not None
    separator = head[1].decode()
    text = text_of(content)
    channels, first = _twincat_channels(name, next(text.pieces()).text, separator)
    decimal = "," if separator != "," and _has_comma(text, first) else "."
    chosen, left_out = _one_clock(channels, wanted)
    places = sorted({chosen[0].time, *(channel.place for channel in chosen)})
    by_place, lines = _twincat_numbers(
        name, text, first, separator, decimal, places, max(c.place for c in channels) + 1
    )
    check_size(name, len(places), lines.size)
    time, ticks = by_place[chosen[0].time], 1e-3
    metadata: dict[str, float] = {}
    if time.size and time[0] > _FILETIME:
        time, ticks = time - time[0], 1e-7
        stated = chosen[0].properties.get("SampleTime[ms]", "").replace(",", ".")
        if _is_float(stated, ".") and 0.0 < float(stated) < 1e6:
            metadata["sample_time"] = round(float(stated) * 1e-3, 12)
    values = {"time": time * ticks, **{channel.name: by_place[channel.place] for channel in chosen}}
    units = {"time": "s"}
    for channel in chosen:
        stated = re.sub(r" *\(.*\)$", "", channel.properties.get("Unit", ""))
        if stated not in _UNITLESS:
            units[channel.name] = unit_of(stated) or stated

    def place(row: int) -> str:
        return f"line {int(lines[row]) + 1}"

    return Columns("TwinCAT Scope", values, units, left_out=left_out, metadata=metadata, place=place)


def _twincat_channels(name: str, begin: str, separator: str) -> tuple[list[_TwincatChannel], int]:
    """Return the channels listed in the header, and the line at which the numbers begin."""
    rows = [[cell.strip().strip('"') for cell in line.split(separator)] for line in begin.split("\n")[:200]]
    heads = [k for k, row in enumerate(rows) if row[0] == "Name" and k > 0]
    start = next((k for k in heads if _follows(rows, k)), heads[0] if heads else 0)
    keys = rows[start]
    times = [k for k, cell in enumerate(keys) if cell == "Name"]
    if times[:1] != [0]:
        raise LogError(f"{name}: line {start + 1} is not the row of names of a TwinCAT export; export it again")
    channels: list[_TwincatChannel] = []
    taken: dict[str, int] = {}
    for place in range(len(keys)):
        if keys[place] and place not in times:
            label = free_name(keys[place], taken)
            channels.append(_TwincatChannel(max(k for k in times if k < place), place, label))
    line = start + 1
    while line < len(rows) and any(rows[line]) and not _is_number(rows[line][0]):
        for channel in channels:
            if channel.place < len(rows[line]):
                channel.properties[rows[line][0]] = rows[line][channel.place]
        line += 1
    if not channels:
        raise LogError(f"{name}: is a TwinCAT export without a channel; export it again")
    return channels, line


def _follows(rows: list[list[str]], k: int) -> bool:
    """Return True if row `k` is followed by rows of channel properties."""
    return any(row[0] in _TWINCAT_KEYS for row in rows[k + 1 : k + 4])


def _is_number(cell: str) -> bool:
    return re.fullmatch(r"[+-]?[0-9][0-9.,eE+-]*", cell) is not None


def _has_comma(text: Text, first: int) -> bool:
    """Return True if a decimal comma occurs in the first rows of numbers."""
    return any("," in line for line in next(text.pieces(first)).text.split("\n")[:2000])


def _one_clock(
    channels: list[_TwincatChannel], wanted: frozenset[str] | None
) -> tuple[list[_TwincatChannel], dict[str, str]]:
    """Return the requested channels with the most common sample time, and by name why other channels are omitted."""

    def clock(channel: _TwincatChannel) -> str:
        return channel.properties.get("SampleTime[ms]", "")

    asked = [channel for channel in channels if wanted is None or channel.name in wanted] or channels
    clocks = [clock(channel) for channel in asked]
    usual = max(clocks, key=lambda period: (clocks.count(period), -clocks.index(period)))
    chosen = [channel for channel in asked if clock(channel) == usual]
    left_out = {
        channel.name: f"sampled every {clock(channel)} ms, not every {usual} ms"
        for channel in channels
        if clock(channel) != usual
    }
    return chosen, left_out


def _twincat_numbers(
    name: str, text: Text, first: int, separator: str, decimal: str, places: list[int], width: int
) -> tuple[Mapping[int, np.ndarray], np.ndarray]:
    """Return the columns at `places` and the line of each row; rows without any value in these columns are skipped."""
    columns: list[list[float]] = [[] for _ in places]
    lines: list[int] = []
    blocks: list[np.ndarray] = []
    for piece in text.pieces(first):
        for k, line in enumerate(piece.text.split("\n")):
            cells = line.split(separator)
            if not line.strip() or cells[0].strip() == "EOF":
                continue
            here = [cells[place].strip() if place < len(cells) else "" for place in places]
            # A slower or shorter clock continues in this line.
            if not any(here):
                continue
            try:
                numbers = [float(cell.replace(",", ".") if decimal == "," else cell) for cell in here]
            except ValueError:
                where = f"{name}: line {piece.line + k + 1}"
                bad = next(cell for cell in here if not _is_float(cell, decimal))
                if piece.is_last and len(cells) < width:
                    raise LogError(f"{where}: the file is cut off there; remove its last line") from None
                raise LogError(f"{where}: '{bad[:40]}' is not a number; correct or remove that line") from None
            for column, number in zip(columns, numbers, strict=True):
                column.append(number)
            lines.append(piece.line + k)
        blocks.append(np.array(columns))
        columns = [[] for _ in places]
    whole = np.concatenate(blocks, axis=1) if blocks else np.empty((len(places), 0))
    return {place: whole[i] for i, place in enumerate(places)}, np.array(lines, dtype=np.int64)


def _is_float(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(",", ".") if decimal == "," else cell)
    except ValueError:
        return False
    return True


_KLIPPER = re.compile(rb"(?:##[^\n]*\n)?#time,accel_x,accel_y,accel_z[ \t]*\r?\n")
_DUET = re.compile(rb"Sample,Timestamp(?:,[A-Za-z ]+)*,(?:Measured|Target) Motor Steps[,\r\n]")


def is_klipper(content: bytes) -> bool:
    """Return True for the samples that Klipper's ACCELEROMETER_MEASURE writes."""
    return _KLIPPER.match(content) is not None


def read_klipper(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the accelerations of a Klipper log, which are in mm/s². Raise LogError with file and line."""
    columns = read_csv(name, content, wanted)
    units = {column: "s" if column == "time" else "mm/s2" for column in columns.values}
    return replace(columns, format="Klipper accelerometer", units=units)


def is_duet(content: bytes) -> bool:
    """Return True for the samples of a closed-loop driver that Duet's M569.5 writes."""
    return _DUET.match(content) is not None


def read_duet(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the channels of a Duet driver: time in ms with two decimals, motion in full steps of the motor.

    Raise LogError with file and line, also for the line that the firmware writes where samples were lost.
    """
    columns = read_csv(name, content, wanted)
    steps = {column: "steps" for column in columns.values if column.endswith(" Motor Steps")}
    return replace(columns, format="Duet closed loop", units={**columns.units, "Timestamp": "ms", **steps})


RECORDERS: tuple[tuple[Callable[[bytes], bool], Reader], ...] = (
    (is_epos, read_epos),
    (is_twincat, read_twincat),
    (is_halscope, read_halscope),
    (is_halsampler, read_halsampler),
    (is_klipper, read_klipper),
    (is_duet, read_duet),
)
"""Pairs of a test on the first bytes of a file and the reader of that format; the first match reads the file."""
