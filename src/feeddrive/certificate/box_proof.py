"""A proof that a loop is stable, and keeps a bound on Ms, at every frozen plant of a box: between its corners, too.

With the mechanics M s² + C s + K of n bodies, whose force acts on b and whose readings are cᵢᵀq, the command u, held
over a sample T, and the control u = Σ Cᵢ(z) xᵢ, Cᵢ = Nᵢ/D:

    den = det(M s² + C s + K),  numᵢ = cᵢᵀ adj(M s² + C s + K) b,  G = (1 - e^-sT)/(sT) e^(-s τ) ωc/(s + ωc)
    f(ω) = D den - Σ Nᵢ G numᵢ,  s = jω, z = e^(jωT);    tailᵢ(ω) = Σ over k ≠ 0 of |G numᵢ/den| at ω + 2πk/T
    |1 + L| >= 1/Ms  if  |f| - Σ |Nᵢ| tailᵢ |den| >= |D den|/Ms

The sampled plant is the sum of G numᵢ/den over all ω + 2πk/T; that of k = 0 is exact here, the others are bounded.

*All plants.*  A mass or a stiffness enters M or K with a matrix of rank one, so den and numᵢ are affine in each of
them alone.  For any angle φ, Re(e^(-jφ) f) - c |den| is then concave in each of them alone, and least at a corner of a
cell: if it is positive at all 2ᵖ corners for one φ, it is positive in the whole cell.  c collects what is subtracted
above.  *All frequencies.*  On |ω - ω0| <= δ every factor is a value, a slope and a bound on the rest, which includes
rounding.  A cell of plants and frequencies at which the test fails is halved, along the side that changes f most.

If the loop is stable at one plant of the box and f ≠ 0 at all plants and frequencies, no pole crosses the unit circle
between any two plants, and all are stable.  Each whole number of additional samples of dead time is proven apart.

Sources: Zadeh & Desoer 1963, section 9.17 (mapping theorem); Barmish 1994, chapters 8 and 14.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import permutations, product
from math import comb
from typing import Any, NamedTuple

import numpy as np

from feeddrive.certificate import box_check, check
from feeddrive.certificate.certificate import LoopResponse
from feeddrive.certificate.systems import deployed, modelled_plant
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis, require_force
from feeddrive.loop.box import Box, Corner, Dimension
from feeddrive.loop.linearize import Lifted, StateSpace, linearize
from feeddrive.loop.loop import Loop

OUTSIDE = (
    "changes in time, saturation, friction other than its slope, rounding of signals, and what is no parameter of the "
    "model, such as a further mode"
)
WORK = 2e8  # corners of cells that are evaluated at most: a minute or two
_PER_DECADE, _DECADES = 12, 6  # intervals of frequency at the start: from 10^-6 of Nyquist
_CHUNK = 60_000  # corners that are evaluated together
_IMAGES = 2  # images on either side whose bound is that of the cell; the rest is bounded together
_AROUND = 1000  # directions in a quarter of a turn: half a step takes 10^-7 of |f|
_STATED, _SHORT = 1e-13, "13g"  # of an entry: what a stated plant may differ by; digits of its factors
_RECORDED = 2_000_000  # cells of which a file can be written: some 10 MB
_ROUND = 1e-12  # of the sum of all terms of a polynomial: more than their rounding, 30 terms of 2^-53 each
# a cell this small at which the proof fails is not halved again: share of its frequency, and of half of a dimension
_NARROW, _SMALL = 1e-7, 1e-5
_NEAR = 1e-3, 0.02  # the same, of a cell with a corner that cannot be proven even alone
_COMPARED = 60  # frequencies at which the sampled model is compared
_AGREES = 1e-6  # largest relative difference of the sampled model of the loop from the sum over images


class Line(NamedTuple):
    """A function of frequency on |ω - ω0| <= δ: |y - value - slope (ω - ω0)| <= rest."""

    value: Any
    slope: Any
    rest: Any

    def times(self, other: "Line", delta: np.ndarray) -> "Line":
        """Return the product with another function on the same interval."""
        a, b = self, other
        size_a, size_b = np.abs(a.value) + np.abs(a.slope) * delta, np.abs(b.value) + np.abs(b.slope) * delta
        rest = np.abs(a.slope) * np.abs(b.slope) * delta**2 + a.rest * (size_b + b.rest) + b.rest * size_a
        return Line(a.value * b.value, a.value * b.slope + a.slope * b.value, rest)

    def minus(self, other: "Line") -> "Line":
        """Return the difference from another function on the same interval."""
        return Line(self.value - other.value, self.slope - other.slope, self.rest + other.rest)

    def most(self, delta: np.ndarray) -> np.ndarray:
        """Return an upper bound of the magnitude on the interval."""
        # the magnitude of a straight line is convex, so its largest value is at an end
        ends = np.abs(self.value + delta * self.slope), np.abs(self.value - delta * self.slope)
        return np.maximum(*ends) + self.rest

    def least_along(self, turn: np.ndarray, delta: np.ndarray) -> np.ndarray:
        """Return a lower bound of Re(y · turn) on the interval; `turn` has magnitude 1."""
        return np.real(self.value * turn) - np.abs(np.real(self.slope * turn)) * delta - self.rest


def _determinant(entries: Sequence[Sequence[np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the determinant of a matrix of polynomials of degree 2, and the sum of the magnitudes of all its terms.

    The coefficients are in the order of rising powers, shape (2 n + 1,).
    """
    n = len(entries)
    value, size = np.zeros(2 * n + 1), np.zeros(2 * n + 1)
    for order in permutations(range(n)):
        term = np.ones(1)
        for i, j in enumerate(order):
            term = np.convolve(term, entries[i][j])
        sign = (-1) ** sum(order[i] > order[j] for i in range(n) for j in range(i + 1, n))
        value, size = value + sign * term, size + np.abs(term)
    return value, size


class Family:
    """The polynomials den and numᵢ in s of all plants of a box, given by those at its corners.

    values  shape (2, ..., 2, 1 + readings, coefficients): a place -1 or 1 for each dimension
    sizes   the largest sum of the magnitudes of all terms of a coefficient, shape (1 + readings, coefficients)
    """

    def __init__(self, axis: Axis, box: Box, readings: Sequence[str]) -> None:
        self.dimensions = box.dimensions(axis)
        self.count, self.outputs = len(self.dimensions), len(readings)
        if any(d.power != 1.0 for d in self.dimensions):
            raise ParameterError(_not_affine(axis, "the frequency of a mode changes its damping as well"))
        corners = [self.at(axis, box, place, readings) for place in product((-1.0, 1.0), repeat=self.count)]
        shape = (2,) * self.count
        self.values = np.array([value for value, _ in corners]).reshape(*shape, 1 + self.outputs, -1)
        self.sizes = np.max(np.array([size for _, size in corners]), axis=0)
        self._check_affine(axis, box, readings)

    @staticmethod
    def at(axis: Axis, box: Box, place: Sequence[float], readings: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Return den and numᵢ at a place of the box, and the sums of the magnitudes of their terms."""
        # of the axis: the viscous part of its friction belongs to the damping
        mechanics = replace(axis, plant=box.plant_of(axis, place)).mechanics()
        entries = np.stack([np.array(part, float) for part in (mechanics.stiffness, mechanics.damping, mechanics.mass)])
        n = entries.shape[1]
        shape = np.array(mechanics.shape, float)
        seen = _seen(axis)
        inner = [[entries[:, i, j] for j in range(n)] for i in range(n)]
        value, size = _determinant(inner)
        values, sizes = [value], [size]
        for reading in readings:
            row, column = shape[seen[reading]], shape[mechanics.drive]
            bordered = [[*inner[i], np.array([column[i], 0.0, 0.0])] for i in range(n)]
            bordered.append([*(np.array([x, 0.0, 0.0]) for x in row), np.zeros(3)])
            value, size = _determinant(bordered)
            values.append(-value[: 2 * n + 1])
            sizes.append(size[: 2 * n + 1])
        return np.array(values), np.array(sizes)

    def _check_affine(self, axis: Axis, box: Box, readings: Sequence[str]) -> None:
        """Raise ParameterError unless the polynomials are affine in each dimension apart, at places drawn at random."""
        random = np.random.default_rng(0)
        for _ in range(4):
            place = random.uniform(-1.0, 1.0, self.count)
            value, size = self.at(axis, box, place.tolist(), readings)
            if np.any(np.abs(self.corners(place[None], place[None])[0, 0] - value) > 1e-9 * (size + 1e-300)):
                raise ParameterError(_not_affine(axis, "a parameter enters in another way than as a mass or a spring"))

    def corners(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the polynomials at all corners of cells, shape (cells, corners, 1 + readings, coefficients).

        low, high  ends of the cells, shape (cells, dimensions), from -1 to 1
        """
        cells = low.shape[0]
        values = np.broadcast_to(self.values, (cells, *self.values.shape))
        for i in range(self.count):
            upper = 0.5 * (1.0 + np.stack([low[:, i], high[:, i]], axis=1))  # (cells, ends): share of the upper end
            weights = np.stack([1.0 - upper, upper], axis=2)  # (cells, ends, corners of the box)
            moved = np.moveaxis(values, 1 + i, 1)
            moved = np.einsum("bec,bc...->be...", weights, moved)
            values = np.moveaxis(moved, 1, 1 + i)
        return values.reshape(cells, -1, 1 + self.outputs, self.values.shape[-1])


def _stated(axis: Axis, box: Box, readings: Sequence[str]) -> dict[str, Any]:
    """Return the bodies of an axis and the parameters of a box as `box_check` reads them.

    Each parameter adds its value times factor · v vᵀ to the mass or the stiffness matrix, which has rank one.
    Raises ParameterError if these matrices are not those of the axis at all corners of the box.
    """
    dimensions = box.dimensions(axis)

    def matrices(place: Sequence[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        mechanics = replace(axis, plant=box.plant_of(axis, place)).mechanics()
        M, C, K = (np.array(part, float) for part in (mechanics.mass, mechanics.damping, mechanics.stiffness))
        return M, C, K

    def short(values: np.ndarray, largest: float) -> np.ndarray:
        # what is left of a difference is rounding
        return np.where(np.abs(values) > 1e-12 * largest, values, 0.0)

    mechanics, count = axis.mechanics(), len(dimensions)
    middle = matrices([0.0] * count)
    parameters: list[dict[str, Any]] = []
    left = {"mass": middle[0], "damping": middle[1], "stiffness": middle[2]}
    for i, d in enumerate(dimensions):
        # twice the value: a difference over a narrow box would consist of rounding
        far = matrices([1.0 / d.spread if i == j else 0.0 for j in range(count)])
        grown = [(far[k] - middle[k]) / (d.at(1.0 / d.spread) - d.value) for k in (0, 2)]
        sizes = [
            float(np.max(np.abs(part))) / max(float(np.max(np.abs(middle[k]))), 1e-300)
            for k, part in zip((0, 2), grown, strict=True)
        ]
        part = grown[int(np.argmax(sizes))]
        j = int(np.argmax(np.abs(np.diag(part))))
        vector = short(part[:, j] / part[j, j], 1.0)
        vector = np.array([float(format(x, _SHORT)) for x in vector])
        factor = float(format(part[j, j], _SHORT))
        added = d.value * factor * np.outer(vector, vector)
        matrix = "mass" if sizes[0] > sizes[1] else "stiffness"
        left[matrix] = left[matrix] - added
        parameters.append(
            {
                "name": d.path,
                "unit": d.unit,
                "from": d.at(-1.0),
                "to": d.at(1.0),
                "adds_to": matrix,
                "factor": factor,
                "vector": vector.tolist(),
            }
        )
    for matrix, whole in zip(left, middle, strict=True):
        left[matrix] = short(left[matrix], float(np.max(np.abs(whole))))
    for place in product((-1.0, 1.0), repeat=count):
        there = matrices(place)
        for actual, (name, rest) in zip(there, left.items(), strict=True):
            found, size = rest.copy(), np.abs(rest)
            for u, p in zip(place, parameters, strict=True):
                if p["adds_to"] == name:
                    term = p["from" if u < 0.0 else "to"] * p["factor"] * np.outer(p["vector"], p["vector"])
                    found, size = found + term, size + np.abs(term)
            if np.any(np.abs(actual - found) > _STATED * np.maximum(size, np.max(np.abs(actual)))):
                raise ParameterError(_not_affine(axis, f"a parameter enters its {name} matrix with more than rank one"))
    seen = _seen(axis)
    shape = np.array(mechanics.shape, float)
    bandwidth = axis.actuator.current_loop
    return {
        "uncertain": parameters,
        "plant": {
            **{name: rest.tolist() for name, rest in left.items()},
            "force": shape[mechanics.drive].tolist(),
            "readings": {reading: shape[seen[reading]].tolist() for reading in readings},
            "dead_time_s": float(axis.actuator.dead_time),
            "current_loop_rad_s": None if bandwidth is None else 2.0 * np.pi * float(bandwidth),
        },
    }


def _seen(axis: Axis) -> dict[str, int]:
    """Return the number of the body whose position each reading is."""
    mechanics = axis.mechanics()
    one = axis.one_encoder()
    only = mechanics.load if axis.encoder_load is not None else mechanics.motor
    return {"reading_motor": only if one else mechanics.motor, "reading_load": only if one else mechanics.load}


def _not_affine(axis: Axis, why: str) -> str:
    return (
        f"the plant '{axis.plant.kind}' cannot be proven over a box: {why}; the proof needs masses and springs, as in "
        "rigid, two_mass and three_mass_chain. Examine the box by feeddrive tune --box, or certify discs without --box"
    )


class ControlLines:
    """The polynomials D and Nᵢ of a control in w = z - 1, in which integrators lose no digits."""

    def __init__(self, model: StateSpace) -> None:
        self.T = float(model.sample_time)
        system: check.System = {name: getattr(model, name).tolist() for name in "ABCD"}
        denominator, above = check.polynomials(system)
        parts = [denominator, *(above[0, i] for i in range(len(model.inputs)))]
        n, leading = len(denominator), denominator[-1]
        shifted = [[sum(p[j] * comb(j, k) for j in range(k, n)) for k in range(n)] for p in parts]
        # exact up to here; float(Fraction) is rounded once
        self.coefficients = np.array([[float(Fraction(x, leading)) for x in p] for p in shifted])
        self._binomials = np.array([[comb(m, k) if m >= k else 0 for k in range(n)] for m in range(n)], float)

    def on(self, omega: np.ndarray, delta: np.ndarray) -> list[Line]:
        """Return D and Nᵢ on intervals of ω, rad/s, each of shape (intervals,)."""
        n, T = self.coefficients.shape[1], self.T
        z = np.exp(1j * omega * T)
        # 2j sin(x/2) e^(jx/2): z - 1 without cancellation
        w = 2j * np.sin(0.5 * omega * T) * np.exp(0.5j * omega * T)
        powers = w[:, None] ** np.arange(n)
        step = T * delta
        lines: list[Line] = []
        around = self._binomials * np.where(
            np.arange(n)[:, None] >= np.arange(n),
            powers[:, np.abs(np.arange(n)[:, None] - np.arange(n))],
            0.0,
        )
        for p in self.coefficients:
            taylor = np.einsum("m,bmk->bk", p, around)
            far = np.abs(taylor[:, 2:]) * step[:, None] ** np.arange(2, n)
            rounding = _ROUND * (np.abs(powers) @ np.abs(p))
            first = taylor[:, 1] if n > 1 else np.zeros_like(w)
            rest = 0.5 * np.abs(first) * step**2 + np.sum(far, axis=1) + rounding
            lines.append(Line(taylor[:, 0], first * z * 1j * T, rest))
        return lines


class Cells(NamedTuple):
    """Cells of plants and frequencies: middle and half width of ω in rad/s, ends of the dimensions, whole samples."""

    omega: np.ndarray
    delta: np.ndarray
    low: np.ndarray  # (cells, dimensions)
    high: np.ndarray
    late: np.ndarray

    def take(self, which: np.ndarray) -> "Cells":
        """Return some of the cells."""
        return Cells(*(part[which] for part in self))

    @staticmethod
    def joined(parts: Sequence["Cells"]) -> "Cells":
        """Return all cells of several groups."""
        return Cells(*(np.concatenate([getattr(part, name) for part in parts]) for name in Cells._fields))


class Judged(NamedTuple):
    """Cells, judged.

    holds     True where the proof holds
    direction the code of the direction in which it was tested (`_direction`)
    worst     the corner whose |1 + L| at ω0 is least
    violated  True where this corner violates the bound itself
    open      True where this corner alone cannot be proven at ω0: the bound of the images is larger than its margin
    side      the dimension along which to halve; the number of dimensions stands for the frequency
    """

    holds: np.ndarray
    direction: np.ndarray
    worst: np.ndarray
    violated: np.ndarray
    open: np.ndarray
    side: np.ndarray


class Prover:
    """The test of cells of plants and frequencies for one control."""

    def __init__(self, loop: Loop, box: Box, model: StateSpace, least: float) -> None:
        self.T, self.least, self.readings = float(loop.sample_time), least, model.inputs
        self.family = Family(loop.axis, box, model.inputs)
        self.control = ControlLines(model)
        actuator = loop.axis.actuator
        require_force(loop.axis, "a proof over a box")
        self.dead_time = float(actuator.dead_time)
        bandwidth = actuator.current_loop
        self.lag = None if bandwidth is None else 2.0 * np.pi * float(bandwidth)
        degree = self.family.values.shape[-1] - 1
        self.powers = np.arange(degree + 1)
        self._binomials = np.array([[comb(m, k) if m >= k else 0 for k in range(degree + 1)] for m in self.powers])
        self.far = self._far_images()

    def _far_images(self) -> np.ndarray:
        """Return the bound βᵢ with |numᵢ/den| <= βᵢ/ω² beyond the images that are computed, in all of the box."""
        values = np.abs(self.family.values.reshape(-1, *self.family.values.shape[-2:]))
        sizes, top = np.max(values, axis=0) + _ROUND * self.family.sizes, self.powers[-1]
        leading = np.min(values[:, 0, top]) * (1.0 - 1e-9)
        first = (_IMAGES + 0.5) * 2.0 * np.pi / self.T
        others = float(np.sum(sizes[0, :top] * first ** (self.powers[:top] - float(top))))
        if others >= 0.5 * leading:
            raise ParameterError(
                f"a plant of the box has a mode beyond two sample rates, {Quantity(2.0 / self.T, 'Hz')}: its proof "
                "over a box is not available; state smaller tolerances, leave the mode out, or sample faster"
            )
        above = np.sum(sizes[1:, : top - 1] * first ** (self.powers[: top - 1] - float(top - 2)), axis=1)
        return above / (leading - others)

    def polynomials(self, corners: np.ndarray, omega: np.ndarray, delta: np.ndarray) -> list[Line]:
        """Return den and numᵢ on intervals, each of shape (cells, corners)."""
        powers = omega[:, None] ** self.powers
        gap = np.abs(self.powers[:, None] - self.powers)
        around = self._binomials * np.where(self.powers[:, None] >= self.powers, powers[:, gap], 0.0)
        steps = delta[:, None] ** self.powers
        rounding = _ROUND * (((np.abs(omega) + delta)[:, None] ** self.powers) @ self.family.sizes.T)  # (cells, rows)
        # j^m of (jω)^m, real and imaginary apart: the coefficients are real
        taylor = np.einsum("bvrm,bmk->bvrk", corners * (1j**self.powers), around)
        rest = np.einsum("bvrk,bk->bvr", np.abs(taylor[..., 2:]), steps[:, 2:])
        return [
            Line(taylor[:, :, r, 0], taylor[:, :, r, 1], rest[:, :, r] + rounding[:, r, None])
            for r in range(corners.shape[2])
        ]

    def drive(self, omega: np.ndarray, delta: np.ndarray, late: np.ndarray) -> Line:
        """Return G, shape (cells,)."""
        half = 0.5 * self.T
        x = omega * half
        small = np.abs(x) < 1e-3
        safe = np.where(small, 1.0, x)
        sinc = np.where(small, 1.0 - x * x / 6.0, np.sin(safe) / safe)
        slope = np.where(small, -x / 3.0, (np.cos(safe) - np.sin(safe) / safe) / safe)
        # |sinc''| <= 1/3; 1e-12: the next terms of the series, and rounding
        held = Line(sinc, slope * half, (half * delta) ** 2 / 6.0 + 1e-12)
        behind = half + self.dead_time + late * self.T
        turned = np.exp(-1j * omega * behind)
        delayed = Line(turned, -1j * behind * turned, 0.5 * (behind * delta) ** 2)
        whole = held.times(delayed, delta)
        if self.lag is None:
            return whole
        pole = self.lag + 1j * omega
        low = np.hypot(self.lag, np.maximum(omega - delta, 0.0))
        lagged = Line(self.lag / pole, -1j * self.lag / pole**2, self.lag * delta**2 / low**3)
        return whole.times(lagged, delta)

    def tails(self, corners: np.ndarray, cells: Cells) -> np.ndarray:
        """Return upper bounds of tailᵢ, shape (cells, readings); infinite where den may be 0 at an image."""
        rate = 2.0 * np.pi / self.T
        stop = np.minimum(np.abs(np.sin(0.5 * cells.omega * self.T)) + 0.5 * cells.delta * self.T, 1.0)
        edge = _IMAGES + 0.5
        far = 2.0 * stop / self.T * 2.0 / rate**3 * (edge**-3 + 0.5 * edge**-2)
        total = far[:, None] * self.far
        for k in [k for k in range(-_IMAGES, _IMAGES + 1) if k]:
            # real polynomials have the same magnitude at -ω
            omega = np.abs(cells.omega + k * rate)
            den, *nums = self.polynomials(corners, omega, cells.delta)
            least = _least_of_hull(den, cells.delta)
            low = omega - cells.delta
            gain = 2.0 * stop / (low * self.T) * (1.0 if self.lag is None else self.lag / np.hypot(self.lag, low))
            for i, num in enumerate(nums):
                largest = np.max(num.most(cells.delta[:, None]), axis=1)
                with np.errstate(divide="ignore"):
                    total[:, i] += np.where(least > 0.0, gain * largest / np.maximum(least, 1e-300), np.inf)
        return total

    def judged(self, cells: Cells) -> Judged:
        """Return which cells are proven."""
        delta, count = cells.delta[:, None], self.family.count
        corners = self.family.corners(cells.low, cells.high)
        den, *nums = self.polynomials(corners, cells.omega, cells.delta)
        D, *Ns = (Line(*(part[:, None] for part in line)) for line in self.control.on(cells.omega, cells.delta))
        G = Line(*(part[:, None] for part in self.drive(cells.omega, cells.delta, cells.late)))
        f = D.times(den, delta)
        for N, num in zip(Ns, nums, strict=True):
            f = f.minus(N.times(G, delta).times(num, delta))
        tails = self.tails(corners, cells)
        through = np.stack([N.most(delta)[:, 0] for N in Ns], axis=1)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            images = np.sum(through * tails, axis=1)[:, None]
            taken = (D.most(delta) * self.least + images) * den.most(delta)
            # the directions that each corner allows, around one that all share: their intersection is taken
            middle = np.mean(f.value / np.maximum(np.abs(f.value), 1e-300), axis=1, keepdims=True)
            angle = np.angle(f.value * np.conj(middle))
            wide = np.arccos(np.clip(taken / np.abs(f.value), 0.0, 1.0))
            first, last = np.max(angle - wide, axis=1), np.min(angle + wide, axis=1)
            direction = _direction(np.angle(middle[:, 0]) + 0.5 * (first + last))
            turn = np.conj(_vector(direction))[:, None]
            # infinite images leave -inf or nan, and no proof
            holds = np.min(f.least_along(turn, delta) - taken, axis=1) > 0.0
            size = np.abs(den.value)
            distance = np.where(size > 0.0, np.abs(f.value) / np.maximum(np.abs(D.value) * size, 1e-300), np.inf)
            most = np.abs(f.value) + images * size
            worst = np.argmin(distance, axis=1)
            bound, every = self.least * np.abs(D.value) * size, np.arange(worst.size)
            violated = (most < (1.0 - 1e-9) * bound)[every, worst]
            open_ = (np.abs(f.value) - images * size <= bound)[every, worst]
        # the change of f between the ends of each dimension, and over the interval
        values = f.value.reshape(cells.omega.size, *(2,) * count)
        changes = [
            np.max(np.abs(np.diff(values, axis=1 + i)).reshape(cells.omega.size, -1), axis=1) for i in range(count)
        ]
        changes.append(np.max(2.0 * np.abs(f.slope) * delta + 4.0 * f.rest, axis=1))
        return Judged(holds, direction, worst, violated, open_, np.argmax(np.array(changes), axis=0))


def _direction(angle: np.ndarray) -> np.ndarray:
    """Return the codes of the directions nearest to angles: places on the square |x| + |y| = `_AROUND`, from 0 on."""
    x, y = np.cos(angle), np.sin(angle)
    share = y / (np.abs(x) + np.abs(y))
    place = np.where(x >= 0.0, share, 2.0 - share)  # a quarter of the square is 1
    return np.rint(_AROUND * np.nan_to_num(place)).astype(np.int64) % (4 * _AROUND)


def _vector(code: np.ndarray) -> np.ndarray:
    """Return the directions of codes as complex numbers of magnitude 1."""
    quarter, t = np.divmod(code, _AROUND)
    side = (_AROUND - t + 1j * t) * 1j**quarter
    return side / np.abs(side)


def _least_of_hull(line: Line, delta: np.ndarray) -> np.ndarray:
    """Return a lower bound of the magnitude over a cell and interval, from the values at the corners; may be < 0."""
    size = np.maximum(np.abs(line.value), 1e-300)
    middle = np.mean(line.value / size, axis=1, keepdims=True)
    turn = np.conj(middle) / np.maximum(np.abs(middle), 1e-300)
    return np.min(line.least_along(turn, delta[:, None]), axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class BoxProof(Result):
    """What was proven of a control over a box of plants, each of which does not change in time.

    text      the box in words, with the ends of every parameter, which are `dimensions`
    bound     the bound on Ms that was to be proven; None for stability alone
    proven    True if it holds at every plant, False if it does not at `plant`, None if that is undecided
    plant     the plant at which it does not hold or is undecided, and its name
    reason    the reason why it is not proven, as a clause; empty if it is proven
    cells     cells of plants and frequencies that were examined
    corners   corners of these cells, of which `WORK` are examined at most
    arithmetic, velocity   arithmetic of the coefficients, and the velocity in m/s at which friction is linearized
    stated    what a second program needs to check the proof (`document`); None if it is not proven, or if there are so
              many cells that they were not kept
    """

    box: Box
    text: Text
    dimensions: tuple[Dimension, ...]
    bound: float | None
    proven: bool | None
    plant: Corner | None
    name: Text
    reason: Text
    cells: int
    corners: int
    arithmetic: str = "float64"
    velocity: float = 0.05
    stated: Mapping[str, Any] | None = None

    @property
    def verdict(self) -> str:
        """The verdict in a word or two."""
        return {True: "proven", False: "not proven", None: "undecided"}[self.proven]

    @property
    def claim(self) -> Text:
        """What is to be proven, as a clause."""
        robust = "" if self.bound is None else f" and has Ms <= {Quantity(self.bound):6}"
        return Text(f"the loop is stable{robust} at every plant of the box, each constant in time")

    def sentence(self) -> Text:
        """Return the verdict as a clause."""
        if self.proven:
            return Text(f"proven: {self.claim}")
        return Text(f"{self.verdict}: {self.claim}; {self.reason}")

    def table(self) -> Table:
        """Tabulate the parameters of the box with both ends."""
        rows: list[list[Any]] = [
            [d.path, Quantity(d.at(-1.0), d.unit), Quantity(d.at(1.0), d.unit), UNIT] for d in self.dimensions
        ]
        more = [["more dead time", Quantity(0, "samples"), Quantity(self.box.dead_time, "samples"), UNIT]]
        title = Text(f"over the box: {self.verdict}, after {self.cells} cells of plants and frequencies")
        return Table(title, ["parameter", "from", "to", "unit"], [*rows, *(more if self.box.dead_time else [])])

    def record(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        return {
            "box": str(self.box),
            "arithmetic": self.arithmetic,
            "velocity_m_s": self.velocity,
            "parameters": self.text,
            "claim": self.claim,
            "verdict": self.verdict,
            "sensitivity_peak": self.bound,
            "plant": self.name or None,
            "reason": self.reason or None,
            "cells": self.cells,
            "corners": {"examined": self.corners, "most": int(WORK)},
        }


def stated(loop: Loop, box: Box, model: StateSpace) -> dict[str, Any]:
    """Return the plants and the control of a proof over a box as its file states them.

    model  the deployed control, from its readings to the force

    Raises ParameterError for a plant whose parameters do not enter with a matrix of rank one each.
    """
    return {
        "sample_time_s": float(loop.sample_time),
        "late_samples": box.dead_time,
        **_stated(loop.axis, box, model.inputs),
        "control": {"readings": list(model.inputs), **{name: getattr(model, name).tolist() for name in "ABCD"}},
    }


def document(proof: BoxProof, machine: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return the result as a document; that of a proof is one that `box_check` accepts.

    machine  names and SHA-256 digest of the machine file, if there is one
    """
    content = {
        "format": box_check.FORMAT,
        **proof.record(),
        "machine": dict(machine or {}),
        "outside": [OUTSIDE],
        **(proof.stated or {}),
    }
    return {**content, "sha256": box_check.digest(content)}


def prove_over_box(
    loop: Loop,
    box: Box,
    *,
    sensitivity_peak: float | None = None,
    arithmetic: str = "float64",
    velocity: float = 0.05,
    work: float = WORK,
) -> BoxProof:
    """Prove that a loop is stable, and that Ms <= `sensitivity_peak` if it is given, at every frozen plant of a box.

    work  largest number of corners of cells to examine; when they are used up, the result is undecided

    Raises ParameterError for a law with two rates, for a plant that is no chain of masses and springs, and for a box of
    so many dimensions that the first pass alone would take more than `work`.
    """
    if sensitivity_peak is not None and not sensitivity_peak > 1.0:
        raise ParameterError(f"max_ms = {Quantity(sensitivity_peak):6} must be above 1, as 2: |1 + L| is 1 without L")
    # the parameters enter one by one: with correlated errors the box around them is proven
    box = box.upright()
    dimensions = box.dimensions(loop.axis)
    grid = _intervals(0.5 / float(loop.sample_time))
    planned = len(grid) * 2.0 ** len(dimensions) * (box.dead_time + 1)
    if planned > work:
        raise ParameterError(
            f"box of {len(dimensions)} parameters: the first pass alone takes {Quantity(planned):2} corners of "
            f"{Quantity(work):2} that are examined at most: leave out the masses or the stiffnesses"
        )
    controller = deployed(loop.control, float(loop.sample_time), arithmetic, velocity)
    model = controller.model
    if isinstance(model, Lifted):
        raise ParameterError(
            "a law with two rates is not proven over a box: set position_every = 1, or certify discs without --box"
        )
    prover = Prover(loop, box, model, 0.0 if sensitivity_peak is None else 1.0 / sensitivity_peak)
    _check_model(prover, loop, box, velocity)
    search = _Search(prover, loop, box, model, sensitivity_peak, arithmetic, velocity)
    search.corners()
    search.run(grid, work)
    return search.result(grid)


def _intervals(nyquist: float) -> np.ndarray:
    """Return intervals of ω that cover 0 to Nyquist, rad/s, shape (intervals, 2)."""
    edges = 2.0 * np.pi * nyquist * np.geomspace(10.0**-_DECADES, 1.0, _DECADES * _PER_DECADE + 1)
    edges = np.concatenate([[0.0], edges[:-1], [edges[-1] * (1.0 + 1e-12)]])
    return np.stack([edges[:-1], edges[1:]], axis=1)


class _Search:
    """The halving of cells until each is proven, one is found that cannot be, or the work is used up."""

    def __init__(
        self,
        prover: Prover,
        loop: Loop,
        box: Box,
        model: StateSpace,
        bound: float | None,
        arithmetic: str,
        velocity: float,
    ) -> None:
        self.prover, self.loop, self.box, self.model = prover, loop, box, model
        self.bound, self.arithmetic, self.velocity = bound, arithmetic, velocity
        self.cells = self.examined = 0
        self.trees = _Trees()
        self.proven: bool | None = True
        self.plant: Corner | None = None
        self.reason = Text()

    def corners(self) -> None:
        """Refute the claim at an unstable corner or at an unstable model; a stable model is needed for the proof."""
        middle = [Corner((0.0,) * self.prover.family.count, late) for late in range(self.box.dead_time + 1)]
        for corner in (*middle, *self.box.corners(self.loop.axis)):
            if self._refuted(corner, None):
                return
        for corner in middle:
            if not self._stable_in_integers(corner):
                self.proven, self.plant = None, corner
                self.reason = Text("the model itself is not stable in exact arithmetic")
                return

    def _response(self, corner: Corner) -> LoopResponse:
        """Return the loop of the deployed control with a sampled plant of the box."""
        loop = self.box.plant(self.loop, corner)
        T = float(loop.sample_time)
        plant = modelled_plant("plant", loop.axis, loop.control, T, self.model.inputs, self.velocity)
        return LoopResponse(self.model, plant.model, ())

    def _stable_in_integers(self, corner: Corner) -> bool:
        """Return True if the loop with a sampled plant is stable, by its Routh array in whole numbers."""
        found = self._response(corner)
        (Dc, Nc), (Dp, Np) = (
            check.polynomials({name: getattr(model, name).tolist() for name in "ABCD"})
            for model in (self.model, found.plant)
        )
        parts = [check.times(Nc[0, i], Np[i, 0]) for i in range(len(self.model.inputs))]
        return check.stable([x - sum(part[k] for part in parts) for k, x in enumerate(check.times(Dc, Dp))])

    def _refuted(self, corner: Corner, frequency: float | None) -> bool:
        """Return True, and note the plant, if its loop is unstable or |S| exceeds the bound at `frequency`."""
        found, name = self._response(corner), self.box.named(self.loop.axis, corner)
        reason = Text()
        if found.growth >= 1.0:
            reason = Text(f"unstable at {name}: a pole at |z| = {Quantity(found.growth):.6f}")
        elif frequency is not None and self.bound is not None:
            peak = 1.0 / float(np.abs(1.0 + found.gains(np.array([frequency])).sum(axis=0))[0])
            if peak > self.bound:
                reason = Text(f"at {name} |S| is {Quantity(peak):5} at {Quantity(frequency, 'Hz'):4}")
        if reason:
            self.proven, self.plant, self.reason = False, corner, reason
        return bool(reason)

    def run(self, grid: np.ndarray, work: float) -> None:
        """Examine all cells; `work` corners at most."""
        count, corners = self.prover.family.count, 2**self.prover.family.count
        lates = np.arange(self.box.dead_time + 1.0)
        n = len(grid) * lates.size
        # wider by more than the rounding of their middles, so that neighbors overlap
        half = 0.5 * np.diff(grid, axis=1)[:, 0] * (1.0 + 1e-12)
        middle, half = np.tile(np.mean(grid, axis=1), lates.size), np.tile(half, lates.size)
        every = Cells(middle, half, -np.ones((n, count)), np.ones((n, count)), np.repeat(lates, len(grid)))
        # a plant at which the claim is wrong was found before
        waiting = [(every, self.trees.grown(n))] if self.proven else []
        most = max(1, _CHUNK // corners)
        while waiting:
            cells, numbers = waiting.pop()
            if cells.omega.size > most:
                waiting.append((cells.take(np.arange(most, cells.omega.size)), numbers[most:]))
                cells, numbers = cells.take(np.arange(most)), numbers[:most]
            if self.examined + cells.omega.size * corners > work:
                self.proven, self.plant = None, _middle(cells, 0)
                self.reason = Text(
                    f"{Quantity(self.examined):3} corners of cells were examined, as many as are allowed"
                )
                return
            self.cells, self.examined = self.cells + cells.omega.size, self.examined + cells.omega.size * corners
            judged = self.prover.judged(cells)
            for i in np.flatnonzero(judged.violated)[:8]:
                if self._refuted(_corner(cells, i, int(judged.worst[i])), float(cells.omega[i] / (2.0 * np.pi))):
                    return
            self.trees.leave(numbers[judged.holds], judged.direction[judged.holds])
            left = np.flatnonzero(~judged.holds)
            if not left.size:
                continue
            cells, numbers, judged = cells.take(left), numbers[left], Judged(*(part[left] for part in judged))
            if self._stuck(cells, judged):
                return
            waiting.append((_halved(cells, judged.side), self.trees.halve(numbers, judged.side)))

    def _stuck(self, cells: Cells, judged: Judged) -> bool:
        """Return True, with the reason noted, if a cell is too small to be halved, or small and open at a corner."""
        count = self.prover.family.count
        share = (cells.delta / np.maximum(cells.omega, 1e-300))[:, None]
        width = np.concatenate([cells.high - cells.low, share], axis=1)
        least, small = np.append(np.full(count, _SMALL), _NARROW), np.append(np.full(count, _NEAR[1]), _NEAR[0])
        # below a billionth of Nyquist the first interval has no relative width
        stuck = (width < least)[np.arange(share.size), judged.side] | (cells.omega * self.prover.T < 1e-9 * np.pi)
        # halving lowers the bound of the images hardly any more
        stuck |= judged.open & np.all(width < small, axis=1)
        for i in np.flatnonzero(stuck)[:1]:
            corner, frequency = _corner(cells, i, int(judged.worst[i])), float(cells.omega[i] / (2.0 * np.pi))
            if not self._refuted(corner, frequency):
                self.proven, self.plant = None, corner
                self.reason = Text(
                    f"{self.box.named(self.loop.axis, corner)} is too near to the bound at "
                    f"{Quantity(frequency, 'Hz'):4} to decide"
                )
            return True
        return False

    def _stated(self, grid: np.ndarray) -> dict[str, Any] | None:
        """Return what a second program needs; None without a proof, and if there are too many cells for a file."""
        if not self.proven or self.cells > _RECORDED:
            return None
        return {
            **stated(self.loop, self.box, self.model),
            "frequencies_rad_s": [0.0, *grid[:, 1].tolist()],
            "directions": _AROUND,
            "trees": list(self.trees.texts(len(grid) * (self.box.dead_time + 1))),
        }

    def result(self, grid: np.ndarray) -> BoxProof:
        """Return what was found."""
        axis = self.loop.axis
        name = Text() if self.plant is None else self.box.named(axis, self.plant)
        return BoxProof(
            self.box,
            self.box.text(axis),
            self.box.dimensions(axis),
            self.bound,
            self.proven,
            self.plant,
            name,
            self.reason,
            self.cells,
            self.examined,
            self.arithmetic,
            self.velocity,
            self._stated(grid),
        )


class _Trees:
    """The halvings of cells: for each cell the code of a direction, or -1 - side and the numbers of its halves.

    Cells are no longer kept once there are more than `_RECORDED` of them.
    """

    def __init__(self) -> None:
        self.count = 0
        self._codes, self._halves = np.zeros(1024, np.int64), np.zeros((1024, 2), np.int64)

    def grown(self, count: int) -> np.ndarray:
        """Return the numbers of so many new cells."""
        numbers = np.arange(self.count, self.count + count)
        self.count += count
        if self.count > len(self._codes) and self.count <= _RECORDED:
            more = max(self.count, 2 * len(self._codes)) - len(self._codes)
            self._codes = np.concatenate([self._codes, np.zeros(more, np.int64)])
            self._halves = np.concatenate([self._halves, np.zeros((more, 2), np.int64)])
        return numbers

    def leave(self, numbers: np.ndarray, directions: np.ndarray) -> None:
        """Note the directions of cells that are proven."""
        if self.count <= _RECORDED:
            self._codes[numbers] = directions

    def halve(self, numbers: np.ndarray, side: np.ndarray) -> np.ndarray:
        """Note that cells are halved; return the numbers of all lower halves, and then of all upper ones."""
        halves = self.grown(2 * numbers.size)
        if self.count <= _RECORDED:
            self._codes[numbers] = -1 - side
            self._halves[numbers, 0], self._halves[numbers, 1] = np.split(halves, 2)
        return halves

    def texts(self, roots: int) -> Iterator[list[int]]:
        """Yield the cells of each root, each one before its lower and then its upper half."""
        codes, halves = self._codes.tolist(), self._halves.tolist()
        for root in range(roots):
            found, waiting = list[int](), [root]
            while waiting:
                cell = waiting.pop()
                found.append(codes[cell])
                if codes[cell] < 0:
                    waiting += halves[cell][::-1]
            yield found


def _corner(cells: Cells, i: int, corner: int) -> Corner:
    """Return a corner of a cell as a plant of the box."""
    count = cells.low.shape[1]
    upper = [bool(corner >> (count - 1 - k) & 1) for k in range(count)]
    place = np.where(upper, cells.high[i], cells.low[i]) if count else np.zeros(0)
    return Corner(tuple(place.tolist()), int(cells.late[i]))


def _middle(cells: Cells, i: int) -> Corner:
    """Return the middle of a cell as a plant of the box."""
    return Corner(tuple((0.5 * (cells.low[i] + cells.high[i])).tolist()), int(cells.late[i]))


def _halved(cells: Cells, side: np.ndarray) -> Cells:
    """Return both halves of each cell, along its side."""
    count = cells.low.shape[1]
    lower, upper = (Cells(*(np.array(part) for part in cells)) for _ in range(2))
    for k in range(count):
        here = side == k
        half = 0.5 * (cells.low[here, k] + cells.high[here, k])
        lower.high[here, k], upper.low[here, k] = half, half
    here = side == count
    # wider by more than the rounding of their middles
    half = 0.5 * cells.delta[here]
    lower.omega[here], upper.omega[here] = cells.omega[here] - half, cells.omega[here] + half
    for part in (lower, upper):
        part.delta[here] = half * (1.0 + 1e-12)
    return Cells.joined((lower, upper))


def _check_model(prover: Prover, loop: Loop, box: Box, velocity: float) -> None:
    """Raise ParameterError unless the sum over images is the sampled model of the loop, at the model and in the box.

    Friction whose slope at the velocity is not viscous is such a difference, and forces that depend on the position.
    """
    f = 0.5 / prover.T * np.geomspace(1e-5, 0.9, _COMPARED)
    s = 2j * np.pi * f
    zero = np.zeros(f.size)
    for corner in (Corner((0.0,) * prover.family.count, 0), *box.drawn(loop.axis, 2, 0)):
        model = linearize(box.plant(loop, corner), ["cut"], prover.readings, velocity=velocity)
        place = np.broadcast_to(np.array(corner.place).reshape(1, -1), (f.size, prover.family.count))
        cells = Cells(np.abs(s), zero, place, place, np.full(f.size, float(corner.late)))
        corners = prover.family.corners(place, place)[:, :1]
        den, *nums = np.sum(corners[:, 0] * (s[:, None] ** prover.powers)[:, None], axis=2).T
        G, tails = prover.drive(cells.omega, zero, cells.late).value, prover.tails(corners, cells)
        for i, num in enumerate(nums):
            response = model.response(f, prover.readings[i], "cut").response
            apart = np.abs(response - G * num / den)
            at = int(np.argmax(apart - (tails[:, i] + _AGREES * np.abs(response))))
            if not apart[at] <= tails[at, i] + _AGREES * abs(response[at]):
                raise ParameterError(
                    f"the sampled model of the axis is not that of its masses, springs and viscous friction: at "
                    f"{Quantity(f[at], 'Hz'):3} they differ by {Quantity(apart[at] / abs(response[at]), 'share'):2}. "
                    "Friction whose slope changes with velocity, or a force that depends on the position, is not "
                    "proven over a box: prove at another --velocity, or leave the force out"
                )
