"""Scaling all gains of a controller by one factor: a faster or slower loop, and the largest gains versus dead time."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.analysis.stiffness import Robustness, robustness
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Column, Result, Table
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.filters import HIGHEST
from feeddrive.tuning.tune import own_tunables, speeds

_INSIDE = 1e-9  # relative distance to an open bound


def speed_powers(control: Control) -> Mapping[str, float]:
    """Return the nonzero exponents of the tunables, by name, when the bandwidth is scaled by a factor w.

    The tunables are those of law, observers and compensations. A rate in 1/s, rad/s or Hz scales with w, a velocity
    gain in N s/m with w, a stiffness in N/m with w², an integral time in s with 1/w. For a free mass the loop gain is
    then stretched in frequency, L(jω; w) = L(jω/w; 1): every crossover is scaled by w and every margin is unchanged, as
    long as dead time and sampling are negligible. Filters, axis models and feedforward depend on the axis and are not
    scaled.
    """
    names = own_tunables(control)
    powers = zip(names, speeds(control, names), strict=True)
    return {name: float(power) for name, power in powers if power != 0.0}


def quickened(control: Control, factor: float) -> Mapping[str, float]:
    """Return the tunables of `speed_powers`, by name and in SI, for a bandwidth scaled by a factor > 0.

    Raises ParameterError if there is no such tunable, if the factor is not finite and > 0, and if a value overflows.
    """
    if not (factor > 0.0 and math.isfinite(factor)):
        raise ParameterError(f"a loop is made faster by a finite factor > 0, not {number(factor, 6)}")
    powers = speed_powers(control)
    if not powers:
        raise ParameterError(
            f"the law '{control.law.kind}' has no number that is a rate or a gain with a unit, which could be scaled: "
            f"move its numbers one by one"
        )
    try:
        return {name: float(tree.get(control, name)) * factor**power for name, power in powers.items()}
    except (OverflowError, ZeroDivisionError):
        raise ParameterError(
            f"a loop cannot be made {number(factor, 3)} times as fast: take a factor nearer to 1"
        ) from None


def speed_range(control: Control, sample_time: float) -> tuple[float, float]:
    """Return the smallest and the largest factor for `quickened` with which all tunables stay within bounds.

    Frequencies in Hz must also stay below 0.49 times the sample rate, 1/`sample_time`.
    """
    low, high = 0.0, math.inf
    for name, power in speed_powers(control).items():
        declared, value = tree.declaration(control, name), float(tree.get(control, name))
        least = max(filter(None, (declared.least, declared.above)), default=0.0) * (1.0 + _INSIDE)
        most = min((bound for bound in (declared.most, declared.below) if bound is not None), default=math.inf)
        if declared.unit == "Hz":
            most = min(most, HIGHEST / sample_time)
        if not value > 0.0:
            continue
        ends = sorted(
            (end / value) ** (1.0 / power) if end > 0.0 else (0.0 if power > 0.0 else math.inf)
            for end in (least, most * (1.0 - _INSIDE))
        )
        low, high = max(low, ends[0]), min(high, ends[1])
    return low, high


_CLOSE = 1e-5  # of a factor: tolerance of the bisection
_FARTHEST = 40  # doublings in the search for a bound


@dataclass(frozen=True, eq=False, repr=False)
class DelayMap(Result):
    """The largest common factor on some tunables, as a function of the dead time (s); all arrays have shape (n,).

    edge     factor at the stability limit
    robust   factor at which Ms reaches `sensitivity_bound`
    tunables    values at a factor of 1, by dotted name; the factor divides times (in s) and multiplies all others
    """

    dead_time: np.ndarray
    edge: np.ndarray
    robust: np.ndarray
    tunables: Mapping[str, float]
    sensitivity_bound: float
    sample_time: float

    def at_edge(self, name: str) -> np.ndarray:
        """Return the values of a tunable at the stability limit; it must be one that the factor multiplies."""
        return self.edge * self.tunables[name]

    def at_robust(self, name: str) -> np.ndarray:
        """Return the values of a tunable where Ms reaches its bound; it must be one that the factor multiplies."""
        return self.robust * self.tunables[name]

    def table(self) -> Table:
        """Tabulate both factors, one row per dead time."""
        samples = self.dead_time / self.sample_time
        rows = np.column_stack([self.dead_time, samples, self.edge, self.robust]).tolist()
        named = ", ".join(f"{name.rpartition('.')[2]} {number(value)}" for name, value in self.tunables.items())
        robust = f"Ms <= {number(self.sensitivity_bound, 6)} up to"
        columns = [Column("dead time", "s"), Column("samples", form="3"), "unstable above", robust]
        return Table(f"factor of {named}", columns, rows)


def delay_map(
    loop: Loop,
    tunables: Sequence[str],
    dead_times: Sequence[float],
    *,
    sensitivity_bound: float = 2.0,
    velocity: float = 0.05,
) -> DelayMap:
    """Return, for each dead time in s, the largest gains for stability and for Ms <= `sensitivity_bound`.

    tunables  paths of parameters that are scaled together, such as `axis.x.control.law.Kp`

    For the laws of this library on rigid axes, the stable gains form a single interval, and the map shows its upper
    end. Gains that a law rejects count as unstable.
    Raises ParameterError if no factor within 2⁴⁰ of 1 is stable, or if all such factors are stable.
    """
    values = {name: float(tree.get(loop, name)) for name in tunables}
    times = {name for name in tunables if tree.declaration(loop, name).unit == "s"}
    delay = tree.path_of(loop, "axis.actuator.dead_time")
    edges, robusts = [], []
    for dead_time in dead_times:

        def judged(factor: float, dead_time: float = dead_time) -> Robustness:
            changed = {name: value / factor if name in times else value * factor for name, value in values.items()}
            try:
                return robustness(tree.vary(loop, {**changed, delay: dead_time}), velocity=velocity)
            except FeeddriveError:
                return Robustness(float("inf"))

        edge = _largest(lambda factor: judged(factor).stable, dead_time)
        robusts.append(_largest(lambda factor: judged(factor).sensitivity_peak <= sensitivity_bound, dead_time))
        edges.append(edge)
    return DelayMap(
        np.asarray(dead_times, dtype=np.float64),
        np.array(edges),
        np.array(robusts),
        values,
        sensitivity_bound,
        float(loop.sample_time),
    )


def _largest(admits: Callable[[float], bool], dead_time: float) -> float:
    """Return the largest factor that `admits` accepts, found by doubling and bisection from 1."""
    low, high = 1.0, 1.0
    if admits(1.0):
        high = next((2.0**i for i in range(1, _FARTHEST) if not admits(2.0**i)), float("inf"))
        low = 0.5 * high
    else:
        low = next((0.5**i for i in range(1, _FARTHEST) if admits(0.5**i)), 0.0)
        high = 2.0 * low
    if not 0.0 < low < high < float("inf"):
        raise ParameterError(
            f"with a dead time of {Quantity(dead_time, 's'):6 SI} no bound lies within a factor of 2^{_FARTHEST} of "
            "the tunables: start from gains with which the loop is stable, and name tunables that bring it to the "
            "edge of stability"
        )
    while high > low * (1.0 + _CLOSE):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if admits(middle) else (low, middle)
    return low
