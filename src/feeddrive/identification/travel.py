"""Numbers of an axis over its travel, over the payload, or over both, from measurements at a few places."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table

FEWEST, MOST = 3, 10  # positions, and payloads: with fewer nothing contradicts a curve, with more each is its own place
_DEGREE = 2  # highest power: the compliance of a screw that is held at both ends is x (L - x)/(L E A)
_SURE = 0.99  # probability with which the scatter of a right curve would be smaller


@dataclass(frozen=True, eq=False, repr=False)
class TravelFit(Result):
    """A number of an axis as a polynomial of the position, and of the payload, fitted to values at known places.

        q(x, m) = Σ_j Σ_k a_jk t^j s^k,   t = (2 x - x_first - x_last)/(x_last - x_first),   -1 <= t <= 1
                                          s the same of the payload m;   k = 0 alone without payloads
    q is the number itself or, if `inverse`, its inverse: springs in series add their compliances, so that the
    compliance of a screw and its bearings is linear in the position if one end is held (1/k_b + x/(E A)) and quadratic
    if both are.  Masses and friction are fitted as they are.

    name, unit    of the number;  `over` is the unit of the places: m for positions, kg for payloads
    places        where was measured, ascending, shape (n,)
    values        the measured values, shape (n,), with their standard errors `errors`; None if none are known
    coefficients  a_00, a_01 ... a_10 ..., with their covariance
    payloads      the payload in kg of each place, shape (n,); None for a number over the position alone
    payload_degree  the highest power of s
    """

    name: str
    unit: str
    over: str
    inverse: bool
    places: np.ndarray
    values: np.ndarray
    errors: np.ndarray | None
    coefficients: np.ndarray
    covariance: np.ndarray
    payloads: np.ndarray | None = None
    payload_degree: int = 0

    @property
    def degree(self) -> int:
        """The highest power of t: 0 for a number that does not change along the travel."""
        return self.coefficients.size // (self.payload_degree + 1) - 1

    def at(self, place: float, payload: float | None = None) -> tuple[float, float]:
        """Return the number at a place, and with a payload if it was measured over both, and its standard error.

        Raises ParameterError for a place outside of those that were measured: nothing is extrapolated.
        """
        if (payload is None) != (self.payloads is None):
            raise ParameterError(
                f"{self.name} was measured "
                + ("for one payload: leave out the payload" if self.payloads is None else "with payloads: name one")
            )
        for value, row, unit in ((place, self.places, self.over), (payload, self.payloads, "kg")):
            if row is not None and value is not None and not np.min(row) <= value <= np.max(row):
                raise ParameterError(
                    f"{self.name} at {Quantity(value, unit):6 SI}: it was measured from "
                    f"{Quantity(float(np.min(row)), unit):6 SI} to {Quantity(float(np.max(row)), unit):6 SI}, and "
                    f"nothing is extrapolated; measure there, too"
                )
        return self._at(place, payload)

    def with_payload(self, payload: float) -> Self:
        """Return the fit over the positions alone, with one payload (kg).

        Its places are the measured positions, and its values those of the polynomial there.
        """
        assert self.payloads is not None
        places = np.unique(self.places)
        found = np.array([self.at(float(place), payload) for place in places])
        # s^k of the payload, once for each power of t
        along = _powers((self.payloads, None), (np.array([payload]), None), (self.payload_degree, 0))
        turn = np.kron(np.eye(self.degree + 1), along)
        return replace(
            self,
            places=places,
            values=found[:, 0],
            errors=found[:, 1],
            coefficients=turn @ self.coefficients,
            covariance=turn @ self.covariance @ turn.T,
            payloads=None,
            payload_degree=0,
        )

    def _at(self, place: float, payload: float | None) -> tuple[float, float]:
        at = np.array([place]), None if payload is None else np.array([payload])
        row = _powers((self.places, self.payloads), at, (self.degree, self.payload_degree))[0]
        value, error = float(row @ self.coefficients), float(np.sqrt(max(row @ self.covariance @ row, 0.0)))
        return (1.0 / value, error / value**2) if self.inverse else (value, error)

    @cached_property
    def fitted(self) -> tuple[np.ndarray, np.ndarray]:
        """The fitted numbers at the measured places, and their standard errors, shape (n,) each."""
        loads = [None] * self.places.size if self.payloads is None else self.payloads.tolist()
        rows = [self._at(float(place), load) for place, load in zip(self.places, loads, strict=True)]
        return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])

    def table(self) -> Table:
        """Return the measured and fitted numbers at each place, with their standard errors."""
        errors = [None] * self.places.size if self.errors is None else self.errors.tolist()
        loads = [()] * self.places.size if self.payloads is None else [(float(load),) for load in self.payloads]
        rows = [
            [float(place), *load, float(value), error, float(fitted), float(of_fit)]
            for place, load, value, error, fitted, of_fit in zip(
                self.places, loads, self.values, errors, *self.fitted, strict=True
            )
        ]
        columns = [
            Column("place", self.over, "5 SI"),
            *(() if self.payloads is None else (Column("payload", "kg", "5 SI"),)),
            Column("measured", self.unit),
            Column("standard error", self.unit),
            Column("fitted", self.unit),
            Column("its error", self.unit),
        ]
        powers = "constant", "linear", "quadratic"
        with_load = "" if self.payloads is None else f", {powers[self.payload_degree]} in the payload"
        said = f"{'its inverse ' if self.inverse else ''}{powers[self.degree]}{with_load}"
        return Table(f"{self.name} over the travel, {said}", columns, rows)


def fit_over_travel(
    places: Sequence[float] | np.ndarray,
    values: Sequence[float] | np.ndarray,
    errors: Sequence[float] | np.ndarray | None = None,
    *,
    name: str = "stiffness",
    unit: str = "N/m",
    over: str = "m",
    inverse: bool | None = None,
    payloads: Sequence[float] | np.ndarray | None = None,
) -> TravelFit:
    """Fit a number of an axis over the places at which it was measured.

    places   positions in m, or payloads in kg (`over`), shape (n,), 3 <= n <= 10, in any order
    values   the number at each place, > 0 if it is fitted by its inverse
    errors   its standard errors; without them the scatter about the curve takes their place
    inverse  True to fit the inverse; default: True for a stiffness, in N/m or N m/rad
    payloads the mass on the table at each place, kg, for a number of both: 3 to 10 positions and payloads, among the
             pairs the first and the last position with the least and the largest payload, so that all between lies
             within what was measured; not every pair need be measured

    The polynomial has the lowest power, up to 2 and n - 2, whose scatter the standard errors explain (χ² at 99 %).
    Without errors it has the power with the smallest error of prediction when each place is left out in turn, and the
    standard errors follow from the scatter with n - power - 1 degrees of freedom.  With payloads it has the fewest
    coefficients of all pairs of powers, and of two with as many the ones that leave less scatter.

    Raises ParameterError for too few or too many places, a place that is given twice, numbers that are not finite or
    have the wrong sign, and rows of different lengths; NotIdentifiableError if no such polynomial explains the values.
    """
    from scipy.special import chdtri

    x, y = np.asarray(places, float), np.asarray(values, float)
    sigma = None if errors is None else np.asarray(errors, float)
    loads = None if payloads is None else np.asarray(payloads, float)
    inverse = unit in ("N/m", "N m/rad") if inverse is None else inverse
    _check(name, unit, over, x, y, sigma, loads, inverse)
    order = np.lexsort((x,) if loads is None else (loads, x))
    x, y = x[order], y[order]
    sigma = None if sigma is None else sigma[order]
    loads = None if loads is None else loads[order]
    q = 1.0 / y if inverse else y
    weight = np.ones(x.size) if sigma is None else 1.0 / (sigma / y**2 if inverse else sigma)
    fits = (_fit(x, loads, q, weight, degrees) for degrees in _candidates(x, loads))
    candidates = [fit for fit in fits if fit is not None]
    if sigma is None:
        # by the same numbers where several powers explain the values exactly: the lowest one
        size = float(np.max(np.abs(q)))
        left_out = [max(fit.left_out, 1e-12 * size) for fit in candidates]
        fit = candidates[int(np.argmin(left_out))]
        covariance = fit.covariance * fit.scatter / (x.size - fit.coefficients.size)
    else:
        explained = [
            fit for fit in candidates if fit.scatter <= float(chdtri(x.size - fit.coefficients.size, 1.0 - _SURE))
        ]
        if not explained:
            last = candidates[-1]
            raise NotIdentifiableError(
                f"{name} at {x.size} places: the scatter about a curve of power "
                f"{' and '.join(map(str, last.degrees[: 1 if loads is None else 2]))} is "
                f"{Quantity(float(np.sqrt(last.scatter / (x.size - last.coefficients.size)))):3} times what the "
                f"standard errors explain; measure at more places, or give larger errors if they leave something out"
            )
        fit = min(explained, key=lambda fit: (fit.coefficients.size, fit.scatter))
        covariance = fit.covariance
    found = TravelFit(name, unit, over, inverse, x, y, sigma, fit.coefficients, covariance, loads, fit.degrees[1])
    everywhere = np.linspace(x[0], x[-1], 201)
    grid = everywhere, None
    if loads is not None:
        some = np.linspace(np.min(loads), np.max(loads), 41)
        grid = np.repeat(everywhere, some.size), np.tile(some, everywhere.size)
    along = _powers((x, loads), grid, fit.degrees) @ fit.coefficients
    if np.all(y > 0.0) and np.min(along) <= 0.0:
        raise NotIdentifiableError(
            f"{name}: between the places the curve falls to 0, although every measured value is > 0; measure at more "
            f"places"
        )
    return found


def require_pairs(name: str, places: np.ndarray, payloads: np.ndarray) -> None:
    """Raise ParameterError unless pairs of position (m) and payload (kg) enclose all that lies between them."""
    for what, row, unit in (("position", places, "m"), ("payload", payloads, "kg")):
        count = np.unique(row).size
        if not FEWEST <= count <= MOST:
            raise ParameterError(
                f"{name}: {count} {what}{'s' if count != 1 else ''}; {FEWEST} to {MOST} are needed: two fit any "
                f"straight line, so that nothing would show a wrong one; measure with another {what}"
            )
        if what == "payload" and np.min(row) < 0.0:
            raise ParameterError(f"{name}: payload {Quantity(float(np.min(row)), unit):6 SI} must be >= 0")
    pairs = set(zip(places.tolist(), payloads.tolist(), strict=True))
    for place in (float(np.min(places)), float(np.max(places))):
        for load in (float(np.min(payloads)), float(np.max(payloads))):
            if (place, load) not in pairs:
                raise ParameterError(
                    f"{name}: no measurement at {Quantity(place, 'm'):6 SI} with {Quantity(load, 'kg'):6 SI}; the "
                    f"first and the last position are needed with the least and the largest payload: nothing is "
                    f"extrapolated; measure there, too"
                )


@dataclass(frozen=True)
class _Polynomial:
    degrees: tuple[int, int]
    coefficients: np.ndarray
    covariance: np.ndarray  # for errors of 1/weight
    scatter: float  # Σ (weight · residual)²
    left_out: float  # RMS of the residuals when each place is left out in turn


_Coordinates = tuple[np.ndarray, np.ndarray | None]  # positions and, if there are any, payloads


def _candidates(x: np.ndarray, loads: np.ndarray | None) -> list[tuple[int, int]]:
    """Return pairs of powers with at least one place more than coefficients, those with the fewest first."""
    first, second = (0 if row is None else min(_DEGREE, np.unique(row).size - 2, x.size - 2) for row in (x, loads))
    pairs = [(j, k) for j in range(first + 1) for k in range(second + 1) if (j + 1) * (k + 1) < x.size]
    return sorted(pairs, key=lambda pair: ((pair[0] + 1) * (pair[1] + 1), pair[1]))


def _powers(places: _Coordinates, at: _Coordinates, degrees: tuple[int, int]) -> np.ndarray:
    columns = np.ones((at[0].size, 1))
    for row, here, degree in zip(places, at, degrees, strict=True):
        if row is not None and here is not None:
            first, last = np.min(row), np.max(row)
            t = (2.0 * here - first - last) / (last - first)
            powers = np.stack([t**j for j in range(degree + 1)], axis=1)
            columns = np.einsum("nj,nk->njk", columns, powers).reshape(here.size, -1)
    return columns


def _fit(
    x: np.ndarray, loads: np.ndarray | None, q: np.ndarray, weight: np.ndarray, degrees: tuple[int, int]
) -> _Polynomial | None:
    """Return the fit with these powers; None if the places do not determine them."""
    rows = _powers((x, loads), (x, loads), degrees) * weight[:, None]
    if np.linalg.matrix_rank(rows) < rows.shape[1]:
        return None
    inverse = np.linalg.pinv(rows)
    coefficients = inverse @ (weight * q)
    residual = weight * q - rows @ coefficients
    # a residual of a place that is left out is that of the fit over 1 - its leverage
    leverage = np.einsum("ij,ji->i", rows, inverse)
    left_out = residual / weight / np.maximum(1.0 - leverage, 1e-12)
    return _Polynomial(
        degrees, coefficients, inverse @ inverse.T, float(residual @ residual), float(np.sqrt(np.mean(left_out**2)))
    )


def _check(
    name: str,
    unit: str,
    over: str,
    x: np.ndarray,
    y: np.ndarray,
    sigma: np.ndarray | None,
    loads: np.ndarray | None,
    inverse: bool,
) -> None:
    there = [row for row in (x, y, sigma, loads) if row is not None]
    if x.ndim != 1 or any(row.shape != x.shape for row in there):
        shapes = ", ".join(str(row.shape) for row in there)
        raise ParameterError(f"{name}: places, values and errors must be rows of one length, not of shapes {shapes}")
    if loads is None and not FEWEST <= x.size <= MOST:
        raise ParameterError(
            f"{name}: {x.size} places; {FEWEST} to {MOST} are needed: two places fit any straight line, so that "
            f"nothing would show a wrong one"
        )
    for what, row, unit_ in (("place", x, over), ("payload", loads, "kg"), ("value", y, unit), ("error", sigma, unit)):
        bad = np.zeros(0) if row is None else np.flatnonzero(~np.isfinite(row))
        if bad.size:
            raise ParameterError(f"{name}: {what} {bad[0] + 1} of {x.size} is not a finite number")
        positive = what == "error" or (what == "value" and inverse)
        wrong = np.zeros(0) if row is None or not positive else np.flatnonzero(row <= 0.0)
        if row is not None and wrong.size:
            shown = Quantity(float(row[wrong[0]]), unit_)
            raise ParameterError(f"{name}: {what} {wrong[0] + 1} of {x.size} is {shown:6 SI}; it must be > 0")
    loads_ = [None] * x.size if loads is None else loads.tolist()
    pairs = list(zip(x.tolist(), loads_, strict=True))
    twice = next((pair for pair in pairs if pairs.count(pair) > 1), None)
    if twice is not None:
        with_ = "" if twice[1] is None else f" with {Quantity(twice[1], 'kg'):6 SI}"
        raise ParameterError(
            f"{name}: the place {Quantity(twice[0], over):6 SI}{with_} is given twice; give each place once, with the "
            f"mean of its measurements"
        )
    if loads is not None:
        require_pairs(name, x, loads)
