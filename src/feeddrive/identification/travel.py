"""Numbers of an axis over its travel, or over the payload, from measurements at a few places."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table

FEWEST, MOST = 3, 10  # places: with fewer nothing contradicts a curve, and with more each place is its own measurement
_DEGREE = 2  # highest power: the compliance of a screw that is held at both ends is x (L - x)/(L E A)
_SURE = 0.99  # probability with which the scatter of a right curve would be smaller


@dataclass(frozen=True, eq=False, repr=False)
class TravelFit(Result):
    """A number of an axis as a polynomial of the position, fitted to values at known places.

        q(x) = Σ_j a_j t^j,   t = (2 x - x_first - x_last)/(x_last - x_first),   -1 <= t <= 1

    q is the number itself or, if `inverse`, its inverse: springs in series add their compliances, so that the
    compliance of a screw and its bearings is linear in the position if one end is held (1/k_b + x/(E A)) and quadratic
    if both are.  Masses and friction are fitted as they are.

    name, unit    of the number;  `over` is the unit of the places: m for positions, kg for payloads
    places        where was measured, ascending, shape (n,)
    values        the measured values, shape (n,), with their standard errors `errors`; None if none are known
    coefficients  a_0 ... a_d, with their covariance (d + 1, d + 1)
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

    @property
    def degree(self) -> int:
        """The power of the polynomial: 0 for a number that does not change along the travel."""
        return self.coefficients.size - 1

    def at(self, place: float) -> tuple[float, float]:
        """Return the number at a place and its standard error.

        Raises ParameterError for a place outside of those that were measured: nothing is extrapolated.
        """
        first, last = float(self.places[0]), float(self.places[-1])
        if not first <= place <= last:
            raise ParameterError(
                f"{self.name} at {Quantity(place, self.over):6 SI}: it was measured from "
                f"{Quantity(first, self.over):6 SI} to {Quantity(last, self.over):6 SI}, and nothing is extrapolated; "
                f"measure there, too"
            )
        return self._at(place)

    def _at(self, place: float) -> tuple[float, float]:
        row = _powers(self.places, np.array([place]), self.degree)[0]
        value, error = float(row @ self.coefficients), float(np.sqrt(max(row @ self.covariance @ row, 0.0)))
        return (1.0 / value, error / value**2) if self.inverse else (value, error)

    @cached_property
    def fitted(self) -> tuple[np.ndarray, np.ndarray]:
        """The fitted numbers at the measured places, and their standard errors, shape (n,) each."""
        rows = [self._at(float(place)) for place in self.places]
        return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])

    def table(self) -> Table:
        """Return the measured and fitted numbers at each place, with their standard errors."""
        errors = [None] * self.places.size if self.errors is None else self.errors.tolist()
        rows = [
            [float(place), float(value), error, float(fitted), float(of_fit)]
            for place, value, error, fitted, of_fit in zip(self.places, self.values, errors, *self.fitted, strict=True)
        ]
        columns = [
            Column("place", self.over, "5 SI"),
            Column("measured", self.unit),
            Column("standard error", self.unit),
            Column("fitted", self.unit),
            Column("its error", self.unit),
        ]
        power = ("constant", "linear", "quadratic")[self.degree]
        return Table(f"{self.name} over the travel, {'its inverse ' if self.inverse else ''}{power}", columns, rows)


def fit_over_travel(
    places: Sequence[float] | np.ndarray,
    values: Sequence[float] | np.ndarray,
    errors: Sequence[float] | np.ndarray | None = None,
    *,
    name: str = "stiffness",
    unit: str = "N/m",
    over: str = "m",
    inverse: bool | None = None,
) -> TravelFit:
    """Fit a number of an axis over the places at which it was measured.

    places   positions in m, or payloads in kg (`over`), shape (n,), 3 <= n <= 10, in any order
    values   the number at each place, > 0 if it is fitted by its inverse
    errors   its standard errors; without them the scatter about the curve takes their place
    inverse  True to fit the inverse; default: True for a stiffness, in N/m or N m/rad

    The polynomial has the lowest power, up to 2 and n - 2, whose scatter the standard errors explain (χ² at 99 %).
    Without errors it has the power with the smallest error of prediction when each place is left out in turn, and the
    standard errors follow from the scatter with n - power - 1 degrees of freedom.

    Raises ParameterError for too few or too many places, a place that is given twice, numbers that are not finite or
    have the wrong sign, and rows of different lengths; NotIdentifiableError if no such polynomial explains the values.
    """
    from scipy.special import chdtri

    x, y = np.asarray(places, float), np.asarray(values, float)
    sigma = None if errors is None else np.asarray(errors, float)
    inverse = unit in ("N/m", "N m/rad") if inverse is None else inverse
    _check(name, unit, over, x, y, sigma, inverse)
    order = np.argsort(x)
    x, y = x[order], y[order]
    sigma = None if sigma is None else sigma[order]
    q = 1.0 / y if inverse else y
    weight = np.ones(x.size) if sigma is None else 1.0 / (sigma / y**2 if inverse else sigma)
    candidates = [_fit(x, q, weight, degree) for degree in range(min(_DEGREE, x.size - 2) + 1)]
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
                f"{name} at {x.size} places: the scatter about a curve of power {last.coefficients.size - 1} is "
                f"{Quantity(float(np.sqrt(last.scatter / (x.size - last.coefficients.size)))):3} times what the "
                f"standard errors explain; measure at more places, or give larger errors if they leave something out"
            )
        fit, covariance = explained[0], explained[0].covariance
    found = TravelFit(name, unit, over, inverse, x, y, sigma, fit.coefficients, covariance)
    along = _powers(x, np.linspace(x[0], x[-1], 201), found.degree) @ fit.coefficients
    if np.all(y > 0.0) and np.min(along) <= 0.0:
        raise NotIdentifiableError(
            f"{name}: between the places the curve falls to 0, although every measured value is > 0; measure at more "
            f"places"
        )
    return found


@dataclass(frozen=True)
class _Polynomial:
    coefficients: np.ndarray
    covariance: np.ndarray  # for errors of 1/weight
    scatter: float  # Σ (weight · residual)²
    left_out: float  # RMS of the residuals when each place is left out in turn


def _powers(places: np.ndarray, at: np.ndarray, degree: int) -> np.ndarray:
    t = (2.0 * at - places[0] - places[-1]) / (places[-1] - places[0])
    return np.stack([t**j for j in range(degree + 1)], axis=1)


def _fit(x: np.ndarray, q: np.ndarray, weight: np.ndarray, degree: int) -> _Polynomial:
    rows = _powers(x, x, degree) * weight[:, None]
    inverse = np.linalg.pinv(rows)
    coefficients = inverse @ (weight * q)
    residual = weight * q - rows @ coefficients
    # a residual of a place that is left out is that of the fit over 1 - its leverage
    leverage = np.einsum("ij,ji->i", rows, inverse)
    left_out = residual / weight / np.maximum(1.0 - leverage, 1e-12)
    return _Polynomial(
        coefficients, inverse @ inverse.T, float(residual @ residual), float(np.sqrt(np.mean(left_out**2)))
    )


def _check(
    name: str, unit: str, over: str, x: np.ndarray, y: np.ndarray, sigma: np.ndarray | None, inverse: bool
) -> None:
    if x.ndim != 1 or y.shape != x.shape or (sigma is not None and sigma.shape != x.shape):
        shapes = ", ".join(str(row.shape) for row in (x, y, *(() if sigma is None else (sigma,))))
        raise ParameterError(f"{name}: places, values and errors must be rows of one length, not of shapes {shapes}")
    if not FEWEST <= x.size <= MOST:
        raise ParameterError(
            f"{name}: {x.size} places; {FEWEST} to {MOST} are needed: two places fit any straight line, so that "
            f"nothing would show a wrong one"
        )
    for what, row, unit_ in (("place", x, over), ("value", y, unit), ("error", sigma, unit)):
        bad = np.zeros(0) if row is None else np.flatnonzero(~np.isfinite(row))
        if bad.size:
            raise ParameterError(f"{name}: {what} {bad[0] + 1} of {x.size} is not a finite number")
        positive = what == "error" or (what == "value" and inverse)
        wrong = np.zeros(0) if row is None or not positive else np.flatnonzero(row <= 0.0)
        if row is not None and wrong.size:
            shown = Quantity(float(row[wrong[0]]), unit_)
            raise ParameterError(f"{name}: {what} {wrong[0] + 1} of {x.size} is {shown:6 SI}; it must be > 0")
    twice = np.flatnonzero(np.diff(np.sort(x)) == 0.0)
    if twice.size:
        place = float(np.sort(x)[twice[0]])
        raise ParameterError(
            f"{name}: the place {Quantity(place, over):6 SI} is given twice; give each place once, with the mean of "
            f"its measurements"
        )
