"""The force of a milling tool that vibrates: the chip remembers the surface that the tooth before left."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.machine_families import Cutter
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity

_STRAIGHT = 1e-7  # rad of lag below which an edge counts as straight: the mean over it is then its value at the tip
_APART = 1e-12  # rad; engagement changes closer than this are one


class Piece(NamedTuple):
    """Angles of the spindle between two changes of the engagement, and whether an edge is in the cut there, rad."""

    begin: float
    end: float
    cutting: bool


@dataclass(frozen=True)
class Regeneration:
    """What a tool with equally spaced teeth answers to a motion r = (feed t, normal n) of tool against work.

        F     = -a H(φ) (r(t) - r(t - τ)) - a P(φ) r'(t),   τ = 60/(teeth · rpm)
        H(φ)  = Σ over engaged edges of [[s (Kt c + Kn s), c (Kt c + Kn s)], [s (Kn c - Kt s), c (Kn c - Kt s)]]
        P(φ)  = Σ over engaged edges of process_damping/V_c · [[s², s c], [s c, c²]],   s = sin v, c = cos v

    a is the axial depth, v = φ + 2πj/teeth; on helical edges v runs from the tip back by `lag` · a, and H and P are the
    means over the depth.  t, n and v are those of `HelicalCutter`; up milling begins at v = 0.

    tangential, radial   Kt and Kn, force per area of chip, N/m²
    entry, leave         angles between which a tooth is in the work, rad
    lag                  turn of the edge per depth, 2 tan(helix_angle)/diameter, rad/m
    diameter             of the tool, m; needed for process damping only
    process_damping      C_i, force per depth and per r'/V_c, N/m; depends on wear and land of the edge
    Run-out, edge forces and the feed do not enter: they are the same with and without vibration, to first order.
    Raises ParameterError for a tool without teeth, without engagement, or with coefficients that no metal has.
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
        """Angle from tooth to tooth, rad."""
        return 2.0 * float(np.pi) / self.teeth

    def period(self, speed: float) -> float:
        """From tooth to tooth at a spindle speed in rpm, s. Raises ParameterError for a spindle that does not turn."""
        if not (speed > 0.0 and np.isfinite(speed)):
            raise ParameterError(
                f"spindle speed = {Quantity(speed, 'rpm'):6} must be > 0: a spindle that stands does not mill"
            )
        return 60.0 / (self.teeth * speed)

    def steps(self, depth: float) -> Iterator[Piece]:
        """One pitch of the spindle, cut where the engagement changes; with helical edges it depends on the depth."""
        lag = self.lag * depth if self.lag * depth > _STRAIGHT else 0.0
        borders = {0.0, self.pitch}
        for angle in (self.entry, self.leave, self.entry + lag, self.leave + lag):
            borders.add(angle % self.pitch)
        ends = sorted(borders)
        kept = [ends[0]] + [b for a, b in pairwise(ends) if b - a > _APART]
        kept[-1] = self.pitch
        for begin, end in pairwise(kept):
            middle = 0.5 * (begin + end)
            yield Piece(begin, end, any(upper > lower for _, lower, upper in self._edges(middle, lag)))

    def _edges(self, angle: Any, lag: float) -> Iterator[tuple[Any, Any, Any]]:
        """Tip, and the ends of the engaged part of each edge that can be in the work; equal ends: it is not."""
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
        """H in N/m² and Σ [[s², s c], [s c, c²]] at angles within a piece, both of shape (n, 2, 2)."""
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
        """The mean of H of straight edges while the spindle turns from begin to end (rad), N/m², shape (2, 2)."""
        # an edge that sweeps an angle passes the same places as one that lags by it
        swept = replace(self, lag=end - begin)
        return swept.matrices(Piece(end, end, True), np.array([end]), 1.0)[0][0]

    def _directed(self, sc: Any, ss: Any, cc: Any) -> np.ndarray:
        Kt, Kn = self.tangential, self.radial
        return _rows(Kt * sc + Kn * ss, Kt * cc + Kn * sc, Kn * sc - Kt * ss, Kn * cc - Kt * sc)

    def mean(self) -> np.ndarray:
        """The mean of H over a turn, N/m², shape (2, 2); it does not depend on the helix."""
        found = np.zeros(3)
        for sign, v in ((1.0, self.leave), (-1.0, self.entry)):
            sine, cosine = np.sin(v), np.cos(v)
            found += sign * 0.5 * np.array([sine * sine, v - sine * cosine, v + sine * cosine])
        return self._directed(*(found[:, None] / self.pitch))[0]

    def damped(self, speed: float) -> float:
        """process_damping over the cutting speed, N s/m²."""
        return self.process_damping / (np.pi * self.diameter * speed / 60.0) if self.process_damping else 0.0


def _rows(a: Any, b: Any, c: Any, d: Any) -> np.ndarray:
    return np.stack([np.stack([a, b], axis=-1), np.stack([c, d], axis=-1)], axis=-2)


def regeneration(cutter: Cutter | Regeneration, **changes: float) -> Regeneration:
    """The regeneration of a cutter's edges; `changes` replace fields, as process_damping = 2e4."""
    if isinstance(cutter, Regeneration):
        found = cutter
    else:
        edge = cutter.edge()
        diameter = float(edge.diameter)
        found = Regeneration(
            teeth=edge.teeth, tangential=float(edge.cutting[0]), radial=float(edge.cutting[1]),
            entry=float(edge.entry), leave=float(edge.exit),
            lag=2.0 * float(np.tan(float(edge.helix_angle))) / diameter, diameter=diameter,
        )  # fmt: skip
    return replace(found, **changes) if changes else found  # type: ignore[arg-type]
