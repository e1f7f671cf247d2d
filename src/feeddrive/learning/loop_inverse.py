"""The inverse of a closed loop: the force, or the change of the set path, that cancels a known or measured error."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.analysis.stability import require_stable
from feeddrive.blocks.friction.viscous import Viscous
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.learning.set_path import cardinal_spline
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import SETPOINT, Loop

DEGREE = 5
"""The degree of the splines: their third derivative is smooth, and their fourth, the snap, is bounded."""
SLOW = 0.05
"""The speed at which a loop is linearized, m/s: dry friction is saturated, and a part is cut at such speeds."""
_SETTLED = 1e-7  # of its peak: below it the response has ended; observers leave a floor of rounding below
_ENDED = 1e-5  # of its peak: below it the inverse of a displacement in one sample has ended
_MOST_KNOTS = 1 << 22  # of a circle: some 100 MB
_LONGEST = 200_000  # samples that a response may take


@dataclass(frozen=True, eq=False)
class LoopInverse:
    """The linear model of a loop at a slow speed without dry friction, and its regularized inverse.

    by_load   response of the table (m) to a force of 1 N on the load during sample 0, shape (n,)
    by_force  response of the table to a force of 1 N that is added to the command in sample 0, shape (n,)
    model     linear model from the derivatives of the setpoint to the table
    """

    by_load: np.ndarray
    by_force: np.ndarray
    model: StateSpace
    sample_time: float

    def answer(self, force: np.ndarray) -> np.ndarray:
        """Return the displacement of the table (m) by a force on the load in N, both of shape (n,)."""
        return _convolved(self.by_load, force)[: force.size]

    def of_command(self, force: np.ndarray) -> np.ndarray:
        """Return the displacement of the table (m) by a force in N that is added to the command, both of shape (n,)."""
        return _convolved(self.by_force, force)[: force.size]

    def following_error(self, path: Recorded) -> np.ndarray:
        """Return the error of the model along a path without friction, planned minus actual position, m, shape (n,)."""
        n = path.position.size
        rows = np.array([np.asarray(row) for row in path.at(np.arange(n) * self.sample_time)])
        # from rest at the first position, where the linear model is at 0
        rows[0] -= rows[0][0]
        return rows[0] - _simulated(self.model, rows.T)[:n]

    def knots(self, spacing: float) -> int:
        """Return a spacing of knots in s as a number of samples, at least 1."""
        return max(1, round(spacing / self.sample_time))

    def force_for(self, displacement: np.ndarray, spacing: float, ridge: float) -> np.ndarray:
        """Return the force added to the command, N, that displaces the table by `displacement` (m), both of shape (n,).

            u = Σ c_j N(k - j h),   (B'B + ridge r0) c = B' displacement

        with B the response of the table to the splines N, and r0 the diagonal of B'B.

        spacing  time between two knots of the splines, s
        ridge    weight of the size of the force, relative to that of the displacement that it makes
        """
        h = self.knots(spacing)
        shape = cardinal_spline(DEGREE, h)
        return self._fitted(shape, _convolved(self.by_force, shape), displacement, h, ridge)[0]

    def path_for(self, displacement: np.ndarray, spacing: float, ridge: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the change of the set path that displaces the table by `displacement` (m), shape (n,), as for a force.

        The result is the change with its derivatives, m .. m/s⁴, shape (5, n), and the coefficients of its splines,
        of which coefficient j belongs to the spline that begins at sample (j - 5) · h.
        """
        h = self.knots(spacing)
        rows = np.array([cardinal_spline(DEGREE, h, order) / self.sample_time**order for order in range(5)])
        response = _simulated(self.model, rows.T)
        _, c = self._fitted(rows[0], response, displacement, h, ridge)
        n = displacement.size
        wide = np.zeros(c.size * h)
        wide[::h] = c
        # the splines that begin before the first sample: 5 of them reach into the motion
        change = [_convolved(row, wide)[DEGREE * h : DEGREE * h + n] for row in rows]
        return np.array(change), c

    def _fitted(
        self, shape: np.ndarray, response: np.ndarray, wanted: np.ndarray, h: int, ridge: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return Σ c_j N(k - j h) at the samples, and the coefficients c from spline -5 on.

        B'B is a Toeplitz matrix.  The equations are solved as circular ones by FFT, with a rest behind the motion that
        is longer than the inverse, so that the end does not reach around to the beginning.
        """
        n = wanted.size
        rest = self._reach(response, h, ridge) * h + response.size + shape.size
        size = _composite(-(-(n + rest) // h)) * h
        B, spectrum = _normal(response, size, h, ridge)
        # correlation of the response of each spline with the wanted displacement
        right = np.fft.irfft(np.conj(B) * np.fft.rfft(wanted, size), size)[::h]
        c = np.fft.irfft(np.fft.rfft(right) / spectrum, size // h)
        # from the splines that begin before the motion
        c = np.roll(c, DEGREE)[: -(-n // h) + DEGREE]
        wide = np.zeros(c.size * h)
        wide[::h] = c
        return _convolved(shape, wide)[DEGREE * h : DEGREE * h + n], c

    def _reach(self, response: np.ndarray, h: int, ridge: float) -> int:
        """Return the number of knots over which a displacement in one sample still needs a force."""
        count = _composite(-(-4 * response.size // h))
        while count < _MOST_KNOTS:
            inverse = np.abs(np.fft.irfft(1.0 / _normal(response, count * h, h, ridge)[1], count))
            above = np.flatnonzero(inverse[: count // 2] > _ENDED * np.max(inverse))
            if above[-1] < count // 4:
                return int(above[-1]) + 1
            count = _composite(2 * count)
        raise ParameterError(
            f"the inverse of the loop needs forces over more than {Quantity(count * h * self.sample_time, 's'):3}: the "
            "loop hardly moves the table; check its gains"
        )


def _normal(response: np.ndarray, size: int, h: int, ridge: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectrum of a response over `size` samples, and that of B'B + ridge r0 I over the knots."""
    B = np.fft.rfft(response, size)
    square = np.fft.irfft(np.abs(B) ** 2, size)[::h]
    return B, np.real(np.fft.rfft(square)) + ridge * square[0]


def _composite(count: int) -> int:
    from scipy.fft import next_fast_len

    length: Any = next_fast_len(count, real=True)
    return int(length)


def _convolved(response: np.ndarray, signal: np.ndarray) -> np.ndarray:
    from scipy.fft import irfft, rfft

    if response.size * signal.size < 1e6:
        return np.convolve(response, signal)
    # scipy.signal, which has the same to the bit, takes half a second to import
    length = response.size + signal.size - 1
    size = _composite(length)
    one: Any = rfft(response, size)
    other: Any = rfft(signal, size)
    whole: Any = irfft(one * other, size)
    return whole[:length]


def loop_inverse(loop: Loop, *, velocity: float = SLOW) -> LoopInverse:
    """Return the inverse of a loop from its exact linear model at a speed, m/s, without its dry friction.

    Raises UnstableError for a loop that is unstable, NoSlopeError for a law without a linear model, and ParameterError
    for a law that does not compute the same in each sample, or a response that does not settle.
    """
    if loop.control.law.period() > 1:
        raise ParameterError(
            f"axis.{loop.name}.control.law: {loop.control.law.kind} computes its position loop every "
            f"{loop.control.law.period()} samples, so that its inverse depends on the sample in which a force begins: "
            "set position_every = 1, or correct the set path of this axis alone by --method splines"
        )
    loop = frictionless(loop)
    require_stable(loop, velocity=velocity, where=f"axis {loop.name}")
    model = linearize(loop, [*SETPOINT, "load_force", "added_force"], ["position_load"], velocity=velocity)
    by_load, by_force = (_impulse(model, name) for name in ("load_force", "added_force"))
    return LoopInverse(by_load, by_force, model, float(loop.sample_time))


def _impulse(model: StateSpace, name: str) -> np.ndarray:
    """Return the response of the output to 1 in sample 0 of an input, until it has settled."""
    column = model.inputs.index(name)
    x, rows = model.B[:, column], [float(model.D[0, column])]
    # squared powers of A: the first rows of each block are those before, further on by the length of the block
    block = np.array([model.C[0]])
    power = model.A
    while block.shape[0] < _LONGEST:
        answer = block @ x
        peak = float(np.max(np.abs(answer)))
        late = np.abs(answer[answer.size // 2 :])
        if answer.size > 64 and (peak == 0.0 or float(np.max(late)) <= _SETTLED * peak):
            above = np.flatnonzero(np.abs(answer) > _SETTLED * peak)
            return np.append(rows, answer[: above[-1] + 1 if above.size else 1])
        block = np.vstack([block, block @ power])
        power = power @ power
    raise ParameterError(
        f"the table has not settled {Quantity(_LONGEST * model.sample_time, 's')} after a force: the loop is hardly "
        "stable, or a part of the axis swings on: damp it, or lower the gains"
    )


def _simulated(model: StateSpace, inputs: np.ndarray) -> np.ndarray:
    """Return the response of the table to the setpoint and its derivatives, shape (n, 5), until it settles."""
    answers = [_convolved(_impulse(model, name), column) for name, column in zip(SETPOINT, inputs.T, strict=True)]
    whole = np.zeros(max(answer.size for answer in answers))
    for answer in answers:
        whole[: answer.size] += answer
    return whole


def frictionless(loop: Loop) -> Loop:
    """Return the loop without dry friction; the viscous part of its friction stays."""

    def viscous(friction: Any) -> Any:
        return None if friction is None else Viscous(viscous=friction.linear())

    axis = dataclasses.replace(
        loop.axis, friction_motor=viscous(loop.axis.friction_motor), friction_load=viscous(loop.axis.friction_load)
    )
    return dataclasses.replace(loop, axis=axis)
