"""A box of plants: the tolerances of an axis within which the bounds of a control shall hold."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from feeddrive.blocks.families import Plant
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.quantity import Quantity, number, span
from feeddrive.language.text import Text, joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.loop import Loop

# units of the parameters that are uncertain, and the power of the factor of the tolerance that each takes: the square
# of a frequency is a stiffness over a mass
_MASS = {"kg": 1.0, "kg m2": 1.0}
_STIFFNESS = {"N/m": 1.0, "Hz": 0.5}
_DEVIATIONS = 2  # standard errors of `identified`: 95 % of a normal error
AUTO = "auto"  # the box of an identification, if its standard errors are known, and else the standard box
BOXES = (AUTO, "standard", "identified", "none")  # boxes by a word
_TOGETHER = tuple(product((-1.0, 1.0), repeat=2))  # ends of all masses, and of all stiffnesses
_CORNERS = 64  # of a box whose corners are all examined; of a larger one this many
_INDEFINITE = 1e-3  # least eigenvalue of correlations with four digits that is rounding, below 0
_EDGES = 256  # largest number of edges whose middles are examined


def tolerances(text: str, names: Sequence[str], example: str) -> dict[str, float]:
    """Return the tolerances of a text such as `mass=0.3,stiffness=20%,dead_time=1sample`, by name.

    What is not named has no tolerance.  Raises ParameterError for an unknown name, one that is stated twice, a value
    that is no number, and a dead time that is no whole number of samples.
    """
    values = dict.fromkeys(names, 0.0)
    stated = set[str]()
    for part in text.split(","):
        name, sign, value = (piece.strip() for piece in part.partition("="))
        if name in values and not value:
            raise ParameterError(f"box '{text}': {name} has no value: write it as {example}")
        if not sign or name not in values:
            raise ParameterError(
                f"box '{text}': '{part.strip()}' is no tolerance with a value{nearest(name, values)}; write it as "
                f"{example}, as standard or as none"
            )
        if name in stated:
            raise ParameterError(f"box '{text}': {name} is stated twice: state it once")
        stated.add(name)
        size = value.removesuffix("s").removesuffix("sample") if name == "dead_time" else value.removesuffix("%")
        try:
            values[name] = float(size) * (0.01 if value.endswith("%") else 1.0)
        except ValueError:
            raise ParameterError(f"box '{text}': {name} = {value} is not a number: write it as {example}") from None
        if name == "dead_time" and not values[name].is_integer():
            raise ParameterError(f"box '{text}': the dead time is a whole number of samples, such as 1sample")
    return values


@dataclass(frozen=True)
class Dimension:
    """A parameter of a plant that is uncertain.

    path    dotted name within the plant, such as mass_load or modes.0.frequency
    value   the value of the model
    spread  relative tolerance of the mass or stiffness
    power   exponent with which it enters: the parameter is value · (1 + spread u)^power, -1 <= u <= 1
    """

    path: str
    value: float
    unit: str
    spread: float
    power: float

    def at(self, place: float) -> float:
        """Return the value of the parameter at a place from -1 (lower end) to 1 (upper end)."""
        return self.value * (1.0 + self.spread * place) ** self.power

    @property
    def text(self) -> Text:
        """The parameter with both ends, in words."""
        return Text(f"{self.path} {span(self.at(-1.0), self.at(1.0), self.unit, '3')}")


@dataclass(frozen=True)
class Corner:
    """A plant of a box.

    place  place of each dimension, -1 .. 1
    late   additional dead time, whole samples
    """

    place: tuple[float, ...]
    late: int


@dataclass(frozen=True)
class Box:
    """The tolerances of the plant of an axis: all plants in it are meant where a bound holds over the box.

        k = k0 (1 + stiffness u),   m = m0 (1 + mass u),   -1 <= u <= 1, apart for each parameter;   0 .. dead_time

    stiffness  relative spread of every stiffness of the plant, and of the square of every frequency of a mode
    mass       relative spread of every mass and inertia of the plant
    dead_time  additional dead time of the actuator, whole samples: a control is never earlier than its model says
    deviations if above 0, a value that was identified spreads by so many of its standard errors instead (`with_errors`)
    known      relative spread of each such value, by its path within the plant
    tied       correlation matrix of the errors of `known`, in its order; empty: they are independent

    With `tied` the box lies along the principal axes of the errors, R = V Λ Vᵀ: with spreads s, and places w, the
    values are

        p = p0 (1 + s V Λ^½ w),   -1 <= w <= 1

    so that a resonance which is known better than its mass and its stiffness keeps its frequency.  `known` then has
    the ends of this box, s Σ |V Λ^½|, between which each value lies.

    Friction, damping, encoders and the current loop are those of the model.  A mass that may be negative, such as an
    off-diagonal term of the mass matrix, changes with the geometric mean of the masses.
    Raises ParameterError for a spread that is not >= 0 and < 1, and for a dead time that is no whole number from 0 to
    100.
    """

    stiffness: float = 0.2
    mass: float = 0.3
    dead_time: int = 1
    deviations: float = 0.0
    known: tuple[tuple[str, float], ...] = ()
    tied: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.deviations) and self.deviations >= 0.0):
            raise ParameterError(
                f"box: identified = {self.deviations} must be a number of standard errors > 0, such as 2 for 95 %"
            )
        for name in ("stiffness", "mass"):
            value = getattr(self, name)
            if not 0.0 <= value < 1.0:
                raise ParameterError(f"box: {name} = {value} must be a share >= 0 and < 1, such as 0.2 for ±20 %")
        if not (0 <= self.dead_time <= 100 and self.dead_time % 1 == 0):
            raise ParameterError(
                f"box: dead_time = {self.dead_time} must be a whole number of samples from 0 to 100, such as 1sample"
            )

    @classmethod
    def parse(cls, text: str) -> Self | None:
        """Return the box of a text such as `stiffness=0.2,mass=0.3,dead_time=1sample`; None for `none`.

        What is not named has no tolerance; `standard` is the standard box, and ±20 % may be written as 20%.
        `identified` is the standard box in which values with a standard error spread by two of them, `identified=3` by
        three; behind other tolerances it does the same with these.
        `auto` is the standard box where nothing is known of the axis (`MachineFile.box`).
        Raises ParameterError for any other text.
        """
        if text.strip() == "none":
            return None
        words = [word.strip() for word in text.split(",")]
        of_errors = [word for word in words if word.partition("=")[0].strip() == "identified"]
        if of_errors:
            rest = ",".join(word for word in words if word not in of_errors)
            size = of_errors[0].partition("=")[2].strip() or str(_DEVIATIONS)
            plain = cls.parse(rest or "standard")
            try:
                deviations = float(size)
            except ValueError:
                deviations = math.nan
            if len(of_errors) > 1 or plain is None or not deviations > 0.0:
                raise ParameterError(
                    f"box '{text}': identified is stated once, with a number of standard errors > 0: write identified, "
                    "identified=3, or stiffness=0.2,mass=0.3,dead_time=1sample,identified=3"
                )
            return replace(plain, deviations=deviations)
        if text.strip() in ("standard", AUTO):
            return cls()
        values = tolerances(text, ("stiffness", "mass", "dead_time"), "stiffness=0.2,mass=0.3,dead_time=1sample")
        return cls(values["stiffness"], values["mass"], int(values["dead_time"]))

    def __str__(self) -> str:
        """Return the text from which `parse` makes this box."""
        unit = "sample" if self.dead_time == 1 else "samples"
        stated = f"stiffness={number(self.stiffness, 6)},mass={number(self.mass, 6)}"
        of_errors = f",identified={number(self.deviations, 6)}" if self.deviations else ""
        return f"{stated},dead_time={self.dead_time}{unit}{of_errors}"

    def with_errors(
        self,
        axis: Axis,
        errors: Mapping[str, float],
        where: str,
        correlations: Mapping[frozenset[str], float] = MappingProxyType({}),
    ) -> Self:
        """Return the box in which each value with a standard error spreads by `deviations` of them.

        errors        standard errors in SI by path, such as plant.mass
        where         name of the file in messages
        correlations  correlations of these errors by both paths; those of other pairs are 0

        A box without `deviations` is returned unchanged.  Raises ParameterError if no mass and no stiffness has an
        error, for errors so large that the value might be 0, and for correlations that no errors have together.
        """
        if not self.deviations:
            return self
        every = _every(axis)
        known = {d.path: self.deviations * errors[f"plant.{d.path}"] for d in every if f"plant.{d.path}" in errors}
        if not known:
            raise ParameterError(
                f"box '{self}': {where} states no standard error of a mass or stiffness, [axis.NAME.standard_errors]: "
                "identify the axis (feeddrive identify), or take --box standard"
            )
        spreads = list[tuple[str, float]]()
        paths = [d.path for d in every if d.path in known]
        R = np.array([[correlations.get(frozenset((f"plant.{a}", f"plant.{b}")), float(a == b)) for b in paths]
                      for a in paths])  # fmt: skip
        tied = not np.array_equal(R, np.eye(len(paths)))
        wide = dict(zip(paths, np.sum(np.abs(_principal(R)), axis=1).tolist(), strict=True)) if tied else {}
        if tied and float(np.linalg.eigvalsh(R)[0]) < -_INDEFINITE:
            raise ParameterError(
                f"box '{self}': {where}: no errors have the correlations of {', '.join(paths)} together, whose matrix "
                "has a negative eigenvalue: write them as identify does, or leave [axis.NAME.correlations] out"
            )
        for d in every:
            if d.path in known:
                # of a frequency, whose square is a stiffness, twice its own share
                spread = known[d.path] / d.value / d.power * wide.get(d.path, 1.0)
                if not spread < 1.0:
                    raise ParameterError(
                        f"box '{self}': {where}: {number(self.deviations, 3)} standard errors of {d.path} are "
                        f"{number(100.0 * spread, 3)} % of its value: measure longer, or take --box standard"
                    )
                spreads.append((d.path, spread))
        return replace(self, known=tuple(spreads), tied=tuple(map(tuple, R.tolist())) if tied else ())

    def upright(self) -> Self:
        """Return the box without correlations that contains this one: each value between its ends, on its own."""
        return replace(self, tied=())

    def apart(self, dimensions: Sequence[Dimension], place: Sequence[Any]) -> list[Any]:
        """Return the place of each parameter between its own ends, from a place of the box."""
        if not self.tied:
            return list(place)
        paths = [d.path for d in dimensions]
        turn = _principal(np.array(self.tied))
        # from end to end: the spreads of `known` are those of the whole sum
        turn /= np.sum(np.abs(turn), axis=1, keepdims=True)
        rows, found = [paths.index(path) for path, _ in self.known], list(place)
        for i, weights in zip(rows, turn.tolist(), strict=True):
            found[i] = sum(weight * place[j] for weight, j in zip(weights, rows, strict=True))
        return found

    @property
    def sentence(self) -> Text:
        """The box in words."""
        late = f"up to {Quantity(self.dead_time):6} more {'sample' if self.dead_time == 1 else 'samples'} of dead time"
        parts = [
            f"every {name} ±{Quantity(size, 'share'):6}"
            for name, size in (("stiffness", self.stiffness), ("mass", self.mass))
            if size
        ]
        if self.deviations:
            parts.append(f"identified values ±{Quantity(self.deviations):3} standard errors")
        return joined(", ", [Text(part) for part in (*parts, *([late] if self.dead_time else []))]) or Text("no spread")

    def dimensions(self, axis: Axis) -> tuple[Dimension, ...]:
        """Return the uncertain parameters of the plant of an axis: its masses first, then its stiffnesses."""
        found: list[Dimension] = []
        known = dict(self.known)
        for powers, usual in ((_MASS, self.mass), (_STIFFNESS, self.stiffness)):
            for path, value in tree.leaves(axis.plant):
                declared = tree.declaration(axis.plant, path)
                spread = known.get(path, usual)
                # a parameter of 0 is absent, and one that may be negative is a product of two masses
                if declared.unit in powers and spread and value > 0.0 and not _signed(axis, path):
                    unit = tree.declaration(axis, f"plant.{path}").unit
                    found.append(Dimension(path, float(value), unit, spread, powers[declared.unit]))
        return tuple(found)

    def text(self, axis: Axis) -> Text:
        """Return the box of an axis in words, with the ends of every parameter."""
        ends = joined("; ", [dimension.text for dimension in self.dimensions(axis)])
        return Text(f"{self.sentence}{Text(f' ({ends})') if ends else ''}")

    def plant_of(self, axis: Axis, place: Sequence[Any]) -> Plant:
        """Return the plant of an axis at a place of the box, from -1 to 1 for each dimension.

        With an array in each dimension of `place`, the parameters of the plant are arrays: one entry per plant.
        """
        dimensions = self.dimensions(axis)
        changes = {d.path: d.at(u) for d, u in zip(dimensions, self.apart(dimensions, place), strict=True)}
        signed = [(path, value) for path, value in tree.leaves(axis.plant) if _signed(axis, path)]
        masses = [np.log(changes[d.path] / d.value) for d in dimensions if d.unit in _MASS] if signed else []
        mean = np.exp(sum(masses) / max(len(masses), 1))
        changes |= {path: value * (mean if np.ndim(mean) else float(mean)) for path, value in signed}
        return tree.vary(axis.plant, changes) if changes else axis.plant

    def plant(self, loop: Loop, corner: Corner) -> Loop:
        """Return the loop with a plant of the box. Its control is unchanged, with the model that it was told.

        Raises ParameterError if the axis cannot be built, for example for a dead time above 1000 samples.
        """
        plant = self.plant_of(loop.axis, corner.place)
        return replace(loop, axis=replace(loop.axis, plant=plant)).later(corner.late)

    def corners(self, axis: Axis) -> Iterator[Corner]:
        """Yield the corners of the box of an axis; of more than 64, those that few changes of sign lead to.

        With many dimensions these are: all masses and all stiffnesses at one end each, the same with one parameter at
        its other end, and further corners drawn at random.
        """
        n = len(self.dimensions(axis))
        lates = (0, self.dead_time) if self.dead_time else (0,)
        if 2**n * len(lates) <= _CORNERS:
            places: Sequence[tuple[float, ...]] = list(product((-1.0, 1.0), repeat=n))
        else:
            places = _some_corners([d.unit in _MASS for d in self.dimensions(axis)], _CORNERS // len(lates))
        for late, place in product(lates, places):
            yield Corner(place, late)

    def together(self, axis: Axis) -> Iterator[Corner]:
        """Yield the corners at which all masses are at one end, all stiffnesses at one end, each with both dead times.

        At most eight plants, which depend on no control.
        """
        mass = [d.unit in _MASS for d in self.dimensions(axis)]
        places = dict.fromkeys(tuple(m if is_mass else k for is_mass in mass) for m, k in _TOGETHER)
        for late, place in product(sorted({0, self.dead_time}), places):
            yield Corner(place, late)

    def edges(self, axis: Axis) -> Iterator[Corner]:
        """Yield the middles of the edges between the corners of `corners`, at most 256."""
        middles = (
            Corner((*corner.place[:i], 0.0, *corner.place[i + 1 :]), corner.late)
            for corner in self.corners(axis)
            for i in range(len(corner.place))
        )
        yield from list(dict.fromkeys(middles))[:_EDGES]

    def all_corners(self, axis: Axis) -> int:
        """Return the number of corners of the box of an axis."""
        return 2 ** len(self.dimensions(axis)) * (2 if self.dead_time else 1)

    def named(self, axis: Axis, corner: Corner) -> Text:
        """Return a plant of the box in words, such as `mass_load -30 %, 1 sample later`."""
        dimensions = self.dimensions(axis)
        return named(dimensions, replace(corner, place=tuple(self.apart(dimensions, corner.place))))

    def drawn(self, axis: Axis, count: int, seed: int) -> Iterator[Corner]:
        """Yield plants drawn at random: evenly from all of the box, every other one with some parameters at an end.

        Of these each parameter is at an end with probability 1/2, since the worst plants lie on edges more often.
        """
        random = np.random.default_rng(seed)
        n = len(self.dimensions(axis))
        for i in range(count):
            place = random.uniform(-1.0, 1.0, n)
            at_end = (random.random(n) < 0.5) & (i % 2 == 1)
            place = np.where(at_end, np.sign(place), place)
            yield Corner(tuple(place.tolist()), int(random.integers(0, self.dead_time + 1)))


def _every(axis: Axis) -> tuple[Dimension, ...]:
    """Return all masses and stiffnesses of the plant of an axis, whichever tolerances a box has."""
    return Box(0.5, 0.5, 0).dimensions(axis)


def _principal(R: np.ndarray) -> np.ndarray:
    """Return V Λ^½ of a correlation matrix: its columns are the principal axes of errors of size 1."""
    sizes, vectors = np.linalg.eigh(R)
    return vectors * np.sqrt(np.maximum(sizes, 0.0))


def can_spread(axis: Axis, path: str) -> bool:
    """Return True for a mass or stiffness of the plant, by its path such as plant.mass."""
    return any(f"plant.{dimension.path}" == path for dimension in _every(axis))


def is_identified(axis: Axis, errors: Mapping[str, float]) -> bool:
    """Return True if there is a standard error of a mass or stiffness of the plant, by paths such as plant.mass."""
    return any(f"plant.{dimension.path}" in errors for dimension in _every(axis))


def named(dimensions: Sequence[Dimension], corner: Corner) -> Text:
    """Return a plant in words, by the dimensions of its box, such as `mass_load -30 %, 1 sample later`."""
    parts = [
        Text(f"{d.path} {'+' if u > 0 else '-'}{_share(abs(d.spread * u))}")
        for d, u in zip(dimensions, corner.place, strict=True)
        if abs(u) > 1e-3
    ]
    if corner.late:
        parts.append(Text(f"{corner.late} {'sample' if corner.late == 1 else 'samples'} later"))
    return joined(", ", parts) or Text("the model")


def _share(size: float) -> Quantity:
    # a mass that falls by 99.9 % is not gone
    return Quantity(size, "share", form="3" if size > 0.99 else "2")


def _signed(axis: Axis, path: str) -> bool:
    """Return True for a mass of the plant that may be negative: an off-diagonal term of the mass matrix."""
    declared = tree.declaration(axis.plant, path)
    return declared.unit in _MASS and declared.above is None and declared.least is None


def _some_corners(mass: Sequence[bool], count: int) -> list[tuple[float, ...]]:
    """Return `count` corners: `mass` is True for the dimensions that are masses."""
    places: dict[tuple[float, ...], None] = {}
    blocks = [tuple(m if is_mass else k for is_mass in mass) for m, k in _TOGETHER]
    places.update(dict.fromkeys(blocks))
    flipped = (tuple(-u if i == j else u for j, u in enumerate(block)) for i in range(len(mass)) for block in blocks)
    places.update(dict.fromkeys(flipped))
    random = np.random.default_rng(0)
    while len(places) < count:
        places[tuple(random.choice((-1.0, 1.0), len(mass)).tolist())] = None
    return list(places)[:count]
