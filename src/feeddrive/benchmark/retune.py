"""The searches of the benchmark: each law that has no design on a plant yet, or a stale one; resumable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from feeddrive.benchmark.designs import Designs
from feeddrive.benchmark.rules import Plant, Rules, folder
from feeddrive.blocks.catalogue import members, shipped
from feeddrive.blocks.families import Law
from feeddrive.comparison.tune_all import Tuning, tuned_all
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.language.progress import Progress
from feeddrive.tuning.candidates import PLAIN, Candidate, candidates
from feeddrive.tuning.tune import own_tunables


def searched(plant: Plant, laws: Sequence[str] = ()) -> list[Candidate]:
    """The laws that are searched on a plant, P-PI among them; `laws` are those that are wanted; default: all."""
    possible, _ = candidates(plant.model)
    needed = {PLAIN, *laws, *(each.like for each in possible if each.name in laws)}
    return [
        each
        for each in possible
        if not each.like and own_tunables(each.loop.control) and (not laws or each.name in needed)
    ]


def own_laws(plant: Plant, laws: Sequence[str] = ()) -> tuple[str, ...]:
    """The names of laws that are not shipped with feeddrive, of those that are wanted."""
    own = set(members(Law).values()) - set(shipped()[Law].values())
    possible, _ = candidates(plant.model)
    found = (each.name for each in possible if type(each.loop.control.law) in own)
    return tuple(name for name in found if not laws or name in laws)


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
    """Search laws on plants and keep each design in `keep` as it is found.

    stored  take the designs of the package as known

    A design that is known and not stale is not searched again, so that a search that was stopped goes on; `engine` is
    where laws are searched, whatever its store is.
    Raises FileError if the folder cannot be written, CancelledError at a cancel.
    """
    engine, progress = engine or Engine(), progress or Progress()
    for plant in plants:
        found = searched(plant, laws)
        also = (folder(rules.version) / "designs",) if stored else ()
        designs = Designs(keep, plant.name, rules.version, also)
        bar = Bar(progress, Tuning.stages * len(found))
        tuned_all(found, rules.rule(plant), replace(engine, store=designs), bar)
