"""Operating points: the frequency responses of an axis at one position and load, measured or from a model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from feeddrive.identification.excitation.nonperiodic import UNKNOWNS, local_rational
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import AVERAGES, FRF, transfers
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop, response_unit
from feeddrive.tuning.control_response import READINGS, Axis, ControlResponse, Response

_HALF_WIDTHS = (4, 7, 12, 20, 34)  # neighboring lines used for each line
# of ln f: largest width of a window, since the fitted function is local even if the residuals allow more
_REACH = 0.3
_SURE = 0.99  # a window whose residuals are larger than noise with this probability is too wide
# stricter for the ratio, which is tested on up to 40 ranges of lines
_SURE_OF_RATIO = 0.999
_FIT = 1.2  # relative difference of both motions up to which their ratio is fitted: up to the antiresonance
_STIFF = 0.25  # relative difference of both motions up to which their ratio is used
_VARIANCE = 4  # lines on both sides over which the measured variance is averaged


def smoothed(
    frequency: np.ndarray, response: np.ndarray, variance: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth a response; return it and its remaining variance on the lines with the indices `wanted`.

    Around each line a function with one resonance is fitted, by least squares weighted with the variance:

        f² G = (a0 + a1 u + a2 u²)/(1 + b u),   u = ln f - ln f0,   complex a, b

    The window is widened as long as the residuals pass a χ² test for noise at 99 %; the last but one accepted width is
    used. The approximation error then stays well below the remaining noise. A line with fewer than two accepted widths
    keeps its measured value. The variance is first averaged over nine lines, because it is itself an estimate.

    Source: McKelvey & Guérin 2012 (local rational models); Goldenshluger & Nemirovski 1997 (windows as wide as the data
    allow); the rule for the width is our own.
    """
    from scipy.special import chdtri

    n = frequency.size
    flat = frequency**2
    out, left = response.copy(), _averaged(variance * flat**2) / flat**2
    if not np.any(variance > 0.0):
        return out[wanted], left[wanted]
    x, y = np.log(frequency), response * flat
    # a line whose variance is stated as 0 would have infinite weight
    spread = np.maximum(left * flat**2, 1e-12 * np.abs(y) ** 2)
    before = (out.copy(), left.copy())
    fits = np.zeros(n, dtype=bool)
    fits[wanted] = True
    for half in _HALF_WIDTHS:
        width = 2 * half + 1
        if width > n or not np.any(fits):
            break
        begin = np.clip(np.arange(n) - half, 0, n - width)
        reach = np.maximum(x - x[begin], x[begin + width - 1] - x)
        fits &= reach <= _REACH
        place = np.flatnonzero(fits)
        if not place.size:
            break
        value, kept, excess = local_rational(x, y, spread, width, place)
        # real and imaginary part of each line are two residuals
        good = excess <= chdtri(2 * (width - UNKNOWNS), 1.0 - _SURE)
        fits[place[~good]] = False
        place, value, kept = place[good], value[good], kept[good]
        # the previous width: it is used only once the next one is accepted too
        out[place], left[place] = before[0][place], before[1][place]
        before[0][place], before[1][place] = value / flat[place], kept / flat[place] ** 2
    return out[wanted], left[wanted]


def _averaged(variance: np.ndarray) -> np.ndarray:
    """Return the moving average of the variance over a few neighbors."""
    summed = np.cumsum(np.concatenate([[0.0], variance]))
    place = np.arange(variance.size)
    low, high = np.maximum(place - _VARIANCE, 0), np.minimum(place + _VARIANCE + 1, variance.size)
    return (summed[high] - summed[low]) / (high - low)


def stiff_ratio(
    frequency: np.ndarray, motor: np.ndarray, load: np.ndarray, variances: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the ratio r of motor to load reading and its variance; NaN on lines where both ends do not move together.

        r = 1 + a1 s + a2 s² + a3 s³ + a4 s⁴,   s = jω,   real coefficients

    At low frequencies both ends of any guided axis move together. The stiffness follows from their small difference,
    which measurement noise would hide at low frequencies, where the responses are large and the spring hardly deflects.
    The polynomial is fitted to the raw lines from the lowest one up to a line below the antiresonance: the highest at
    which the residuals still pass a χ² test for noise at 99.9 %. The fit is used where |r - 1| is at most 1/4, which is
    up to half of the first antiresonance, and on at most half of the fitted lines, because it deviates first at its
    end.
    """
    from scipy.special import chdtri

    ratio, variance = np.full(frequency.size, np.nan, dtype=complex), np.zeros(frequency.size)
    if variances is None:
        return ratio, variance
    raw = motor / load
    spread = np.abs(raw) ** 2 * (variances[0] / np.abs(motor) ** 2 + variances[1] / np.abs(load) ** 2)
    if not np.all(spread > 0.0):
        return ratio, variance
    best = 0
    far = np.flatnonzero(np.abs(raw - 1.0) > _FIT)
    most = int(far[0]) if far.size else frequency.size
    for count in np.unique(np.geomspace(12, max(most, 13), 40).astype(int)):
        if count > most:
            break
        fitted, left = _real_polynomial(frequency[:count], raw[:count], spread[:count])
        excess = 2.0 * float(np.sum(np.abs(raw[:count] - fitted) ** 2 / spread[:count]))
        # two residuals a line, less the four coefficients
        if excess <= chdtri(2 * count - 4, 1.0 - _SURE_OF_RATIO):
            best, ratio[:count], variance[:count] = count, fitted, left
        elif count > 2 * max(best, 12):
            break
    apart = np.flatnonzero(np.abs(ratio[:best] - 1.0) > _STIFF)
    end = min(best // 2, int(apart[0]) if apart.size else best)
    ratio[end:], variance[end:] = np.nan, 0.0
    return ratio, variance


def _real_polynomial(f: np.ndarray, r: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit 1 + a1 s + ... + a4 s⁴ to complex values by weighted least squares; return the fit and its variance."""
    # scaled to 1 at the last line: powers of ω in rad/s would make the problem ill-conditioned
    s = 1j * f / f[-1]
    powers = np.stack([s**k for k in (1, 2, 3, 4)], axis=1)
    columns = powers / np.sqrt(0.5 * spread)[:, None]
    right = (r - 1.0) / np.sqrt(0.5 * spread)
    both = np.vstack([columns.real, columns.imag])
    inverse = np.linalg.pinv(both)
    coefficients = inverse @ np.concatenate([right.real, right.imag])
    spanned = powers @ inverse
    return 1.0 + powers @ coefficients, np.sum(np.abs(spanned) ** 2, axis=1)


_LOWEST = 3e-5  # of Nyquist: lowest line of a model
_PER_DECADE = 250
_BESIDE = np.linspace(-4.0, 4.0, 65)  # half widths of a resonance at which lines are added
_EVERY = 3  # of the lines of a model, for many plants
_STEP, _BEND = 0.035, 0.12  # of ln f, and of the response: largest difference of two lines of a search
_FINEST = 0.003  # of ln f: lines of a measurement with variance keep this distance after smoothing
_CLOSEST = 3e-4  # the same for lines without variance; it thins only measurements with very many lines
_LEAST, _MOST = 1e-30, 1e6  # m/N, plausible range of the response of an axis
_WIDTH = 5  # lines over which a noisy curve is averaged before its curvature is used


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """The frequency responses (m/N) of an axis at one position and load.

    frequency    frequency lines, Hz
    by_force     responses of motor and load reading to the command, shape (2, lines)
    by_load      responses of motor and load reading to a force on the table, shape (2, lines)
    moved        responses of the table itself to the command and to a force on it, shape (2, lines)
    variance     variance of by_force after smoothing, shape (2, lines); None for a model
    load_variance  variance of by_load in the same form
    coherence    measured coherence of by_force, shape (lines,), the smaller of the two readings; None if unknown
    at_drive     True if no response to a force on the table is known; the stiffness then refers to a force at the drive
    ratio        ratio of motor to load reading in by_force and by_load, shape (2, lines), on lines where the errors of
                 both readings are correlated (1 with one encoder), and NaN where they are independent. Where there is a
                 ratio, the motor's row of a variance is the uncertainty of this ratio
    loop, model  the loop of a model, and the state-space model of its axis
    known_as     a loop whose axis agrees with the measurement (`with_table_force`), for simulating the tuned controller
    by_force_at  function that returns by_force at any frequency, for the images of a multirate controller
    commanded    what the drive takes: by_force is in m/N, or in m/(m/s) of one that is commanded by velocities
    bounds_only  True for a plant of a box, at which the limits apply but not the goal
    """

    name: str
    frequency: np.ndarray
    by_force: np.ndarray
    by_load: np.ndarray
    moved: np.ndarray
    sample_time: float
    variance: np.ndarray | None = None
    load_variance: np.ndarray | None = None
    at_drive: bool = False
    ratio: np.ndarray | None = None
    loop: Loop | None = None
    model: StateSpace | None = None
    known_as: Loop | None = None
    by_force_at: Axis | None = None
    coherence: np.ndarray | None = None
    bounds_only: bool = False
    commanded: str = "force"

    def holds(self) -> bool:
        """Return True if the axis alone returns after a constant force: its drive closes a velocity loop with an
        integral.
        """
        loop = self.loop or self.known_as
        held = None if loop is None else loop.axis.actuator.velocity_loop
        return held is not None and held.Tn is not None

    def chosen(self, keep: np.ndarray) -> Self:
        """Return the operating point restricted to the lines with the given indices."""
        return replace(
            self,
            frequency=self.frequency[keep],
            by_force=self.by_force[:, keep],
            by_load=self.by_load[:, keep],
            moved=self.moved[:, keep],
            variance=None if self.variance is None else self.variance[:, keep],
            load_variance=None if self.load_variance is None else self.load_variance[:, keep],
            ratio=None if self.ratio is None else self.ratio[:, keep],
            coherence=None if self.coherence is None else self.coherence[keep],
        )

    def sparse(self, fewer: float = 1.0) -> np.ndarray:
        """Return the indices of the lines for a search: dense where the response changes rapidly, else sparse.

        fewer  factor by which there are fewer of them
        """
        x = np.log(self.frequency)
        shape = np.log(np.abs(self.by_force[1]) * self.frequency**2) + 1j * np.unwrap(np.angle(self.by_force[1]))
        # the remaining noise must not count as curvature
        if self.variance is not None and x.size > _WIDTH:
            padded = np.pad(shape, _WIDTH // 2, mode="edge")
            shape = np.convolve(padded, np.full(_WIDTH, 1.0 / _WIDTH), mode="valid")
        steps = np.abs(np.diff(x)) / _STEP + np.abs(np.diff(shape)) / _BEND
        walked = np.concatenate([[0.0], np.cumsum(steps)])
        keep = np.searchsorted(walked, np.arange(0.0, walked[-1] + 1.0, fewer)).clip(0, x.size - 1)
        return np.union1d(keep, [0, x.size - 1])


def response_on(point: OperatingPoint, control: Control, velocity: float = 0.05) -> Response:
    """Return the response of a controller at all frequency lines of an operating point."""
    response = ControlResponse(control, point.sample_time, (), velocity)
    return response.at((), point.frequency, response.images(point.by_force_at, point.frequency))


def position_loop(point: OperatingPoint, whole: Response, inner: Response) -> FRF:
    """Return the loop gain of a cascade opened at its velocity command, with the velocity loop closed.

    whole, inner  the responses of the controller with and without position loop, on the lines of the point

    L and Lv are the loop gains at the actuator with and without the position loop. For a single-rate controller the
    result is (L - Lv)/(1 + Lv). A position loop that runs every N-th sample is a single-rate loop with sample time NT;
    its gain is exactly det(1 + L)/det(1 + Lv) - 1 with the determinants of the lifted loops, up to 1/(2NT).
    """
    f, step = point.frequency, point.sample_time
    L, Lv = (-np.einsum("kl,kl->l", response.value, point.by_force) for response in (whole, inner))
    gain = (L - Lv) / (1.0 + Lv)
    if whole.rest is not None and inner.rest is not None:
        step = step * whole.period
        gain = (1.0 + L) * whole.rest / ((1.0 + Lv) * inner.rest) - 1.0
    below = f <= 0.5 / step
    return FRF(f[below], gain[below], "velocity command", "velocity command", "", step)


def modelled_point(
    loop: Loop,
    name: str = "model",
    *,
    velocity: float = 0.05,
    coarse: bool = False,
    model: StateSpace | None = None,
) -> OperatingPoint:
    """Return the operating point of the axis of a loop, linearized while it slides at `velocity` (m/s).

    The responses include dead time, current loop and encoders.

    coarse  True for a third of the lines, as to find the worst of many plants
    model   the linear model of the axis, if it is known already
    """
    model = model or linearize(
        loop, ["cut", "load_force"], ["reading_motor", "reading_load", "position_load"], velocity=velocity
    )
    T = float(loop.sample_time)
    nyquist = 0.5 / T
    every = _EVERY if coarse else 1
    count = round(-np.log10(_LOWEST) * _PER_DECADE) // every
    spread = np.geomspace(_LOWEST * nyquist, nyquist * (1.0 - 1e-6), count)
    s = model.oscillations()
    near = (np.imag(s)[:, None] + np.abs(np.real(s))[:, None] * _BESIDE[::every]).ravel() / (2.0 * np.pi)
    lines = np.unique(np.concatenate([spread, near[(near > spread[0]) & (near < spread[-1])]]))
    lines = lines[np.append(True, np.diff(lines) > 2e-4 * lines[1:])]
    values = transfers(model.A, model.B, model.C, model.D, np.exp(2j * np.pi * lines * T))
    responses = {
        (output, source): values[row, column]
        for row, output in enumerate(model.outputs)
        for column, source in enumerate(model.inputs)
    }

    def by_force_at(frequency: np.ndarray) -> np.ndarray:
        # the images of different lines coincide: each frequency is computed once
        there, places = np.unique(np.clip(frequency, 1e-6 * lines[0], nyquist), return_inverse=True)
        return np.array([model.response(there, reading, "cut").response[places] for reading in READINGS])

    return OperatingPoint(
        name,
        lines,
        np.array([responses[reading, "cut"] for reading in READINGS]),
        np.array([responses[reading, "load_force"] for reading in READINGS]),
        np.array([responses["position_load", source] for source in ("cut", "load_force")]),
        T,
        ratio=np.ones((2, lines.size)) if loop.axis.one_encoder() else None,
        loop=loop,
        model=model,
        by_force_at=by_force_at,
        commanded=loop.axis.actuator.commanded,
    )


def measured_point(
    load: FRF,
    motor: FRF | None = None,
    *,
    disturbance: tuple[FRF, FRF | None] | None = None,
    sample_time: float,
    delay: float = 0.0,
    name: str = "measured",
    averages: int = AVERAGES,
    commanded: str = "force",
) -> OperatingPoint:
    """Return the operating point given by measured responses on the same lines, in m/N or, for a law that commands a
    velocity, in m/(m/s).

    load, motor   responses of the readings to the commanded force; with a single encoder leave `motor` out
    disturbance   responses of the load and motor readings to a force on the table (impact hammer); without them,
                  stiffness and rope-snap error refer to a force at the drive
    sample_time   sample time of the controller to be tuned, s
    delay         computation delay, s, if the input of the measured responses is the actual force, not its command
    commanded     what the drive takes: "force" or "velocity"
    averages      number of averages, for a coherence without variance: var = |G|² (1 - γ²)/(γ² averages)

    Responses with a variance are smoothed as far as the variance allows; where motor and table move nearly together,
    their ratio is fitted (`stiff_ratio`).
    Raises ParameterError for differing lines, for fewer than ten lines, and for another unit.
    """
    both = (load if motor is None else motor, load)
    hit: Sequence[FRF] = () if disturbance is None else (disturbance[1] or disturbance[0], disturbance[0])
    for frf in (*both, *hit):
        if frf.frequency.shape != load.frequency.shape or np.any(frf.frequency != load.frequency):
            raise ParameterError(
                "the measured responses have different frequencies: measure or interpolate them on the same lines"
            )
        wanted_unit = "m/N" if any(frf is other for other in hit) else response_unit(commanded)
        if frf.unit not in ("", wanted_unit):
            raise ParameterError(
                f"the response from {frf.input} to {frf.output} is in {frf.unit}: it must be {wanted_unit}"
            )
        bad = np.flatnonzero(~((np.abs(frf.response) > _LEAST) & (np.abs(frf.response) < _MOST)))
        if bad.size:
            raise ParameterError(
                f"the response from {frf.input} to {frf.output} is "
                f"{Quantity(np.abs(frf.response[bad[0]]), wanted_unit):3 SI} at "
                f"{Quantity(frf.frequency[bad[0]], 'Hz')} ({bad.size} such lines), which is impossible for an "
                "axis: check columns and unit, and leave out lines on which nothing was measured"
            )
    inside = load.frequency < 0.5 / sample_time
    if np.count_nonzero(inside) < 10:
        raise ParameterError(
            f"{np.count_nonzero(inside)} lines below half the sample rate are too few to shape a loop on: at least 10"
        )
    measured_lines = load.frequency[inside]
    sources = [[_on(frf, inside, averages) for frf in row] for row in (both, hit) if row]
    # lines next to each other carry no new information after smoothing, and are left out
    marked = all(lines_.variance is not None for row in sources for lines_ in row)
    wanted = _thinned(measured_lines, _FINEST if marked else _CLOSEST)
    lines = measured_lines[wanted]
    # computation delays the command, but not a hammer on the table
    late = np.exp(-2j * np.pi * lines * delay)
    ratio = np.full((2, lines.size), np.nan, dtype=complex)
    cleaned: list[list[_Lines]] = []
    for k, raw in enumerate(sources):
        clean = [_cleaned(measured_lines, lines_, wanted) for lines_ in raw]
        motor_variance = clean[0].variance
        if motor is not None and motor_variance is not None:
            fitted, open_ = stiff_ratio(measured_lines, raw[0].response, raw[1].response, _variances(raw))
            ratio[k] = fitted[wanted]
            stiff = ~np.isnan(ratio[k])
            load_ = clean[1].response
            of_ratio = np.abs(load_) ** 2 * open_[wanted]
            clean[0] = _Lines(
                np.where(stiff, ratio[k] * load_, clean[0].response), np.where(stiff, of_ratio, motor_variance)
            )
        cleaned.append(clean)
    if motor is None:
        ratio[:] = 1.0
        # with a ratio of 1 the motor's row is the uncertainty of the ratio, and that is none
        cleaned = [[_without(row[0]), row[1]] for row in cleaned]
    by_force = np.array([lines_.response * late for lines_ in cleaned[0]])
    by_load = by_force if len(cleaned) == 1 else np.array([lines_.response for lines_ in cleaned[1]])
    return OperatingPoint(
        name,
        lines,
        by_force,
        by_load,
        np.array([by_force[1], by_load[1]]),
        float(sample_time),
        variance=_variances(cleaned[0]),
        load_variance=_variances(cleaned[1]) if len(cleaned) > 1 else None,
        at_drive=len(cleaned) == 1,
        ratio=ratio,
        by_force_at=_between(lines, by_force),
        coherence=_coherence(both, inside, wanted),
        commanded=commanded,
    )


def _coherence(both: Sequence[FRF], inside: np.ndarray, wanted: np.ndarray) -> np.ndarray | None:
    """Return the minimum of the measured coherences on each line; None if none was measured."""
    coherences = [frf.coherence[inside][wanted] for frf in both if frf.coherence is not None]
    return np.minimum.reduce(coherences) if coherences else None


def _between(lines: np.ndarray, by_force: np.ndarray) -> Axis:
    """Return an interpolator of measured responses over frequency.

    ln |X| and the phase are linear in ln f between the lines; beyond them the axis is a free mass (1/f²).
    """
    x = np.log(lines)
    level, phase = np.log(np.abs(by_force)), np.unwrap(np.angle(by_force), axis=1)

    def at(frequency: np.ndarray) -> np.ndarray:
        there = np.log(np.maximum(frequency, 1e-6 * lines[0]))
        beyond = 2.0 * (np.clip(there, x[0], x[-1]) - there)
        rows = zip(level, phase, strict=True)
        return np.array([np.exp(np.interp(there, x, a) + beyond + 1j * np.interp(there, x, b)) for a, b in rows])

    return at


def _thinned(frequency: np.ndarray, apart: float) -> np.ndarray:
    """Return the indices of lines that are about `apart` from each other in ln f."""
    x = np.log(frequency)
    keep = np.unique(np.searchsorted(x, np.arange(x[0], x[-1], apart)).clip(0, x.size - 1))
    return np.union1d(keep, [x.size - 1])


class _Lines(NamedTuple):
    """A response and the variance of each line, if known."""

    response: np.ndarray
    variance: np.ndarray | None


def _cleaned(frequency: np.ndarray, raw: _Lines, wanted: np.ndarray) -> _Lines:
    """Return the smoothed lines; without a variance, the selected lines unchanged."""
    if raw.variance is None:
        return _Lines(raw.response[wanted], None)
    return _Lines(*smoothed(frequency, raw.response, raw.variance, wanted))


def _variances(readings: Sequence[_Lines]) -> np.ndarray | None:
    """Return the variances of both readings; None if either is unknown."""
    variances = [lines.variance for lines in readings if lines.variance is not None]
    return np.array(variances) if len(variances) == len(readings) else None


def _without(lines: _Lines) -> _Lines:
    """Return the lines with the variance set to zero; lines without a variance are returned unchanged."""
    return lines if lines.variance is None else lines._replace(variance=np.zeros(lines.variance.size))


def _on(frf: FRF, inside: np.ndarray, averages: int) -> _Lines:
    """Return a response on the selected lines; an unknown variance is computed from the coherence, if known."""
    variance = frf.known_variance(averages)
    return _Lines(frf.response[inside], None if variance is None else variance[inside])


_WORST = 0.2  # of the response: a plant with a larger deviation does not belong to the measurement
_COUNTS = 0.1  # |L| above which lines are compared
_FEWEST = 10


def disagreement(point: OperatingPoint, loop: Loop, velocity: float = 0.05) -> float:
    """Return the median of |measured/model - 1|, less the contribution of noise, for the worse of the two readings.

    The median is over the lines on which the loop gain with the controller of `loop` is at least 0.1, or over all lines
    if these are fewer than ten.
    """
    model = linearize(loop, ["cut"], READINGS, velocity=velocity)
    C = response_on(point, loop.control, velocity).value
    gain = np.abs(np.einsum("kl,kl->l", C, point.by_force))
    lines = np.flatnonzero(gain >= _COUNTS)
    if lines.size < _FEWEST:
        lines = np.arange(point.frequency.size)
    off: list[float] = []
    for k, reading in enumerate(READINGS):
        if k == 0 and one_encoder(point):
            continue
        true = model.response(point.frequency[lines], reading, "cut").response
        apart = np.abs(point.by_force[k, lines] / true - 1.0) ** 2
        # squares of independent deviations add, so that of the noise is subtracted
        noise = 0.0 if point.variance is None else np.median(point.variance[1, lines] / np.abs(true) ** 2)
        off.append(float(np.sqrt(max(np.median(apart) - noise, 0.0))))
    return max(off)


def with_table_force(
    point: OperatingPoint, loop: Loop, source: str, velocity: float = 0.05, *, run: bool = True
) -> tuple[OperatingPoint, str]:
    """Add responses to a force on the table, computed from the plant of `loop`, to a measured operating point.

    Returns the extended point, and a sentence on the accuracy of these responses. The plant must agree with the
    measured responses to within 20 % (`disagreement`); otherwise the point is returned unchanged. If the measurement
    has variances, the disagreement is used as the relative standard deviation of the added responses. A point with
    a measured response to a force on the table keeps it.

    source  name of the plant in the sentence
    run     True if the tuned controller is also to be simulated in `loop`, with its friction, encoder counts and limits
            (`OperatingPoint.known_as`)
    """
    off = disagreement(point, loop, velocity)
    if off > _WORST:
        nothing = "a force on the table, nor for a run of the new control" if run else "a force on the table"
        apart = Text(f"{source} is {Quantity(off, 'share'):3} away from the response '{point.name}'")
        return point, Text(f"{apart}, so it cannot be used for {nothing}")
    if run:
        point = replace(point, known_as=replace(loop, sample_time=point.sample_time))
    if not point.at_drive:
        return point, ""
    model = linearize(loop, ["cut", "load_force"], READINGS, velocity=velocity)
    responses = {
        source: np.array([model.response(point.frequency, reading, source).response for reading in READINGS])
        for source in model.inputs
    }
    by_load = responses["load_force"]
    # y = S y_d (1 - C_m y_u (r_u - r_d)), r = motor/load: the stiffness depends on the difference of the ratios, so the
    # plant gives this difference; a second ratio would have an error as large as the difference itself
    apart = responses["cut"][0] / responses["cut"][1] - by_load[0] / by_load[1]
    if one_encoder(point):
        apart = 0.0 * apart
    by_load = np.array([by_load[1] * (point.by_force[0] / point.by_force[1] - apart), by_load[1]])
    variance = None
    if point.variance is not None:
        spread = (off * np.abs(by_load)) ** 2
        variance = np.array([np.zeros(spread.shape[1]), spread[1]])
    ratio = None if point.ratio is None else np.array([point.ratio[0], by_load[0] / by_load[1]])
    moved = np.array([point.moved[0], by_load[1]])
    shown = Text(
        f"the force on the table is by {source}, which agrees with the response '{point.name}' within "
        f"{Quantity(max(off, 1e-3), 'share'):2}; a hammer on the table (--disturbance) would verify it"
    )
    return (
        replace(point, by_load=by_load, moved=moved, load_variance=variance, at_drive=False, ratio=ratio),
        shown,
    )


def one_encoder(point: OperatingPoint) -> bool:
    """Return True if both readings come from a single encoder."""
    return point.ratio is not None and bool(np.all(point.ratio[0] == 1.0))
