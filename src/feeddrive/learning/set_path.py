"""Set paths that compensate the response of a loop in advance: filtered splines, and zero-phase inversion."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity, number
from feeddrive.loop.linearize import StateSpace, lifted, linearize
from feeddrive.loop.loop import Loop

_INPUTS, _OUTPUTS = ("set_position", "set_velocity"), ("position_load",)


@dataclass(frozen=True, eq=False)
class SetPath:
    """The linear model of a loop from set positions to table positions; the set velocity is the backward difference.

    samples  the linear model of each sample of a period; most loops have only one
    """

    samples: tuple[StateSpace, ...]

    @property
    def sample_time(self) -> float:
        """The time T of one sample, s."""
        return float(self.samples[0].sample_time)

    @property
    def period(self) -> int:
        """The period of a multirate loop in samples; 1 for all other loops."""
        return len(self.samples)

    def answers(self, positions: np.ndarray, phase: int = 0) -> np.ndarray:
        """Return the table positions in m for set positions, both of shape (n, columns).

        The set positions are 0 before row 0, which is sample `phase` of the period.
        """
        # the controller of the machine receives positions and differences them itself
        velocity = np.diff(positions, axis=0, prepend=0.0) / self.sample_time
        x = np.zeros((self.samples[0].A.shape[0], positions.shape[1]))
        table = np.empty(positions.shape)
        for k in range(positions.shape[0]):
            sample = self.samples[(phase + k) % self.period]
            u = np.stack([positions[k], velocity[k]])
            table[k] = (sample.C @ x + sample.D @ u)[0]
            x = sample.A @ x + sample.B @ u
        return table


def set_path(loop: Loop, *, velocity: float = 0.05) -> SetPath:
    """Return the linear model of a loop that moves at `velocity` (m/s), from set positions to table positions.

    Feedforward of acceleration, jerk and snap has no effect, since a list of set positions does not contain them.
    """
    if loop.control.law.period() > 1:
        return SetPath(lifted(loop, _INPUTS, _OUTPUTS, velocity=velocity).samples)
    return SetPath((linearize(loop, _INPUTS, _OUTPUTS, velocity=velocity),))


@dataclass(frozen=True, eq=False)
class ChangedReference:
    """Set positions modified so that the table follows the desired positions.

    reference  input of the loop: positions, their differences as velocities, no higher derivatives
    wanted     desired table positions at the same samples
    lead       preview in s, by which the desired motion is delayed
    """

    reference: Recorded
    wanted: Recorded
    lead: float

    @property
    def shift(self) -> float:
        """The largest deviation of the modified set positions from the desired positions, m."""
        return float(np.max(np.abs(self.reference.position - self.wanted.position)))


def sampled(reference: Reference, sample_time: float, before: int, after: int) -> np.ndarray:
    """Return the set positions in m of a reference at kT, with `before` and `after` samples at rest added."""
    rows = round(float(reference.duration) / sample_time) + 1
    return np.asarray(reference.at(np.arange(-before, rows + after) * sample_time).position, dtype=float)


def changed(positions: np.ndarray, wanted: np.ndarray, sample_time: float, lead: int) -> ChangedReference:
    """Return the modified reference for positions sampled every `sample_time` s.

    Raises ParameterError for positions that are not finite.
    """
    if not np.all(np.isfinite(positions)):
        raise ParameterError("the changed set positions are not finite: the model of the loop is not stable")
    both = (Recorded(position=row, sample_time=sample_time) for row in (positions, wanted))
    return ChangedReference(*both, lead=lead * sample_time)


_SETTLED = 1e-9  # of its peak: below it the answer of a spline has ended
_LONGEST = 40_000  # samples that an answer may take
# dense: with the default spacing a matrix of 20,000 rows and 1,000 columns, 160 MB
_WHOLE = 20_000  # samples that are fitted at once, without a window
# the last splines of a window hardly reach its rows: without it their coefficients grow without bound
_RIDGE = 1e-6  # of the largest column: weight of the coefficients' own size in a window


def cardinal_spline(degree: int, spacing: int, derivative: int = 0) -> np.ndarray:
    """Return a cardinal B-spline, or its derivative per sample, at the samples; it has knots every `spacing` samples.

    It begins at row 0 and has (degree + 1) · spacing + 1 rows; shifted by `spacing`, its copies add up to 1.
    """
    # imported here: commands that only read a log start without it
    from scipy.interpolate import BSpline

    t = np.arange((degree + 1) * spacing + 1) / spacing
    spline = BSpline.basis_element(np.arange(degree + 2.0), extrapolate=False)
    # beyond its support, at its last knot, scipy returns NaN
    return np.nan_to_num(spline.derivative(derivative)(t)) / float(spacing) ** derivative


class _Columns:
    """The responses of the table position to splines, one of which begins every `spacing` samples."""

    def __init__(self, path: SetPath, degree: int, spacing: int) -> None:
        self.spline, self.spacing, self.period = cardinal_spline(degree, spacing), spacing, path.period
        # splines that begin at the same place of the period have the same answer
        phases = {(i * spacing) % path.period for i in range(path.period)}
        self.answers = {phase: self._answer(path, phase) for phase in phases}

    def _answer(self, path: SetPath, phase: int) -> np.ndarray:
        """Return the response of the table to the spline, until it has settled."""
        rows = 2 * self.spline.size
        while True:
            positions = np.zeros((rows, 1))
            positions[: self.spline.size, 0] = self.spline
            answer = path.answers(positions, phase)[:, 0]
            above = np.flatnonzero(np.abs(answer) > _SETTLED * np.max(np.abs(answer)))
            if not np.all(np.isfinite(answer)) or (above[-1] >= rows - 2 and rows > _LONGEST):
                raise ParameterError(
                    f"the answer of the table to one spline has not settled after {rows} samples: the loop is not "
                    f"stable, or hardly damped"
                )
            if above[-1] < rows - 2:
                return answer[: above[-1] + 1]
            rows *= 2

    def matrix(self, first: int, last: int, begin: int, end: int, *, answered: bool = True) -> np.ndarray:
        """Return a matrix whose columns are splines first .. last - 1, or their responses, at samples begin .. end - 1.

        Spline i begins at sample i · spacing.
        """
        columns = np.zeros((end - begin, last - first))
        for i in range(first, last):
            at = i * self.spacing
            column = self.answers[at % self.period] if answered else self.spline
            low, high = max(at, begin), min(at + column.size, end)
            if low < high:
                columns[low - begin : high - begin, i - first] = column[low - at : high - at]
        return columns


def filtered_splines(
    loop: Loop,
    reference: Reference,
    *,
    spacing: int = 20,
    degree: int = 5,
    window: int | None = None,
    kept: int | None = None,
) -> ChangedReference:
    """Return set positions as a sum of splines whose simulated responses fit a reference best; no inverse is needed.

        x_r' = Φ p,   p = argmin |x_r - Ψ p|²,   Ψ_i = response of the table to the spline Φ_i (degree, knots)

    spacing  samples between knots; spacing · T <= 1/(6 f) of a mode with frequency f
    window   number of coefficients to solve for at once, at least 10, for a path with a limited preview;
             window · spacing · T should be at least 1/f.  None: all at once
    kept     number of coefficients that become final before the window slides on; default: a quarter of `window`
    Windows are solved by QR, with a ridge of 1e-6: normal equations would lose all precision.

    Raises ParameterError for a spacing below the degree, and for a path of more than 20000 samples without a window.
    When to use: on paths known in advance, for modes that no encoder measures and for zeros outside the unit circle.
    It does not reject disturbances, and the effect of model errors is not reduced.
    Source: Okwudire, Ramani & Duan 2016; Duan, Yoon & Okwudire 2018 (limited preview).
    """
    if not 3 <= degree <= 5 or spacing < degree:
        raise ParameterError(
            f"degree = {degree} must be 3 to 5, and spacing = {spacing} samples at least the degree: below, the "
            f"coefficients cannot be told apart"
        )
    T = float(loop.sample_time)
    columns = _Columns(set_path(loop), degree, spacing)
    around = (degree + 1) * spacing  # rows of rest on both sides, for splines that begin before the motion
    wanted = sampled(reference, T, around, around)
    rows, shifted = wanted.size, wanted - wanted[0]
    first, last = -degree, rows // spacing + 1
    if window is None:
        if rows > _WHOLE:
            raise ParameterError(
                f"{rows} samples without a window (at most {_WHOLE}): give window, as 20 coefficients of {spacing} "
                f"samples"
            )
        p = _least(columns.matrix(first, last, 0, rows), shifted, 0.0)
    else:
        p = _slid(columns, shifted, first, last, window, max(1, window // 4) if kept is None else kept)
    at = np.zeros(rows)
    for i, coefficient in enumerate(p, start=first):
        low, high = max(i * spacing, 0), min(i * spacing + columns.spline.size, rows)
        at[low:high] += coefficient * columns.spline[low - i * spacing : high - i * spacing]
    return changed(wanted[0] + at, wanted, T, around)


def _slid(columns: _Columns, wanted: np.ndarray, first: int, last: int, window: int, kept: int) -> np.ndarray:
    """Return the coefficients, solved window by window after subtracting the contribution of all previous windows."""
    if window < 10 or not 1 <= kept <= window:
        raise ParameterError(
            f"window = {window} coefficients, {kept} of them kept: at least 10, of which 1 to all are kept; with "
            f"shorter windows the recursion diverges"
        )
    p = np.zeros(last - first)
    left = wanted.copy()
    done = first
    while done < last:
        stop = min(done + window, last)
        begin, end = max(done * columns.spacing, 0), min(stop * columns.spacing, wanted.size)
        if end > begin:
            some = _least(columns.matrix(done, stop, begin, end), left[begin:end], _RIDGE)
        else:
            some = np.zeros(stop - done)
        fixed = stop if stop == last else done + kept
        p[done - first : fixed - first] = some[: fixed - done]
        left -= columns.matrix(done, fixed, 0, wanted.size) @ some[: fixed - done]
        done = fixed
    return p


def _least(Psi: np.ndarray, right: np.ndarray, ridge: float) -> np.ndarray:
    """Return p = argmin |right - Ψ p|² + (ridge · |Ψ|)² |p|² by QR of the stacked matrix; 0 for columns of zeros."""
    from scipy.linalg import lstsq

    size = np.sqrt(np.sum(Psi**2, axis=0))
    there = size > _SETTLED * np.max(size)
    coefficients = np.zeros(Psi.shape[1])
    rows = [Psi[:, there] / size[there]]
    if ridge > 0.0:
        rows.append(ridge * np.eye(int(there.sum())))
    full = np.concatenate([right, np.zeros(rows[-1].shape[0] if ridge > 0.0 else 0)])
    solved: Any = lstsq(np.vstack(rows), full, lapack_driver="gelsy")
    coefficients[there] = solved[0] / size[there]
    return coefficients


_ORIGIN = 1e-6  # of |z|: poles below are delays
_LEFT = 0.6  # |z| from which a zero left of the imaginary axis would ring: it is not inverted
_REST = 1e-6  # of the largest coefficient: what is below it in the numerator is rounding
_SETTLING = 0.05  # s of rest after the end


@dataclass(frozen=True, eq=False)
class InversePath:
    """The closed loop from set position to table, T_r = q^r B⁺ B⁻ / A in q = z⁻¹, in ascending powers of q.

    B⁻, whose first coefficient is 1, contains the zeros that are not inverted: |z| >= 1, or Re z < 0 with |z| > 0.6.
    """

    A: np.ndarray
    inverted: np.ndarray
    kept: np.ndarray
    delay: int

    @property
    def preview(self) -> int:
        """The preview r + s in samples, with s = deg B⁻: the set path must be known this far in advance."""
        return self.delay + self.kept.size - 1

    def gain(self, frequency: np.ndarray, sample_time: float) -> np.ndarray:
        """Return |B⁻(e^jω)|² / B⁻(1)², the frequency response of T_r combined with the filter; its phase is 0."""
        z = np.exp(-2j * np.pi * frequency * sample_time)
        return np.abs(np.polyval(self.kept[::-1], z)) ** 2 / np.sum(self.kept) ** 2

    def filtered(self, wanted: np.ndarray) -> np.ndarray:
        """Return x_r'(k) = A(q) B⁻(q⁻¹) / (B⁺(q) B⁻(1)²) x_r(k + r), for a path x_r at rest at both ends."""
        # imported here: commands that only read a log start without it
        from scipy.signal import lfilter

        s = self.kept.size - 1
        ahead = np.concatenate([wanted - wanted[0], np.full(self.preview, wanted[-1] - wanted[0])])
        smooth = np.convolve(ahead, self.kept[::-1])[s + self.delay :][: wanted.size]
        return wanted[0] + lfilter(self.A, self.inverted * np.sum(self.kept) ** 2, smooth)


def inverse_path(loop: Loop | SetPath) -> InversePath:
    """Return the closed loop as polynomials: A from its poles, B from its Markov parameters.

    If B were computed from its zeros, the eigenvalue solver would lose the leading zero coefficients, which represent
    the delay.
    Raises UnstableError for a loop that is not stable, and ParameterError for a multirate loop.
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
    # a triple pole at 0 (a queue of dead time) is found only to the cube root of rounding
    A = np.real(np.poly(poles[np.abs(poles) > _ORIGIN ** (1.0 / 3.0)]))
    rows = 2 * poles.size + 4
    impulse = np.zeros((rows, 1))
    impulse[0] = 1.0
    # B = A times the impulse response; its zeros by eigenvalues would lose the leading zeros that are the delay
    whole = np.convolve(A, path.answers(impulse)[:, 0])[:rows]
    there = np.flatnonzero(np.abs(whole) > _REST * np.max(np.abs(whole)))
    delay, B = int(there[0]), whole[there[0] : there[-1] + 1]
    zeros = np.roots(B)
    away = (np.abs(zeros) >= 1.0) | ((zeros.real < 0.0) & (np.abs(zeros) > _LEFT))
    # the polynomial of no zeros is a plain 1.0 in numpy
    inverted, kept = (np.atleast_1d(np.real(np.poly(zeros[row]))) for row in (~away, away))
    return InversePath(A, B[0] * inverted, kept, delay)


def zero_phase(loop: Loop, reference: Reference) -> ChangedReference:
    """Return set positions for which the linear model of the loop follows a reference without phase error.

        T_r = q^r B⁺ B⁻ / A,    x_r'(k) = A(q) B⁻(q⁻¹) / (B⁺(q) B⁻(1)²) x_r(k + r)

    The motion is delayed by the preview of r + s samples (`lead`).
    When to use: on smooth moves with a loop that is known and linear.  It does not compensate for friction and is not
    suitable if the gains are changed afterwards; an unknown load of 20 % removes most of its advantage.
    Raises ParameterError if the polynomials lose their precision, as from about degree 10 on (filters, two encoders).
    Source: Tomizuka 1987; the choice of zeros that are not inverted, and B from Markov parameters, are this library's.
    """
    model, T = set_path(loop), float(loop.sample_time)
    path = inverse_path(model)
    wanted = sampled(reference, T, path.preview, round(_SETTLING / T))
    filtered = path.filtered(wanted)
    before, after = (_left(model, positions, wanted) for positions in (wanted, filtered))
    # lost digits show in no residual of the polynomials: the model itself is simulated
    if not after < before:
        raise ParameterError(
            f"the model of the loop itself is {Quantity(after, 'm')} off the path with this inverse, and "
            f"{Quantity(before, 'm')} without: polynomials of degree {path.A.size - 1} have lost their digits; take "
            "filtered splines"
        )
    return changed(filtered, wanted, T, path.preview)


def _left(model: SetPath, positions: np.ndarray, wanted: np.ndarray) -> float:
    """Return the largest deviation of the model's table position from the desired path, m."""
    return float(np.max(np.abs(model.answers((positions - wanted[0])[:, None])[:, 0] - (wanted - wanted[0]))))
