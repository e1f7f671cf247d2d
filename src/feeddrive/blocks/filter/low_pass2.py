"""A second-order low-pass filter."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.biquad import (
    Delayed,
    Polynomial,
    Section,
    advance,
    below_nyquist,
    prewarped,
    retuned,
    section,
    settled,
    tustin,
)
from feeddrive.language.block import Number, Rule, parameter


class LowPass2(Filter):
    """A second-order low-pass (PT2), by Tustin with prewarping at its own frequency.

        H(s) = ω² / (s² + 2 damping ω s + ω²),   ω = 2π frequency

    Its phase lag at a frequency f far below `frequency` is about 2 damping · f / frequency rad.
    """

    frequency: Number = parameter("Hz", "natural frequency", above=0)
    damping: Number = parameter("", "damping ratio", above=0, default=0.7)

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """The frequency lies below half the sample rate."""
        yield below_nyquist(self.kind, "frequency", self.frequency, T)

    def prepare(self, T: Number) -> Section:
        """The section's coefficients; the numerator is w² (1 + z⁻¹)²."""
        w = prewarped(self.frequency, T)
        return section(Polynomial(1.0, 2.0, 1.0), tustin(self.frequency, self.damping, T), w * w)

    def start(self, prepared: Any, value: Number) -> Delayed:
        """At rest with output = input = value."""
        return settled(prepared, value)

    def step(self, prepared: Any, state: Any, value: Number) -> tuple[Delayed, Number]:
        """One sample."""
        return advance(prepared, state, value)

    def retune(self, state: Any, old: LowPass2, old_prepared: Any, prepared: Any) -> Delayed:
        """The output is continuous."""
        return retuned(state, old_prepared, prepared)
