"""Storage of finished cases, so that a stopped evaluation can be resumed: one file per case, named by its digest.

    DIR/p_pi-0c4f6f0d2c1b9a53.json    {"case": ..., "digest": ..., "outcome": ...}

A file is valid only for a case with the same digest.  If the numbers, the rule, the law or the version of feeddrive
change, the digest changes, and the case is computed again.
"""

import contextlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from feeddrive.evaluation.case import Case
from feeddrive.files.atomic_io import read_whole, write_whole
from feeddrive.language.errors import FileError
from feeddrive.language.progress import Progress

# bytes; a larger file is none of these and is not read
_MOST = 4_000_000
# only names that this module writes: the folder may contain files of the user, which `clear` must not touch
_NAME = re.compile(r"[a-z0-9_]+-[0-9a-f]{16}\.json")


class Store(Protocol):
    """A store that returns the outcomes of finished cases and records new ones."""

    def known(self, case: Case[Any], progress: Progress) -> Any:
        """Return the outcome of a case; None if it is unknown."""
        ...

    def keep(self, case: Case[Any], outcome: Any) -> None:
        """Store the outcome of a case."""
        ...


@dataclass(frozen=True)
class Folder:
    """A directory with one file per finished case; it is created when the first outcome is stored.

    resume  False: existing files are ignored, and are replaced as their cases finish
    """

    place: Path
    resume: bool = True

    def known(self, case: Case[Any], progress: Progress) -> Any:
        """Return the outcome of a case; None if its file is missing, damaged or modified."""
        path = self._path(case)
        if not self.resume or not path.is_file():
            return None
        # a damaged file costs one case again; an error would end the whole evaluation
        try:
            content: dict[str, Any] = json.loads(read_whole(path, _MOST))
            return case.restored(content["outcome"], progress) if content["digest"] == case.digest else None
        except (FileError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def keep(self, case: Case[Any], outcome: Any) -> None:
        """Write the record of an outcome atomically. Raises FileError if it cannot be written."""
        record = case.record(outcome)
        if record is None:
            return
        # not reported here: the write below fails for the same reason and names it
        with contextlib.suppress(OSError):
            self.place.mkdir(parents=True, exist_ok=True)
        content = {"case": case.name, "digest": case.digest, "outcome": record}
        write_whole(self._path(case), json.dumps(content, indent=2) + "\n")

    @property
    def count(self) -> int:
        """The number of stored cases."""
        return len(self._files())

    def clear(self) -> None:
        """Remove all stored cases, and the directory if it is then empty."""
        for path in self._files():
            path.unlink(missing_ok=True)
        # a folder with other files is not empty and stays
        with contextlib.suppress(OSError):
            self.place.rmdir()

    def _files(self) -> list[Path]:
        if not self.place.is_dir():
            return []
        return [path for path in self.place.iterdir() if _NAME.fullmatch(path.name)]

    def _path(self, case: Case[Any]) -> Path:
        name = re.sub(r"[^a-z0-9]+", "_", case.name.lower()).strip("_")[:80] or "case"
        # 64 bits are enough for a name: the file itself contains the whole digest
        return self.place / f"{name}-{case.digest[:16]}.json"
