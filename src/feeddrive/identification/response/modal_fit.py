"""Modal fit of one or several frequency responses without start values: frequencies, damping ratios, residues."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feeddrive.identification.estimate import Estimate, estimates_table
from feeddrive.identification.response.agreement import Agreement, agreement
from feeddrive.identification.response.modal_response import ModalResponse, Poles, begun, unknowns
from feeddrive.identification.response.refine import Refined, Unknown, refine
from feeddrive.identification.response.units import ResponseUnits, taken
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.frequency_response import FRF

_MOST_ASKED = 40
MOST = 8  # modes that are tried by default
_GAIN = 0.9  # ratio to which a further mode must lower the error
_FURTHER = 3  # modes that are tried beyond the best number so far
_GOOD = 0.1  # mean |ln(fitted/measured)|: above it further modes are tried, even if the last ones gained little
_STARTS = 3  # starts that are followed further
_FIRST = 20  # steps after which the best of several starts is chosen


@dataclass(frozen=True, eq=False, repr=False)
class FittedMode(Result):
    """One mode: Hz, damping ratio, and by output the complex residue R = residue + j skew at its own frequency."""

    frequency: Estimate
    damping_ratio: Estimate
    residues: tuple[complex, ...]

    def table(self) -> Table:
        """Both with their errors."""
        return estimates_table("mode", (self.frequency, self.damping_ratio))


@dataclass(frozen=True, eq=False, repr=False)
class ModalFit(Result):
    """Result of a modal fit; `values` and `covariance` in the order of `unknowns`.

    modes      by frequency, only oscillating ones within the lines; all other terms are in `beyond`
    estimates  every parameter that was sought, with its standard errors
    remarks    remarks that follow from the residuals and the errors
    """

    modes: tuple[FittedMode, ...]
    beyond: tuple[FittedMode, ...]
    estimates: tuple[Estimate, ...]
    agreement: Agreement
    model: ModalResponse
    values: np.ndarray
    covariance: np.ndarray
    units: ResponseUnits
    outputs: tuple[str, ...]
    remarks: tuple[str, ...]

    def __getitem__(self, name: str) -> Estimate:
        found = {each.name: each for each in self.estimates}
        if name not in found:
            raise ParameterError(f"the fit has no parameter '{name}'; there are {', '.join(found)}")
        return found[name]

    def table(self) -> Table:
        """One row a mode."""
        heads = [
            "mode", Column("frequency", "Hz", "5"), Column("error", "Hz", "2"), Column("damping ratio", form=".4f"),
            Column("error", form="2"), *(Column(f"|residue| {name}") for name in self.outputs),
        ]  # fmt: skip
        rows = [
            [i, replace(mode.frequency.quantity, form="5"), mode.frequency.error,
             replace(mode.damping_ratio.quantity, form=".4f"), mode.damping_ratio.error, *map(abs, mode.residues)]
            for i, mode in enumerate(self.modes, start=1)
        ]  # fmt: skip
        fit = self.agreement
        title = Text(
            f"{len(self.modes)} modes; unused lines are predicted within {Quantity(8.686 * fit.unused, 'dB'):.2f} RMS"
        )
        return Table(title, heads, rows)


def fit_modes(
    responses: FRF | Sequence[FRF] | Mapping[str, FRF],
    modes: int | None = None,
    *,
    band: tuple[float, float] | None = None,
    rigid: bool = True,
    proportional: bool = False,
    rest: bool = False,
    dead_time: float | None = None,
    progress: Progress | None = None,
) -> ModalFit:
    """Modes that several responses to one input have in common.

        x/f = e^(-s·dead_time) [ free/(s (s + corner)) + Σ (residue + skew s/ω)/(s² + 2ζωs + ω²) + rest ]

    responses     position, velocity or acceleration over force or current; their unit says which
    modes         how many; None: as many as lines that were not used support (at most 8)
    band          Hz, lowest and highest line that counts
    rigid         whether the axis moves freely at low frequencies
    proportional  residues are real, skew = 0: all points of a mode move in phase, as in an undamped structure. Friction
                  and local dampers violate this
    rest          a constant for all modes above the band
    progress      reports the number of modes that are tried
    dead_time     s; None: it is found

    The start comes from vector fitting; the cost is that of `refine`.  Each parameter has a standard error that is
    valid for correlated residuals.  Mode parameters of a model that lacks a mode are wrong by more than their
    errors: see `remarks`.
    Raises ParameterError for units that differ and for too few lines.
    When not: for masses and stiffnesses; see `fit_two_mass` and `fit_modal_axis`.
    """
    if modes is not None and not 0 <= modes <= _MOST_ASKED:
        raise ParameterError(f"modes = {modes} must be >= 0 and <= {_MOST_ASKED}")
    progress = progress or Progress()
    named = _named(responses)
    chosen, units = taken(named, band, None, None)
    outputs = tuple(chosen)
    frfs = list(chosen.values())
    found: list[tuple[float, ModalResponse, list[Unknown], Refined]] = []
    poles: Poles | None = None
    for count in range(MOST + 1) if modes is None else (modes,):
        model = ModalResponse(
            tuple(2j * np.pi * frf.frequency for frf in frfs), units.order, count, rigid, rest, not proportional
        )
        if sum(frf.frequency.size for frf in frfs) < 2 * (model.common + len(frfs) * model.own):
            break
        progress.step(f"{count} modes")
        poles = Poles(model, [frf.response for frf in frfs], dead_time) if poles is None else poles
        begin = _begun(model, frfs, outputs, units, dead_time, poles)
        if begin is not None:
            found.append((begin[0], model, *begin[1:]))
        best = _simplest(found)
        if best is not None and best[0] < _GOOD and count >= best[1].modes + _FURTHER:
            break
    best = _simplest(found)
    if best is None:
        raise ParameterError(
            f"the responses do not hold {modes} resonances: take fewer modes, or give a band in which they stand out"
        )
    _, model, sought, begun_at = best
    progress.step(f"{model.modes} modes, to the end")
    refined = refine(model, sought, frfs, start=begun_at.values)
    return _result(model, sought, refined, frfs, outputs, units)


def _named(responses: FRF | Sequence[FRF] | Mapping[str, FRF]) -> dict[str, FRF]:
    if isinstance(responses, FRF):
        return {"": responses}
    if isinstance(responses, Mapping):
        return dict(responses)
    names = [frf.output for frf in responses]
    if len(set(names)) < len(names):
        names = [f"{i + 1}" for i in range(len(names))]
    return dict(zip(names, responses, strict=True))


def _simplest(found: Sequence[tuple[float, ModalResponse, list[Unknown], Refined]]) -> Any:
    """The one with the fewest modes, if no larger one is better by a tenth per mode."""
    for i, (error, *_) in enumerate(found):
        rest = found[i + 1 :]
        if not any(other < error * _GAIN ** (more + 1) for more, (other, *_) in enumerate(rest)):
            return found[i]
    return None


def _begun(
    model: ModalResponse,
    frfs: Sequence[FRF],
    outputs: Sequence[str],
    units: ResponseUnits,
    dead_time: float | None,
    poles: Poles,
) -> tuple[float, list[Unknown], Refined] | None:
    """The best of several automatic starts, after a few steps, by its mean |ln(fitted/measured)|, at most 1 a line."""
    best: tuple[float, list[Unknown], Refined] | None = None
    arrays = [frf.response for frf in frfs]
    low, high = min(frf.frequency[0] for frf in frfs), max(frf.frequency[-1] for frf in frfs)
    starts: list[tuple[float, np.ndarray]] = []
    for extra in range(3 if model.modes else 1):
        for power in (1.0, 0.5):
            chosen = poles.most(model.modes, model.modes + extra, power)
            if chosen is not None:
                starts.append(begun(model, arrays, chosen, dead_time))
    for _, start in sorted(starts, key=lambda each: each[0])[:_STARTS]:
        sought = [
            _settled(each, model, dead_time, low, high) for each in unknowns(model, start, outputs, units.of("m/N"))
        ]
        found = refine(model, sought, frfs, logarithmic=True, steps=_FIRST)
        far = float(np.mean(np.minimum(np.abs(np.concatenate(found.residuals)), 1.0)))
        if best is None or far < best[0]:
            best = far, sought, found
    return best


def _settled(each: Unknown, model: ModalResponse, dead_time: float | None, low: float, high: float) -> Unknown:
    """An unknown, fixed as requested."""
    kind = each.name.split("_")[0]
    absent = (kind == "rest" and not model.rest) or (kind == "skew" and not model.skewed)
    absent = absent or (kind in ("free", "corner") and not model.rigid)
    if kind == "frequency":
        each = replace(each, least=0.5 * low, most=2.0 * high, start=min(max(each.start, 0.5 * low), 2.0 * high))
    if absent and kind != "corner":
        return replace(each, start=0.0, fixed=True)
    if each.name == "dead_time" and dead_time is not None:
        return replace(each, start=dead_time, fixed=True)
    return replace(each, fixed=absent)


def _frequencies(modes: Sequence[FittedMode]) -> Text:
    """Return the frequencies of some modes as a list with one unit."""
    frequencies = [Quantity(mode.frequency.value, "Hz", bare=True) for mode in modes]
    return Text(f"{joined(', ', map(format, frequencies))} {unit_name('Hz')}")


def _result(
    model: ModalResponse,
    sought: Sequence[Unknown],
    refined: Refined,
    frfs: Sequence[FRF],
    outputs: tuple[str, ...],
    units: ResponseUnits,
) -> ModalFit:
    errors, plain = (np.sqrt(np.maximum(np.diag(c), 0.0)) for c in (refined.covariance, refined.ols))
    every = [
        Estimate(each.name, float(v), each.unit, float(e), float(o))
        for each, v, e, o in zip(sought, refined.values, errors, plain, strict=True)
    ]
    k = model.modes
    fit = agreement(model, sought, frfs, refined, units.order)
    low, high = min(frf.frequency[0] for frf in frfs), max(frf.frequency[-1] for frf in frfs)
    inside: list[FittedMode] = []
    beyond: list[FittedMode] = []
    for i in np.argsort(refined.values[:k]):
        places = [model.common + j * model.own for j in range(len(outputs))]
        residues = tuple(complex(refined.values[p + 1 + i], refined.values[p + 1 + k + i]) for p in places)
        mode = FittedMode(every[i], every[k + i], residues)
        rings = mode.damping_ratio.value < 1.0
        (inside if rings and low <= mode.frequency.value <= high else beyond).append(mode)
    said = fit.remarks()
    for mode in inside:
        if mode.damping_ratio.error > 0.5 * mode.damping_ratio.value:
            width = 2.0 * mode.damping_ratio.value * mode.frequency.value
            said.append(
                Text(
                    f"the damping ratio of the mode at {Quantity(mode.frequency.value, 'Hz')} is not identifiable "
                    f"({mode.damping_ratio.quantity}): measure next at least five lines within "
                    f"{Quantity(max(width, 0.002 * mode.frequency.value), 'Hz'):2} around it"
                )
            )
    lags = [mode for mode in beyond if mode.damping_ratio.value >= 1.0]
    if lags:
        said.append(
            Text(
                f"terms at {_frequencies(lags)} do not oscillate (damping ratio of 1 or more): they represent a lag, "
                "such as that of the current loop, or friction, and are not modes"
            )
        )
    if len(beyond) > len(lags):
        ringing = [mode for mode in beyond if mode not in lags]
        said.append(
            Text(
                f"resonances at {_frequencies(ringing)} represent the response beyond the lines "
                f"({Quantity(low, 'Hz', bare=True)} to {Quantity(high, 'Hz')}): not identifiable; measure next up to "
                f"{Quantity(2.0 * high, 'Hz')}"
            )
        )
    if not refined.settled:
        said.append("the minimization did not converge: limit the band to high coherence, or take fewer modes")
    estimates = tuple(e for e, each in zip(every, sought, strict=True) if not each.fixed)
    return ModalFit(
        tuple(inside),
        tuple(beyond),
        estimates,
        fit,
        model,
        refined.values,
        refined.covariance,
        units,
        outputs,
        tuple(said),
    )
