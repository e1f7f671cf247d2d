"""Uploaded files of the page: names that are safe on every system, limited sizes, one folder."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from itertools import chain, count
from pathlib import Path

from feeddrive.files.atomic_io import written_whole
from feeddrive.language.errors import FileError

LARGEST = 256_000_000  # bytes of one file
MANY = 64  # files of one session
_LONGEST = 200  # bytes of a name: file systems take 255, of which a temporary file wants some
_NAME = re.compile(r"[^\W_][\w .()+,=@~-]{0,119}")
_DEVICES = re.compile(r"(con|prn|aux|nul|(com|lpt)[\d¹²³]) *(\..*)?", re.IGNORECASE)  # what Windows takes for devices


def safe_name(name: str) -> str:
    """Return a file name that stays in its folder on every system. Raises FileError for any other one."""
    if len(name.encode("utf-8", "surrogatepass")) > _LONGEST:
        raise FileError(f"{name!r:.80} is too long a name for a file here: {_LONGEST} bytes at most, rename it")
    if not _NAME.fullmatch(name) or ".." in name or name.endswith((".", " ")) or _DEVICES.fullmatch(name):
        raise FileError(
            f"{name!r:.80} is no name for a file here: rename it with letters, digits, blanks and . - _ ( ) + , = @ ~"
        )
    return name


def stem_of(name: str) -> str:
    """Return a name without its extension, as a part of other names: Windows drops blanks and dots at the end."""
    return Path(name).stem.rstrip(" .")


def place_of(name: str, folder: Path, promised: int | None = None) -> Path:
    """Return the path for an uploaded file: run.csv, then 2/run.csv, ...: a reader of the first one keeps its file.

    promised  its size, bytes, if the browser said it
    Raises FileError for its name, for a link that stands there, for more than `LARGEST` bytes, and for more than
    `MANY` files.
    """
    path = folder / safe_name(name)
    if promised is not None and promised > LARGEST:
        raise _too_large(path)
    if path.is_symlink():
        raise FileError(f"{path.name} is a link to another file: remove it from {folder}, or rename the file")
    if sum(1 for entry in folder.rglob("*") if not entry.is_dir()) >= MANY:
        raise FileError(f"{MANY} files were brought already: open a new page for more")
    return free_place(folder, name)


def free_place(folder: Path, name: str) -> Path:
    """Return a free path in a folder for a file of this name."""
    places = chain([folder], (folder / str(i) for i in count(2)))
    return next(place / name for place in places if not (place / name).exists())


async def keep(name: str, pieces: AsyncIterator[bytes], folder: Path, promised: int | None = None) -> Path:
    """Write a file that arrives in pieces into the folder, whole or not at all. Raises the errors of `place_of`."""
    path = place_of(name, folder, promised)
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as temporary, temporary.open("wb") as file:
        size = 0
        async for piece in pieces:
            size += len(piece)
            if size > LARGEST:
                raise _too_large(path)
            file.write(piece)
    return path


def _too_large(path: Path) -> FileError:
    return FileError(
        f"{path.name} is larger than {LARGEST // 1_000_000} MB: take a shorter piece of the log, or use feeddrive on "
        "the command line, which reads it where it is"
    )
