"""Text files of recorders: maxon EPOS Studio, LinuxCNC's halscope and halsampler, TwinCAT Scope View.

EPOS Studio states sampling period and number of rows, which are checked.  Torque is in percent of the motor's nominal
torque, current in mA, position in counts.

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

halsampler prints six decimals: positions in mm are then exact to a nanometer, small signals in SI are coarse.  It
writes `overrun` where samples were lost.

TwinCAT Scope View (3.4 and its documentation) has a header with one entry for each channel, then alternating times and
values:

    Name<tab>Scope1                            the project, its file, start and end of the export
    Name<tab>Axis 1.ActPos<tab>Name<tab>...    one row for each property, its key before each value
    SampleTime[ms]<tab>0,25<tab>SampleTime[ms]<tab>...
    Unit<tab>mm<tab>Unit<tab>...

    0<tab>12,5<tab>0<tab>...                   time in ms (or a FILETIME in 100 ns), value, time, value
    EOF                                        optional

A time column may be shared by the channels that follow it.  A log contains the channels of one clock, that of most of
the wanted channels; the others are left out with their sample time.  A FILETIME as a float is exact to 3 us, which the
stated sample time compensates.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from feeddrive.files.columns import Columns, check_size, free_name, unit_of
from feeddrive.files.readers.csv_text import MOST_BYTES, Text, read_csv, text_of
from feeddrive.language.errors import LogError
from feeddrive.language.quantity import Quantity

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
    seconds = 0.0 if period is None else round(float(period[1].replace(b",", b".")) * 1e-3, 12)
    left_out = {
        **columns.left_out,
        **({"after the last channel": f"remarks in {written} row{'s' * (written != 1)}"} if written else {}),
    }
    metadata = {"sample_time": seconds} if seconds > 0.0 else {}
    return replace(columns, format="EPOS Studio", left_out=left_out, metadata=metadata)


def _without_remarks(content: bytes) -> tuple[bytes, int]:
    """Strip remarks after the last channel; return the recording and the number of rows with such a remark.

    Spreadsheet programs pad all lines to the longest one (`-24.1,,`), with a remark in some of them.
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
    """Cut a header line to its first cells; the last one ends at a comma."""
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
    """Return the names in the first line of a log written before 2.9. Raise LogError for a repeated name."""
    line = next((line for line in body.split(b"\n", 100) if line.strip()), b"")
    names = line.decode("utf-8", "replace").split()[::2]
    if len(set(names)) != len(names):
        raise LogError(f"{name}: records '{max(names, key=names.count)[:40]}' twice; record each channel once")
    return names


def read_halsampler(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the pins of a halsampler log as column_1, column_2, ...; sample numbers, if present, are the clock.

    `overrun` before the first line means no loss within the log; elsewhere it is an error with its line.
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
    """Return True for sample numbers: increasing whole numbers, most of them by one."""
    steps = np.diff(numbers)
    return bool(
        steps.size >= 2 and np.all(numbers == np.floor(numbers)) and np.all(steps >= 1) and np.median(steps) == 1.0
    )


_TWINCAT_HEAD_BYTES = 2_000_000
_TWINCAT_HEAD = re.compile(rb"\s*(?:\xef\xbb\xbf)?\"?Name\"?([\t;,])")
_TWINCAT_KEYS = ("SampleTime[ms]", "SymbolComment", "Data-Type", "SymbolName", "VariableSize")
_FILETIME = 1e15  # ticks of 100 ns since 1601; an offset in ms never comes near
_UNITLESS = ("(None)", "None", "")


def is_twincat(content: bytes) -> bool:
    """Return True for an export of TwinCAT Scope View, judged by its header."""
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
    """Read the channels of one clock of a TwinCAT export, with that clock. Raise LogError with file and line."""
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
    """Return True if rows of channel properties follow row `k`."""
    return any(row[0] in _TWINCAT_KEYS for row in rows[k + 1 : k + 4])


def _is_number(cell: str) -> bool:
    return re.fullmatch(r"[+-]?[0-9][0-9.,eE+-]*", cell) is not None


def _has_comma(text: Text, first: int) -> bool:
    """Return True if the first numbers have a decimal comma."""
    return any("," in line for line in next(text.pieces(first)).text.split("\n")[:2000])


def _one_clock(
    channels: list[_TwincatChannel], wanted: frozenset[str] | None
) -> tuple[list[_TwincatChannel], dict[str, str]]:
    """Return the channels on the clock of most wanted channels, and the reason for each omitted channel."""

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
    """Return the columns at some places, and the line number of each row; rows without a value there are skipped."""
    columns: list[list[float]] = [[] for _ in places]
    lines: list[int] = []
    blocks: list[np.ndarray] = []
    for piece in text.pieces(first):
        for k, line in enumerate(piece.text.split("\n")):
            cells = line.split(separator)
            if not line.strip() or cells[0].strip() == "EOF":
                continue
            here = [cells[place].strip() if place < len(cells) else "" for place in places]
            if not any(here):  # a slower or shorter clock continues
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
