"""Origins: the files that a file was made from, by name and SHA-256 digest, so that a chain of files can be checked.

[[made_from]]
file = "x_axis.csv"
sha256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
"""

import hashlib
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from feeddrive.files.atomic_io import read_whole
from feeddrive.files.columns import MOST_BYTES
from feeddrive.files.section import Section, text
from feeddrive.files.toml_file import TomlEdit, TomlFile, quoted

SECTION = "made_from"
_DIGEST = re.compile(r"[0-9a-f]{64}")


class Origin(Section, kind=SECTION):
    """A file that another file was made from: its name, without a folder, and its SHA-256 digest."""

    file: str = text("name of the file")
    sha256: str = text("its SHA-256 digest, 64 hexadecimal digits")

    def check(self) -> None:
        """Raise ParameterError for a digest that is not one of SHA-256."""
        if not _DIGEST.fullmatch(self.sha256):
            raise self.error("sha256 must be 64 digits of 0-9 and a-f, as `sha256sum FILE` prints them", "sha256")


def digest_of(content: bytes | str) -> str:
    """Return the SHA-256 digest of a file's content."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


def origins(inputs: Iterable[Any]) -> tuple[Origin, ...]:
    """Return the origins among the inputs of a command, each once; values that are from no file are left out.

    An input is a path, a log, or a machine file whose text is still that of the file of its name.
    Raises FileError for a file that cannot be read.
    """
    found: dict[tuple[str, str], Origin] = {}
    for entry in inputs:
        origin = _origin(entry)
        if origin is not None:
            found[origin.file, origin.sha256] = origin
    return tuple(found.values())


def _origin(entry: Any) -> Origin | None:
    file = getattr(entry, "file", None)
    if isinstance(file, TomlFile):
        # a machine that was made in memory, or with other values, has no file
        path, digest = Path(file.name), digest_of(file.text)
        there = path.is_file() and digest_of(read_whole(path, MOST_BYTES)) == digest
        return Origin(file=path.name, sha256=digest) if there else None
    provenance = getattr(entry, "provenance", None)
    if isinstance(provenance, dict) and "sha256" in provenance:
        return Origin(file=Path(str(entry.name)).name, sha256=str(provenance["sha256"]))
    if isinstance(entry, str | Path) and Path(entry).is_file():
        return Origin(file=Path(entry).name, sha256=digest_of(read_whole(entry, MOST_BYTES)))
    return None


def with_origins(content: str, inputs: Iterable[Any]) -> str:
    """Return the text of a TOML file with the origins among the inputs in place of those that it states."""
    edit = TomlEdit(content, "machine.toml")
    edit.remove((SECTION,))
    for origin in origins(inputs):
        edit.add(f"[[{SECTION}]]\nfile = {quoted(origin.file)}\nsha256 = {quoted(origin.sha256)}")
    return edit.text
