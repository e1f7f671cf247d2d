"""Smoothing of a measured frequency response with a bandwidth set by its noise, and the variance that remains."""

from __future__ import annotations

import numpy as np

from feeddrive.identification.excitation.nonperiodic import UNKNOWNS, local_rational

_HALF_WIDTHS = (4, 7, 12, 20, 34)  # neighboring lines used for each line
_REACH = 0.3  # of ln f: largest width of a window, since the fitted function is local even if the residuals allow more
_SURE = 0.99  # a window whose residuals are larger than noise with this probability is too wide
_SURE_OF_RATIO = 0.999  # the same for the ratio, which is tested often
_FIT = 1.2  # relative difference of both motions up to which their ratio is fitted: up to the antiresonance
_STIFF = 0.25  # relative difference of both motions up to which their ratio is used
_VARIANCE = 4  # lines on both sides over which the measured variance is averaged


def smoothed(
    frequency: np.ndarray, response: np.ndarray, variance: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The response and the variance after smoothing on the `wanted` lines, by index.

    Around each line a function with one resonance is fitted, by least squares weighted with the variance:

        f² G = (a0 + a1 u + a2 u²)/(1 + b u),   u = ln f - ln f0,   complex a, b

    The window grows while the residuals look like noise, by χ² on 99 %; the width before the last good one is taken, so
    that what the function cannot follow stays well below the noise that is left.  A line whose neighbors do not help
    keeps its measured value.  The variance itself is first averaged over nine lines, as it is an estimate too.

    Source: McKelvey & Guérin 2012 (local rational models); Goldenshluger & Nemirovski 1997 (windows as wide as the data
    allow), with the rule above.
    """
    from scipy.special import chdtri

    n = frequency.size
    flat = frequency**2
    out, left = response.copy(), _averaged(variance * flat**2) / flat**2
    if not np.any(variance > 0.0):
        return out[wanted], left[wanted]
    x, y = np.log(frequency), response * flat
    spread = np.maximum(left * flat**2, 1e-12 * np.abs(y) ** 2)
    before = (out.copy(), left.copy())
    fits = np.zeros(n, dtype=bool)
    fits[wanted] = True
    for half in _HALF_WIDTHS:
        width = 2 * half + 1
        if width > n or not np.any(fits):
            break
        begin = np.clip(np.arange(n) - half, 0, n - width)
        reach = np.maximum(x - x[begin], x[begin + width - 1] - x)
        fits &= reach <= _REACH
        place = np.flatnonzero(fits)
        if not place.size:
            break
        value, kept, excess = local_rational(x, y, spread, width, place)
        good = excess <= chdtri(2 * (width - UNKNOWNS), 1.0 - _SURE)
        fits[place[~good]] = False
        place, value, kept = place[good], value[good], kept[good]
        # the width before: it becomes the answer only once the next one has also been found good
        out[place], left[place] = before[0][place], before[1][place]
        before[0][place], before[1][place] = value / flat[place], kept / flat[place] ** 2
    return out[wanted], left[wanted]


def _averaged(variance: np.ndarray) -> np.ndarray:
    """The mean over a few neighbors."""
    summed = np.cumsum(np.concatenate([[0.0], variance]))
    place = np.arange(variance.size)
    low, high = np.maximum(place - _VARIANCE, 0), np.minimum(place + _VARIANCE + 1, variance.size)
    return (summed[high] - summed[low]) / (high - low)


def stiff_ratio(
    frequency: np.ndarray, motor: np.ndarray, load: np.ndarray, variances: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Motor over load reading at the lines where both ends still move nearly as one, NaN beyond, and its variance.

        r = 1 + a1 s + a2 s² + a3 s³ + a4 s⁴,   s = jω,   real coefficients

    At low frequencies both ends of any guided axis move as one. The stiffness follows from their small difference,
    which noise would hide where the responses are large and the spring hardly deflects. Fitted to raw lines from the
    lowest one up to the highest below the antiresonance at which the residuals still look like noise, by χ² on 99.9 %;
    used where |r - 1| is at most a quarter, which is up to half of the first antiresonance, and on at most half of the
    lines of the fit, which bends away first at its end.
    """
    from scipy.special import chdtri

    ratio, variance = np.full(frequency.size, np.nan, dtype=complex), np.zeros(frequency.size)
    if variances is None:
        return ratio, variance
    raw = motor / load
    spread = np.abs(raw) ** 2 * (variances[0] / np.abs(motor) ** 2 + variances[1] / np.abs(load) ** 2)
    if not np.all(spread > 0.0):
        return ratio, variance
    best = 0
    far = np.flatnonzero(np.abs(raw - 1.0) > _FIT)
    most = int(far[0]) if far.size else frequency.size
    for count in np.unique(np.geomspace(12, max(most, 13), 40).astype(int)):
        if count > most:
            break
        fitted, left = _real_polynomial(frequency[:count], raw[:count], spread[:count])
        excess = 2.0 * float(np.sum(np.abs(raw[:count] - fitted) ** 2 / spread[:count]))
        if excess <= chdtri(2 * count - 4, 1.0 - _SURE_OF_RATIO):
            best, ratio[:count], variance[:count] = count, fitted, left
        elif count > 2 * max(best, 12):
            break
    apart = np.flatnonzero(np.abs(ratio[:best] - 1.0) > _STIFF)
    end = min(best // 2, int(apart[0]) if apart.size else best)
    ratio[end:], variance[end:] = np.nan, 0.0
    return ratio, variance


def _real_polynomial(f: np.ndarray, r: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The weighted fit of 1 + a1 s + ... + a4 s⁴ to complex values, and its variance."""
    s = 1j * f / f[-1]
    powers = np.stack([s**k for k in (1, 2, 3, 4)], axis=1)
    columns = powers / np.sqrt(0.5 * spread)[:, None]
    right = (r - 1.0) / np.sqrt(0.5 * spread)
    both = np.vstack([columns.real, columns.imag])
    inverse = np.linalg.pinv(both)
    coefficients = inverse @ np.concatenate([right.real, right.imag])
    spanned = powers @ inverse
    return 1.0 + powers @ coefficients, np.sum(np.abs(spanned) ** 2, axis=1)
