"""The signals from which a control law computes its command, as columns of a least-squares problem."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self

import numpy as np

from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.regression import median_spread

MOST_DELAY = 3  # samples between reading and command that are tried
MOST_SAMPLES = 8  # over which a velocity may be computed by differences
_AHEAD, _PAST = 2, 7  # samples that a column may use after row k, and of the set position before it
_CHANGES = MOST_SAMPLES + MOST_DELAY + 2  # past changes of the reading that a column may use
_SIGNS = range(-1, MOST_DELAY + 2)  # samples by which the direction of the set motion may be older than row k
_SKIP = 0.2  # s at the start: the filters and models of the law hold a past there that the log does not show
_SHORT = 40  # rows: a shorter stretch between two limits would be spent on its own constant
_SETTLED = 0.05  # s: of a rest that still tell how motion ends
_STARTING = 0.05  # s: of a rest that already tell how motion begins
_STILL = 1e-6  # of the largest set speed, up to which a set position rests: the rounding of a file
_HELD = 1e-3  # of the largest force, within which successive samples are at the limit: the rounding of a log
_BEFORE, _AFTER = 2, 6  # rows around a limit that are left out with it: filters and differences reach across its edge


_MEDIAN, _NOISE = 15, 4.0  # samples and standard deviations with which a noisy plateau of the command is found
_WARM = 500  # samples that pass through the filters before the rows of a search that takes fewer
_OVER = 2.5  # samples of the slow rows in a period of the highest frequency, which lets half of it pass
_KERNEL = 6  # slow samples over which their low pass reaches
_STOPPED = 7.0  # shape of its Kaiser window: a thousandth and less is left from 2.5 times the highest frequency on


class Term(NamedTuple):
    """A regressor of a control law: its coefficients on the basis columns of `LawRows`."""

    on: np.ndarray

    def __add__(self, other: Term) -> Term:  # type: ignore[override]
        return Term(self.on + other.on)

    def __sub__(self, other: Term) -> Term:
        return Term(self.on - other.on)

    def __rmul__(self, factor: float) -> Term:  # type: ignore[override]
        return Term(factor * self.on)


class Twist(NamedTuple):
    """The lead of the motor read by the law over the logged load, compliance (a - loss da/dt), a the load acceleration.

    compliance  m_load/k, s2
    loss        damping over stiffness, d/k, s
    """

    compliance: float = 0.0
    loss: float = 0.0


STIFF = Twist()


class Basis:
    """The basis columns of a log by name, and the regressors of a control law as sums of them.

        e = x_set - x,   Se = T Σ e,   dx(j) = x(k-j) - x(k-j-1),   ds(j) = x_set(k-j) - x_set(k-j-1)

    Differences instead of positions avoid a loss of digits: an acceleration times T² is about a millionth of the
    travel. The reading in a regressor is d samples old, its setpoint d + q samples.
    """

    def __init__(self, T: float) -> None:
        self.T = T
        names = ["e", "Se", "s", "t"]
        names += [f"dx{j}" for j in range(-_AHEAD, _CHANGES)]
        names += [f"ds{j}" for j in range(-_AHEAD, _PAST)]
        names += [f"sign{j}" for j in _SIGNS] + [f"moves{j}" for j in _SIGNS]
        self.names = names
        self._place = {name: k for k, name in enumerate(names)}

    @property
    def size(self) -> int:
        """The number of basis columns."""
        return len(self.names)

    @property
    def motion(self) -> np.ndarray:
        """The indices of the columns that do not depend on the direction of the set motion."""
        return np.array([k for k, name in enumerate(self.names) if not name.startswith(("sign", "moves"))])

    @property
    def reading_places(self) -> np.ndarray:
        """The places of the columns that make the reading and its velocity, for no delay and more."""
        past = {f"dx{j}" for j in range(_CHANGES)}
        return np.array([k for k, name in enumerate(self.names) if name in ("e", "s") or name in past])

    def zero(self) -> Term:
        """Return the zero regressor."""
        return Term(np.zeros(self.size))

    def one(self, name: str) -> Term:
        """Return a basis column as a regressor."""
        on = np.zeros(self.size)
        on[self._place[name]] = 1.0
        return Term(on)

    def many(self, kind: str, begin: int, end: int) -> Term:
        """Return the sum of the changes `begin` to `end` - 1 of the reading ("dx") or the set position ("ds")."""
        on = np.zeros(self.size)
        for j in range(begin, end):
            on[self._place[f"{kind}{j}"]] = 1.0
        return Term(on)

    def set_position(self, d: int) -> Term:
        """Return x_set(k-d)."""
        return self.one("s") - self.many("ds", 0, d)

    def error(self, d: int, q: int = 0, twist: Twist = STIFF) -> Term:
        """Return x_set(k-d-q) - x(k-d)."""
        error = self.one("e") - self.many("ds", 0, d + q) + self.many("dx", 0, d)
        return error - self._ahead(d, twist) if twist.compliance else error

    def error_sum(self, d: int, q: int = 0, twist: Twist = STIFF) -> Term:
        """Return T Σ e up to k-d."""
        total = self.one("Se") - self.T * float(q) * self.set_position(d)
        for i in range(d):
            total = total - self.T * self.error(i)
        if twist.compliance:
            speed, rise = self.one(f"dx{d - 1}"), 0.5 * (self.one(f"dx{d - 2}") - self.one(f"dx{d}"))
            total = total - (twist.compliance / self.T) * (speed - (twist.loss / self.T) * rise)
        return total

    def reading(self, d: int) -> Term:
        """Return x(k-d)."""
        return self.set_position(d) - self.error(d)

    def velocity(self, n: int, d: int, twist: Twist = STIFF) -> Term:
        """Return (x(k-d) - x(k-d-n)) / nT."""
        total = (1.0 / (n * self.T)) * self.many("dx", d, d + n)
        if twist.compliance:
            total = total + (1.0 / (n * self.T)) * (self._ahead(d, twist) - self._ahead(d + n, twist))
        return total

    def travel(self, n: int, d: int, twist: Twist = STIFF) -> Term:
        """Return T Σ of `velocity`, which is the mean of n readings up to a constant."""
        total = self.reading(d)
        for j in range(n - 1):
            total = total - ((n - 1.0 - j) / n) * self.one(f"dx{d + j}")
        if twist.compliance:
            # the sums of both ends telescope
            new, old = (
                self.one(f"dx{j - 1}") - (twist.loss / self.T) * (0.5 * (self.one(f"dx{j - 2}") - self.one(f"dx{j}")))
                for j in (d, d + n)
            )
            total = total + (twist.compliance / (n * self.T**2)) * (new - old)
        return total

    def _bend(self, d: int) -> Term:
        """Return the acceleration of the reading at k-d."""
        return (1.0 / self.T**2) * (self.one(f"dx{d - 1}") - self.one(f"dx{d}"))

    def _ahead(self, d: int, twist: Twist) -> Term:
        """Return the lead of a motor over its load at k-d: compliance (a - loss da/dt)."""
        rise = (0.5 / self.T) * (self._bend(d - 1) - self._bend(d + 1))
        return twist.compliance * (self._bend(d) - twist.loss * rise)

    def set_velocity(self, d: int, *, central: bool) -> Term:
        """Return the set velocity as a backward or a central difference; the latter is the velocity of the planner."""
        if central:
            return (0.5 / self.T) * self.many("ds", d - 1, d + 1)
        return (1.0 / self.T) * self.one(f"ds{d}")

    def set_travel(self, d: int, *, central: bool) -> Term:
        """Return T Σ of `set_velocity`."""
        position = self.set_position(d)
        return position + 0.5 * self.one(f"ds{d - 1}") if central else position

    def set_acceleration(self, d: int, when: str) -> Term:
        """Return the second difference of the set position that ends at k-d ("backward"), is centered at k-d
        ("central"), or is centered in the middle of the following sample interval ("middle").
        """
        if when == "middle":
            return 0.5 * (self.set_acceleration(d - 1, "central") + self.set_acceleration(d, "central"))
        newest = d if when == "backward" else d - 1
        return (1.0 / self.T**2) * (self.one(f"ds{newest}") - self.one(f"ds{newest + 1}"))


class Reduced(NamedTuple):
    """A least-squares problem reduced to its triangular factor, with the same solutions and sums of squares.

    factor  basis columns, shape (p + 1, p)
    right   force, shape (p + 1,)
    """

    factor: np.ndarray
    right: np.ndarray

    @property
    def power(self) -> float:
        """The sum of squares of the force, without its mean over each stretch."""
        return float(self.right @ self.right)

    def rest(self) -> float:
        """Return the residual sum of squares of a fit of all basis columns."""
        return float(self.right[-1] ** 2)


@dataclass(frozen=True, eq=False)
class LawRows:
    """The rows of a log that a control law must explain.

    columns  basis columns, each without its mean over a stretch, shape (rows, basis)
    whole    basis columns over the whole log, for filters, shape (samples, basis)
    force    force without its mean over a stretch, shape (rows,)
    starts   first row of each stretch
    places   sample indices of the rows in the log, shape (rows,)
    kernel   weights of a low pass without phase that all columns have passed; one weight for none
    step     samples between two rows

    The constant of each stretch between two saturations absorbs the unknown initial value of an integral, a weight, and
    the effect of any anti-windup, which need not be modeled.
    """

    basis: Basis
    columns: np.ndarray
    whole: np.ndarray
    force: np.ndarray
    starts: np.ndarray
    places: np.ndarray
    raw: Signals
    kernel: np.ndarray = field(default_factory=lambda: np.ones(1))
    step: int = 1

    @classmethod
    def of(cls, signals: Signals, keep: np.ndarray) -> Self:
        """Return the rows in `keep`, shape (samples,), without the start of the log and without short stretches."""
        basis = Basis(signals.T)
        first = max(round(_SKIP / signals.T), _CHANGES + 2)
        keep = keep.copy()
        keep[:first] = False
        keep[keep.size - _AHEAD :] = False
        edges = np.flatnonzero(np.diff(np.concatenate([[0], keep.astype(np.int8), [0]])))
        runs = [(b, e) for b, e in zip(edges[::2], edges[1::2], strict=True) if e - b >= _SHORT]
        places = np.concatenate([np.arange(b, e) for b, e in runs]) if runs else np.zeros(0, dtype=np.int64)
        starts = np.cumsum([0, *(e - b for b, e in runs)])[:-1]
        whole = signals.basis(basis)
        made = cls(basis, whole[places], whole, signals.force[places], starts, places, signals)
        return replace(made, columns=made.centered(made.columns), force=made.centered(made.force))

    def fewer(self, most: int) -> LawRows:
        """Return the block of at most `most` successive rows with the largest changes of force.

        Filters then run only over these rows and a short warm-up before them.
        """
        total = self.force.size
        if total <= most:
            return self
        power = np.cumsum(np.diff(self.force, prepend=self.force[0]) ** 2)
        first = int(np.argmax(power[most:] - power[:-most]))
        chosen = slice(first, first + most)
        inside = self.starts[(self.starts > first) & (self.starts < first + most)] - first
        # the filters forget their start before the first row
        begin = max(0, int(self.places[first]) - _WARM)
        end = int(self.places[first + most - 1]) + 1
        made = replace(
            self,
            force=self.force[chosen],
            starts=np.concatenate([[0], inside]),
            places=self.places[chosen] - begin,
            whole=self.whole[begin:end],
            raw=self.raw.part(begin, end),
        )
        return replace(made, columns=made.centered(self.columns[chosen]), force=made.centered(made.force))

    def signed(self, signals: Signals) -> LawRows:
        """Return the rows with the direction of the set motion smoothed as in `signals`; all else is unchanged."""
        whole, columns = self.whole.copy(), self.columns.copy()
        signs = [k for k, name in enumerate(self.basis.names) if name.startswith(("sign", "moves"))]
        whole[:, signs] = np.stack([signals.direction(self.basis.names[k]) for k in signs], axis=1)
        columns[:, signs] = self.taken(whole[:, signs])
        return replace(self, whole=whole, columns=columns, raw=signals)

    def with_other_set_positions(self) -> Iterator[LawRows]:
        """Yield the rows with each of the set positions that are as likely."""
        for wanted in self.raw.others:
            signals = replace(self.raw, wanted=wanted, others=())
            whole = signals.basis(self.basis)
            yield replace(self, whole=whole, columns=self.taken(whole), raw=signals)

    def centered(self, values: np.ndarray) -> np.ndarray:
        """Return values without their mean over each stretch."""
        if not self.starts.size:
            return values
        lengths = np.diff(np.append(self.starts, values.shape[0]))
        shape = (-1,) + (1,) * (values.ndim - 1)
        means = np.add.reduceat(values, self.starts, axis=0) / lengths.reshape(shape)
        return values - np.repeat(means, lengths, axis=0)

    def slow(self, highest: float) -> LawRows:
        """Return the rows of the low-passed log: of all signals what is slower than about `highest` (Hz).

        A law of the log is a law of these rows, too, as one filter is before all columns and the force. Counts and the
        noise of differences are fast. Rows near the end of a stretch, which the filter reaches beyond, are left out.
        """
        from scipy.signal import firwin  # takes a second to import

        step = int(1.0 / (_OVER * highest * self.raw.T))
        if step < 2:
            return self
        half, samples = _KERNEL // 2 * step, self.whole.shape[0]
        window: Any = ("kaiser", _STOPPED)
        kernel = firwin(2 * half + 1, highest, window=window, fs=1.0 / self.raw.T)
        kept = np.zeros(samples + 1)
        kept[self.places + 1] = 1.0
        inside = np.cumsum(kept)
        centers = np.arange(half, samples - half, step)
        centers = centers[inside[centers + half + 1] - inside[centers - half] == 2 * half + 1]
        starts = np.flatnonzero(np.diff(centers, prepend=-samples) > step)
        made = replace(self, places=centers, starts=starts, kernel=kernel, step=step)
        return replace(made, columns=made.taken(self.whole), force=made.taken(self.raw.force))

    def without(self, rows: np.ndarray) -> LawRows:
        """Return slow rows but for some of them, (rows,) of bool: none needs its neighbours."""
        starts = np.zeros(self.places.size, bool)
        starts[self.starts] = True
        of = np.cumsum(starts)[~rows]
        made = replace(self, places=self.places[~rows], starts=np.flatnonzero(np.diff(of, prepend=0)))
        return replace(made, columns=made.taken(self.whole), force=made.taken(self.raw.force))

    def taken(self, whole: np.ndarray) -> np.ndarray:
        """Return whole-log values, shape (samples,) or (samples, p), in the rows, without their means."""
        if self.step == 1:
            return self.centered(whole[self.places])
        from scipy.signal import upfirdn  # takes a second to import

        half = self.kernel.size // 2
        # the filter begins at the first sample, half of its length before the row at which its first value counts
        passed = upfirdn(self.kernel, whole - whole[0], down=self.step, axis=0)
        return self.centered(np.asarray(passed)[(self.places + half) // self.step])

    def reduced(self, rows: slice = slice(None), more: np.ndarray | None = None) -> Reduced:
        """Return the problem of some rows reduced to its triangular factor; `more` are additional columns."""
        columns = self.columns if more is None else np.hstack([self.columns, more])
        return reduced(columns[rows], self.force[rows])

    def at(self, terms: list[Term]) -> np.ndarray:
        """Return regressors over the rows, shape (rows, terms)."""
        return self.columns @ np.stack([term.on for term in terms], axis=1)


def reduced(columns: np.ndarray, force: np.ndarray) -> Reduced:
    """Return a problem reduced to the triangular factor of its columns and force."""
    both = np.column_stack([columns, force])
    # columns of unit size: a constant one (no motion in one direction) stays 0 and determines nothing
    factor = triangle(both)
    missing = factor.shape[1] - factor.shape[0]
    if missing > 0:
        factor = np.vstack([factor, np.zeros((missing, factor.shape[1]))])
    return Reduced(factor[:, :-1], factor[:, -1])


def triangle(columns: np.ndarray) -> np.ndarray:
    """Return the triangular factor R of columns = Q R."""
    return np.asarray(np.linalg.qr(columns, mode="r"))


@dataclass(frozen=True, eq=False)
class Signals:
    """The signals of a log: reading x and set position (m), command (N) and sample time (s).

    smoothing  velocity scale, m/s, over which the sign of the set velocity changes smoothly; 0: abruptly
    others     set positions that are as likely, if it was restored from a rounded one
    resting    set speed, m/s, up to which the axis is taken to rest: what a restored set position moves in a rest
    """

    x: np.ndarray
    wanted: np.ndarray
    force: np.ndarray
    T: float
    smoothing: float = 0.0
    others: tuple[np.ndarray, ...] = ()
    resting: float = 0.0

    @classmethod
    def of(cls, log: MotionLog) -> Self:
        """Return the signals of a log with set positions."""
        assert log.set_position is not None
        return cls(log.position, log.set_position, log.force, log.sample_time)

    def part(self, begin: int, end: int) -> Signals:
        """Return the samples `begin` to `end` - 1."""
        cut = slice(begin, end)
        others = tuple(other[cut] for other in self.others)
        return replace(self, x=self.x[cut], wanted=self.wanted[cut], force=self.force[cut], others=others)

    @property
    def fastest(self) -> float:
        """The largest set speed."""
        return float(np.max(np.abs(np.diff(self.wanted)))) / self.T

    def basis(self, basis: Basis) -> np.ndarray:
        """Return all basis columns over the whole log, shape (samples, basis)."""
        e = self.wanted - self.x
        changes = {"dx": np.diff(self.x, prepend=self.x[0]), "ds": np.diff(self.wanted, prepend=self.wanted[0])}
        out = np.empty((e.size, basis.size))
        for k, name in enumerate(basis.names):
            if name == "e":
                out[:, k] = e
            elif name == "Se":
                out[:, k] = self.T * np.cumsum(e)
            elif name == "s":
                out[:, k] = self.wanted
            elif name == "t":
                out[:, k] = self.T * np.arange(e.size)
            elif name.startswith(("sign", "moves")):
                out[:, k] = self.direction(name)
            else:
                out[:, k] = shifted(changes[name[:2]], int(name[2:]))
        return out

    def direction(self, name: str) -> np.ndarray:
        """Return the basis column of the direction of the set motion (sign) or of its absolute value (moves)."""
        v = np.diff(self.wanted, prepend=self.wanted[0]) / self.T
        sign = np.tanh(v / self.smoothing) if self.smoothing > 0.0 else np.sign(np.where(self._rests(v), 0.0, v))
        kind = name.rstrip("-0123456789")
        return shifted(np.abs(sign) if kind == "moves" else sign, int(name[len(kind) :]))

    def free(self, limit: float | None) -> np.ndarray:
        """Return a mask of the samples at which the command is not held at its limit.

        If the limit is unknown, the largest force is assumed to be the limit if successive samples reach it, since a
        law does not command two equal peaks.
        """
        most = float(np.max(np.abs(self.force))) if limit is None else min(limit, float(np.max(np.abs(self.force))))
        there = np.abs(self.force) >= (1.0 - _HELD) * most
        held = there & (np.roll(there, 1) | np.roll(there, -1)) if limit is None else there
        return ~widened(held)

    def between_rests(self) -> np.ndarray:
        """Return a mask of the samples that are not within a rest of the set motion.

        A motor that stands is up to half a count from its reading, and the integral of a law sums that: it is another
        constant before and after the rest.
        """
        still = self._rests(np.diff(self.wanted, prepend=self.wanted[0]) / self.T)
        after, before = round(_SETTLED / self.T), round(_STARTING / self.T)
        moves = np.concatenate([[0], np.cumsum(~still)])
        ends = np.arange(still.size)
        first, last = np.maximum(ends - after, 0), np.minimum(ends + before + 1, still.size)
        return moves[last] > moves[first]

    def _rests(self, v: np.ndarray) -> np.ndarray:
        """Return True where the set velocity is that of a rest."""
        return np.abs(v) < max(_STILL * float(np.max(np.abs(v))), self.resting)

    def below_plateau(self) -> np.ndarray:
        """Return a mask of the samples at which the command is below its highest plateau by more than the noise.

        The plateau is the maximum of the running median over 15 samples; samples within 4 standard deviations of it are
        left out.
        """
        from scipy.ndimage import median_filter  # takes a second to import

        middle = median_filter(self.force, _MEDIAN, mode="nearest")
        spread = median_spread(self.force - middle)
        most = float(np.max(np.abs(middle)))
        return ~widened(np.abs(self.force) > (1.0 - _HELD) * most - _NOISE * spread)


def widened(flags: np.ndarray, before: int = _BEFORE, after: int = _AFTER) -> np.ndarray:
    """Return flags that are also True in `before` rows before and `after` rows after each True one."""
    wide = flags.copy()
    for j in range(1, before + 1):
        wide[:-j] |= flags[j:]
    for j in range(1, after + 1):
        wide[j:] |= flags[:-j]
    return wide


def shifted(values: np.ndarray, samples: int) -> np.ndarray:
    """Return values delayed by a number of samples (negative: advanced), held at the ends."""
    if samples == 0:
        return values
    out = np.empty_like(values)
    if samples > 0:
        out[:samples], out[samples:] = values[0], values[:-samples]
    else:
        out[samples:], out[:samples] = values[-1], values[-samples:]
    return out


def filtered(rows: LawRows, coefficients: tuple[np.ndarray, np.ndarray], columns: np.ndarray) -> np.ndarray:
    """Return whole-log columns (samples, p), filtered from a steady state at their first values, in the rows."""
    from scipy.signal import lfilter, lfilter_zi  # takes a second to import

    b, a = coefficients
    initial: Any = lfilter_zi(b, a)
    values, _ = lfilter(b, a, columns, axis=0, zi=initial[:, None] * columns[:1])
    return rows.taken(np.asarray(values))


def halves(rows: LawRows, share: float) -> Iterator[slice]:
    """Yield the slice of the first `share` of the rows, then that of all other rows."""
    cut = round(share * rows.force.size)
    yield slice(0, cut)
    yield slice(cut, None)
