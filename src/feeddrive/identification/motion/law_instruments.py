"""What the set motion tells of a control law: instruments, for logs whose noise moves the axis.

Counts of the motor's encoder that are coarse for its speed are slow, pass the law and move the axis. The force and the
logged position then share their noise: least squares bends a law towards the inverse of the plant, and a free linear
law, which makes up any mixture of law and inverse plant, leaves less than the law that ran. The set motion knows
nothing of this noise. With z, columns of the set motion alone, the right law leaves a residual r with

    E[zᵀ r] = 0,   J = (Zᵀ r)ᵀ W⁻¹ (Zᵀ r) ~ χ²(instruments - unknowns),   W the covariance of Zᵀ r

whatever the noise does, and gains that make J least are right (generalized method of moments, Hansen 1982). W holds
rows of unlike noise, as where the motor stands at one count, and a memory of the residual.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from feeddrive.identification import regression
from feeddrive.identification.motion.law_rows import LawRows, Reduced
from feeddrive.identification.motion.law_search import Floor, correlation

# s: time constants of the low passes whose outputs of the set motion span the answers of an axis under its control
_TIMES = (0.003, 0.006, 0.012, 0.025, 0.05, 0.1, 0.2)
_TURNING = (1e-9, 0.02)  # of the largest set speed: smoothings of the direction, to which friction answers
_MEMORY = 3  # slow rows: the low pass before them and what is left of counts have a memory of 0.3, then of nothing
_ALONE = 1e-7  # of the largest singular value, up to which an instrument is a sum of others


@dataclass(frozen=True, eq=False)
class SetMotion:
    """Instruments in the slow rows of a log.

    columns  orthonormal columns of the set motion, shape (rows, instruments)
    whiten   W^(-1/2), shape (instruments, instruments)
    """

    columns: np.ndarray
    whiten: np.ndarray

    @classmethod
    def of(cls, rows: LawRows, rest: np.ndarray) -> Self:
        """Return the instruments of rows, for a law that leaves `rest` of the force, as white noise of one size."""
        answers = _answers(rows)
        made, sizes = rows.taken(answers), np.linalg.norm(answers[rows.places], axis=0)
        left = np.linalg.norm(made, axis=0)
        # a direction that does not change within a stretch tells nothing
        told = left > _ALONE * sizes
        basis, sizes, _ = np.linalg.svd(made[:, told] / left[told], full_matrices=False)
        kept = basis[:, sizes > _ALONE * sizes[0]]
        return cls(kept, np.eye(kept.shape[1]) / math.sqrt(float(rest @ rest) / rest.size))

    def weighted(self, rest: np.ndarray) -> Self:
        """Return the instruments with W of what a law leaves: of rows unlike in size, and with a memory."""
        covariance = regression.long_run(self.columns * rest[:, None], _MEMORY)
        return replace(self, whiten=np.linalg.inv(np.linalg.cholesky(covariance)))

    def told(self, values: np.ndarray) -> np.ndarray:
        """Return what the instruments tell of values in the rows, (rows,) or (rows, p), in standard deviations."""
        return self.whiten @ (self.columns.T @ values)

    def reduced(self, columns: np.ndarray, force: np.ndarray) -> Reduced:
        """Return the problem of columns and force whose residual sum of squares is J, and the number of rows beside."""
        factor, right = self.told(columns), self.told(force)
        noise = math.sqrt(force.size)
        return Reduced(np.vstack([factor, np.zeros((1, factor.shape[1]))]), np.append(right, noise))

    def floor(self, force: np.ndarray, rest: np.ndarray) -> Floor:
        """Return the free law that explains all that the instruments tell, beside the noise of `rest`."""
        part, rows = self.reduced(np.zeros((force.size, 0)), force), float(force.size)
        return Floor(rows, part.power, correlation(rest), 0.0, rows, self.columns.shape[1], force.size)


def _answers(rows: LawRows) -> np.ndarray:
    """Return the set motion and its directions, and both after low passes, over the whole log."""
    from scipy.signal import lfilter  # takes a second to import

    raw = rows.raw
    speed = np.diff(raw.wanted, prepend=raw.wanted[0]) / raw.T
    acceleration = np.diff(speed, prepend=speed[0]) / raw.T
    turns = [replace(raw, smoothing=share * raw.fastest).direction("sign0") for share in _TURNING]
    made = [raw.wanted - raw.wanted[0], raw.T * np.arange(speed.size), acceleration]
    made.append(np.diff(acceleration, prepend=acceleration[0]) / raw.T)
    for one in (speed, *turns):
        poles = [math.exp(-raw.T / time) for time in _TIMES]
        made += [one, *(np.asarray(lfilter([1.0 - pole], [1.0, -pole], one)) for pole in poles)]
    return np.stack(made, axis=1)
