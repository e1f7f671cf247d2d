"""Stored designs, with exact tunables and figures per law and plant, and the searches for them."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from feeddrive.analysis.loop_model import loop_model
from feeddrive.benchmark.rules import Plant, Rules, folder
from feeddrive.blocks.catalogue import members, shipped
from feeddrive.blocks.families import Law
from feeddrive.comparison.figures import Values, linear
from feeddrive.comparison.tune_all import Rule, Tuning, tuned_all
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.figures.of_loops import NOISE_GAIN, ROPE_SNAP, SENSITIVITY_PEAK
from feeddrive.files.atomic_io import read_whole, write_whole
from feeddrive.files.run_files import versions
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, FileError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text
from feeddrive.language.units import rounded
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal, candidates
from feeddrive.tuning.tune import Tuned, own_tunables

STALE = 1e-4  # of a figure: a design whose figures differ by more belongs to another law, plant or rule
_LARGEST = 1_000_000  # bytes, largest size of a file
_KEPT = (ROPE_SNAP, SENSITIVITY_PEAK, NOISE_GAIN)


@dataclass(frozen=True)
class Design:
    """The tuned design of a law on a plant under the rules; `refused` is the reason if there is none.

    tunables   by dotted name within the control
    figures    by criterion key, at the nominal position; the design is stale once the recomputed figures differ
    noise      the noise-gain limit of its tuning, N/m; None for P-PI, which sets the limit
    held       the active constraints, as sentences
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
        """Return the control of a candidate with these tunables. Raises ParameterError if its tunables are
        different.
        """
        return tree.vary(candidate.loop.control, dict(self.tunables))

    def moved(self, figures: Values) -> str:
        """Return a sentence on the first stored figure whose value has changed; empty if none has."""
        for key, stored in self.figures.items():
            now = figures.get(key)
            if now is None or abs(now - stored) > STALE * abs(stored):
                present = None if now is None else number(now, 6)
                return f"{key} was {number(stored, 6)} when its design was stored and is {present}"
        return ""

    def stale(self, loop: Loop, rule: Rule) -> str:
        """Return why the design does not match the present code (a changed figure or noise limit); empty if it does."""
        moved = self.moved(_figures(loop, rule))
        if moved or self.noise is None or rule.noise is None or abs(self.noise / rule.noise - 1.0) <= STALE:
            return moved
        return Text(
            f"it was tuned to a noise bound of {Quantity(self.noise, 'N/m'):6 SI}, which is "
            f"{Quantity(rule.noise, 'N/m'):6 SI} now"
        )


@dataclass(frozen=True)
class Designs:
    """A directory of designs for one plant, one JSON file per law. The directories in `also` are only read from."""

    folder: Path
    plant: str
    rules: int
    also: tuple[Path, ...] = ()

    def design(self, law: str) -> Design | None:
        """Return the design of a law; None if there is none. Raises FileError if the file is not a valid design."""
        paths = (self._path(law, place) for place in (self.folder, *self.also))
        path = next((path for path in paths if path.is_file()), None)
        if path is None:
            return None
        try:
            content: dict[str, Any] = json.loads(read_whole(path, _LARGEST))
            content["tunables"] = {name: float.fromhex(value) for name, value in content["tunables"].items()}
            content["held"] = tuple(content["held"])
            del content["values"]
            design = Design(**content)
        except (ValueError, KeyError, TypeError, AttributeError):
            raise FileError(f"{path}: is no design of the benchmark: remove it, and it is searched anew") from None
        return design if (design.plant, design.rules) == (self.plant, self.rules) else None

    def write(self, design: Design) -> None:
        """Write a design atomically. Raises FileError if the directory cannot be written."""
        content = asdict(design)
        content["tunables"] = {name: float(value).hex() for name, value in design.tunables.items()}
        content["values"] = {name: rounded(value, 6) for name, value in design.tunables.items()}
        path = self._path(design.law, self.folder)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(content, indent=2, ensure_ascii=False) + "\n")

    def known(self, case: Tuning, progress: Progress) -> Tuned | Refusal | None:
        """Return the stored result of a law if its design is not stale. Called by the engine, for which this object is
        the result store.
        """
        design = self.design(case.name)
        if design is None:
            return None
        if design.refused:
            return Refusal(case.name, design.refused)
        try:
            if design.stale(replace(case.candidate.loop, control=design.control(case.candidate)), case.rule):
                return None
        except FeeddriveError:
            return None
        return replace(case.assessed(design.tunables, progress), unsettled=design.unsettled, spread=design.spread)

    def keep(self, case: Tuning, outcome: Tuned | Refusal) -> None:
        """Store the result of tuning a law. Called by the engine."""
        design = Design(case.name, self.plant, self.rules, noise=case.rule.noise, versions=versions())
        if isinstance(outcome, Refusal):
            self.write(replace(design, refused=outcome.reason))
            return
        self.write(
            replace(
                design,
                tunables=dict(outcome.tunables),
                figures=_figures(outcome.loops[0], case.rule),
                unsettled=outcome.unsettled,
                spread=outcome.spread,
                repeats=case.rule.repeats,
                evaluations=outcome.evaluations,
                held=tuple(bound.sentence() for bound in outcome.held),
            )
        )

    def _path(self, law: str, place: Path) -> Path:
        return place / self.plant / (re.sub(r"[^a-z0-9]+", "_", law.lower()).strip("_") + ".json")


def _figures(loop: Loop, rule: Rule) -> dict[str, float]:
    figures = linear(loop, loop_model(loop, velocity=rule.velocity))
    return {figure.key: float(value) for figure in _KEPT if (value := figures.get(figure.key)) is not None}


def searched(plant: Plant, laws: Sequence[str] = ()) -> list[Candidate]:
    """Return the laws to be tuned on a plant, P-PI included; `laws` restricts the selection; default: all."""
    possible, _ = candidates(plant.model)
    wanted = {PLAIN, *laws, *(law.like for law in possible if law.name in laws)} if laws else None
    return [
        law
        for law in possible
        if not law.like and own_tunables(law.loop.control) and (wanted is None or law.name in wanted)
    ]


def own_laws(plant: Plant, laws: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the names of the selected laws that are not shipped with feeddrive."""
    own = set(members(Law).values()) - set(shipped()[Law].values())
    names = (law.name for law in candidates(plant.model)[0] if type(law.loop.control.law) in own)
    return tuple(name for name in names if not laws or name in laws)


def search(
    rules: Rules,
    plants: Sequence[Plant],
    keep: Path,
    *,
    laws: Sequence[str] = (),
    engine: Engine | None = None,
    stored: bool = False,
    progress: Progress | None = None,
) -> None:
    """Tune laws on plants, and write each design to `keep` as soon as it is found.

    stored  use the designs stored in the package as well

    A law whose stored design is not stale is not tuned again, so an interrupted search can be resumed. `engine` runs
    the searches; its own store is replaced.
    Raises FileError if the folder cannot be written, CancelledError if cancelled.
    """
    engine, progress = engine or Engine(), progress or Progress()
    for plant in plants:
        laws_here = searched(plant, laws)
        also = (folder(rules.version) / "designs",) if stored else ()
        designs = Designs(keep, plant.name, rules.version, also)
        bar = Bar(progress, Tuning.stages * len(laws_here))
        tuned_all(laws_here, rules.rule(plant), replace(engine, store=designs), bar)
