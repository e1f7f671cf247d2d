"""Selection of the reader of a log by the content of the file; its extension only appears in error messages."""

from __future__ import annotations

import re
import tomllib
import zlib
from collections.abc import Callable
from functools import cached_property
from pathlib import Path

from feeddrive.files.atomic_io import read_whole
from feeddrive.files.columns import MOST_BYTES, Columns, Reader, most_unpacked
from feeddrive.files.log import Log
from feeddrive.files.readers import mdf
from feeddrive.files.readers.arrays import START as _NPY
from feeddrive.files.readers.arrays import read_mat, read_npy
from feeddrive.files.readers.csv_text import read_csv
from feeddrive.files.readers.hdf5 import read_mat73
from feeddrive.files.readers.recorders import (
    is_epos,
    is_halsampler,
    is_halscope,
    is_twincat,
    read_epos,
    read_halsampler,
    read_halscope,
    read_twincat,
)
from feeddrive.files.readers.uff import STARTS as _UFF
from feeddrive.files.readers.uff import read_uff
from feeddrive.files.run_files import read_parquet
from feeddrive.language.errors import LogError
from feeddrive.language.quantity import Quantity

_PIECE = 10_000_000  # bytes that gzip unpacks at a time: a decompression bomb is detected one piece beyond the limit
_LEAST = 256  # bytes that a member of a gzip file is given first
_PAD = 65536  # bytes of zeros between members that are skipped at a time
_HDF5 = b"\x89HDF\r\n\x1a\n"
_MOST_TOML = 4_000_000  # bytes; no TOML file of ours is larger
_PAIR = re.compile(rb"(?:\s*#[^\n]*\n|\s)*(?:\[[^,\n]*\]|[\w.\"'-]+[ \t]*=)")  # how a TOML file begins
_READABLE = "MATLAB (.mat), CSV, Parquet, numpy (.npy), UFF 58, MDF4, also packed by gzip"

# text formats that have a header of their own
_TEXTS: tuple[tuple[Callable[[bytes], bool], Reader], ...] = (
    (is_epos, read_epos),
    (is_twincat, read_twincat),
    (is_halscope, read_halscope),
    (is_halsampler, read_halsampler),
)

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
    """Read the columns of a log of any known format. Raise LogError for a damaged file and one of another kind."""
    content = unpacked(name, content)
    return reader_of(name, content)(name, content, wanted)


class OpenedFile:
    """A measured file that several functions use: it is read and parsed once; or a log that was read.

    `read_log`, `read_arrays` and `read_frfs` take it in place of a path. The complete file is parsed.
    """

    def __init__(self, path: str | Path | Log) -> None:
        if isinstance(path, Log):  # as its file would have them
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
        """The content, unpacked if it is packed by gzip."""
        return unpacked(str(self), self.content)

    @cached_property
    def csv(self) -> Columns:
        """The columns of a CSV. Raises LogError."""
        return read_csv(str(self), self.unpacked, None)

    @cached_property
    def columns(self) -> Columns:
        """The columns of a file of any known format. Raises LogError."""
        reader = reader_of(str(self), self.unpacked)
        return self.csv if reader is read_csv else reader(str(self), self.unpacked, None)


def reader_of(name: str, content: bytes) -> Reader:
    """Return the reader of a content. Raise LogError for a file of another kind."""
    if content.startswith(b"MATLAB 5.0 MAT-file"):
        return read_mat
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
    """Return the reader of a text: that of the maker whose header it has, else that of CSV."""
    for fits, reader in _TEXTS:
        if fits(content):
            return reader
    return read_csv


def refuse_others(name: str, content: bytes, readable: str) -> None:
    """Raise LogError, with the kind, for a file of a kind that is not text."""
    for start, what, advice in _OTHERS:
        if content.startswith(start):
            raise LogError(f"{name}: is {what}, not a log that can be read ({readable}); {advice}")
    if _is_toml(content):
        raise LogError(f"{name}: is a TOML file, not a log that can be read ({readable}); give the log itself")
    if not content.startswith((b"\xff\xfe", b"\xfe\xff")) and re.search(rb"[\0-\x08\x0e-\x1f]", content[:65536]):
        raise LogError(f"{name}: is a binary file of an unknown kind; readable are {readable}{_expected(name)}")


def _is_toml(content: bytes) -> bool:
    """Return True if a text is TOML: a machine file, a job, a mapping of columns. A table of numbers never is."""
    if not _PAIR.match(content[:65536]) or len(content) > _MOST_TOML:
        return False
    try:
        tomllib.loads(content.decode())
    except ValueError:  # no TOML, no UTF-8
        return False
    return True


def _expected(name: str) -> str:
    ending = name.rpartition(".")[2].lower()
    return f"; by its name it should be .{ending}: is the copy complete?" if ending in ("mat", "parquet", "csv") else ""


def unpacked(name: str, content: bytes) -> bytes:
    """Return the content, unpacked if packed by gzip. Raise LogError if it is empty, damaged or too large."""
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
            while place < len(packed) and packed[place] == 0:
                pad = bytes(packed[place : place + _PAD])
                place += len(pad) - len(pad.lstrip(b"\0"))
    except zlib.error:
        raise LogError(f"{name}: is packed by gzip and damaged; copy it again") from None
    return b"".join(parts)
