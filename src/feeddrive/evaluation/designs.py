"""Stored designs, with exact tunables and figures, one file per law and plant."""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

from feeddrive.evaluation.robustness import Design, Tuning
from feeddrive.files.atomic_io import read_whole, write_whole
from feeddrive.language.errors import FeeddriveError, FileError
from feeddrive.language.progress import Progress
from feeddrive.tuning.candidates import Refusal
from feeddrive.tuning.tune import Tuned

_LARGEST = 1_000_000  # bytes, largest size of a file


@dataclass(frozen=True)
class Designs:
    """A directory of designs for one plant, one JSON file per law.

    also    directories that are only read, after `folder`
    shared  laws whose designs are read there; empty: all
    """

    folder: Path
    plant: str
    rules: int
    also: tuple[Path, ...] = ()
    shared: tuple[str, ...] = ()

    def design(self, law: str) -> Design | None:
        """Return the design of a law; None if there is none. Raises FileError if the file is not a valid design."""
        # a user's design comes before that of the package
        also = self.also if not self.shared or law in self.shared else ()
        paths = (self._path(law, place) for place in (self.folder, *also))
        path = next((path for path in paths if path.is_file()), None)
        if path is None:
            return None
        try:
            design = Design.read(json.loads(read_whole(path, _LARGEST)))
        except (ValueError, KeyError, TypeError, AttributeError):
            raise FileError(f"{path}: is no design of the benchmark: remove it, and it is searched anew") from None
        # a design for other rules is no error: it is ignored
        return design if (design.plant, design.rules) == (self.plant, self.rules) else None

    def outcome(self, law: str) -> Design | Refusal | None:
        """Return the design of a law, or the reason why its search found none."""
        design = self.design(law)
        return Refusal(law, design.refused) if design is not None and design.refused else design

    def write(self, design: Design) -> None:
        """Write a design atomically. Raises FileError if the directory cannot be written."""
        path = self._path(design.law, self.folder)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(design.record(), indent=2, ensure_ascii=False) + "\n")

    def known(self, case: Tuning, progress: Progress) -> Tuned | Refusal | None:
        """Return the stored result of a law if its design is not stale. Called by the engine, for which this object is
        the result store.
        """
        design = self.design(case.name)
        if design is None:
            return None
        try:
            if not design.refused and design.stale(
                case.candidate.tuned(design.control(case.candidate)).loop, case.rule
            ):
                return None
        # the law no longer has the tunables with which its design was stored: it is tuned again
        except FeeddriveError:
            return None
        return case.as_designed(design, progress)

    def keep(self, case: Tuning, outcome: Tuned | Refusal) -> None:
        """Store the result of tuning a law. Called by the engine."""
        self.write(replace(Design.of(case.name, outcome, case.rule), plant=self.plant, rules=self.rules))

    def _path(self, law: str, place: Path) -> Path:
        return place / self.plant / (re.sub(r"[^a-z0-9]+", "_", law.lower()).strip("_") + ".json")
