"""The map of a vibration over one tooth: the monodromy of the regenerative cut, by collocation."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.machining.regeneration import Piece, Regeneration
from feeddrive.machining.tool_point import ToolPoint

_LAYER = 30.0  # points for what dies out at once after the tooth enters
_MOST = 420  # degree of a piece: about 50 vibrations


@lru_cache(maxsize=32)
def _differences(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Chebyshev points -1 ... 1, the matrix of the derivative on them and the weights of the integral."""
    j = np.arange(n + 1)
    x = -np.cos(np.pi * j / n)
    c = np.where((j == 0) | (j == n), 2.0, 1.0) * (-1.0) ** j
    apart = x[:, None] - x[None, :] + np.eye(n + 1)
    derivative = np.outer(c, 1.0 / c) / apart
    derivative -= np.diag(derivative.sum(axis=1))
    # Clenshaw-Curtis: the integrals of T_k against the values at the points
    k = np.arange(0, n + 1, 2)
    moments = np.zeros(n + 1)
    moments[k] = 2.0 / (1.0 - k.astype(float) ** 2)
    values = np.cos(np.outer(j, np.pi * (n - j) / n))
    weights = np.linalg.solve(values, moments)
    return x, derivative, weights


class _Passage(NamedTuple):
    """A piece in time and, on a cutting one, what force at its points and state at its begin make of it."""

    piece: Piece
    length: float  # s
    points: np.ndarray  # rad, without the first one
    weights: np.ndarray  # s
    moved: tuple[np.ndarray, np.ndarray]  # C y at the points: by the forces there, by the state before
    speed: tuple[np.ndarray, np.ndarray]  # C y' there
    end: tuple[np.ndarray, np.ndarray]  # y at the end


class ToothPassage:
    """One tooth period of a tool point under a cut, at a spindle speed in rpm.

        y' = A y + B f,   f = -a H (C y - C y(t - τ)) - a P C A y,      split where the engagement changes

    On a cutting piece f is a polynomial through Chebyshev points, at which the equations hold; on a free one y moves by
    e^{AΔ}.  The unknowns are C y at the points of the cutting pieces and y at the end; their map over a tooth is the
    monodromy, whose largest multiplier µ decides: |µ| < 1, and the vibration dies out.  The error falls exponentially
    with the number of points, 12 + 8 for each vibration in a piece.
    With straight edges pieces and their response do not depend on the depth and are computed once.
    Raises ParameterError where a piece holds more vibrations than 50.
    Source: Insperger & Stépán, Semi-Discretization for Time-Delay Systems, 2011, ch. 1 (monodromy); Trefethen,
    Spectral Methods in MATLAB, 2000, ch. 6 (points).
    """

    def __init__(self, tool: ToolPoint, cut: Regeneration, speed: float, *, share: float = 1.0) -> None:
        """`share` of the points is taken: 0.6 for 1 % of |µ|, to find a place to begin."""
        from scipy.linalg import schur  # not for commands that only read

        self.cut, self.speed, self.period, self.share = cut, speed, cut.period(speed), share
        self.A, self.B, self.C = tool.moving()
        self.fastest = tool.fastest()
        self.directions = tool.directions()
        found = schur(self.A, output="complex")
        self._T, self._U = np.asarray(found[0], complex), np.asarray(found[1], complex)
        self._kept: list[_Passage] | None = None

    def _passages(self, depth: float) -> list[_Passage]:
        if self.cut.lag == 0.0:
            if self._kept is None:
                self._kept = [self._passage(piece) for piece in self.cut.steps(depth)]
            return self._kept
        return [self._passage(piece) for piece in self.cut.steps(depth)]

    def _passage(self, piece: Piece) -> _Passage:
        length = (piece.end - piece.begin) / self.cut.pitch * self.period
        d = self.A.shape[0]
        if not piece.cutting:
            from scipy.linalg import expm

            none = np.zeros((0, 0))
            return _Passage(piece, length, np.zeros(0), np.zeros(0), (none, none), (none, none),
                            (np.zeros((d, 0)), expm(self.A * length)))  # fmt: skip
        poles: Any = np.diag(self._T)
        vibrations = self.fastest * length / (2.0 * np.pi)
        turns = (piece.end - piece.begin) / np.pi
        stiff = float(np.max(np.abs(poles))) * length
        n = int(self.share * (12.0 + 8.0 * (vibrations + turns) + min(2.0 * np.sqrt(stiff), _LAYER)))
        if n > _MOST:
            raise ParameterError(
                f"at {Quantity(self.speed, 'rpm'):6} the fastest mode swings {Quantity(vibrations):.0f} times while a "
                f"tooth cuts, and at most 50 are resolved: begin at {Quantity(self.speed * vibrations / 50.0, 'rpm')}, "
                f"or leave out modes above {Quantity(50.0 / length, 'Hz')}, which the damping of the process holds "
                "there"
            )
        x, derivative, weights = _differences(n)
        D = derivative * (2.0 / length)
        q = self.B.shape[1]
        into = self._U.conj().T @ self.B
        X = np.zeros((d, n, n * q + d), complex)
        eye = np.eye(n)
        for k in reversed(range(d)):
            right = np.zeros((n, n * q + d), complex)
            for column in range(q):
                right[:, column : n * q : q] = into[k, column] * eye
            right[:, n * q + k] = -D[1:, 0]
            right += np.tensordot(self._T[k, k + 1 :], X[k + 1 :], axes=1)
            X[k] = np.linalg.solve(D[1:, 1:] - poles[k] * eye, right)
        y: Any = np.tensordot(self._U, X, axes=1)  # of all states, by the forces and the state in Schur's coordinates
        y[:, :, n * q :] = y[:, :, n * q :] @ self._U.conj().T
        y = y.real

        def seen(C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            rows = np.tensordot(C, y, axes=1).transpose(1, 0, 2).reshape(n * q, -1)
            return rows[:, : n * q], rows[:, n * q :]

        angles = piece.begin + 0.5 * (x[1:] + 1.0) * (piece.end - piece.begin)
        ends = y[:, -1, : n * q], y[:, -1, n * q :]
        own = np.array(weights[1:]) * 0.5 * length
        return _Passage(piece, length, angles, own, seen(self.C), seen(self.C @ self.A), ends)

    def _directional(self, passage: _Passage, depth: float) -> tuple[np.ndarray, np.ndarray]:
        """H and P at the points as matrices over points and directions."""
        n, q = passage.points.size, len(self.directions)
        chosen = np.ix_(range(n), self.directions, self.directions)
        found: list[np.ndarray] = []
        H, P = self.cut.matrices(passage.piece, passage.points, depth)
        for each in (H[chosen], P[chosen] * self.cut.damped(self.speed)):
            whole = np.zeros((n, q, n, q))
            whole[np.arange(n), :, np.arange(n), :] = each
            found.append(whole.reshape(n * q, n * q))
        return found[0], found[1]

    def monodromy(self, depths: Sequence[float] | np.ndarray) -> np.ndarray:
        """The map at each axial depth in m; of helical edges all depths must be one."""
        return self._maps(np.asarray(depths, float))[0]

    def _maps(self, depths: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """The maps, and the forces of each cutting piece by what was before."""
        passages = self._passages(float(depths[0]))
        sizes = [each.points.size * len(self.directions) for each in passages]
        d, total, many = self.A.shape[0], sum(sizes), depths.size
        width = total + d
        state = np.zeros((many, d, width))
        state[:, :, total:] = np.eye(d)
        rows: list[np.ndarray] = []
        forces: list[np.ndarray] = []
        at = 0
        a = depths[:, None, None]
        for passage, size in zip(passages, sizes, strict=True):
            if size:
                H, P = self._directional(passage, float(depths[0]))
                (by_force, by_state), (fast, slow) = passage.moved, passage.speed
                left = np.eye(size) + a * (H @ by_force + P @ fast)
                right = -a * ((H @ by_state + P @ slow) @ state)
                right[:, :, at : at + size] += a * H
                force = np.linalg.solve(left, right)
                rows.append(by_force @ force + by_state @ state)
                forces.append(force)
                state = passage.end[0] @ force + passage.end[1] @ state
                at += size
            else:
                state = passage.end[1] @ state
        return np.concatenate([*rows, state], axis=1), forces

    def multipliers(self, depths: Sequence[float] | np.ndarray) -> np.ndarray:
        """The largest multiplier µ at each axial depth (m), that of two conjugate ones with the positive angle."""
        depths = np.atleast_1d(np.asarray(depths, float))
        if self.cut.lag == 0.0:
            found = np.linalg.eigvals(self._maps(depths)[0])
        else:
            found = [np.linalg.eigvals(self._maps(depths[i : i + 1])[0][0]) for i in range(depths.size)]
        largest = [each[np.argmax(np.abs(each) + 1e-12 * (each.imag > 0.0))] for each in found]
        return np.array([complex(m.real, abs(m.imag)) for m in largest])

    def flips(self) -> np.ndarray:
        """All axial depths in m, rising, at which a multiplier is -1; of straight edges only.

        y(τ) = -y(0) and r(t - τ) = -r(t) make the motion a linear function G of the force, f = -a (2 H + P d/dt) G f:
        the depths are the eigenvalues of a matrix, and none is missed, however narrow the tongue above it is.
        """
        if self.cut.lag:
            return np.zeros(0)
        passages = self._passages(1.0)
        d, total = self.A.shape[0], sum(each.points.size for each in passages) * len(self.directions)
        # the state at the begin of each piece by all forces, and by the state at the begin of the tooth
        by_forces, by_state = np.zeros((d, total)), np.eye(d)
        begun: list[tuple[np.ndarray, np.ndarray]] = []
        at = 0
        for each in passages:
            begun.append((by_forces, by_state))
            size = each.points.size * len(self.directions)
            by_forces, by_state = each.end[1] @ by_forces, each.end[1] @ by_state
            by_forces[:, at : at + size] += each.end[0]
            at += size
        first = np.linalg.solve(-np.eye(d) - by_state, by_forces)
        rows: list[np.ndarray] = []
        at = 0
        for each, (forces, state) in zip(passages, begun, strict=True):
            size = each.points.size * len(self.directions)
            if size:
                H, P = self._directional(each, 1.0)
                moved, fast = (seen[1] @ (forces + state @ first) for seen in (each.moved, each.speed))
                moved[:, at : at + size] += each.moved[0]
                fast[:, at : at + size] += each.speed[0]
                rows.append(2.0 * (H @ moved) + P @ fast)
            at += size
        values = np.linalg.eigvals(np.vstack(rows))
        real = values[(np.abs(values.imag) <= 1e-9 * np.abs(values)) & (values.real < 0.0)].real
        return np.sort(-1.0 / real)

    def frequency(self, depth: float, tool: ToolPoint) -> float:
        """Hz of the chatter of the largest multiplier: |arg µ|/2πτ + k/τ with the k of the largest velocity."""
        maps, forces = self._maps(np.array([depth]))
        values, vectors = np.linalg.eig(maps[0])
        values = values + 0j
        i = int(np.argmax(np.abs(values) + 1e-12 * (values.imag > 0.0)))
        base = float(np.angle(values[i])) / (2.0 * np.pi * self.period)
        top = float(np.max(np.abs(np.diag(self._T)))) / (2.0 * np.pi)
        most = int(np.ceil(top * self.period)) + 3
        candidates = base + np.arange(-most, most + 1) / self.period
        spectrum = np.zeros((candidates.size, len(self.directions)), complex)
        cutting = [each for each in self._passages(depth) if each.points.size]
        for passage, force in zip(cutting, forces, strict=True):
            values_of_force = (force[0] @ vectors[:, i]).reshape(passage.points.size, -1)
            time = passage.points / self.cut.pitch * self.period
            # the motion grows with µ over the tooth: what repeats is the force without that growth
            steady = np.exp(-(2j * np.pi * candidates[:, None] + np.log(np.abs(values[i])) / self.period) * time)
            spectrum += (steady * passage.weights) @ values_of_force
        chosen = np.ix_(range(candidates.size), self.directions, self.directions)
        motion = np.einsum("kij,kj->ki", tool.response(candidates)[chosen], spectrum)
        return abs(float(candidates[np.argmax(np.abs(candidates) * np.linalg.norm(motion, axis=1))]))
