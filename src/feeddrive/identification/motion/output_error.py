"""Output-error identification: parameters of the simulated closed loop are fitted to a measured log."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.replay import Replay, estimate_start, path_of, replay
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.identification.motion.motion_log import MotionLog, at_rest, count_of, drawn, spread, unknown_force
from feeddrive.identification.regression import Estimate, errors, estimates_table, inverse_gram, robust_covariance
from feeddrive.language import tree
from feeddrive.language.errors import DivergedError, NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

_SIGNALS = ("position_load", "force")
# shares of the largest speed: the width of what friction does near standstill is unknown
_NEAR_REST = (0.01, 0.02, 0.035, 0.06, 0.1, 0.2)
# s: of the smoothing of the motion that bends the axis: below resonances of some 30 and 80 Hz it bends statically
_BENDING = (2e-3, 5e-3)
# of the RMS force, for the effect of a force near standstill: it hardly moves where the axis sticks
_SMALL_FORCE = 0.02
_STEP = 1e-3  # of a parameter, for its difference
# m: a rounded reading has no slope, so that simulations for differences need practically continuous ones
_FINE = 1e-13
_MOST = 12  # steps of Gauss and Newton
_DONE = 1e-5  # of the cost: the last step is one that lowers it by less
DELAYS = (0, 1)  # samples of dead time, in addition to that of the loop, that are always tried
_LATEST = 10  # samples: as long as the last delay tried is the best, one more is tried, up to this
_FEW, _RUNS = 4, 16  # runs with counts: to see whether they matter, and where they do
# an interval from 16 runs over that from many: Student's t with 15 degrees of freedom
_STUDENT = 2.131 / 1.960
_ROUNDS = 3  # corrections by what counts do on average
_MATTERS = 0.1  # of a standard error: what counts shift or scatter less is left as it is
# rows over which scores are summed: noise of counts hides how long they are correlated
_SMOOTH = 16
_MOVING = 10  # rows in motion a parameter without which rows at rest must count, too
# of the variance of a residual: the least that counts do not explain, so that no row gets all of the weight
_LEAST = 0.5


@dataclass(frozen=True, eq=False, repr=False)
class Refinement(Result):
    """The loop whose simulation fits the log best.

    estimates   fitted parameters, by dotted name in the loop, with standard errors
    start       initial values by name
    by_delay    tried dead time in samples -> RMS of the position residual, m
    replay      replay of the fitted loop
    count       resolution of the readings, m, if the fit accounts for quantization; otherwise 0
    """

    name: str
    loop: Loop
    estimates: tuple[Estimate, ...]
    start: dict[str, float]
    by_delay: dict[int, float]
    delay: int
    replay: Replay
    steps: int
    count: float = 0.0

    def __getitem__(self, parameter: str) -> Estimate:
        return next(estimate for estimate in self.estimates if estimate.name.endswith(parameter))

    @property
    def rotary(self) -> bool:
        """True for a rotary axis."""
        return self.loop.axis.rotary

    @property
    def short(self) -> tuple[Estimate, ...]:
        """The estimates, each named by the last part of its dotted name where this part is unique."""
        last = [estimate.name.rsplit(".", 1)[-1] for estimate in self.estimates]
        return tuple(
            dataclasses.replace(estimate, name=end if last.count(end) == 1 else estimate.name)
            for estimate, end in zip(self.estimates, last, strict=True)
        )

    def table(self) -> Table:
        """Return a table of the parameters with their errors."""
        off = Text(f"position {Quantity(self.replay.rms('position_load'), 'm'):3} RMS")
        if "force" in self.replay.measured:
            off += Text(f", force {Quantity(self.replay.share('force'), 'share'):3}")
        return estimates_table(f"{self.name}: output error, {self.delay} samples of delay; {off}", self.short)


def physics(loop: Loop) -> tuple[str, ...]:
    """Return the names of the nonzero mass, friction and constant-force parameters, which are fitted by default."""
    axis = loop.place_of("axis")
    wanted = tuple(f"{axis}.{part}" for part in ("plant.mass", "friction_load.", "friction_motor.", "forces."))
    skipped = ("stribeck_velocity", "smoothing", "transition_velocity", "period", "phase", "share")
    paths = [
        name
        for name, value in tree.parameters(loop).items()
        if name.startswith(wanted) and isinstance(value, float) and not name.endswith(skipped)
    ]
    return tuple(name for name in paths if tree.get(loop, name) != 0.0)


def refine(
    loop: Loop,
    log: MotionLog,
    names: Sequence[str] | None = None,
    *,
    delays: Sequence[int] | None = None,
    skip: int = 49,
) -> Refinement:
    """Fit parameters of a loop to a log by simulating the loop with the log's reference.

        minimize  Σ ((x - x_model) / σx)² + Σ ((F - F_model) / σF)²,   σ: RMS of each residual, updated during the fit

    The cost is minimized by Gauss-Newton steps with finite differences of simulated runs.  The dead
    time is varied in whole samples: the parameters are fitted for each of `delays`, which are added to the dead time of
    the loop, and the delay with the smallest position residual is selected.  By default 0 and 1 are tried, then longer
    delays as long as they improve the fit.

    names  dotted names; default: mass, friction and constant forces that are not 0
    skip   samples at the start that are ignored

    The loop must be that of the log, with the same law, gains and sample time.  Standard errors are robust to the
    residual's autocorrelation.  Use this function after `identify_rigid` if noise or quantization spoils the
    derivatives, or to fit friction near standstill, which the inverse dynamics leave out.
    Raises NotIdentifiableError for a log without set position, and for a parameter without effect.
    """
    if log.set_position is None:
        raise NotIdentifiableError(
            f"{log.name}: output error needs the set position: record it next, on the same clock"
        )
    if abs(log.sample_time / float(loop.sample_time) - 1.0) > 1e-3:
        raise ParameterError(
            f"{log.name}: its sample time {Quantity(log.sample_time, 's'):6 SI} is not that of the loop, "
            f"{Quantity(float(loop.sample_time), 's'):6 SI}"
        )
    chosen = tuple(names or physics(loop))
    for name in chosen:
        tree.declaration(loop, name)
    fits = {d: _fitted(loop.later(d), log, chosen, skip) for d in delays or DELAYS}
    while delays is None and _is_last(fits) and max(fits) < _LATEST:
        fits[max(fits) + 1] = _fitted(loop.later(max(fits) + 1), log, chosen, skip)
    if all(fit is None for fit in fits.values()):
        raise DivergedError(f"{log.name}: the loop diverges along the log's reference: check its gains and its start")
    there = {d: fit for d, fit in fits.items() if fit is not None}
    by_delay = {d: fit.left for d, fit in there.items()}
    best = min(by_delay, key=lambda d: by_delay[d])
    fit = there[best]
    measured = {"set_position": log.set_position, "position_load": log.position, "force": log.force}
    return Refinement(
        name=log.name,
        loop=fit.loop,
        estimates=fit.estimates,
        start={name: float(tree.get(loop, name)) for name in chosen},
        by_delay=by_delay,
        delay=best,
        replay=replay(fit.loop, measured, skip=skip, name="fitted"),
        steps=fit.steps,
        count=fit.counted,
    )


def dead_time(fit: Refinement, log: MotionLog, *, skip: int = 49) -> tuple[float, float]:
    """Return the dead time of a fit in addition to that of the initial loop, in samples, and its standard error.

    The fractional part is an extra parameter of the least-squares problem; its column of the Jacobian is the effect of
    one sample of dead time.
    Raises DivergedError for a loop that becomes unstable with one more sample.
    """
    names = tuple(estimate.name for estimate in fit.estimates)
    model = _signals(fit.loop, log, skip)
    measured = np.array([log.position[skip:], log.force[skip:]])
    change = _signals(fit.loop.later(1), log, skip) - model
    columns = np.concatenate([_columns(fit.loop, log, names, skip, model), change[:, :, None]], axis=2)
    sizes = _sizes(measured - model)
    left = (measured - model) / sizes
    covariance = robust_covariance(columns / sizes[:, :, None], left)
    return fit.delay + float(_solved(columns / sizes[:, :, None], left)[-1]), float(errors(covariance)[-1])


def _is_last(fits: Mapping[int, _Fit | None]) -> bool:
    """Return True if, of all delays tried, the longest has the smallest position residual."""
    left = {d: fit.left for d, fit in fits.items() if fit is not None}
    return bool(left) and min(left, key=lambda d: left[d]) == max(fits)


def _signals(
    loop: Loop, log: MotionLog, skip: int, names: Sequence[str] = _SIGNALS, load: RecordedForce | None = None
) -> np.ndarray:
    """Return signals of the simulated log, by default position and force, without quantization and noise."""
    loop = tree.vary(
        loop, dict.fromkeys(_encoder(loop, "resolution"), _FINE) | dict.fromkeys(_encoder(loop, "noise"), 0.0)
    )
    assert log.set_position is not None
    reference = path_of(loop.control, log.set_position, float(loop.sample_time))
    start = estimate_start(log.position, log.sample_time)
    run = simulate(loop, reference, load=load, start=start, record=names)
    return np.array([run[name][skip : log.position.size] for name in names])


class _Fit(NamedTuple):
    """A fitted loop: its position residual in m, parameters, number of steps, and the resolution used (`counted`)."""

    loop: Loop
    left: float
    estimates: tuple[Estimate, ...]
    steps: int
    counted: float = 0.0


def _fitted(loop: Loop, log: MotionLog, names: tuple[str, ...], skip: int) -> _Fit | None:
    """Return the fitted loop with its errors, or None if it diverges."""
    measured = np.array([log.position[skip:], log.force[skip:]])
    try:
        model = _signals(loop, log, skip)
    # a dead time with which the loop is unstable is no candidate
    except DivergedError:
        return None
    steps = 0
    sizes = _sizes(measured - model)
    while True:
        columns = _columns(loop, log, names, skip, model) / sizes[:, :, None]
        left = (measured - model) / sizes
        change = _step(log, columns, left, names)
        loop, model, gained = _advance(loop, log, names, skip, change, (measured, sizes, model))
        steps += 1
        if gained < _DONE or steps == _MOST:
            break
        sizes = _sizes(measured - model)
    left = (measured - model) / sizes
    _require_effect(log, columns, names)
    # with both signals divided by their own RMS the sum over them is one least-squares problem
    covariance = robust_covariance(columns, left)
    try:
        counted = _with_counts(loop, log, names, skip, columns * sizes[:, :, None], errors(covariance))
    except DivergedError:
        return None
    if counted is not None:
        return counted._replace(steps=steps + counted.steps)
    wider = np.hypot(errors(covariance), _doubt(loop, log, skip, sizes, columns, left))
    estimates = _estimates(loop, names, columns, left, wider)
    return _Fit(loop, float(np.sqrt(np.mean((measured - model)[0] ** 2))), estimates, steps)


def _with_counts(
    loop: Loop, log: MotionLog, names: tuple[str, ...], skip: int, slopes: np.ndarray, before: np.ndarray
) -> _Fit | None:
    """Fit the mean of simulated runs with quantization; return None if all changes are small.

        r = measured - mean,   σ²(k) = max(mean r² - mean s², r²/2) + s²(k)
        cov = cov(runs) + cov(r)

    A change is small if it is below `_MATTERS` times the standard error `before` quantization was considered.  s² is
    the variance between the runs at each row.  Rows at rest are ignored.  cov(runs) is the covariance of the results if
    the log is replaced by other runs, since rounding is not white noise while a reading stays at one count.  cov(r)
    follows from the residual; it counts part of the quantization again, so that the errors are conservative.  After the
    first correction the runs also include the unmodelled force of the log, since dry friction prevents its effect from
    averaging out.
    Source: the parametric bootstrap, Efron & Tibshirani 1993; the weights and the choice of rows are ours.
    """
    count = count_of(log.position)
    if count == 0.0:
        return None
    measured = np.array([log.position[skip:], log.force[skip:]])
    model = _signals(loop, log, skip)
    runs = drawn(loop, log, skip, count, _FEW, seed=0)
    sizes = _sizes(measured - model)
    moved = np.array([_solved(slopes / sizes[:, :, None], (run - model) / sizes) for run in runs])
    if np.all(np.abs(np.mean(moved, axis=0)) + np.std(moved, axis=0) < _MATTERS * before):
        return None
    weighed, unknown = _Weighed.of(loop, log, names, skip, count), None
    for turn in range(_ROUNDS):
        change = _step(log, weighed.columns, weighed.left, names)
        loop = tree.vary(loop, {name: _bounded(loop, name, dv) for name, dv in zip(names, change, strict=True)})
        weighed = _Weighed.of(loop, log, names, skip, count, unknown)
        if turn == 0:
            unknown = weighed.unknown
    _require_effect(log, weighed.columns, names)
    # other draws than those of the fit, which lie too close to their own mean
    others = drawn(loop, log, skip, count, _RUNS, 2, unknown)
    others = (others - np.mean(others, axis=0)) / weighed.scale
    moved = np.array([_solved(weighed.columns, other) for other in others])
    covariance = robust_covariance(weighed.columns, weighed.left, smooth=_SMOOTH)
    scattered = np.diag(covariance) + _STUDENT**2 * np.sum(moved**2, axis=0) / (_RUNS - 1)
    robust = np.hypot(np.sqrt(scattered), _doubt(loop, log, skip, weighed.scale, weighed.columns, weighed.left))
    estimates = _estimates(loop, names, weighed.columns, weighed.left, robust)
    return _Fit(loop, float(np.sqrt(np.mean((measured - weighed.mean)[0] ** 2))), estimates, _ROUNDS, count)


def _doubt(
    loop: Loop, log: MotionLog, skip: int, scale: np.ndarray, columns: np.ndarray, left: np.ndarray
) -> np.ndarray:
    """Return the errors that the residual does not show, shape (p,): friction near standstill, elasticity, dead time.

        near standstill:  F = -extra sign(v) exp(-(v / w)²),   w = share of the largest speed
        elasticity:       F = extra d²a/dt²,   a the acceleration of the model, smoothed: an axis of two masses below
                          its resonance (see `Terms`); it changes the apparent mass M by (ω / resonance)²

    scale          the size by which columns and residual are divided, shape (2, n) or (2, 1)
    columns, left  columns and residual of the fit, shapes (2, n, p) and (2, n)
    """
    model = _signals(loop, log, 0, (*_SIGNALS, "velocity_load"))
    velocity = model[-1]
    top = float(np.max(np.abs(velocity)))
    moved = _moved_by_dead_time(loop, log, skip, scale, columns, left)
    if top == 0.0:
        return moved
    near_rest = [-np.sign(velocity) * np.exp(-((velocity / (share * top)) ** 2)) for share in _NEAR_REST]
    bending = [_bent(velocity, float(loop.sample_time), width) for width in _BENDING]
    for shapes in (near_rest, bending):
        shift = _moved_by_force(shapes, loop, log, skip, scale, columns, left, model[:-1])
        moved = np.hypot(moved, shift)
    return moved


def _bent(velocity: np.ndarray, T: float, width: float) -> np.ndarray:
    """Return the third derivative of a velocity smoothed over `width`, s, as a shape with a largest magnitude of 1."""
    from scipy.ndimage import gaussian_filter1d  # takes a second to import

    shape = gaussian_filter1d(velocity, max(width / T, 1.0), order=3, mode="nearest")
    return shape / (float(np.max(np.abs(shape))) or 1.0)


def _moved_by_dead_time(
    loop: Loop, log: MotionLog, skip: int, scale: np.ndarray, columns: np.ndarray, left: np.ndarray
) -> np.ndarray:
    """Return the error of each parameter due to that of the dead time, shape (p,).

        error² = max(0, error_wider² - error²) + d²

    The fit takes the best whole number of samples.  With the dead time as one more unknown, each parameter moves by d,
    and its error grows where the log hardly tells a delay from it.
    """
    try:
        change = _signals(loop.later(1), log, skip) - _signals(loop, log, skip)
    # a loop that is unstable one sample later determines its dead time well
    except DivergedError:
        return np.zeros(columns.shape[-1])
    if not np.any(change):
        return np.zeros(columns.shape[-1])
    wider = np.concatenate([columns, (change / scale)[:, :, None]], axis=2)
    p = columns.shape[-1]
    moved = _solved(wider, left)[:p] - _solved(columns, left)
    before, after = (
        np.diag(robust_covariance(x, left - x @ _solved(x, left), smooth=_SMOOTH))[:p] for x in (columns, wider)
    )
    return np.sqrt(np.maximum(after - before, 0.0) + moved**2)


def _moved_by_force(
    shapes: Sequence[np.ndarray],
    loop: Loop,
    log: MotionLog,
    skip: int,
    scale: np.ndarray,
    columns: np.ndarray,
    left: np.ndarray,
    model: np.ndarray,
) -> np.ndarray:
    """Return by how much a force that the model lacks shifts each parameter, shape (p,).

    The force, a factor times a shape over time, is added as one more unknown; of the shapes the one that explains most
    of the residual counts.  The shift d is reduced by what chance makes of it, as between two fits of which one is more
    precise (Hausman 1978): d² - |error² - error_wider²|, or 0.  Such forces act alike at each start and stop, so that
    the residual's autocorrelation does not show how much of them the mass has taken.

    model  the signals of the loop without the force, shape (2, n + skip); for the rest see `_doubt`
    """
    small = _SMALL_FORCE * float(np.sqrt(np.mean(log.force**2)))
    p = columns.shape[-1]
    least, moved, wider = np.inf, np.zeros(p), columns
    for shape in shapes:
        load = RecordedForce(force=small * shape, sample_time=float(loop.sample_time))
        try:
            felt = (_signals(loop, log, 0, load=load) - model)[:, skip:] / small / scale
        # a loop at the edge of stability shows nothing about a force
        except DivergedError:
            continue
        if not np.any(felt):
            continue
        tried = np.concatenate([columns, felt[:, :, None]], axis=2)
        change = _solved(tried, left)
        rest = float(np.sum((left - tried @ change) ** 2))
        if rest < least:
            least, moved, wider = rest, change[:p] - _solved(columns, left), tried
    if not np.isfinite(least):
        return moved
    before, after = (
        np.diag(robust_covariance(x, left - x @ _solved(x, left), smooth=_SMOOTH))[:p] for x in (columns, wider)
    )
    return np.sqrt(np.maximum(moved**2 - np.abs(before - after), 0.0))


class _Weighed(NamedTuple):
    """Mean and standard deviation of runs with quantization, shape (2, n), and the weighted columns and residual.

    The standard deviation of rows at rest is infinite, so that their weight is 0.
    """

    mean: np.ndarray
    scale: np.ndarray
    columns: np.ndarray
    left: np.ndarray
    unknown: np.ndarray

    @classmethod
    def of(
        cls,
        loop: Loop,
        log: MotionLog,
        names: tuple[str, ...],
        skip: int,
        count: float,
        unknown: np.ndarray | None = None,
    ) -> _Weighed:
        """Return the weighted least-squares problem at the parameter values of a loop."""
        measured = np.array([log.position[skip:], log.force[skip:]])
        runs = drawn(loop, log, skip, count, _RUNS, 1, unknown)
        mean, scatter = np.mean(runs, axis=0), spread(runs)
        squares = np.mean((measured - mean) ** 2, axis=1, keepdims=True)
        scale = np.sqrt(np.maximum(squares - np.mean(scatter, axis=1, keepdims=True), _LEAST * squares) + scatter)
        rest = at_rest(log, skip)
        rest &= np.count_nonzero(~rest) > _MOVING * len(names)
        scale[:, rest] = np.inf
        columns = _columns(loop, log, names, skip, _signals(loop, log, skip)) / scale[:, :, None]
        felt = unknown_force((measured - mean)[1], (runs - mean)[:, 1], ~rest)
        return cls(mean, scale, columns, (measured - mean) / scale, felt)


def _estimates(
    loop: Loop, names: tuple[str, ...], columns: np.ndarray, left: np.ndarray, robust: np.ndarray
) -> tuple[Estimate, ...]:
    flat = columns.reshape(-1, len(names))
    white = errors(inverse_gram(flat) * float(np.mean(left**2)))
    return tuple(
        Estimate(name, float(tree.get(loop, name)), tree.declaration(loop, name).unit, float(e), float(o))
        for name, e, o in zip(names, robust, white, strict=True)
    )


def _solved(columns: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Solve the least-squares problem for the change of the parameters."""
    flat = columns.reshape(-1, columns.shape[-1])
    sizes = np.linalg.norm(flat, axis=0)
    # columns of length 1: a mass in kg and a friction in N differ by powers of ten
    return np.linalg.lstsq(flat / sizes, left.ravel(), rcond=1e-10)[0] / sizes


def _encoder(loop: Loop, parameter: str) -> list[str]:
    return [
        path
        for path in tree.parameters(loop)
        if path.startswith(f"{loop.place_of('axis')}.encoder_") and path.endswith(f".{parameter}")
    ]


def _sizes(residual: np.ndarray) -> np.ndarray:
    """Return the RMS of the residual of both signals, shape (2, 1)."""
    return np.maximum(np.sqrt(np.mean(residual**2, axis=1, keepdims=True)), np.finfo(float).tiny)


def _columns(loop: Loop, log: MotionLog, names: tuple[str, ...], skip: int, model: np.ndarray) -> np.ndarray:
    """Return d signals / d parameters by one-sided differences, shape (2, n, p)."""
    slopes = []
    for name in names:
        value = float(tree.get(loop, name))
        step = _STEP * (abs(value) or 1.0)
        # one-sided, since only the directions of the descent and the errors follow from these slopes
        slopes.append((_signals(tree.vary(loop, {name: value + step}), log, skip) - model) / step)
    return np.stack(slopes, axis=-1)


def _step(log: MotionLog, columns: np.ndarray, left: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    _require_effect(log, columns, names)
    return _solved(columns, left)


def _require_effect(log: MotionLog, columns: np.ndarray, names: tuple[str, ...]) -> None:
    """Raise NotIdentifiableError for a parameter whose column is 0, or is not finite."""
    sizes = np.linalg.norm(columns.reshape(-1, len(names)), axis=0)
    for name, size in zip(names, sizes, strict=True):
        if size == 0.0 or not np.isfinite(size):
            raise NotIdentifiableError(
                f"{log.name}: {name} is not identifiable: the run does not change with it; record next a motion in "
                f"which it acts, or leave it out"
            )


def _advance(
    loop: Loop,
    log: MotionLog,
    names: tuple[str, ...],
    skip: int,
    change: np.ndarray,
    now: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> tuple[Loop, np.ndarray, float]:
    """Apply the largest fraction of a step that lowers the cost; return loop, signals and relative decrease."""
    measured, sizes, model = now
    before = float(np.mean(((measured - model) / sizes) ** 2))
    # a full step may make the loop unstable or reverse the sign of friction: the cost is flat or undefined there
    for share in (1.0, 0.5, 0.25, 0.1, 0.01):
        values = {name: _bounded(loop, name, share * dv) for name, dv in zip(names, change, strict=True)}
        try:
            tried = tree.vary(loop, values)
            signals = _signals(tried, log, skip)
        except (DivergedError, ParameterError):
            continue
        after = float(np.mean(((measured - signals) / sizes) ** 2))
        if after < before:
            return tried, signals, 1.0 - after / before
    return loop, model, 0.0


def _bounded(loop: Loop, name: str, change: float) -> float:
    """Return a value after a change; a value that must be positive keeps at least a tenth of its magnitude."""
    value = float(tree.get(loop, name))
    declared = tree.declaration(loop, name)
    positive = declared.above == 0 or declared.least == 0
    return max(0.1 * value, value + change) if positive else value + change
