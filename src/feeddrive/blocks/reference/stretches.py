"""A motion as a series of polynomials in time, computed so that numpy can sample and a trace can record it."""

from typing import NamedTuple, cast

from feeddrive.blocks.reference.derivatives import Derivatives
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number


class Way(NamedTuple):
    """The timing and location of a leg: leg time = t - begins, position = first + sense · travel."""

    begins: Number  # s
    lasts: Number  # s
    first: Number  # m
    sense: Number  # 1, -1, or 0 for a rest

    def ends(self) -> Number:
        """Return the end time of the leg, s."""
        return self.begins + self.lasts

    def inside(self, t: Number) -> Number:
        """Return the time since the start of the leg, clipped to its length, s."""
        # clipped, since a trace evaluates every stretch at every time
        return ops.clip(t - self.begins, 0.0, self.lasts)

    def placed(self, travel: Derivatives) -> Setpoint:
        """Return the setpoints from travel and its derivatives."""
        bases = (self.first, 0.0, 0.0, 0.0, 0.0)
        return Setpoint(
            *(cast(Number, base + self.sense * derivative) for base, derivative in zip(bases, travel, strict=True))
        )


class Piece(NamedTuple):
    """A fourth-order polynomial in the time of a leg, defined by travel, velocity, ..., snap at its start (SI)."""

    start: Number  # s
    span: Number  # s
    travel: Number
    velocity: Number
    acceleration: Number
    jerk: Number
    snap: Number

    def at(self, time: Number) -> Derivatives:
        """Return travel and derivatives by Taylor expansion up to snap, at a time clipped to the piece."""
        return moved(self[2:], ops.clip(time - self.start, 0.0, self.span))


class Stretch(NamedTuple):
    """A piece of a leg, valid until the next stretch begins."""

    way: Way
    piece: Piece

    def holds(self, t: Number) -> Number:
        """Return True if the stretch has begun at the time t (s)."""
        return ops.both(t >= self.way.begins, self.way.inside(t) >= self.piece.start)

    def at(self, t: Number) -> Setpoint:
        """Return the setpoints at a time within the stretch."""
        return self.way.placed(self.piece.at(self.way.inside(t)))


def rest(begins: float, position: float) -> Stretch:
    """Return a stretch in which the axis rests at `position` (m) from the time `begins` (s) on."""
    return Stretch(Way(begins, 0.0, position, 0.0), Piece(*(0.0,) * 7))


def moved(state: tuple[Number, ...], span: Number) -> Derivatives:
    """Return the motion by Taylor expansion up to snap, from states (5, n) over spans (n,)."""
    x, v, a, j, s = state
    half, third = 0.5 * span, span / 3.0
    derivatives = (
        x + span * (v + half * (a + third * (j + 0.25 * span * s))),
        v + span * (a + half * (j + third * s)),
        a + span * (j + half * s),
        j + span * s,
        s,
    )
    return cast(Derivatives, derivatives)
