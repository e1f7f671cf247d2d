"""A trial: setpoint, tracking error and force of one repetition, simulated or measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.signals import Setpoint
from feeddrive.identification.regression import robust_covariance
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run

LARGEST_ROUNDING = 0.05  # of a derivative's RMS in motion: largest share of rounding in its differences

# weights over samples k-2 .. k+2, and the power of T below them; each is of second order
_WEIGHTS = {
    "velocity": ((0.0, -0.5, 0.0, 0.5, 0.0), 1),
    "acceleration": ((0.0, 1.0, -2.0, 1.0, 0.0), 2),
    "jerk": ((-0.5, 1.0, 0.0, -1.0, 0.5), 3),
    "snap": ((1.0, -4.0, 6.0, -4.0, 1.0), 4),
}


def differenced(name: str, position: np.ndarray, sample_time: float, needed: Sequence[str]) -> Setpoint:
    """Return the setpoint from sampled positions in m; derivatives that are not needed are 0.

    All derivatives are unfiltered central differences about the same sample, so they are consistent; they are 0 at the
    two samples at each end.
    Raises LogError for fewer than six rows, and if rounding errors would be a large part of a derivative.
    """
    if position.size < 6:
        raise LogError(f"{name}: {position.size} rows are too few for a fourth difference: at least 6 are needed")
    rounding = _rounding(position)
    # at rest the weights would leave rounding, which counts as motion elsewhere
    rests = np.ptp(np.lib.stride_tricks.sliding_window_view(position, 5), axis=1) == 0.0
    derivatives: dict[str, np.ndarray] = {}
    for derivative, (weights, order) in _WEIGHTS.items():
        values = np.zeros(position.size)
        if derivative in needed:
            taken = np.convolve(position, weights[::-1], mode="valid") / sample_time**order
            values[2:-2] = np.where(rests, 0.0, taken)
            _check_rounding(name, derivative, values, rounding, float(np.linalg.norm(weights)) / sample_time**order)
        derivatives[derivative] = values
    return Setpoint(position, **derivatives)  # type: ignore[arg-type]


def _rounding(position: np.ndarray) -> float:
    """Return the RMS of the rounding error of positions, m, from fifth differences while the axis accelerates.

    In a motion with segments of constant snap, the fifth differences of exact positions are 0 except at a few samples,
    which the median ignores.  At constant velocity, the rounding error is periodic and not detected.
    """
    second, fifth = np.abs(np.diff(position, 2)), np.abs(np.diff(position, 5))
    accelerates = second[1:-2] > 1e-2 * np.max(second, initial=0.0)
    # 0.6745: median of |normal|; 252 = 1 + 25 + 100 + 100 + 25 + 1, the squares of the weights of a fifth difference
    return float(np.median(fifth[accelerates])) / (0.6745 * np.sqrt(252.0)) if np.any(accelerates) else 0.0


def _check_rounding(name: str, derivative: str, values: np.ndarray, rounding: float, gain: float) -> None:
    moving = values[np.abs(values) > 1e-9 * np.max(np.abs(values), initial=0.0)]
    if not moving.size:
        return
    rms = float(np.sqrt(np.mean(moving**2)))
    share = gain * rounding / rms
    if share > LARGEST_ROUNDING:
        raise LogError(
            f"{name}: its set positions are rounded by about {Quantity(rounding, 'm'):2 SI} RMS, which is "
            f"{Quantity(share, 'share'):3} of their {derivative} by differences; at most "
            f"{Quantity(LARGEST_ROUNDING, 'share'):6} is admitted, "
            f"{Quantity(rounding * LARGEST_ROUNDING / share, 'm'):2 SI}: give the job that was run, for exact "
            "derivatives, or leave out the regressor"
        )


# crystals agree to 1e-4, and a log at another rate is off by far more
CLOCK = 1e-3  # share of the sample time by which the clock of a log may differ from the controller's
_NOISE = 0.02  # share of the acceleration's RMS that the rounding of a logged reference may make
_WIDEST = 64  # samples on each side over which a rounded reference is smoothed at most
_ENDS = 3  # rows that a third difference needs on each side
_FIRST = 200  # rows at rest whose mean is the force at the first sample: a drive's noise of 5 % falls below 1 %


@dataclass(frozen=True, eq=False, repr=False)
class Trial(Result):
    """The data of one repetition: setpoint and following error (m), of shape (n,), at a sample time in s.

    `saturated` is True at samples at which the force was limited; None if unknown.  `remarks` describe how the
    reference was processed.  `force` is the commanded force at the first sample, N, with its standard error; None if it
    is unknown or the trial starts in motion.
    """

    name: str
    setpoint: Setpoint
    following_error: np.ndarray
    sample_time: float
    saturated: np.ndarray | None = None
    remarks: tuple[str, ...] = ()
    force: float | None = None
    force_error: float = 0.0

    @property
    def rms(self) -> float:
        """The RMS of the following error, m."""
        return float(np.sqrt(np.mean(self.following_error**2)))

    @property
    def peak(self) -> float:
        """The peak of the following error, m."""
        return float(np.max(np.abs(self.following_error)))

    @property
    def starts_moving(self) -> bool:
        """True if the first velocity cannot be reached from rest in two samples at the largest acceleration."""
        first = abs(float(np.asarray(self.setpoint.velocity)[0]))
        return first > 2.0 * self.sample_time * float(np.max(np.abs(self.setpoint.acceleration)))

    @property
    def time(self) -> np.ndarray:
        """The time of each sample in s, from 0."""
        return np.arange(self.following_error.size) * self.sample_time

    def table(self) -> Table:
        """Return a table of duration, travel, speed, acceleration and error."""
        x, v, a = (np.asarray(derivative) for derivative in self.setpoint[:3])
        largest = [float(np.ptp(x)), *(float(np.max(np.abs(values))) for values in (v, a))]
        columns = [
            "trial",
            "samples",
            Column("travel", "m", "mm"),
            Column("velocity", "m/s"),
            Column("acceleration", "m/s2"),
            Column("error RMS", "m"),
            Column("peak", "m"),
        ]
        row = [self.name, self.following_error.size, *largest, self.rms, self.peak]
        return Table(f"a trial of {Quantity(self.following_error.size * self.sample_time, 's'):SI}", columns, [row])


def simulated_trial(run: Run, reference: Reference) -> Trial:
    """Return the trial of a simulated run along a reference, with the exact derivatives of the reference.

    Raises LogError if the guard tripped during the run, since the axis then did not follow the reference.
    """
    if "trip" in run.signals and np.any(run["trip"] > 0.0):
        k = int(np.argmax(run["trip"] > 0.0))
        raise LogError(
            f"{run.name}: the guard tripped at {Quantity(run.time[k], 's'):6 SI} (code {number(run['trip'][k], 6)}): "
            "no trial"
        )
    rows = (np.broadcast_to(np.asarray(row, dtype=np.float64), run.time.shape) for row in reference.at(run.time))
    return Trial(
        name=run.name,
        setpoint=Setpoint(*rows),  # type: ignore[arg-type]
        following_error=run["following_error"],
        sample_time=run.sample_time,
        saturated=run["requested"] != run["force"],
        force=float(run["requested"][0]),
    )


def measured_trial(
    loop: Loop,
    set_position: np.ndarray,
    position: np.ndarray,
    *,
    sample_time: float,
    force: np.ndarray | None = None,
    smoothing: int | None = None,
    name: str = "log",
) -> Trial:
    """Return the trial of a log: set and actual position in m, and the force in N if it was logged, each of shape (n,).

    sample_time  sample time of the log in s, which must agree with that of the loop to within 0.1 %
    smoothing    number of samples on each side of two moving averages of the set position; 0: none; default: the
                 smallest number for which rounding errors of the logged reference are below 2 % of its acceleration

    The log contains no derivatives.  They are computed as differences of the set positions, centered at the middle of
    the sample interval over which the force acts, where the feedforward needs them:

        v(k+½) = (x(k+1) - x(k)) / T,   a(k+½) = (x(k+2) - x(k+1) - x(k) + x(k-1)) / 2T²
        j(k+½) = (x(k+2) - 3 x(k+1) + 3 x(k) - x(k-1)) / T³
        s(k+½) = (x(k+3) - 3 x(k+2) + 2 x(k+1) + 2 x(k) - 3 x(k-1) + x(k-2)) / 2T⁴

    and the setpoint at kT is their Taylor extrapolation by minus half a sample, so that extrapolation by half a sample
    restores them.
    A sample counts as saturated if |force| reaches the force limit of the controller.  The force at the first sample
    is its mean over the rest before the motion, at most 200 samples.
    Raises LogError for a different sample time (with the difference and the tolerance), for arrays of different length,
    and for a log that is too short.
    """
    T = float(loop.sample_time)
    check_clock(name, sample_time, T)
    x, y = np.asarray(set_position, dtype=np.float64), np.asarray(position, dtype=np.float64)
    if x.shape != y.shape or x.ndim != 1:
        raise LogError(f"{name}: set position has {x.size} rows, position {y.size}: they must be equal")
    for what, row in (("set position", x), ("position", y)):
        if not np.all(np.isfinite(row)):
            raise LogError(
                f"{name}: the {what} is not finite in row {int(np.argmin(np.isfinite(row)))}: cut the log there"
            )
    if x.size < 4 * _ENDS:
        raise LogError(f"{name}: has {x.size} rows, {4 * _ENDS - x.size} too few; a trial needs at least {4 * _ENDS}")
    width, remarks = _width(x, T) if smoothing is None else (_checked(smoothing, x.size), ())
    limit = loop.control.force_limit
    saturated = np.zeros(x.size, dtype=bool) if limit is None else None
    if force is not None and limit is not None:
        # a log rounds the force
        saturated = np.abs(force) >= (1.0 - 1e-6) * limit
    first = _first_force(x, force)
    return Trial(
        name=name,
        setpoint=_differenced(_smoothed(x, width), T)._replace(position=x),  # type: ignore[arg-type]
        following_error=x - y,
        sample_time=T,
        saturated=saturated,
        remarks=remarks,
        force=first[0],
        force_error=first[1],
    )


def _first_force(x: np.ndarray, force: np.ndarray | None) -> tuple[float | None, float]:
    """Return the mean force during the initial rest of a log, and its standard error; None for a log that starts in
    motion.

    The error accounts for the autocorrelation of the noise.
    """
    rest = int(np.argmax(x != x[0])) if np.any(x != x[0]) else x.size
    if force is None or rest < 2:
        return None, 0.0
    rows = np.asarray(force, dtype=np.float64)[: min(rest, _FIRST)]
    mean = float(np.mean(rows))
    return mean, float(np.sqrt(robust_covariance(np.ones((rows.size, 1)), rows - mean)[0, 0]))


def check_clock(name: str, sample_time: float, T: float) -> None:
    """Raise LogError if a sample time in s differs from that of the controller, T."""
    off = abs(sample_time - T)
    if off <= CLOCK * T:
        return
    near = T * (1.0 + CLOCK if sample_time > T else 1.0 - CLOCK)
    raise LogError(
        f"{name}: its clock of {Quantity(sample_time, 's'):6} differs from the controller's {Quantity(T, 's'):6} by "
        f"{Quantity(off, 's'):6}; {Quantity(CLOCK, 'share'):6} or {Quantity(CLOCK * T, 's')} is admitted, so the "
        f"nearest admissible clock is {Quantity(near, 's'):6}: log every sample of the controller, or give the machine "
        "the sample time it has"
    )


def _checked(smoothing: int, rows: int) -> int:
    most = rows // 4
    if not 0 <= smoothing <= most:
        raise ParameterError(f"smoothing = {smoothing} must be a whole number of samples, >= 0 and <= {most}")
    return smoothing


def _padded(x: np.ndarray, rows: int) -> np.ndarray:
    """Return an array extended by `rows` entries on each side, by point reflection about its ends."""
    return np.pad(x, rows, mode="reflect", reflect_type="odd")


def _smoothed(x: np.ndarray, width: int) -> np.ndarray:
    """Return the values after two passes of a moving average over 2 width + 1 samples."""
    if width == 0:
        return x
    # two passes make a triangle, which has no steps: a second difference would show those of a single box
    box = np.full(2 * width + 1, 1.0 / (2 * width + 1))
    base = x[0]  # the sum of small numbers keeps more digits
    return base + np.convolve(_padded(x - base, 2 * width), np.convolve(box, box), mode="valid")


def _differenced(x: np.ndarray, T: float) -> Setpoint:
    """Return the setpoint at kT whose Taylor series half a sample later equals the central differences there."""
    n, wide = x.size, _padded(x, _ENDS)

    def at(k: int) -> np.ndarray:
        return wide[_ENDS + k : _ENDS + k + n]

    middle = Setpoint(
        position=0.5 * (at(0) + at(1)),  # type: ignore[arg-type]
        velocity=(at(1) - at(0)) / T,  # type: ignore[arg-type]
        acceleration=(at(2) - at(1) - at(0) + at(-1)) / (2.0 * T * T),  # type: ignore[arg-type]
        jerk=(at(2) - 3.0 * at(1) + 3.0 * at(0) - at(-1)) / (T * T * T),  # type: ignore[arg-type]
        snap=(at(3) - 3.0 * at(2) + 2.0 * at(1) + 2.0 * at(0) - 3.0 * at(-1) + at(-2)) / (2.0 * T * T * T * T),  # type: ignore[arg-type]
    )
    return middle.shifted(-0.5 * T)


def _width(x: np.ndarray, T: float) -> tuple[int, tuple[str, ...]]:
    """Return the smoothing width (samples on each side) for a log rounded to decimals, and a remark on it."""
    step = _rounded_to(x) if np.ptp(x) > 0.0 else 0.0
    if step == 0.0:
        return 0, ()
    # each some 1.4 times as wide: the noise of an acceleration falls fast with the width
    for width in (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, _WIDEST):
        if 4 * width > x.size // 4:
            break
        pulse = np.zeros(8 * width + 16)
        # rounding is white with a deviation of step/√12: the norm of the response to one such pulse is the noise
        pulse[pulse.size // 2] = step / np.sqrt(12.0)
        noise = float(np.linalg.norm(_acceleration(pulse, width, T)))
        if noise <= _NOISE * float(np.sqrt(np.mean(_acceleration(x, width, T) ** 2))):
            remark = Text(
                f"the set position was rounded to {Quantity(step, 'm'):6 SI} and is averaged over ±{2 * width} samples"
            )
            return width, (remark,) if width else ()
    raise LogError(
        f"the set position is rounded to {Quantity(step, 'm'):6 SI}, which hides its acceleration at a sample time of "
        f"{Quantity(T, 's'):6}: log it with more digits"
    )


def _acceleration(x: np.ndarray, width: int, T: float) -> np.ndarray:
    """Return the acceleration of the smoothed positions in the middle of the sample intervals."""
    return np.asarray(_differenced(_smoothed(x, width), T).shifted(0.5 * T).acceleration)


def _rounded_to(x: np.ndarray) -> float:
    """Return the decimal step, in m, of which all positions are multiples; 0 if there is none above 1e-12 m."""
    for digits in range(3, 12):
        # logs are rounded to decimals of mm or µm, or to halves, quarters and fifths of one
        for part in (1.0, 0.5, 0.25, 0.2):
            step = part * 10.0**-digits
            # 4e-16 x/step: rounding of the doubles themselves, in steps
            if float(np.max(np.abs(x / step - np.rint(x / step)))) < 1e-4 + 4e-16 * float(np.max(np.abs(x))) / step:
                return step
    return 0.0
