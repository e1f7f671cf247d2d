"""How sure a tuning is of its bounds, from the variance of the measurement; and when it is too poor to tune on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from feeddrive.language.errors import NotIdentifiableError
from feeddrive.tuning.shaping.answer import Answer
from feeddrive.tuning.shaping.bounds import Bound

_TOGETHER = 0.15  # of ln f: bounds nearer than this at one site share their noise and count once
_POOR = 0.5  # of the distance to -1 that the noise may take
_BEYOND = 3.0  # times the crossover: up to there the measurement must be good
_LOW = 0.3  # |L| at the last line that may be left
_BEFORE = 2.0  # times the first line: the lowest crossover must lie above
_GAP = 1.6  # ratio of two lines beside each other around a crossover


def distances(bounds: Sequence[Bound]) -> np.ndarray:
    """Slack over standard deviation of each separate bound: the nearest one of every neighborhood in frequency."""
    left = sorted((b for b in bounds if b.deviation > 0.0), key=lambda b: b.slack / b.deviation)
    kept: list[Bound] = []
    for bound in left:
        if all(b.site != bound.site or abs(np.log(b.frequency / bound.frequency)) > _TOGETHER for b in kept):
            kept.append(bound)
        if bound.slack / bound.deviation > 8.0:
            break
    return np.array([b.slack / b.deviation for b in kept])


def chance(bounds: Sequence[Bound]) -> float:
    """The probability that all bounds hold: Π Φ(slack/σ), for noise that is normal and independent."""
    return float(np.prod(norm.cdf(distances(bounds))))


def needed(bounds: Sequence[Bound], sure: float, confidence: float) -> float:
    """The number of standard deviations to keep in place of `sure`, so that all bounds hold with the confidence."""
    found = distances(bounds)
    if not found.size:
        return sure

    def off(more: float) -> float:
        return float(np.prod(norm.cdf(found + more))) - confidence

    low, high = -5.0, 8.0
    if off(low) > 0.0 or off(high) < 0.0:
        return sure
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if off(middle) < 0.0 else (low, middle)
    return max(0.0, sure + high)


def require_covered(answers: Sequence[Answer]) -> None:
    """Raise NotIdentifiableError, with the band, where lines are missing that a tuning stands on.

    Below: the lowest crossover must lie above twice the first line.  Around it, from half to twice, two lines
    may not be further apart than a factor 1.6.  Above: the loop gain must have fallen to 0.3 at the last line, unless
    the lines go up to three times the highest crossover, or nearly to half the sample rate.
    """
    for each in answers:
        f, size, site = each.site.frequency, np.abs(each.gain), each.site
        if site.loop is not None:
            continue
        above, below = np.flatnonzero(size >= 1.0), np.flatnonzero(size < 1.0)
        again = f"do not tune, measure again: '{site.name}'"
        if not above.size or (below.size and f[below[0]] < _BEFORE * f[0]):
            raise NotIdentifiableError(
                f"{again} begins at {f[0]:.4g} Hz, where the loop gain is only {size[0]:.2g}: what lies below decides; "
                f"measure from {0.1 * f[0]:.2g} Hz on, a fifth of the crossover or less"
            )
        crossover = float(f[above[-1]])
        if size[-1] > _LOW and f[-1] < _BEYOND * crossover and f[-1] < 0.45 / site.sample_time:
            raise NotIdentifiableError(
                f"{again} ends at {f[-1]:.4g} Hz, where the loop gain is still {size[-1]:.2g}; measure up to at least "
                f"{_BEYOND * crossover:.4g} Hz, three times the crossover"
            )
        first = float(f[below[0]]) if below.size else crossover
        for k in np.flatnonzero(f[1:] / f[:-1] > _GAP):
            if f[k + 1] > first / _BEFORE and f[k] < _BEFORE * crossover:
                raise NotIdentifiableError(
                    f"{again} has no lines from {f[k]:.4g} to {f[k + 1]:.4g} Hz, and the crossover lies near, at "
                    f"{first if f[k] < first else crossover:.4g} Hz; measure this band too"
                )


def require_good(answers: Sequence[Answer], sure: float) -> None:
    """Raise NotIdentifiableError, with the band, where noise leaves a tuning without ground.

    Judged up to three times the highest crossover: k σ(L) may not exceed half of |1 + L|.
    """
    for each in answers:
        f, L, site = each.site.frequency, each.gain, each.site
        above = np.flatnonzero(np.abs(L) >= 1.0)
        crossover = float(f[above[-1]]) if above.size else float(f[0])
        if site.variance is None:
            continue
        excess = sure * np.sqrt(0.5 * each.gain_variance) > _POOR * np.abs(1.0 + L)
        poor = np.flatnonzero(excess & (f <= _BEYOND * crossover))
        if poor.size:
            low, high = f[poor[0]], f[poor[-1]]
            worst = poor[np.argmax(each.gain_variance[poor] / np.abs(1.0 + L[poor]) ** 2)]
            share = np.sqrt(site.variance[1, worst]) / np.abs(site.by_force[1, worst])
            raise NotIdentifiableError(
                f"do not tune, measure again: '{site.name}' is too noisy from {low:.4g} to {high:.4g} Hz, up to "
                f"{100.0 * share:.2g} % of the response at {f[worst]:.4g} Hz, below three times the crossover of "
                f"{crossover:.4g} Hz; excite this band more strongly, or average longer"
            )
