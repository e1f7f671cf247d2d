"""Control by LinuxCNC's stock `pid` components: one pid on the position, or two in cascade."""

from dataclasses import replace
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Start
from feeddrive.blocks.controller.stock_biquad import StockBiquad
from feeddrive.blocks.controller.stock_pid import StockPid, limited
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, choice, parameter, part


class LinuxcncPid(Law):
    """A controller built from LinuxCNC's components `pid`, `ddt`, `sum2` and `biquad`, connected as in an export.

        command  = units x_set,   feedback = units x_load
        motor    = (units x_motor - units x_motor,₋₁)/T                                      ddt
        forward  = acceleration_gain · units a_set + velocity_gain · units v_set + bias      sum2
        output   = position(command, feedback)                        one pid, `forward` at its pin `bias`
        output   = velocity(position(command, feedback), motor)       two pids, `forward` at the second one's `bias`
        output   = filters(output - forward) + forward, limited to ±maxoutput   where there are filters
        force    = force_per_output · output

    The limit and the integral of the last pid thus include the feedforward, and the filters do not delay it.

    The two pids are a P-PI cascade if the first has Pgain = Kv and FF1 = velocity_feedforward, the second
    Pgain = Kp/c and Igain = Kp/(c Tn), c = units · force_per_output, and `error_previous_target` is off in both.
    With one encoder, one pid is equivalent to both if Pgain = Kp (Kv + 1/Tn)/c, Igain = Kp Kv/(c Tn), Dgain = Kp/c.
    Both forms differ from `CascadePPI` only in the behavior of the integral at the limit.
    The limit is the pid's `maxoutput`; a controller with this law needs no other limit.
    A parameter that is changed in a running loop changes the force at once, as `setp` does.  A pid integrates the
    error, so a new Igain rescales the whole accumulated integral.  A biquad keeps the delayed sums that it
    computed with its old coefficients.

    When to use: to see how a design behaves on an unmodified LinuxCNC before it is installed there.  Not needed with
    the component that the export target `linuxcnc` writes, which computes the original design.
    Source: LinuxCNC manual pages pid(9), ddt(9), sum2(9), biquad(9), limit1(9), motion(9).
    """

    feeds = ("acceleration", "velocity")
    steps_live = True

    @classmethod
    def begin(cls, axis: AxisModel, present: Law) -> tuple[Start, ...]:
        """Return no variants: a comparison omits this law, which is a P-PI cascade with LinuxCNC's parameters."""
        return ()

    position: StockPid = part("pid on the position of the load")
    velocity: StockPid | None = part("pid on the velocity of the motor; absent for one pid alone", default=None)
    filters: tuple[StockBiquad, ...] = part("filters on the feedback part of the output", default=())
    units: Number = parameter("1/m", "machine units in a meter: 1000 for mm", above=0, default=1000)
    force_per_output: Number = parameter("N", "force at the table per unit of the output", above=0, default=1)
    acceleration_gain: Number | None = parameter(
        "", "output per set acceleration in machine units; absent for none", default=None
    )
    velocity_gain: Number | None = parameter(
        "", "output per set velocity in machine units; absent for none", default=None
    )
    command_derivative: str = choice(
        "derivative of the first pid's command: its own difference, or the joint's set velocity",
        options=("difference", "joint"),
        default="difference",
    )
    feedback_derivative: str = choice(
        "derivative of the first pid's feedback: its own difference, or the motor's velocity",
        options=("difference", "motor"),
        default="difference",
    )

    class Prepared(NamedTuple):
        """The sample time in s."""

        T: Number

    class State(NamedTuple):
        """The states of the PIDs and of the filters, and the motor position in machine units."""

        position: Any
        velocity: tuple[Any, ...]
        motor: Number
        filters: tuple[Any, ...]

    def prepare(self, T: Number) -> Prepared:
        """Return the sample time, which is needed for a start in motion."""
        return self.Prepared(T)

    def settled(self) -> Self:
        """Return the law with the limits of its pids removed."""
        velocity = None if self.velocity is None else self.velocity.unlimited()
        return replace(self, position=self.position.unlimited(), velocity=velocity)

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state of pids that have been disabled so far: differences are up to date, integrals are zero."""
        # a pid differences its command: it must have seen that of one sample before
        before, units = setpoint.shifted(-prepared.T), self.units
        motor, moved = units * reading.position_motor, units * reading.velocity
        position = self.position.start(
            units * before.position,
            units * reading.position_load,
            units * setpoint.backward_velocity(prepared.T),
            moved,
        )
        zero = ops.zero(motor)
        velocity = () if self.velocity is None else (self.velocity.start(zero, moved, zero, zero),)
        return self.State(position, velocity, motor, tuple(filter_.start(zero) for filter_ in self.filters))

    def step(
        self, prepared: object, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        """Run the HAL functions in thread order: ddt, sum2, the pids, the filters between two sums, the limit."""
        motor = self.units * reading.position_motor
        speed = (motor - state.motor) / T
        forward = self._forward(setpoint)
        position, output = self.position.step(
            state.position,
            self.units * setpoint.position,
            self.units * reading.position_load,
            T,
            bias=forward if self.velocity is None else None,
            command_deriv=self.units * setpoint.velocity if self.command_derivative == "joint" else None,
            feedback_deriv=speed if self.feedback_derivative == "motor" else None,
        )
        velocity = state.velocity
        if self.velocity is not None:
            held, output = self.velocity.step(velocity[0], output, speed, T, bias=forward)
            velocity = (held,)
        filters, output = self._filtered(state.filters, output, forward)
        return self.State(position, velocity, motor, filters), self.force_per_output * output

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Return the state unchanged, as LinuxCNC does: a pid keeps the integral of the error, not of the force."""
        return state

    def _filtered(
        self, states: tuple[Any, ...], output: Number, forward: Number | None
    ) -> tuple[tuple[Any, ...], Number]:
        """Return the new filter states and the limited output; the feedforward bypasses the filters."""
        if not self.filters:
            return states, output
        last = self.position if self.velocity is None else self.velocity
        beside = last.bias if forward is None else forward
        output = output - beside
        after: list[Any] = []
        for block, state in zip(self.filters, states, strict=True):
            held, output = block.step(state, output)
            after.append(held)
        # the pid's own limit acts before the filters, whose output may exceed it
        return tuple(after), limited(output + beside, last.maxoutput)

    def _forward(self, setpoint: Setpoint) -> Number | None:
        """Return the output of sum2 at the pin `bias` of the last pid; None if the pin is not connected."""
        if self.acceleration_gain is None and self.velocity_gain is None:
            return None
        last = self.position if self.velocity is None else self.velocity
        acceleration = self.acceleration_gain if self.acceleration_gain is not None else 0.0
        velocity = self.velocity_gain if self.velocity_gain is not None else 0.0
        return (
            # in the order of sum2, in0 gain0 + in1 gain1 + offset, for equal bits
            (self.units * setpoint.acceleration) * acceleration
            + (self.units * setpoint.velocity) * velocity
            + last.bias
        )
