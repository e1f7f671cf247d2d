"""Closed-loop responses of a control at an operating point, with their derivatives and their measurement noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.tuning.control_response import Response
from feeddrive.tuning.operating_point import OperatingPoint

_DEEPEST, _LINES = 1e-3, 40  # of the first line: down to where, and with how many lines


class Recovery(NamedTuple):
    """Frequency, compliance and its slope to the tunables: what a rope-snap error is made of."""

    frequency: np.ndarray
    compliance: np.ndarray
    slope: np.ndarray


class Below:
    """The axis of a point below its first line f₁, as the free motion that it is there.

        X_load(f) = X_load(f₁) (f₁/f)²,    X_motor/X_load = 1 + ρ,  ρ(f) = ρ(f₁) (f/f₁)²
        y = X_d (1 + C_motor X_u (ρ_d - ρ_u)) / (1 + L),    L = -X_u (C_motor (1 + ρ_u) + C_load)

    u is the command, d the force on the table.  With integral action y is nearly 1/C, whatever the mass.  So this shows
    a law that takes long to come back, and serves for nothing else.
    """

    def __init__(self, point: OperatingPoint) -> None:
        first = point.frequency[0]
        self.frequency = first * np.geomspace(_DEEPEST, 1.0, _LINES, endpoint=False)
        down = (first / self.frequency) ** 2
        self.by_force, self.by_load = point.by_force[1, 0] * down, point.by_load[1, 0] * down
        self.apart_force, self.apart_load = (
            (each[0, 0] / each[1, 0] - 1.0) / down for each in (point.by_force, point.by_load)
        )

    def recovery(self, response: Response) -> Recovery:
        """The closed loop of a control, of which `response` is given on these lines."""
        (C, D), (dC, dD) = response.value, response.slope
        loop = -self.by_force * (C * (1.0 + self.apart_force) + D)
        dloop = -self.by_force[:, None] * (dC * (1.0 + self.apart_force)[:, None] + dD)
        twist = self.by_force * (self.apart_load - self.apart_force)
        S = 1.0 / (1.0 + loop)
        y = self.by_load * (1.0 + C * twist) * S
        return Recovery(self.frequency, y, (self.by_load * S * twist)[:, None] * dC - (y * S)[:, None] * dloop)


_LOWEST, _FEWEST = 2.5, 5  # lines up to so many times the first one, and at least so many, tell what integrates


@dataclass(frozen=True, eq=False)
class Answer:
    """The closed loop of a point on its lines, with slopes (lines, tunables) and variances (lines,).

    below   the compliance below the first line, with the axis as a free mass; None if not needed
    """

    point: OperatingPoint
    response: Response
    gain: np.ndarray
    gain_slope: np.ndarray
    gain_variance: np.ndarray
    compliance: np.ndarray
    compliance_slope: np.ndarray
    compliance_variance: np.ndarray
    below: Recovery | None = None

    def recovery(self) -> Recovery:
        """From far below the first line on."""
        own = Recovery(self.point.frequency, self.compliance, self.compliance_slope)
        if self.below is None:
            return own
        return Recovery(*(np.concatenate(pair) for pair in zip(self.below, own, strict=True)))


def answer(point: OperatingPoint, response: Response, below: Recovery | None = None) -> Answer:
    """L = -C·X_u and the compliance y = y_d + y_u (C·X_d)/(1 + L), with slopes, and variances to first order."""
    C, dC = response.value, response.slope
    xu, xd = point.by_force, point.by_load
    yu, yd = point.moved
    L = -np.einsum("kl,kl->l", C, xu)
    dL = -np.einsum("klp,kl->lp", dC, xu)
    back, dback = np.einsum("kl,kl->l", C, xd), np.einsum("klp,kl->lp", dC, xd)
    S = 1.0 / (1.0 + L)
    y = yd + yu * back * S
    dy = (yu * S)[:, None] * (dback - (back * S)[:, None] * dL)
    zero = np.zeros(point.frequency.size)
    gain_variance = zero if point.variance is None else _through(point, 0, C)
    return Answer(point, response, L, dL, gain_variance, y, dy, _of_compliance(point, C, back, S), below)


def _through(point: OperatingPoint, source: int, factors: np.ndarray) -> np.ndarray:
    """The variance of Σ factor · reading of one source (0: the command, 1: a force on the table).

    Where the motor's reading is the load's times a ratio, they have one error; elsewhere they count as independent.
    """
    variance = (point.variance, point.load_variance)[source]
    assert variance is not None
    found = np.einsum("kl,kl->l", np.abs(factors) ** 2, variance)
    if point.ratio is None:
        return found
    ratio = point.ratio[source]
    together = np.abs(factors[0] * ratio + factors[1]) ** 2 * variance[1] + np.abs(factors[0]) ** 2 * variance[0]
    return np.where(np.isnan(ratio), found, together)


def _of_compliance(point: OperatingPoint, C: np.ndarray, back: np.ndarray, S: np.ndarray) -> np.ndarray:
    """∂y/∂X_u = C_k y_u back S² + back S (load), ∂y/∂X_d = y_u S C_k + 1 (load)."""
    found = np.zeros(S.size)
    if point.variance is None:
        return found
    table = np.array([[0.0], [1.0]])
    yu = point.moved[0]
    if point.at_drive:  # y = y_u S: all of it comes from one measurement
        return _through(point, 0, table * S + C * (yu * S * S))
    found = found + _through(point, 0, C * (yu * back * S * S) + table * (back * S))
    if point.load_variance is not None:
        found = found + _through(point, 1, C * (yu * S) + table)
    return found


def encircles(answer: Answer) -> bool:
    """Whether -1 is encircled in the wrong way: the closed loop is then unstable.

    For an axis that is stable but for its free motion, the phase φ of 1 + L, followed from Nyquist, where it lies
    within ±180°, down to the lowest lines, is that of a stable loop if

        |φ + 90° n + 180° P| < 90°,   n = -d ln|1 + L|/d ln f

    n counts what still integrates there, 2 for a free mass and 1 for each integral, and P the poles of the control
    alone that are unstable and faster than these lines.  Each pair of unstable poles of the closed loop adds 360°, one
    pole or a response of the wrong sign 180°.
    """
    f, values = answer.point.frequency, 1.0 + answer.gain
    low = np.arange(min(max(int(np.searchsorted(f, _LOWEST * f[0])), _FEWEST), f.size))
    steps = np.angle(values[:-1] * np.conj(values[1:]))
    phase = np.angle(values[-1]) + np.cumsum(steps[::-1])[::-1][low[low < steps.size]]
    level, x = np.log(np.abs(values[low])), np.log(f[low])
    apart = x - np.mean(x)
    n = -float(apart @ level / (apart @ apart))
    fast = int(np.sum(answer.response.unstable > 2.0 * np.pi * f[0]))
    return not abs(np.degrees(np.mean(phase)) + 90.0 * n + 180.0 * fast) < 90.0
