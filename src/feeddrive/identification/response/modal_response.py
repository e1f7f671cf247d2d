"""Responses of a rigid body and modes in parallel with their derivatives, and the start poles of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.identification.response.refine import Unknown

_TURNS = 12


def common_poles(
    s: Sequence[np.ndarray], responses: Sequence[np.ndarray], pairs: int, reals: int, *, power: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Poles of `pairs` resonances, those with positive imaginary part, and the height of each peak above the response.

    Each response is fitted by Σ c/(s - p) + d with the same poles, in least squares weighted by |G|^-power: 1 for
    equal shares of peaks and valleys, 0.5 where valleys are all noise.  Poles move to the zeros of
    σ(s) = Σ c̃/(s - p) + d̃ until σ is one; unstable poles are mirrored.
    Sources: Gustavsen & Semlyen 1999; Gustavsen 2006 (relaxed); Deschrijver et al. 2008 (one QR a response).
    """
    low, high = min(float(abs(each[0])) for each in s), max(float(abs(each[-1])) for each in s)
    poles = np.geomspace(1.2 * low, high / 1.2, max(pairs, 1))[:pairs] * (-0.01 + 1j)
    real = -np.geomspace(low, high, reals + 2)[1:-1]
    weights = [np.abs(each) ** -power for each in responses]
    for _ in range(_TURNS):
        poles, real = _moved(s, responses, weights, poles, real)
    heights = np.zeros(poles.size)
    for each, response, weight in zip(s, responses, weights, strict=True):
        P = np.column_stack([_basis(each, poles, real), np.ones(each.size)])
        found = _solved(P * weight[:, None], response * weight)
        residues = np.abs(found[0 : 2 * poles.size : 2] + 1j * found[1 : 2 * poles.size : 2])
        level = np.interp(np.abs(poles), np.abs(each), np.abs(response))
        heights = np.maximum(heights, residues / np.maximum(-np.real(poles), 1e-12 * np.abs(poles)) / level)
    return poles, heights


def _basis(s: np.ndarray, poles: np.ndarray, real: np.ndarray) -> np.ndarray:
    """Two real basis functions a pair and one a real pole, shape (lines, functions)."""
    a, b = 1.0 / (s[:, None] - poles), 1.0 / (s[:, None] - np.conj(poles))
    pairs = np.stack([a + b, 1j * (a - b)], axis=2).reshape(s.size, -1)
    return np.hstack([pairs, 1.0 / (s[:, None] - real)])


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Real least squares of complex equations, columns scaled."""
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
    for each, response, weight in zip(s, responses, weights, strict=True):
        basis = np.column_stack([_basis(each, poles, real), np.ones(each.size)])
        both = np.hstack([basis, -response[:, None] * basis]) * weight[:, None]
        reduced = np.asarray(np.linalg.qr(np.vstack([np.real(both), np.imag(both)]), mode="r"))
        rows.append(reduced[count + 1 :, count + 1 :])
        right.append(np.zeros(rows[-1].shape[0]))
        relaxed += np.real(basis).sum(axis=0)
        size += float(np.sum(np.abs(response * weight) ** 2))
    # Σ Re σ = number of lines: without it the solution would be zero
    scale = np.sqrt(size) / sum(each.size for each in s)
    matrix = np.vstack([*rows, scale * relaxed])
    values = np.concatenate([*right, [scale * sum(each.size for each in s)]])
    columns = np.linalg.norm(matrix, axis=0) + 1e-300
    found = np.linalg.lstsq(matrix / columns, values, rcond=None)[0] / columns
    direct = found[-1] if abs(found[-1]) > 1e-8 else 1e-8
    moving, drive = np.zeros((count, count)), np.zeros(count)
    for i, pole in enumerate(poles):
        moving[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
        drive[2 * i] = 2.0
    for i, value in enumerate(real):
        moving[2 * poles.size + i, 2 * poles.size + i] = value
        drive[2 * poles.size + i] = 1.0
    zeros = np.linalg.eigvals(moving - np.outer(drive, found[:-1]) / direct)
    zeros = np.where(np.real(zeros) > 0.0, -np.conj(zeros), zeros)
    upper = zeros[np.imag(zeros) > 1e-9 * np.abs(zeros)]
    return upper[np.argsort(np.abs(upper))], np.real(zeros[np.abs(np.imag(zeros)) <= 1e-9 * np.abs(zeros)])


@dataclass(frozen=True, eq=False)
class ModalResponse:
    """x/f = e^(-s·dead_time) · s^order · [ free/(s (s + corner)) + Σ (residue + skew s/ω)/(s² + 2ζωs + ω²) + rest ]

    for each output, with common ω, ζ, corner and dead time; the parameters are stacked as
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
        """The number of parameters that all outputs share."""
        return 2 * self.modes + 2

    @property
    def own(self) -> int:
        """The number of separate parameters of each output."""
        return 2 * self.modes + 2

    def on(self, frequencies: Sequence[np.ndarray], /) -> ModalResponse:
        """The same model on other lines in Hz."""
        return replace(self, s=tuple(2j * np.pi * f for f in frequencies))

    def shapes(self, s: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """The regressors of free motion, residues and remainder, without delay; shape (lines, 2 modes + 2)."""
        k = self.modes
        omega, ratio, corner = 2.0 * np.pi * parameters[:k], parameters[k : 2 * k], parameters[2 * k]
        factor = s**self.order
        free = factor / (s * (s + corner)) if self.rigid else np.zeros(s.size, complex)
        poles = (factor / ((s * s)[:, None] + 2.0 * np.outer(s, ratio * omega) + omega**2).T).T
        turned = poles * (s[:, None] / omega if self.skewed else 0.0)
        return np.column_stack([free, poles, turned, factor if self.rest else np.zeros(s.size, complex)])

    def __call__(self, parameters: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Response and slopes of each output."""
        k, n = self.modes, self.common
        omega, ratio, corner, late = (
            2.0 * np.pi * parameters[:k], parameters[k : 2 * k], parameters[2 * k], parameters[2 * k + 1],
        )  # fmt: skip
        found: list[tuple[np.ndarray, np.ndarray]] = []
        for i, s in enumerate(self.s):
            place = n + i * self.own
            weights = parameters[place : place + self.own]
            delay = np.exp(-s * late)
            shapes = self.shapes(s, parameters) * delay[:, None]
            response = shapes @ weights
            slopes = np.zeros((s.size, parameters.size), complex)
            slopes[:, place : place + self.own] = shapes
            turned = shapes[:, k + 1 : 2 * k + 1] * weights[k + 1 : 2 * k + 1]
            inner = shapes[:, 1 : k + 1] * weights[1 : k + 1] + turned
            denominator = (s * s)[:, None] + 2.0 * np.outer(s, ratio * omega) + omega**2
            slopes[:, :k] = -inner * 2.0 * np.pi * (2.0 * np.outer(s, ratio) + 2.0 * omega) / denominator
            slopes[:, :k] -= turned / parameters[:k]
            slopes[:, k : 2 * k] = -inner * 2.0 * np.outer(s, omega) / denominator
            slopes[:, 2 * k] = -weights[0] * shapes[:, 0] / (s + corner)
            slopes[:, 2 * k + 1] = -s * response
            found.append((response, slopes))
        return found


class Poles:
    """Resonances that several responses share, found once for each number and weight that is asked."""

    def __init__(self, model: ModalResponse, responses: Sequence[np.ndarray], dead_time: float | None) -> None:
        late = dead_time or 0.0
        self.s = model.s
        # twice differentiated, a rigid motion is a constant
        self.rising = [g * np.exp(s * late) * s ** (2 - model.order) for s, g in zip(model.s, responses, strict=True)]
        self.found: dict[tuple[int, float], tuple[np.ndarray, np.ndarray]] = {}

    def most(self, wanted: int, pairs: int, power: float) -> np.ndarray | None:
        """The `wanted` most pronounced of `pairs` resonances, by frequency; None if there are fewer."""
        if wanted == 0:
            return np.zeros(0, complex)
        if (pairs, power) not in self.found:
            self.found[pairs, power] = common_poles(self.s, self.rising, pairs, 1, power=power)
        poles, heights = self.found[pairs, power]
        alive = np.flatnonzero(-np.real(poles) < 0.5 * np.abs(poles))
        if alive.size < wanted:
            return None
        return poles[np.sort(alive[np.argsort(-heights[alive])][:wanted])]


def begun(
    model: ModalResponse, responses: Sequence[np.ndarray], chosen: np.ndarray, dead_time: float | None
) -> tuple[float, np.ndarray]:
    """Parameters to start from, with the poles of the modes: weights by least squares of relative errors.

    The sum of their squares comes first.  Dead time and corner are those of a coarse search.
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
    """The parameters of the model by name; `unit` is that of a response in position, as m/N."""
    k = model.modes
    number = [str(i + 1) for i in range(k)]
    found = [Unknown(f"frequency_{i}", "Hz", start[j], positive=True) for j, i in enumerate(number)]
    found += [
        Unknown(f"damping_ratio_{i}", "", start[k + j], positive=True, least=1e-5, most=2.0)
        for j, i in enumerate(number)
    ]
    lowest = min(float(abs(s[0])) for s in model.s)
    highest = max(float(abs(s[-1])) for s in model.s)
    corner = min(max(start[2 * k], 1e-3 * lowest), highest)
    found.append(Unknown("corner", "1/s", corner, positive=True, least=1e-4 * lowest, most=highest))
    found.append(Unknown("dead_time", "s", start[2 * k + 1], scale=0.1 / highest))
    for i, name in enumerate(outputs):
        weights = start[model.common + i * model.own : model.common + (i + 1) * model.own]
        of = f"_{name}" if name else ""
        top = float(np.max(np.abs(weights[: k + 1]), initial=0.0)) or 1.0
        found.append(Unknown(f"free{of}", f"{unit}/s2", weights[0], scale=abs(weights[0]) or top))
        found += [
            Unknown(
                f"residue_{number[j]}{of}", f"{unit}/s2", weights[1 + j], scale=max(abs(weights[1 + j]), 1e-3 * top)
            )
            for j in range(k)
        ]
        found += [
            Unknown(
                f"skew_{number[j]}{of}", f"{unit}/s2", weights[1 + k + j], scale=max(abs(weights[1 + j]), 1e-3 * top)
            )
            for j in range(k)
        ]
        found.append(Unknown(f"rest{of}", unit, weights[-1], scale=max(abs(weights[-1]), top / highest**2)))
    return found
