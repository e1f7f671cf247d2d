"""The record of a commissioning: its steps as values, and the file from which an interrupted one goes on."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from feeddrive.commissioning.evidence import Evidence, read_evidence
from feeddrive.commissioning.trial import Figures, Trial
from feeddrive.files.atomic_io import MARKER, read_whole, write_whole
from feeddrive.files.origins import digest_of
from feeddrive.files.read_log import MOST_BYTES
from feeddrive.language.errors import FileError
from feeddrive.language.table import Result, Table

FILE = "commission.json"
FORMAT = "feeddrive commission 1"

Asked: TypeAlias = Mapping[str, Mapping[str, str]]  # options of the request, by the step that takes them and by name


@dataclass(frozen=True)
class Step:
    """A step that was done: its name, a sentence with the result, its figures in SI, and its files by digest."""

    name: str
    says: str
    figures: Mapping[str, float] = field(default_factory=dict[str, float])
    files: Mapping[str, str] = field(default_factory=dict[str, str])
    inside: Mapping[str, str] = field(default_factory=dict[str, str])


@dataclass(frozen=True, eq=False, repr=False)
class Commissioned(Result):
    """A commissioning: its steps in order, the trial if there was one, and whether the new control was kept.

    questions  how often the user was asked
    refusal    the reason for which the control before stays in place; empty if there is none
    evidence   what was measured, for pictures
    turns      True for an axis that turns
    """

    where: str
    steps: tuple[Step, ...]
    trial: Trial | None = None
    kept: bool = False
    questions: int = 0
    refusal: str = ""
    evidence: Evidence = field(default_factory=Evidence)
    turns: bool = False

    @property
    def rotary(self) -> bool:
        """True for an axis that turns: lengths are in rad, forces in N m."""
        return self.turns

    def table(self) -> Table:
        """Return a table of the steps and their results."""
        heads = ["step", "result"]
        return Table(f"Commissioning of {self.where}", heads, [[step.name, step.says] for step in self.steps])

    def __getitem__(self, name: str) -> Step:
        for step in self.steps:
            if step.name == name:
                return step
        raise KeyError(name)

    @property
    def figures(self) -> dict[str, float]:
        """All figures of all steps, by name."""
        return {name: value for step in self.steps for name, value in step.figures.items()}


def digests(folder: Path, files: Sequence[str]) -> dict[str, str]:
    """Return the SHA-256 digests of files by their paths within a folder."""
    return {name: digest_of(read_whole(folder / name, MOST_BYTES)) for name in files}


@dataclass(frozen=True)
class Record:
    """What an interrupted commissioning had: what was in the drive at its beginning, the steps that were done, the
    names of the files of all others, which are done again, and the reason for which the first of these is.
    """

    inside: Mapping[str, str]
    steps: tuple[Step, ...]
    stale: tuple[str, ...]
    again: str = ""


def write_record(
    folder: Path,
    drive: str,
    asked: Asked,
    inside: Mapping[str, str],
    steps: Sequence[Step],
    closing: Mapping[str, Any],
) -> None:
    """Write `commission.json`: digest of the drive file, the options of the steps by name, what was in the drive, the
    steps, and how it all ended.  Figures that are not finite, as a stiffness without any deflection, are null.
    """
    document = {
        "format": FORMAT,
        "drive_sha256": digest_of(drive),
        "asked": {name: dict(options) for name, options in asked.items()},
        "inside": dict(inside),
        "steps": [
            {
                "name": step.name,
                "says": step.says,
                "figures": dict(step.figures),
                "files": dict(step.files),
                "inside": dict(step.inside),
            }
            for step in steps
        ],
        **closing,
    }
    write_whole(folder / FILE, json.dumps(_written(document), indent=1, allow_nan=False) + "\n")


def _written(value: Any) -> Any:
    """Return a value with null for every number that JSON does not have."""
    if isinstance(value, dict):
        return {name: _written(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_written(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _figure(value: object) -> float:
    """Return a figure of a record: null stands for one that was too large for a number."""
    return math.inf if value is None else float(value)  # type: ignore[arg-type]


def read_record(folder: Path, drive: str, asked: Asked) -> Record | None:
    """Return the record from which a commissioning goes on, with the steps before the first that is done again.

    drive  the text of the drive file, which must be the one that the record names
    asked  the options of each step by name: a step whose options are others now is done again, as is one whose files
           have changed
    Raises FileError for a record that is none, and for one of another drive.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    with _understood(path) as document:
        stated = str(document["drive_sha256"])
        inside = _texts(document["inside"])
        steps = _steps(document)
        before = {str(name): _texts(options) for name, options in document["asked"].items()}
    if stated != digest_of(drive):
        raise FileError(
            f"{path}: is the record of another drive file, or of this one before it was changed: give another --out, "
            "or remove that directory to begin anew"
        )
    whole: list[Step] = []
    again = ""
    for step in steps:
        again = _other_file(folder, step) or _other_option(before.get(step.name, {}), asked.get(step.name, {}))
        if again:
            break
        whole.append(step)
    return Record(inside, tuple(whole), tuple(name for step in steps[len(whole) :] for name in step.files), again)


def _other_file(folder: Path, step: Step) -> str:
    """Return the reason if a file of a step is not as it was written, or ""."""
    changed = next((name for name, digest in step.files.items() if not _is_same(folder / name, digest)), None)
    return "" if changed is None else f"{folder / changed} is not what its step wrote"


def _other_option(before: Mapping[str, str], now: Mapping[str, str]) -> str:
    """Return the reason if an option of a step is not as it was, or ""."""
    name = next((name for name in {**before, **now} if before.get(name) != now.get(name)), None)
    if name is None:
        return ""
    return f"--{name.replace('_', '-')} was {before.get(name, 'not given')} and is now {now.get(name, 'not given')}"


def read_commissioned(folder: str | Path) -> Commissioned:
    """Return the commissioning that a folder holds, finished or not, with what it measured.

    Raises FileError for a folder without a record, and the errors of the readers for damaged files.
    """
    path = Path(folder) / FILE
    with _understood(path) as document:
        figures = {
            name: Figures(**{str(key): _figure(value) for key, value in document[name].items()})
            for name in ("predicted", "measured", "before")
            if name in document
        }
        trial = Trial(figures["predicted"], figures["measured"], figures.get("before")) if figures else None
        return Commissioned(
            str(document.get("where", "")),
            tuple(_steps(document)),
            trial,
            bool(document.get("kept", False)),
            int(document.get("questions", 0)),
            str(document.get("refusal", "")),
            read_evidence(path.parent),
            bool(document.get("rotary", False)),
        )


@contextlib.contextmanager
def _understood(path: Path) -> Generator[dict[str, Any]]:
    """Yield the content of a record. Raise FileError if it cannot be read, or if the block does not understand it."""
    try:
        document = json.loads(read_whole(path, MOST_BYTES))
        if document["format"] != FORMAT:
            raise ValueError
        yield document
    except (ValueError, KeyError, TypeError, AttributeError):
        raise FileError(f"{path}: is no record of a commissioning; give another --out, or remove it") from None


def _steps(document: Mapping[str, Any]) -> list[Step]:
    return [
        Step(
            str(entry["name"]),
            str(entry["says"]),
            {str(name): _figure(value) for name, value in entry["figures"].items()},
            _texts(entry["files"]),
            _texts(entry["inside"]),
        )
        for entry in document["steps"]
    ]


def _texts(pairs: Mapping[str, Any]) -> dict[str, str]:
    return {str(name): str(value) for name, value in pairs.items()}


def remove_stale(folder: Path, names: Sequence[str]) -> None:
    """Remove files of steps that are done again, and the folders that are empty then; all others stay."""
    root = folder.resolve()
    for name in names:
        path = root / name
        # a name out of a damaged record may lead out of the folder, or be one
        if not path.resolve().is_relative_to(root) or path.is_dir():
            continue
        path.unlink(missing_ok=True)
        for parent in path.parents:
            if parent == root or not parent.is_dir():
                break
            (parent / MARKER).unlink(missing_ok=True)
            if any(parent.iterdir()):
                break
            parent.rmdir()


def _is_same(path: Path, digest: str) -> bool:
    # a name from a file must not lead out of the folder; digests of other files would only not match
    return path.is_file() and digest_of(read_whole(path, MOST_BYTES)) == digest
