"""The P-PI cascade, the standard control of machine-tool axes."""

from dataclasses import replace
from typing import NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Start
from feeddrive.blocks.controller.cascade_options import (
    Interpolator,
    ReferenceModel,
    commanded_velocity,
    expected_velocity,
    interpolated,
    interpolator,
    reference_model,
    smoothed_velocity,
)
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import StructureError


class CascadePPI(Law):
    """P position loop around a PI velocity loop, with velocity feedforward.

        e     = Kv (x_set - x_load) + velocity_feedforward · v_set - v
        force = Kp (e + (1/Tn) Σ T e) (+ viscous · v)
        v     = (x(k) - x(k-n)) / nT  of the velocity encoder,  v_set = (x_set(k) - x_set(k-1)) / T

    With `velocity_lag` a low pass of first order smooths v, as drives smooth their actual speed:
    v(k) = v(k-1) + T / (velocity_lag + T) (difference(k) - v(k-1)).

    Anti-windup is by back-calculation: the force cut off by the limit in the last sample is subtracted from the
    integral one step later, as `requested` - `applied`.  This equals back-calculation within the step.
    With two encoders the position loop uses the load's encoder and the velocity loop the motor's.
    With `position_every` above 1 the position loop is slower, and an `Interpolator` connects the two loops.  With
    `model_mass` the integral compares v with the velocity of a `ReferenceModel` instead of the command: the position
    loop then includes the lag of the model, so check Ms again; at the force limit the model is faster than the axis.

    With `viscous` the law cancels the viscous friction of the guideway, using the measured velocity; the paper's closed
    form (7) is exact only then.  An `Inertia` in the same controller then feeds the acceleration forward and keeps its
    own `viscous` at 0.

    When to use: always first, as the baseline of every comparison.  If the first mode of the axis lies within three
    times the desired crossover, a law that damps it performs better.
    Source: Altintas & Okwudire 2009, section 2 (the cascade); the set velocity is differenced in the same way as the
    measured one.
    """

    tunables = ("Kv", "Kp", "Tn")
    title = "P-PI"

    Kv: Number = parameter("1/s", "position gain", above=0)
    Kp: Number = parameter("N s/m", "velocity gain", above=0)
    Tn: Number | None = parameter(
        "s", "integral time of the velocity loop; absent for a P velocity loop", above=0, default=None
    )
    velocity_feedforward: Number = parameter("", "share of the set velocity that is fed forward", default=1.0, least=0)
    viscous: Number | None = parameter(
        "N s/m", "viscous friction that is compensated by the measured velocity; absent for none", least=0, default=None
    )
    model_mass: Number | None = parameter(
        "kg", "mass of the reference model in the integral; absent for no model", above=0, default=None
    )
    model_samples: int = choice(
        "dead time of the reference model in the integral, in samples", default=1, least=0, most=64
    )
    velocity_samples: int = choice("samples over which the velocity is differenced", default=1, least=1, most=1000)
    velocity_lag: Number | None = parameter(
        "s", "time constant of a low pass of the measured velocity; absent for none", above=0, default=None
    )
    velocity_encoder: str = choice("encoder of the velocity loop", options=("motor", "load"), default="motor")
    position_every: int = choice("the position loop runs every so many samples", default=1, least=1, most=1000)

    def check(self) -> None:
        """Raise StructureError for a reference model without an integral."""
        if self.model_mass is not None and self.Tn is None:
            raise StructureError(
                f"{self.kind}.model_mass is the mass of a reference model in the integral, and there is none without "
                f"Tn: leave it out, or give Tn in s"
            )

    @classmethod
    def begin(cls, axis: AxisModel, present: Law) -> tuple[Start, ...]:
        """Return two variants: with and without an integral.

        The first has the gains of the existing cascade if it has an integral, otherwise gains derived from `axis.rate`.
        The second is tried only with a disturbance observer, which then provides the integral action.
        """
        rate = axis.rate
        law = cls(Kv=0.7 * rate, Kp=2.5 * axis.mass * rate, Tn=1.4 / rate, velocity_encoder=axis.velocity_encoder)
        if not isinstance(present, CascadePPI):
            return (Start(cls.title, law), _observed(law))
        changed = [
            text
            for text, differs in (
                ("with an integral, which the present control does not have", present.Tn is None),
                ("the whole set velocity fed forward", present.velocity_feedforward != 1.0),
            )
            if differs
        ]
        gains = law if present.Tn is None else present
        law = replace(present, Kv=gains.Kv, Kp=gains.Kp, Tn=gains.Tn, velocity_feedforward=1.0)
        return (Start(cls.title, law, "; ".join(changed)), _observed(law))

    class Prepared(NamedTuple):
        """The sample time in s."""

        T: Number

    class State(NamedTuple):
        """The past positions, newest first (m), the integral (N), and the memory of the options, empty without them."""

        positions: tuple[Number, ...]
        integral: Number
        interpolator: tuple[Interpolator, ...] = ()
        model: tuple[ReferenceModel, ...] = ()
        smoothed: tuple[Number, ...] = ()

    def period(self) -> int:
        """Return `position_every`, the period of the law in samples."""
        return self.position_every

    def at_one_rate(self) -> Self:
        """Return the cascade with its position loop in every sample."""
        return replace(self, position_every=1)

    def position_gain(self) -> Number:
        return self.Kv

    def prepare(self, T: Number) -> Prepared:
        """Return the sample time, which is needed for a start in motion."""
        return self.Prepared(T)

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state at the measured velocity, with the integral equal to the acting force.

        The position loop runs in the first sample.
        """
        position = reading.position(self.velocity_encoder)
        zero = ops.zero(position)
        passed = prepared.T * reading.velocity
        # a past at constant velocity: enabled in motion, the first difference is the true velocity
        positions = (position, *(position - float(i) * passed for i in range(1, self.velocity_samples)))
        model = () if self.model_mass is None else (reference_model(self.model_samples, reading.velocity, zero),)
        smoothed = () if self.velocity_lag is None else (zero + reading.velocity,)
        return self.State(positions, reading.applied, interpolator(self.position_every, zero), model, smoothed)

    def step(
        self, prepared: object, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        position = reading.position(self.velocity_encoder)
        velocity = (position - state.positions[-1]) / (self.velocity_samples * T)
        smoothed, velocity = smoothed_velocity(state.smoothed, velocity, self.velocity_lag, T)
        wanted = commanded_velocity(self.Kv, self.velocity_feedforward, setpoint, reading, T)
        interpolator, wanted = interpolated(state.interpolator, wanted, self.position_every)
        e = wanted - velocity
        model, expected = expected_velocity(state.model, wanted, self.Kp, self.model_mass, T)
        missed = expected - velocity
        positions = (position, *state.positions[:-1])
        force = self.Kp * e if self.viscous is None else self.Kp * e + self.viscous * velocity
        if self.Tn is None:
            return self.State(positions, state.integral, interpolator, model, smoothed), force
        integral = state.integral + (reading.applied - reading.requested)
        integral = integral + (self.Kp * T / self.Tn) * missed
        return self.State(positions, integral, interpolator, model, smoothed), force + integral

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Return the state unchanged: it holds positions, velocities, and an integral and forces in N."""
        return state


def _observed(law: CascadePPI) -> Start:
    """Return the P-P cascade as a starting point of the search.

    It is tried only together with an observer, which provides the integral action.
    """
    return Start("P-P", replace(law, Tn=None), "the observer is its integral", only_with=("DOB",))
