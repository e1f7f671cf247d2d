"""A section `[[vary]]` of a study file.

[[vary]]
parameter = "axis.x.plant.stiffness"     # a path, as a machine file has it; or reference.velocity, load.force
kind = "normal"                          # uniform (default), loguniform, normal, lognormal, triangular, discrete
nominal_N_per_um = 18                    # default: the value of the machine; units stand in the keys
deviation_percent = 4                    # of the nominal value, or deviation_N_per_um
tolerance_percent = 10                   # truncates to nominal ± tolerance; or least and most
[[vary]]
name = "wear"                            # one factor on several numbers; `add` adds to them in the same way
scale = ["axis.x.friction_motor.coulomb", "axis.x.friction_motor.breakaway"]
least = 0.7
most = 1.6
[[vary]]
name = "position"                        # several numbers together, by label
parameters = ["axis.x.plant.stiffness_N_per_um", "axis.x.plant.damping"]
settings = { near = [21, 700], middle = [18, 700], far = [15.5, 650] }
[[vary]]
name = "identified"                      # several numbers with a common normal distribution
parameters = ["axis.x.plant.mass_load", "axis.x.friction_load.coulomb"]
covariance = [[0.8, 0.1], [0.1, 2.5]]    # in SI; or deviations = [...] and correlations = [[...]]
within = 3                               # deviations; nominal = [...] as above
[[vary]]
choice = "row"                           # a law of the job, or a key of job or machine: "machine", "program.file"
values = ["today", "twice the gain"]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from feeddrive.files.toml_file import Section
from feeddrive.language import quantity, units
from feeddrive.language.declaration import Declaration, check_bounds
from feeddrive.language.errors import FeeddriveError, ParameterError, nearest, shown
from feeddrive.study.distributions import Discrete, Distribution, LogNormal, LogUniform, Normal, Triangular, Uniform
from feeddrive.study.vary import Choice, Joint, Quantity, Settings, Varied

Declared: TypeAlias = Callable[[str], Declaration]
"""The declaration of a path. Raises ParameterError for a path that is not there."""
Nominal: TypeAlias = Callable[[str], float]

_KINDS = ("uniform", "loguniform", "normal", "lognormal", "triangular", "discrete")
_FORMS = ("parameter", "scale", "add", "parameters", "choice")
_TEXTS = ("name", "kind", "steps", "weights", *_FORMS)
_NUMBERS = {
    "uniform": ("least", "most", "tolerance"),
    "loguniform": ("least", "most", "tolerance"),
    "normal": ("deviation", "least", "most", "tolerance"),
    "lognormal": ("ratio", "least", "most", "tolerance"),
    "triangular": ("least", "most", "tolerance"),
    "discrete": ("values",),
}
_OF_NOMINAL = ("tolerance", "deviation")  # which may be given in percent of the nominal value


def read_varied(section: Section, declared: Declared, nominal: Nominal, grid: bool) -> Varied:
    """What a section varies.

    declared  of a path;  nominal  its value in the job;  grid  whether the study's sampler is a grid

    Raises ParameterError with file, line, key, value, bound and unit.
    """
    forms = [name for name in _FORMS if name in section.values]
    if len(forms) != 1:
        told = f", not {' and '.join(forms)}" if forms else ""
        raise section.error(f"{section.dotted()} needs one of {', '.join(_FORMS)}{told}")
    try:
        match forms[0]:
            case "choice":
                return _choice(section)
            case "parameters":
                return _several(section, declared, nominal, grid)
            case form:
                return _quantity(section, form, declared, nominal, grid)
    except FeeddriveError as error:
        text = str(error)
        raise error if text.startswith(section.file.name) else section.error(f"{section.dotted()}: {text}") from None


def _choice(section: Section) -> Choice:
    section.refuse_unknown(("choice", "values", "weights"))
    key, values = section.values["choice"], section.values.get("values")
    if not isinstance(key, str) or not key:
        raise section.error('choice must be a key of the job or its machine: choice = "row"', "choice")
    if not isinstance(values, list) or not values or not all(isinstance(each, str | int | float) for each in values):
        raise section.error(f"choice = '{key}' needs values = [ ... ], texts or numbers", "values")
    if len(set(map(repr, values))) < len(values):
        raise section.error("values has an entry twice: use weights = [ ... ]", "values")
    return Choice(key, Discrete(tuple(values), _weights(section)))


def _quantity(section: Section, form: str, declared: Declared, nominal: Nominal, grid: bool) -> Quantity:
    """A number with a distribution."""
    kind = section.values.get("kind", "discrete" if any(_is(key, "values") for key in section.values) else "uniform")
    if kind not in _KINDS:
        raise section.error(f"kind = {shown(kind)} is no distribution{nearest(str(kind), _KINDS)}", "kind")
    given = section.values[form]
    paths = tuple(given) if isinstance(given, list) else (given,)
    if form == "parameter" and isinstance(given, list):
        raise section.error(
            "parameter is one path; several that vary together are  scale = [...]  or  add = [...]", form
        )
    if not paths or not all(isinstance(path, str) for path in paths):
        raise section.error(f"{form} must be a path as a machine file has it, such as axis.x.plant.mass", form)
    found = [_declared(section, form, path, declared) for path in paths]
    scale = form == "scale"
    own = found[0] if form == "parameter" else Declaration(role="", unit="" if scale else found[0].unit, meaning=form)
    if any(each.unit != own.unit for each in found if form == "add"):
        raise section.error("the paths of add must have one unit", form)
    name = _name(section, paths[0] if form == "parameter" else None)
    default = nominal(paths[0]) if form == "parameter" else 1.0 if scale else 0.0
    numbers = _Numbers(section, own.unit, kind, default)
    try:
        made = numbers.distribution()
        for end in made.range():
            if form == "parameter" and math.isfinite(end):
                check_bounds(f"the {kind} distribution reaches {paths[0]}", own, end)
    except FeeddriveError as error:
        raise section.error(f"{section.dotted()} ({name}): {error}") from None
    steps = section.values.get("steps")
    if steps is not None and (isinstance(steps, bool) or not isinstance(steps, int) or steps < 1):
        raise section.error(f"steps = {shown(steps)} must be a whole number >= 1", "steps")
    if grid and kind != "discrete":
        _check_grid(section, name, made, steps)
    if not grid and steps is not None:
        raise section.error('steps belongs to a grid: sampler = "grid"', "steps")
    mode = "set" if form == "parameter" else form
    return Quantity(name, own.unit, paths, made, mode, steps)


def _check_grid(section: Section, name: str, made: Distribution, steps: Any) -> None:
    if steps is None:
        raise section.error(
            f"{section.dotted()} ({name}): a grid needs values = [ ... ], or steps = the number of values"
        )
    low, high = made.range()
    if not (math.isfinite(low) and math.isfinite(high)) or (isinstance(made, LogNormal) and low <= 0.0):
        raise section.error(
            f"{section.dotted()} ({name}): a grid goes from end to end: give least and most, or a tolerance"
        )


def _is(key: str, name: str) -> bool:
    return key == name or key.startswith(f"{name}_")


@dataclass(frozen=True)
class _Numbers:
    """The numbers of a section with a distribution, in SI."""

    section: Section
    unit: str
    kind: str
    default: float

    def distribution(self) -> Distribution:
        """The distribution of the kind. Raises ParameterError for unknown, missing or impossible numbers."""
        known = ("nominal", *_NUMBERS[self.kind])
        for key in self.section.values:
            if key not in _TEXTS and not any(_is(key, name) for name in known):
                raise self.section.error(
                    f"key '{self.section.dotted(key)}' is not known to a {self.kind} distribution"
                    f"{nearest(key, (*_TEXTS, *known))}", key
                )  # fmt: skip
        if self.kind == "discrete":
            return Discrete(self._values(), _weights(self.section))
        nominal = self._one("nominal", self.default)
        assert nominal is not None
        least, most = self._range(nominal)
        match self.kind:
            case "normal":
                return Normal(nominal, self._needed("deviation", nominal), _or(least, -math.inf), _or(most, math.inf))
            case "lognormal":
                return LogNormal(nominal, self._needed("ratio", nominal), _or(least, 0.0), _or(most, math.inf))
            case "triangular":
                return Triangular(_or(least, -math.inf), nominal, _or(most, math.inf))
            case "loguniform":
                return LogUniform(_or(least, -math.inf), _or(most, math.inf))
            case _:
                return Uniform(_or(least, -math.inf), _or(most, math.inf))

    def _range(self, nominal: float) -> tuple[float | None, float | None]:
        """Least and most, given so or as a tolerance."""
        least, most, tolerance = self._one("least"), self._one("most"), self._one("tolerance", None, nominal)
        if tolerance is None:
            return least, most
        if least is not None or most is not None:
            raise ParameterError("give either a tolerance, or least and most")
        if not tolerance > 0.0:
            raise ParameterError(f"tolerance = {quantity.Quantity(tolerance, self.unit):6 SI} must be > 0")
        return nominal - tolerance, nominal + tolerance

    def _needed(self, name: str, nominal: float) -> float:
        found = self._one(name, None, nominal)
        if found is None:
            raise ParameterError(f"a {self.kind} distribution needs {name}")
        return found

    def _one(self, name: str, default: float | None = None, nominal: float | None = None) -> float | None:
        """A number by its name, with or without a unit in its key."""
        key = self._key(name)
        if key is None:
            return default
        value = self.section.values[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.section.error(f"{self.section.dotted(key)} = {shown(value)} must be a finite number", key)
        suffix = key[len(name) + 1 :]
        if suffix == "percent" and name in _OF_NOMINAL:
            assert nominal is not None
            return abs(nominal) * units.scaled(float(value), 1e-2)
        return self._in_SI(key, suffix, float(value), "" if name == "ratio" else self.unit)

    def _in_SI(self, key: str, suffix: str, value: float, unit: str) -> float:
        try:
            return units.scaled(value, units.factor(suffix, unit)) if suffix else value
        except ParameterError as error:
            raise self.section.error(f"key '{self.section.dotted(key)}': {error}", key) from None

    def _key(self, name: str) -> str | None:
        """The key of a number. Raises ParameterError if it is given twice."""
        keys = [key for key in self.section.values if _is(key, name)]
        if len(keys) > 1:
            raise self.section.error(f"{name} is given twice, as {keys[0]} and as {keys[1]}; remove one", keys[1])
        return keys[0] if keys else None

    def _values(self) -> tuple[float, ...]:
        key = self._key("values")
        if key is None:
            raise ParameterError("a discrete distribution needs values = [ ... ]")
        row = _row(self.section, key)
        return tuple(self._in_SI(key, key[len("values") + 1 :], value, self.unit) for value in row)


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _several(section: Section, declared: Declared, nominal: Nominal, grid: bool) -> Varied:
    """Several numbers together: by label, or with a common normal distribution."""
    given = section.values["parameters"]
    if not isinstance(given, list) or not given or not all(isinstance(each, str) for each in given):
        raise section.error("parameters must be a list of paths as a machine file has them", "parameters")
    found = [_with_unit(section, "parameters", each, declared) for each in given]
    paths = tuple(path for path, _, _ in found)
    if len(set(paths)) < len(paths):
        raise section.error("parameters names a path twice", "parameters")
    own, factors = tuple(each.unit for _, each, _ in found), [factor for _, _, factor in found]
    name = _name(section, None)
    if "settings" in section.values:
        section.refuse_unknown(("name", "parameters", "settings", "weights"))
        settings = section.section("settings")
        rows = {label: _row(settings, label, len(paths)) for label in settings.values}
        scaled = {label: tuple(map(units.scaled, row, factors)) for label, row in rows.items()}
        for label, row in scaled.items():
            for (path, each, _), value in zip(found, row, strict=True):
                _bounded(settings, label, path, each, value)
        return Settings(name, own, paths, scaled, _weights(section))
    section.refuse_unknown(("name", "parameters", "nominal", "covariance", "deviations", "correlations", "within"))
    if any(factor != 1.0 for factor in factors):
        raise section.error("a covariance is in SI: name the parameters without units", "parameters")
    if grid:
        raise section.error(f"{section.dotted()} ({name}): a common distribution has no grid; take another sampler")
    mean = [nominal(path) for path in paths] if "nominal" not in section.values else _row(section, "nominal")
    within = section.values.get("within", math.inf)
    if isinstance(within, bool) or not isinstance(within, int | float):
        raise section.error(f"within = {shown(within)} must be a number of deviations", "within")
    try:
        return Joint(name, own, paths, np.array(mean), _covariance(section), float(within))
    except ParameterError as error:
        raise section.error(f"{section.dotted()} ({name}): {error}") from None


def _covariance(section: Section) -> np.ndarray:
    """The covariance, given so or by deviations and correlations."""
    if ("covariance" in section.values) == ("deviations" in section.values):
        raise section.error(f"{section.dotted()} needs covariance = [[...]], or deviations = [...] with correlations")
    if "covariance" in section.values:
        return _square(section, "covariance")
    deviations = np.array(_row(section, "deviations"))
    correlations = np.eye(deviations.size)
    if "correlations" in section.values:
        correlations = _square(section, "correlations")
    if correlations.shape != (deviations.size, deviations.size) or not np.allclose(np.diag(correlations), 1.0):
        raise section.error(f"correlations must have {deviations.size} rows and columns and 1 on the diagonal")
    return correlations * np.outer(deviations, deviations)


def _square(section: Section, key: str) -> np.ndarray:
    rows = section.values[key]
    if not isinstance(rows, list) or not all(isinstance(row, list) and len(row) == len(rows) for row in rows):
        raise section.error(f"{key} must be as many rows as columns: [[1, 0.2], [0.2, 1]]", key)
    return np.array([_numbers(section, key, row) for row in rows])


def _row(section: Section, key: str, length: int | None = None) -> tuple[float, ...]:
    value = section.values[key]
    if not isinstance(value, list) or not value or (length is not None and len(value) != length):
        count = "" if length is None else f"{length} "
        raise section.error(f"{section.dotted(key)} must be a list of {count}numbers: [1.0, 2.0]", key)
    return _numbers(section, key, value)


def _numbers(section: Section, key: str, row: Sequence[Any]) -> tuple[float, ...]:
    for each in row:
        if isinstance(each, bool) or not isinstance(each, int | float) or not math.isfinite(each):
            raise section.error(f"{section.dotted(key)}: {shown(each)} must be a finite number", key)
    return tuple(map(float, row))


def _bounded(section: Section, label: str, path: str, declared: Declaration, value: float) -> None:
    try:
        check_bounds(path, declared, value)
    except ParameterError as error:
        raise section.error(f"{section.dotted(label)}: {error}", label) from None


def _weights(section: Section) -> tuple[float, ...]:
    return _row(section, "weights") if "weights" in section.values else ()


def _name(section: Section, otherwise: str | None) -> str:
    name = section.values.get("name", otherwise)
    if not isinstance(name, str) or not name:
        raise section.error(f'{section.dotted()} needs a name, that of its column: name = "wear"', "name")
    return name


def _declared(section: Section, key: str, path: str, declared: Declared) -> Declaration:
    try:
        return declared(path)
    except FeeddriveError as error:
        raise section.error(f"{section.dotted(key)}: {error}", key) from None


def _with_unit(section: Section, key: str, given: str, declared: Declared) -> tuple[str, Declaration, float]:
    """Path, declaration and factor to SI of a path that may end with a unit."""
    head, dot, last = given.rpartition(".")
    words = last.split("_")
    for end in range(len(words), 0, -1):
        path = f"{head}{dot}{'_'.join(words[:end])}"
        try:
            found = declared(path)
        except FeeddriveError:
            continue
        suffix = "_".join(words[end:])
        try:
            return path, found, units.factor(suffix, found.unit) if suffix else 1.0
        except ParameterError as error:
            raise section.error(f"{section.dotted(key)}: '{given}': {error}", key) from None
    return given, _declared(section, key, given, declared), 1.0
