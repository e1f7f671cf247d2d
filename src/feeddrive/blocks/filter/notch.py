"""A notch filter for one resonance."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.biquad import (
    Delayed,
    Section,
    advance,
    below_nyquist,
    notch_section,
    retuned,
    settled,
)
from feeddrive.language.block import Number, Rule, parameter


class Notch(Filter):
    """A second-order notch, by Tustin with prewarping at its own frequency, in direct form II transposed.

        H(s) = (s² + 2 ζn ω s + ω²) / (s² + 2 ζd ω s + ω²),   ω = 2π frequency
        s -> (2/T)(z - 1)/(z + 1),   ω -> (2/T) tan(ωT/2)

    Its depth is ζn/ζd.  When not to use it: if the resonance moves by more than its width (about 2 ζd · frequency).
    """

    frequency: Number = parameter("Hz", "centre of the notch", above=0)
    damping_zero: Number = parameter("", "damping ratio of the numerator: the depth", least=0, default=0.05)
    damping_pole: Number = parameter("", "damping ratio of the denominator: the width", above=0, default=0.5)

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """The centre lies below half the sample rate."""
        yield below_nyquist(self.kind, "frequency", self.frequency, T)

    def prepare(self, T: Number) -> Section:
        """The section's coefficients."""
        return notch_section(self.frequency, self.damping_zero, self.damping_pole, T)

    def start(self, prepared: Any, value: Number) -> Delayed:
        """At rest with output = input = value."""
        return settled(prepared, value)

    def step(self, prepared: Any, state: Any, value: Number) -> tuple[Delayed, Number]:
        """One sample."""
        return advance(prepared, state, value)

    def retune(self, state: Any, old: Notch, old_prepared: Any, prepared: Any) -> Delayed:
        """The output is continuous."""
        return retuned(state, old_prepared, prepared)
