"""What a periodic excitation shows of nonlinearity: on lines that it leaves empty, and by how rough the response is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.identification.excitation.frequency_estimate import Level

_GAP = 5.0  # factor between excited and empty lines below which there are no empty ones
_ROUNDING = 1e-9  # share of the largest line under which all is rounding
_RISK = 0.01  # that noise is called distortion
_NEIGHBORS = 5  # detection lines over which a level is the RMS
_HALF = 5  # lines on each side of the local polynomial
_ORDER = 2
_REACH = 31  # lines over which the share of the scatter is a median


@dataclass(frozen=True, eq=False)
class Averaged:
    """Means over periods, shape (lines,), with the (co)variances E|.|² of these means."""

    frequency: np.ndarray
    input: np.ndarray
    output: np.ndarray
    yy: np.ndarray
    uu: np.ndarray
    yu: np.ndarray
    freedom: int  # complex degrees of freedom of the variances
    excited: np.ndarray  # bool

    def noise(self, response: np.ndarray, lines: np.ndarray) -> np.ndarray:
        """E|v|² of v = y - G u on some lines, with G there."""
        cross = np.real(np.conj(response) * self.yu[lines])
        return np.maximum(self.yy[lines] + np.abs(response) ** 2 * self.uu[lines] - 2.0 * cross, 0.0)


def excited_lines(cause: np.ndarray) -> np.ndarray:
    """Which lines carry excitation: those above the widest gap in the sizes of all lines; cause of shape (lines,).

    A spectrum that falls by decades over the band has no gap as wide as the one to its empty lines.
    """
    size = np.maximum(np.abs(cause) / np.max(np.abs(cause)), _ROUNDING)
    ordered = np.sort(size)[::-1]
    gaps = ordered[:-1] / ordered[1:]
    widest = int(np.argmax(gaps))
    if gaps[widest] < _GAP:
        return np.ones(size.size, bool)
    return size > np.sqrt(ordered[widest] * ordered[widest + 1])


def detection(mean: Averaged, response: np.ndarray) -> dict[str, Level]:
    """Levels on empty lines: "odd" and "even" distortion with the noise taken off.

        D(k) = Ȳ(k) - Ĝ(k) Ū(k),   level² = mean over 5 lines of a kind of (|D|² - noise)

    Ĝ is the response on the neighboring excited lines, interpolated: in a closed loop the input is not empty there.
    The level of a kind is 0 in the band if all its lines together are not more than noise, at a risk of 1 %.
    Outside the band no response is known, and D is the output itself, also what the input's own distortion made.
    `response` on the excited lines.  Only lines up to three times the band are looked at.
    """
    lines = np.flatnonzero(mean.excited)
    first, last = int(lines[0]), int(lines[-1])
    found: dict[str, Level] = {}
    everywhere = np.arange(min(3 * (last + 1), mean.frequency.size))
    empty = everywhere[~mean.excited[everywhere]]
    if not empty.size:
        return found
    between = (empty > first) & (empty < last)
    guessed = np.interp(empty, lines, np.real(response)) + 1j * np.interp(empty, lines, np.imag(response))
    guessed = np.where(between, guessed, 0.0)
    power = np.abs(mean.output[empty] - guessed * mean.input[empty]) ** 2
    noise = mean.noise(guessed, empty)
    size = np.interp(empty, lines, np.abs(mean.input[lines]))
    for name, kind in (("odd", (empty + 1) % 2 == 1), ("even", (empty + 1) % 2 == 0)):
        if not np.any(kind):
            continue
        inside = between[kind]
        level = np.sqrt(np.maximum(smoothed(power[kind] - noise[kind]), 0.0))
        if np.any(inside) and not _loud(power[kind][inside], noise[kind][inside], mean.freedom):
            level = np.where(inside, 0.0, level)
        response_level = np.where(inside, level / size[kind], np.nan)
        found[name] = Level(mean.frequency[empty[kind]], level, response_level)
    return found


def _loud(power: np.ndarray, noise: np.ndarray, freedom: int) -> bool:
    """Whether lines hold more than noise: the sum of |D|²/noise, each F(2, 2ν), against its quantile.

    The sum counts as one F whose degrees of freedom add up, which holds for noise of any color.
    """
    from scipy.special import fdtri

    quotient = float(np.mean(power / np.maximum(noise, 1e-300)))
    # the mean of F(2, 2ν) is ν/(ν - 1); few periods make single lines wild, and their sum is judged with caution
    expected = freedom / (freedom - 1.0) if freedom > 1 else np.inf
    return quotient > expected * float(fdtri(2 * power.size, 2 * max(freedom, 1), 1.0 - _RISK))


def smoothed(values: np.ndarray) -> np.ndarray:
    """Running mean over neighbors, shorter at the ends."""
    width = min(_NEIGHBORS, values.size)
    ones = np.ones(width)
    return np.convolve(values, ones, "same") / np.convolve(np.ones(values.size), ones, "same")


def local_scatter(frequency: np.ndarray, input: np.ndarray, output: np.ndarray) -> np.ndarray | None:  # noqa: A002
    """E|v|² around a response that is smooth over eleven excited lines, shape (lines,); None if there are fewer.

        Ȳ(i) = (g₀ + g₁ x + g₂ x²) fᵖ Ū(i) + V(i),   x from -1 to 1 over the lines, p the slope of |Ȳ/Ū| on log scales

    It holds noise and everything nonlinear, also on a full grid.  At a sharp resonance it would hold the bend of the
    response, too: what is handed out is therefore the share |V|²/|Ȳ|² as the median over 31 lines, times |Ȳ|².
    Source: Pintelon et al. 2010; in steady state there is no transient to estimate.
    """
    n = frequency.size
    width = 2 * _HALF + 1
    if n < width:
        return None
    starts = np.clip(np.arange(n) - _HALF, 0, n - width)
    around = starts[:, None] + np.arange(width)
    f, u, y = frequency[around], input[around], output[around]
    x = f - 0.5 * (f[:, :1] + f[:, -1:])
    x = x / x[:, -1:]
    response = np.log(np.maximum(np.abs(y / u), 1e-300))
    away = np.log(f) - np.mean(np.log(f), axis=1, keepdims=True)
    slope = np.sum(away * response, axis=1, keepdims=True) / np.sum(away**2, axis=1, keepdims=True)
    regressors = (u * (f / f[:, :1]) ** slope)[:, :, None] * x[:, :, None] ** np.arange(_ORDER + 1)
    scale = np.maximum(np.abs(regressors).max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    q = np.linalg.qr(regressors / scale)[0]
    rest = y[:, :, None] - q @ (np.conj(q).transpose(0, 2, 1) @ y[:, :, None])
    scatter = np.sum(np.abs(rest[:, :, 0]) ** 2, axis=1) / (width - _ORDER - 1)
    power = np.abs(output) ** 2
    share = scatter / np.mean(np.abs(y) ** 2, axis=1)
    reach = min(_REACH, n)
    begins = np.clip(np.arange(n) - reach // 2, 0, n - reach)
    return np.median(share[begins[:, None] + np.arange(reach)], axis=1) * power
