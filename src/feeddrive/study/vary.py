"""The varied things of a study, quantities and choices: their values at points of the unit cube.

Each `[[vary]]` of a study file is one of these.  Its columns are what the table of rows shows, its changes what is put
into the system, the reference or the load, by path.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeAlias

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import number
from feeddrive.study.distributions import Discrete, Distribution, truncated

Nominal: TypeAlias = Callable[[str], float]  # the value of a path in the job


class Varied(Protocol):
    """One thing that varies, and one factor of a sensitivity.

    Its fields have these meanings in all kinds.
    """

    @property
    def name(self) -> str:
        """The name of the factor."""
        ...

    @property
    def columns(self) -> Mapping[str, str]:
        """SI unit by column."""
        ...

    @property
    def dimensions(self) -> int:
        """How many numbers in (0, 1) each variant needs."""
        ...

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths of the numbers that it changes; none for a choice."""
        ...

    @property
    def levels(self) -> np.ndarray | None:
        """The numbers of (0, 1) of a grid, shape (levels,); None if it has none."""
        ...

    def at(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Return values by column at points u of shape (n, dimensions)."""
        ...

    def changes(self, values: Mapping[str, np.ndarray], nominal: Nominal) -> dict[str, np.ndarray]:
        """Return the numbers by path that follow from values of the columns."""
        ...


@dataclass(frozen=True)
class Quantity:
    """A number with a distribution, which sets paths, is a factor of their values or is added to them.

    mode   "set", "scale" or "add"
    steps  of a grid: values that are evenly spread from end to end of the distribution
    """

    name: str
    unit: str
    paths: tuple[str, ...]
    distribution: Distribution
    mode: str = "set"
    steps: int | None = None
    dimensions: int = 1

    @property
    def columns(self) -> Mapping[str, str]:
        """One column in the unit of the number; without unit for a factor."""
        return {self.name: "" if self.mode == "scale" else self.unit}

    @property
    def levels(self) -> np.ndarray | None:
        """Evenly spaced from 0 to 1; of a discrete distribution one level for each of its values."""
        if isinstance(self.distribution, Discrete):
            return _edges_inside(self.distribution)
        if self.steps is None:
            return None
        return np.linspace(0.0, 1.0, self.steps) if self.steps > 1 else np.array([0.5])

    def at(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """The quantiles of the distribution."""
        return {self.name: self.distribution.at(u[:, 0])}

    def changes(self, values: Mapping[str, np.ndarray], nominal: Nominal) -> dict[str, np.ndarray]:
        """The drawn value, or the nominal value of each path times or plus the drawn one."""
        drawn = values[self.name]
        if self.mode == "set":
            return dict.fromkeys(self.paths, drawn)
        if self.mode == "scale":
            return {path: nominal(path) * drawn for path in self.paths}
        return {path: nominal(path) + drawn for path in self.paths}


@dataclass(frozen=True, eq=False)
class Joint:
    """Several numbers with a common normal distribution, such as the result of an identification.

    x = mean + L z, L Lᵀ = covariance; mean of shape (n,), covariance (n, n), in SI.  Each z is truncated to ±within.
    """

    name: str
    units: tuple[str, ...]
    paths: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray
    within: float = np.inf
    levels: None = None

    def __post_init__(self) -> None:
        n = len(self.paths)
        if self.mean.shape != (n,) or self.covariance.shape != (n, n):
            raise ParameterError(
                f"{n} parameters need {n} nominal values and a covariance of {n} rows and columns, not "
                f"{self.mean.size} and {' x '.join(map(str, self.covariance.shape))}"
            )
        if not np.all(np.isfinite(self.mean)) or not np.all(np.isfinite(self.covariance)):
            raise ParameterError("nominal values and covariance must be finite numbers")
        if not np.all(np.diag(self.covariance) > 0.0):
            raise ParameterError("the variances on the diagonal of a covariance must be > 0")
        scale = np.sqrt(np.diag(self.covariance))
        correlation = self.covariance / np.outer(scale, scale)
        if not np.allclose(correlation, correlation.T, rtol=0.0, atol=1e-9):
            raise ParameterError("a covariance must be symmetric")
        least = float(np.linalg.eigvalsh(correlation)[0])
        if least < -1e-9:
            raise ParameterError(
                "a covariance must be positive semidefinite: the least eigenvalue of its correlations is "
                f"{number(least, 3)}"
            )
        if not self.within > 0.0:
            raise ParameterError(f"within = {number(self.within, 6)} deviations must be > 0")

    @property
    def columns(self) -> Mapping[str, str]:
        """A column for each parameter."""
        return dict(zip(self.paths, self.units, strict=True))

    @property
    def dimensions(self) -> int:
        """A dimension for each parameter."""
        return len(self.paths)

    @cached_property
    def _root(self) -> np.ndarray:
        """L of the covariance, by eigenvalues of the correlations: it may be singular."""
        scale = np.sqrt(np.diag(self.covariance))
        values, vectors = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        return scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))

    def at(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """x = mean + L z, summed in one order for every split."""
        z = truncated(u, -self.within, self.within)
        drawn: dict[str, np.ndarray] = {}
        for i, path in enumerate(self.paths):
            total = np.full(len(z), self.mean[i])
            for j in range(len(self.paths)):
                total = total + self._root[i, j] * z[:, j]
            drawn[path] = total
        return drawn

    def changes(self, values: Mapping[str, np.ndarray], nominal: Nominal) -> dict[str, np.ndarray]:
        """The values themselves."""
        return {path: values[path] for path in self.paths}


@dataclass(frozen=True, eq=False)
class Settings:
    """Named settings of several numbers at once: positions of an axis, payloads, machines of a fleet.

    rows  by label the numbers of all paths, in SI
    """

    name: str
    units: tuple[str, ...]
    paths: tuple[str, ...]
    rows: Mapping[str, tuple[float, ...]]
    weights: tuple[float, ...] = ()
    dimensions: int = 1

    @property
    def columns(self) -> Mapping[str, str]:
        """The label; the numbers follow from it."""
        return {self.name: ""}

    @cached_property
    def _labels(self) -> Discrete:
        return Discrete(tuple(self.rows), self.weights)

    @property
    def levels(self) -> np.ndarray:
        """One for each setting."""
        return _edges_inside(self._labels)

    def at(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """The label of each variant."""
        return {self.name: self._labels.at(u[:, 0])}

    def changes(self, values: Mapping[str, np.ndarray], nominal: Nominal) -> dict[str, np.ndarray]:
        """The numbers of the labels."""
        table = np.array([self.rows[label] for label in values[self.name]])
        return {path: np.ascontiguousarray(table[:, i]) for i, path in enumerate(self.paths)}


@dataclass(frozen=True)
class Choice:
    """A key of the job or of its machine that takes one of several values, and with it the structure or the work.

    key  "row" for the job's laws by name, or a key of a file: "machine", "program.file", "axis.x.substeps"
    """

    key: str
    distribution: Discrete
    paths: tuple[str, ...] = ()
    dimensions: int = 1

    @property
    def name(self) -> str:
        """The key."""
        return self.key

    @property
    def columns(self) -> Mapping[str, str]:
        """One column without unit."""
        return {self.key: ""}

    @property
    def levels(self) -> np.ndarray:
        """One for each value."""
        return _edges_inside(self.distribution)

    def at(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """The chosen values."""
        return {self.key: self.distribution.at(u[:, 0])}

    def changes(self, values: Mapping[str, np.ndarray], nominal: Nominal) -> dict[str, np.ndarray]:
        """Return nothing: the value of a choice is read into the files."""
        return {}


def _edges_inside(distribution: Discrete) -> np.ndarray:
    """For each value a number of (0, 1) that gives it; none for a value of weight 0."""
    weights = np.array(distribution.weights or (1.0,) * len(distribution.values))
    shares = weights / weights.sum()
    return (np.cumsum(shares) - 0.5 * shares)[shares > 0.0]
