"""The general second-order filter of a drive's current setpoint path."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.biquad import (
    Delayed,
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


class SecondOrder(Filter):
    """Two zeros and two poles with unit gain at 0 Hz, each pair prewarped at its own frequency.

        H(s) = (s²/ωz² + 2 damping_zero s/ωz + 1) / (s²/ωp² + 2 damping_pole s/ωp + 1),   ω = 2π frequency

    Far above both frequencies the gain is (frequency_pole / frequency_zero)².  Drives call it the general second-order
    filter: a low-pass with a stop band, or a lead.  Equal frequencies make it the `Notch`.
    """

    frequency_zero: Number = parameter("Hz", "natural frequency of the numerator", above=0)
    damping_zero: Number = parameter("", "damping ratio of the numerator", least=0, default=0.1)
    frequency_pole: Number = parameter("Hz", "natural frequency of the denominator", above=0)
    damping_pole: Number = parameter("", "damping ratio of the denominator", above=0, default=0.7)

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Both frequencies lie below half the sample rate."""
        yield below_nyquist(self.kind, "frequency_zero", self.frequency_zero, T)
        yield below_nyquist(self.kind, "frequency_pole", self.frequency_pole, T)

    def prepare(self, T: Number) -> Section:
        """The section's coefficients."""
        ratio = prewarped(self.frequency_pole, T) / prewarped(self.frequency_zero, T)
        zeros = tustin(self.frequency_zero, self.damping_zero, T)
        return section(zeros, tustin(self.frequency_pole, self.damping_pole, T), ratio * ratio)

    def start(self, prepared: Any, value: Number) -> Delayed:
        """At rest with output = input = value."""
        return settled(prepared, value)

    def step(self, prepared: Any, state: Any, value: Number) -> tuple[Delayed, Number]:
        """One sample."""
        return advance(prepared, state, value)

    def retune(self, state: Any, old: SecondOrder, old_prepared: Any, prepared: Any) -> Delayed:
        """The output is continuous."""
        return retuned(state, old_prepared, prepared)
