"""Second-order sections (biquads): Tustin design with prewarping, direct form II transposed, and a base class."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, NamedTuple

from feeddrive.blocks.families import Filter
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, declarations
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text


class Section(NamedTuple):
    """A section H(z) = (b0 + b1 z⁻¹ + b2 z⁻²) / (1 + a1 z⁻¹ + a2 z⁻²); a1 is None where it equals b1, as in a notch."""

    b0: Number
    b1: Number
    b2: Number
    a1: Number | None
    a2: Number


class Delayed(NamedTuple):
    """The two delayed sums of a section, and its last output, which is needed for a live change."""

    first: Number
    second: Number
    output: Number


class Polynomial(NamedTuple):
    """A polynomial c0 + c1 z⁻¹ + c2 z⁻², such as (1 + 2 damping s/ω + (s/ω)²)(1 + z⁻¹)² with s by Tustin's method."""

    c0: Number
    c1: Number
    c2: Number


def prewarped(frequency: Number, T: Number) -> Number:
    """Return w = tan(π frequency T), so that s/ω -> (1/w)(z - 1)/(z + 1) is exact at s = jω, z = e^jωT."""
    return ops.tan(ops.pi * frequency * T)


def tustin(frequency: Number, damping: Number, T: Number) -> Polynomial:
    """Return w² times the polynomial (1 + 2 damping s/ω + (s/ω)²)(1 + z⁻¹)², prewarped at `frequency` in Hz."""
    w = prewarped(frequency, T)
    base = 1.0 + w * w
    slope = 2.0 * damping * w
    return Polynomial(base + slope, 2.0 * (w * w - 1.0), base - slope)


def section(numerator: Polynomial, denominator: Polynomial, gain: Number) -> Section:
    """Return the section gain · numerator / denominator."""
    scale = 1.0 / denominator.c0
    up = gain * scale
    return Section(
        b0=numerator.c0 * up,
        b1=numerator.c1 * up,
        b2=numerator.c2 * up,
        a1=denominator.c1 * scale,
        a2=denominator.c2 * scale,
    )


def notch_section(frequency: Number, damping_zero: Number, damping_pole: Number, T: Number) -> Section:
    """Return a notch section, whose numerator and denominator share the middle coefficient to save a product."""
    zeros, poles = tustin(frequency, damping_zero, T), tustin(frequency, damping_pole, T)
    # both middle coefficients are 2 (w² - 1) over the same c0
    return section(zeros, poles, 1.0)._replace(a1=None)


def low_pass_section(frequency: Number, damping: Number, T: Number) -> Section:
    """Return the section for ω²/(s² + 2 damping ω s + ω²), whose transformed numerator is w² (1 + z⁻¹)²."""
    w = prewarped(frequency, T)
    return section(Polynomial(1.0, 2.0, 1.0), tustin(frequency, damping, T), w * w)


def settled(made: Section, value: Number) -> Delayed:
    """Return the steady state of a section with H(1) = 1 at a constant input."""
    return Delayed((1.0 - made.b0) * value, (made.b2 - made.a2) * value, value)


def advance(made: Section, state: Delayed, value: Number) -> tuple[Delayed, Number]:
    """Compute one sample: the new state and the output."""
    output = made.b0 * value + state.first
    if made.a1 is None:
        first = made.b1 * (value - output) + state.second
    else:
        first = made.b1 * value - made.a1 * output + state.second
    return Delayed(first, made.b2 * value - made.a2 * output, output), output


def retuned(state: Delayed, old: Section, new: Section) -> Delayed:
    """Return the state after a live change from one section to another.

    The part of the state that belongs to a constant signal is converted from the old section to the new one. The output
    stays continuous: if the input equals the last output, the next output is that of the old section.
    """
    steady = state.output
    first = state.first + (old.b0 - new.b0) * steady
    second = state.second + ((new.b2 - new.a2) - (old.b2 - old.a2)) * steady
    return Delayed(first, second, steady)


def below_nyquist(kind: str, name: str, frequency: Number, T: Number) -> Rule:
    """Return the rule that a frequency in Hz lies below half the sample rate; `T` is the sample time in s."""
    return Rule(
        frequency < 0.5 / T,
        f"{name} is below half the sample rate",
        lambda: Text(
            f"{kind}.{name} = {Quantity(frequency, 'Hz'):6} must be below half the sample rate, "
            f"{Quantity(0.5 / T, 'Hz'):6}: lower it, or leave the filter out"
        ),
    )


class SecondOrderSection(Filter, ABC):
    """The base class of filters with one section and H(1) = 1, each defined by its parameters and its `prepare`.

    Each parameter in Hz must lie below half the sample rate, where the prewarping becomes singular.
    Source of the form: Oppenheim & Schafer, Discrete-Time Signal Processing, section 6.3 (direct form II transposed).
    """

    @abstractmethod
    def prepare(self, T: Number) -> Section:
        """Return the coefficients at a sample time in s."""

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        for name, declared in declarations(type(self)).items():
            if declared.unit == "Hz":
                yield below_nyquist(self.kind, name, getattr(self, name), T)

    def start(self, prepared: Section, value: Number) -> Delayed:
        return settled(prepared, value)

    def step(self, prepared: Section, state: Any, value: Number) -> tuple[Delayed, Number]:
        return advance(prepared, state, value)

    def retune(self, state: Any, old: Any, old_prepared: Any, prepared: Any) -> Delayed:
        return retuned(state, old_prepared, prepared)
