"""Zero phase error tracking: a set path through the inverse of the closed loop, as far as that is stable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity, number
from feeddrive.learning.set_path import ChangedReference, SetPath, changed, sampled, set_path
from feeddrive.loop.loop import Loop

_ORIGIN = 1e-6  # of |z|: poles below are delays
_LEFT = 0.6  # |z| from which a zero left of the imaginary axis would ring: it is not inverted
_REST = 1e-6  # of the largest coefficient: what is below it in the numerator is rounding
_SETTLING = 0.05  # s of rest after the end


@dataclass(frozen=True, eq=False)
class InversePath:
    """The closed loop from set position to table, T_r = q^r B⁺ B⁻ / A in q = z⁻¹, coefficients from q⁰ on.

    B⁻, normalized to begin with 1, holds the zeros that are not inverted: |z| >= 1, or left of 0 with |z| > 0.6.
    """

    A: np.ndarray
    inverted: np.ndarray
    kept: np.ndarray
    delay: int

    @property
    def preview(self) -> int:
        """The samples r + s that the set path must be known ahead, s = deg B⁻."""
        return self.delay + self.kept.size - 1

    def gain(self, frequency: np.ndarray, sample_time: float) -> np.ndarray:
        """Return |B⁻(e^jω)|² / B⁻(1)²: the product of T_r and the filter, whose phase is 0."""
        z = np.exp(-2j * np.pi * frequency * sample_time)
        return np.abs(np.polyval(self.kept[::-1], z)) ** 2 / np.sum(self.kept) ** 2

    def filtered(self, wanted: np.ndarray) -> np.ndarray:
        """Return x_r'(k) = A(q) B⁻(q⁻¹) / (B⁺(q) B⁻(1)²) x_r(k + r), for a wanted path at rest at both ends."""
        from scipy.signal import lfilter  # not for commands that only read

        s = self.kept.size - 1
        ahead = np.concatenate([wanted - wanted[0], np.full(self.preview, wanted[-1] - wanted[0])])
        smooth = np.convolve(ahead, self.kept[::-1])[s + self.delay :][: wanted.size]
        return wanted[0] + lfilter(self.A, self.inverted * np.sum(self.kept) ** 2, smooth)


def inverse_path(loop: Loop | SetPath) -> InversePath:
    """Return the closed loop as polynomials: A from its poles, B from its Markov parameters, which loses no digits.

    Raises UnstableError for a loop that is not stable, and ParameterError for one with a slow part.
    """
    path = loop if isinstance(loop, SetPath) else set_path(loop)
    if path.period > 1:
        raise ParameterError(
            f"zero phase error tracking needs a loop that is the same in every sample; this one repeats itself after "
            f"{path.period}: take filtered splines"
        )
    poles = np.linalg.eigvals(path.samples[0].A)
    if np.max(np.abs(poles)) >= 1.0:
        raise UnstableError(f"the loop is unstable: a pole has |z| = {number(np.max(np.abs(poles)), 6)}")
    A = np.real(np.poly(poles[np.abs(poles) > _ORIGIN ** (1.0 / 3.0)]))
    rows = 2 * poles.size + 4
    impulse = np.zeros((rows, 1))
    impulse[0] = 1.0
    whole = np.convolve(A, path.answers(impulse)[:, 0])[:rows]
    there = np.flatnonzero(np.abs(whole) > _REST * np.max(np.abs(whole)))
    delay, B = int(there[0]), whole[there[0] : there[-1] + 1]
    zeros = np.roots(B)
    away = (np.abs(zeros) >= 1.0) | ((zeros.real < 0.0) & (np.abs(zeros) > _LEFT))
    kept = np.real(np.poly(zeros[away]))
    return InversePath(A, B[0] * np.real(np.poly(zeros[~away])), kept, delay)


def zero_phase(loop: Loop, reference: Reference) -> ChangedReference:
    """Return set positions with which the table follows a reference without phase error, by the linear model of the
    loop.

        T_r = q^r B⁺ B⁻ / A,    x_r'(k) = A(q) B⁻(q⁻¹) / (B⁺(q) B⁻(1)²) x_r(k + r)

    The motion begins r + s samples later (`lead`), since the path is looked at so far ahead.
    When to use: on smooth moves with a loop that is known and linear.  When not: against friction, for which it does
    nothing; with gains that are turned afterwards; with 20 % of unknown load most of its advantage is gone.
    Raises ParameterError where the polynomials lose their digits, from about degree 10 on (filters, two encoders).
    Source: Tomizuka 1987; which zeros are kept, and B by Markov parameters, are this library's.
    """
    model, T = set_path(loop), float(loop.sample_time)
    path = inverse_path(model)
    wanted = sampled(reference, T, path.preview, round(_SETTLING / T))
    filtered = path.filtered(wanted)
    before, after = (_left(model, positions, wanted) for positions in (wanted, filtered))
    if not after < before:
        raise ParameterError(
            f"the model of the loop itself is {Quantity(after, 'm')} off the path with this inverse, and "
            f"{Quantity(before, 'm')} without: polynomials of degree {path.A.size - 1} have lost their digits; take "
            "filtered splines"
        )
    return changed(filtered, wanted, T, path.preview)


def _left(model: SetPath, positions: np.ndarray, wanted: np.ndarray) -> float:
    """Return the largest distance of the model's table from the wanted path, m."""
    return float(np.max(np.abs(model.answers((positions - wanted[0])[:, None])[:, 0] - (wanted - wanted[0]))))
