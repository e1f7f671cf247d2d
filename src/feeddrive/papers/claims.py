"""The claims of a paper and the rules that decide them, with parallel execution of the experiments and their output
files.

The output is one page per paper, an index of all claims, and the figures as JSON.

Random set motions and readings serve to compare a block with an independent evaluation of its paper's equations.
"""

import json
import math
import multiprocessing
import os
import queue
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.run_files import versions
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.language.units import factor
from feeddrive.report.page import html
from feeddrive.report.report import Marked, Picture, Remarks, Report, Section, Verdict, facts

# SI unit and name of a unit in which a paper states its figures, where that is no SI unit
_STATED = {
    "nm": ("m", "nm"),
    "um": ("m", "um"),
    "µm": ("m", "um"),
    "mm": ("m", "mm"),
    "ms": ("s", "ms"),
    "%": ("share", "%"),
    "um/N": ("m/N", "um/N"),
    "µm/N": ("m/N", "um/N"),
    "N/µm": ("N/m", "N/um"),
    "µm/s": ("m/s", "um/s"),
    "kN": ("N", "kN"),
    "kW": ("W", "kW"),
}


def stated(value: float, unit: str = "", digits: str = "4", *, bare: bool = False) -> Quantity:
    """Convert a figure in the unit of its paper to an SI quantity that is displayed in that unit."""
    si, name = _STATED.get(unit, (unit, unit))
    size = 100.0 if si == "share" else factor(si, name) if si != name else 1.0
    return Quantity(value / size, si, form=f"{digits} {name}", bare=bare)


# largest difference from an exact value, in SI units or as a share, that rounding and the hold of a sample may leave
ROUNDING = 1e-4
ORDER = "an order, for which no figure was given"
# of a claim whose figure is a difference from another computation or a closed form
DIFFERENCE = "a difference, which is never less than 0"
# why the bounds of `kept` stand: no other computation of the figure is known
KEPT = "computed here, held to 10 %: guards against change, no truth"


# of a difference over its error, a share of a bound, or a pole: less would be as good
LESS = "less would be as good"


def printed(figure: str) -> tuple[float, float]:
    """Return the least and the largest number that rounds to a printed figure: half a unit of its last digit."""
    mantissa = figure.lower().partition("e")[0]
    digits = len(mantissa.partition(".")[2])
    half = 0.5 * 10.0**-digits * (float(figure) / float(mantissa))
    return float(figure) - half, float(figure) + half


def quotient(above: str, below: str, known: float = 0.0, *, known_below: float | None = None) -> tuple[float, float]:
    """Return the bounds of the quotient of two printed figures.

    known        share to which the quotient is known beyond the digits, e.g. 0.2
    known_below  share to which the figure below is known; `known` then belongs to the figure above
    """
    (low, high), (least, most) = printed(above), printed(below)
    if known_below is None:
        return (1.0 - known) * low / most, (1.0 + known) * high / least
    return (1.0 - known) * low / ((1.0 + known_below) * most), (1.0 + known) * high / ((1.0 - known_below) * least)


def within(expected: float, share: float) -> tuple[float, float]:
    """Return the bounds of a figure that is known to a share."""
    return (1.0 - share) * expected, (1.0 + share) * expected


def kept(figure: float) -> tuple[float, float]:
    """Return the bounds of a figure that was computed here alone; its rule must have the words of `KEPT`."""
    return within(figure, 0.1)


@dataclass(frozen=True)
class Claim:
    """A falsifiable statement: it holds if  least <= got <= most  (a bound may be absent).

    key        key of the row, e.g. "1.d"
    claim      the statement, as a sentence
    rule       the conditions that make both sides comparable, with plant, noise and seed
    got        the computed figure, in `unit`
    expected   the expected result in words; if empty, it is given by the bounds
    equations  equations of shipped blocks, such as "DADSC (4)"; the claim must fail if one of them is changed
    one_sided  why there is one bound and no figure to either side, e.g. ORDER; not needed for a difference whose bound
               is that of rounding (`ROUNDING`)
    """

    key: str
    claim: str
    rule: str
    got: float
    least: float | None = None
    most: float | None = None
    unit: str = ""
    expected: str = ""
    equations: tuple[str, ...] = ()
    one_sided: str = ""

    def __post_init__(self) -> None:
        for name in ("key", "claim", "rule", "expected", "one_sided"):
            object.__setattr__(self, name, Text(getattr(self, name)))

    @property
    def holds(self) -> bool:
        """True if the figure lies within its bounds; NaN is never within them."""
        above = self.least is None or self.got >= self.least
        below = self.most is None or self.got <= self.most
        # NaN fails no comparison if both bounds are absent
        return above and below and not math.isnan(self.got)

    @property
    def unexplained(self) -> bool:
        """True if the claim accepts anything above or below its bound and does not say why."""
        if self.least is not None and self.most is not None:
            return False
        # a difference from 0, which is never less
        exact = self.most is not None and 0.0 < float(stated(self.most, self.unit).value) <= ROUNDING
        return not exact and not self.one_sided

    @property
    def bounds(self) -> Text:
        """The bounds as text, with the unit."""
        if self.least is not None and self.most is not None:
            return Text(f"{stated(self.least, self.unit, bare=True)} to {stated(self.most, self.unit)}")
        if self.least is not None:
            return Text(f"at least {stated(self.least, self.unit)}")
        if self.most is not None:
            return Text(f"at most {stated(self.most, self.unit)}")
        return Text(f"any number {self.unit}".rstrip())

    @property
    def shown(self) -> Quantity:
        """The computed figure as a quantity in SI units, displayed in `unit`."""
        return stated(self.got, self.unit)

    def cells(self) -> list[str]:
        """Return the cells of the table row as strings."""
        bounds = Text(f"{self.bounds}; {self.one_sided}") if self.one_sided else self.bounds
        expected = Text(f"{self.expected} ({bounds})") if self.expected else bounds
        verdict = "holds" if self.holds else "DOES NOT HOLD"
        return [self.key, self.claim, self.rule, expected, Text(f"{self.shown}"), verdict]

    def row(self) -> list[str | Quantity]:
        """Return the table row, with the computed figure as a number."""
        cells = self.cells()
        return [*cells[:4], self.shown, cells[5]]


CELLS = ("row", "claim", "rule", "expected", "got", "holds?")


@dataclass(frozen=True, eq=False, repr=False)
class Experiment(Result):
    """The experiments of one paper: claims, further tables, pictures, facts about the runs, and remarks.

    name      name on the command line, e.g. "altintas2009"
    citation  authors, title, journal, year
    """

    name: str
    title: str
    citation: str
    claims: Sequence[Claim]
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    facts: Mapping[str, str] = field(default_factory=dict[str, str])
    notes: Sequence[str] = ()

    @property
    def broken(self) -> list[Claim]:
        """The claims that do not hold."""
        return [claim for claim in self.claims if not claim.holds]

    def table(self) -> Table:
        """Return the table of claims."""
        return Table(self.title, CELLS, [claim.row() for claim in self.claims])

    def sentence(self) -> str:
        """Return a sentence stating how many claims hold and which do not."""
        held = len(self.claims) - len(self.broken)
        if not self.broken:
            return f"All {held} claims hold."
        listed = ", ".join(claim.key for claim in self.broken)
        return f"{held} of {len(self.claims)} claims hold; these do not: {listed}."


def paper_report(experiment: Experiment) -> Report:
    """Return the report of an experiment, with failed claims highlighted."""
    first, further = experiment.pictures[:1], experiment.pictures[1:]
    return Report(
        experiment.title,
        "feeddrive reproduce",
        Verdict((experiment.sentence(), experiment.citation), good=not experiment.broken),
        (
            Section("claims", "Claims", (claims_table(experiment.claims), Remarks(experiment.notes))),
            Section("tables", "Tables", experiment.tables),
            Section("pictures", "Pictures", further),
            facts("What was run", experiment.facts),
        ),
        next(iter(first), None),
    )


def claims_table(claims: Sequence[Claim]) -> Marked:
    """Tabulate claims; those that do not hold are highlighted."""
    broken = [number for number, claim in enumerate(claims) if not claim.holds]
    return Marked(Table("", CELLS, [claim.cells() for claim in claims]), alert=broken, text=True)


PAPERS = ("altintas2009", "gordon2013", "beltran2013", "wu2017")
# what was measured, by name, with the file of its log as it is published
MEASURED = {"emps": "DATA_EMPS.mat", "bench": "MultisineTypeA.mat"}


class Reproduced:
    """The result of an experiment in a form that can be pickled: its claims, and its report as HTML."""

    def __init__(self, experiment: Experiment) -> None:
        self.name = experiment.name
        self.title = experiment.title
        self.claims: Sequence[Claim] = tuple(experiment.claims)
        self.sentence = experiment.sentence()
        self.table = experiment.table()
        # in the process of the paper: pictures hold functions, which cannot be pickled
        self.page = html(paper_report(experiment))


def chosen(paper: str) -> tuple[str, ...]:
    """Return the papers selected by a name; `all` selects every paper. Raises ParameterError for an unknown name."""
    if paper == "all":
        return PAPERS
    if paper in PAPERS:
        return (paper,)
    near = get_close_matches(paper, (*PAPERS, "all"), 1)
    hint = f"; did you mean {near[0]}?" if near else "."
    raise ParameterError(f"paper '{paper}' is not known{hint} There are: {', '.join(PAPERS)}, all")


def run(paper: str, progress: Progress) -> Experiment:
    """Run the experiments of a paper. `progress` reports each step."""
    module = import_module(f"feeddrive.papers.{paper}")
    return getattr(module, paper)(progress)


def reproduce(papers: Sequence[str], progress: Progress) -> list[Reproduced]:
    """Run the experiments of papers in as many processes as there are processors. Raises CancelledError if `progress`
    is cancelled.
    """
    workers = min(len(papers), os.cpu_count() or 1)
    if workers == 1:
        return [Reproduced(run(paper, progress.named(paper))) for paper in papers]
    # a fresh interpreter each: a fork would copy the locks of the caller's threads
    context = multiprocessing.get_context("spawn")
    # a Progress cannot be pickled: processes send the texts of their steps
    steps: Any = context.Queue()
    with ProcessPoolExecutor(workers, context, _listen, (steps,)) as pool:
        futures = [pool.submit(_reproduced, paper) for paper in papers]
        try:
            for paper, text in _received(steps, futures, progress):
                progress.step(text, part=paper)
            return _results(futures)
        # also Ctrl-C: a pool waits for its processes otherwise, which may take minutes
        except BaseException:
            for child in multiprocessing.active_children():
                child.terminate()
            raise


# set in each process when it starts: a queue can be inherited, but not sent with a task
_steps: Any = None


def _listen(steps: Any) -> None:
    global _steps
    _steps = steps


class _Sent(Progress):
    """A progress reporter for a separate process; it sends its steps to the parent process."""

    def __init__(self, paper: str) -> None:
        super().__init__()
        self._paper = paper

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        _steps.put((self._paper, what))


def _reproduced(paper: str) -> Reproduced:
    return Reproduced(run(paper, _Sent(paper)))


def _received(steps: Any, futures: Sequence[Future[Reproduced]], progress: Progress) -> Iterator[tuple[str, str]]:
    """Yield the progress steps of the processes until all are done or one has failed."""
    while not all(future.done() for future in futures):
        # the caller raises the error by `result` of the future
        if any(future.done() and future.exception() for future in futures):
            return
        try:
            # short, so that a cancel is noticed between two steps of the papers
            yield steps.get(timeout=0.1)
        except queue.Empty:
            progress.check()


def _results(futures: Sequence[Future[Reproduced]]) -> list[Reproduced]:
    """Return the results of all papers, or, as soon as one has failed, raise its error."""
    failed = [future for future in futures if future.done() and future.exception()]
    return [future.result() for future in failed or futures]


def write_reproduced(reproduced: Sequence[Reproduced], out: str | Path) -> Path:
    """Write the directory completely or not at all, and return the path of the report to open.

    Raises FileError if `out` cannot be written, or is a directory that feeddrive did not write.
    """
    with new_directory(out) as folder:
        fill(folder, reproduced)
    return Path(out) / "report.html"


def fill(folder: Path, reproduced: Sequence[Reproduced]) -> None:
    """Write the files into a directory that was created before the run started."""
    for paper in reproduced:
        # a single paper needs no index: its page is the report
        name = "report" if len(reproduced) == 1 else paper.name
        (folder / f"{name}.html").write_text(paper.page, encoding="utf-8")
    if len(reproduced) > 1:
        (folder / "report.html").write_text(html(index_report(reproduced)), encoding="utf-8")
    (folder / "claims.json").write_text(json.dumps(_figures(reproduced), indent=2) + "\n", encoding="utf-8")


def _figures(reproduced: Sequence[Reproduced]) -> dict[str, object]:
    """Return all claims with plain numbers; NaN and infinity are null."""
    papers = {
        paper.name: [
            {
                "key": claim.key,
                "claim": claim.claim,
                "rule": claim.rule,
                "expected": claim.expected or claim.bounds,
                "least": claim.least,
                "most": claim.most,
                "got": claim.got if math.isfinite(claim.got) else None,
                "unit": claim.unit,
                "one_sided": claim.one_sided,
                "holds": claim.holds,
                "equations": list(claim.equations),
            }
            for claim in paper.claims
        ]
        for paper in reproduced
    }
    return {"versions": versions(), "papers": papers}


def index_report(reproduced: Sequence[Reproduced]) -> Report:
    """Return the index page, with links to the reports of the papers."""
    return Report(
        "The four papers, reproduced",
        "feeddrive reproduce",
        Verdict(
            (f"{paper.title}: {paper.sentence}" for paper in reproduced),
            good=all(claim.holds for paper in reproduced for claim in paper.claims),
        ),
        [
            Section(paper.name, paper.title, (claims_table(paper.claims),), file=f"{paper.name}.html")
            for paper in reproduced
        ],
    )


SAMPLES = 80
RANDOM = f"{SAMPLES} samples of random readings and forces, seed 7, along a set motion of the fourth degree"


class RandomMotion:
    """A set motion x(t), a random polynomial of fourth degree with exact derivatives; x in m, t in s."""

    def __init__(self, seed: int = 7) -> None:
        # each derivative has the size that it has on a machine: m, m/s, m/s², m/s³, m/s⁴
        sizes = np.array([1e-2, 0.1, 1.0, 30.0, 800.0])
        whole = np.poly1d((sizes * np.random.default_rng(seed).normal(size=5))[::-1])
        self.derivatives: list[Callable[[Any], Any]] = [whole.deriv(i) if i else whole for i in range(5)]

    def __call__(self, order: int, t: np.ndarray) -> np.ndarray:
        """Return the derivative of the given order at times t."""
        return np.asarray(self.derivatives[order](t), dtype=float)

    def setpoints(self, t: np.ndarray) -> list[Setpoint]:
        """Return the setpoints at times t."""
        return [Setpoint(*row) for row in np.stack([self(i, t) for i in range(5)], axis=1).tolist()]


class RandomReadings:
    """Random readings of two encoders (m), and forces applied and requested (N), each of shape (n,); the forces are
    initially 0.
    """

    def __init__(self, way: RandomMotion, t: np.ndarray, seed: int = 7, size: float = 1e-4) -> None:
        random = np.random.default_rng(seed)
        self.motor, self.load = (way(0, t) + size * random.normal(size=t.size) for _ in range(2))
        self.applied, self.requested = 50.0 * random.normal(size=(2, t.size))
        # the equations of the papers assume that a law starts without a force
        self.applied[0] = self.requested[0] = 0.0

    def readings(self) -> list[Reading]:
        """Return the readings as the blocks' input type."""
        rows = np.stack([self.motor, self.load, self.applied, self.requested], axis=1).tolist()
        return [Reading(*row) for row in rows]


def stepped(
    law: Law, T: float, setpoints: Sequence[Setpoint], readings: Sequence[Reading]
) -> tuple[list[Any], np.ndarray]:
    """Return the states and forces of a law that starts at the first reading, both from the second sample onward."""
    prepared = law.prepare(T)
    state = law.start(prepared, setpoints[0], readings[0])
    states, forces = [], []
    for setpoint, reading in zip(setpoints[1:], readings[1:], strict=True):
        state, force = law.step(prepared, state, setpoint, reading, T)
        states.append(state)
        forces.append(force)
    return states, np.array(forces)


def misfit(actual: Sequence[Any] | np.ndarray, expected: np.ndarray) -> float:
    """Return the largest absolute difference relative to the largest expected value."""
    return float(np.max(np.abs(np.asarray(actual, dtype=float) - expected)) / np.max(np.abs(expected)))
