"""The closed loop of a control at a site, line by line, with slopes to the tunables and what noise leaves open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.tuning.shaping.below import Recovery
from feeddrive.tuning.shaping.control_response import Response
from feeddrive.tuning.shaping.site import Site

_LOWEST, _FEWEST = 2.5, 5  # lines up to so many times the first one, and at least so many, tell what integrates


@dataclass(frozen=True, eq=False)
class Answer:
    """The closed loop of a site on its lines, with slopes (lines, tunables) and variances (lines,).

    below   the compliance below the first line, with the axis as a free mass; None if nobody asks
    """

    site: Site
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
        own = Recovery(self.site.frequency, self.compliance, self.compliance_slope)
        if self.below is None:
            return own
        return Recovery(*(np.concatenate(pair) for pair in zip(self.below, own, strict=True)))


def answer(site: Site, response: Response, below: Recovery | None = None) -> Answer:
    """L = -C·X_u and the compliance y = y_d + y_u (C·X_d)/(1 + L), with slopes, and variances to first order."""
    C, dC = response.value, response.slope
    xu, xd = site.by_force, site.by_load
    yu, yd = site.moved
    L = -np.einsum("kl,kl->l", C, xu)
    dL = -np.einsum("klp,kl->lp", dC, xu)
    back, dback = np.einsum("kl,kl->l", C, xd), np.einsum("klp,kl->lp", dC, xd)
    S = 1.0 / (1.0 + L)
    y = yd + yu * back * S
    dy = (yu * S)[:, None] * (dback - (back * S)[:, None] * dL)
    zero = np.zeros(site.frequency.size)
    gain_variance = zero if site.variance is None else _through(site, 0, C)
    return Answer(site, response, L, dL, gain_variance, y, dy, _of_compliance(site, C, back, S), below)


def _through(site: Site, source: int, factors: np.ndarray) -> np.ndarray:
    """The variance of Σ factor · reading of one source (0: the command, 1: a force on the table).

    Where the motor's reading is the load's times a ratio, they have one error; elsewhere they count as independent.
    """
    variance = (site.variance, site.load_variance)[source]
    assert variance is not None
    found = np.einsum("kl,kl->l", np.abs(factors) ** 2, variance)
    if site.ratio is None:
        return found
    ratio = site.ratio[source]
    together = np.abs(factors[0] * ratio + factors[1]) ** 2 * variance[1] + np.abs(factors[0]) ** 2 * variance[0]
    return np.where(np.isnan(ratio), found, together)


def _of_compliance(site: Site, C: np.ndarray, back: np.ndarray, S: np.ndarray) -> np.ndarray:
    """∂y/∂X_u = C_k y_u back S² + back S (load), ∂y/∂X_d = y_u S C_k + 1 (load)."""
    found = np.zeros(S.size)
    if site.variance is None:
        return found
    table = np.array([[0.0], [1.0]])
    yu = site.moved[0]
    if site.at_drive:  # y = y_u S: one measurement stands in all of it
        return _through(site, 0, table * S + C * (yu * S * S))
    found = found + _through(site, 0, C * (yu * back * S * S) + table * (back * S))
    if site.load_variance is not None:
        found = found + _through(site, 1, C * (yu * S) + table)
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
    f, values = answer.site.frequency, 1.0 + answer.gain
    low = np.arange(min(max(int(np.searchsorted(f, _LOWEST * f[0])), _FEWEST), f.size))
    steps = np.angle(values[:-1] * np.conj(values[1:]))
    phase = np.angle(values[-1]) + np.cumsum(steps[::-1])[::-1][low[low < steps.size]]
    level, x = np.log(np.abs(values[low])), np.log(f[low])
    apart = x - np.mean(x)
    n = -float(apart @ level / (apart @ apart))
    fast = int(np.sum(answer.response.unstable > 2.0 * np.pi * f[0]))
    return not abs(np.degrees(np.mean(phase)) + 90.0 * n + 180.0 * fast) < 90.0
