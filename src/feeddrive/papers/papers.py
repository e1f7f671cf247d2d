"""The papers by name, and their experiments run side by side."""

from __future__ import annotations

import multiprocessing
import os
import queue
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from difflib import get_close_matches
from importlib import import_module
from typing import Any

from feeddrive.language.errors import ParameterError
from feeddrive.papers.claims import Claim, Experiment
from feeddrive.papers.page import build

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


def run(paper: str, step: Callable[[str], None]) -> Experiment:
    """The experiments of a paper. `step(text)` is called before each piece of work."""
    module = import_module(f"feeddrive.papers.{paper}")
    return getattr(module, paper)(step)


def reproduce(papers: Sequence[str], step: Callable[[str, str], None]) -> list[Reproduced]:
    """Run papers, in as many processes as there are processors; `step(paper, text)` tells of the progress."""
    workers = min(len(papers), os.cpu_count() or 1)
    if workers == 1:
        return [Reproduced(run(paper, lambda text, paper=paper: step(paper, text))) for paper in papers]
    # a fresh interpreter each: a fork would copy the threads' locks of whoever calls
    context = multiprocessing.get_context("spawn")
    told: Any = context.Queue()
    with ProcessPoolExecutor(workers, context, _listen, (told,)) as pool:
        futures = [pool.submit(_reproduced, paper) for paper in papers]
        try:
            for paper, text in _heard(told, futures):
                step(paper, text)
            return [future.result() for future in futures]
        except BaseException:
            for child in multiprocessing.active_children():
                child.terminate()
            raise


_told: Any = None


def _listen(told: Any) -> None:
    global _told
    _told = told


def _reproduced(paper: str) -> Reproduced:
    return Reproduced(run(paper, lambda text: _told.put((paper, text))))


def _heard(told: Any, futures: Sequence[Future[Reproduced]]) -> Iterator[tuple[str, str]]:
    """What the processes tell until all are done; the first error ends it."""
    while not all(future.done() for future in futures):
        if any(future.done() and future.exception() for future in futures):
            return
        try:
            yield told.get(timeout=0.1)
        except queue.Empty:
            continue
