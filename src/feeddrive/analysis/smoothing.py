"""What a measured response is between its noise: local parabolas as wide as the variances allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.stats import chi2

from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF

_HALVES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48)  # lines on each side that are tried
_LEVEL = 0.999  # of the χ² test that a parabola explains the lines
_EXACT = 1e-10  # of the largest variance in a window: a line with less counts as known that well
_CENTER, _SPREAD = 1, 2  # steps by which windows are taken narrower than the widest that holds


@dataclass(frozen=True, eq=False)
class Smoother:
    """A linear map from the lines of an FRF to smooth ones: the weights of each line in each, a sparse (n, n)."""

    weights: csr_array

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Applied to values of shape (..., n)."""
        columns = np.moveaxis(values, -1, 0).reshape(values.shape[-1], -1)
        smooth = self.weights @ np.real(columns) + 1j * (self.weights @ np.imag(columns))
        return np.moveaxis(smooth.reshape(np.moveaxis(values, -1, 0).shape), 0, -1)


def smoothers(frf: FRF) -> tuple[Smoother, Smoother]:
    """Local parabolas over ln f in windows as wide as they explain all lines within their variance: (center, spread).

    Windows grow from 5 to 97 lines and stop at the first that fails: χ² of the residuals beyond its 99.9 % point.
    Where the first one fails, the line stays as it is.  A window that just holds still bends the curve by as much as
    the noise that is left in it; so the curve itself is taken from windows one step narrower, and its spread, which is
    to cover the rest of that bias, from windows two steps narrower.
    Raises ParameterError for an FRF without variance.
    Source: Goldenshluger & Nemirovski 1997 (windows as wide as the noise allows); Schoukens et al. 2009 (local
    polynomials of frequency responses).
    """
    if frf.variance is None:
        raise ParameterError(
            f"the response to {frf.output} has no variance: estimate it from several periods or averages, or give it"
        )
    n, x = frf.frequency.size, np.log(frf.frequency)
    variance = np.maximum(frf.variance, np.maximum(1e-24 * frf.magnitude**2, 1e-200))
    reach = np.full(n, -1)  # index of the widest window that holds
    growing = np.ones(n, bool)
    maps: list[tuple[np.ndarray, np.ndarray]] = []
    for i, half in enumerate(_HALVES):
        width = 2 * half + 1
        if width > n or not np.any(growing):
            break
        start = np.clip(np.arange(n) - half, 0, n - width)
        places = start[:, None] + np.arange(width)
        offset = x[places] - x[:, None]
        offset = offset / np.max(np.abs(offset), axis=1, keepdims=True)
        columns = np.stack([np.ones_like(offset), offset, offset**2], axis=2)
        # a line where the response is zero (a sampled one at Nyquist) has no noise, and would outweigh all others
        unsure = variance[places]
        unsure = np.maximum(unsure, _EXACT * np.max(unsure, axis=1, keepdims=True))
        heavy = columns / unsure[:, :, None]
        made = np.linalg.solve(np.swapaxes(columns, 1, 2) @ heavy, np.swapaxes(heavy, 1, 2))
        fitted = np.squeeze(columns @ (made @ frf.response[places][:, :, None]), axis=2)
        misfit = np.sum(np.abs(frf.response[places] - fitted) ** 2 / unsure, axis=1)
        # |r|²/variance has mean 1 with two real degrees of freedom, of which the parabola takes three complex ones
        growing &= 2.0 * misfit <= chi2.ppf(_LEVEL, 2 * (width - 3))
        reach[growing] = i
        maps.append((start, made[:, 0, :]))
    return _smoother(n, maps, reach - _CENTER), _smoother(n, maps, reach - _SPREAD)


def _smoother(n: int, maps: Sequence[tuple[np.ndarray, np.ndarray]], reach: np.ndarray) -> Smoother:
    """Each line by the map of the window that it reaches; below 0 it stays."""
    stays = np.flatnonzero(reach < 0)
    rows, columns, weights = [stays], [stays], [np.ones(stays.size)]
    for i, (start, made) in enumerate(maps):
        lines, width = np.flatnonzero(reach == i), made.shape[1]
        rows.append(np.repeat(lines, width))
        columns.append((start[lines, None] + np.arange(width)).ravel())
        weights.append(made[lines].ravel())
    places = np.concatenate(rows), np.concatenate(columns)
    return Smoother(csr_array((np.concatenate(weights), places), shape=(n, n)))
