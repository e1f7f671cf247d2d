"""The papers by name, the parallel run of their experiments, and the files that `reproduce` writes.

A page for each paper, an index of all claims, and the figures as JSON.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import queue
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

from feeddrive.files.atomic_io import new_directory
from feeddrive.files.provenance import versions
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.papers.claims import CELLS, Claim, Experiment, build
from feeddrive.report.page import render

PAPERS = ("altintas2009", "gordon2013", "beltran2013", "wu2017")


class Reproduced:
    """What is left of an experiment when its pictures are drawn: claims and a page."""

    def __init__(self, experiment: Experiment) -> None:
        self.name = experiment.name
        self.title = experiment.title
        self.claims: Sequence[Claim] = tuple(experiment.claims)
        self.sentence = experiment.sentence()
        self.table = experiment.table()
        self.page = build(experiment)


def chosen(paper: str) -> tuple[str, ...]:
    """The papers that a name means; `all` means every one. Raises ParameterError for a name that is none."""
    if paper == "all":
        return PAPERS
    if paper in PAPERS:
        return (paper,)
    near = get_close_matches(paper, (*PAPERS, "all"), 1)
    hint = f"; did you mean {near[0]}?" if near else "."
    raise ParameterError(f"paper '{paper}' is not known{hint} There are: {', '.join(PAPERS)}, all")


def run(paper: str, progress: Progress) -> Experiment:
    """The experiments of a paper. `progress` reports each step."""
    module = import_module(f"feeddrive.papers.{paper}")
    return getattr(module, paper)(progress)


def reproduce(papers: Sequence[str], progress: Progress) -> list[Reproduced]:
    """Run papers, in as many processes as there are processors. Raises CancelledError if `progress` is cancelled."""
    workers = min(len(papers), os.cpu_count() or 1)
    if workers == 1:
        return [Reproduced(run(paper, progress.named(paper))) for paper in papers]
    # a fresh interpreter each: a fork would copy the locks of the caller's threads
    context = multiprocessing.get_context("spawn")
    told: Any = context.Queue()
    with ProcessPoolExecutor(workers, context, _listen, (told,)) as pool:
        futures = [pool.submit(_reproduced, paper) for paper in papers]
        try:
            for paper, text in _heard(told, futures, progress):
                progress.step(text, part=paper)
            return [future.result() for future in futures]
        except BaseException:
            for child in multiprocessing.active_children():
                child.terminate()
            raise


_told: Any = None


def _listen(told: Any) -> None:
    global _told
    _told = told


class _Sent(Progress):
    """The progress in a process of its own: its steps go to the process that began it."""

    def __init__(self, paper: str) -> None:
        super().__init__()
        self._paper = paper

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        _told.put((self._paper, what))


def _reproduced(paper: str) -> Reproduced:
    return Reproduced(run(paper, _Sent(paper)))


def _heard(told: Any, futures: Sequence[Future[Reproduced]], progress: Progress) -> Iterator[tuple[str, str]]:
    """What the processes tell until all are done; the first error ends it."""
    while not all(future.done() for future in futures):
        if any(future.done() and future.exception() for future in futures):
            return
        try:
            yield told.get(timeout=0.1)
        except queue.Empty:
            progress.check()


def write_reproduced(reproduced: Sequence[Reproduced], out: str | Path) -> Path:
    """Write the directory whole or not at all, and return the path of the report to open.

    Raises FileError if `out` cannot be written, or is a directory that feeddrive did not write.
    """
    with new_directory(out) as folder:
        fill(folder, reproduced)
    return Path(out) / "report.html"


def fill(folder: Path, reproduced: Sequence[Reproduced]) -> None:
    """Write the files into a directory that was created before the work began."""
    for each in reproduced:
        name = "report" if len(reproduced) == 1 else each.name
        (folder / f"{name}.html").write_text(each.page, encoding="utf-8")
    if len(reproduced) > 1:
        (folder / "report.html").write_text(_index(reproduced), encoding="utf-8")
    (folder / "claims.json").write_text(json.dumps(_figures(reproduced), indent=2) + "\n", encoding="utf-8")


def _figures(reproduced: Sequence[Reproduced]) -> dict[str, object]:
    """All claims as plain figures; what is not finite is null."""
    papers = {
        each.name: [
            {
                "key": claim.key,
                "claim": claim.claim,
                "rule": claim.rule,
                "expected": claim.expected or claim.bounds,
                "least": claim.least,
                "most": claim.most,
                "got": claim.got if math.isfinite(claim.got) else None,
                "unit": claim.unit,
                "holds": claim.holds,
            }
            for claim in each.claims
        ]
        for each in reproduced
    }
    return {"versions": versions(), "papers": papers}


def _index(reproduced: Sequence[Reproduced]) -> str:
    return render(
        "papers.html",
        title="The four papers, reproduced",
        lead=[f"{each.title}: {each.sentence}" for each in reproduced],
        links=[(each.name, each.title) for each in reproduced],
        heads=CELLS,
        papers=reproduced,
    )
