"""A first-order low-pass filter."""

from collections.abc import Iterator
from typing import Any, NamedTuple, Self

from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.biquad import below_nyquist, prewarped
from feeddrive.language.block import Number, Rule, parameter


class LowPass(Filter):
    """A first-order low-pass (PT1), discretized by Tustin's method with prewarping at its corner frequency.

        H(s) = 1 / (s/ω + 1),   ω = 2π frequency,   s/ω -> (1/w)(z - 1)/(z + 1),   w = tan(ωT/2)
        y = b (x + x₋₁) - a y₋₁,   b = w/(1 + w),   a = (w - 1)/(w + 1)

    Its gain at `frequency` remains -3 dB after discretization; at a frequency f far below `frequency` its phase lag is
    about f / frequency rad.
    """

    frequency: Number = parameter("Hz", "corner frequency", above=0)

    class Prepared(NamedTuple):
        """The coefficients b and a in y = b (x + x₋₁) - a y₋₁."""

        b: Number
        a: Number

    class State(NamedTuple):
        """The delayed sum b x₋₁ - a y₋₁, and the last output y₋₁, which is needed for a live change."""

        delayed: Number
        output: Number

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the validity rule: the corner frequency lies below half the sample rate."""
        yield below_nyquist(self.kind, "frequency", self.frequency, T)

    def prepare(self, T: Number) -> Prepared:
        w = prewarped(self.frequency, T)
        return self.Prepared(w / (1.0 + w), (w - 1.0) / (w + 1.0))

    def start(self, prepared: Any, value: Number) -> State:
        """Return the state at rest with output = input = value."""
        return self.State((prepared.b - prepared.a) * value, value)

    def step(self, prepared: Any, state: Any, value: Number) -> tuple[State, Number]:
        output = prepared.b * value + state.delayed
        return self.State(prepared.b * value - prepared.a * output, output), output

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Convert the part of the state that belongs to a constant signal, so that the output is continuous."""
        steady = (prepared.b - prepared.a) - (old_prepared.b - old_prepared.a)
        return state._replace(delayed=state.delayed + steady * state.output)
