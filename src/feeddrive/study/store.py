"""The store of a sweep: its rows as one Parquet file per chunk, with a manifest, in a folder or at an fsspec address.

    DIR/manifest.json                 study, digest, version of feeddrive, variants, variants per chunk, and
                                      "sealed": true (each chunk carries its SHA-256)
    DIR/rows/chunk_00000012.parquet   the rows of chunk 12, in the order of their variants

Each file is written atomically under a hidden temporary name: a reader never sees a partial file, and the leftovers of
a killed process have names that begin with a dot, which are never read.  A chunk is therefore either complete or
absent, whichever process was killed.  Each chunk carries a SHA-256 of itself (`chunk.py`), so that a file damaged later
is rejected.  If two sweeps of one study write to the same store, they write the same bytes, and no row is duplicated.

    store = Store("out")
    done = store.begin(manifest, resume=True)        # rejects a store of another study; checks every file
    store.write(3, table)
    store.table()                                    # all rows as one pyarrow table
"""

import contextlib
import errno
import json
import os
import re
import secrets
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import zip_longest
from pathlib import Path
from typing import Any, Protocol

from feeddrive.files.atomic_io import MARKER, read_whole, refusal, write_whole
from feeddrive.language.errors import FileError, MissingExtraError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.study.chunk import DamagedChunkError, chunk_bytes, chunk_rows
from feeddrive.version import __version__


class Place(Protocol):
    """The location of the files of a store; file names are relative to it, with `/` between folders."""

    address: str

    def names(self, folder: str = "") -> list[str]:
        """Return the sorted names in a folder, without hidden ones, or an empty list if the folder does not exist."""
        ...

    def has(self, name: str) -> bool:
        """Return True if there is a file of this name."""
        ...

    def read(self, name: str, most: int) -> bytes:
        """Return the content of a file; raise FileError if it cannot be read or has more than `most` bytes."""
        ...

    def check_writable(self) -> None:
        """Raise FileError if the location is found not to be writable, without writing to it."""
        ...

    def write(self, name: str, content: bytes) -> None:
        """Write a file atomically, creating its parent folders; raise FileError if it cannot be written."""
        ...


def place(address: str | Path) -> Place:
    """Return the location of a folder (`results/mill`, `file:///results/mill`) or fsspec URL (`s3://bucket/mill`).

    Raises FileError for an address with a password or one that fsspec cannot open, MissingExtraError without fsspec.
    """
    text = str(address)
    _check_no_password(text)
    if "://" not in text:
        return Folder(text)
    protocol, _, path = text.partition("://")
    return Folder(path) if protocol in ("file", "local") else Remote(text)


_PASSWORD = re.compile(r"(?<=://)([^/@:]*):[^/@]*@")


def _check_no_password(address: str) -> None:
    """Raise FileError for `ftp://name:password@host`: command lines, reports and messages would expose it."""
    if _PASSWORD.search(address):
        shown = _PASSWORD.sub(r"\1:...@", address)
        protocol = shown.partition("://")[0].rpartition(":")[2]
        raise FileError(
            f"{shown}: holds a password, which every user of this machine can read in the command line: leave it out, "
            f"and put it into the environment as FSSPEC_{protocol.upper()}_PASSWORD or into a file in ~/.config/fsspec"
        )


class Folder:
    """A folder of the local file system."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._root = Path(address)

    def names(self, folder: str = "") -> list[str]:
        """Return the sorted names in a folder, without hidden ones."""
        try:
            return sorted(entry.name for entry in (self._root / folder).iterdir() if not entry.name.startswith("."))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise refusal(self._root / folder, "read", error) from None

    def has(self, name: str) -> bool:
        """Return True if there is a file of this name."""
        return (self._root / name).is_file()

    def read(self, name: str, most: int) -> bytes:
        """Return the bytes of a regular file."""
        return read_whole(self._root / name, most)

    def check_writable(self) -> None:
        """Raise FileError if a parent folder is in fact a file or has no write permission."""
        try:
            # The first write makes the folder itself, so its nearest existing parent decides.
            there = next(folder for folder in (self._root, *self._root.absolute().parents) if folder.exists())
            if not there.is_dir():
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
            # Creating an entry needs both the write and the search permission of a folder.
            if not os.access(there, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        except OSError as error:
            raise refusal(self._root, "written", error) from None

    def write(self, name: str, content: bytes) -> None:
        """Write a file, and flush it to disk before it is renamed."""
        path = self._root / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise refusal(path, "written", error) from None
        write_whole(path, content)


class Remote:
    """An fsspec address; every error of its file system is reported as a FileError with file and reason."""

    def __init__(self, address: str) -> None:
        try:
            import fsspec
        except ImportError:
            raise MissingExtraError("fsspec", "cluster", f"{address}: an address that is no folder") from None
        self.address = address
        try:
            self._files: Any
            self._files, self._root = fsspec.url_to_fs(address)
        except (ImportError, ValueError, OSError) as error:
            # The text of an ImportError names the missing package of the protocol.
            raise FileError(f"{address}: cannot be opened: {error}") from None

    def names(self, folder: str = "") -> list[str]:
        """Return the sorted names in a folder, without hidden ones."""
        try:
            # Another client may have written since.
            self._files.invalidate_cache()
            entries = self._files.ls(self._path(folder), detail=False)
        except FileNotFoundError:
            return []
        except Exception as error:
            # Third-party file systems raise arbitrary exceptions.
            raise self._refusal(folder, "read", error) from None
        there = (str(entry).rstrip("/").rpartition("/")[2] for entry in entries)
        return sorted(name for name in there if name and not name.startswith("."))

    def has(self, name: str) -> bool:
        """Return True if there is a file of this name."""
        # By the listing, which bypasses the cache of the file system.
        return name.rpartition("/")[2] in self.names(name.rpartition("/")[0])

    def read(self, name: str, most: int) -> bytes:
        """Return the bytes of a file."""
        try:
            # Checked before the download: a foreign object of any size must not fill the memory.
            size = self._files.info(self._path(name))["size"]
            content = b"" if size > most else self._files.cat_file(self._path(name))
        except Exception as error:
            raise self._refusal(name, "read", error) from None
        if size > most:
            raise FileError(
                f"{self.address}/{name}: has {Quantity(size / 1e6, 'MB'):,.1f}, more than the "
                f"{Quantity(most / 1e6, 'MB'):,.1f} read"
            )
        return content

    def check_writable(self) -> None:
        """Do nothing, since only an actual write shows whether the address is writable."""

    def write(self, name: str, content: bytes) -> None:
        """Write the file under a hidden name, then rename it, since not every protocol writes files atomically."""
        folder, _, last = name.rpartition("/")
        temporary = self._path(f"{folder}/.{last}.{secrets.token_hex(6)}.part".lstrip("/"))
        try:
            self._files.makedirs(self._path(folder), exist_ok=True)
            self._files.pipe_file(temporary, content)
            self._files.mv(temporary, self._path(name))
        except BaseException as error:
            # Ctrl-C included, which must not leave the temporary file. Its removal may fail as the write did, and the
            # error of the write is the one to report.
            with contextlib.suppress(Exception):
                self._files.rm_file(temporary)
            if not isinstance(error, Exception):
                raise
            raise self._refusal(name, "written", error) from None

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}".rstrip("/")

    def _refusal(self, name: str, what: str, error: Exception) -> FileError:
        address = f"{self.address}/{name}".rstrip("/")
        if isinstance(error, OSError) and error.errno is not None:
            return refusal(address, what, error)
        return FileError(f"{address}: cannot be {what}: {str(error) or type(error).__name__}")


MANIFEST = "manifest.json"
ROWS = "rows"
_KIND = "rows of a feeddrive study"
_NAME = re.compile(r"chunk_(\d{8})\.parquet")
# Files are read whole, and whoever can write to the address decides their size.
_MOST_MANIFEST = 64_000_000  # bytes
_MOST_CHUNK = 4_000_000_000  # bytes
_MOST_CHUNKS = 10**8  # limited by the eight digits in the file name
GO_ON = "then go on with --resume"


@dataclass(frozen=True)
class Manifest:
    """The identity of the study whose rows a store holds.

    study    text of the study file
    digest   SHA-256 (hex) of everything that determines the rows: study, machine, job, part programs
    count    total number of variants
    chunk    number of variants per chunk; the last chunk may have fewer
    version  version of feeddrive; the results of other versions may not be bit-identical
    """

    study: str
    digest: str
    count: int
    chunk: int
    version: str = __version__

    def __post_init__(self) -> None:
        # The values may come from a JSON file, which has any types.
        for name, wanted in (("study", str), ("digest", str), ("count", int), ("chunk", int), ("version", str)):
            if not isinstance(getattr(self, name), wanted):
                raise ParameterError(f"{name} must be of type {wanted.__name__}, not {getattr(self, name)!r}")
        if self.count < 1 or self.chunk < 1 or self.chunks > _MOST_CHUNKS:
            raise ParameterError(
                f"{self.count} variants in chunks of {self.chunk}: both must be at least 1, and at most {_MOST_CHUNKS} "
                "chunks have a name"
            )

    @property
    def chunks(self) -> int:
        """The number of chunks."""
        return -(-self.count // self.chunk)

    def rows(self, number: int) -> range:
        """Return the variants of a chunk."""
        return range(number * self.chunk, min((number + 1) * self.chunk, self.count))


class Store:
    """The store of the rows of a study: a folder, or an fsspec address (`s3://bucket/mill`)."""

    def __init__(self, address: str | Path) -> None:
        self._place = place(address)
        self._manifest: Manifest | None = None
        self._made = False  # True once the manifest is written
        self._sealed = True  # all chunks must carry a SHA-256; stores of earlier versions had none
        self._schema: Any = None  # schema of the first chunk read or written, required of all others

    @property
    def address(self) -> str:
        """The folder or address of the store."""
        return self._place.address

    def manifest(self) -> Manifest:
        """Return the manifest of the store. Raise FileError if there is no store, or its manifest is damaged."""
        if self._manifest is None:
            self._manifest = self._read_manifest()
            self._made = True
        return self._manifest

    def begin(self, manifest: Manifest, *, resume: bool = False) -> frozenset[int]:
        """Start or continue a store; return the numbers of the finished chunks. The first `write` creates the store.

        Raises FileError, before anything is written, for a non-empty folder that is not a store, an existing store
        without `resume`, a store of another study or version, and a store with a damaged or foreign file.
        """
        if not self._place.has(MANIFEST):
            if strangers := [name for name in self._place.names() if name != MARKER]:
                raise FileError(
                    f"{self.address}: exists and holds '{strangers[0]}', which is not of a sweep: "
                    "choose another directory, or move that away"
                )
            # Found now, not when the first chunk has been computed.
            self._place.check_writable()
            self._manifest = manifest
            return frozenset()
        there = self.manifest()
        if not resume:
            done = len(self._numbers())
            raise FileError(
                f"{self.address}: holds a sweep already, {done} of {there.chunks} chunks: go on with --resume, or "
                "choose another directory"
            )
        # The manifest is compared first: chunks of another study would all look damaged.
        if reason := _other(there, manifest):
            raise FileError(f"{self.address}: {reason}")
        for number in self._numbers():
            # Read only to verify it: damage that is found after the sweep would cost another run.
            self.read(number)
        return self.done()

    def done(self) -> frozenset[int]:
        """Return the numbers of the chunks whose files exist; only `begin` checks the content of these files."""
        return frozenset(self._numbers())

    def write(self, number: int, rows: Any) -> None:
        """Write the rows of a chunk (a pyarrow table), replacing any existing file of this chunk.

        Raises FileError, with the remedy, if it cannot be written, for example on a full disk; ParameterError for a
        table that does not hold the rows of this chunk.
        """
        manifest = self.manifest()
        if reason := self._objection(number, rows):
            raise ParameterError(f"chunk {number}: {reason}")
        content = chunk_bytes(rows, manifest.digest)
        try:
            # Written with the first chunk, so that a sweep that fails to start leaves nothing, and before it, so that
            # no chunk is without its study.
            if not self._made:
                self._place.write(MANIFEST, _manifest_text(manifest))
                self._made = True
            self._place.write(_file(number), content)
        except FileError as error:
            raise FileError(f"{error}; {GO_ON}") from None

    def read(self, number: int, columns: Sequence[str] | None = None) -> Any:
        """Return the rows of a finished chunk as a pyarrow table.

        Raises FileError if the file is damaged, belongs to another study, or does not hold the rows of this chunk.
        """
        digest = self.manifest().digest
        content = self._place.read(_file(number), _MOST_CHUNK)
        rows, reason = None, ""
        try:
            rows, study = chunk_rows(content, sealed=self._sealed)
            reason = self._objection(number, rows) if study == digest else "it is of another study"
        except DamagedChunkError as error:
            reason = f"it is damaged ({error})"
        if reason:
            raise FileError(f"{self.address}/{_file(number)}: {reason}: move it away, {GO_ON}, which computes it again")
        assert rows is not None
        return rows if columns is None else rows.select(list(columns))

    def batches(self, columns: Sequence[str] | None = None) -> Iterator[Any]:
        """Yield the rows chunk by chunk, in order, as pyarrow tables; only one chunk is in memory."""
        self.manifest()  # raises if this is not a store
        for number in self._numbers():
            yield self.read(number, columns)

    def table(self, columns: Sequence[str] | None = None) -> Any:
        """Return all rows in the store as one pyarrow table, in the order of their variants.

        Raises FileError as `read` does, and if there are no rows yet.
        """
        import pyarrow as arrow

        parts = list(self.batches(columns))
        if not parts:
            raise FileError(f"{self.address}: holds no rows yet: run the sweep with --resume")
        return arrow.concat_tables(parts)

    def _numbers(self) -> list[int]:
        """Return the sorted numbers of the chunk files. Raise FileError for any other file."""
        numbers = list[int]()
        for name in self._place.names(ROWS):
            match = _NAME.fullmatch(name)
            if match is None or int(match[1]) >= self.manifest().chunks:
                raise FileError(
                    f"{self.address}/{ROWS}/{name}: is no chunk of this sweep, and would be read as one: move it away"
                )
            numbers.append(int(match[1]))
        return numbers

    def _objection(self, number: int, rows: Any) -> str:
        """Return the reason why a table cannot be the rows of a chunk, or an empty string if there is none."""
        import numpy as np
        import pyarrow as arrow

        if "variant" not in rows.column_names or rows.schema.field("variant").type != arrow.int64():
            return "it has no column 'variant' of whole numbers"
        wanted = self.manifest().rows(number)
        if not np.array_equal(rows.column("variant").to_numpy(), np.arange(wanted.start, wanted.stop)):
            return f"its rows are not those of the variants {wanted.start} to {wanted.stop - 1}"
        if self._schema is None:
            self._schema = rows.schema.remove_metadata()
        if not rows.schema.equals(self._schema):
            return "it has other columns than the chunks before"
        return ""

    def _read_manifest(self) -> Manifest:
        where = f"{self.address}/{MANIFEST}"
        try:
            entries = json.loads(self._place.read(MANIFEST, _MOST_MANIFEST))
            if entries.pop("kind") != _KIND:
                raise ValueError("it is of another program")
            entries.pop("chunks")
            # Stores of earlier versions have no such entry, and chunks without a seal.
            self._sealed = entries.pop("sealed", False)
            if self._sealed not in (True, False):
                raise ValueError("'sealed' must be true")
            if set(entries) != {entry.name for entry in fields(Manifest)}:
                raise ValueError("its entries are not those of a sweep")
            return Manifest(**entries)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError, ParameterError) as error:
            # JSON of another shape fails in any of these ways; deep nesting raises RecursionError.
            reason = str(error) or type(error).__name__
            raise FileError(
                f"{where}: is damaged or not that of a sweep ({reason}): restore it, or choose another directory"
            ) from None


def _file(number: int) -> str:
    return f"{ROWS}/chunk_{number:08d}.parquet"


def _manifest_text(manifest: Manifest) -> bytes:
    entries = {"kind": _KIND, "chunks": manifest.chunks, **asdict(manifest), "sealed": True}
    return (json.dumps(entries, indent=1, ensure_ascii=False) + "\n").encode()


def _other(there: Manifest, wanted: Manifest) -> str:
    """Return the reason why a sweep with one manifest cannot be continued with another; empty if it can."""
    if there == wanted:
        return ""
    # The text changes the digest as well, but also gives the line.
    if there.study != wanted.study:
        pairs = zip_longest(there.study.splitlines(), wanted.study.splitlines())
        line = next((i for i, (old, new) in enumerate(pairs, start=1) if old != new), 1)
        return f"holds the sweep of another study, which differs from line {line} on: choose another directory"
    if there.version != wanted.version:
        return (
            f"was begun with feeddrive {there.version}, and this is {wanted.version}, whose rows may differ: "
            f"choose another directory, or go on with  pip install feeddrive=={there.version}"
        )
    if there.digest != wanted.digest:
        return (
            "the study is the one that it was begun with, but its job, machine or another file that it reads was "
            "changed since: choose another directory, or undo the change"
        )
    return (
        f"holds {there.count} variants in chunks of {there.chunk}, and {wanted.count} in chunks of {wanted.chunk} are "
        "asked for: choose another directory"
    )
