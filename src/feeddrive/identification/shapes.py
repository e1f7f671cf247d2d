"""Relations between the samples of two channels that hold for any units and signs.

A position is the integral of a velocity; a set position leads the actual one; the motor runs ahead of the table while
it accelerates; a force follows acceleration and the direction of motion.  These relations distinguish channels with
unclear names, and reveal wrong names.  All of them are computed from changes over windows of 5 ms, which encoder counts
hardly affect, and by least squares with one or a few coefficients: no model of a drive is fitted here.

    change    Δx(t) = x(t + w) - x(t - w)              w: half a window
    integral  Δx    = k ∫ v dt over the same window     k: 1 if both are in SI
    bend      x(t + 2w) - 2 x(t) + x(t - 2w) = (2w)² a  a: the acceleration, weighted by a triangle
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WINDOW = 5e-3  # s: half of the span of a change; as in plausibility, encoder counts hardly affect it
LEAST_ROWS = 200  # of a log: fewer hold no two moves
POINTS = 4000  # at most that are compared: the relations of more are the same
MOVING = 0.02  # of the largest speed: below, friction holds any force
LATEST = 0.1  # s by which an actual value may trail its setpoint: Kv of 10 1/s
SAME = 0.9  # share of a motion that the same motion of the same axis explains
INTEGRAL = 0.95  # share of a position's changes that the integral of its velocity explains
EXPLAINED = 0.6  # share of a force that acceleration and friction explain at least, or it is no force of this motion
BETTER = 0.25  # unexplained share of one reading over that of another, from which on it is the right one
PROPORTIONAL = 0.98  # share of a command that the velocity alone explains, from which on it commands a velocity
CLEAR = 1.0  # sample by which one channel must lead another one: less may be the recorder's order
AGREES = 2.0  # times that one position explains more of the force than another, to confirm the lead: noise makes 1.2
SMOOTH = 0.5  # of the third differences of a reading, below which those of a set position are; 0.34 is usual
FAR = 8.0  # times that one position explains more of the force than another, against the lead: 5 occur by counts
LIKELY = 2.5  # standard errors from which on that effect is worth a remark
SURE = 5.0  # standard errors of an effect that decides between motor and table


def share(y: np.ndarray, *basis: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the fraction of y'y, y of shape (n,), that a combination of the basis explains, and its coefficients.

    A mean is explained only if the basis contains a constant; for y = 0 the fraction is 0.
    """
    columns = np.column_stack(basis)
    size = np.linalg.norm(columns, axis=0)
    columns /= np.where(size > 0.0, size, 1.0)
    coefficients, *_ = np.linalg.lstsq(columns, y, rcond=1e-9)
    power = float(y @ y)
    if power == 0.0:
        return 0.0, coefficients
    left = y - columns @ coefficients
    return max(0.0, 1.0 - float(left @ left) / power), coefficients / np.where(size > 0.0, size, 1.0)


@dataclass(frozen=True)
class Grid:
    """The rows in which channels are compared, the half window in rows, and the sample time in s."""

    rows: np.ndarray
    half: int
    T: float

    @classmethod
    def of(cls, n: int, T: float) -> Grid:
        """Return the grid of a log; that of a log that is too short has no rows."""
        half = max(1, round(WINDOW / T))
        rows = np.arange(2 * half, max(n - 2 * half, 2 * half), max(1, half // 2, n // POINTS))
        return cls(rows if n >= LEAST_ROWS else rows[:0], half, T)

    def change(self, x: np.ndarray) -> np.ndarray:
        """Return x(t + w) - x(t - w)."""
        return x[self.rows + self.half] - x[self.rows - self.half]

    def rate(self, x: np.ndarray) -> np.ndarray:
        """Return the mean rate of change over the window."""
        return self.change(x) / (2.0 * self.half * self.T)

    def bend(self, x: np.ndarray) -> np.ndarray:
        """Return the second derivative, weighted by a triangle of four half windows."""
        span = 2 * self.half
        return (x[self.rows + span] - 2.0 * x[self.rows] + x[self.rows - span]) / (span * self.T) ** 2

    def mean(self, x: np.ndarray, *, triangle: bool = False) -> np.ndarray:
        """Return the mean over the window by the trapezoidal rule; if `triangle`, with the weights of `bend`."""
        # removed first: the sums of a large constant would lose the digits of small changes
        total = np.concatenate([[0.0], np.cumsum(0.5 * (x[1:] + x[:-1]) - x[0])])
        if triangle:
            twice = np.concatenate([[0.0], np.cumsum(0.5 * (total[1:] + total[:-1]))])
            span = 2 * self.half
            bent = twice[self.rows + span] - 2.0 * twice[self.rows] + twice[self.rows - span]
            return bent / span**2 + x[0]
        return self.change(total) / (2 * self.half) + x[0]


def integral_of(position: np.ndarray, velocity: np.ndarray, T: float) -> tuple[float, float]:
    """Return the fraction of the changes of a position explained by the integral of a velocity, and k in Δx = k ∫ v dt.

    The fraction is 0 for a log that is too short and for channels that do not change.
    """
    grid = Grid.of(position.size, T)
    if not grid.rows.size:
        return 0.0, 0.0
    explained, k = share(grid.rate(position), grid.mean(velocity))
    return explained, float(k[0])


def velocity_of(position: np.ndarray, velocity: np.ndarray, T: float) -> float:
    """Return k in Δx = k ∫ v dt, by regression of v on Δx; 0 for a log that is too short or without motion."""
    grid = Grid.of(position.size, T)
    if not grid.rows.size:
        return 0.0
    _, k = share(grid.mean(velocity), grid.rate(position))
    return 1.0 / float(k[0]) if k[0] else 0.0


@dataclass(frozen=True)
class Likeness:
    """The similarity of a channel b to a channel a: b(t) ≈ gain · a(t - lag) + constant.

    explained  explained fraction of the changes of b
    lag        lag in samples, positive if b lags behind a
    """

    explained: float
    gain: float
    lag: float


def likeness(a: np.ndarray, b: np.ndarray, T: float) -> Likeness:
    """Return the similarity of b to a at the best lag within ±LATEST, interpolated by a parabola through the peak."""
    n = a.size
    if n < LEAST_ROWS or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return Likeness(0.0, 0.0, 0.0)
    half = max(1, round(WINDOW / T))
    da, db = (x[2 * half :] - x[: -2 * half] for x in (a, b))
    most = min(max(2, round(LATEST / T)), da.size // 4)
    size = 1 << int(np.ceil(np.log2(da.size + most + 1)))
    spectrum = np.fft.irfft(np.fft.rfft(db, size) * np.conj(np.fft.rfft(da, size)), size)
    lags = np.arange(-most, most + 1)
    # over the energies of the overlap: a log that ends in the middle of a move would seem to have less of a lag
    sums = [np.concatenate([[0.0], np.cumsum(d * d)]) for d in (da, db)]
    late, early = np.maximum(lags, 0), np.maximum(-lags, 0)
    n_ = da.size
    energies = (sums[0][n_ - late] - sums[0][early]) * (sums[1][n_ - early] - sums[1][late])
    products = np.abs(spectrum[lags]) / np.sqrt(np.maximum(energies, np.finfo(float).tiny))
    k = int(np.argmax(products))
    lag = float(lags[k])
    if 0 < k < lags.size - 1:
        before, here, after = products[k - 1 : k + 2]
        bent = before - 2.0 * here + after
        lag += 0.5 * (before - after) / bent if bent < 0.0 else 0.0
    whole = int(lags[k])
    first, second = (da[: da.size - whole], db[whole:]) if whole >= 0 else (da[-whole:], db[: db.size + whole])
    # the fraction of the lag moves b by fraction · T · rate: without it a fast motion would seem less alike
    explained, gains = share(second, first, np.gradient(first))
    return Likeness(explained, float(gains[0]), lag)


@dataclass(frozen=True)
class Driven:
    """The relation of a force f to a motion: f ≈ mass · a + friction · sign(v) + viscous · v + constant, while moving.

    explained  explained fraction of the force about its mean
    mass       mass in N/(m/s²), negative for a reversed sign
    by_speed   fraction that the velocity alone explains
    as_power   fraction that mass · a v + friction · |v| + viscous · v² explains, which is high for a power
    """

    explained: float
    mass: float
    by_speed: float
    as_power: float = 0.0


def driven(motion: np.ndarray, force: np.ndarray, T: float, *, is_velocity: bool = False) -> Driven:
    """Return the relation of a force to a motion, which is a position or a velocity."""
    grid = Grid.of(motion.size, T)
    nothing = Driven(0.0, 0.0, 0.0)
    if grid.rows.size < LEAST_ROWS // 4:
        return nothing
    if is_velocity:
        v, a = grid.mean(motion, triangle=True), _rate_of_mean(grid, motion)
    else:
        v, a = _wide_rate(grid, motion), grid.bend(motion)
    f = grid.mean(force, triangle=True)
    limit = MOVING * float(np.max(np.abs(v), initial=0.0))
    moving = np.abs(v) > limit
    if np.count_nonzero(moving) < LEAST_ROWS // 8 or limit == 0.0:
        return nothing
    v, a, f = v[moving], a[moving], f[moving] - np.mean(f[moving])
    ones = np.ones(v.size)
    explained, coefficients = share(f, a, np.sign(v), v, ones)
    by_speed, _ = share(f, v, ones)
    as_power, _ = share(f, a * v, np.abs(v), v * v, ones)
    return Driven(explained, float(coefficients[0]), by_speed, as_power)


def order(goal: np.ndarray, actual: np.ndarray, force: np.ndarray | None, T: float) -> float:
    """Return the evidence that the first of two positions is the setpoint, from -1 to 1.

    ±1 is certain, ±0.5 likely, 0 undecided; a negative number means that the second one is the setpoint.

    A setpoint leads, and the force follows the acceleration and friction of the actual position better than those of
    the setpoint.  Either may mislead: with strong feedforward the position leads, and through a velocity gain coarse
    counts cause a force that follows them.  The result is certain if both criteria agree, or if the evidence of the
    force against the lead is much stronger.
    """
    lag = likeness(goal, actual, T).lag
    lead = 0.0 if abs(lag) <= CLEAR else float(np.sign(lag))
    left = [0.0, 0.0] if force is None else [max(1.0 - driven(x, force, T).explained, 1e-12) for x in (goal, actual)]
    if force is None or min(left) > 1.0 - EXPLAINED:
        return 0.5 * lead
    side = 1.0 if left[0] > left[1] else -1.0
    times = max(left) / min(left)
    # without a lead the force alone does not make it sure: feedforward and coarse counts let it follow the setpoint
    if lead == 0.0:
        return 0.5 * side if times > 1.0 / BETTER else 0.0
    if lead == side:
        return lead if times > AGREES else 0.5 * lead
    return side if times > FAR else 0.5 * lead


def smoother(one: np.ndarray, other: np.ndarray) -> bool:
    """Return True if the third differences of the first channel are clearly smaller: setpoints are smooth, while
    readings contain quantization and noise.
    """
    rough, rougher = (float(np.sqrt(np.mean(np.diff(x, 3) ** 2))) for x in (one, other))
    return rough < SMOOTH * rougher


def _wide_rate(grid: Grid, x: np.ndarray) -> np.ndarray:
    """Return the mean velocity over the window of `bend`."""
    span = 2 * grid.half
    return (x[grid.rows + span] - x[grid.rows - span]) / (2.0 * span * grid.T)


def _rate_of_mean(grid: Grid, velocity: np.ndarray) -> np.ndarray:
    """Return the acceleration from a velocity, with the weights of `bend`: the change of its mean over a span."""
    span = 2 * grid.half
    total = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) - velocity[0])])
    bent = total[grid.rows + span] - 2.0 * total[grid.rows] + total[grid.rows - span]
    return bent * grid.T / (span * grid.T) ** 2


def ahead(motor: np.ndarray, table: np.ndarray, T: float) -> float:
    """Return the lead of the first channel over the second during acceleration, in standard errors.

        motor - table = slope · x + compliance · a + lost · sign(v) + lag · v + constant

    Because of the drive-train elasticity, the motor leads by the inertial force and the friction of the load, divided
    by the stiffness. The terms in x and v are due to scales and clocks and do not distinguish the encoders.  A negative
    number means that the second channel is the motor; the result is 0 for channels of different scale, which cannot be
    subtracted.
    """
    grid = Grid.of(motor.size, T)
    if grid.rows.size < LEAST_ROWS // 4:
        return 0.0
    x = 0.5 * (motor + table)
    v, a = _wide_rate(grid, x), grid.bend(x)
    moving = np.abs(v) > MOVING * float(np.max(np.abs(v), initial=0.0))
    if np.count_nonzero(moving) < LEAST_ROWS // 8:
        return 0.0
    d = grid.mean(motor - table, triangle=True)[moving]
    basis = np.column_stack([a[moving], np.sign(v[moving]), x[grid.rows][moving], v[moving], np.ones(d.size)])
    scale = np.linalg.norm(basis, axis=0)
    basis /= np.where(scale > 0.0, scale, 1.0)
    coefficients, *_ = np.linalg.lstsq(basis, d, rcond=1e-9)
    left = d - basis @ coefficients
    inverse = np.linalg.pinv(basis.T @ basis)
    # residuals of neighbouring rows are alike: as in `regression`, their sum over lags widens the errors
    memory = _memory(left)
    errors = np.sqrt(np.maximum(np.diag(inverse), 0.0) * float(left @ left) / d.size * memory)
    ratios = [c / e if e > 0.0 else 0.0 for c, e in zip(coefficients[:2], errors[:2], strict=True)]
    return float(max(ratios, key=abs))


def _memory(residual: np.ndarray) -> float:
    """Return the factor by which autocorrelation widens a variance: 1 + 2 Σ ρ up to the first ρ < 0.1."""
    n = residual.size
    power = float(residual @ residual)
    if power == 0.0:
        return 1.0
    total = 1.0
    for lag in range(1, n // 4):
        rho = float(residual[lag:] @ residual[:-lag]) / power
        if rho < 0.1:
            break
        total += 2.0 * rho
    return total
