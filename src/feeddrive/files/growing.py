"""Text tables that grow while they are read: a log that is being written, or rows from a pipe.

    rows = GrowingTable(GrowingFile("run.csv"))
    rows.take()     # first all existing rows, then the rows added since

Only complete lines are read.  A file that is truncated, rewritten or replaced is read from its start; while a file
does not exist, there are no rows.  A file is opened for each read and closed again, so that its writer may
rename it.
"""

from __future__ import annotations

import os
import stat
import threading
import time as clock
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple, Protocol

import numpy as np

from feeddrive.analysis.oscilloscope import Rows
from feeddrive.files.atomic_io import refusal
from feeddrive.files.columns import Column, factor_of, is_time
from feeddrive.files.names import unit_in_name
from feeddrive.files.read_log import reader_of
from feeddrive.files.readers import text_files
from feeddrive.files.readers.text_files import CsvLayout
from feeddrive.language.errors import FileError, LogError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

HEAD = 64_000  # bytes at the start that contain headers and first rows
FIRST = 8_000_000  # bytes of a long file that are read at first, from its end
_MARK = 64  # bytes before the read position, by which a rewritten file is recognized
_LONGEST = 1_000_000  # bytes of a line
_LEAST = 3  # rows needed to detect a layout
_SILENT = 1.0  # s without rows, after which the state reports it
_MOST = 16_000_000  # bytes of a pipe that are kept for its readers


class Grown(NamedTuple):
    """The bytes received since the last read.

    begins  True if they are the first bytes of the file or pipe
    anew    True if the file has started over, so that earlier bytes are obsolete
    ended   True if no more bytes will follow
    """

    content: bytes
    begins: bool = False
    anew: bool = False
    ended: bool = False


class GrowingBytes(Protocol):
    """A byte stream that grows at its end."""

    name: str

    def head(self) -> bytes:
        """Return the first `HEAD` bytes, or fewer if not as many are available."""
        ...

    def read(self) -> Grown:
        """Return the bytes received since the last call. Raise FileError."""
        ...

    def waits(self) -> str:
        """Return a status message as long as the stream is empty, otherwise an empty string."""
        ...


class GrowingFile:
    """A file to which another program is appending.

    inside  folder that must contain the file after resolving symbolic links; None: no restriction
    """

    def __init__(self, path: str | Path, inside: Path | None = None) -> None:
        self.path, self.name, self._inside = Path(path), str(path), inside
        self._at, self._mark, self._which, self._written = 0, b"", (0, 0), 0
        self._head = b""
        self._begun = False
        self._missing = False

    def head(self) -> bytes:
        """Return the first bytes of the file as it was at the last `read`."""
        return self._head

    def waits(self) -> str:
        """Return a message if the file does not exist, otherwise an empty string."""
        return "waits for the file: it is not there" if self._missing else ""

    def read(self) -> Grown:
        """Read the new bytes. The first call reads at most the last `FIRST` bytes, from the start of a line."""
        try:
            if self._inside is not None and not Path(os.path.realpath(self.path)).is_relative_to(
                os.path.realpath(self._inside)
            ):
                raise FileError(f"{self.name}: leads out of {self._inside}: name it on the command line (--follow)")
            status = os.stat(self.path)
            if not stat.S_ISREG(status.st_mode):
                raise FileError(f"{self.name}: is no file that grows, but a directory, a device or a pipe")
            self._missing = False
            # Without a change, neither size nor time of writing differ, and the file need not be opened.
            same = (status.st_dev, status.st_ino) == self._which and status.st_size == self._at
            if same and status.st_mtime_ns == self._written:
                return Grown(b"")
            # closed again at once: Windows does not rename a file that is open
            with self.path.open("rb") as file:
                return self._more(file)
        except FileNotFoundError:
            self._missing = True
            return Grown(b"")
        except OSError as error:
            raise refusal(self.name, "read", error) from None

    def _more(self, file: BinaryIO) -> Grown:
        status = os.fstat(file.fileno())
        which = status.st_dev, status.st_ino
        file.seek(max(0, self._at - len(self._mark)))
        # a file that was written anew may have the same inode and be longer: only the bytes read last identify it
        anew = which != self._which or status.st_size < self._at or file.read(len(self._mark)) != self._mark
        self._written, self._which = status.st_mtime_ns, which
        skip = b""
        if anew:
            file.seek(0)
            self._head = file.read(HEAD)
            self._at = max(0, status.st_size - FIRST)
            file.seek(self._at)
            if self._at:
                skip = file.readline(_LONGEST)
        elif len(self._head) < HEAD:
            file.seek(0)
            self._head = file.read(HEAD)
            file.seek(self._at)
        content = file.read(FIRST)
        self._at += len(skip) + len(content)
        # After a restart the mark must not contain bytes of the earlier file.
        self._mark = (self._mark + content)[-_MARK:] if not anew else (skip + content)[-_MARK:]
        begun, self._begun = self._begun, True
        return Grown(content, anew and self._at == len(content), anew and begun)


class Pipe:
    """The bytes received through a pipe, as in `halsampler -t | feeddrive studio --follow -`.

    One thread reads the pipe and keeps at least its last `_MOST` bytes for all followers.
    """

    def __init__(self, stream: BinaryIO, name: str = "-") -> None:
        self.name = name
        self._stream, self._lock = stream, threading.Lock()
        self._content, self._begin, self.ended = bytearray(), 0, False
        self.first = b""
        # A daemon, since a blocked read of the pipe must not keep the program from ending.
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        try:
            # Not through the buffer of the stream, which stays locked while it waits for bytes.
            while piece := os.read(self._stream.fileno(), 65536):
                with self._lock:
                    self.first = (self.first + piece)[:HEAD] if len(self.first) < HEAD else self.first
                    self._content += piece
                    # Cut only at twice the size: removing the start of a bytearray for every piece would copy all the
                    # rest.
                    if len(self._content) > 2 * _MOST:
                        gone = len(self._content) - _MOST
                        del self._content[:gone]
                        self._begin += gone
        # a broken pipe, or a stream that was closed meanwhile: what came before can still be read
        except (OSError, ValueError):
            pass
        self.ended = True

    def since(self, at: int) -> tuple[bytes, int, bool]:
        """Return the bytes from offset `at` on, the offset of their end, and True if some were already discarded."""
        with self._lock:
            begin = max(at, self._begin)
            # A copy, since the thread goes on changing the buffer.
            return bytes(self._content[begin - self._begin :]), self._begin + len(self._content), begin > at

    def follower(self) -> PipeFollower:
        """Return a new reader of the pipe with its own read position."""
        return PipeFollower(self)


class PipeFollower:
    """A reader of a pipe, independent of its other readers."""

    def __init__(self, pipe: Pipe) -> None:
        self._pipe, self._at, self.name = pipe, 0, pipe.name

    def head(self) -> bytes:
        """Return the first bytes of the pipe."""
        return self._pipe.first

    def waits(self) -> str:
        """Return a message while no bytes have been received, otherwise an empty string."""
        return "" if self._pipe.first else "waits for rows from the pipe"

    def read(self) -> Grown:
        """Read the new bytes; if unread bytes were already discarded, start at the next complete line."""
        ended, begins = self._pipe.ended, self._at == 0
        content, self._at, lost = self._pipe.since(self._at)
        return Grown(content.partition(b"\n")[2] if lost else content, begins and not lost, False, ended)


class GrowingTable:
    """The rows of a growing text table: CSV of any kind, or halsampler output. See `LiveSource`.

    sample_time  sample time of a table without a time column, s; None: time is counted in samples
    time_unit    unit of a time column that states none; None: s

    Invalid lines are skipped and counted.  An `overrun` line of halsampler marks a gap; the sample numbers in its
    output serve as the time base.
    """

    def __init__(
        self, content: GrowingBytes, *, sample_time: float | None = None, time_unit: str | None = None
    ) -> None:
        self.name, self._content = content.name, content
        self.channels: Mapping[str, str] = {}
        self.clock = "s"
        self._sample_time, self._time_unit = sample_time, time_unit
        self._layout: CsvLayout | None = None
        self._rest = b""
        self._anew = self.over = self._from_begin = False
        self._count = self._wrong = self._gaps = 0
        self._last_wrong = ""
        self._heard = clock.monotonic()

    def take(self) -> Rows:
        """Return the new rows. Raise LogError if the content is not a table, FileError if the stream cannot be read."""
        grown = self._content.read()
        self.over = grown.ended
        if grown.anew:
            self._rest, self._layout, self._anew = b"", None, True
            self._count = self._gaps = 0
        if grown.begins or grown.anew:
            self._from_begin = grown.begins
        self._rest += grown.content
        # a binary stream without line ends would be gathered without limit
        if len(self._rest) > _LONGEST and b"\n" not in self._rest[-_LONGEST:]:
            raise LogError(
                f"{self.name}: has a line of more than {Quantity(_LONGEST / 1e6, 'MB')}; it is no table of rows"
            )
        if self._layout is None and not self._understand():
            return Rows(np.empty(0), np.empty((0, len(self.channels))))
        # The last line may be incomplete: it stays until its end has been written.
        whole, line, self._rest = self._rest.rpartition(b"\n")
        rows = self._parsed((whole + line).decode(self._encoding, "replace").replace("\r", ""))
        if rows.time.size:
            self._heard, self._anew = clock.monotonic(), False
        return rows

    def state(self) -> str:
        """Describe the state: number of rows, time without new rows, and skipped lines."""
        waiting = self._content.waits()
        if waiting:
            return waiting
        if self.over:
            text = "the pipe has ended"
        elif self._layout is None:
            text = f"waits for {_LEAST} rows of numbers"
        else:
            silent = clock.monotonic() - self._heard
            text = Text(f"no new rows for {Quantity(silent, 's'):.0f SI}") if silent > _SILENT else "rows come"
        if self._wrong:
            text += f"; {self._wrong} lines were no rows, the last one '{self._last_wrong}'"
        return text

    def close(self) -> None:
        """Do nothing, since the file is open only during a read."""

    def _understand(self) -> bool:
        """Detect layout, names, units and clock from the first lines; return False while there are too few."""
        head = self._content.head()
        # More content would not help.
        full = len(head) >= HEAD
        head = head[: head.rfind(b"\n") + 1]
        if head.count(b"\n") < _LEAST and not full:
            return False
        # whole lines are found by their byte \n, which in UTF-16 is half a letter and in gzip nothing
        if head.startswith((b"\xff\xfe", b"\xfe\xff", b"\x1f\x8b")):
            raise LogError(f"{self.name}: is packed or in UTF-16, and cannot be followed: write it as plain text")
        reader = reader_of(self.name, head)
        if reader not in (text_files.read_csv, text_files.read_halsampler):
            raise LogError(
                f"{self.name}: is of a format whose rows cannot be read while it grows; followed are CSV and other "
                "tables in text, and halsampler: open it when it is complete"
            )
        text = text_files.text_of(head)
        layout = text_files.layout_of(head.decode(text.encoding, "replace").replace("\r", ""))
        below = "" if layout is None else head.decode(text.encoding, "replace").split("\n", layout.first)[-1]
        rows = [line for line in below.split("\n") if line.strip()]
        if layout is None or len(rows) < _LEAST:
            if not full:
                return False
            raise LogError(
                f"{self.name}: holds no rows of numbers, or fewer than {_LEAST}, in its first {HEAD // 1000} kB: "
                "shorten the text above them, or record fewer columns"
            )
        self._encoding = text.encoding
        numbered = False
        if reader is text_files.read_halsampler and len(layout.names) > 1 and layout.numeric[0]:
            cells = [text_files.split(line, layout.separator) for line in rows]
            whole = [row for row in cells if len(row) == len(layout.names) and layout.is_number(row[0])]
            numbers = [_number(row[0], layout) for row in whole]
            numbered = text_files.counts_samples(np.array(numbers))
        self._set(layout, numbered)
        return True

    def _set(self, layout: CsvLayout, numbered: bool) -> None:
        """Set the layout, clock and channels; with `numbered` the first column holds sample numbers."""
        names = list(layout.names)
        counter = 0 if numbered else None
        if numbered:
            names[0] = text_files.COUNTER
        self._chosen = [k for k, numeric in enumerate(layout.numeric) if numeric]
        stamps = next((k for k in self._chosen if is_time(names[k])), None) if counter is None else None
        self._stamps = None if stamps is None else self._chosen.index(stamps)
        self._counter = None if counter is None else self._chosen.index(counter)
        self._factor = 1.0
        if stamps is not None:
            unit = layout.units[stamps]
            column = Column(name=names[stamps], unit="" if unit else self._time_unit or "")
            self._factor = factor_of(self.name, "time", column, unit)
        elif self._sample_time is not None:
            self._factor = self._sample_time
        self.clock = "s" if stamps is not None or self._sample_time is not None else "samples"
        self._layout = layout
        self._values = [k for k in range(len(self._chosen)) if k not in (self._stamps, self._counter)]
        numbers = {names[self._chosen[k]]: layout.units[self._chosen[k]] for k in self._values}
        self.channels = {name: unit or unit_in_name(name) for name, unit in numbers.items()}
        # Only from the start of the file do headers precede the first row.
        if self._from_begin:
            lines = self._rest.split(b"\n", layout.first)
            self._rest = lines[-1] if len(lines) > layout.first else b""

    def _parsed(self, text: str) -> Rows:
        assert self._layout is not None
        layout = self._layout
        plain = text
        # quotes, remarks and empty lines are rare: only text that has them is searched line by line in Python
        if any(mark in plain for mark in '#%/"') or "\n\n" in plain or plain[:1] == "\n":
            plain = "".join(f"{line}\n" for line in plain.split("\n") if not text_files.is_skipped(line))
        numbers = None
        if plain and '"' not in plain:
            dotted = plain.replace(",", ".") if layout.decimal == "," else plain
            numbers = text_files.plain_numbers(dotted, layout, self._chosen)
        if numbers is None:
            numbers = self._line_by_line(plain)
        if self._stamps is not None:
            time = self._factor * numbers[:, self._stamps]
            kept = np.isfinite(time)
            self._wrong += int(np.count_nonzero(~kept & np.isfinite(numbers).any(axis=1)))
            time, numbers = time[kept], numbers[kept]
        elif self._counter is not None:
            numbers = np.vstack([np.full((self._gaps, numbers.shape[1]), np.nan), numbers])
            # a gap has the number of the row after it: one at the end waits for that row
            numbered = np.flatnonzero(np.isfinite(numbers[:, self._counter]))
            end = numbered[-1] + 1 if numbered.size else 0
            self._gaps = len(numbers) - end
            numbers = numbers[:end]
            time = self._factor * _filled(numbers[:, self._counter])
        else:
            time = self._factor * np.arange(self._count, self._count + len(numbers), dtype=np.float64)
        self._count += len(numbers)
        values = numbers[:, self._values]
        values[~np.isfinite(values)] = np.nan
        return Rows(time, values, self._anew)

    def _line_by_line(self, text: str) -> np.ndarray:
        """Parse the valid rows among the lines; `overrun` becomes a row of NaN."""
        assert self._layout is not None
        layout = self._layout
        rows = list[list[float]]()
        for line in text.split("\n"):
            if text_files.is_skipped(line):
                continue
            cells = text_files.split(line, layout.separator)
            good = len(cells) == len(layout.names) and all(layout.is_number(cells[k]) for k in self._chosen)
            if good:
                rows.append([_number(cells[k], layout) for k in self._chosen])
                continue
            self._wrong += 1
            self._last_wrong = "".join(letter for letter in line.strip()[:40] if letter.isprintable())
            # Lost samples are a gap in a record that is counted; time stamps show the gap themselves.
            if self._stamps is None and "overrun" in line.lower():
                rows.append([np.nan] * len(self._chosen))
        return np.array(rows, dtype=np.float64).reshape(len(rows), len(self._chosen))


def _number(cell: str, layout: CsvLayout) -> float:
    return float(cell.replace(",", ".") if layout.decimal == "," else cell)


def _filled(counter: np.ndarray) -> np.ndarray:
    """Replace each NaN among the sample numbers by the next valid number; the last number must be valid."""
    good = np.flatnonzero(np.isfinite(counter))
    return counter[good[np.searchsorted(good, np.arange(counter.size))]]
