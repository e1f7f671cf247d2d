"""Stored designs: the tunables of a law on a plant to the last bit, how they were found, and what they gave."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from feeddrive.analysis.loop_model import loop_model
from feeddrive.comparison.figures import linear
from feeddrive.comparison.tune_all import Rule, Tuning
from feeddrive.figures.of_loops import NOISE_GAIN, ROPE_SNAP, SENSITIVITY_PEAK
from feeddrive.files.atomic_io import read_whole, write_whole
from feeddrive.files.run_files import versions
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, FileError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import Candidate, Refusal
from feeddrive.tuning.tune import Tuned

STALE = 1e-4  # of a figure: a design whose figures have moved by more belongs to another law, plant or rule
_LARGEST = 1_000_000  # bytes of a file
_KEPT = (ROPE_SNAP, SENSITIVITY_PEAK, NOISE_GAIN)


@dataclass(frozen=True)
class Design:
    """What a law came to on a plant under the rules; `refused` says why it has no design.

    tunables   by dotted name of the control
    figures    by key of a criterion, at the nominal position: a design is stale once they have moved
    noise      N/m: the bound that it was tuned to; None for P-PI, which makes the bound
    held       the bounds that hold it back, in sentences
    """

    law: str
    plant: str
    rules: int
    tunables: Mapping[str, float] = field(default_factory=dict[str, float])
    figures: Mapping[str, float] = field(default_factory=dict[str, float])
    noise: float | None = None
    refused: str = ""
    unsettled: str = ""
    spread: float = 0.0
    repeats: int = 0
    evaluations: int = 0
    held: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict[str, str])

    def control(self, candidate: Candidate) -> Control:
        """The control of a candidate with these tunables. Raises ParameterError if it has others."""
        return tree.vary(candidate.loop.control, dict(self.tunables))

    def stale(self, loop: Loop, rule: Rule) -> str:
        """Why it does not belong to the present code: what its figures have become; empty if it does."""
        there = _figures(loop, rule)
        for key, value in self.figures.items():
            now = there.get(key)
            if now is None or abs(now - value) > STALE * abs(value):
                return (
                    f"{key} was {number(value, 6)} when it was stored and is {now if now is None else number(now, 6)}"
                )
        if self.noise is not None and rule.noise is not None and abs(self.noise / rule.noise - 1.0) > STALE:
            return Text(
                f"it was tuned to a noise bound of {Quantity(self.noise, 'N/m'):6 SI}, which is "
                f"{Quantity(rule.noise, 'N/m'):6 SI} now"
            )
        return ""


@dataclass(frozen=True)
class Designs:
    """A directory of designs of one plant: a JSON file a law. `also` are directories that are read only."""

    folder: Path
    plant: str
    rules: int
    also: tuple[Path, ...] = ()

    def design(self, law: str) -> Design | None:
        """The design of a law; None if there is none. Raises FileError for a file that is not one."""
        there = (path for place in (self.folder, *self.also) if (path := self._path(law, place)).is_file())
        path = next(there, None)
        if path is None:
            return None
        try:
            said: dict[str, Any] = json.loads(read_whole(path, _LARGEST))
            said["tunables"] = {name: float.fromhex(value) for name, value in said["tunables"].items()}
            said.pop("values")
            said["held"] = tuple(said["held"])
            found = Design(**said)
        except (ValueError, KeyError, TypeError, AttributeError):
            raise FileError(f"{path}: is no design of the benchmark: remove it, and it is searched anew") from None
        return found if (found.plant, found.rules) == (self.plant, self.rules) else None

    def write(self, design: Design) -> None:
        """Write a design, whole or not at all. Raises FileError if the directory cannot be written."""
        said = asdict(design)
        said["tunables"] = {name: float(value).hex() for name, value in design.tunables.items()}
        said["values"] = {name: float(f"{value:.6g}") for name, value in design.tunables.items()}
        path = self._path(design.law, self.folder)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(said, indent=2, ensure_ascii=False) + "\n")

    def known(self, case: Tuning, progress: Progress) -> Tuned | Refusal | None:
        """What a law came to, if its design is not stale; for the engine, whose store of searches this is."""
        design = self.design(case.name)
        if design is None:
            return None
        if design.refused:
            return Refusal(case.name, design.refused)
        try:
            loop = replace(case.candidate.loop, control=design.control(case.candidate))
            if design.stale(loop, case.rule):
                return None
        except FeeddriveError:
            return None
        return replace(case.assessed(design.tunables, progress), unsettled=design.unsettled, spread=design.spread)

    def keep(self, case: Tuning, outcome: Tuned | Refusal) -> None:
        """Keep what a law came to; for the engine."""
        one = Design(case.name, self.plant, self.rules, noise=case.rule.noise, versions=versions())
        if isinstance(outcome, Refusal):
            self.write(replace(one, refused=outcome.reason))
            return
        self.write(
            replace(
                one,
                tunables=dict(outcome.tunables),
                figures=_figures(outcome.loops[0], case.rule),
                unsettled=outcome.unsettled,
                spread=outcome.spread,
                repeats=case.rule.repeats,
                evaluations=outcome.evaluations,
                held=tuple(each.sentence() for each in outcome.held),
            )
        )

    def _path(self, law: str, place: Path) -> Path:
        return place / self.plant / (re.sub(r"[^a-z0-9]+", "_", law.lower()).strip("_") + ".json")


def _figures(loop: Loop, rule: Rule) -> dict[str, float]:
    found = linear(loop, loop_model(loop, velocity=rule.velocity))
    return {figure.key: float(value) for figure in _KEPT if (value := found.get(figure.key)) is not None}
