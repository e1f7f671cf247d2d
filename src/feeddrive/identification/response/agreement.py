"""Agreement of a model with frequency responses, unidentifiable parameters, and what to measure next."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from feeddrive.identification.regression import Estimate
from feeddrive.identification.response.refine import Model, Refined, ResponseUnits, Unknown, refine
from feeddrive.language.quantity import Quantity, span
from feeddrive.language.table import Cell, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF

_COARSE = 300  # points of a drawn curve to begin with
_STEP = 0.02  # of the largest velocity over force: the longest step of a drawn curve
_MOST_HALVED = 12
_FEW = 15  # steps where the start is a fit of nearly all lines
_FOLDS = 5
_POOR = 0.35  # RMS of ln(fitted/measured) on unused lines, 3 dB, beyond which a model is rejected
OPEN_LINE = 0.3  # relative deviation from which a line is too uncertain
_AROUND = 9  # lines over which the median of the variance is taken
_DECIBEL = 20.0 / np.log(10.0)  # dB of a natural logarithm
_MOST_HANGING = 0.5  # autocorrelation from line to line from which the residual is systematic
_TIED = 0.995  # correlation from which two parameters count as one combination
_BLIND = 0.01  # independent share of their effects: below it, model errors change the parameters as much
_SURE = 0.1  # standard error over value up to which a parameter of such a combination still counts as known


@dataclass(frozen=True, eq=False, repr=False)
class Agreement(Result):
    """The agreement of measured and fitted responses: the RMS of ln(fitted/measured) at used and at unused frequency
    lines.

    drawn        the model as a smooth curve, with short steps in the complex plane; its variance is J C Jᴴ, with
                 the covariance C of the parameters and the derivatives J, and does not include model errors
    unused       found by cross-validation: each line is predicted by a fit to four fifths of the lines that excludes it
    spread       standard deviation of the weighted residual; near 1 if variances were measured and the model agrees
                 within them
    model_error  relative model error beyond the noise; 0 if no variance is known
    order        order of the measured derivative: 0 for positions, 1 for velocities, 2 for accelerations
    """

    measured: tuple[FRF, ...]
    fitted: tuple[FRF, ...]
    residuals: tuple[np.ndarray, ...]
    used: float
    unused: float
    spread: float
    model_error: float
    drawn: tuple[FRF, ...]
    order: int = 0

    def autocorrelation(self, lag: int = 1) -> float:
        """Return the autocorrelation of the residuals over lines: 0 for noise, near 1 if the model lacks a term."""
        across = sum(float(np.real(np.vdot(r[:-lag], r[lag:]))) for r in self.residuals if r.size > lag)
        return across / max(sum(float(np.real(np.vdot(r, r))) for r in self.residuals), 1e-300)

    @property
    def poor(self) -> bool:
        """True if the prediction error at unused frequency lines exceeds 3 dB RMS: the model does not describe this
        response.
        """
        return self.unused > _POOR

    @property
    def worst(self) -> tuple[float, float]:
        """The frequency in Hz and magnitude in dB of the largest fit error, averaged over five neighboring frequency
        lines.
        """
        worst = (0.0, 0.0)
        for measured, fitted in zip(self.measured, self.fitted, strict=True):
            apart = np.abs(np.log(fitted.response / measured.response))
            window = min(5, apart.size)
            mean = np.convolve(apart, np.full(window, 1.0 / window), mode="valid")
            place = int(np.argmax(mean))
            if mean[place] > worst[1]:
                worst = float(measured.frequency[place + window // 2]), float(mean[place])
        return worst[0], _DECIBEL * worst[1]

    def remarks(self) -> list[str]:
        """Return remarks on the model, based on its residuals."""
        remarks: list[str] = []
        if self.unused > 1.3 * self.used + 1e-6:
            remarks.append(
                Text(
                    f"lines that were not used are predicted {Quantity(self.unused / self.used):.2f} times worse than "
                    "those that were: the model has more parameters than the lines support"
                )
            )
        if self.autocorrelation() > _MOST_HANGING:
            where, apart = self.worst
            remarks.append(
                Text(
                    "the residuals are correlated from line to line (autocorrelation "
                    f"{Quantity(self.autocorrelation()):.2f}): the model lacks a systematic part, mostly near "
                    f"{Quantity(where, 'Hz')} ({Quantity(apart, 'dB'):2})"
                )
            )
        if self.model_error > 0.0:
            remarks.append(
                Text(
                    f"the model is wrong by {Quantity(self.model_error, 'share'):2} of the response beyond the "
                    "measured noise; the errors of the parameters include it"
                )
            )
        return remarks

    def table(self) -> Table:
        """Return a table of the figures of the agreement."""
        where, apart = self.worst
        rows: list[Sequence[Cell]] = [
            [name, Quantity(_DECIBEL * error, "dB", form=".3f"), Quantity(error, "rad", form=".2f deg")]
            for name, error in (("lines that were fitted", self.used), ("lines that were not used", self.unused))
        ]
        rows += [
            [Text(f"furthest off, at {Quantity(where, 'Hz')}"), Quantity(apart, "dB", form=".2f"), ""],
            ["autocorrelation from line to line", Quantity(self.autocorrelation(), form=".2f"), ""],
        ]
        return Table("agreement with the measurement, RMS", ["what", "magnitude", "phase"], rows)


class LineModel(Protocol):
    """A model for refinement that can also be evaluated on other lines."""

    def __call__(self, values: np.ndarray, /) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return each response and its derivatives with respect to the parameters."""
        ...

    def on(self, frequencies: Sequence[np.ndarray], /) -> Self:
        """Return the model at other frequencies in Hz, one array per response."""
        ...


def agreement(
    model: LineModel, unknowns: Sequence[Unknown], responses: Sequence[FRF], refined: Refined, order: int = 0
) -> Agreement:
    """Return the agreement of a refined model with the responses."""
    used, unused = predicted(model, unknowns, responses, refined)
    fitted = tuple(
        replace(frf, response=response, variance=None, coherence=None)
        for frf, (response, _) in zip(responses, model(refined.values), strict=True)
    )
    drawn = tuple(_curves(model, responses, refined, order))
    return Agreement(
        tuple(responses), fitted, refined.residuals, used, unused, refined.spread, refined.model_error, drawn, order
    )


def _curves(model: LineModel, responses: Sequence[FRF], refined: Refined, order: int) -> list[FRF]:
    """Return the model between the first and the last line, with steps halved where the mobility changes strongly."""
    values = refined.values
    lines = [np.geomspace(frf.frequency[0], frf.frequency[-1], _COARSE) for frf in responses]
    for _ in range(_MOST_HALVED):
        curves = [response for response, _ in model.on(lines)(values)]
        finer: list[np.ndarray] = []
        for f, response in zip(lines, curves, strict=True):
            # mobility: in position the rigid-body motion, in acceleration the highest line would get all points
            place = response * (2j * np.pi * f) ** (1 - order)
            far = np.flatnonzero(np.abs(np.diff(place)) > _STEP * np.max(np.abs(place)))
            finer.append(np.insert(f, far + 1, np.sqrt(f[far] * f[far + 1])))
        if all(new.size == old.size for new, old in zip(finer, lines, strict=True)):
            break
        lines = finer
    return [
        replace(frf, frequency=f, response=response, variance=_variance(slopes, refined.covariance), coherence=None)
        for frf, f, (response, slopes) in zip(responses, lines, model.on(lines)(values), strict=True)
    ]


def _variance(slopes: np.ndarray, covariance: np.ndarray) -> np.ndarray | None:
    """Return E|dG|² of each line, to first order, or None if a parameter has no finite error."""
    variance = np.real(np.einsum("li,ij,lj->l", slopes, covariance, np.conj(slopes)))
    return np.maximum(variance, 0.0) if np.all(np.isfinite(variance)) else None


def predicted(
    model: Model, unknowns: Sequence[Unknown], responses: Sequence[FRF], refined: Refined
) -> tuple[float, float]:
    """Return the RMS of ln(G/Gm) at used frequency lines, and at unused ones by five-fold cross-validation.

    Each of the five fits leaves out every fifth line, starting at another one, so that each line is predicted once.
    Lines whose noise exceeds 30 % are ignored.
    """
    used, unused = [], []
    for fold in range(_FOLDS):
        out = [np.arange(frf.frequency.size) % _FOLDS == fold for frf in responses]
        # from the solution, so that a few steps suffice and no fold ends in another minimum
        part = refine(
            model,
            unknowns,
            responses,
            use=[~left_out for left_out in out],
            start=refined.values,
            steps=_FEW,
            model_error=refined.model_error,
        )
        for (response, _), frf, left in zip(model(part.values), responses, out, strict=True):
            apart, above_noise = np.abs(np.log(response / frf.response)) ** 2, lines_above_noise(frf)
            unused.append(apart[left & above_noise])
            used.append(apart[~left & above_noise])
    return float(np.sqrt(np.mean(np.concatenate(used)))), float(np.sqrt(np.mean(np.concatenate(unused))))


def lines_above_noise(frf: FRF) -> np.ndarray:
    """Return a mask of the frequency lines above the noise, or of all lines if hardly any is above it.

    The variance of a line is estimated from few averages, so that some lines in the noise seem to be certain by chance.
    Therefore the median over the neighboring lines must also be below `OPEN_LINE`.
    """
    if frf.variance is None:
        return np.ones(frf.frequency.size, bool)
    from scipy.ndimage import median_filter  # takes a second to import

    share = frf.variance / frf.magnitude**2
    above_noise = np.maximum(share, median_filter(share, _AROUND, mode="nearest")) < OPEN_LINE**2
    return above_noise if np.count_nonzero(above_noise) >= 2 * _FOLDS else np.ones(above_noise.size, bool)


def advice(name: str, band: tuple[float, float], mass: float, error: float, units: ResponseUnits) -> str:
    """Return the reason why these frequency lines do not identify a parameter, and what to measure next; `band` is in
    Hz.
    """
    low, high = band
    last = name.rsplit(".", 1)[-1]
    known = Text(f"its standard error is {Quantity(error):2}")
    viscous = Text(f"its standard error is {Quantity(error, units.of('N s/m')):2}")
    match last:
        case "viscous_motor" | "viscous_load" | "viscous":
            # the phase of 1/(M s² + B s) leaves -180° by 3° where B = M ω/20
            below = error / (2.0 * np.pi * max(mass, 1e-300))
            return Text(
                f"{viscous}: inertia hides it above {Quantity(below, 'Hz'):2}, and the lowest line is at "
                f"{Quantity(low, 'Hz'):3}; fix it, or take it from runs at constant speeds (a friction curve), which "
                "show the total viscous friction"
            )
        case "damping" | "damping_ratio":
            return Text(
                f"{known if last == 'damping_ratio' else viscous}: no line lies close enough to the top of the "
                "resonance; measure next at least five lines within its width at -3 dB, 2 ζ f"
            )
        case "current_loop":
            return Text(
                f"its standard error is {Quantity(error, 'Hz'):2}: below {Quantity(high, 'Hz'):3} a lag looks like a "
                "dead time; fix one of both (the drive's manual states the bandwidth of its current loop), or measure "
                "next up to that bandwidth"
            )
        case "mass_motor" | "mass_load" | "stiffness" | "mass" | "coupling_mass":
            return Text(
                f"{known}: measure next with lines on both sides of the antiresonance and of the resonance, at the "
                "motor's encoder too, with more amplitude or more periods where the coherence is low"
            )
        case _:
            return Text(f"{known}: more than half of its value; measure next more lines or more periods where it acts")


def beyond(resonance: Estimate, band: tuple[float, float]) -> list[str]:
    """Return a remark on a resonance in Hz outside the measured band, or an empty list if it is inside."""
    low, high = band
    if low <= resonance.value <= high:
        return []
    surely = resonance.error <= 0.5 * resonance.value
    where = Text(f"at {resonance.quantity} ") if surely else ""
    last = (
        Text(f"up to {Quantity(1.5 * resonance.value if surely else 3.0 * high, 'Hz'):3}")
        if resonance.value > high or not surely
        else Text(f"from {Quantity(0.5 * resonance.value, 'Hz'):3}")
    )
    return [
        Text(
            f"the resonance {where}lies beyond the lines ({span(low, high, 'Hz')}): "
            "its masses and its stiffness follow only from the slope of the response towards it, which any further "
            f"mode changes, too; measure next {last}"
        )
    ]


def entangled(names: Sequence[str], refined: Refined) -> list[str]:
    """Return remarks on parameters of which the frequency lines determine only a combination.

    They follow from the singular values of the Jacobian with columns scaled to length one: if one of them is
    nearly zero, the parameters can change together in its direction without a visible effect.
    """
    return [
        Text(
            f"{', '.join(together)} are distinguished only by {Quantity(share, 'share'):2} of the effect of each on "
            "the responses: fix one of them, or measure over a wider band"
        )
        for share, together in _combinations(names, refined)
    ]


def blind(estimates: Sequence[Estimate], refined: Refined) -> dict[str, str]:
    """Return the reasons why parameters are not identifiable, by name of the parameter.

    These parameters have errors above 10 % and belong to a nearly undetermined combination.  Their standard errors
    would be valid only if the model were exact to 1 % of the effect of each parameter.
    """
    gone: dict[str, str] = {}
    for share, together in _combinations([estimate.name for estimate in estimates], refined):
        for estimate in estimates:
            if share < _BLIND and estimate.name in together and estimate.error > _SURE * abs(estimate.value):
                others = ", ".join(name for name in together if name != estimate.name)
                gone.setdefault(
                    estimate.name,
                    Text(
                        f"it is distinguished from {others} by {Quantity(share, 'share'):2} of its effect on the "
                        "responses, less than the accuracy of a model, and its standard error is "
                        f"{Quantity(estimate.error, estimate.unit):2}; fix one of them (--fix), from a data sheet"
                    ),
                )
    return gone


def _combinations(names: Sequence[str], refined: Refined) -> list[tuple[float, list[str]]]:
    """Return the groups of parameters determined only in combination, with their singular value (0: collinear)."""
    loose = [i for i in range(len(names)) if not refined.bound[i]]
    size = np.linalg.norm(refined.slopes[:, loose], axis=0)
    seen = [i for i, s in zip(loose, size, strict=True) if s > 0.0]
    if len(seen) < 2:
        return []
    columns = refined.slopes[:, seen] / np.linalg.norm(refined.slopes[:, seen], axis=0)
    _, values, rows = np.linalg.svd(columns, full_matrices=False)
    combined: list[tuple[float, list[str]]] = []
    for value, row in zip(values[::-1], np.abs(rows[::-1]), strict=True):
        # two columns of correlation r have singular values √(1 ± r)
        if value > np.sqrt(1.0 - _TIED):
            break
        together = [names[i] for i, share in zip(seen, row, strict=True) if share > 0.3 * row.max()]
        combined.append((float(value), together))
    return combined
