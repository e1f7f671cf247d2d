"""A loop: one axis with its controller, and the order in which one sample is computed."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Annotated, Any, NamedTuple, Self

from feeddrive.blocks.signals import Motion, Noise, Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Block, Number, Rule, label, parameter, part
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.units import Unit, units_of
from feeddrive.language.units import turning as turned
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.core import advance
from feeddrive.loop.hold import Hold, Timing


class Signals(NamedTuple):
    """The signals that can be recorded; row k contains the values at t = kT; forces are those commanded at kT or acting
    from kT onward.
    """

    set_position: Annotated[Number, Unit("m")]
    set_velocity: Annotated[Number, Unit("m/s")]
    set_acceleration: Annotated[Number, Unit("m/s2")]
    position_motor: Annotated[Number, Unit("m")]  # true
    position_load: Annotated[Number, Unit("m")]  # true
    velocity_motor: Annotated[Number, Unit("m/s")]  # true
    velocity_load: Annotated[Number, Unit("m/s")]  # true
    reading_motor: Annotated[Number, Unit("m")]  # as the controller sees it
    reading_load: Annotated[Number, Unit("m")]
    following_error: Annotated[Number, Unit("m")]  # setpoint - reading of the load
    tracking_error: Annotated[Number, Unit("m")]  # setpoint - true position of the load
    force: Annotated[Number, Unit("N")]  # commanded
    requested: Annotated[Number, Unit("N")]  # wanted before the limit
    feedback: Annotated[Number, Unit("N")]  # part of the law
    feedforward: Annotated[Number, Unit("N")]
    compensation: Annotated[Number, Unit("N")]  # subtracted disturbance and the like
    drive_force: Annotated[Number, Unit("N")]  # acting in the last substep
    friction_motor: Annotated[Number, Unit("N")]
    friction_load: Annotated[Number, Unit("N")]
    load_force: Annotated[Number, Unit("N")]
    trip: Annotated[Number, Unit("")]  # 0, or the code of the guard


class ToolPoint(NamedTuple):
    """The additional signals of a machine with geometry errors: the position of the tool, such as `tool.x`."""

    x: Annotated[Number, Unit("m")]
    y: Annotated[Number, Unit("m")]
    z: Annotated[Number, Unit("m")]


class Probe(NamedTuple):
    """Points at which a loop can be opened or excited for analysis; unused ones add no operations to the program."""

    cut: Annotated[Number | None, Unit("N")] = None  # replaces the command of the control: the loop is open
    added_force: Annotated[Number | None, Unit("N")] = None  # added to the command between control and axis
    reading_motor: Annotated[Number | None, Unit("m")] = None  # added to the reading of the motor's encoder
    reading_load: Annotated[Number | None, Unit("m")] = None  # added to the reading of the load's encoder

    def read(self, motor: Number, load: Number) -> tuple[Number, Number]:
        """Return the readings of both encoders as the controller receives them."""
        motor = motor if self.reading_motor is None else motor + self.reading_motor
        return motor, load if self.reading_load is None else load + self.reading_load

    def acting(self, command: Number) -> Number:
        """Return the force command that reaches the axis: `cut`, otherwise the controller's command, plus
        `added_force`.
        """
        acting = command if self.cut is None else self.cut
        return acting if self.added_force is None else acting + self.added_force


UNITS = {**units_of(Signals), **units_of(ToolPoint)}
SETPOINT = tuple(f"set_{name}" for name in Setpoint._fields)


def quantity(signal: str) -> str:
    """Return the name of a signal without its axis prefix: `force` for `x.force`."""
    return signal.rpartition(".")[2]


# signals and probes that are commands of the control, or parts of one
COMMANDS = frozenset(("force", "requested", "feedback", "feedforward", "compensation", "cut", "added_force"))


def unit_of(
    signal: str, turning: Collection[str], unit: str | None = None, by_velocity: Collection[str] = frozenset()
) -> str:
    """Return the unit of a signal, an angular unit for a rotary axis; `unit` is the unit for a linear axis (default:
    SI). `turning` holds the signal prefixes of rotary axes, such as `c.`, and `by_velocity` those of axes whose drives
    are commanded by velocities: their commands are in m/s.
    """
    name = quantity(signal)
    prefix = signal.removesuffix(name)
    unit = UNITS[name] if unit is None else unit
    unit = "m/s" if name in COMMANDS and prefix in by_velocity else unit
    return turned(unit) if prefix in turning else unit


def response_unit(commanded: str) -> str:
    """Return the unit of the response from a command, "force" or "velocity", to a position of a linear axis."""
    return {"force": "m/N", "velocity": "m/(m/s)"}[commanded]


class Loop(Block):
    """An axis, its controller and the sample time.

    At sample k the encoders read the plant at t = kT, `Control` computes the force, which acts after the dead time, and
    the plant advances to (k+1)T in `axis.substeps` substeps, with exact discretization of the linear mechanics.
    """

    control: Control = part("all that runs on the controller")
    axis: Axis = part("all that is physics")
    sample_time: Number = parameter("s", "time from sample to sample", above=0)
    name: str = label("name of the axis", default="x")

    class Prepared(NamedTuple):
        """The numbers that `prepare` computes from the parameters of the controller and the axis."""

        control: Any
        axis: Hold

    class State(NamedTuple):
        """The states of the controller and the axis."""

        control: Any
        axis: Any

    def place_of(self, field: str) -> str:
        """Return the path of a field as in a machine file: `axis.x` for the physics, `axis.x.control` for the
        controller.
        """
        place = f"axis.{self.name}"
        return {"axis": place, "control": f"{place}.control"}.get(field, field)

    def later(self, samples: int) -> Self:
        """Return the loop with additional samples of dead time."""
        if samples == 0:
            return self
        actuator = self.axis.actuator
        dead_time = actuator.dead_time + samples * float(self.sample_time)
        return replace(self, axis=replace(self.axis, actuator=replace(actuator, dead_time=dead_time)))

    def require(self) -> None:
        """Check the block; errors from the controller or the physics are raised with the name of the axis."""
        try:
            # symbols and variants are checked by the rules of the whole loop
            if isinstance(self.sample_time, float):
                self.check()
                tree.check_sampled(self, self.sample_time)
            else:
                super().require()
        except (ParameterError, StructureError) as error:
            raise type(error)(tree.in_paths(self, str(error))) from None

    def check(self) -> None:
        """Check that the axis has the encoders that the law needs, and that the dead time can be simulated."""
        if self.control.law.positions() > self.axis.encoders():
            raise StructureError(
                f"control.law: {self.control.law.kind} needs the position of the motor and that of the load, but the "
                f"axis gives one for both: give it two encoders, or take a law with one, such as cascade_ppi"
            )
        takes, commanded = self.axis.actuator.commanded, self.control.law.commanded
        if takes != commanded:
            advice = (
                "take a law that commands a velocity, such as position_loop"
                if takes == "velocity"
                else "take a law that commands a force, such as cascade_ppi, or give the axis an actuator.velocity_loop"
            )
            raise StructureError(
                f"control.law: {self.control.law.kind} commands a {commanded}, and the drive of the axis takes a "
                f"{takes}: {advice}"
            )
        # symbols and variants are checked when a run is prepared
        if isinstance(self.sample_time, float) and isinstance(self.axis.actuator.dead_time, float):
            self.timing()

    def rules(self) -> Iterator[Rule]:
        """Return the rules of all parts at this sample time."""
        return tree.sampled_rules(self, self.sample_time)

    def timing(self, partial: Collection[str] = ()) -> Timing:
        """Return the number of whole samples of dead time, and whether a fraction remains. An axis in `partial` keeps
        the structure of a fractional dead time even if the fraction is 0.
        """
        if not isinstance(self.sample_time, float):
            raise StructureError("loop.sample_time is a constant of the design: it cannot vary within a batch")
        timing = self.axis.timing(self.sample_time)
        return timing._replace(partial=True) if self.name in partial else timing

    def prepare(self, timing: Timing) -> Prepared:
        """Compute everything that depends on parameters only."""
        T = self.sample_time
        return self.Prepared(self.control.prepare(T), self.axis.prepare(T, timing))

    def start(
        self, prepared: Prepared, timing: Timing, setpoint: Setpoint, position: Number, velocity: Number
    ) -> State:
        """Return the state of an axis at `position` (m) and `velocity` (m/s), with the controller just switched on.

        The controller is assumed to have read the position one sample earlier, so that its first velocity is correct.
        """
        return self.started(prepared.control, timing, setpoint, position, velocity)

    def started(
        self, prepared: Control.Prepared, timing: Timing, setpoint: Setpoint, position: Number, velocity: Number
    ) -> State:
        """Return the same state as `start`, from the precomputed coefficients of the controller alone."""
        axis = self.axis.start(position, velocity, timing)
        # the readings of one sample before, so that the first difference is the velocity
        motor, load = self.axis.still(position - velocity * self.sample_time)
        return self.State(self.control.start(prepared, setpoint, motor, load, velocity), axis)

    def step(
        self,
        prepared: Prepared,
        state: State,
        setpoint: Setpoint,
        load: Number | None,
        noise: Noise,
        enable: Number,
        time: Number,
        probe: Probe | None = None,
    ) -> tuple[State, Signals]:
        """Compute one sample. `load` is a force on the table in N, or None; `probe` is for analysis only."""
        T = self.sample_time
        probe = probe or Probe()
        motion = self.axis.motion(state.axis)
        axis, motor, reading = self.axis.read(state.axis, motion, noise, T)
        motor, reading = probe.read(motor, reading)
        control, command = self.control.step(prepared.control, state.control, setpoint, motor, reading, enable, T)
        axis, done = advance(self.axis, prepared.axis, axis, probe.acting(command.applied), load, time, T)
        return self.State(control, axis), reported(setpoint, motion, motor, reading, command, done, load)

    def ports(self) -> tuple[str, ...]:
        """Return the signal prefix of each axis: empty, since there is one axis."""
        return ("",)

    def signals(self) -> list[str]:
        """Return the names of the loop's signals."""
        return list(Signals._fields)

    def loops(self) -> dict[str, Self]:
        """Return a one-entry mapping from the axis name to this loop."""
        return {self.name: self}

    def sample(
        self, prepared: Prepared, state: State, inputs: Mapping[str, Number], noise: Noise, time: Number
    ) -> tuple[State, dict[str, Number]]:
        """Compute one sample from named inputs: `set_position` ... `set_snap`, `load_force`, `enable`, and those of
        `Probe`.
        """
        setpoint, load, enable, probe = inputs_of(inputs, "")
        after, signals = self.step(prepared, state, setpoint, load, noise, enable, time, probe)
        return after, signals._asdict()


def inputs_of(inputs: Mapping[str, Number], port: str) -> tuple[Setpoint, Number | None, Number, Probe]:
    """Return setpoint, load force, enable and probe of the axis with prefix `port`; missing inputs are None."""
    setpoint = Setpoint(*(inputs[f"{port}{name}"] for name in SETPOINT))
    probe = Probe(**{name: inputs.get(f"{port}{name}") for name in Probe._fields})
    return setpoint, inputs.get(f"{port}load_force"), inputs.get(f"{port}enable", 1.0), probe


def reported(
    setpoint: Setpoint,
    motion: Motion,
    motor: Number,
    reading: Number,
    command: Control.Command,
    done: Axis.Step,
    load: Number | None,
) -> Signals:
    """Return the signals of an axis for one sample."""
    return Signals(
        set_position=setpoint.position,
        set_velocity=setpoint.velocity,
        set_acceleration=setpoint.acceleration,
        position_motor=motion.position_motor,
        position_load=motion.position_load,
        velocity_motor=motion.velocity_motor,
        velocity_load=motion.velocity_load,
        reading_motor=motor,
        reading_load=reading,
        following_error=setpoint.position - reading,
        tracking_error=setpoint.position - motion.position_load,
        force=command.applied,
        requested=command.requested,
        feedback=command.feedback,
        feedforward=command.feedforward,
        compensation=command.compensation,
        drive_force=done.drive,
        friction_motor=done.friction_motor,
        friction_load=done.friction_load,
        load_force=0.0 if load is None else load,
        trip=command.trip,
    )
