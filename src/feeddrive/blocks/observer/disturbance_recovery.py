"""Disturbance estimate from the inverse model of a rigid axis."""

from collections.abc import Iterator
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, begun
from feeddrive.blocks.families import Observer
from feeddrive.blocks.filter import biquad
from feeddrive.blocks.filter.biquad import Delayed, Section
from feeddrive.blocks.signals import Estimate, Reading
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, choice, parameter

_BUTTERWORTH = 0.7071067811865476  # damping ratio of the second order


class DisturbanceRecovery(Observer):
    """Disturbance recovery: the force on a rigid axis in addition to the drive's, from reading and `applied` alone.

        F̂d(k) = m (v(k) - v(k-1))/T + b v(k) - F_m(k-1),    v(k) = (x(k) - x(k-1))/T

    Inverting the paper's (6), with F_m(k) - F_m(k-1) added since a real motor has applied the last sample's force,
    gives the same result, so gains and references of the law are not needed.  F_m(k-1) is the `applied` force, or
    the one `delay_samples` earlier.

        exact        without a filter
        one_pole     F(k) = α F(k-1) + (1 - α) F̂d(k),   α = e^(-2π frequency T), in place of the law's Q/(Q + g1 T/m)
        two_poles    two such poles in series
        butterworth  second order, by Tustin with prewarping

    The estimate is a double difference: a resolution q causes noise of √6 m (q/√12)/T² before the filter.  `lag` is the
    delay for a force that is held over each sample while the motor force is constant: 1.5 T plus the delay of the
    filter, about √2/(2π frequency) for second order.  For a force that rises linearly within the samples, T
    replaces 1.5 T.  Both values are smaller by T/2 under a law that cancels the force, since F_m(k-1) is then more
    recent than the mean over the two samples that the double difference spans.
    When to use: under any law, to monitor a cutting force or to reject it.  Not suitable for an axis mode inside the
    filter's band; with a coarse encoder use `KalmanRecovery`.
    Source: Altintas & Okwudire 2009, section 3, from eq. (6); the second-order filter is this library's choice.
    """

    tunables = ("frequency",)

    mass: Number = parameter("kg", "m: all that moves", above=0)
    viscous: Number = parameter("N s/m", "b: viscous friction that does not count as disturbance", least=0, default=0)
    form: str = choice("filter", options=("exact", "one_pole", "two_poles", "butterworth"), default="butterworth")
    frequency: Number = parameter("Hz", "corner frequency of the filter", above=0, default=500)
    delay_samples: int = choice("samples of dead time until a command acts", default=0, least=0, most=64)
    encoder: str = choice("encoder whose reading is inverted", options=("load", "motor"), default="load")

    @classmethod
    def begin(cls, axis: AxisModel) -> Self:
        """Return starting values: the velocity encoder, and 0.2 `axis.rate` as corner frequency in Hz."""
        return begun(cls, axis, frequency=0.2 * axis.rate, encoder=axis.velocity_encoder)

    class Prepared(NamedTuple):
        """The α of the poles, or the second-order section; each is empty if it is not used."""

        pole: tuple[Number, ...]
        section: tuple[Section, ...]

    class State(NamedTuple):
        """The last position (m) and velocity (m/s), commands that have not acted yet (N, newest first), the filter."""

        position: Number
        velocity: Number
        pending: tuple[Number, ...]
        filter: tuple[Any, ...]

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the validity rule: the corner frequency of the filter lies below half the sample rate."""
        if self.form != "exact":
            yield biquad.below_nyquist(self.kind, "frequency", self.frequency, T)

    def prepare(self, T: Number) -> Prepared:
        """Compute the coefficients of the filter."""
        if self.form in ("one_pole", "two_poles"):
            return self.Prepared((ops.exp(-2.0 * ops.pi * self.frequency * T),), ())
        if self.form == "butterworth":
            return self.Prepared((), (biquad.low_pass_section(self.frequency, _BUTTERWORTH, T),))
        return self.Prepared((), ())

    def start(self, prepared: Prepared, reading: Reading) -> State:
        """Return the state of steady motion through the measured position; the disturbance balances the force."""
        position, held = reading.position(self.encoder), self.viscous * reading.velocity - reading.applied
        kept: tuple[Any, ...] = (held,) * self._poles()
        if prepared.section:
            kept = (biquad.settled(prepared.section[0], held),)
        return self.State(position, reading.velocity, (reading.applied,) * self.delay_samples, kept)

    def _poles(self) -> int:
        return {"one_pole": 1, "two_poles": 2}.get(self.form, 0)

    def step(self, prepared: Prepared, state: State, reading: Reading, T: Number) -> tuple[State, Estimate]:
        position = reading.position(self.encoder)
        commands = (reading.applied, *state.pending)
        velocity = (position - state.position) / T
        # the oldest command: that which acted while the axis moved between the last two readings
        force = self.mass * ((velocity - state.velocity) / T) + self.viscous * velocity - commands[-1]
        kept: tuple[Any, ...] = ()
        for i in range(self._poles()):
            force = force + prepared.pole[0] * (state.filter[i] - force)
            kept = (*kept, force)
        if prepared.section:
            held: Delayed = state.filter[0]
            delayed, force = biquad.advance(prepared.section[0], held, force)
            kept = (delayed,)
        after = self.State(position, velocity, commands[: self.delay_samples], kept)
        return after, Estimate(position, velocity, force)

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Convert the state so that the filtered force is continuous."""
        if not prepared.section:
            return state
        return state._replace(filter=(biquad.retuned(state.filter[0], old_prepared.section[0], prepared.section[0]),))

    def lag(self, prepared: Prepared, T: Number) -> Number:
        """Return the delay in s for a disturbance that is held over each sample, at constant motor force.

        This is the sum of 1.5 T for the double difference and the delay of the filter at 0 Hz, which is α/(1 - α) T for
        each pole. In other cases the delay is up to T shorter.
        """
        samples: Any = 1.5
        if prepared.pole:
            samples = samples + float(self._poles()) * (prepared.pole[0] / (1.0 - prepared.pole[0]))
        if prepared.section:
            # slope of the phase at 0 Hz: Tustin makes 2 ζ s/ω of the denominator ζ T s/w
            samples = samples + _BUTTERWORTH / biquad.prewarped(self.frequency, T)
        return samples * T
