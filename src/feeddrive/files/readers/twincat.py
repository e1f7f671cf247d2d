"""The text that TwinCAT Scope View exports: a head with one entry for each channel, then times and values by turns.

    Name<tab>Scope1                            the project, its file, start and end of the export
    Name<tab>Axis 1.ActPos<tab>Name<tab>...    one row for each property, its key before each value
    SampleTime[ms]<tab>0,25<tab>SampleTime[ms]<tab>...
    Unit<tab>mm<tab>Unit<tab>...

    0<tab>12,5<tab>0<tab>...                   time in ms (or a FILETIME in 100 ns), value, time, value
    EOF                                        if it was asked for

A time may be shared by the channels that follow it.  The channels of one clock make a log: that of most channels that
are wanted; the others are left out with their sample time.  A FILETIME as a float is exact to 3 us, which the stated
sample time makes good.  The layout is that of Scope View 3.4 and its documentation.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from feeddrive.files.columns import Columns, check_size, unit_of
from feeddrive.files.readers.csv_log import MOST_BYTES, Text, text_of
from feeddrive.language.errors import LogError

_HEAD_BYTES = 2_000_000
_HEAD = re.compile(rb"\s*(?:\xef\xbb\xbf)?\"?Name\"?([\t;,])")
_KEYS = ("SampleTime[ms]", "SymbolComment", "Data-Type", "SymbolName", "VariableSize")
_FILETIME = 1e15  # ticks of 100 ns since 1601; an offset in ms never comes near
_UNITLESS = ("(None)", "None", "")


def is_twincat(content: bytes) -> bool:
    """True for an export of TwinCAT Scope View, by its head."""
    begin = content[:_HEAD_BYTES]
    return _HEAD.match(begin) is not None and b"SampleTime[ms]" in begin


@dataclass
class _Channel:
    """A channel: the columns of its time and its values, and its properties."""

    time: int
    place: int
    name: str
    properties: dict[str, str] = field(default_factory=dict[str, str])


def read_twincat(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """The channels of one clock, with that clock. Raises LogError that names file and line."""
    if len(content) > MOST_BYTES:
        raise LogError(f"{name}: has more than the {MOST_BYTES / 1e6:,.0f} MB of text that are read; export a part")
    head = _HEAD.match(content)
    assert head is not None
    separator = head[1].decode()
    text = text_of(content)
    channels, first = _channels(name, next(text.pieces()).text, separator)
    decimal = "," if separator != "," and _has_comma(text, first) else "."
    chosen, left_out = _one_clock(channels, wanted)
    places = sorted({chosen[0].time, *(channel.place for channel in chosen)})
    found, lines = _numbers(name, text, first, separator, decimal, places, max(c.place for c in channels) + 1)
    check_size(name, len(places), lines.size)
    time, ticks = found[chosen[0].time], 1e-3
    metadata: dict[str, float] = {}
    if time.size and time[0] > _FILETIME:
        time, ticks = time - time[0], 1e-7
        stated = chosen[0].properties.get("SampleTime[ms]", "").replace(",", ".")
        if _is_float(stated, ".") and 0.0 < float(stated) < 1e6:
            metadata["sample_time"] = round(float(stated) * 1e-3, 12)
    values = {"time": time * ticks, **{channel.name: found[channel.place] for channel in chosen}}
    units = {"time": "s"}
    for channel in chosen:
        stated = re.sub(r" *\(.*\)$", "", channel.properties.get("Unit", ""))
        if stated not in _UNITLESS:
            units[channel.name] = unit_of(stated) or stated

    def place(row: int) -> str:
        return f"line {int(lines[row]) + 1}"

    return Columns("TwinCAT Scope", values, units, left_out=left_out, metadata=metadata, place=place)


def _channels(name: str, begin: str, separator: str) -> tuple[list[_Channel], int]:
    """The channels that the head lists, and the line at which the numbers begin."""
    rows = [[cell.strip().strip('"') for cell in line.split(separator)] for line in begin.split("\n")[:200]]
    heads = [k for k, row in enumerate(rows) if row[0] == "Name" and k > 0]
    start = next((k for k in heads if _follows(rows, k)), heads[0] if heads else 0)
    keys = rows[start]
    times = [k for k, cell in enumerate(keys) if cell == "Name"]
    if times[:1] != [0]:
        raise LogError(f"{name}: line {start + 1} is not the row of names of a TwinCAT export; export it again")
    channels: list[_Channel] = []
    for place in range(len(keys)):
        if keys[place] and place not in times:
            label = keys[place]
            while label in {channel.name for channel in channels}:
                label += "_again"
            channels.append(_Channel(max(k for k in times if k < place), place, label))
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
    """True if properties of channels follow a row of names."""
    return any(row[0] in _KEYS for row in rows[k + 1 : k + 4])


def _is_number(cell: str) -> bool:
    return re.fullmatch(r"[+-]?[0-9][0-9.,eE+-]*", cell) is not None


def _has_comma(text: Text, first: int) -> bool:
    """True if the first numbers have a decimal comma."""
    return any("," in line for line in next(text.pieces(first)).text.split("\n")[:2000])


def _one_clock(channels: list[_Channel], wanted: frozenset[str] | None) -> tuple[list[_Channel], dict[str, str]]:
    """The channels of the clock that most wanted channels have, and why the others are left out."""

    def clock(channel: _Channel) -> str:
        return channel.properties.get("SampleTime[ms]", "")

    asked = [channel for channel in channels if wanted is None or channel.name in wanted] or channels
    clocks = [clock(channel) for channel in asked]
    usual = max(clocks, key=lambda each: (clocks.count(each), -clocks.index(each)))
    chosen = [channel for channel in asked if clock(channel) == usual]
    left_out = {
        channel.name: f"sampled every {clock(channel)} ms, not every {usual} ms"
        for channel in channels
        if clock(channel) != usual
    }
    return chosen, left_out


def _numbers(
    name: str, text: Text, first: int, separator: str, decimal: str, places: list[int], width: int
) -> tuple[Mapping[int, np.ndarray], np.ndarray]:
    """The columns at some places, and the line of each row; rows end where the first of them is empty."""
    columns: list[list[float]] = [[] for _ in places]
    lines: list[int] = []
    blocks: list[np.ndarray] = []
    for piece in text.pieces(first):
        for k, line in enumerate(piece.text.split("\n")):
            cells = line.split(separator)
            if not line.strip() or cells[0].strip() == "EOF":
                continue
            here = [cells[place].strip() if place < len(cells) else "" for place in places]
            if not any(here):  # a slower or shorter clock goes on
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
