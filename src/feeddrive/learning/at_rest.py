"""Friction at rest in a trial, modeled as an unknown force that holds the axis, and the resulting error."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from feeddrive.loop.linearize import StateSpace

# presliding of guideways and bearings ends within some 10 um of travel: nearer to a rest, friction has no level yet
BREAKAWAY = 1e-5  # m (rad) of set travel before and after a rest
SHORT = 0.01  # of the travel: largest part of a short move that counts as near a rest
# the force at rest differs from the regressors by the whole friction, whose effect is some ten times the noise of
# the error; a larger ratio would only pass more of the encoder's counts into the state
UNKNOWN = 5.0  # effect of the unknown force over the noise of the error
WALK = 0.05  # of its white variance: variance of the random walk of the unknown force, per sample


def force_unknown(position: np.ndarray, velocity: np.ndarray, dead_band: float) -> np.ndarray:
    """Return a mask of the samples at which sliding friction does not apply; all arrays have shape (n,).

    These are the samples at which the set velocity is within the dead band or reverses, and those within `BREAKAWAY` of
    travel around them.
    """
    n = position.size
    rest = np.abs(velocity) <= dead_band
    turns = np.flatnonzero(velocity[1:] * velocity[:-1] < 0.0)
    rest[turns] = rest[turns + 1] = True
    if not np.any(rest):
        return rest
    near = min(BREAKAWAY, SHORT * float(np.ptp(position)))
    rows = np.arange(n)
    before = np.maximum.accumulate(np.where(rest, rows, -1))
    after = np.minimum.accumulate(np.where(rest, rows, n)[::-1])[::-1]
    unknown = rest.copy()
    for there, at in ((before >= 0, np.maximum(before, 0)), (after < n, np.minimum(after, n - 1))):
        unknown |= there & (np.abs(position - position[at]) <= near)
    return unknown


def filtered_held(
    samples: Sequence[StateSpace],
    columns: np.ndarray,
    error: np.ndarray,
    unknown: np.ndarray,
    *,
    moving: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Filter columns, shape (n, columns), through Ĝ_d, with an unknown force in the samples where `unknown` is True.

        e = Ψ Δθ + e_rest + level · u0

    Returns Ψ, shape (n, columns), e - e_rest, shape (n,), and `level`, shape (n,): the response to a force of 1 N that
    the feedback supplies at the first sample.  In the samples of the mask, the force is modeled as large white noise,
    and the state of the model follows the measured error by its steady-state Kalman gain; elsewhere the model runs
    without correction. During a rest, the integral of the law therefore evolves as in the drive, regardless of the
    friction force.

    `samples` are the models of a period; with `moving`, the columns are assumed to have the values of row 0 before it.
    """
    N, n, count = len(samples), samples[0].A.shape[0], columns.shape[1]
    held = [_with_force(sample) for sample in samples]
    gains = _gains(samples, held)
    # at rest the error drives the model by the gain, in motion the columns do
    rest = _Stretch([(A - np.outer(K, c), K, c, 0.0) for (A, c), K in zip(held, gains, strict=True)])
    motion = _Stretch([(s.A, s.B[:, 0], s.C[0], float(s.D[0, 0])) for s in samples])
    # the periodic state that a constant force has reached
    through, pushed = np.eye(n), np.zeros((n, 1))
    for sample in samples:
        through, pushed = sample.A @ through, sample.A @ pushed + sample.B[:, :1]
    reached = np.linalg.solve(np.eye(n) - through, pushed)[:, 0] if n else np.zeros(0)
    state = np.zeros((n, count + 2))
    state[:, count + 1] = reached
    if moving:
        state[:, :count] = np.outer(reached, columns[0])
    driven, measured = (np.zeros((error.size, count + 2)) for _ in range(2))
    driven[:, :count], measured[:, count] = columns, error
    out = np.empty_like(driven)
    edges = [0, *(np.flatnonzero(np.diff(unknown)) + 1).tolist(), error.size]
    for begin, end in pairwise(edges):
        if unknown[begin]:
            # the unknown force begins at 0 and is forgotten in motion, where the regressors are the whole force
            whole = np.vstack([state, np.zeros((1, count + 2))])
            out[begin:end], whole = rest.run(begin % N, measured[begin:end], whole)
            state = whole[:n]
        else:
            out[begin:end], state = motion.run(begin % N, driven[begin:end], state)
    return out[:, :count], error - out[:, count], out[:, count + 1]


_BLOCK = 32  # samples that one product of matrices takes: some thousand samples need no loop over each


class _Stretch:
    """A periodic model with one input and one output, which filters many columns in blocks of samples."""

    def __init__(self, models: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, float]]) -> None:
        """Set up the model from A, b, c and d of each sample of a period."""
        self.models = models
        self.blocks: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = {}

    def run(self, phase: int, inputs: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the outputs and the last state for inputs of shape (samples, columns), from a sample of the period."""
        outputs = np.empty_like(inputs)
        k = 0
        while k + _BLOCK <= len(inputs):
            seen, passed, kept, pushed = self._block((phase + k) % len(self.models))
            there = inputs[k : k + _BLOCK]
            outputs[k : k + _BLOCK] = seen @ state + passed @ there
            state = kept @ state + pushed @ there
            k += _BLOCK
        for i in range(k, len(inputs)):
            A, b, c, d = self.models[(phase + i) % len(self.models)]
            outputs[i] = c @ state + d * inputs[i]
            state = A @ state + b[:, None] * inputs[i]
        return outputs, state

    def _block(self, phase: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the matrices from state and inputs to the outputs and the state of a block."""
        if phase not in self.blocks:
            n = len(self.models[0][1])
            # the response to each state and to a pulse in each sample, side by side
            state = np.hstack([np.eye(n), np.zeros((n, _BLOCK))])
            rows = np.empty((_BLOCK, n + _BLOCK))
            for j in range(_BLOCK):
                A, b, c, d = self.models[(phase + j) % len(self.models)]
                rows[j] = c @ state
                rows[j, n + j] += d
                state = A @ state
                state[:, n + j] += b
            self.blocks[phase] = rows[:, :n], rows[:, n:], state[:, :n], state[:, n:]
        return self.blocks[phase]


_PULSE = 50  # samples over which the response to a pulse of force reaches its peak
_SETTLES = 400  # periods until the gain of the filter is steady: dead times and filters are a few samples long


def _with_force(sample: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """Return the state matrix and the output row of a model extended by the unknown force as its last state."""
    n = sample.A.shape[0]
    step = np.eye(n + 1)
    step[:n, :n], step[:n, n] = sample.A, sample.B[:, 0]
    return step, np.append(sample.C[0], sample.D[0, 0])


def _gains(samples: Sequence[StateSpace], held: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    """Return the steady-state Kalman gain of each sample of a period, for a force of white noise plus a random walk."""
    N = len(samples)
    size, state = abs(float(samples[0].D[0, 0])), samples[0].B[:, 0]
    for k in range(1, _PULSE):
        size = max(size, abs(float(samples[k % N].C[0] @ state)))
        state = samples[k % N].A @ state
    variance = (UNKNOWN / size) ** 2
    covariance = np.zeros_like(held[0][0])
    gains = [np.full(covariance.shape[0], np.inf)] * N
    for k in range(_SETTLES * N):
        sample, (step, sight) = samples[k % N], held[k % N]
        force, d = np.append(sample.B[:, 0], 0.0), float(sample.D[0, 0])
        spread = float(sight @ covariance @ sight) + d * d * variance + 1.0
        gain = (step @ covariance @ sight + force * (d * variance)) / spread
        covariance = step @ covariance @ step.T + variance * np.outer(force, force) - spread * np.outer(gain, gain)
        covariance[-1, -1] += WALK * variance
        covariance = 0.5 * (covariance + covariance.T)
        steady = np.allclose(gain, gains[k % N], rtol=1e-9, atol=0.0)
        gains[k % N] = gain
        if steady and k >= 2 * N:
            break
    return gains
