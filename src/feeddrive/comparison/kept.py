"""Tunings of a comparison that was stopped: a file a law, from which it goes on."""

from __future__ import annotations

import hashlib
import inspect
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from feeddrive.files.atomic_io import read_whole, write_whole
from feeddrive.files.run_files import versions
from feeddrive.language import tree
from feeddrive.language.progress import Progress
from feeddrive.tuning.candidates import Candidate, Refusal
from feeddrive.tuning.limits import Limits
from feeddrive.tuning.tune import assess
from feeddrive.tuning.tuned import HeldBack, Tuned

_LARGEST = 1_000_000  # bytes of a file


class Keeps(Protocol):
    """Knows what laws came to, and keeps what others come to."""

    def read(self, candidate: Candidate, limits: Limits, rule: Any, progress: Progress) -> Tuned | Refusal | None:
        """What a law came to; None if that is not known."""
        ...

    def write(self, candidate: Candidate, limits: Limits, rule: Any, made: Tuned | Refusal) -> None:
        """Keep what a law came to."""
        ...


@dataclass(frozen=True)
class Kept:
    """A directory with what each finished law came to: values of its tunables to the last bit, and how they were found.

    A file counts only for the same loop, limits, number of starts, versions and source of the law; else the law is
    tuned anew.  Figures and proof are computed again, so that a comparison that goes on gives what one that was never
    stopped gives.
    """

    folder: Path

    def read(self, candidate: Candidate, limits: Limits, rule: Any, progress: Progress) -> Tuned | Refusal | None:
        """What a law came to; None if that is not known."""
        path = self._path(candidate)
        if not path.is_file():
            return None
        try:
            known: Mapping[str, Any] = json.loads(read_whole(path, _LARGEST))
            if known.get("of") != _of(candidate, limits, rule):
                return None
            if known["refused"] is not None:
                return Refusal(candidate.name, str(known["refused"]))
            tunables = {str(name): float.fromhex(value) for name, value in known["tunables"].items()}
            held = tuple(HeldBack(*each) for each in known["held"])
            control = tree.vary(candidate.loop.control, tunables)
        except (ValueError, KeyError, TypeError, AttributeError):
            return None  # not a file of ours, or one that somebody has changed
        progress.step("as it was kept")
        found = assess(control, candidate.loop, rule="kept", limits=limits, velocity=rule.velocity)
        return replace(
            found, tunables=tunables, started=dict(known["started"]), held=held, advice=tuple(known["advice"]),
            evaluations=int(known["evaluations"]), spread=float(known["spread"]), unsettled=str(known["unsettled"]),
            recipe="",
        )  # fmt: skip

    def write(self, candidate: Candidate, limits: Limits, rule: Any, made: Tuned | Refusal) -> None:
        """Keep what a law came to. Raises FileError if the directory cannot be written."""
        said: dict[str, Any] = {"law": candidate.name, "of": _of(candidate, limits, rule), "refused": None}
        if isinstance(made, Refusal):
            said["refused"] = made.reason
        else:
            said |= {
                "tunables": {name: float(value).hex() for name, value in made.tunables.items()},
                "started": dict(made.started), "held": [list(vars(each).values()) for each in made.held],
                "advice": list(made.advice), "evaluations": made.evaluations, "spread": made.spread,
                "unsettled": made.unsettled,
            }  # fmt: skip
        self.folder.mkdir(parents=True, exist_ok=True)
        write_whole(self._path(candidate), json.dumps(said, indent=2) + "\n")

    def _path(self, candidate: Candidate) -> Path:
        return self.folder / (re.sub(r"[^a-z0-9]+", "_", candidate.name.lower()).strip("_") + ".json")


def _of(candidate: Candidate, limits: Limits, rule: Any) -> str:
    """A hash of all that a tuning follows from."""
    source = inspect.getsource(type(candidate.loop.control.law))
    loop = candidate.loop
    leaves = [(name, repr(value)) for name, value in tree.leaves(loop)]
    tables = [(name, list(map(repr, row))) for name, row in tree.tables(loop)]
    told = (
        candidate.name,
        tree.structure(loop),
        leaves,
        tables,
        limits,
        rule.velocity,
        rule.starts,
        rule.repeats,
        [list(tree.leaves(axis)) for axis in rule.also],
        versions(),
        source,
    )
    return hashlib.sha256(repr(told).encode()).hexdigest()
