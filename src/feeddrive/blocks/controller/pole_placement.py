"""Pole placement for screw and table: active damping of the axial mode with two encoders."""

from collections.abc import Iterator
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Start
from feeddrive.blocks.families import Law, Nothing, Plant
from feeddrive.blocks.feedforward.inverse_dynamics import InverseDynamics
from feeddrive.blocks.plant.two_bodies import (
    Gains,
    TwoBodies,
    controllable,
    lag,
    place,
    polynomial,
    relaxed_lead,
    series,
    two_bodies,
    two_mass_model,
)
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number, Rule, choice, parameter, part
from feeddrive.language.errors import StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

# share of the axial mode's natural frequency: moving a mode wastes force, damping it does not
AXIAL_SHARE = 0.975


class PolePlacement(Law):
    """State feedback of screw and table that places all five poles of the closed loop.

        force = K1 (x1r - x1) + K2 (x2r - x2) + K3 (v1r - v1) + K4 (v2r - v2) + Ki Σ T (x2r - x2)
        v1 = (x1(k) - x1(k-1)) / T,  v2 likewise;  x2r, v2r are the setpoint, x1r = x2r + lead, v1r = v2r + lead'
        poles:  -ωc,   s² + 2 rigid_damping ωr s + ωr²,   s² + 2 axial_damping ωa s + ωa²

    The gains follow from `model` by one linear solve, for a diagonal and for a full mass matrix; a pair with a
    damping ratio of 1 or more becomes two real poles, and poles may coincide.  Omitted frequencies default to ωr = ωc
    and to ωa = 0.975 times the model's axial mode.  Choose ωc first, as high as the sensitivity peak allows, then raise
    the damping of the axial mode to about five times the mechanical one.  More does not help, since torsional modes and
    delay then limit the loop.

    `commands` selects how the set position of the screw follows from that of the table (`ScrewCommand` in
    blocks/plant/two_bodies.py).  With the stiffness k and the damping c of the spring, "series" uses a truncated series
    in c/k, "exact" the lag with time constant c/k, discretized by first-order hold.  "rigid" sets both positions equal,
    which needs no model of the spring but loses most of the accuracy.

    If the force was limited in a sample, the term that this sample added to the integral is removed one sample later.
    When to use: ball screws and belts whose first mode lies within three times the desired crossover, with one encoder
    on the motor and one on the table.  Not suitable for a single encoder, or if the frequency of the axial mode changes
    by more than a fifth along the travel.
    Source: Gordon & Erkorkmaz 2013, eq. (1) to (2) and section 2; the integral by backward Euler.
    """

    encoders = 2
    tunables = ("bandwidth", "rigid_damping", "axial_damping")
    title = "pole placement"

    model: Plant = part("screw, table and the spring between them, as the law believes them to be")
    bandwidth: Number = parameter("Hz", "real pole, and the rigid pair if it has no frequency of its own", above=0)
    rigid_frequency: Number | None = parameter(
        "Hz", "frequency of the rigid pair; absent: the bandwidth", above=0, default=None
    )
    rigid_damping: Number = parameter("", "damping ratio of the rigid pair", above=0, default=0.45)
    axial_frequency: Number | None = parameter(
        "Hz", "frequency of the axial pair; absent: 0.975 of the model's mode", above=0, default=None
    )
    axial_damping: Number = parameter("", "damping ratio of the axial pair", above=0, default=0.1)
    commands: str = choice(
        "how the set position of the screw follows from that of the table",
        options=("series", "exact", "rigid"),
        default="series",
    )

    @classmethod
    def begin(cls, axis: AxisModel, present: Law) -> tuple[Start, ...]:
        """Return one variant that uses the screw and table of the axis's plant, with matching `InverseDynamics`."""
        if axis.encoders < 2:
            raise StructureError(
                "pole placement needs the position of the motor and that of the load; the controller reads one encoder"
            )
        model = two_mass_model(axis.plant)
        shown = two_bodies(cls.kind, model)
        mode = shown.mode / (2.0 * ops.pi)
        # a crossover below a third of the mode leaves it to the damping pair
        law = cls(model=model, bandwidth=ops.minimum(0.3 * mode, axis.rate / (2.0 * ops.pi)))
        remark = Text(
            f"model: {Quantity(shown.m11, 'kg'):5} and {Quantity(shown.m22, 'kg'):5}, spring "
            f"{Quantity(shown.k, 'N/m')} ({Quantity(mode, 'Hz')}), friction "
            f"{Quantity(shown.c11 + shown.c12, 'N s/m', bare=True)} and {Quantity(shown.dragged, 'N s/m')}"
        )
        return (Start(cls.title, law, remark, InverseDynamics(model=model)),)

    class Prepared(NamedTuple):
        """The gains, and the coefficients of the exact lag for its last output, the last input and the new input."""

        gains: Gains
        kept: Number = 0.0
        last: Number = 0.0
        new: Number = 0.0

    class Lead(NamedTuple):
        """The state of the exact lag: its last inputs, the leads for an undamped spring, and its outputs (m, m/s)."""

        relaxed: tuple[Number, Number]
        lead: tuple[Number, Number]

    class Series(NamedTuple):
        """The state of the series: the lead in the last sample (m), used only at a live change."""

        position: Number

    class State(NamedTuple):
        """The last readings and their difference at the start (m), Σ T e and its last term (m s), the screw's lead."""

        position_motor: Number
        position_load: Number
        offset: Number
        integral: Number
        added: Number
        lead: Any

    def check(self) -> None:
        """Raise StructureError unless the model has two bodies."""
        two_bodies(self.kind, self.model)

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rules: the model is controllable, and the exact filter is stable."""
        bodies = two_bodies(self.kind, self.model)
        yield controllable(self.kind, bodies)
        if self.commands == "exact" and not matrix.is_zero(bodies.m12):
            yield Rule(
                ops.equal(bodies.m12, 0.0),
                "model.coupling_mass is 0 where commands = 'exact': the filter of the screw's set position is stable",
                lambda: self._unstable_lag(bodies),
            )

    def _unstable_lag(self, bodies: TwoBodies) -> str:
        """Return the error message that explains why the exact filter of the screw's set position cannot be used."""
        m12, c, k = bodies.m12, -bodies.c12, bodies.k
        if m12 > 0.0:
            pole = (c + ops.sqrt(c * c + 4.0 * m12 * k)) / (2.0 * m12)
            why = Text(
                f"is unstable, as for every value > {Quantity(0.0, 'kg')}: its pole is at +{Quantity(pole, '1/s'):6}"
            )
        else:
            ringing = ops.sqrt(-k / m12)
            ratio = -0.5 * c / (m12 * ringing)
            why = Text(
                f"rings at {Quantity(ringing / (2.0 * ops.pi), 'Hz')} with a damping ratio of {Quantity(ratio):3}"
            )
        return Text(
            f"{self.kind}.commands = 'exact': with model.coupling_mass = {Quantity(m12, 'kg'):6} the exact filter of "
            f"the screw's set position {why}; the nearest admissible coupling_mass is {Quantity(0.0, 'kg')}, "
            f"{Quantity(abs(m12), 'kg'):6} away: leave it out, or take commands = 'series'"
        )

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the validity rules: all poles lie below half the sample rate."""
        for name, frequency, damping in (
            ("bandwidth", self.bandwidth, 1.0),
            ("rigid_frequency", self._rigid(), self.rigid_damping),
            ("axial_frequency", self._axial(), self.axial_damping),
        ):
            # with a damping above 1 the pair is two real poles, the faster one at ω (ζ + √(ζ² - 1))
            spread = ops.maximum(damping, 1.0) + ops.sqrt(ops.maximum(damping * damping - 1.0, 0.0))
            yield _below_nyquist(self.kind, name, frequency, damping, spread, 0.5 / T)

    def _rigid(self) -> Number:
        return self.bandwidth if self.rigid_frequency is None else self.rigid_frequency

    def _axial(self) -> Number:
        if self.axial_frequency is not None:
            return self.axial_frequency
        return AXIAL_SHARE * two_bodies(self.kind, self.model).mode / (2.0 * ops.pi)

    def polynomial(self) -> list[Any]:
        """Return the desired characteristic polynomial, coefficients from s⁰ to s⁵."""
        turn = 2.0 * ops.pi
        return polynomial(
            turn * self.bandwidth,
            (turn * self._rigid(), self.rigid_damping),
            (turn * self._axial(), self.axial_damping),
        )

    def gains(self) -> Gains:
        """Return the five gains."""
        return place(two_bodies(self.kind, self.model), self.polynomial())

    def prepare(self, T: Number) -> Prepared:
        """Compute the gains and, for "exact", the first-order-hold coefficients of the lag c/k."""
        if self.commands != "exact":
            return self.Prepared(self.gains())
        # without damping the lag is 0, and the floor keeps its inverse finite
        samples = ops.maximum(lag(two_bodies(self.kind, self.model)) / T, 1e-15)
        kept = ops.exp(-1.0 / samples)
        # first-order hold: the lag answers a ramp between two samples exactly
        mean = samples * (1.0 - kept)
        return self.Prepared(self.gains(), kept, mean - kept, 1.0 - mean)

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state at rest, with the encoders aligned and the integral providing the acting force."""
        zero = ops.zero(reading.position_load)
        lead: Any = Nothing()
        if self.commands == "exact":
            lead = self.Lead((zero, zero), (zero, zero))
        elif self.commands == "series":
            lead = self.Series(zero)
        # two incremental encoders have no common zero
        offset = reading.position_motor - reading.position_load
        held = reading.applied / prepared.gains.Ki
        return self.State(reading.position_motor, reading.position_load, offset, held, zero, lead)

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        K1, K2, K3, K4, Ki = prepared.gains
        v1 = (reading.position_motor - state.position_motor) / T
        v2 = (reading.position_load - state.position_load) / T
        e = setpoint.position - reading.position_load
        e1 = setpoint.position - (reading.position_motor - state.offset)
        ev1, ev2 = setpoint.velocity - v1, setpoint.velocity - v2
        lead = state.lead
        if self.commands == "exact":
            lead = self._followed(prepared, lead, setpoint)
            e1, ev1 = e1 + lead.lead[0], ev1 + lead.lead[1]
        elif self.commands == "series":
            ahead = series(two_bodies(self.kind, self.model), setpoint)
            e1, ev1 = e1 + ahead.position, ev1 + ahead.velocity
            lead = self.Series(ahead.position)
        free = ops.equal(reading.applied, reading.requested)
        added = T * e
        integral = ops.where(free, state.integral, state.integral - state.added) + added
        force = K1 * e1 + K2 * e + K3 * ev1 + K4 * ev2 + Ki * integral
        after = self.State(reading.position_motor, reading.position_load, state.offset, integral, added, lead)
        return after, force

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Keep Ki Σ T e continuous as a force, including the force of K1 on the deflected spring.

        At standstill under load the error of the screw is the deflection of the spring, not 0, and K1 acts on it.
        """
        before, now = old_prepared.gains, prepared.gains
        stretch = state.position_load - (state.position_motor - state.offset)
        if self.commands == "exact":
            stretch = stretch + state.lead.lead[0]
        elif self.commands == "series":
            stretch = stretch + state.lead.position
        ratio = before.Ki / now.Ki
        integral = ratio * state.integral + ((before.K1 - now.K1) / now.Ki) * stretch
        return state._replace(integral=integral, added=ratio * state.added)

    def _followed(self, prepared: Prepared, state: Lead, setpoint: Setpoint) -> Lead:
        """Advance (c s + k) lead = k relaxed_lead and its derivative by one sample, with linearly changing inputs."""
        made = relaxed_lead(two_bodies(self.kind, self.model), setpoint)
        now = (made.position, made.velocity)
        position, velocity = (
            prepared.kept * held + prepared.last * before + prepared.new * new
            for held, before, new in zip(state.lead, state.relaxed, now, strict=True)
        )
        return self.Lead(now, (position, velocity))


def _below_nyquist(kind: str, name: str, frequency: Number, damping: Number, spread: Number, nyquist: Number) -> Rule:
    """Return the rule that the fastest pole of a pair, at `spread` · `frequency`, lies below `nyquist` (Hz)."""
    fastest = frequency * spread
    return Rule(
        fastest < nyquist,
        f"the fastest pole that {name} and its damping ratio place is below half the sample rate",
        lambda: Text(
            f"{kind}.{name} = {Quantity(frequency, 'Hz'):6} with a damping ratio of {Quantity(damping):6} places a "
            f"pole at {Quantity(fastest, 'Hz'):6}, {Quantity(fastest / nyquist):3} times half the sample rate: it must "
            f"be below {Quantity(nyquist, 'Hz'):6}, which {name} < {Quantity(nyquist / spread, 'Hz'):6} gives; lower "
            "it, or sample faster"
        ),
    )
