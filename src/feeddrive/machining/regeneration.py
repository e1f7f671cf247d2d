"""The regenerative cut: the chip thickness depends on the surface that the previous tooth left.

`Regeneration` is the force on a vibrating tool. `ToothPassage` computes the monodromy matrix of the cut, which maps a
vibration over one tooth period, by collocation.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.families import Cutter
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.machining.tool_point import ToolPoint

_STRAIGHT = 1e-7  # rad of lag below which an edge counts as straight: the mean over it is then its value at the tip
_APART = 1e-12  # rad; engagement changes closer than this are one


class Piece(NamedTuple):
    """The spindle angles between two changes of engagement, rad; `cutting` is True if an edge is in the cut."""

    begin: float
    end: float
    cutting: bool


@dataclass(frozen=True)
class Regeneration:
    """The force on a tool with equally spaced teeth for its motion r = (feed t, normal n) relative to the workpiece.

        F     = -a H(φ) (r(t) - r(t - τ)) - a P(φ) r'(t),   τ = 60/(teeth · rpm)
        H(φ)  = Σ over engaged edges of [[s (Kt c + Kn s), c (Kt c + Kn s)], [s (Kn c - Kt s), c (Kn c - Kt s)]]
        P(φ)  = Σ over engaged edges of process_damping/V_c · [[s², s c], [s c, c²]],   s = sin v, c = cos v

    a is the axial depth, v = φ + 2πj/teeth; on helical edges v decreases from the tip upwards by `lag` · a, and H and P
    are the means over the depth.  t, n and v are those of `HelicalCutter`; up milling begins at v = 0.

    tangential, radial   Kt and Kn, force per area of chip, N/m²
    entry, leave         angles between which a tooth is in the workpiece, rad
    lag                  lag angle of the edge per depth, 2 tan(helix_angle)/diameter, rad/m
    diameter             tool diameter, m; needed for process damping only
    process_damping      C_i, force per depth and per r'/V_c, N/m; depends on wear and land of the edge
    Run-out, edge forces and the feed have no influence: to first order they are the same with and without vibration.
    Raises ParameterError for a tool without teeth, without engagement, or with implausible coefficients.
    Source: Altintas & Budak 1995, eqs. (1)-(5).
    """

    teeth: int
    tangential: float
    radial: float
    entry: float = 0.0
    leave: float = float(np.pi)
    lag: float = 0.0
    diameter: float = 0.0
    process_damping: float = 0.0

    def __post_init__(self) -> None:
        if self.teeth < 1:
            raise ParameterError(f"teeth = {self.teeth} must be 1 or more: a tool without teeth does not cut")
        if not (self.entry < self.leave <= self.entry + 2.0 * np.pi):
            raise ParameterError(
                f"entry = {Quantity(self.entry, 'rad'):6} and leave = {Quantity(self.leave, 'rad'):6}: a tooth leaves "
                f"the work after it entered it, and within a turn; a slot is 0 to {Quantity(np.pi, 'rad'):6}"
            )
        if not self.tangential > 0.0 or not np.isfinite(self.tangential + self.radial):
            raise ParameterError(
                f"tangential = {Quantity(self.tangential, 'N/m2'):6} must be > 0: 6e8 N/m2 for aluminium, 1.8e9 for "
                "steel"
            )
        if self.tangential < 1e6:
            raise ParameterError(
                f"tangential = {Quantity(self.tangential, 'N/m2'):6} is less than any metal needs; catalogues state "
                f"N/mm2: multiply by 1e6, {Quantity(1e6 * self.tangential, 'N/m2'):6}"
            )
        if self.lag < 0.0 or self.process_damping < 0.0:
            raise ParameterError(
                f"lag = {Quantity(self.lag, 'rad/m'):6} and process_damping = "
                f"{Quantity(self.process_damping, 'N/m'):6 SI} must be >= 0"
            )
        if self.process_damping > 0.0 and not self.diameter > 0.0:
            raise ParameterError(
                "process_damping acts on the cutting speed: give the diameter of the tool in m as well"
            )

    @property
    def pitch(self) -> float:
        """The pitch angle of the teeth, rad."""
        return 2.0 * float(np.pi) / self.teeth

    def period(self, speed: float) -> float:
        """Return the tooth period in s at a spindle speed in rpm. Raises ParameterError for a speed that is not > 0."""
        if not (speed > 0.0 and np.isfinite(speed)):
            raise ParameterError(
                f"spindle speed = {Quantity(speed, 'rpm'):6} must be > 0: a spindle that stands does not mill"
            )
        return 60.0 / (self.teeth * speed)

    def steps(self, depth: float) -> Iterator[Piece]:
        """Yield the pieces of one pitch angle, divided where the engagement changes (at this depth, if helical)."""
        lag = self.lag * depth if self.lag * depth > _STRAIGHT else 0.0
        borders = {0.0, self.pitch}
        for angle in (self.entry, self.leave, self.entry + lag, self.leave + lag):
            borders.add(angle % self.pitch)
        ends = sorted(borders)
        kept = [ends[0]] + [b for a, b in pairwise(ends) if b - a > _APART]
        # Exactly the pitch, also if a change of engagement just before it was merged.
        kept[-1] = self.pitch
        for begin, end in pairwise(kept):
            middle = 0.5 * (begin + end)
            yield Piece(begin, end, any(upper > lower for _, lower, upper in self._edges(middle, lag)))

    def _edges(self, angle: Any, lag: float) -> Iterator[tuple[Any, Any, Any]]:
        """Yield the tip angle and the ends of the engaged part of each edge; equal ends mean no engagement."""
        first = int(np.floor((self.entry - self.pitch) / self.pitch))
        last = int(np.ceil((self.leave + lag) / self.pitch))
        for tooth in range(first, last + 1):
            tip = angle + tooth * self.pitch
            if lag == 0.0:
                inside = (tip >= self.entry) & (tip < self.leave)
                yield tip, tip, tip + np.where(inside, 1.0, 0.0)
            else:
                upper = np.clip(tip, self.entry, self.leave)
                yield tip, np.minimum(np.clip(tip - lag, self.entry, self.leave), upper), upper

    def matrices(self, piece: Piece, angle: np.ndarray, depth: float) -> tuple[np.ndarray, np.ndarray]:
        """Return H in N/m² and Σ [[s², s c], [s c, c²]] at angles within a piece, both of shape (n, 2, 2)."""
        lag = self.lag * depth if self.lag * depth > _STRAIGHT else 0.0
        middle = 0.5 * (piece.begin + piece.end)
        sc, ss, cc = np.zeros((3, angle.size))
        for i, (_, lower, upper) in enumerate(self._edges(middle, lag)):
            if not upper > lower:
                continue
            if lag == 0.0:
                v = list(self._edges(angle, lag))[i][0]
                sine, cosine = np.sin(v), np.cos(v)
                sc, ss, cc = sc + sine * cosine, ss + sine * sine, cc + cosine * cosine
            else:
                _, lower, upper = list(self._edges(angle, lag))[i]
                for sign, v in ((1.0 / lag, upper), (-1.0 / lag, lower)):
                    sine, cosine = np.sin(v), np.cos(v)
                    sc = sc + sign * 0.5 * sine * sine
                    ss = ss + sign * 0.5 * (v - sine * cosine)
                    cc = cc + sign * 0.5 * (v + sine * cosine)
        return self._directed(sc, ss, cc), _rows(ss, sc, sc, cc)

    def averaged(self, begin: float, end: float) -> np.ndarray:
        """Return the mean of H of straight edges over spindle angles from begin to end (rad), N/m², shape (2, 2)."""
        # an edge that sweeps an angle passes the same places as one that lags by it
        swept = replace(self, lag=end - begin)
        return swept.matrices(Piece(end, end, True), np.array([end]), 1.0)[0][0]

    def _directed(self, sc: Any, ss: Any, cc: Any) -> np.ndarray:
        Kt, Kn = self.tangential, self.radial
        return _rows(Kt * sc + Kn * ss, Kt * cc + Kn * sc, Kn * sc - Kt * ss, Kn * cc - Kt * sc)

    def mean(self) -> np.ndarray:
        """Return the mean of H over a turn, N/m², shape (2, 2); it does not depend on the helix."""
        averaged = np.zeros(3)
        for sign, v in ((1.0, self.leave), (-1.0, self.entry)):
            sine, cosine = np.sin(v), np.cos(v)
            averaged += sign * 0.5 * np.array([sine * sine, v - sine * cosine, v + sine * cosine])
        return self._directed(*(averaged[:, None] / self.pitch))[0]

    def damped(self, speed: float) -> float:
        """Return the process damping divided by the cutting speed, N s/m²."""
        return self.process_damping / (np.pi * self.diameter * speed / 60.0) if self.process_damping else 0.0


def _rows(a: Any, b: Any, c: Any, d: Any) -> np.ndarray:
    return np.stack([np.stack([a, b], axis=-1), np.stack([c, d], axis=-1)], axis=-2)


def regeneration(cutter: Cutter | Regeneration, **changes: float) -> Regeneration:
    """Return the regeneration of a cutter; `changes` replace fields, such as process_damping = 2e4."""
    if isinstance(cutter, Regeneration):
        cut = cutter
    else:
        edge = cutter.edge()
        diameter = float(edge.diameter)
        cut = Regeneration(
            teeth=edge.teeth,
            tangential=float(edge.cutting[0]),
            radial=float(edge.cutting[1]),
            entry=float(edge.entry),
            leave=float(edge.exit),
            lag=2.0 * float(np.tan(float(edge.helix_angle))) / diameter,
            diameter=diameter,
        )
    return replace(cut, **changes) if changes else cut  # type: ignore[arg-type]


_LAYER = 30.0  # points for the fast transient after a tooth enters
_MOST = 420  # degree of a piece: about 50 vibrations


@lru_cache(maxsize=32)
def _differences(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Chebyshev points -1 ... 1, their differentiation matrix and their quadrature weights."""
    j = np.arange(n + 1)
    x = -np.cos(np.pi * j / n)
    c = np.where((j == 0) | (j == n), 2.0, 1.0) * (-1.0) ** j
    apart = x[:, None] - x[None, :] + np.eye(n + 1)
    derivative = np.outer(c, 1.0 / c) / apart
    # the derivative of a constant is 0: a diagonal from this identity loses fewer digits than its formula
    derivative -= np.diag(derivative.sum(axis=1))
    # Clenshaw-Curtis: the integrals of T_k against the values at the points
    k = np.arange(0, n + 1, 2)
    moments = np.zeros(n + 1)
    moments[k] = 2.0 / (1.0 - k.astype(float) ** 2)
    values = np.cos(np.outer(j, np.pi * (n - j) / n))
    weights = np.linalg.solve(values, moments)
    return x, derivative, weights


class _Passage(NamedTuple):
    """The time interval of a piece and, if it is cutting, the response to the force at its points and to the initial
    state.
    """

    piece: Piece
    length: float  # s
    points: np.ndarray  # rad, without the first one
    weights: np.ndarray  # s
    moved: tuple[np.ndarray, np.ndarray]  # C y at the points: by the forces there, by the state before
    speed: tuple[np.ndarray, np.ndarray]  # C y' there
    end: tuple[np.ndarray, np.ndarray]  # y at the end


class ToothPassage:
    """The monodromy matrix of a tool point with a cut, over one tooth period at a spindle speed in rpm.

        y' = A y + B f,   f = -a H (C y - C y(t - τ)) - a P C A y,      split where the engagement changes

    On a cutting piece f is a polynomial through Chebyshev points, at which the equations hold; on a free one the state
    transition is e^{AΔ}.  The unknowns are C y at the points of the cutting pieces and y at the end; their map over a
    tooth is the monodromy matrix; the vibration decays if its largest multiplier has |µ| < 1.  The error falls
    exponentially with the number of points, which is 12 plus 8 for each period of vibration in a piece.
    With straight edges, the pieces and their responses do not depend on the depth and are computed once.
    Raises ParameterError if a piece contains more than 50 periods of vibration.
    Source: Insperger & Stépán, Semi-Discretization for Time-Delay Systems, 2011, ch. 1 (monodromy); Trefethen,
    Spectral Methods in MATLAB, 2000, ch. 6 (points).
    """

    def __init__(self, tool: ToolPoint, cut: Regeneration, speed: float, *, share: float = 1.0) -> None:
        """Prepare the Chebyshev points; with a fraction `share` = 0.6 of them |µ| is accurate to 1 %, enough for a
        starting value.
        """
        # Deferred: commands that only read files do not need it.
        from scipy.linalg import schur

        self.cut, self.speed, self.period, self.share = cut, speed, cut.period(speed), share
        self.A, self.B, self.C = tool.moving()
        self.fastest = tool.fastest()
        self.directions = tool.directions()
        # triangular, so that the states are solved one by one; eigenvectors of a double pole would be singular
        schur_form = schur(self.A, output="complex")
        self._T, self._U = np.asarray(schur_form[0], complex), np.asarray(schur_form[1], complex)
        self._kept: list[_Passage] | None = None

    def _passages(self, depth: float) -> list[_Passage]:
        # with straight edges the pieces do not depend on the depth: they are computed once
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
            return _Passage(
                piece,
                length,
                np.zeros(0),
                np.zeros(0),
                (none, none),
                (none, none),
                (np.zeros((d, 0)), expm(self.A * length)),
            )
        poles: Any = np.diag(self._T)
        vibrations = self.fastest * length / (2.0 * np.pi)
        turns = (piece.end - piece.begin) / np.pi
        stiff = float(np.max(np.abs(poles))) * length
        # Chebyshev points are spaced by 1/n² at the ends: a layer that decays quickly needs the root of its stiffness
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
        in_time = np.array(weights[1:]) * 0.5 * length
        return _Passage(piece, length, angles, in_time, seen(self.C), seen(self.C @ self.A), ends)

    def _directional(self, passage: _Passage, depth: float) -> tuple[np.ndarray, np.ndarray]:
        """Return H and P at the points as block-diagonal matrices over points and directions."""
        n, q = passage.points.size, len(self.directions)
        chosen = np.ix_(range(n), self.directions, self.directions)
        matrices: list[np.ndarray] = []
        H, P = self.cut.matrices(passage.piece, passage.points, depth)
        for matrix in (H[chosen], P[chosen] * self.cut.damped(self.speed)):
            whole = np.zeros((n, q, n, q))
            whole[np.arange(n), :, np.arange(n), :] = matrix
            matrices.append(whole.reshape(n * q, n * q))
        return matrices[0], matrices[1]

    def monodromy(self, depths: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return the monodromy matrix at each axial depth in m; with helical edges all depths must be equal."""
        return self._maps(np.asarray(depths, float))[0]

    def _maps(self, depths: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the monodromy matrices, and the forces of each cutting piece as a function of the initial state."""
        passages = self._passages(float(depths[0]))
        sizes = [cut_passage.points.size * len(self.directions) for cut_passage in passages]
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
        """Return the largest Floquet multiplier µ at each depth (m); of a conjugate pair, the one with Im µ > 0."""
        depths = np.atleast_1d(np.asarray(depths, float))
        # straight edges: the pieces are the same for all depths, which are solved in one batch
        if self.cut.lag == 0.0:
            eigenvalues = np.linalg.eigvals(self._maps(depths)[0])
        else:
            eigenvalues = [np.linalg.eigvals(self._maps(depths[i : i + 1])[0][0]) for i in range(depths.size)]
        # the small term decides between the two of a conjugate pair, which are equal in size
        largest = [values[np.argmax(np.abs(values) + 1e-12 * (values.imag > 0.0))] for values in eigenvalues]
        return np.array([complex(m.real, abs(m.imag)) for m in largest])

    def flips(self) -> np.ndarray:
        """Return all axial depths in m, ascending, at which a multiplier is -1, for straight edges only.

        With y(τ) = -y(0) and r(t - τ) = -r(t), the motion is a linear function G of the force: f = -a (2 H + P d/dt) G
        f.  The depths a follow from the eigenvalues of a matrix, so no lobe is missed, however narrow it is.
        """
        if self.cut.lag:
            return np.zeros(0)
        passages = self._passages(1.0)
        d, total = self.A.shape[0], sum(passage.points.size for passage in passages) * len(self.directions)
        # the state at the begin of each piece by all forces, and by the state at the begin of the tooth
        by_forces, by_state = np.zeros((d, total)), np.eye(d)
        begun: list[tuple[np.ndarray, np.ndarray]] = []
        at = 0
        for passage in passages:
            begun.append((by_forces, by_state))
            size = passage.points.size * len(self.directions)
            by_forces, by_state = passage.end[1] @ by_forces, passage.end[1] @ by_state
            by_forces[:, at : at + size] += passage.end[0]
            at += size
        first = np.linalg.solve(-np.eye(d) - by_state, by_forces)
        rows: list[np.ndarray] = []
        at = 0
        for passage, (forces, state) in zip(passages, begun, strict=True):
            size = passage.points.size * len(self.directions)
            if size:
                H, P = self._directional(passage, 1.0)
                moved, fast = (seen[1] @ (forces + state @ first) for seen in (passage.moved, passage.speed))
                moved[:, at : at + size] += passage.moved[0]
                fast[:, at : at + size] += passage.speed[0]
                rows.append(2.0 * (H @ moved) + P @ fast)
            at += size
        values = np.linalg.eigvals(np.vstack(rows))
        real = values[(np.abs(values.imag) <= 1e-9 * np.abs(values)) & (values.real < 0.0)].real
        return np.sort(-1.0 / real)

    def frequency(self, depth: float, tool: ToolPoint) -> float:
        """Return the chatter frequency in Hz: |arg µ|/2πτ + k/τ, with the k of the largest velocity amplitude."""
        maps, forces = self._maps(np.array([depth]))
        values, vectors = np.linalg.eig(maps[0])
        values = values + 0j
        i = int(np.argmax(np.abs(values) + 1e-12 * (values.imag > 0.0)))
        base = float(np.angle(values[i])) / (2.0 * np.pi * self.period)
        top = float(np.max(np.abs(np.diag(self._T)))) / (2.0 * np.pi)
        most = int(np.ceil(top * self.period)) + 3
        candidates = base + np.arange(-most, most + 1) / self.period
        spectrum = np.zeros((candidates.size, len(self.directions)), complex)
        cutting = [engaged for engaged in self._passages(depth) if engaged.points.size]
        for passage, force in zip(cutting, forces, strict=True):
            values_of_force = (force[0] @ vectors[:, i]).reshape(passage.points.size, -1)
            time = passage.points / self.cut.pitch * self.period
            # the motion grows with µ over the tooth: what repeats is the force without that growth
            steady = np.exp(-(2j * np.pi * candidates[:, None] + np.log(np.abs(values[i])) / self.period) * time)
            spectrum += (steady * passage.weights) @ values_of_force
        chosen = np.ix_(range(candidates.size), self.directions, self.directions)
        motion = np.einsum("kij,kj->ki", tool.response(candidates)[chosen], spectrum)
        return abs(float(candidates[np.argmax(np.abs(candidates) * np.linalg.norm(motion, axis=1))]))
