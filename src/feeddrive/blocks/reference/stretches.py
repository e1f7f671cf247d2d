"""A motion as stretches that are polynomials of time, in arithmetic that is sampled by numpy or traced."""

from __future__ import annotations

from typing import NamedTuple, cast

from feeddrive.blocks.reference.derivatives import Derivatives
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number


class Way(NamedTuple):
    """When and where a leg is: its time is t - begins, its position first + sense · travel."""

    begins: Number  # s
    lasts: Number  # s
    first: Number  # m
    sense: Number  # 1, -1, or 0 for a rest

    def ends(self) -> Number:
        """The end of the leg, s."""
        return self.begins + self.lasts

    def inside(self, t: Number) -> Number:
        """Time since the leg began, held within it."""
        return ops.clip(t - self.begins, 0.0, self.lasts)

    def placed(self, travel: Derivatives) -> Setpoint:
        """Setpoints from travel and its derivatives."""
        bases = (self.first, 0.0, 0.0, 0.0, 0.0)
        return Setpoint(
            *(cast(Number, base + self.sense * derivative) for base, derivative in zip(bases, travel, strict=True))
        )


class Piece(NamedTuple):
    """A polynomial of fourth order in the time of a leg, by travel, velocity ... snap at its start (SI)."""

    start: Number  # s
    span: Number  # s
    travel: Number
    velocity: Number
    acceleration: Number
    jerk: Number
    snap: Number

    def at(self, time: Number) -> Derivatives:
        """Taylor to snap; after the span it stands still at its end."""
        return moved(self[2:], ops.clip(time - self.start, 0.0, self.span))


class Stretch(NamedTuple):
    """A piece of a leg; it holds until the next stretch does."""

    way: Way
    piece: Piece

    def holds(self, t: Number) -> Number:
        """True where it has begun at t (s)."""
        return ops.both(t >= self.way.begins, self.way.inside(t) >= self.piece.start)

    def at(self, t: Number) -> Setpoint:
        """Setpoints at a time in it."""
        return self.way.placed(self.piece.at(self.way.inside(t)))


def rest(begins: float, position: float) -> Stretch:
    """Standing still at a position (m) from a time (s) on."""
    return Stretch(Way(begins, 0.0, position, 0.0), Piece(*(0.0,) * 7))


def moved(state: tuple[Number, ...], span: Number) -> Derivatives:
    """Taylor to snap from states (5, n) over spans (n,)."""
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
