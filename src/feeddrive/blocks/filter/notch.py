"""A notch against one resonance."""

from __future__ import annotations

from typing import Any, NamedTuple

from feeddrive.blocks.families import Filter
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter


class Notch(Filter):
    """A second-order notch, by Tustin with prewarping at its own frequency, in direct form II transposed.

        H(s) = (s² + 2 ζn ω s + ω²) / (s² + 2 ζd ω s + ω²),   ω = 2π frequency
        s -> (2/T)(z - 1)/(z + 1),   ω -> (2/T) tan(ωT/2)

    Its depth is ζn/ζd.  When not to use it: if the resonance moves by more than its width (about 2 ζd · frequency).
    """

    frequency: Number = parameter("Hz", "centre of the notch", above=0)
    damping_zero: Number = parameter("", "damping ratio of the numerator: the depth", least=0, default=0.05)
    damping_pole: Number = parameter("", "damping ratio of the denominator: the width", above=0, default=0.5)

    class Prepared(NamedTuple):
        """H(z) = (b0 + b1 z⁻¹ + b2 z⁻²) / (1 + b1 z⁻¹ + a2 z⁻²): numerator and denominator share b1."""

        b0: Number
        b1: Number
        b2: Number
        a2: Number

    class State(NamedTuple):
        """The two delayed sums."""

        first: Number
        second: Number

    def prepare(self, T: Number) -> Prepared:
        """With w = tan(ωT/2) and D = 1 + 2 ζd w + w².

        b0, b2 = (1 ± 2 ζn w + w²)/D,   b1 = 2 (w² - 1)/D,   a2 = (1 - 2 ζd w + w²)/D
        """
        w = ops.tan(ops.pi * self.frequency * T)
        base = 1.0 + w * w
        wide, narrow = 2.0 * self.damping_pole * w, 2.0 * self.damping_zero * w
        scale = 1.0 / (base + wide)
        return self.Prepared(
            b0=(base + narrow) * scale,
            b1=2.0 * (w * w - 1.0) * scale,
            b2=(base - narrow) * scale,
            a2=(base - wide) * scale,
        )

    def start(self, prepared: Any, value: Number) -> State:
        """At rest with output = input = value."""
        second = (prepared.b2 - prepared.a2) * value
        return self.State(second, second)

    def step(self, prepared: Any, state: Any, value: Number) -> tuple[State, Number]:
        """One sample."""
        output = prepared.b0 * value + state.first
        first = prepared.b1 * (value - output) + state.second
        return self.State(first, prepared.b2 * value - prepared.a2 * output), output
