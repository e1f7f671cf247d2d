"""Modal fit of one or several frequency responses without starting values: frequencies, damping ratios, residues."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from feeddrive.identification.regression import Estimate, estimates_table
from feeddrive.identification.response.agreement import Agreement, agreement
from feeddrive.identification.response.refine import Refined, ResponseUnits, Unknown, refine, taken
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, span, unit_name
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.frequency_response import FRF

# Responses of a rigid body and modes in parallel with their derivatives, and the start poles of a fit.

# relocations converge within a few turns, and the fit that follows moves the poles anyway
_TURNS = 12


def common_poles(
    s: Sequence[np.ndarray], responses: Sequence[np.ndarray], pairs: int, reals: int, *, power: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the poles of `pairs` resonances with positive imaginary part and their peak heights, by vector fitting.

    The responses are fitted by Σ c/(s - p) + d with common poles, by least squares weighted with |G|^-power: a power of
    1 gives peaks and valleys equal weight, 0.5 is for valleys that contain only noise.  Heights are relative to the
    response.  Poles are relocated to the zeros of σ(s) = Σ c̃/(s - p) + d̃ until σ is one; unstable poles are mirrored.
    Sources: Gustavsen & Semlyen 1999; Gustavsen 2006 (relaxed); Deschrijver et al. 2008 (one QR per response).
    """
    low, high = min(float(abs(points[0])) for points in s), max(float(abs(points[-1])) for points in s)
    # weakly damped start poles, as in the source: real or strongly damped ones give an ill-conditioned basis
    poles = np.geomspace(1.2 * low, high / 1.2, max(pairs, 1))[:pairs] * (-0.01 + 1j)
    real = -np.geomspace(low, high, reals + 2)[1:-1]
    weights = [np.abs(response) ** -power for response in responses]
    for _ in range(_TURNS):
        poles, real = _moved(s, responses, weights, poles, real)
    heights = np.zeros(poles.size)
    for points, response, weight in zip(s, responses, weights, strict=True):
        P = np.column_stack([_basis(points, poles, real), np.ones(points.size)])
        solution = _solved(P * weight[:, None], response * weight)
        residues = np.abs(solution[0 : 2 * poles.size : 2] + 1j * solution[1 : 2 * poles.size : 2])
        level = np.interp(np.abs(poles), np.abs(points), np.abs(response))
        heights = np.maximum(heights, residues / np.maximum(-np.real(poles), 1e-12 * np.abs(poles)) / level)
    return poles, heights


def _basis(s: np.ndarray, poles: np.ndarray, real: np.ndarray) -> np.ndarray:
    """Return two real basis functions for each pair and one for each real pole, shape (lines, functions)."""
    a, b = 1.0 / (s[:, None] - poles), 1.0 / (s[:, None] - np.conj(poles))
    pairs = np.stack([a + b, 1j * (a - b)], axis=2).reshape(s.size, -1)
    return np.hstack([pairs, 1.0 / (s[:, None] - real)])


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve complex equations for real unknowns by least squares, with scaled columns."""
    stacked = np.vstack([np.real(matrix), np.imag(matrix)])
    scale = np.linalg.norm(stacked, axis=0) + 1e-300
    return np.linalg.lstsq(stacked / scale, np.concatenate([np.real(right), np.imag(right)]), rcond=None)[0] / scale


def _moved(
    s: Sequence[np.ndarray],
    responses: Sequence[np.ndarray],
    weights: Sequence[np.ndarray],
    poles: np.ndarray,
    real: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    count = 2 * poles.size + real.size
    rows, right, relaxed, size = [], [], np.zeros(count + 1), 0.0
    for lines, response, weight in zip(s, responses, weights, strict=True):
        basis = np.column_stack([_basis(lines, poles, real), np.ones(lines.size)])
        both = np.hstack([basis, -response[:, None] * basis]) * weight[:, None]
        # only the part below the residues of this response concerns the common poles: the rest of the factor is dropped
        reduced = np.asarray(np.linalg.qr(np.vstack([np.real(both), np.imag(both)]), mode="r"))
        rows.append(reduced[count + 1 :, count + 1 :])
        right.append(np.zeros(rows[-1].shape[0]))
        relaxed += np.real(basis).sum(axis=0)
        size += float(np.sum(np.abs(response * weight) ** 2))
    # Σ Re σ = number of lines: without it the solution would be zero
    scale = np.sqrt(size) / sum(lines.size for lines in s)
    matrix = np.vstack([*rows, scale * relaxed])
    values = np.concatenate([*right, [scale * sum(lines.size for lines in s)]])
    columns = np.linalg.norm(matrix, axis=0) + 1e-300
    solution = np.linalg.lstsq(matrix / columns, values, rcond=None)[0] / columns
    # a d̃ near 0 would throw the zeros of σ to infinity
    direct = solution[-1] if abs(solution[-1]) > 1e-8 else 1e-8
    moving, drive = np.zeros((count, count)), np.zeros(count)
    for i, pole in enumerate(poles):
        moving[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
        drive[2 * i] = 2.0
    for i, value in enumerate(real):
        moving[2 * poles.size + i, 2 * poles.size + i] = value
        drive[2 * poles.size + i] = 1.0
    zeros = np.linalg.eigvals(moving - np.outer(drive, solution[:-1]) / direct)
    zeros = np.where(np.real(zeros) > 0.0, -np.conj(zeros), zeros)
    upper = zeros[np.imag(zeros) > 1e-9 * np.abs(zeros)]
    return upper[np.argsort(np.abs(upper))], np.real(zeros[np.abs(np.imag(zeros)) <= 1e-9 * np.abs(zeros)])


@dataclass(frozen=True, eq=False)
class ModalResponse:
    """The response of a rigid body and modes in parallel, for several outputs.

        x/f = e^(-s·dead_time) · s^order · [ free/(s (s + corner)) + Σ (residue + skew s/ω)/(s² + 2ζωs + ω²) + rest ]

    All outputs have common ω, ζ, corner and dead time; the parameters are stacked as
    [frequency ..., damping ..., corner, dead_time, then for each output: free, residue ..., skew ..., rest].
    A `skew` of zero is proportional damping: all points of a mode move in phase.
    """

    s: tuple[np.ndarray, ...]
    order: int
    modes: int
    rigid: bool
    rest: bool
    skewed: bool

    @property
    def common(self) -> int:
        """The number of parameters common to all outputs."""
        return 2 * self.modes + 2

    @property
    def per_output(self) -> int:
        """The number of separate parameters of each output."""
        return 2 * self.modes + 2

    def on(self, frequencies: Sequence[np.ndarray], /) -> Self:
        """Return the model at other frequencies in Hz."""
        return replace(self, s=tuple(2j * np.pi * f for f in frequencies))

    def shapes(self, s: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Return the regressors of rigid-body motion, residues and rest, without delay, shape (lines, 2 modes + 2)."""
        k = self.modes
        omega, ratio, corner = 2.0 * np.pi * parameters[:k], parameters[k : 2 * k], parameters[2 * k]
        factor = s**self.order
        free = factor / (s * (s + corner)) if self.rigid else np.zeros(s.size, complex)
        poles = (factor / ((s * s)[:, None] + 2.0 * np.outer(s, ratio * omega) + omega**2).T).T
        turned = poles * (s[:, None] / omega if self.skewed else 0.0)
        return np.column_stack([free, poles, turned, factor if self.rest else np.zeros(s.size, complex)])

    def __call__(self, parameters: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the response of each output and its derivatives with respect to the parameters."""
        k, n = self.modes, self.common
        omega, ratio, corner, late = (
            2.0 * np.pi * parameters[:k],
            parameters[k : 2 * k],
            parameters[2 * k],
            parameters[2 * k + 1],
        )
        responses: list[tuple[np.ndarray, np.ndarray]] = []
        for i, s in enumerate(self.s):
            place = n + i * self.per_output
            weights = parameters[place : place + self.per_output]
            delay = np.exp(-s * late)
            shapes = self.shapes(s, parameters) * delay[:, None]
            response = shapes @ weights
            slopes = np.zeros((s.size, parameters.size), complex)
            slopes[:, place : place + self.per_output] = shapes
            turned = shapes[:, k + 1 : 2 * k + 1] * weights[k + 1 : 2 * k + 1]
            inner = shapes[:, 1 : k + 1] * weights[1 : k + 1] + turned
            denominator = (s * s)[:, None] + 2.0 * np.outer(s, ratio * omega) + omega**2
            slopes[:, :k] = -inner * 2.0 * np.pi * (2.0 * np.outer(s, ratio) + 2.0 * omega) / denominator
            slopes[:, :k] -= turned / parameters[:k]
            slopes[:, k : 2 * k] = -inner * 2.0 * np.outer(s, omega) / denominator
            slopes[:, 2 * k] = -weights[0] * shapes[:, 0] / (s + corner)
            slopes[:, 2 * k + 1] = -s * response
            responses.append((response, slopes))
        return responses


class Poles:
    """The common resonances of several responses, computed once for each number of resonances and weighting."""

    def __init__(self, model: ModalResponse, responses: Sequence[np.ndarray], dead_time: float | None) -> None:
        late = dead_time or 0.0
        self.s = model.s
        # twice differentiated, a rigid motion is a constant
        self.rising = [g * np.exp(s * late) * s ** (2 - model.order) for s, g in zip(model.s, responses, strict=True)]
        self.computed: dict[tuple[int, float], tuple[np.ndarray, np.ndarray]] = {}

    def most(self, wanted: int, pairs: int, power: float) -> np.ndarray | None:
        """Return the `wanted` most pronounced of `pairs` resonances, sorted by frequency; None if there are fewer."""
        if wanted == 0:
            return np.zeros(0, complex)
        if (pairs, power) not in self.computed:
            self.computed[pairs, power] = common_poles(self.s, self.rising, pairs, 1, power=power)
        poles, heights = self.computed[pairs, power]
        # strongly damped poles represent friction, dead time and lag, and are no modes
        alive = np.flatnonzero(-np.real(poles) < 0.5 * np.abs(poles))
        if alive.size < wanted:
            return None
        return poles[np.sort(alive[np.argsort(-heights[alive])][:wanted])]


def initial(
    model: ModalResponse, responses: Sequence[np.ndarray], chosen: np.ndarray, dead_time: float | None
) -> tuple[float, np.ndarray]:
    """Return initial parameters for given mode poles: linear ones by least squares on the relative errors.

    The first value is the sum of squared errors.  Dead time and corner are found by a coarse search.
    """
    late = [0.0] if dead_time is None else [dead_time]
    highest = max(float(abs(s[-1])) for s in model.s)
    if dead_time is None:
        late += [turn / highest for turn in (0.3, 0.8, 1.5, 2.5)]
    lowest = min(float(abs(s[0])) for s in model.s)
    shared = np.concatenate(
        [np.abs(chosen) / (2.0 * np.pi), np.clip(-np.real(chosen) / np.maximum(np.abs(chosen), 1e-12), 2e-3, 0.5)]
    )
    best: tuple[float, np.ndarray] | None = None
    for delay in late:
        for corner in (0.02 * lowest, 0.5 * lowest, 5.0 * lowest):
            parameters = np.concatenate([shared, [corner, delay]])
            error, parts = 0.0, [parameters]
            for s, g in zip(model.s, responses, strict=True):
                matrix = model.shapes(s, parameters) * (np.exp(-s * delay) / g)[:, None]
                stacked = np.vstack([np.real(matrix), np.imag(matrix)])
                scale = np.linalg.norm(stacked, axis=0)
                # a term that the model lacks has a column of 0, and its weight becomes 0
                scale[scale == 0.0] = np.inf
                wanted = np.concatenate([np.ones(s.size), np.zeros(s.size)])
                weights = np.linalg.lstsq(stacked / scale, wanted, rcond=None)[0] / scale
                error += float(np.sum((stacked @ weights - wanted) ** 2))
                parts.append(weights)
            if best is None or error < best[0]:
                best = error, np.concatenate(parts)
    assert best is not None
    return best


def unknowns(model: ModalResponse, start: np.ndarray, outputs: Sequence[str], unit: str) -> list[Unknown]:
    """Return the parameters of the model by name; `unit` is that of a position response, such as m/N."""
    k = model.modes
    number = [str(i + 1) for i in range(k)]
    parameters = [Unknown(f"frequency_{i}", "Hz", start[j], positive=True) for j, i in enumerate(number)]
    parameters += [
        Unknown(f"damping_ratio_{i}", "", start[k + j], positive=True, least=1e-5, most=2.0)
        for j, i in enumerate(number)
    ]
    lowest = min(float(abs(s[0])) for s in model.s)
    highest = max(float(abs(s[-1])) for s in model.s)
    corner = min(max(start[2 * k], 1e-3 * lowest), highest)
    parameters.append(Unknown("corner", "1/s", corner, positive=True, least=1e-4 * lowest, most=highest))
    parameters.append(Unknown("dead_time", "s", start[2 * k + 1], scale=0.1 / highest))
    for i, name in enumerate(outputs):
        weights = start[model.common + i * model.per_output : model.common + (i + 1) * model.per_output]
        of = f"_{name}" if name else ""
        top = float(np.max(np.abs(weights[: k + 1]), initial=0.0)) or 1.0
        parameters.append(Unknown(f"free{of}", f"{unit}/s2", weights[0], scale=abs(weights[0]) or top))
        parameters += [
            Unknown(
                f"residue_{number[j]}{of}", f"{unit}/s2", weights[1 + j], scale=max(abs(weights[1 + j]), 1e-3 * top)
            )
            for j in range(k)
        ]
        parameters += [
            Unknown(
                f"skew_{number[j]}{of}", f"{unit}/s2", weights[1 + k + j], scale=max(abs(weights[1 + j]), 1e-3 * top)
            )
            for j in range(k)
        ]
        parameters.append(Unknown(f"rest{of}", unit, weights[-1], scale=max(abs(weights[-1]), top / highest**2)))
    return parameters


# Modal fit of one or several frequency responses without start values: frequencies, damping ratios, residues.

_MOST_ASKED = 40
MOST = 8  # modes that are tried by default
_GAIN = 0.9  # ratio to which a further mode must lower the error
_FURTHER = 3  # modes that are tried beyond the best number so far
_GOOD = 0.1  # mean |ln(fitted/measured)|: above it further modes are tried, even if the last ones gained little
_STARTS = 3  # starts that are followed further
_FIRST = 20  # steps after which the best of several starts is chosen


@dataclass(frozen=True, eq=False, repr=False)
class FittedMode(Result):
    """A fitted mode: frequency, damping ratio, and the complex residue R = residue + j skew of each output."""

    frequency: Estimate
    damping_ratio: Estimate
    residues: tuple[complex, ...]

    def table(self) -> Table:
        """Return a table of frequency and damping ratio with their errors."""
        return estimates_table("mode", (self.frequency, self.damping_ratio))


@dataclass(frozen=True, eq=False, repr=False)
class ModalFit(Result):
    """The result of a modal fit; `values` and `covariance` are in the order of `unknowns`.

    modes      oscillating modes within the measured band, sorted by frequency; all other terms are in `beyond`
    estimates  every fitted parameter with its standard errors
    remarks    remarks based on the residuals and the errors
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
        estimates_by_name = {estimate.name: estimate for estimate in self.estimates}
        if name not in estimates_by_name:
            raise ParameterError(f"the fit has no parameter '{name}'; there are {', '.join(estimates_by_name)}")
        return estimates_by_name[name]

    def table(self) -> Table:
        """Return a table with one row for each mode."""
        heads = [
            "mode",
            Column("frequency", "Hz", "5"),
            Column("error", "Hz", "2"),
            Column("damping ratio", form=".4f"),
            Column("error", form="2"),
            *(Column(f"|residue| {name}") for name in self.outputs),
        ]
        rows = [
            [
                i,
                replace(mode.frequency.quantity, form="5"),
                mode.frequency.error,
                replace(mode.damping_ratio.quantity, form=".4f"),
                mode.damping_ratio.error,
                *map(abs, mode.residues),
            ]
            for i, mode in enumerate(self.modes, start=1)
        ]
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
    """Fit the common modes of several responses to one input.

        x/f = e^(-s·dead_time) [ free/(s (s + corner)) + Σ (residue + skew s/ω)/(s² + 2ζωs + ω²) + rest ]

    responses     position, velocity or acceleration over force or current, as stated by their unit
    modes         number of modes; None: as many as the frequency lines left out of the fit justify (at most 8)
    band          lowest and highest frequency of the lines used, Hz
    rigid         True if the axis moves freely at low frequencies
    proportional  True for real residues, skew = 0: all points of a mode move in phase, as in an undamped structure.
                  Friction and local dampers violate this
    rest          True to add a constant for all modes above the band
    progress      reports the number of modes being tried
    dead_time     dead time, s; None: it is fitted

    Initial values come from vector fitting; the cost is that of `refine`.  Each parameter has a standard error that is
    valid for correlated residuals.  Mode parameters of a model that lacks a mode are wrong by more than their
    errors: see `remarks`.
    Raises ParameterError for different units and for too few lines.
    Not suitable for masses and stiffnesses; see `fit_two_mass` and `fit_modal_axis`.
    """
    if modes is not None and not 0 <= modes <= _MOST_ASKED:
        raise ParameterError(f"modes = {modes} must be >= 0 and <= {_MOST_ASKED}")
    progress = progress or Progress()
    named = _named(responses)
    chosen, units = taken(named, band, None, None)
    outputs = tuple(chosen)
    frfs = list(chosen.values())
    candidates: list[tuple[float, ModalResponse, list[Unknown], Refined]] = []
    poles: Poles | None = None
    for count in range(MOST + 1) if modes is None else (modes,):
        model = ModalResponse(
            tuple(2j * np.pi * frf.frequency for frf in frfs), units.order, count, rigid, rest, not proportional
        )
        if sum(frf.frequency.size for frf in frfs) < 2 * (model.common + len(frfs) * model.per_output):
            break
        progress.step(f"{count} modes")
        poles = Poles(model, [frf.response for frf in frfs], dead_time) if poles is None else poles
        begin = _best_start(model, frfs, outputs, units, dead_time, poles)
        if begin is not None:
            candidates.append((begin[0], model, *begin[1:]))
        best = _simplest(candidates)
        if best is not None and best[0] < _GOOD and count >= best[1].modes + _FURTHER:
            break
    best = _simplest(candidates)
    if best is None:
        raise ParameterError(
            f"the responses do not hold {modes} resonances: take fewer modes, or give a band in which they stand out"
        )
    _, model, sought, best_start = best
    progress.step(f"{model.modes} modes, to the end")
    refined = refine(model, sought, frfs, start=best_start.values)
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


def _simplest(candidates: Sequence[tuple[float, ModalResponse, list[Unknown], Refined]]) -> Any:
    """Return the first candidate, sorted by number of modes, that no later one beats by 10 % per additional mode."""
    for i, (error, *_) in enumerate(candidates):
        rest = candidates[i + 1 :]
        if not any(other < error * _GAIN ** (more + 1) for more, (other, *_) in enumerate(rest)):
            return candidates[i]
    return None


def _best_start(
    model: ModalResponse,
    frfs: Sequence[FRF],
    outputs: Sequence[str],
    units: ResponseUnits,
    dead_time: float | None,
    poles: Poles,
) -> tuple[float, list[Unknown], Refined] | None:
    """Return the best of several automatic starts after a few steps of refinement.

    The best one has the smallest mean of |ln(fitted/measured)|, with each value limited to 1.
    """
    best: tuple[float, list[Unknown], Refined] | None = None
    arrays = [frf.response for frf in frfs]
    low, high = min(frf.frequency[0] for frf in frfs), max(frf.frequency[-1] for frf in frfs)
    starts: list[tuple[float, np.ndarray]] = []
    # poles in excess take up noise and dead time, so that the others stay at the resonances
    for extra in range(3 if model.modes else 1):
        for power in (1.0, 0.5):
            chosen = poles.most(model.modes, model.modes + extra, power)
            if chosen is not None:
                starts.append(initial(model, arrays, chosen, dead_time))
    for _, start in sorted(starts, key=lambda scored: scored[0])[:_STARTS]:
        sought = [
            _settled(parameter, model, dead_time, low, high)
            for parameter in unknowns(model, start, outputs, units.of("m/N"))
        ]
        refined = refine(model, sought, frfs, logarithmic=True, steps=_FIRST)
        far = float(np.mean(np.minimum(np.abs(np.concatenate(refined.residuals)), 1.0)))
        if best is None or far < best[0]:
            best = far, sought, refined
    return best


def _settled(unknown: Unknown, model: ModalResponse, dead_time: float | None, low: float, high: float) -> Unknown:
    """Return the unknown with its bounds; it is fixed if the model lacks the term or its value is prescribed."""
    kind = unknown.name.split("_")[0]
    absent = (kind == "rest" and not model.rest) or (kind == "skew" and not model.skewed)
    absent = absent or (kind in ("free", "corner") and not model.rigid)
    if kind == "frequency":
        unknown = replace(
            unknown, least=0.5 * low, most=2.0 * high, start=min(max(unknown.start, 0.5 * low), 2.0 * high)
        )
    # the corner is optimized by its logarithm and cannot start at 0
    if absent and kind != "corner":
        return replace(unknown, start=0.0, fixed=True)
    if unknown.name == "dead_time" and dead_time is not None:
        return replace(unknown, start=dead_time, fixed=True)
    return replace(unknown, fixed=absent)


def _frequencies(modes: Sequence[FittedMode]) -> Text:
    """Return the frequencies of modes as text, with one unit."""
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
        Estimate(parameter.name, float(v), parameter.unit, float(e), float(o))
        for parameter, v, e, o in zip(sought, refined.values, errors, plain, strict=True)
    ]
    k = model.modes
    fit = agreement(model, sought, frfs, refined, units.order)
    low, high = min(frf.frequency[0] for frf in frfs), max(frf.frequency[-1] for frf in frfs)
    inside: list[FittedMode] = []
    beyond: list[FittedMode] = []
    for i in np.argsort(refined.values[:k]):
        places = [model.common + j * model.per_output for j in range(len(outputs))]
        residues = tuple(complex(refined.values[p + 1 + i], refined.values[p + 1 + k + i]) for p in places)
        mode = FittedMode(every[i], every[k + i], residues)
        rings = mode.damping_ratio.value < 1.0
        (inside if rings and low <= mode.frequency.value <= high else beyond).append(mode)
    remarks = fit.remarks()
    for mode in inside:
        if mode.damping_ratio.error > 0.5 * mode.damping_ratio.value:
            width = 2.0 * mode.damping_ratio.value * mode.frequency.value
            remarks.append(
                Text(
                    f"the damping ratio of the mode at {Quantity(mode.frequency.value, 'Hz')} is not identifiable "
                    f"({mode.damping_ratio.quantity}): measure next at least five lines within "
                    f"{Quantity(max(width, 0.002 * mode.frequency.value), 'Hz'):2} around it"
                )
            )
    lags = [mode for mode in beyond if mode.damping_ratio.value >= 1.0]
    if lags:
        remarks.append(
            Text(
                f"terms at {_frequencies(lags)} do not oscillate (damping ratio of 1 or more): they represent a lag, "
                "such as that of the current loop, or friction, and are not modes"
            )
        )
    if len(beyond) > len(lags):
        ringing = [mode for mode in beyond if mode not in lags]
        remarks.append(
            Text(
                f"resonances at {_frequencies(ringing)} represent the response beyond the lines "
                f"({span(low, high, 'Hz')}): not identifiable; measure next up to "
                f"{Quantity(2.0 * high, 'Hz')}"
            )
        )
    if not refined.settled:
        remarks.append("the minimization did not converge: limit the band to high coherence, or take fewer modes")
    estimates = tuple(e for e, parameter in zip(every, sought, strict=True) if not parameter.fixed)
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
        tuple(remarks),
    )
