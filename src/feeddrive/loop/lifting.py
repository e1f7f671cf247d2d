"""Lifting of multirate loops, whose law is periodic over several samples, and frequency responses of every loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import (
    INPUT_UNITS,
    StateSpace,
    check_below_nyquist,
    kept_states,
    linearize,
    samples_of_a_period,
)
from feeddrive.loop.loop import SETPOINT, UNITS, Loop, quantity
from feeddrive.loop.machine import System, check_system

MOST = 64  # samples of a period: responses have as many images, and cost their square
_BLOCK = 2**19  # entries of all matrices that are made at once


@dataclass(frozen=True, eq=False)
class Lifted:
    """A loop that is periodic over N samples (multirate), as a sequence of N linear models.

        x(k+1) = A_i x(k) + B_i u(k),   y(k) = C_i x(k) + D_i u(k),   i = k mod N

    Lifted: with all samples of a period as one input and one output it is a time-invariant system at the sample time NT
    (Bamieh, Pearson, Francis & Tannenbaum 1991; Meyer 1990; Khargonekar, Poolla & Tannenbaum 1985).  It is stable if
    all eigenvalues of A_{N-1} ... A_0 lie inside the unit circle.

    The response to a sine at f has components at f and at its images f + k/(NT), k = 1 .. N-1.  `response` is the
    component at f, which a sine sweep measures.  For N = 1 it is the ordinary frequency response.
    """

    samples: tuple[StateSpace, ...]

    @property
    def sample_time(self) -> float:
        """The time T of one sample, s."""
        return self.samples[0].sample_time

    @property
    def inputs(self) -> tuple[str, ...]:
        """The names of the inputs, with their units as in `linearize`."""
        return self.samples[0].inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of the recorded signals."""
        return self.samples[0].outputs

    def poles(self) -> np.ndarray:
        """Return the eigenvalues of the state transition over a period, the largest first."""
        product = np.eye(self.samples[0].A.shape[0])
        for sample in self.samples:
            product = sample.A @ product
        poles = np.linalg.eigvals(product)
        return poles[np.argsort(-np.abs(poles))]

    def stacked(self, inputs: Sequence[str], outputs: Sequence[str]) -> tuple[np.ndarray, ...]:
        """Return A, B, C, D of the lifted system; the samples of each input and output are stacked in order."""
        N, n = len(self.samples), self.samples[0].A.shape[0]
        columns = [self.inputs.index(name) for name in inputs]
        rows = [self.outputs.index(name) for name in outputs]
        through = np.hstack([np.eye(n), np.zeros((n, N * len(columns)))])
        seen = np.zeros((len(rows), N, through.shape[1]))
        for k, sample in enumerate(self.samples):
            places = n + k + N * np.arange(len(columns))
            seen[:, k] = sample.C[rows] @ through
            seen[:, k, places] += sample.D[np.ix_(rows, columns)]
            through = sample.A @ through
            through[:, places] += sample.B[:, columns]
        wide = seen.reshape(-1, through.shape[1])
        return through[:, :n], through[:, n:], wide[:, :n], wide[:, n:]

    def harmonics(self, frequency: np.ndarray, output: str, input: str) -> np.ndarray:  # noqa: A002
        """Return H of shape (lines, N, N), from a sine at f + k/(NT) in column k to its component at f + m/(NT) in row
        m.
        """
        A, B, C, D = self.stacked([input], [output])
        N, n = len(self.samples), A.shape[0]
        turns = images_turn(frequency, N, self.sample_time)
        z = np.exp(2j * np.pi * frequency * N * self.sample_time)
        inner = np.linalg.solve(z[:, None, None] * np.eye(n) - A, np.broadcast_to(B.astype(complex), (z.size, n, N)))
        return np.conj(turns).transpose(0, 2, 1) @ (C @ inner + D) @ turns / N

    def response(self, frequency: np.ndarray, output: str, input: str) -> FRF:  # noqa: A002
        """Return the component at f of the response to a sine at f in Hz, up to the Nyquist frequency of one sample."""
        A, B, C, D = self.stacked([input], [output])
        N, n = len(self.samples), A.shape[0]
        frequency = np.asarray(frequency, dtype=float)
        check_below_nyquist(frequency, self.sample_time)
        turn = images_turn(frequency, N, self.sample_time)[:, :, 0]
        z = np.exp(2j * np.pi * frequency * N * self.sample_time)
        right = turn @ B.T
        inner = np.linalg.solve(z[:, None, None] * np.eye(n) - A, right[:, :, None])[:, :, 0]
        values = np.sum(np.conj(turn) * (inner @ C.T + turn @ D.T), axis=1) / N
        unit = f"{UNITS[quantity(output)]}/{INPUT_UNITS[quantity(input)]}"
        return FRF(frequency, values, input, output, unit, self.sample_time)


def images_turn(frequency: np.ndarray, period: int, sample_time: float) -> np.ndarray:
    """Return e^(j 2π (f + m/(NT)) i T) of shape (lines, samples i, images m)."""
    i = np.arange(period)
    turns = np.exp(2j * np.pi * frequency[:, None] * i * sample_time)
    return turns[:, :, None] * np.exp(2j * np.pi * np.outer(i, i) / period)


def images_closed(gain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the loop gain for a sine with the loops of its images closed, and det(1 + L) of the images alone.

        L(f) = L₀₀ - L₀ᵢ (1 + Lᵢᵢ)⁻¹ Lᵢ₀,    1/(1 + L(f)) = [(1 + L)⁻¹]₀₀,    det(1 + L) = (1 + L(f)) det(1 + Lᵢᵢ)

    gain  the harmonics of an opened loop, shape (lines, N, N), the sine itself first
    """
    others = np.eye(gain.shape[1] - 1) + gain[:, 1:, 1:]
    back = np.linalg.solve(others, gain[:, 1:, :1])
    return gain[:, 0, 0] - (gain[:, :1, 1:] @ back)[:, 0, 0], np.linalg.det(others)


def period_of(loop: System) -> int:
    """Return the period of a loop or machine in samples: the least common multiple of its laws' periods."""
    return int(np.lcm.reduce([axis_loop.control.law.period() for axis_loop in loop.loops().values()]))


def lifted(
    loop: System,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    velocity: float | Mapping[str, float] = 0.05,
    stored: Callable[[str, float], float] | None = None,
) -> Lifted:
    """Return the linear models of all samples of a period, from any inputs to any signals, as in `linearize`.

    Raises what `linearize` raises.
    """
    check_system(loop)
    samples = samples_of_a_period(loop, inputs, outputs, velocity=velocity, stored=stored)
    n = len(samples.names)
    keep = kept_states(samples.jacobians, n)
    names = tuple(samples.names[i] for i in keep)
    return Lifted(
        tuple(
            StateSpace(
                jacobian[np.ix_(keep, keep)],
                jacobian[keep, n:],
                jacobian[n:, keep],
                jacobian[n:, n:],
                samples.sample_time,
                names,
                tuple(inputs),
                tuple(outputs),
            )
            for jacobian in samples.jacobians
        )
    )


def gain_of(model: Lifted, frequency: np.ndarray, output: str = "force", input: str = "cut") -> tuple[FRF, np.ndarray]:  # noqa: A002
    """Return the gain L of a loop opened from `output` to `input`, with its images closed, and det(1 + L) of the
    images.

    See `images_closed` for both.
    Raises ParameterError for a period of more than 64 samples.
    """
    N, T = len(model.samples), model.sample_time
    if N > MOST:
        raise ParameterError(
            f"the loop repeats itself every {N} samples: loop gain and margins are computed for at most {MOST}; "
            f"set position_every <= {MOST}, or take a longer sample time"
        )
    # N × N matrices at all frequencies at once would fill the memory
    blocks = np.array_split(frequency, max(1, -(-frequency.size * N * N // _BLOCK)))
    parts = [images_closed(-model.harmonics(block, output, input)) for block in blocks if block.size]
    gain, rest = (np.concatenate([part[i] for part in parts]) for i in range(2))
    return FRF(frequency, gain, input, output, "N/N", T), rest


def loop_gain(loop: System, frequency: np.ndarray, *, velocity: float = 0.05, axis: str | None = None) -> FRF:
    """Return the sampled loop gain L = -force/cut, opened at the actuator, with all delays; 1 + L = 0 is the stability
    limit.

    For a machine it is the gain of one `axis`, with the loops of all others closed.  For a multirate law it is the gain
    for a sine with the loops of its images closed: 1/(1 + L) is the remaining share of a sine added to the force
    (`images_closed`).
    """
    port, _ = _port(loop, axis)
    if period_of(loop) > 1:
        model = lifted(loop, [f"{port}cut"], [f"{port}force"], velocity=velocity)
        return gain_of(model, np.asarray(frequency, dtype=float), f"{port}force", f"{port}cut")[0]
    return -linearize(loop, [f"{port}cut"], [f"{port}force"], velocity=velocity).response(frequency)


def tracking(loop: System, frequency: np.ndarray, *, velocity: float = 0.05, axis: str | None = None) -> FRF:
    """Return table position over set position, with set velocity to snap as exact derivatives: Σ Hₙ (j2πf)ⁿ.

    For a multirate law it is the component at the excited frequency, as in `compliance`.
    """
    port, _ = _port(loop, axis)
    model = linear_model(loop, [f"{port}{name}" for name in SETPOINT], [f"{port}position_load"], velocity)
    s = 2j * np.pi * np.asarray(frequency, dtype=float)
    total = model.response(frequency, f"{port}position_load", f"{port}{SETPOINT[0]}")
    for order, name in enumerate(SETPOINT[1:], start=1):
        total = total + s**order * model.response(frequency, f"{port}position_load", f"{port}{name}").response
    return total


def compliance(loop: System, frequency: np.ndarray, *, velocity: float = 0.05, axis: str | None = None) -> FRF:
    """Return the closed-loop compliance in m/N, table position over table force: the inverse of the dynamic stiffness.

    For a multirate law it is the component at the excited frequency, at the fast sample rate.
    """
    port, _ = _port(loop, axis)
    model = linear_model(loop, [f"{port}load_force"], [f"{port}position_load"], velocity)
    return model.response(frequency, f"{port}position_load", f"{port}load_force")


def linear_model(
    loop: System, inputs: Sequence[str], outputs: Sequence[str], velocity: float = 0.05
) -> StateSpace | Lifted:
    """Return the linear model of a loop; for a multirate loop those of all samples of a period."""
    return (lifted if period_of(loop) > 1 else linearize)(loop, inputs, outputs, velocity=velocity)


def _port(loop: System, axis: str | None) -> tuple[str, Loop]:
    """Return the signal prefix of an axis, which must be named for a machine, and its loop alone."""
    check_system(loop)
    ports = dict(zip(loop.loops(), loop.ports(), strict=True))
    name = next(iter(ports)) if axis is None and len(ports) == 1 else axis
    if name not in ports:
        raise ParameterError(f"axis = {axis!r} must be one of {', '.join(ports)}")
    return ports[name], loop.loops()[name]
