"""Filtered B-splines: a set path as a sum of splines, whose simulated responses are fitted to the wanted path."""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.language.errors import ParameterError
from feeddrive.learning.set_path import ChangedReference, SetPath, changed, sampled, set_path
from feeddrive.loop.loop import Loop

_SETTLED = 1e-9  # of its peak: below it the answer of a spline has ended
_LONGEST = 40_000  # samples that an answer may take
_WHOLE = 20_000  # samples that are fitted at once, without a window
_RIDGE = 1e-6  # of the largest column: weight of the coefficients' own size in a window


def cardinal_spline(degree: int, spacing: int) -> np.ndarray:
    """Return a cardinal B-spline with knots every `spacing` samples: degree·spacing + spacing + 1 values, which sum to
    1.
    """
    from scipy.interpolate import BSpline  # not for commands that only read

    t = np.arange((degree + 1) * spacing + 1) / spacing
    spline = BSpline.basis_element(np.arange(degree + 2.0), extrapolate=False)(t)
    return np.nan_to_num(spline)


class _Columns:
    """The table's responses to splines that begin every `spacing` samples."""

    def __init__(self, path: SetPath, degree: int, spacing: int) -> None:
        self.spline, self.spacing, self.period = cardinal_spline(degree, spacing), spacing, path.period
        phases = {(i * spacing) % path.period for i in range(path.period)}
        self.answers = {phase: self._answer(path, phase) for phase in phases}

    def _answer(self, path: SetPath, phase: int) -> np.ndarray:
        """Return the table's response to the spline until it has settled."""
        rows = 2 * self.spline.size
        while True:
            positions = np.zeros((rows, 1))
            positions[: self.spline.size, 0] = self.spline
            answer = path.answers(positions, phase)[:, 0]
            above = np.flatnonzero(np.abs(answer) > _SETTLED * np.max(np.abs(answer)))
            if not np.all(np.isfinite(answer)) or (above[-1] >= rows - 2 and rows > _LONGEST):
                raise ParameterError(
                    f"the answer of the table to one spline has not settled after {rows} samples: the loop is not "
                    f"stable, or hardly damped"
                )
            if above[-1] < rows - 2:
                return answer[: above[-1] + 1]
            rows *= 2

    def matrix(self, first: int, last: int, begin: int, end: int, *, answered: bool = True) -> np.ndarray:
        """Return rows begin .. end of the splines (or their responses) first .. last; spline i begins at row i ·
        spacing.
        """
        columns = np.zeros((end - begin, last - first))
        for i in range(first, last):
            at = i * self.spacing
            column = self.answers[at % self.period] if answered else self.spline
            low, high = max(at, begin), min(at + column.size, end)
            if low < high:
                columns[low - begin : high - begin, i - first] = column[low - at : high - at]
        return columns


def filtered_splines(
    loop: Loop,
    reference: Reference,
    *,
    spacing: int = 20,
    degree: int = 5,
    window: int | None = None,
    kept: int | None = None,
) -> ChangedReference:
    """Return set positions as splines whose simulated responses fit a reference best: tracking without an inverse.

        x_r' = Φ p,   p = argmin |x_r - Ψ p|²,   Ψ_i = answer of the table to the spline Φ_i (degree, knots)

    spacing  samples between knots; spacing · T <= 1/(6 f) of a mode with frequency f
    window   coefficients that are found at once, for a path of which only so much is known ahead; window · spacing · T
             should be 1/f at least, and 10 coefficients at least.  None: all at once
    kept     coefficients of a window that are kept before it slides; default: a quarter of it
    Windows are solved by QR, with a ridge of 1e-6: normal equations would lose all digits.

    Raises ParameterError for a spacing below the degree, and for a path of more than 20000 samples without a window.
    When to use: for modes that no encoder sees, and for zeros outside the unit circle, known ahead of time.  When not:
    against disturbances; an error of the model is paid in full.
    Source: Okwudire, Ramani & Duan 2016; Duan, Yoon & Okwudire 2018 (limited preview).
    """
    if not 3 <= degree <= 5 or spacing < degree:
        raise ParameterError(
            f"degree = {degree} must be 3 to 5, and spacing = {spacing} samples at least the degree: below, the "
            f"coefficients cannot be told apart"
        )
    T = float(loop.sample_time)
    columns = _Columns(set_path(loop), degree, spacing)
    around = (degree + 1) * spacing  # rows of rest on both sides, for splines that begin before the motion
    wanted = sampled(reference, T, around, around)
    rows, shifted = wanted.size, wanted - wanted[0]
    first, last = -degree, rows // spacing + 1
    if window is None:
        if rows > _WHOLE:
            raise ParameterError(
                f"{rows} samples without a window (at most {_WHOLE}): give window, as 20 coefficients of {spacing} "
                f"samples"
            )
        p = _least(columns.matrix(first, last, 0, rows), shifted, 0.0)
    else:
        p = _slid(columns, shifted, first, last, window, max(1, window // 4) if kept is None else kept)
    at = np.zeros(rows)
    for i, coefficient in enumerate(p, start=first):
        low, high = max(i * spacing, 0), min(i * spacing + columns.spline.size, rows)
        at[low:high] += coefficient * columns.spline[low - i * spacing : high - i * spacing]
    return changed(wanted[0] + at, wanted, T, around)


def _slid(columns: _Columns, wanted: np.ndarray, first: int, last: int, window: int, kept: int) -> np.ndarray:
    """Return the coefficients window by window, after subtracting what the windows before have fixed."""
    if window < 10 or not 1 <= kept <= window:
        raise ParameterError(
            f"window = {window} coefficients, {kept} of them kept: at least 10, of which 1 to all are kept; with "
            f"shorter windows the recursion diverges"
        )
    p = np.zeros(last - first)
    left = wanted.copy()
    done = first
    while done < last:
        stop = min(done + window, last)
        begin, end = max(done * columns.spacing, 0), min(stop * columns.spacing, wanted.size)
        if end > begin:
            some = _least(columns.matrix(done, stop, begin, end), left[begin:end], _RIDGE)
        else:
            some = np.zeros(stop - done)
        fixed = stop if stop == last else done + kept
        p[done - first : fixed - first] = some[: fixed - done]
        left -= columns.matrix(done, fixed, 0, wanted.size) @ some[: fixed - done]
        done = fixed
    return p


def _least(Psi: np.ndarray, right: np.ndarray, ridge: float) -> np.ndarray:
    """Return argmin |right - Ψ p|² + (ridge · |Ψ|)² |p|² by QR of the stacked matrix; columns without rows give 0."""
    from scipy.linalg import lstsq

    size = np.sqrt(np.sum(Psi**2, axis=0))
    there = size > _SETTLED * np.max(size)
    coefficients = np.zeros(Psi.shape[1])
    rows = [Psi[:, there] / size[there]]
    if ridge > 0.0:
        rows.append(ridge * np.eye(int(there.sum())))
    full = np.concatenate([right, np.zeros(rows[-1].shape[0] if ridge > 0.0 else 0)])
    solved: Any = lstsq(np.vstack(rows), full, lapack_driver="gelsy")
    coefficients[there] = solved[0] / size[there]
    return coefficients
