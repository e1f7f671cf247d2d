"""Common poles of several responses without a start from the user: relaxed vector fitting."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_TURNS = 12


def common_poles(
    s: Sequence[np.ndarray], responses: Sequence[np.ndarray], pairs: int, reals: int, *, power: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Poles of `pairs` resonances, those with positive imaginary part, and how high each stands over the response.

    Each response is brought onto Σ c/(s - p) + d with the same poles, in least squares weighted by |G|^-power: 1 for
    equal shares of peaks and valleys, 0.5 where valleys are all noise.  Poles move to the zeros of
    σ(s) = Σ c̃/(s - p) + d̃ until σ is one; those that come out unstable are mirrored.
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
