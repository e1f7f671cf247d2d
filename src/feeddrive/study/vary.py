"""The varied quantities and choices of a study, and the sections `[[vary]]` that declare them.

Each section declares one varied factor, whose values are drawn at points of the unit cube.  The values appear as
columns in the table of rows; the numbers that follow from them replace numbers of the system, the reference or the
load.

[[vary]]
parameter = "axis.x.plant.stiffness"     # a path in the machine file; or reference.velocity, load.force
kind = "normal"                          # uniform (default), loguniform, normal, lognormal, triangular, discrete
nominal_N_per_um = 18                    # default: the value of the machine; units are part of the keys
deviation_percent = 4                    # of the nominal value, or deviation_N_per_um
tolerance_percent = 10                   # truncates to nominal ± tolerance; or least and most

[[vary]]
name = "wear"                            # one factor that scales several numbers; `add` adds to them likewise
scale = ["axis.x.friction_motor.coulomb", "axis.x.friction_motor.breakaway"]
least = 0.7
most = 1.6

[[vary]]
name = "position"                        # named settings of several numbers
parameters = ["axis.x.plant.stiffness_N_per_um", "axis.x.plant.damping"]
settings = { near = [21, 700], middle = [18, 700], far = [15.5, 650] }

[[vary]]
name = "identified"                      # several numbers with a joint normal distribution
parameters = ["axis.x.plant.mass_load", "axis.x.friction_load.coulomb"]
covariance = [[0.8, 0.1], [0.1, 2.5]]    # in SI; or deviations = [...] and correlations = [[...]]
within = 3                               # standard deviations; nominal = [...] as above

[[vary]]
choice = "row"                           # a law of the job, or a key of job or machine: "machine", "program.file"
values = ["today", "twice the gain"]
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol, TypeAlias

import numpy as np

from feeddrive.files.section import VARIED, Section, named, read_field, text
from feeddrive.files.toml_file import TomlTable
from feeddrive.language import block, quantity, units
from feeddrive.language.block import Declaration, Number, check_bounds
from feeddrive.language.errors import FeeddriveError, ParameterError, nearest, shown
from feeddrive.language.quantity import number
from feeddrive.study import distributions
from feeddrive.study.distributions import Discrete, Distribution, LogNormal, LogUniform, Normal, Triangular, Uniform

Nominal: TypeAlias = Callable[[str], float]  # the value of a path in the job


class Varied(Protocol):
    """A quantity or choice that varies in a study; it counts as one factor in the sensitivity analysis.

    Its members have the same meaning in every class that implements it.
    """

    @property
    def name(self) -> str:
        """The name of the factor."""
        ...

    @property
    def columns(self) -> Mapping[str, str]:
        """The SI unit of each column."""
        ...

    @property
    def dimensions(self) -> int:
        """The number of random numbers in (0, 1) per variant."""
        ...

    @property
    def paths(self) -> tuple[str, ...]:
        """The paths of the numbers that the factor changes; a choice has none."""
        ...

    @property
    def levels(self) -> np.ndarray | None:
        """The grid levels as numbers in [0, 1], shape (levels,), or None if there is no grid."""
        ...

    def at(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Return the value of each column at points u of shape (n, dimensions)."""
        ...

    def changes(self, values: Mapping[str, np.ndarray], nominal: Nominal) -> dict[str, np.ndarray]:
        """Return the numbers to set, by path, for the given column values; `nominal` returns the value of a path."""
        ...


@dataclass(frozen=True)
class Quantity:
    """A number with a distribution, which replaces, scales or is added to the values of its paths.

    mode   "set", "scale" or "add"
    steps  number of grid values, at evenly spaced probabilities from one end of the distribution to the other
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
        """One column in the unit of the number; dimensionless for a scale factor."""
        return {self.name: "" if self.mode == "scale" else self.unit}

    @property
    def levels(self) -> np.ndarray | None:
        """Levels evenly spaced from 0 to 1; for a discrete distribution, one level per value."""
        if isinstance(self.distribution, Discrete):
            return _edges_inside(self.distribution)
        if self.steps is None:
            return None
        # 0 and 1 give the ends of the range, which are finite on a grid. A single level is the median rather than an
        # end.
        return np.linspace(0.0, 1.0, self.steps) if self.steps > 1 else np.array([0.5])

    def at(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Return the quantiles of the distribution."""
        return {self.name: self.distribution.at(u[:, 0])}

    def changes(self, values: Mapping[str, np.ndarray], nominal: Nominal) -> dict[str, np.ndarray]:
        """Return, for each path, the drawn value, the nominal value times the drawn value, or the sum of both."""
        drawn = values[self.name]
        if self.mode == "set":
            return dict.fromkeys(self.paths, drawn)
        if self.mode == "scale":
            return {path: nominal(path) * drawn for path in self.paths}
        return {path: nominal(path) + drawn for path in self.paths}


@dataclass(frozen=True, eq=False)
class Joint:
    """Several numbers with a joint normal distribution, such as the result of an identification.

    x = mean + L z, L Lᵀ = covariance; mean of shape (n,), covariance (n, n), in SI units.  Each z is truncated to
    ±within.
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
        # Correlations are checked instead of covariances: variances in different units differ by decades, so one
        # tolerance would not fit.
        correlation = self.covariance / np.outer(scale, scale)
        if not np.allclose(correlation, correlation.T, rtol=0.0, atol=1e-9):
            raise ParameterError("a covariance must be symmetric")
        least = float(np.linalg.eigvalsh(correlation)[0])
        # Rounding makes the zero eigenvalues of a singular matrix slightly negative.
        if least < -1e-9:
            raise ParameterError(
                "a covariance must be positive semidefinite: the least eigenvalue of its correlations is "
                f"{number(least, 3)}"
            )
        if not self.within > 0.0:
            raise ParameterError(f"within = {number(self.within, 6)} deviations must be > 0")

    @property
    def columns(self) -> Mapping[str, str]:
        """One column per parameter."""
        return dict(zip(self.paths, self.units, strict=True))

    @property
    def dimensions(self) -> int:
        """One dimension per parameter."""
        return len(self.paths)

    @cached_property
    def _root(self) -> np.ndarray:
        """The factor L of the covariance, computed from the eigenvalues of the correlation matrix because this matrix
        may be singular.
        """
        scale = np.sqrt(np.diag(self.covariance))
        values, vectors = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        return scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))

    def at(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Return x = mean + L z; the order of summation does not depend on how the variants are split into chunks."""
        z = distributions.truncated(u, -self.within, self.within)
        drawn: dict[str, np.ndarray] = {}
        for i, path in enumerate(self.paths):
            # Not a matrix product, whose order of summation depends on the number of rows.
            total = np.full(len(z), self.mean[i])
            for j in range(len(self.paths)):
                total = total + self._root[i, j] * z[:, j]
            drawn[path] = total
        return drawn

    def changes(self, values: Mapping[str, np.ndarray], nominal: Nominal) -> dict[str, np.ndarray]:
        """Return the values unchanged."""
        return {path: values[path] for path in self.paths}


@dataclass(frozen=True, eq=False)
class Settings:
    """Named settings of several numbers at once: positions of an axis, payloads, machines of a fleet.

    rows  the values of all paths, by label, in SI units
    """

    name: str
    units: tuple[str, ...]
    paths: tuple[str, ...]
    rows: Mapping[str, tuple[float, ...]]
    weights: tuple[float, ...] = ()
    dimensions: int = 1

    @property
    def columns(self) -> Mapping[str, str]:
        """The single column, which holds the label of the setting; it has no unit."""
        return {self.name: ""}

    @cached_property
    def _labels(self) -> Discrete:
        return Discrete(tuple(self.rows), self.weights)

    @property
    def levels(self) -> np.ndarray:
        """One level per setting."""
        return _edges_inside(self._labels)

    def at(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Return the label of each variant."""
        return {self.name: self._labels.at(u[:, 0])}

    def changes(self, values: Mapping[str, np.ndarray], nominal: Nominal) -> dict[str, np.ndarray]:
        """Return the numbers of the setting that each label names."""
        table = np.array([self.rows[label] for label in values[self.name]])
        return {path: np.ascontiguousarray(table[:, i]) for i, path in enumerate(self.paths)}


@dataclass(frozen=True)
class Choice:
    """A key of the job or machine file that takes one of several values; it may change the structure of the system or
    its task.

    key  "row" for the job's laws by name, or a key of a file: "machine", "program.file", "axis.x.substeps"
    """

    key: str
    distribution: Discrete
    paths: tuple[str, ...] = ()
    dimensions: int = 1

    @property
    def name(self) -> str:
        """The name of the factor, which is its key."""
        return self.key

    @property
    def columns(self) -> Mapping[str, str]:
        """One dimensionless column."""
        return {self.key: ""}

    @property
    def levels(self) -> np.ndarray:
        """One level per value."""
        return _edges_inside(self.distribution)

    def at(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Return the chosen values."""
        return {self.key: self.distribution.at(u[:, 0])}

    def changes(self, values: Mapping[str, np.ndarray], nominal: Nominal) -> dict[str, np.ndarray]:
        """Return no changes, since the value of a choice is inserted into the files."""
        return {}


def _edges_inside(distribution: Discrete) -> np.ndarray:
    """Return, for each value with a positive weight, a number in (0, 1) at which the distribution takes it."""
    weights = np.array(distribution.weights or (1.0,) * len(distribution.values))
    shares = weights / weights.sum()
    return (np.cumsum(shares) - 0.5 * shares)[shares > 0.0]


Declared: TypeAlias = Callable[[str], Declaration]
"""A function that returns the declaration of a path, and raises ParameterError for an unknown path."""


class VarySection(Section):
    """A parameter or choice that varies between variants."""

    @classmethod
    def choose(cls, table: TomlTable) -> type[Section]:
        """Return the section class of a table; it follows from the keys of the table and the kind of distribution."""
        forms = [name for name in _FORMS if name in table.values]
        if len(forms) != 1:
            told = f", not {' and '.join(forms)}" if forms else ""
            raise table.error(f"{table.dotted()} needs one of {', '.join(_FORMS)}{told}")
        if forms[0] == "choice":
            return VaryChoice
        if forms[0] == "parameters":
            return VarySettings if "settings" in table.values else VaryJoint
        is_discrete = any(key == "values" or key.startswith("values_") for key in table.values)
        kind = table.values.get("kind", "discrete" if is_discrete else "uniform")
        if not isinstance(kind, str) or kind not in _DISTRIBUTIONS:
            raise table.error(f"kind = {shown(kind)} is no distribution{nearest(str(kind), _DISTRIBUTIONS)}", "kind")
        return _DISTRIBUTIONS[kind]


class VaryChoice(VarySection):
    """A law of the job, or a key of the job or its machine, that takes one of several values."""

    choice: str = text('"row", or a key of job or machine: "machine", "program.file"', shortest=1, example='"row"')
    values: tuple[str | bool | int | float, ...] = block.choice("of the key", default=())
    weights: np.ndarray | None = block.table("", "of the values; absent: equal ones", shortest=1, default=None)

    def check(self) -> None:
        """Raise ParameterError for missing or repeated values."""
        if not self.values:
            raise self.error(f"choice = '{self.choice}' needs values = [ ... ], texts or numbers", "values")
        # Compared as text: 1, 1.0 and true are equal in Python, but different values of a key.
        if len(set(map(repr, self.values))) < len(self.values):
            raise self.error("values has an entry twice: use weights = [ ... ]", "values")

    @property
    def varied(self) -> Choice:
        """The choice with its values and weights."""
        return Choice(self.choice, Discrete(self.values, _row(self.weights)))


class VaryNumber(VarySection):
    """A number with a distribution, or one that scales or is added to several numbers."""

    exactly: ClassVar[tuple[tuple[str, ...], ...]] = (("parameter",), ("scale",), ("add",))
    needs: ClassVar[str] = "a number that varies is one of parameter, scale and add"

    name: str | None = text(
        "of the column of results; of a parameter its path", shortest=1, default=None, example='"wear"'
    )
    parameter: str | None = text(
        "path of the number, as a machine file has it",
        default=None,
        example='"axis.x.plant.mass"; several that vary together are  scale = [...]  or  add = [...]',
    )
    scale: str | tuple[str, ...] | None = block.choice("paths of numbers that are multiplied by it", default=None)
    add: str | tuple[str, ...] | None = block.choice("paths of numbers that it is added to", default=None)
    nominal: Number | None = block.parameter(
        VARIED, "absent: the value of the machine; of scale 1, of add 0", default=None
    )
    steps: int | None = block.choice("values in a grid", least=1, default=None)

    @property
    def form(self) -> str:
        """The key that selects the form: parameter, scale or add."""
        return next(name for name in ("parameter", "scale", "add") if getattr(self, name) is not None)

    @property
    def paths(self) -> tuple[str, ...]:
        """The paths of the varied numbers."""
        paths = getattr(self, self.form)
        return paths if isinstance(paths, tuple) else (paths,)

    @abstractmethod
    def distribution(self, nominal: float) -> Distribution:
        """Return the distribution about a nominal value, in SI units. Raise ParameterError for inconsistent numbers."""


class _Ranged(VaryNumber):
    """A number that varies within a range."""

    least: Number | None = block.parameter(VARIED, "least value", default=None)
    most: Number | None = block.parameter(VARIED, "largest value", default=None)
    tolerance: Number | None = block.parameter(
        VARIED, "largest distance from nominal, in place of least and most", above=0, default=None
    )
    tolerance_percent: Number | None = block.parameter("", "the same in percent of nominal", above=0, default=None)

    def range(self, nominal: float) -> tuple[float, float]:
        """Return the least and the largest value, given directly or as a tolerance; infinite if there is no limit."""
        tolerance = _of_nominal(self, "tolerance", nominal)
        if tolerance is None:
            return _or(self.least, -math.inf), _or(self.most, math.inf)
        if self.least is not None or self.most is not None:
            raise ParameterError("give either a tolerance, or least and most")
        # A percentage of a nominal value of 0 is 0.
        if not tolerance > 0.0:
            raise ParameterError(f"tolerance = {quantity.Quantity(tolerance):6} must be > 0")
        return nominal - tolerance, nominal + tolerance


class VaryUniform(_Ranged, kind="uniform"):
    """A uniform distribution from least to most."""

    def distribution(self, nominal: float) -> Distribution:
        """Return the uniform distribution over the range."""
        return Uniform(*self.range(nominal))


class VaryLogUniform(_Ranged, kind="loguniform"):
    """A log-uniform distribution from least to most."""

    needs_kind: ClassVar[bool] = True

    def distribution(self, nominal: float) -> Distribution:
        """Return the log-uniform distribution over the range."""
        return LogUniform(*self.range(nominal))


class VaryNormal(_Ranged, kind="normal"):
    """A normal distribution about the nominal value, truncated to the range."""

    needs_kind: ClassVar[bool] = True

    deviation: Number | None = block.parameter(VARIED, "standard deviation", default=None)
    deviation_percent: Number | None = block.parameter("", "the same in percent of nominal", default=None)

    def distribution(self, nominal: float) -> Distribution:
        """Return the normal distribution about the nominal value."""
        deviation = _of_nominal(self, "deviation", nominal)
        least, most = self.range(nominal)
        if deviation is None:
            raise ParameterError("a normal distribution needs deviation")
        return Normal(nominal, deviation, least, most)


class VaryLogNormal(_Ranged, kind="lognormal"):
    """A log-normal distribution whose median is the nominal value, truncated to the range."""

    needs_kind: ClassVar[bool] = True

    ratio: Number = block.parameter("", "68 % lie within a factor of it about nominal")

    def distribution(self, nominal: float) -> Distribution:
        """Return the log-normal distribution whose median is the nominal value."""
        least, most = self.range(nominal)
        return LogNormal(nominal, self.ratio, 0.0 if least == -math.inf else least, most)


class VaryTriangular(_Ranged, kind="triangular"):
    """A triangular distribution over the range with its mode at the nominal value."""

    needs_kind: ClassVar[bool] = True

    def distribution(self, nominal: float) -> Distribution:
        """Return the triangular distribution with its mode at the nominal value."""
        least, most = self.range(nominal)
        return Triangular(least, nominal, most)


class VaryDiscrete(VaryNumber, kind="discrete"):
    """One of several values, with weights."""

    values: np.ndarray | None = block.table(VARIED, "values", shortest=1, default=None)
    weights: np.ndarray | None = block.table("", "of the values; absent: equal ones", shortest=1, default=None)

    def distribution(self, nominal: float) -> Distribution:
        """Return the discrete distribution of the values and weights."""
        if self.values is None:
            raise ParameterError("a discrete distribution needs values = [ ... ]")
        return Discrete(_row(self.values), _row(self.weights))


class _Several(VarySection):
    """Several numbers that vary together."""

    name: str = text("of the column of results", shortest=1, example='"position"')
    parameters: tuple[str, ...] = block.choice("paths as a machine file has them")


class VarySettings(_Several):
    """Several numbers that vary together, as named settings."""

    settings: Mapping[str, tuple[float, ...]] = named("the numbers by label, in the units that end the paths", least=1)
    weights: np.ndarray | None = block.table("", "of the settings; absent: equal ones", shortest=1, default=None)


class VaryJoint(_Several):
    """Several numbers with a joint normal distribution, in SI units."""

    nominal: np.ndarray | None = block.table("", "means; absent: the values of the machine", shortest=1, default=None)
    covariance: tuple[tuple[float, ...], ...] | None = block.choice("rows of the covariance", default=None)
    deviations: np.ndarray | None = block.table(
        "", "standard deviations, in place of covariance", shortest=1, default=None
    )
    correlations: tuple[tuple[float, ...], ...] | None = block.choice(
        "rows of the correlations beside deviations; absent: none", default=None
    )
    within: Number = block.parameter("", "deviations within which all numbers lie", default=math.inf, infinite=True)

    def covariances(self) -> np.ndarray:
        """Return the covariance, which is given directly or by standard deviations and correlations."""
        if (self.covariance is None) == (self.deviations is None):
            raise self.error(f"{self.dotted()} needs covariance = [[...]], or deviations = [...] with correlations")
        if self.covariance is not None:
            return _square(self, "covariance")
        deviations = np.array(self.deviations)
        correlations = np.eye(deviations.size) if self.correlations is None else _square(self, "correlations")
        if correlations.shape != (deviations.size, deviations.size) or not np.allclose(np.diag(correlations), 1.0):
            raise self.error(f"correlations must have {deviations.size} rows and columns and 1 on the diagonal")
        return correlations * np.outer(deviations, deviations)


_FORMS = ("parameter", "scale", "add", "parameters", "choice")
_DISTRIBUTIONS: Mapping[str, type[VaryNumber]] = {
    "uniform": VaryUniform,
    "loguniform": VaryLogUniform,
    "normal": VaryNormal,
    "lognormal": VaryLogNormal,
    "triangular": VaryTriangular,
    "discrete": VaryDiscrete,
}


def unit_varied(table: TomlTable, declared: Declared) -> str:
    """Return the unit of the varied numbers of a section, or an empty string for a scale factor."""
    form = next(name for name in _FORMS if name in table.values)
    if form == "scale":
        return ""
    # Read ahead of the section, whose numbers need this unit.
    stated = read_field(VaryNumber, table, form)
    paths = stated if isinstance(stated, tuple) else (stated,)
    if not paths:
        raise table.error(f"{form} must be a path as a machine file has it, such as axis.x.plant.mass", form)
    return _declared(table, form, paths[0], declared).unit


def varied(section: VarySection, declared: Declared, nominal: Nominal, grid: bool) -> Varied:
    """Convert a section to the varied factor that it declares.

    declared  returns the declaration of a path
    nominal   returns the value of a path in the job
    grid      True if the study's sampler is a grid

    Raises ParameterError with file, line, key, value, bound and unit.
    """
    try:
        if isinstance(section, VaryChoice):
            return section.varied
        if isinstance(section, VarySettings):
            return _settings(section, declared)
        if isinstance(section, VaryJoint):
            return _joint(section, declared, nominal, grid)
        assert isinstance(section, VaryNumber)
        return _number(section, declared, nominal, grid)
    except FeeddriveError as error:
        # An error that already names the file also names line and key.
        if section.read_from is None or str(error).startswith(section.read_from.file.name):
            raise
        raise section.error(f"{section.dotted()}: {error}") from None


def _number(section: VaryNumber, declared: Declared, nominal: Nominal, grid: bool) -> Quantity:
    """Convert a section to a varied number with its distribution."""
    form, paths = section.form, section.paths
    if not paths:
        raise section.error(f"{form} must be a path as a machine file has it, such as axis.x.plant.mass", form)
    of_paths = [_declared(section, form, path, declared) for path in paths]
    unit = "" if form == "scale" else of_paths[0].unit
    if form == "add" and any(declaration.unit != unit for declaration in of_paths):
        raise section.error("the paths of add must have one unit", form)
    name = section.name or section.parameter
    if name is None:
        raise section.error(f'{section.dotted()} needs a name, that of its column: name = "wear"')
    usual = nominal(paths[0]) if form == "parameter" else 1.0 if form == "scale" else 0.0
    try:
        distribution = section.distribution(_or(section.nominal, usual))
        for end in distribution.range():
            # Scaled and shifted values depend on the nominal value in each job, and are checked when a variant is
            # built.
            if form == "parameter" and math.isfinite(end):
                check_bounds(f"the {section.kind} distribution reaches {paths[0]}", of_paths[0], end)
    except FeeddriveError as error:
        raise section.error(f"{section.dotted()} ({name}): {error}") from None
    if grid and not isinstance(section, VaryDiscrete):
        _check_grid(section, name, distribution)
    if not grid and section.steps is not None:
        raise section.error('steps belongs to a grid: sampler = "grid"', "steps")
    mode = "set" if form == "parameter" else form
    return Quantity(name, unit, paths, distribution, mode, section.steps)


def _check_grid(section: VaryNumber, name: str, distribution: Distribution) -> None:
    if section.steps is None:
        raise section.error(
            f"{section.dotted()} ({name}): a grid needs values = [ ... ], or steps = the number of values"
        )
    low, high = distribution.range()
    if not (math.isfinite(low) and math.isfinite(high)) or (isinstance(distribution, LogNormal) and low <= 0.0):
        raise section.error(
            f"{section.dotted()} ({name}): a grid goes from end to end: give least and most, or a tolerance"
        )


def _of_nominal(section: VaryNumber, name: str, nominal: float) -> float | None:
    """Return a number of the section, which may be given directly or in percent of the nominal value."""
    value, percent = getattr(section, name), getattr(section, f"{name}_percent")
    if value is not None and percent is not None:
        raise ParameterError(f"{name} is given twice, as {name} and as {name}_percent; remove one")
    # The nominal value may be negative; a deviation or tolerance is not.
    return value if percent is None else abs(nominal) * units.scaled(percent, 1e-2)


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _row(values: np.ndarray | None) -> tuple[float, ...]:
    return () if values is None else tuple(values.tolist())


def _paths(section: _Several, declared: Declared) -> Iterator[tuple[str, Declaration, float]]:
    """Yield the path, declaration and factor to SI of each parameter. Raise ParameterError for a repeated path."""
    if not section.parameters:
        raise section.error("parameters must be a list of paths as a machine file has them", "parameters")
    entries = [_with_unit(section, written, declared) for written in section.parameters]
    if len({path for path, _, _ in entries}) < len(entries):
        raise section.error("parameters names a path twice", "parameters")
    yield from entries


def _settings(section: VarySettings, declared: Declared) -> Settings:
    """Convert a section to named settings."""
    paths, declarations, factors = zip(*_paths(section, declared), strict=True)
    rows: dict[str, tuple[float, ...]] = {}
    for label, values in section.settings.items():
        if len(values) != len(paths) or not all(map(math.isfinite, values)):
            raise section.error(
                f"{section.dotted('settings')}.{label} must be a list of {len(paths)} finite numbers: [1.0, 2.0]",
                ("settings", label),
            )
        rows[label] = tuple(map(units.scaled, values, factors))
        for path, declaration, value in zip(paths, declarations, rows[label], strict=True):
            try:
                check_bounds(path, declaration, value)
            except ParameterError as error:
                raise section.error(f"{section.dotted('settings')}.{label}: {error}", ("settings", label)) from None
    return Settings(
        section.name, tuple(declaration.unit for declaration in declarations), paths, rows, _row(section.weights)
    )


def _joint(section: VaryJoint, declared: Declared, nominal: Nominal, grid: bool) -> Joint:
    """Convert a section to a joint normal distribution."""
    paths, declarations, factors = zip(*_paths(section, declared), strict=True)
    if any(factor != 1.0 for factor in factors):
        raise section.error("a covariance is in SI: name the parameters without units", "parameters")
    if grid:
        raise section.error(
            f"{section.dotted()} ({section.name}): a common distribution has no grid; take another sampler"
        )
    mean = np.array([nominal(path) for path in paths]) if section.nominal is None else section.nominal
    covariance = section.covariances()
    try:
        return Joint(
            section.name,
            tuple(declaration.unit for declaration in declarations),
            paths,
            mean,
            covariance,
            section.within,
        )
    except ParameterError as error:
        raise section.error(f"{section.dotted()} ({section.name}): {error}") from None


def _square(section: VaryJoint, key: str) -> np.ndarray:
    rows: tuple[tuple[float, ...], ...] = getattr(section, key)
    if not all(len(row) == len(rows) for row in rows):
        raise section.error(f"{key} must be as many rows as columns: [[1, 0.2], [0.2, 1]]", key)
    for entry in (entry for row in rows for entry in row):
        if not math.isfinite(entry):
            raise section.error(f"{section.dotted(key)}: {shown(entry)} must be a finite number", key)
    return np.array(rows)


def _declared(place: Section | TomlTable, key: str, path: str, declared: Declared) -> Declaration:
    try:
        return declared(path)
    except FeeddriveError as error:
        raise place.error(f"{place.dotted(key)}: {error}", key) from None


def _with_unit(section: _Several, written: str, declared: Declared) -> tuple[str, Declaration, float]:
    """Return the path, declaration and conversion factor to SI of a path that may end in a unit."""
    head, dot, last = written.rpartition(".")
    words = last.split("_")
    # Longest name first: both names (mass_load) and units (N_per_um) contain underscores.
    for end in range(len(words), 0, -1):
        path = f"{head}{dot}{'_'.join(words[:end])}"
        try:
            declaration = declared(path)
        except FeeddriveError:
            continue
        suffix = "_".join(words[end:])
        try:
            return path, declaration, units.factor(suffix, declaration.unit) if suffix else 1.0
        except ParameterError as error:
            raise section.error(f"{section.dotted('parameters')}: '{written}': {error}", "parameters") from None
    return written, _declared(section, "parameters", written, declared), 1.0
