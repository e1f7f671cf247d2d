"""How well a model agrees with frequency responses: on the lines it was fitted to, and on lines it never saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.identification.response.refine import Model, Refined, Unknown, refine
from feeddrive.language.table import Result, Table
from feeddrive.loop.frequency_response import FRF

_FEW = 15  # steps where the start is a fit of nearly all lines
_FOLDS = 5
_OPEN_LINE = 0.3  # relative deviation of a line that is left open
_DECIBEL = 20.0 / np.log(10.0)
_MOST_HANGING = 0.5  # autocorrelation from line to line from which something regular is left


@dataclass(frozen=True, eq=False, repr=False)
class Agreement(Result):
    """Measured and fitted responses, and the RMS of ln(fitted/measured) on used and on unused lines.

    unused       each line was predicted by a fit that lacked it and every fifth other one
    spread       standard deviation of the weighted residual; near 1 if variances were measured and the model is as
                 good as they are
    model_error  share of the response by which the model is wrong beyond the noise; 0 where no variance is known
    order        of the derivative of the position that was measured: 0, 1 for velocities, 2 for accelerations
    """

    measured: tuple[FRF, ...]
    fitted: tuple[FRF, ...]
    residuals: tuple[np.ndarray, ...]
    used: float
    unused: float
    spread: float
    model_error: float
    order: int = 0

    def autocorrelation(self, lag: int = 1) -> float:
        """Of the residuals from line to line, over all responses: 0 for noise, near 1 where something is missing."""
        across = sum(float(np.real(np.vdot(r[:-lag], r[lag:]))) for r in self.residuals if r.size > lag)
        return across / max(sum(float(np.real(np.vdot(r, r))) for r in self.residuals), 1e-300)

    @property
    def worst(self) -> tuple[float, float]:
        """Hz and dB: where the fit is furthest off, over five neighboring lines."""
        found = (0.0, 0.0)
        for measured, fitted in zip(self.measured, self.fitted, strict=True):
            apart = np.abs(np.log(fitted.response / measured.response))
            window = min(5, apart.size)
            mean = np.convolve(apart, np.full(window, 1.0 / window), mode="valid")
            place = int(np.argmax(mean))
            if mean[place] > found[1]:
                found = float(measured.frequency[place + window // 2]), float(mean[place])
        return found[0], _DECIBEL * found[1]

    def remarks(self) -> list[str]:
        """What the residuals say of the model, in sentences."""
        said: list[str] = []
        if self.unused > 1.3 * self.used + 1e-6:
            said.append(
                f"lines that were not used are predicted {self.unused / self.used:.2f} times worse than those that "
                f"were: the model has more parameters than the lines support"
            )
        if self.autocorrelation() > _MOST_HANGING:
            where, apart = self.worst
            said.append(
                f"the residuals hang together from line to line (autocorrelation {self.autocorrelation():.2f}): "
                f"something regular is not in the model, most of it near {where:.4g} Hz ({apart:.2g} dB)"
            )
        if self.model_error > 0.0:
            said.append(
                f"the model is wrong by {100.0 * self.model_error:.2g} % of the response beyond the measured noise; "
                f"the errors of the parameters include it"
            )
        return said

    def table(self) -> Table:
        """The figures."""
        where, apart = self.worst
        rows = [
            ["lines that were fitted", f"{_DECIBEL * self.used:.3f} dB", f"{np.degrees(self.used):.2f} deg"],
            ["lines that were not used", f"{_DECIBEL * self.unused:.3f} dB", f"{np.degrees(self.unused):.2f} deg"],
            ["furthest off", f"{apart:.2f} dB", f"at {where:.4g} Hz"],
            ["from line to line", f"{self.autocorrelation():.2f}", "autocorrelation"],
        ]
        return Table("agreement with the measurement, RMS", ["what", "", ""], rows)


def agreement(
    model: Model, unknowns: Sequence[Unknown], responses: Sequence[FRF], found: Refined, order: int = 0
) -> Agreement:
    """Of a model that was refined."""
    used, unused = predicted(model, unknowns, responses, found)
    fitted = tuple(
        replace(frf, response=response, variance=None, coherence=None)
        for frf, (response, _) in zip(responses, model(found.values), strict=True)
    )
    return Agreement(tuple(responses), fitted, found.residuals, used, unused, found.spread, found.model_error, order)


def predicted(
    model: Model, unknowns: Sequence[Unknown], responses: Sequence[FRF], found: Refined
) -> tuple[float, float]:
    """RMS of ln(G/Gm) on the lines that were used, and on lines that a fit of the others lacked.

    Every fifth line is left out, then its neighbor, and so on, so that each line is once predicted.  Lines that noise
    leaves open by more than 30 % say nothing of a model and do not count.
    """
    own, other = [], []
    for fold in range(_FOLDS):
        out = [np.arange(frf.frequency.size) % _FOLDS == fold for frf in responses]
        part = refine(
            model, unknowns, responses, use=[~each for each in out], start=found.values, steps=_FEW,
            model_error=found.model_error,
        )  # fmt: skip
        for (response, _), frf, left in zip(model(part.values), responses, out, strict=True):
            apart, known = np.abs(np.log(response / frf.response)) ** 2, _known(frf)
            other.append(apart[left & known])
            own.append(apart[~left & known])
    return float(np.sqrt(np.mean(np.concatenate(own)))), float(np.sqrt(np.mean(np.concatenate(other))))


def _known(frf: FRF) -> np.ndarray:
    """Lines that are more than noise; all of them if there are hardly any."""
    share = np.zeros(frf.frequency.size) if frf.variance is None else frf.variance / frf.magnitude**2
    known = share < _OPEN_LINE**2
    return known if np.count_nonzero(known) >= 2 * _FOLDS else np.ones(known.size, bool)
