"""Reading of measured logs: the format is detected from the content; all channels share one clock.

The time stamps must have a uniform sample time, no gap and no backward step. Every error states location and remedy.
"""

import hashlib
import re
import shlex
import tomllib
import zlib
from collections import abc
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from feeddrive.files.atomic_io import read_whole
from feeddrive.files.columns import (
    MOST_BYTES,
    OWN_UNIT,
    ROLES,
    Column,
    Columns,
    Named,
    Reader,
    factor_of,
    is_time,
    most_unpacked,
    unit_at_the_end,
)
from feeddrive.files.log import Log, write_log
from feeddrive.files.mapping import ChannelsSection, LogSection, Mapping
from feeddrive.files.readers import mdf, text_files
from feeddrive.files.readers.arrays import START as _NPY
from feeddrive.files.readers.arrays import read_mat, read_mat73, read_npy
from feeddrive.files.readers.text_files import COUNTER
from feeddrive.files.readers.uff import STARTS as _UFF
from feeddrive.files.readers.uff import read_uff
from feeddrive.files.run_files import read_parquet
from feeddrive.files.section import read_section
from feeddrive.files.toml_file import MOST_BYTES as MOST_TOML_BYTES
from feeddrive.files.toml_file import read_toml
from feeddrive.language import units
from feeddrive.language.errors import LogError, ParameterError, nearest, plain
from feeddrive.language.quantity import Quantity, span
from feeddrive.language.text import Text, joined

# Bytes that gzip unpacks at a time: a decompression bomb is detected at most one piece beyond the limit.
_PIECE = 10_000_000
_LEAST = 256  # bytes that a member of a gzip file is given first
_PAD = 65536  # bytes of zeros between members that are skipped at a time
_HDF5 = b"\x89HDF\r\n\x1a\n"
_PAIR = re.compile(rb"(?:\s*#[^\n]*\n|\s)*(?:\[[^,\n]*\]|[\w.\"'-]+[ \t]*=)")  # how a TOML file begins
_READABLE = "MATLAB (.mat), CSV, Parquet, numpy (.npy), UFF 58, MDF4, also packed by gzip"

# first bytes of files of other kinds, what they are, and what to do
_OTHERS = (
    (b"MDF     ", "an MDF measurement file older than version 4", "export it as MDF4, CSV or MATLAB"),
    (b"UnFinMF ", "an unfinished MDF measurement file", "export it as MDF4, CSV or MATLAB"),
    (b"TDSm", "a TDMS file", "export it as CSV or MATLAB"),
    (b"\x80\x04\x95", "a Python pickle, which could execute code", "save it as CSV or Parquet"),
    (b"\xd0\xcf\x11\xe0", "an old Office file (.xls)", "export the sheet as CSV"),
    (b"PK\x03\x04", "a ZIP archive or an Office file (.xlsx)", "unpack it, or export the sheet as CSV"),
    (b"%PDF", "a PDF", "give the log itself"),
    (b"\x89PNG", "a PNG picture", "give the log itself"),
    (b"\xff\xd8\xff", "a JPEG picture", "give the log itself"),
    (b"\x7fELF", "a program", "give the log itself"),
    (b"MZ", "a Windows program", "give the log itself"),
    (b"SQLite format 3", "an SQLite database", "export the table as CSV"),
    (b"BZh", "packed by bzip2", "unpack it first"),
    (b"\xfd7zXZ", "packed by xz", "unpack it first"),
    (b"7z\xbc\xaf", "a 7z archive", "unpack it first"),
    (b"(\xb5/\xfd", "packed by zstd", "unpack it first"),
    (b"<", "an XML or HTML file", "export the log as CSV"),
    (b"{", "a JSON file", "export the log as CSV"),
)


def read_columns(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the columns of a log of any supported format. Raise LogError for a damaged or unsupported file."""
    content = unpacked(name, content)
    return reader_of(name, content)(name, content, wanted)


class OpenedFile:
    """A measured file, or a log in memory, that is read and parsed only once, even if several functions use it.

    `read_log`, `read_arrays` and `read_frfs` accept it in place of a path. The complete file is parsed.
    """

    def __init__(self, path: str | Path | Log) -> None:
        if isinstance(path, Log):  # the same columns as from its file
            self.path = Path(path.name)
            # begins with bytes that no text file has
            self.content = b"\0" + b"".join(array.tobytes() for array in (path.time, *path.channels.values()))
            self.columns = Columns(
                format="a log in memory",
                values={"time": path.time, **path.channels},
                constants=path.constants,
                units={"time": "s", **path.units},
                left_out=path.left_out,
                metadata={"sample_time": path.sample_time},
            )
        else:
            self.path = Path(path)

    def __str__(self) -> str:
        return str(self.path)

    @cached_property
    def content(self) -> bytes:
        """The bytes of the file. Raises FileError."""
        return read_whole(self.path, MOST_BYTES)

    @cached_property
    def unpacked(self) -> bytes:
        """The content, decompressed if it is compressed with gzip."""
        return unpacked(str(self), self.content)

    @cached_property
    def csv(self) -> Columns:
        """The columns of a CSV file. Raises LogError."""
        return text_files.read_csv(str(self), self.unpacked, None)

    @cached_property
    def columns(self) -> Columns:
        """The columns of a file of any supported format. Raises LogError."""
        reader = reader_of(str(self), self.unpacked)
        # A CSV may be parsed already, by `csv` for its frequency responses.
        return self.csv if reader is text_files.read_csv else reader(str(self), self.unpacked, None)


def reader_of(name: str, content: bytes) -> Reader:
    """Return the reader for the format of the content. Raise LogError for an unsupported format."""
    if content.startswith(b"MATLAB 5.0 MAT-file"):
        return read_mat
    # MATLAB 7.3 writes a block of 512 bytes of its own before the signature of HDF5
    if content.startswith(_HDF5) or content[512:].startswith(_HDF5):
        return read_mat73
    if content.startswith(b"PAR1"):
        return read_parquet
    if content.startswith(mdf.STARTS):
        return mdf.read_mdf
    if content.startswith(_UFF):
        return read_uff
    if content.startswith(_NPY):
        return read_npy
    refuse_others(name, content, _READABLE)
    return _text_reader(content)


def _text_reader(content: bytes) -> Reader:
    """Return the reader of a text file: that of the recorder whose header the file has, otherwise the CSV reader."""
    for fits, reader in text_files.RECORDERS:
        if fits(content):
            return reader
    return text_files.read_csv


def refuse_others(name: str, content: bytes, readable: str) -> None:
    """Raise LogError, naming the kind of file, for a TOML file or a file that is not text."""
    for start, what, advice in _OTHERS:
        if content.startswith(start):
            raise LogError(f"{name}: is {what}, not a log that can be read ({readable}); {advice}")
    if _is_toml(content):
        raise LogError(f"{name}: is a TOML file, not a log that can be read ({readable}); give the log itself")
    # in UTF-16 every ASCII letter has a zero byte
    if not content.startswith((b"\xff\xfe", b"\xfe\xff")) and re.search(rb"[\0-\x08\x0e-\x1f]", content[:65536]):
        raise LogError(f"{name}: is a binary file of an unknown kind; readable are {readable}{_expected(name)}")


def _is_toml(content: bytes) -> bool:
    """Return True for a TOML text, such as a machine file, a job or a column mapping; no table of numbers is TOML."""
    # no TOML file of ours is larger; a table of numbers of that size need not be parsed as TOML first
    if not _PAIR.match(content[:65536]) or len(content) > MOST_TOML_BYTES:
        return False
    try:
        tomllib.loads(content.decode())
    except ValueError:
        # Invalid TOML and invalid UTF-8 both raise subclasses of ValueError.
        return False
    return True


def _expected(name: str) -> str:
    ending = name.rpartition(".")[2].lower()
    return f"; by its name it should be .{ending}: is the copy complete?" if ending in ("mat", "parquet", "csv") else ""


def unpacked(name: str, content: bytes) -> bytes:
    """Return the content, decompressed if compressed with gzip. Raise LogError if it is empty, damaged or too large."""
    if content[:2] == b"\x1f\x8b":
        content = _unpacked(name, content)
    if not content:
        raise LogError(f"{name}: is empty")
    return content


def _unpacked(name: str, content: bytes) -> bytes:
    parts: list[bytes] = []
    size, place = 0, 0
    most = most_unpacked(len(content))
    packed = memoryview(content)
    try:
        while place < len(packed):
            # 31 expects a gzip header; each member is a stream of its own.
            zip_ = zlib.decompressobj(wbits=31)
            # a file may have a million members: each is fed in pieces that grow, so the rest is not copied each time
            piece = _LEAST
            while not zip_.eof:
                fed = zip_.unconsumed_tail
                if not fed:
                    fed = packed[place : place + piece]
                    place += len(fed)
                    piece = min(2 * piece, _PIECE)
                parts.append(zip_.decompress(fed, _PIECE))
                if not fed and not parts[-1] and not zip_.eof:
                    raise LogError(f"{name}: is packed by gzip and cut off; copy it again")
                size += len(parts[-1])
                if size > most:
                    raise LogError(
                        f"{name}: holds more than the {Quantity(most / 1e6, 'MB'):,.0f} that are read, once unpacked"
                    )
            place -= len(zip_.unused_data)
            # tapes and block devices pad the last member with zeros, which gzip skips as well
            while place < len(packed) and packed[place] == 0:
                pad = bytes(packed[place : place + _PAD])
                place += len(pad) - len(pad.lstrip(b"\0"))
    except zlib.error:
        raise LogError(f"{name}: is packed by gzip and damaged; copy it again") from None
    return b"".join(parts)


# names of a constant that is the sampling rate in Hz
_RATES = ("fs", "sampling_rate", "sample_rate", "samplerate", "fsample", "f_s")
# Powers of any number of a log must not overflow, and recorders mark a missing value by 1.8e308.
_LARGEST = 1e30

__all__ = ["ROLES", "Column", "Log", "Named", "read_log", "write_log"]


def read_log(
    path: str | Path | OpenedFile,
    mapping: abc.Mapping[str, Named] | None = None,
    *,
    optional: abc.Mapping[str, Named] | None = None,
    sample_time: float | None = None,
    name: str | None = None,
) -> Log:
    """Read a measured log: MATLAB (5 to 7.3), CSV of any kind, Parquet, numpy, EPOS Studio, halscope and halsampler;
    also compressed with gzip.

    mapping      role -> column, for the roles in `ROLES`; without it every numeric column is a channel in its own
                 unit; a time column with a common name need not be mapped
    optional     role -> column, for columns that may be missing; may be part of a `Mapping`
    sample_time  s, for a file without a time column, or with rounded stamps; may be part of a `Mapping`
    name         the name of the log in errors; default: the name in the file, otherwise the path

    Raises FileError (no such file, ...) or LogError (unsupported format, damaged, empty, NaN, gaps, a non-uniform
    clock, a column that is missing or has a wrong unit), each with file, row and remedy.
    """
    optional = optional or {}
    if isinstance(mapping, Mapping):
        optional = {**mapping.optional, **optional}
        sample_time = mapping.sample_time if sample_time is None else sample_time
    try:
        return _read_log(path, mapping, optional, sample_time, name)
    except LogError as error:
        raise LogError(plain(f"{error}")) from None
    except MemoryError:
        raise LogError(f"{path}: does not fit into the memory; map only the columns that are needed") from None


def read_arrays(path: str | Path | OpenedFile) -> dict[str, np.ndarray]:
    """Read the numeric columns of a file that is not a log over time, such as a cogging map or a friction curve.

    No time column is needed.  Values are those of the file, NaN included; a numpy matrix gives column_1, ...
    Raises FileError or LogError as `read_log` does.
    """
    try:
        file = path if isinstance(path, OpenedFile) else OpenedFile(path)
        return dict(file.columns.values)
    except LogError as error:
        raise LogError(plain(f"{error}")) from None
    except MemoryError:
        raise LogError(f"{path}: does not fit into the memory") from None


def _read_log(
    path: str | Path | OpenedFile,
    mapping: abc.Mapping[str, Named] | None,
    optional: abc.Mapping[str, Named],
    sample_time: float | None,
    name: str | None,
) -> Log:
    where = str(path)
    if sample_time is not None and not (np.isfinite(sample_time) and sample_time > 0.0):
        raise ParameterError(f"{where}: sample_time = {Quantity(sample_time, 's'):6 SI} must be > 0 s")
    mapped = None if mapping is None else {role: _column(where, role, column) for role, column in mapping.items()}
    extra = {role: _column(where, role, column) for role, column in optional.items()}
    if isinstance(path, OpenedFile):
        content, columns = path.content, path.columns
    else:
        content = read_whole(path, MOST_BYTES)
        wanted = None if mapped is None else frozenset(column.name for column in (*mapped.values(), *extra.values()))
        columns = read_columns(where, content, wanted)
    there = {*columns.values, *columns.left_out}
    asked = {role: column for role, column in extra.items() if column.name in there} | (mapped or {})
    chosen = _chosen(columns, asked, everything=mapped is None)
    values = {role: _values(where, columns, role, column, asked) for role, column in chosen.items()}
    recorded = values.pop("time", None)
    channels = {role: numbers for role, (numbers, _) in values.items()}
    stored = columns.metadata.get("sample_time")
    step = stored if sample_time is None and isinstance(stored, float) else sample_time
    counter = str(columns.metadata.get("counter", ""))
    told = ""
    if recorded is not None:
        time, told = _scaled_by_rate(columns, chosen["time"], recorded[0])
    elif counter in columns.values and step is not None:
        # Exact stamps: a jump of the counter is then found as a gap.
        time, step = step * (columns.values[counter] - columns.values[counter][0]), None
        channels.pop(counter, None)
    else:
        time = _stamps(where, columns, channels, step)
    left_out = dict(columns.left_out)
    for role, numbers in list(channels.items()):
        if numbers.size != time.size:
            if role in asked:
                raise LogError(
                    f"{where}: column '{chosen[role].name}' has {numbers.size} rows, that of time {time.size}"
                )
            left_out[role] = f"{numbers.size} rows long, not {time.size}"
            del channels[role]
    column = chosen["time"].name if "time" in chosen else "t"
    clock = checked_clock(where, time, columns.place, step, column)
    origin = columns.metadata.get("provenance")
    return Log(
        name=name or str(columns.metadata.get("name") or where),
        time=time,
        channels=channels,
        units={role: values[role][1] for role in channels},
        sample_time=clock.sample_time,
        jitter=clock.jitter,
        constants=columns.constants,
        left_out=left_out,
        provenance={
            "file": where,
            "sha256": hashlib.sha256(content).hexdigest(),
            "format": columns.format,
            **({"time": told} if told else {}),
            **({"clock": "given"} if sample_time is not None else {}),
            **({"origin": origin} if origin else {}),
        },
    )


def _column(path: str, role: str, named: Named) -> Column:
    """Convert any short form of a column to a checked Column. Raise ParameterError as `Column.checked` does."""
    match named:
        case Column():
            column = named
        case str():
            column = Column(name=named)
        case (name, str(unit)):
            column = Column(name=name, unit=unit)
        case (name, factor):
            column = Column(name=name, factor=float(factor))
    try:
        return column.checked(role)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def _chosen(columns: Columns, asked: abc.Mapping[str, Column], *, everything: bool) -> dict[str, Column]:
    """Return the mapped columns, a time column recognized by its name, and with `everything` all other columns."""
    chosen = dict(asked)
    time = next((name for name in columns.values if is_time(name)), None)
    if "time" not in chosen and time is not None:
        chosen = {"time": Column(name=time), **chosen}
    if everything:
        taken = {column.name for column in chosen.values()}
        chosen |= {name: Column(name=name) for name in columns.values if name not in taken}
    return chosen


def _values(
    path: str, columns: Columns, role: str, column: Column, asked: abc.Mapping[str, Column]
) -> tuple[np.ndarray, str]:
    """Return the values of a column, and their unit: that of the role, otherwise of the file. Raise LogError if
    invalid.
    """
    numbers = columns.values.get(column.name)
    if numbers is None:
        if column.name in columns.left_out:
            why = columns.left_out[column.name]
            raise LogError(f"{path}: column '{column.name}' ({role}) is not numbers but {why}")
        known = [*columns.values, *columns.unread, *columns.constants]
        raise LogError(f"{path}: there is no column '{column.name}' ({role}){nearest(column.name, known)}")
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        place = columns.place(int(bad[0]))
        raise LogError(
            f"{path}: column '{column.name}' is {numbers[bad[0]]} at {place} ({bad.size} such rows); "
            "cut the log there, repair the row, or map only the columns that are needed"
        )
    if numbers.size and max(float(numbers.max()), -float(numbers.min())) > _LARGEST:
        k = int(np.argmax(np.abs(numbers)))
        raise LogError(
            f"{path}: column '{column.name}' reaches {Quantity(numbers[k]):3} at {columns.place(k)}, beyond "
            f"{Quantity(_LARGEST)}, as no measured quantity does: look at exponents and decimal mark, cut the log "
            "there, or map only the columns that are needed"
        )
    unit = columns.units.get(column.name, "")
    # Without a mapping a channel keeps the unit of its file; only time must be in seconds.
    as_it_is = role != "time" and role not in asked
    factor = 1.0 if as_it_is else factor_of(path, role, column, unit)
    held = numbers if factor == 1.0 else numbers * factor
    # Columns may be shared by several logs of one opened file.
    held.flags.writeable = False
    if as_it_is or (role in OWN_UNIT and not column.unit):
        return held, unit if column.factor is None else ""
    return held, column.unit if role in OWN_UNIT else ROLES[role]


def _scaled_by_rate(columns: Columns, column: Column, time: np.ndarray) -> tuple[np.ndarray, str]:
    """Convert stamps without a unit to s with the sampling rate stated in the file; also return a note on the unit."""
    if column.unit or column.factor is not None or columns.units.get(column.name) or "_" in column.name:
        return time, ""
    rates = {name: value for name, value in columns.constants.items() if name.lower() in _RATES and value > 0.0}
    if not rates or time.size < 2:
        return time, ""
    name, rate = next(iter(rates.items()))
    usual = float(np.median(np.diff(time)))
    # Only a unit that agrees with the stated rate to a thousandth is accepted, so that nothing is guessed.
    for unit in ("ms", "us", "ns"):
        size = units.factor(unit, "s")
        if abs(usual * size * rate - 1.0) < 1e-3:
            return time * size, Text(f"in {unit}, by {name} = {Quantity(rate, 'Hz'):6} in the file")
    return time, ""


def _stamps(
    path: str, columns: Columns, channels: abc.Mapping[str, np.ndarray], sample_time: float | None
) -> np.ndarray:
    """Return uniform stamps, s, for a file without a time column. Raise LogError if sample time or rows are missing."""
    rows = max((numbers.size for numbers in channels.values()), default=0)
    left = "".join(f"; '{name[:40]}' is {why}" for name, why in list(columns.left_out.items())[:5])
    if rows == 0:
        raise LogError(f"{path}: holds no column of numbers{left}")
    if sample_time is None:
        names = ", ".join(name[:40] for name in list(columns.values)[:12])
        raise LogError(
            f"{path}: has no column of time among {names}{left}; {_clock_of(columns)}"
            f"give the sample time in s, as --sample-time 0.001{_as_frequencies(columns)}"
        )
    return sample_time * np.arange(rows, dtype=np.float64)


def _clock_of(columns: Columns) -> str:
    """Return a hint on how to provide the time of a file that has none, as part of an error message."""
    if columns.format == "halsampler":
        numbers = (
            "" if COUNTER not in columns.values else "the numbers of the samples are there, but not their period: "
        )
        return f"halsampler writes no clock; {numbers}it is the period of the thread that the sampler runs in: "
    return "name it, as in  time = { column = 'x', unit = 'ms' }, or "


def _as_frequencies(columns: Columns) -> str:
    """Return a hint if the table may be a frequency response: its first column is non-negative and increasing."""
    first = next(iter(columns.values.values()), None)
    if first is None or first.size < LEAST_ROWS or first[0] < 0.0 or not np.all(np.diff(first) > 0.0):
        return ""
    name = next(iter(columns.values))
    return f"; if '{name}' holds frequencies, this is a frequency response: head its columns f_Hz,re,im"


LEAST_ROWS = 3
JITTER = 0.1  # of the sample time: the most by which a step may differ from it
GAP = 1.5  # of the sample time: a longer step has lost a sample
_BLOCK = 100_000  # rows that are processed together
_SLOWEST, _FASTEST = 0.5, 1e-7  # s; a servo log outside is one in another unit


@dataclass(frozen=True)
class Clock:
    """The sample time (s), and the largest deviation of a step from it as a fraction of the sample time."""

    sample_time: float
    jitter: float


def checked_clock(
    name: str, time: np.ndarray, place: Callable[[int], str], sample_time: float | None = None, column: str = "t"
) -> Clock:
    """Check that stamps in s, shape (n,), are uniform, and return their clock.

    With a `sample_time`, the stamps may be rounded, as long as every one is off by less than half a sample.
    `column` is the name of the column of the stamps, for the remedy.
    Raises LogError with the file, the first bad row, its stamps and the remedy.
    """
    if time.size < LEAST_ROWS:
        raise LogError(f"{name}: has {time.size} row{'s' * (time.size != 1)}; a log needs at least {LEAST_ROWS}")
    if sample_time is not None:
        return _fitted(name, time, place, sample_time, column)
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0.0)
    if back.size:
        k = int(back[0])
        what = "stands still" if steps[k] == 0.0 else "runs backward"
        raise LogError(
            f"{name}: time {what} at {place(k + 1)}: {Quantity(time[k], 's'):9 SI} is followed by "
            f"{Quantity(time[k + 1], 's'):9 SI} ({back.size} such rows); remove the repeated rows, or give the sample "
            "time if the stamps are only rounded"
        )
    if _grow(time):
        raise LogError(
            f"{name}: the stamps grow by a constant factor, {Quantity(time[1] / time[0])} from row to row, as "
            "frequencies do: a frequency response is read if its columns are headed f_Hz,re,im"
        )
    # the median, which a long gap does not move
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps > GAP * usual)
    if gaps.size:
        k = int(gaps[0])
        raise LogError(
            f"{name}: a gap lies before {place(k + 1)}: {Quantity(time[k], 's'):9 SI} is followed by "
            f"{Quantity(time[k + 1], 's'):9 SI}, where the step is {Quantity(usual, 's'):6 SI} ({gaps.size} such "
            "rows); cut the log there, or record it again without loss"
        )
    # Over the whole log: rounding of single stamps cancels, unlike in the median.
    mean = float(time[-1] - time[0]) / (time.size - 1)
    # In place, since logs are large.
    deviation = np.divide(steps, mean, out=steps)
    np.abs(np.subtract(deviation, 1.0, out=deviation), out=deviation)
    worst = int(np.argmax(deviation))
    if deviation[worst] > JITTER:
        k = int(np.argmax(deviation > JITTER))
        raise LogError(
            f"{name}: the clock is not uniform: the step to {place(k + 1)} is "
            f"{Quantity(time[k + 1] - time[k], 's'):6 SI}, the mean {Quantity(mean, 's'):6 SI}; resample the log to a "
            "uniform clock, or give the sample time if the stamps are only rounded"
        )
    _check_plausible(name, mean, column)
    largest = float(deviation[worst])
    del deviation, steps
    return Clock(_decimal(mean, time), largest)


def _grow(time: np.ndarray) -> bool:
    """Return True if the stamps are logarithmically spaced over at least an octave, as frequencies are."""
    if time.size < 10 or not time[0] > 0.0 or time[-1] < 2.0 * time[0]:
        return False
    ratio = np.diff(np.log(time))
    return bool(np.ptp(ratio) < 0.1 * np.mean(ratio))


def _fitted(name: str, time: np.ndarray, place: Callable[[int], str], sample_time: float, column: str) -> Clock:
    _check_plausible(name, sample_time, column)
    off = (time - time[0]) / sample_time - np.arange(time.size)
    # from half a sample on, a stamp belongs to the row before or behind
    bad = np.flatnonzero(np.abs(off) >= 0.5)
    if bad.size:
        k = int(bad[0])
        raise LogError(
            f"{name}: with a sample time of {Quantity(sample_time, 's'):6 SI}, {place(k)} should be at "
            f"{Quantity(time[0] + k * sample_time, 's'):9 SI}, not at {Quantity(time[k], 's'):9 SI}; give the right "
            "sample time, or cut the log there"
        )
    return Clock(units.decimal(sample_time), float(np.max(np.abs(np.diff(off)))))


def _check_plausible(name: str, sample_time: float, column: str) -> None:
    if not _FASTEST <= sample_time <= _SLOWEST:
        read = [Text(f"{unit} ({Quantity(step, 's')})") for unit, step in time_units(sample_time)]
        likely = f"; likeliest are {joined(' and ', read)} from one row to the next" if read else ""
        unit = read[0].partition(" ")[0] if read else "ms"
        raise LogError(
            f"{name}: a sample time of {Quantity(sample_time, 's'):6 SI} is not one of a servo loop, "
            f"{span(_FASTEST, _SLOWEST, 's', '6 SI')}; is the time in "
            f"another unit{likely}? Then state it: --time {shlex.quote(f'{column}:{unit}')}, or  "
            f"time = {{ column = '{column}', unit = '{unit}' }}"
        )


def time_units(step: float) -> list[tuple[str, float]]:
    """Return up to two units in which the step is a plausible servo sample time, with the step in s, likeliest first.

    A step near 1 ms is the likeliest, since whole milliseconds are the most common sample times.
    """
    read = [(unit, step * units.factor(unit, "s")) for unit in ("s", "ms", "us", "ns")]
    inside = [candidate for candidate in read if _FASTEST <= candidate[1] <= _SLOWEST]
    return sorted(inside, key=lambda candidate: abs(np.log(candidate[1] / 1e-3)))[:2]


def _decimal(mean: float, time: np.ndarray) -> float:
    """Round the mean step to the fewest digits that fit the stamps equally well: 0.001, not 0.0010000000000002."""
    n = time.size
    scatter = max(
        float(np.max(np.abs(time[k : k + _BLOCK] - time[0] - mean * np.arange(k, min(k + _BLOCK, n)))))
        for k in range(0, n, _BLOCK)
    )
    for digits in range(1, 12):
        near = units.rounded(mean, digits)
        # The error accumulated at the last stamp must not exceed the scatter of the stamps.
        if abs(near - mean) * (n - 1) <= scatter + 1e-9 * mean * n:
            return near
    return units.decimal(mean)


@dataclass(frozen=True)
class LogRequest:
    """The log to read, the roles of its columns, and the number of samples to skip at its start."""

    path: Path
    mapping: Mapping
    skip_samples: int = 0

    def read(self) -> Log:
        """Read the log, including the optional channels that are present.

        Raises FileError or LogError as `read_log` does, and LogError for an injected force without a unit.
        """
        file = OpenedFile(self.path)
        log = read_log(file, self.mapping)
        named = self.named("load_force")
        told = named is None or named.unit or named.factor is not None or file.columns.units.get(named.name)
        if named is None or told or "load_force" not in log.channels or unit_at_the_end(named.name, "load_force"):
            return log
        raise LogError(
            f"{self.path}: '{named.name}' (load_force) states no unit, and injected signals are logged in N, in V or "
            f"in percent: state it, as load_force = {{ column = '{named.name}', unit = 'N' }}, or give factor = the N "
            f"at the table for each unit of it; a signal that is added to the drive's command, in the command's unit, "
            f"is excitation = '{named.name}'"
        )

    def named(self, role: str) -> Column | None:
        """Return the column of a role, mandatory or optional; None if no column has this role."""
        return self.mapping.get(role) or self.mapping.optional.get(role)


def read_request(path: str | Path, log: str | Path | None = None) -> LogRequest:
    """Read the roles of a log's columns from the section [log] of a job or of the output of `Guess.toml`.

    `log` replaces the log file named there.  Raises FileError or ParameterError with file, line, key and remedy.
    """
    root = read_toml(path).root()
    if root.optional("log") is None:
        raise root.error("section [log] is missing; print(guess_roles(read_log(file)).toml()) shows one")
    return log_request(read_section(ChannelsSection, root).log, Path(path), log)


def log_request(section: LogSection, place: Path, log: str | Path | None) -> LogRequest:
    """Return the log request from a section of the file `place`; `log` replaces the log file named there."""
    if log is None and section.file is None:
        raise section.error('log.file is missing: file = "run.csv", or give the log on the command line')
    path = Path(log) if log is not None else place.parent / str(section.file)
    return LogRequest(path, section.mapping, section.skip_samples)
