"""Check of the clock and the scales of a log by a second source: another log, known values, or controller gains.

One log alone cannot show that its clock, its force or its lengths are wrong by a factor: the identified values are then
wrong by powers of that factor, and explain the log as well as the correct ones. If the stated sample time is s times,
the force k times and the position l times the true one,

    value found = value · s^t · k^f · l^n        for a value in N^f s^t m^n, such as a mass in N s²/m: s² k / l

so that two values of one quantity differ by a factor, and several quantities differ in a pattern that reveals the
cause. `causes_of` fits each single cause to the logarithms of these factors by weighted least squares:

    ln(found / known) = h λ + e,    h the exponents of the cause, λ the logarithm of its factor
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.identification.regression import SIGNIFICANT
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined

CLOCK, FORCE, LENGTH, LOAD = "clock", "force", "length", "load"
MASS = "mass"  # the name of the moving mass or inertia among the values

# exponents of force, time and length in the unit of a value; a torque counts as force, an angle as length
_POWERS = {
    "": (0, 0, 0),
    "kg": (1, 2, -1),
    "kg m2": (1, 2, -1),
    "N": (1, 0, 0),
    "N m": (1, 0, 0),
    "N s/m": (1, 1, -1),
    "N m s/rad": (1, 1, -1),
    "N/m": (1, 0, -1),
    "N m/rad": (1, 0, -1),
    "N/m/s": (1, -1, -1),
    "N m/rad/s": (1, -1, -1),
    "1/s": (0, -1, 0),
    "s": (0, 1, 0),
    "m/s": (0, -1, 1),
    "rad/s": (0, -1, 1),
}
_PLACES = {FORCE: 0, CLOCK: 1, LENGTH: 2}

# shares by which a value may differ between two sources without a cause, as one standard deviation
SLACK_MASS = 0.01  # inverse dynamics and closed loop of one log differ by as much (EMPS: 94.5 and 95.3 kg)
SLACK_FRICTION = 0.1  # friction changes by 10 % with temperature and lubrication
SLACK_GAIN = 0.003  # a gain that is found in a log is right to 0.3 % nine times in ten
# smallest factor that is reported as a cause: it makes a mass 2 % wrong if it is of the clock, less than what two
# models of one log differ by if it is of anything else
LEAST_FACTOR = 0.01
_CHANCE = 0.01  # of what a cause leaves: below this probability by chance it is not the cause


@dataclass(frozen=True)
class Ratio:
    """The ratio of a value identified from a log to the same value from a second source.

    log     natural logarithm of found / known
    error   its standard error, including the usual variation of the quantity (`SLACK_...`)
    """

    name: str
    unit: str
    log: float
    error: float

    @classmethod
    def of(cls, name: str, unit: str, found: float, known: float, error: float = 0.0) -> Ratio | None:
        """Return the ratio of two values; None for a unit that reveals no cause, and for values that are not positive.

        error  relative standard error of found / known, without the usual variation of the quantity
        """
        if unit not in _POWERS or not (found > 0.0 and known > 0.0 and math.isfinite(error)):
            return None
        if name == MASS:
            slack = SLACK_MASS
        elif name.startswith(("viscous", "coulomb")):
            slack = SLACK_FRICTION
        else:
            slack = SLACK_GAIN
        return cls(name, unit, math.log(found / known), math.hypot(error, slack))

    def power(self, kind: str) -> float:
        """Return the exponent with which this value depends on the factor of a cause."""
        if kind == LOAD:
            return 1.0 if self.name == MASS else 0.0
        return float(_POWERS[self.unit][_PLACES[kind]])


@dataclass(frozen=True)
class Cause:
    """A single factor that explains all ratios: of the sample time, the force, the length, or the moving mass.

    error   standard error of the factor
    shown   names of the values that depend on this factor
    """

    kind: str
    factor: float
    error: float
    shown: tuple[str, ...]

    @property
    def off(self) -> Quantity:
        """The relative deviation of the factor from 1."""
        return Quantity(abs(self.factor - 1.0), "share", form="2")


def causes_of(ratios: Iterable[Ratio | None]) -> tuple[Cause, ...]:
    """Return the causes that each explain all ratios alone, the best first; empty for ratios near 1.

    The factor of a cause must deviate from 1 by more than `SIGNIFICANT` standard errors and by `LEAST_FACTOR`, and its
    residual must be explicable by chance.
    """
    there = [ratio for ratio in ratios if ratio is not None]
    if not there:
        return ()
    from scipy.special import chdtrc  # takes a second to import

    logs = np.array([ratio.log for ratio in there])
    weights = np.array([ratio.error for ratio in there]) ** -2
    fits: list[tuple[float, Cause]] = []
    for kind in (CLOCK, FORCE, LENGTH, LOAD):
        h = np.array([ratio.power(kind) for ratio in there])
        information = float(weights @ (h * h))
        if information == 0.0:
            continue
        size, error = float(weights @ (h * logs)) / information, information**-0.5
        left = float(weights @ (logs - size * h) ** 2)
        by_chance = float(chdtrc(len(there) - 1, left)) if len(there) > 1 else 1.0
        factor = math.exp(size)
        if abs(size) > SIGNIFICANT * error and abs(factor - 1.0) > LEAST_FACTOR and by_chance > _CHANCE:
            shown = tuple(ratio.name for ratio, power in zip(there, h, strict=True) if power)
            fits.append((left, Cause(kind, factor, factor * error, shown)))
    return tuple(cause for _, cause in sorted(fits, key=lambda fit: fit[0]))


def said(causes: Sequence[Cause], name: str, sample_time: float, other: str = "") -> Text:
    """Return text on the meaning of each cause for the log `name`, and the option that corrects it.

    other  name of the log used for comparison; empty if the second source is certain, such as a weighed mass
    """
    return joined("; or ", (_said(cause, name, sample_time, other) for cause in causes))


def _said(cause: Cause, name: str, T: float, other: str) -> Text:
    larger = cause.factor > 1.0
    inverse = number(1.0 / cause.factor)
    also = f", or that of '{other}' {inverse} times" if other else ""
    if cause.kind == CLOCK:
        ways = ("long", "short") if larger else ("short", "long")
        also = f", or that of '{other}' as much too {ways[1]}" if other else ""
        return Text(
            f"the sample time of '{name}' is stated {cause.off} too {ways[0]}, {Quantity(T, 's', form='4')} in place "
            f"of {Quantity(T / cause.factor, 's', form='4')}{also} (correct a clock with --time 'column*{inverse}:s', "
            "or with --sample-time if the log has no stamps)"
        )
    if cause.kind == FORCE:
        return Text(
            f"the force of '{name}' is read {number(cause.factor)} times as large as it is{also} (another rated "
            f"value, torque constant or unit, as A for N: --rated, --torque-constant, or --force 'column*{inverse}')"
        )
    if cause.kind == LENGTH:
        return Text(
            f"the position of '{name}' is read {number(cause.factor)} times as large as it is{also} (another lead, "
            f"gear or count: --lead, --gear, or --position 'column*{inverse}')"
        )
    than = f"than in '{other}'" if other else "than is stated"
    more = "more" if larger else "less"
    return Text(f"{cause.off} {more} mass moves in '{name}' {than}, as with another workpiece or fixture")
