"""Lines and phases of a multisine: which lines are left empty to hear distortion, and phases with a low peak."""

from __future__ import annotations

import numpy as np

from feeddrive.language.errors import ParameterError

GRIDS = ("full", "odd", "random_odd", "odd_odd")
_GROUP = 4  # odd lines of which one, drawn by chance, stays empty
_CLIPPINGS = 300
_OVERSAMPLING = 4  # grid points per sample of the highest line, for peaks between the samples


def grid_lines(lowest: float, highest: float, period: float, grid: str = "random_odd", seed: int = 0) -> np.ndarray:
    """Numbers k of the lines k/period in the band that carry excitation.

        full        all: most power, no empty lines in the band
        odd         1, 3, 5 ...: even distortion shows on the even lines
        odd_odd     1, 5, 9 ...: odd distortion shows on 3, 7, 11 ..., too
        random_odd  odd, and of each four one drawn by chance stays empty (default): both show, most lines remain

    Raises ParameterError for a grid that is not known and a band without a line.
    Source: Pintelon & Schoukens 2012, section 4.3.1; Schoukens, Lataire, Pintelon & Vandersteen 2008.
    """
    if grid not in GRIDS:
        raise ParameterError(f"grid = {grid!r} must be one of {', '.join(GRIDS)}")
    if not 0.0 < lowest <= highest:
        raise ParameterError(f"band {lowest:g} .. {highest:g} Hz must be above 0 Hz and rise")
    every = np.arange(max(1, int(np.ceil(lowest * period * (1 - 1e-12)))), int(highest * period * (1 + 1e-12)) + 1)
    if grid == "odd_odd":
        chosen = every[every % 4 == 1]
    elif grid == "full":
        chosen = every
    else:
        chosen = every[every % 2 == 1]
    if grid == "random_odd":
        groups = chosen.size // _GROUP
        out = np.arange(groups) * _GROUP + np.random.default_rng(seed).integers(0, _GROUP, groups)
        chosen = np.delete(chosen, out)
    if not chosen.size:
        raise ParameterError(
            f"no line of the grid '{grid}' lies in {lowest:g} .. {highest:g} Hz at a resolution of "
            f"{1.0 / period:g} Hz: make the period longer"
        )
    return chosen


def schroeder_phases(lines: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
    """φₖ = -2π Σ over the lines i below of (k - i) pᵢ / d, with shares of power p (Schroeder 1970).

    d is the usual distance of two lines: the sum of every d-th line repeats itself d times in a period, but for a turn,
    and the sweep that Schroeder's phases are must fit into such a part.
    """
    steps = lines / (np.median(np.diff(lines)) if lines.size > 1 else 1.0)
    shares = amplitudes**2 / np.sum(amplitudes**2)
    below = np.concatenate([[0.0], np.cumsum(shares)[:-1]])
    moments = np.concatenate([[0.0], np.cumsum(shares * steps)[:-1]])
    return -2.0 * np.pi * (steps * below - moments)


def crest_factor(values: np.ndarray) -> float:
    """Peak over RMS."""
    return float(np.max(np.abs(values)) / np.sqrt(np.mean(values**2)))


def low_crest_phases(lines: np.ndarray, amplitudes: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Phases with a lower peak: the sum is clipped, its phases are kept, its amplitudes put back, again and again.

    The clipping level rises from 75 to 99 % of the peak over 300 rounds; the best phases on the way are returned.  Some
    1.45 for hundreds of lines, where Schroeder's phases give 1.7 and random ones 3 to 4.
    Source: Van der Ouderaa, Schoukens & Renneboog 1988.
    """
    count = int(2 ** np.ceil(np.log2(2 * _OVERSAMPLING * (lines[-1] + 1))))
    best, lowest = phases, np.inf
    for level in np.linspace(0.75, 0.99, _CLIPPINGS):
        wave = summed(lines, amplitudes, phases, count)
        peak = float(np.max(np.abs(wave)))
        if peak < lowest:
            best, lowest = phases, peak
        spectrum = np.fft.rfft(np.clip(wave, -level * peak, level * peak))
        phases = np.angle(spectrum[lines])
    return best


def summed(lines: np.ndarray, amplitudes: np.ndarray, phases: np.ndarray, count: int, order: int = 0) -> np.ndarray:
    """One period of Σ aₖ cos(2π k t/period + φₖ) at `count` points; `order` 1, 2, ...: derivatives over t/period."""
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    spectrum[lines] = 0.5 * count * amplitudes * np.exp(1j * phases) * (2j * np.pi * lines) ** order
    return np.fft.irfft(spectrum, count)
