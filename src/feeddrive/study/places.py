"""Where files of a store stand: a folder of this machine, or any address that fsspec opens.

Both write a file whole or not at all, under a hidden temporary name first: a reader never sees half a file, and what a
killed process leaves behind has a name that begins with a point, which nothing reads.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
from pathlib import Path
from typing import Any, Protocol

from feeddrive.files.atomic_io import read_whole, refusal, write_whole
from feeddrive.language.errors import FileError, MissingExtraError
from feeddrive.language.quantity import Quantity


class Place(Protocol):
    """A folder of files; names are relative to it, with `/` between folders."""

    address: str

    def names(self, folder: str = "") -> list[str]:
        """Names in a folder, in order, without hidden ones; none where there is no such folder."""
        ...

    def has(self, name: str) -> bool:
        """Return True if there is a file of this name."""
        ...

    def read(self, name: str, most: int) -> bytes:
        """The bytes of a file of at most `most` bytes. Raises FileError."""
        ...

    def check_writable(self) -> None:
        """Raise FileError if nothing can be written there, as far as can be seen without writing."""
        ...

    def write(self, name: str, content: bytes) -> None:
        """Write a file whole or not at all, with the folders above it. Raises FileError."""
        ...


def place(address: str | Path) -> Place:
    """The place of an address: `results/mill` or `file:///results/mill` is a folder, `s3://bucket/mill` is fsspec's.

    Raises FileError for an address with a password and for one that fsspec cannot open, MissingExtraError without it.
    """
    text = str(address)
    _check_no_password(text)
    if "://" not in text:
        return Folder(text)
    protocol, _, path = text.partition("://")
    return Folder(path) if protocol in ("file", "local") else Remote(text)


_PASSWORD = re.compile(r"(?<=://)([^/@:]*):[^/@]*@")


def _check_no_password(address: str) -> None:
    """Raise FileError for `ftp://name:password@host`: command lines, reports and messages show an address to others."""
    if _PASSWORD.search(address):
        shown = _PASSWORD.sub(r"\1:...@", address)
        protocol = shown.partition("://")[0].rpartition(":")[2]
        raise FileError(
            f"{shown}: holds a password, which every user of this machine can read in the command line: leave it out, "
            f"and put it into the environment as FSSPEC_{protocol.upper()}_PASSWORD or into a file in ~/.config/fsspec"
        )


class Folder:
    """A folder of this machine."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._root = Path(address)

    def names(self, folder: str = "") -> list[str]:
        """Names in a folder, in order, without hidden ones."""
        try:
            return sorted(entry.name for entry in (self._root / folder).iterdir() if not entry.name.startswith("."))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise refusal(self._root / folder, "read", error) from None

    def has(self, name: str) -> bool:
        """Whether there is a file of this name."""
        return (self._root / name).is_file()

    def read(self, name: str, most: int) -> bytes:
        """The bytes of a regular file."""
        return read_whole(self._root / name, most)

    def check_writable(self) -> None:
        """Raise FileError for a place below a file or in a folder of somebody else."""
        try:
            there = next(folder for folder in (self._root, *self._root.absolute().parents) if folder.exists())
            if not there.is_dir():
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
            if not os.access(there, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        except OSError as error:
            raise refusal(self._root, "written", error) from None

    def write(self, name: str, content: bytes) -> None:
        """Write a file, flushed to the disk before it has its name."""
        path = self._root / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise refusal(path, "written", error) from None
        write_whole(path, content)


class Remote:
    """An address of fsspec; every error of its file system becomes a FileError that names file and reason."""

    def __init__(self, address: str) -> None:
        try:
            import fsspec
        except ImportError:
            raise MissingExtraError("fsspec", "cluster", f"{address}: an address that is no folder") from None
        self.address = address
        try:
            self._files: Any
            self._files, self._root = fsspec.url_to_fs(address)
        except (ImportError, ValueError, OSError) as error:  # ImportError names the package of the protocol
            raise FileError(f"{address}: cannot be opened: {error}") from None

    def names(self, folder: str = "") -> list[str]:
        """Names in a folder, in order, without hidden ones."""
        try:
            self._files.invalidate_cache()  # another client may have written since
            entries = self._files.ls(self._path(folder), detail=False)
        except FileNotFoundError:
            return []
        except Exception as error:  # a file system of another package raises what it likes
            raise self._refusal(folder, "read", error) from None
        there = (str(entry).rstrip("/").rpartition("/")[2] for entry in entries)
        return sorted(name for name in there if name and not name.startswith("."))

    def has(self, name: str) -> bool:
        """Whether there is a file of this name."""
        return name.rpartition("/")[2] in self.names(name.rpartition("/")[0])

    def read(self, name: str, most: int) -> bytes:
        """The bytes of a file."""
        try:
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
        """Check nothing: only a write would show it."""

    def write(self, name: str, content: bytes) -> None:
        """Write under a hidden name, then move: not every protocol puts a file in one piece."""
        folder, _, last = name.rpartition("/")
        temporary = self._path(f"{folder}/.{last}.{secrets.token_hex(6)}.part".lstrip("/"))
        try:
            self._files.makedirs(self._path(folder), exist_ok=True)
            self._files.pipe_file(temporary, content)
            self._files.mv(temporary, self._path(name))
        except BaseException as error:
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
