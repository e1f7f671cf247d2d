"""A figure of merit of a loop, a run or a machine, declared once for studies, comparisons and tunings.

    RIPPLE = Figure("force_ripple_rms_N", "force ripple", "N", "run", lambda run: float(np.std(run["force"])))

A study can measure a figure, and a comparison can rank by it. A tuning can optimize it if it has a `Goal`, and keep it
within a limit if it has a `Limitable`. The entries are in `of_loops.py` and `of_runs.py`; packages add their own
(`catalogue.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import USUAL, Quantity, number
from feeddrive.language.table import Column
from feeddrive.language.text import Text
from feeddrive.language.units import in_key

if TYPE_CHECKING:
    from feeddrive.figures.slopes import JudgedLoop, Place, Slope, SlopedLoop
    from feeddrive.loop.simulate import Batch

STATISTICS, MODEL, RUN, DUTY = "statistics", "model", "run", "duty"
NEEDS = (STATISTICS, MODEL, RUN, DUTY)
"""What a figure is computed from: see `Figure.needs`."""
LOWER, HIGHER, NEUTRAL = "lower", "higher", ""
BETTER = (LOWER, HIGHER, NEUTRAL)


@dataclass(frozen=True)
class Goal:
    """The declaration of a figure as the goal of a tuning.

    name      name of the goal on the command line
    what      the quantity in words, such as `dynamic stiffness`
    of        function of (loop, band in Hz) that returns the quantity to minimize
    slope     function of (loop with derivatives, band in Hz) that returns its logarithm with derivatives
    banded    True if the quantity depends on the band
    on_table  True if it refers to a force on the table, so a response to such a force should be known
    returns   True if it measures how fast the axis recovers from a disturbance, so it needs integral action
    """

    name: str
    what: str
    of: Callable[[JudgedLoop, tuple[float, float]], float]
    slope: Callable[[SlopedLoop, tuple[float, float]], Slope]
    banded: bool = False
    on_table: bool = True
    returns: bool = False


@dataclass(frozen=True)
class Limitable:
    """The declaration of a figure that a tuning can keep within a limit.

    option, meaning, entered  the command-line option, its help text, and the unit of its value
    places    function of (loop, limit, noise of both readings in m) that yields a `Place` for each frequency near the
              limit, or returns them as columns (`Places`)
    where     function that returns the critical frequency of a loop in Hz, if there is one
    usual     the default limit
    above, below  range of admissible limits; a limit is relaxed by scaling its distance from `origin`
    order     sort key of the bounds in a search
    noise     True if the figure depends on the noise of the readings
    """

    option: str
    meaning: str
    places: Callable[[SlopedLoop, float, tuple[float, float]], Iterable[Place]]
    where: Callable[[JudgedLoop], float | None]
    order: int
    entered: str = ""
    usual: float | None = None
    above: float = 0.0
    below: float | None = None
    origin: float = 0.0
    noise: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class Figure:
    """A figure of merit; two figures with the same key are equal.

    key      name in files, with the SI unit at the end: following_error_rms_m
    title    name in words
    unit     SI unit
    needs    argument of `of`: "statistics", "model" or "run"; "duty" if a comparison computes the figure itself
    of       function that returns the figure: for `Statistics` the values of all variants, shape (n,); for a
             `LinearLoop` or a Run, a number or None
    better   "lower", "higher", or empty if neither is better
    meaning  a longer title
    short    a shorter title, for a column of numbers
    label    the title in the table of a tuned loop
    form     digits in a comparison, and the unit if it is not the usual one
    absent   value for a model without this figure, such as an infinite margin for a loop without a crossover
    signals  signals whose statistics it needs, by their names on a single axis
    tuned    True if a tuning reports it
    compared  True if a tuning also reports when it gets worse
    judges_laws  True if a comparison and the benchmark judge every law by it, from the linear model
    goal     how a tuning optimizes it
    limit    how a tuning keeps it within a limit
    """

    key: str
    title: str
    unit: str
    needs: str
    of: Callable[[Any], Any] | None = None
    better: str = LOWER
    meaning: str = ""
    short: str = ""
    label: str = ""
    form: str = "3"
    absent: float | None = None
    signals: tuple[str, ...] = ()
    tuned: bool = False
    compared: bool = False
    judges_laws: bool = False
    goal: Goal | None = None
    limit: Limitable | None = None

    def __post_init__(self) -> None:
        for name, value, allowed in (("needs", self.needs, NEEDS), ("better", self.better, BETTER)):
            if value not in allowed:
                raise ParameterError(f"figure '{self.key}': {name} = {value!r} must be one of {', '.join(allowed)}")
        # a file holds the key and a bare number: without the unit in the key the number could not be read
        if self.unit and not self.key.endswith(f"_{in_key(self.unit)}"):
            raise ParameterError(f"figure '{self.key}' must end with its unit: ..._{in_key(self.unit)}")
        if self.of is None and self.needs != DUTY:
            raise ParameterError(f"figure '{self.key}' needs `of`, which computes it")

    def __repr__(self) -> str:
        return f"Figure({self.key!r})"  # identical in every process, because hashes are computed from it

    # by the key alone: functions are equal only to themselves, which pickling does not preserve
    def __eq__(self, other: object) -> bool:
        return isinstance(other, Figure) and other.key == self.key

    def __hash__(self) -> int:
        return hash(self.key)

    @property
    def description(self) -> str:
        """The meaning of the figure, or its title if there is none."""
        return self.meaning or self.title

    @property
    def higher(self) -> bool:
        """True if a larger value is better."""
        return self.better == HIGHER

    def read(self, source: Any) -> Any:
        """Return the value for a loop or a run; None if it does not exist."""
        assert self.of is not None
        return self.of(source)

    def value(self, source: Any) -> Any:
        """Return the value for a loop or a run; `absent` if it does not exist."""
        value = self.read(source)
        return self.absent if value is None else value

    def quantity(self, value: float | None) -> Quantity | None:
        """Return a value with its unit; None if the value is None."""
        return None if value is None else Quantity(value, self.unit)

    def shown(self, value: float) -> Quantity:
        """Return a value with its unit, rounded to the number of digits used when designs are compared."""
        return Quantity(value, self.unit, form=self.form)

    def bare(self, value: float) -> str:
        """Return a value without its unit, as `Text` markup; "never" for an infinite time."""
        if math.isinf(value):
            return "never" if self.unit == "s" else "∞"
        return f"{replace(self.shown(value), bare=True)}"

    def column(self, head: str = "") -> Column:
        """Return the column of this figure in a table."""
        return Column(head or self.title, self.unit, self.form)

    @property
    def scale(self) -> float:
        """The factor from SI to the usual unit of the figure."""
        return USUAL.of(self.unit)[1]


@dataclass(frozen=True)
class Limit:
    """A limit of a figure in SI units: a lower limit if a larger value is better, otherwise an upper limit."""

    figure: Figure
    bound: float

    def __post_init__(self) -> None:
        limit = self.figure.limit
        if limit is None:
            raise ParameterError(f"no tuning can keep a limit of '{self.figure.key}': it has no slopes")
        if not (np.isfinite(self.bound) and self.bound > limit.above):
            raise ParameterError(
                f"{self.figure.key} = {number(self.bound, 6)} must be a finite number > {number(limit.above)}"
            )
        if limit.below is not None and not self.bound < limit.below:
            raise ParameterError(f"{self.figure.key} = {number(self.bound, 6)} must be < {number(limit.below)}")

    @property
    def declared(self) -> Limitable:
        """The declaration of the limited figure for a tuning."""
        assert self.figure.limit is not None
        return self.figure.limit

    @property
    def text(self) -> Text:
        """The limit in words."""
        sign = ">=" if self.figure.higher else "<="
        return Text(f"{self.figure.title} {sign} {Quantity(self.bound, self.figure.unit)}")

    def keeps(self, value: float | None, room: float = 0.0) -> bool:
        """Return True if a value satisfies the limit within the tolerance `room`, a fraction of the limit.

        An absent value satisfies it.
        """
        if value is None:
            return True
        # a phase margin of -30 deg is as far from -1 as one of 30 deg
        size = abs(value)
        return size >= (1.0 - room) * self.bound if self.figure.higher else size <= (1.0 + room) * self.bound

    def used(self, value: float | None) -> float:
        """Return the utilization of the limit at a value: above 1 if the limit is violated; 0 for an absent value."""
        if value is None:
            return 0.0
        # a stiffness of 0 exceeds every limit; it must not divide by zero on the way
        size = max(abs(value), 1e-300)
        return self.bound / size if self.figure.higher else size / self.bound

    def eased(self, factor: float) -> Limit:
        """Return the limit relaxed by a factor."""
        # Ms is never below 1: only its distance from there can be relaxed by a factor
        origin = self.declared.origin
        bound = self.bound / factor if self.figure.higher else origin + factor * (self.bound - origin)
        return Limit(self.figure, bound)


@dataclass(frozen=True, eq=False)
class Statistics:
    """The statistics of one axis in a batch: `rms("force")` is an array over the variants.

    `port` is the prefix of the axis's signals, such as `x.` in a machine.
    """

    batch: Batch
    port: str = ""

    def rms(self, signal: str) -> np.ndarray:
        """Return the RMS of a signal over the run, for all variants."""
        return self.batch.rms[f"{self.port}{signal}"]

    def peak(self, signal: str) -> np.ndarray:
        """Return the largest absolute value of a signal over the run, for all variants."""
        return self.batch.peak[f"{self.port}{signal}"]
