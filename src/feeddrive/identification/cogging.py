"""Identification of cogging: harmonics of the cogging force from force and position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.force.cogging import Cogging
from feeddrive.blocks.force.harmonic import Harmonic
from feeddrive.identification.regression import Estimate, ols_covariance, stray_remarks, strays
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text

# for all orders together (Bonferroni): of 128 orders some would otherwise be significant by chance
RISK = 0.05
_ROWS = 3  # rows a column needs


@dataclass(frozen=True)
class CoggingOrder:
    """A harmonic of the cogging: amplitudes in the unit of the force, with standard errors, and phases of a sine, rad.

    even      amplitude of the part that does not depend on the direction: cogging; None if all runs have the same
              direction
    odd       amplitude of the part that changes sign with the direction: friction that varies with position
    forward   amplitude in motion towards larger positions, `backward` in the opposite direction; None if no run
              has that direction
    p_value   probability of amplitudes at least this large if the true force does not contain this harmonic
    """

    order: int
    even: Estimate | None
    even_phase: float
    odd: Estimate | None
    forward: Estimate | None
    backward: Estimate | None
    phase: float
    p_value: float
    significant: bool

    @property
    def amplitude(self) -> float:
        """The larger of the amplitudes measured in the two directions."""
        return max(direction.value for direction in (self.forward, self.backward) if direction is not None)


@dataclass(frozen=True, eq=False, repr=False)
class CoggingFit(Result):
    """The harmonics of the cogging, strongest first, separated from Coulomb friction and a constant force.

    coulomb   half the difference between the mean forces in the two directions; None if all runs have the same
              direction
    offset    average of these mean forces; if all runs have the same direction, it includes the friction
    orders    all fitted harmonics
    residual  residuals of all runs, concatenated
    """

    orders: tuple[CoggingOrder, ...]
    coulomb: Estimate | None
    offset: Estimate
    residual: np.ndarray
    unit: str
    remarks: tuple[str, ...]

    @property
    def significant(self) -> tuple[CoggingOrder, ...]:
        """The statistically significant harmonics."""
        return tuple(order for order in self.orders if order.significant)

    def order(self, order: int) -> CoggingOrder:
        """Return the harmonic of the given order. Raises ParameterError for an order that was not fitted."""
        for candidate in self.orders:
            if candidate.order == order:
                return candidate
        raise ParameterError(
            f"order {order} was not tried; the largest is {max(candidate.order for candidate in self.orders)}"
        )

    def table(self) -> Table:
        """Return a table of the strongest significant harmonics."""
        rows = []
        for order in self.significant[:16]:
            amplitudes = (order.forward, order.backward, order.even, order.odd)
            cells = (None if amplitude is None else amplitude.quantity for amplitude in amplitudes)
            rows.append([order.order, *cells, order.p_value])
        friction = "" if self.coulomb is None else Text(f"; Coulomb friction {self.coulomb.quantity}")
        title = f"{len(self.significant)} of {len(self.orders)} orders are significant{friction}"
        heads = (Column(head, self.unit) for head in ("forward", "backward", "cogging", "friction-like"))
        return Table(title, ["order", *heads, Column("p", form="1")], rows)

    def block(self, period: float, *, force_per_unit: float = 1.0, most: int = 12) -> Cogging:
        """Return the strongest significant harmonics as a cogging block.

        period          table motion per turn, m
        force_per_unit  N at the table per unit of the measured force (such as A)
        most            maximum number of harmonics

        The measured motor force balances the cogging, so the block has the opposite sign.  If all runs have the same
        direction, the block includes friction that varies with position.
        """
        strongest = sorted(self.significant, key=lambda order: -_balanced(order)[0])[:most]
        if not strongest:
            raise NotIdentifiableError("no order is significant: there is no cogging to write")
        largest = _balanced(strongest[0])[0]
        harmonics = tuple(
            Harmonic(
                order=order.order, share=_balanced(order)[0] / largest, phase=_wrapped(_balanced(order)[1] + np.pi)
            )
            for order in strongest
        )
        return Cogging(force=largest * force_per_unit, period=period, harmonics=harmonics)


def _balanced(order: CoggingOrder) -> tuple[float, float]:
    """Return the amplitude and phase of the cogging; if all runs have the same direction, they include friction."""
    return (order.even.value, order.even_phase) if order.even is not None else (order.amplitude, order.phase)


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def identify_cogging(runs: Sequence[CoggingRun], orders: Sequence[int] | None = None, *, unit: str = "A") -> CoggingFit:
    """Fit harmonics of the position by least squares, separated from the friction.

        force = offset + d coulomb + Σ over orders of (even + d odd),   d = ±1 the direction
        even, odd: a cos(2π order x) + b sin(2π order x)

    Cogging is independent of the direction of motion, while friction changes its sign; with runs in both directions the
    even part is therefore cogging and the odd part is friction that varies with position.  Runs in one direction give
    only their sum.

    orders  default: 1 to 128, but at most a sixth of the number of distinct positions within one turn

    An order is significant if its F statistic exceeds the value that the strongest of all orders reaches by chance in
    5 % of cases (Bonferroni).  Each run is fitted separately, and the fits of all runs in one direction are averaged.
    Standard errors are computed from the residual of each run and account for the correlation between neighboring
    rows.  They are increased if runs in the same direction differ by more than these errors, for example because the
    zero position or the temperature has changed.
    Raises NotIdentifiableError for runs that cover less than a whole turn.
    """
    if not runs:
        raise ParameterError("identify_cogging needs at least one run")
    chosen = tuple(orders) if orders is not None else tuple(range(1, _most(runs) + 1))
    if not chosen or min(chosen) < 1 or len(set(chosen)) != len(chosen):
        raise ParameterError("orders must be whole numbers >= 1, each once")
    for i, run in enumerate(runs):
        covered = np.unique(np.floor(np.mod(run.turns, 1.0) * 2 * max(chosen))).size
        # two places a wave: fewer would let a high order pass as a low one
        if covered < 0.95 * min(2 * max(chosen), run.turns.size):
            raise NotIdentifiableError(
                f"run {i + 1} visits {covered} of {2 * max(chosen)} places of a turn that order {max(chosen)} needs; "
                f"record next a whole turn at low speed, or ask for fewer orders"
            )
    sides = {sign: _side([run for run in runs if run.direction == sign], chosen) for sign in (1, -1)}
    there = {sign: side for sign, side in sides.items() if side is not None}
    fitted = [_order(n, i, there, unit, len(chosen)) for i, n in enumerate(chosen)]
    fitted.sort(key=lambda order: -order.amplitude)
    both = len(there) == 2
    levels = np.array([side.level for side in there.values()])
    error = float(np.sqrt(sum(side.level_variance for side in there.values()))) / len(there)
    coulomb = Estimate("coulomb", float(0.5 * (levels[0] - levels[1])), unit, error, error) if both else None
    offset = Estimate("offset", float(np.mean(levels)), unit, error, error)
    residual = np.concatenate([side.residual for side in there.values()])
    remarks = [remark for run in runs for remark in run.remarks]
    return CoggingFit(tuple(fitted), coulomb, offset, residual, unit, (*remarks, *_remarks(fitted, both)))


def _most(runs: Sequence[CoggingRun]) -> int:
    # a position that is visited again adds no resolution
    places = min(np.unique(np.mod(run.turns, 1.0)).size for run in runs)
    return max(1, min(128, places // (2 * _ROWS)))


@dataclass(frozen=True, eq=False)
class _Side:
    """The average fit of the runs in one direction: mean force, and (a, b) of each order with their covariance."""

    level: float
    level_variance: float
    pairs: np.ndarray  # shape (orders, 2)
    spreads: np.ndarray  # shape (orders, 2, 2)
    residual: np.ndarray
    freedom: int  # rows less columns


def _side(runs: Sequence[CoggingRun], orders: Sequence[int]) -> _Side | None:
    """Fit each run by least squares and average the fits.

    Errors are increased if the differences between the runs exceed those predicted by the errors of the fits.
    """
    if not runs:
        return None
    fits = [_alone(run, orders) for run in runs]
    values, count = np.array([fit[0] for fit in fits]), len(fits)
    mean = values.mean(axis=0)
    # each run is fitted alone: a shifted zero of one run would otherwise smear the harmonics of all
    covariance = np.sum([fit[1] for fit in fits], axis=0) / count**2
    groups = [slice(0, 1), *(slice(1 + 2 * i, 3 + 2 * i) for i in range(len(orders)))]
    spreads = [
        covariance[group, group] * _between(values[:, group] - mean[group], [fit[1][group, group] for fit in fits])
        for group in groups
    ]
    return _Side(
        float(mean[0]),
        float(spreads[0][0, 0]),
        mean[1:].reshape(-1, 2),
        np.array(spreads[1:]),
        np.concatenate([fit[2] for fit in fits]),
        sum(fit[2].size - values.shape[1] for fit in fits),
    )


def _alone(run: CoggingRun, orders: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the constant and the cos and sin coefficients of one run, their covariance, and the residual."""
    angle = 2.0 * np.pi * np.outer(run.turns, orders)
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(run.turns.size, -1)
    columns = np.column_stack([np.ones(run.turns.size), waves])
    values = np.linalg.lstsq(columns, run.force, rcond=None)[0]
    residual = run.force - columns @ values
    along = residual[np.argsort(run.turns)]
    rho = max(0.0, float(along[1:] @ along[:-1]) / (float(along @ along) or 1.0))
    # (1 + rho)/(1 - rho): spectral density at low frequency of a first-order process over its variance. It serves for
    # all orders, since the fit removed the noise at the orders themselves
    return values, ols_covariance(columns, residual) * (1.0 + rho) / (1.0 - min(rho, 0.95)), residual


def _between(off: np.ndarray, spreads: Sequence[np.ndarray]) -> float:
    """Return the ratio of the variance between runs to that predicted by the errors of the fits, at least 1."""
    count, width = off.shape
    if count < 2:
        return 1.0
    statistic = sum(float(row @ np.linalg.pinv(spread) @ row) for row, spread in zip(off, spreads, strict=True))
    return max(1.0, statistic / (width * (count - 1)))


def _order(n: int, place: int, sides: Mapping[int, _Side], unit: str, tried: int) -> CoggingOrder:
    """Return a harmonic with its amplitudes by direction and its significance."""
    # scipy.stats has the same function, but takes a second to import
    from scipy.special import fdtrc

    pairs = {sign: side.pairs[place] for sign, side in sides.items()}
    spreads = {sign: side.spreads[place] for sign, side in sides.items()}
    statistic = sum(float(pairs[sign] @ np.linalg.pinv(spreads[sign]) @ pairs[sign]) for sign in sides)
    width, freedom = 2 * len(sides), sum(side.freedom for side in sides.values())
    p_value = float(fdtrc(width, freedom, statistic / width))
    forward = _amplitude("forward", pairs[1], spreads[1], unit) if 1 in sides else None
    backward = _amplitude("backward", pairs[-1], spreads[-1], unit) if -1 in sides else None
    even = odd = None
    phase = 0.0
    if forward is not None and backward is not None:
        # the noise of the two directions is independent, so that their covariances add
        spread = 0.25 * (spreads[1] + spreads[-1])
        even = _amplitude("even", 0.5 * (pairs[1] + pairs[-1]), spread, unit)
        odd = _amplitude("odd", 0.5 * (pairs[1] - pairs[-1]), spread, unit)
        phase = _phase(0.5 * (pairs[1] + pairs[-1]))
    shown = pairs[1] if 1 in sides else pairs[-1]
    return CoggingOrder(n, even, phase, odd, forward, backward, _phase(shown), p_value, p_value < RISK / tried)


def _amplitude(name: str, pair: np.ndarray, spread: np.ndarray, unit: str) -> Estimate:
    """Return the amplitude √(a² + b²) with its standard error."""
    size = float(np.hypot(*pair))
    along = pair / (size or 1.0)
    error = float(np.sqrt(along @ spread @ along))
    return Estimate(name, size, unit, error, error)


def _phase(pair: np.ndarray) -> float:
    """Return the phase φ of a cos + b sin = A sin(angle + φ)."""
    return float(np.arctan2(pair[0], pair[1]))


def _remarks(orders: Sequence[CoggingOrder], both: bool) -> tuple[str, ...]:
    if not both:
        return (
            "all runs go one way: friction is in the offset, and friction that varies along the travel in the "
            "harmonics; record next the same travel the other way",
        )
    flipped = [
        order.order
        for order in orders
        if order.significant
        and order.even is not None
        and order.odd is not None
        and order.odd.value > order.even.value
        and order.amplitude > 0.05 * orders[0].amplitude
    ]
    if not flipped:
        return ()
    listed = ", ".join(map(str, flipped))
    return (
        f"order {listed}: changes its sign with the direction of motion, so it is not cogging but friction that "
        "varies along the travel, or an offset of the measured current; a compensation by position must also know "
        "the direction",
    )


# share of a run's steps that must go in its direction: noise and vibration at low speed turn single ones back
_ONE_WAY = 0.98
_TURN = 0.02  # share of the whole travel by which a position must come back to be a reversal
_END = 0.005  # share of a pass that is cut off at its ends, with the rows that stand still there
_WHOLE = 0.95  # of a period: least length of a pass
# rows that are kept per wave of the highest order: averaging over 1/32 of a wave reduces its amplitude by 0.2 %
_FINE = 32


@dataclass(frozen=True, eq=False)
class CoggingRun:
    """A run in one direction: position in turns (or in periods of the cogging) and motor force, shape (n,).

    direction is +1 for a run towards larger positions, otherwise -1; by default it follows from the positions. Outliers
    of the force (`regression.strays`) are left out; `remarks` lists them.
    """

    turns: np.ndarray
    force: np.ndarray
    direction: int = 0
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        turns, force = np.asarray(self.turns, dtype=np.float64), np.asarray(self.force, dtype=np.float64)
        if turns.ndim != 1 or turns.shape != force.shape:
            raise LogError(f"a cogging run needs one force for each position, not {force.shape} for {turns.shape}")
        if not (np.all(np.isfinite(turns)) and np.all(np.isfinite(force))):
            bad = int(np.argmin(np.isfinite(turns) & np.isfinite(force)))
            raise LogError(f"a cogging run is not finite at row {bad + 1}; cut it there")
        direction = self.direction
        if direction == 0:
            steps = np.diff(turns)
            steps = steps[np.abs(steps) > 0.0]
            share = float(np.mean(steps > 0.0)) if steps.size else 0.5
            if 1.0 - _ONE_WAY < share < _ONE_WAY:
                raise NotIdentifiableError(
                    f"a cogging run goes both ways ({Quantity(share, 'share'):3} of its steps forward): friction "
                    "changes its sign within it; cut it into runs of one direction, or state `direction`"
                )
            direction = 1 if share > 0.5 else -1
        if direction not in (-1, 1):
            raise ParameterError(f"direction = {direction} must be 1 or -1")
        far = strays(force)
        remarks = (*self.remarks, *stray_remarks("a cogging run, force", force, far, ""))
        turns, force = turns[~far], force[~far]
        for name, value in (("turns", turns), ("force", force), ("direction", direction), ("remarks", remarks)):
            object.__setattr__(self, name, value)


def cogging_passes(
    turns: np.ndarray, force: np.ndarray, *, highest: int = 128, name: str = "the log"
) -> tuple[CoggingRun, ...]:
    """Split a log of position (in periods) and force, both of shape (n,), into unidirectional passes.

    A position that wraps after each period is unwrapped.  The log is split at reversals; passes shorter than 95 % of a
    period are left out, as is 0.5 % of the travel at each end of a pass, where the axis accelerates or stands still. A
    long pass is reduced, by averaging, to 32 rows per wavelength of the order `highest`.
    Raises LogError for numbers that are not finite, NotIdentifiableError if no pass covers a period.
    """
    turns, force = np.asarray(turns, dtype=np.float64), np.asarray(force, dtype=np.float64)
    if turns.shape != force.shape or turns.ndim != 1 or turns.size < 2:
        raise LogError(f"a log of cogging needs one force for each position, not {force.shape} for {turns.shape}")
    if not (np.all(np.isfinite(turns)) and np.all(np.isfinite(force))):
        bad = int(np.argmin(np.isfinite(turns) & np.isfinite(force)))
        raise LogError(f"a log of cogging is not finite at row {bad + 1}; cut it there")
    far = strays(force)
    remarks = stray_remarks(f"{name}, force", force, far, "")
    # unwrapped before strays of the force are removed: a gap could hide a wrap
    x, force = np.unwrap(turns, period=1.0)[~far], force[~far]
    runs: list[CoggingRun] = []
    longest = 0.0
    for begin, end in _passes(x):
        travel = float(x[end] - x[begin])
        longest = max(longest, abs(travel))
        if abs(travel) < _WHOLE:
            continue
        along = (x[begin : end + 1] - x[begin]) / travel
        inside = np.flatnonzero((along > _END) & (along < 1.0 - _END))
        rows = slice(begin + int(inside[0]), begin + int(inside[-1]) + 1)
        averaged = _averaged(x[rows], force[rows], highest)
        # outliers belong to the log and not to a pass: the first pass carries the remark for all
        runs.append(CoggingRun(*averaged, direction=1 if travel > 0.0 else -1, remarks=remarks if not runs else ()))
    if not runs:
        raise NotIdentifiableError(
            f"the longest stretch in one direction is {Quantity(longest):3} periods, and cogging needs a whole one: "
            "record next a whole period at low speed in both directions, or correct the period"
        )
    return tuple(runs)


def _passes(x: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield the first and last row of each pass between two reversals."""
    enough = _TURN * float(np.ptp(x))
    if enough == 0.0:
        return
    begin = far = 0
    way = 0
    for k in range(1, x.size):
        if way == 0:
            if abs(x[k] - x[begin]) > enough:
                way, far = (1 if x[k] > x[begin] else -1), k
        elif way * (x[k] - x[far]) > 0.0:
            far = k
        # hysteresis: noise and the vibration at low speed go back by less, and are no reversal
        elif way * (x[far] - x[k]) > enough:
            yield begin, far
            begin, far, way = far, k, -way
    if way:
        yield begin, far


def _averaged(x: np.ndarray, force: np.ndarray, highest: int) -> tuple[np.ndarray, np.ndarray]:
    """Average neighboring rows of a pass that has more than twice as many rows as the order `highest` requires."""
    needed = int(np.ceil(_FINE * highest * max(1.0, float(np.ptp(x)))))
    if x.size <= 2 * needed:
        return x, force
    edges = np.linspace(0, x.size, needed + 1).astype(int)
    count = np.diff(edges)
    return np.add.reduceat(x, edges[:-1]) / count, np.add.reduceat(force, edges[:-1]) / count
