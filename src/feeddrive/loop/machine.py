"""A machine: named axes with a common sample time, their controllers, and the couplings between them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple, TypeAlias

from feeddrive.blocks.coupling.geometry import Geometry
from feeddrive.blocks.families import Coupling
from feeddrive.blocks.signals import Motion, Noise, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Block, Number, Rule, choice, label, parameter, part
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.core import Acting, Joint, Shared, acting, named
from feeddrive.loop.hold import JointHold
from feeddrive.loop.loop import SETPOINT, Loop, Signals, inputs_of, reported


class ControlInputs(NamedTuple):
    """The inputs of a controller in a sample: setpoint, the readings of the motor and the load in m, and enable."""

    setpoint: Setpoint
    motor: Number
    load: Number
    enable: Number


class Controls:
    """The controllers of axes by name with the couplings between them: a machine without its physics.

    for each axis:   its guard checks setpoint and readings
    couplings:       correct the velocity commands of the laws, from the setpoints and readings that the guards pass on
    for each axis:   compensation, law, filters, feedforward, limit
    """

    def __init__(self, controls: Mapping[str, Control], couplings: Sequence[Coupling]) -> None:
        self.controls, self.couplings = dict(controls), tuple(coupling for coupling in couplings if coupling.controls)

    def listen(self, setpoints: Mapping[str, Setpoint]) -> tuple[Any, ...]:
        """Return the initial states of the couplings between the controllers."""
        return tuple(coupling.listen(_of(coupling, setpoints)) for coupling in self.couplings)

    def step(
        self,
        prepared: Sequence[Any],
        states: Mapping[str, Any],
        between: tuple[Any, ...],
        readings: Mapping[str, ControlInputs],
        T: Number,
    ) -> tuple[dict[str, Any], tuple[Any, ...], dict[str, Control.Command]]:
        """Compute one sample: the states of the controllers and of their couplings, and the commands by axis."""
        judged = {
            name: control.judge(coefficients, states[name], *readings[name])
            for (name, control), coefficients in zip(self.controls.items(), prepared, strict=True)
        }
        moved = {name: control.moved(states[name]) for name, control in self.controls.items()} if self.couplings else {}
        between, added = self._corrected(between, judged, moved)
        after: dict[str, Any] = {}
        commands: dict[str, Control.Command] = {}
        for (name, control), coefficients in zip(self.controls.items(), prepared, strict=True):
            after[name], commands[name] = control.answer(coefficients, states[name], judged[name], T, added.get(name))
        return after, between, commands

    def _corrected(
        self, between: tuple[Any, ...], judged: Mapping[str, Control.Judged], moved: Mapping[str, Any]
    ) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """Return the new states of the couplings and, for each axis, the velocity that they add. A coupling adds 0
        while one of its axes is not running.

        `moved` is, for each axis, the part of the compensations' shift of the set position that only corrects the
        encoder reading for pitch errors, and therefore does not count as contour error.
        """
        setpoints = {name: judgment.setpoint for name, judgment in judged.items()}
        positions = {name: judgment.load - moved[name] if moved else judgment.load for name, judgment in judged.items()}
        added: dict[str, Any] = {}
        remembered: list[Any] = []
        for coupling, held in zip(self.couplings, between, strict=True):
            after, corrections = coupling.correct(held, _of(coupling, setpoints), _of(coupling, positions))
            verdicts = [judged[name].verdict for name in coupling.axes() if judged[name].verdict is not None]
            runs = reduce(ops.both, (verdict.usual for verdict in verdicts)) if verdicts else None
            for name, velocity in corrections.items():
                used = velocity if runs is None else ops.where(runs, velocity, 0.0)
                added[name] = added[name] + used if name in added else used
            remembered.append(after)
        return tuple(remembered), added


def _of(coupling: Coupling, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of the axes of a coupling."""
    return {name: values[name] for name in coupling.axes()}


class Controller(Block):
    """The controller of an axis, and the motor that converts its force to the drive's unit: the part that runs on a
    target.
    """

    control: Control = part("all that runs on the controller")
    motor: Any = part("what makes the force", default=None)
    encoders: int = choice("encoders of the axis", options=(1, 2), default=1)
    name: str = label("name of the axis", default="x")

    def place_of(self, field: str) -> str:
        """Return the path of a field in the loop."""
        place = f"axis.{self.name}"
        return {"control": f"{place}.control", "motor": f"{place}.actuator.motor"}.get(field, field)

    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs of a sample."""
        return (*SETPOINT, *_readings(self.encoders), "enable")

    def prepare(self, T: Number) -> Any:
        """Compute everything that depends on parameters only."""
        return self.control.prepare(T)

    def start(self, prepared: Any, inputs: Mapping[str, Any]) -> Any:
        """Return the initial state for an axis at rest at the position in `inputs`."""
        return self.control.start(prepared, *_control_inputs(inputs, "")[:3])

    def step(self, prepared: Any, state: Any, inputs: Mapping[str, Any], T: Number) -> tuple[Any, dict[str, Any]]:
        """Compute one sample: the state, and the outputs by name."""
        answer = self.control.step(prepared, state, *_control_inputs(inputs, ""), T)
        return answer[0], _outputs(answer[1], self.motor, "")

    def retune(self, state: Any, old: Controller, old_prepared: Any, prepared: Any) -> Any:
        """Return the state after a live change from `old` to this controller."""
        return self.control.retune(state, old.control, old_prepared, prepared)

    def check_live(self, old: Controller) -> None:
        """Raise StructureError if this controller differs from `old` in more than parameter values."""
        self.control.check_live(old.control)


class Drive(Block):
    """The motor of an axis."""

    motor: Any = part("what makes the force", default=None)


class Controlled(Block):
    """The controller of one axis of a machine, with its drive."""

    control: Control = part("all that runs on the controller")
    actuator: Drive = part("what makes the force")
    encoders: int = choice("encoders of the axis", options=(1, 2), default=1)


class Controllers(Block):
    """The controllers of all axes of a machine, with the couplings between them: the part that runs on a target."""

    axis: Any = part("axes by name")
    couplings: tuple[Any, ...] = part(
        "what runs between the controls, by place in the machine; else absent", default=()
    )

    class State(NamedTuple):
        """The states of the controllers by axis, and of the couplings between them."""

        axis: Any
        couplings: tuple[Any, ...]

    def controls(self) -> Controls:
        """Return the controllers and their couplings as the `Controls` object that computes a sample."""
        there = [coupling for coupling in self.couplings if coupling is not None]
        return Controls({name: axis.control for name, axis in self.axis._asdict().items()}, there)

    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs of a sample, prefixed by their axis."""
        axes: dict[str, Controlled] = self.axis._asdict()
        return tuple(
            f"{name}.{signal}"
            for name, axis in axes.items()
            for signal in (*SETPOINT, *_readings(axis.encoders), "enable")
        )

    def prepare(self, T: Number) -> Any:
        """Compute everything that depends on parameters only, by axis."""
        return type(self.axis)(*(axis.control.prepare(T) for axis in self.axis))

    def start(self, prepared: Any, inputs: Mapping[str, Any]) -> State:
        """Return the initial states for axes at rest at the positions in `inputs`."""
        readings = {name: _control_inputs(inputs, f"{name}.") for name in self.axis._fields}
        begun = (
            axis.control.start(coefficients, *readings[name][:3])
            for name, axis, coefficients in zip(self.axis._fields, self.axis, prepared, strict=True)
        )
        setpoints = {name: reading.setpoint for name, reading in readings.items()}
        return self.State(type(self.axis)(*begun), self.controls().listen(setpoints))

    def step(self, prepared: Any, state: State, inputs: Mapping[str, Any], T: Number) -> tuple[State, dict[str, Any]]:
        """Compute one sample: the state, and the outputs by name."""
        readings = {name: _control_inputs(inputs, f"{name}.") for name in self.axis._fields}
        answer = self.controls().step(prepared, state.axis._asdict(), state.couplings, readings, T)
        outputs = {
            key: value
            for name, axis in self.axis._asdict().items()
            for key, value in _outputs(answer[2][name], axis.actuator.motor, f"{name}.").items()
        }
        return self.State(type(self.axis)(**answer[0]), answer[1]), outputs

    def retune(self, state: State, old: Controllers, old_prepared: Any, prepared: Any) -> State:
        """Return the states after a live change from `old` to these controllers; the couplings between them keep their
        states.
        """
        rows = zip(self.axis, state.axis, old.axis, old_prepared, prepared, strict=True)
        return state._replace(
            axis=type(self.axis)(
                *(
                    new.control.retune(held, before.control, was, coefficients)
                    for new, held, before, was, coefficients in rows
                )
            )
        )

    def check_live(self, old: Controllers) -> None:
        """Raise StructureError if these controllers differ from `old` in more than parameter values."""
        for new, before in zip(self.axis, old.axis, strict=True):
            new.control.check_live(before.control)


def _readings(encoders: int) -> tuple[str, ...]:
    return ("reading_motor", "reading_load") if encoders == 2 else ("reading",)


def _control_inputs(inputs: Mapping[str, Any], port: str) -> ControlInputs:
    """Return the inputs of one controller, by prefix; a single encoder gives both readings."""
    setpoint = Setpoint(*(inputs[f"{port}{field}"] for field in SETPOINT))
    single = inputs.get(f"{port}reading")
    motor, load = (inputs[f"{port}{field}"] for field in _readings(2)) if single is None else (single, single)
    return ControlInputs(setpoint, motor, load, inputs[f"{port}enable"])


def _outputs(command: Control.Command, motor: Any, port: str) -> dict[str, Any]:
    scaled = {} if motor is None else {f"{port}command": command.applied / motor.force_per_unit()}
    outputs = {f"{port}force": command.applied, **scaled}
    return {**outputs, f"{port}trip": command.trip, f"{port}enabled": command.running}


def controller_of(loop: Loop) -> Controller:
    """Return the part of a loop that runs on a target."""
    motor = loop.axis.actuator.motor
    return Controller(control=loop.control, motor=motor, encoders=loop.axis.encoders(), name=loop.name)


def motors(block: Controller | Controllers) -> Iterator[tuple[str, Any]]:
    """Yield, for each axis, the prefix of its outputs and its motor (None if not specified)."""
    if isinstance(block, Controller):
        yield "", block.motor
    else:
        yield from ((f"{name}.", axis.actuator.motor) for name, axis in block.axis._asdict().items())


_TOOL = "tool"  # prefix of the signals of the tool point
# Between the seeds of two axes: with seeds of users below it, no axis repeats the noise of another.
_SEEDS = 2.0**40


class DrivenAxis(Block):
    """An axis of a machine: its physics and its controller, which together form one loop."""

    control: Control = part("all that runs on the controller")
    axis: Axis = part("all that is physics", inline=True)


class Machine(Block):
    """Named axes that run at one sample time as one program; signals are prefixed by the axis: `x.tracking_error`.

        for each substep: coupling forces at its middle → forces of each axis → exact linear step → friction

    Axes that share structure modes are discretized together, every other axis separately, so a machine with one
    axis gives the same results as its loop.  Couplings act at common substeps, based on the motions of all axes at the
    same instant.  `axis` is a mapping from names to `DrivenAxis`; `Machine.of` takes loops.
    """

    axis: Any = part("axes by name")
    couplings: tuple[Coupling, ...] = part("what acts between them", default=())
    geometry: Geometry | None = part("geometry errors; with them there are the signals tool.x ...", default=None)
    sample_time: Number = parameter("s", "time from sample to sample", above=0)

    class Prepared(NamedTuple):
        """The numbers that `prepare` computes from the parameters of the controllers, the axes and the couplings."""

        control: Any
        cores: tuple[JointHold, ...]
        couplings: tuple[Any, ...]

    class State(NamedTuple):
        """The states of the axes by name, the modes of each core, the couplings, and the controllers' couplings."""

        axis: Any
        shared: tuple[Shared, ...]
        couplings: tuple[Any, ...]
        coordination: tuple[Any, ...]

    def __post_init__(self) -> None:
        if isinstance(self.axis, Mapping):
            axes: Mapping[str, DrivenAxis] = self.axis
            # a named tuple is a node of a tree, whose leaves have paths; a mapping is not
            object.__setattr__(self, "axis", named(axes))
        super().__post_init__()

    @classmethod
    def of(
        cls, loops: Mapping[str, Loop], couplings: tuple[Coupling, ...] = (), geometry: Geometry | None = None
    ) -> Machine:
        """Build a machine from loops. Raises ParameterError if their sample times differ."""
        times = {name: float(loop.sample_time) for name, loop in loops.items()}
        if len(set(times.values())) != 1:
            shown = joined(", ", (f"{name}: {Quantity(time, 's'):6 SI}" for name, time in times.items()))
            raise ParameterError(f"the axes of a machine have one sample time, not {shown or 'none'}")
        axes = {name: DrivenAxis(control=loop.control, axis=loop.axis) for name, loop in loops.items()}
        return cls(axis=named(axes), couplings=couplings, geometry=geometry, sample_time=next(iter(times.values())))

    def axes(self) -> dict[str, DrivenAxis]:
        """Return the axes by name."""
        return dict(zip(self.axis._fields, self.axis, strict=True))

    def loop(self, name: str) -> Loop:
        """Return the loop of one axis alone, without couplings. Raises ParameterError for an unknown name."""
        axes = self.axes()
        if name not in axes:
            raise ParameterError(f"the machine has no axis '{name}'; it has {', '.join(axes)}")
        return Loop(control=axes[name].control, axis=axes[name].axis, sample_time=self.sample_time, name=name)

    def loops(self) -> dict[str, Loop]:
        """Return the loop of each axis alone."""
        return {name: self.loop(name) for name in self.axes()}

    def with_loops(self, loops: Mapping[str, Loop]) -> Machine:
        """Return a copy of the machine with other loops on its axes."""
        return Machine.of({**self.loops(), **loops}, self.couplings, self.geometry)

    def check(self) -> None:
        """Check that couplings name existing axes, that all axes have the same number of substeps, and that each axis
        with its controller is a valid loop.
        """
        axes = self.axes()
        if not axes:
            raise StructureError("a machine needs at least one axis")
        substeps = {name: axis.axis.substeps for name, axis in axes.items()}
        if len(set(substeps.values())) > 1:
            shown = ", ".join(f"{name}: {count}" for name, count in substeps.items())
            raise StructureError(
                f"the axes of a machine have one number of substeps, at which forces between them act, not {shown}"
            )
        for i, coupling in enumerate(self.couplings):
            for name in coupling.axes():
                if name not in axes:
                    raise StructureError(f"couplings.{i}: {coupling.kind} acts on axis '{name}', which is not there")
            for name in each_controlled(coupling):
                law = axes[name].control.law
                if law.position_gain() is None or axes[name].axis.rotary:
                    why = "turns" if axes[name].axis.rotary else f"has the law {law.kind}, which commands no velocity"
                    raise StructureError(
                        f"couplings.{i}: {coupling.kind} adds to the velocity that the law of each axis commands, and "
                        f"axis '{name}' {why}: take axes that move along lines, under a law such as cascade_ppi"
                    )
        self._check_geometry(axes)
        if isinstance(self.sample_time, float):
            # the constructor of a loop runs all its checks
            for name in axes:
                self.loop(name)

    def _check_geometry(self, axes: Collection[str]) -> None:
        for way, name in {} if self.geometry is None else self.geometry.axes().items():
            if name not in axes:
                raise StructureError(
                    f"geometry.along_{way}: axis '{name}' is not there; the machine has {', '.join(axes)}"
                )
        if self.geometry is not None and _TOOL in axes:
            raise StructureError(f"an axis cannot be named '{_TOOL}': signals of the tool point are {_TOOL}.x ...")

    def rules(self) -> Iterator[Rule]:
        """Yield the conditions on couplings and shared modes; the rules of the axes are those of their loops."""
        yield from self.joint().rules(self.sample_time)

    def joint(self) -> Joint:
        """Return the physics of all axes."""
        return Joint({name: axis.axis for name, axis in self.axes().items()}, self.couplings)

    def ports(self) -> tuple[str, ...]:
        """Return the signal prefix of each axis."""
        return tuple(f"{name}." for name in self.axes())

    def signals(self) -> list[str]:
        """Return the names of all signals: those of each axis, and with a geometry those of the tool point."""
        there = [f"{port}{name}" for port in self.ports() for name in Signals._fields]
        return there if self.geometry is None else [*there, *(f"{_TOOL}.{way}" for way in self.geometry.axes())]

    def timing(self, partial: Collection[str] = ()) -> Any:
        """Return, for each axis, the number of whole samples of dead time and whether a fraction remains; see
        `Loop.timing`.
        """
        if not isinstance(self.sample_time, float):
            raise StructureError("machine.sample_time is a constant of the design: it cannot vary within a batch")
        return named({name: loop.timing(partial) for name, loop in self.loops().items()})

    def prepare(self, timing: Any) -> Prepared:
        """Compute everything that depends on parameters only."""
        T, axes = self.sample_time, self.axes()
        controls = named({name: axis.control.prepare(T) for name, axis in axes.items()})
        return self.Prepared(controls, *self.joint().prepare(T, dict(zip(axes, timing, strict=True))))

    def start(self, prepared: Prepared, timing: Any, setpoint: Any, position: Any, velocity: Any) -> State:
        """Return the state for `position` (m) and `velocity` (m/s) of each axis, both by axis; see `Loop.start`."""
        started: dict[str, Loop.State] = {}
        motions: dict[str, Motion] = {}
        for name, coefficients, held in zip(self.axes(), prepared.control, timing, strict=True):
            at, speed = position[name], velocity[name]
            started[name] = self.loop(name).started(coefficients, held, setpoint[name], at, speed)
            motions[name] = Motion(at, at, speed, speed)
        states = {name: begun_loop.axis for name, begun_loop in started.items()}
        begun = self.joint().start(Joint.Prepared(prepared.cores, prepared.couplings), states, motions)
        return self.State(named(started), begun.shared, begun.couplings, self.controls().listen(setpoint))

    def controls(self) -> Controls:
        """Return the controllers of all axes and the couplings between them."""
        return Controls({name: axis.control for name, axis in self.axes().items()}, self.couplings)

    def sample(
        self, prepared: Prepared, state: State, inputs: Mapping[str, Number], noise: Noise, time: Number
    ) -> tuple[State, dict[str, Number]]:
        """Compute one sample from named inputs such as `x.set_position`; return the signals by name."""
        T, axes, joint = self.sample_time, self.axes(), self.joint()
        states = dict(zip(axes, state.axis, strict=True))
        joint_prepared = Joint.Prepared(prepared.cores, prepared.couplings)
        columns = joint.columns(joint_prepared)
        moved: dict[str, Axis.State] = {name: held.axis for name, held in states.items()}
        before = Joint.State(named(moved), state.shared, state.couplings)
        read: dict[str, Any] = {}
        readings: dict[str, ControlInputs] = {}
        at: dict[str, Acting] = {}
        # all encoders before any control: couplings between controls need readings of one instant
        for i, (name, axis) in enumerate(axes.items()):
            setpoint, load, enable, probe = inputs_of(inputs, f"{name}.")
            motion = joint.motion(name, before)
            moved[name], motor, reading = axis.axis.read(moved[name], motion, noise_of(noise, i), T)
            motor, reading = probe.read(motor, reading)
            readings[name] = ControlInputs(setpoint, motor, reading, enable)
            read[name] = setpoint, motion, motor, reading, probe, load
        held = {name: loop.control for name, loop in states.items()}
        controls, between, commands = self.controls().step(prepared.control, held, state.coordination, readings, T)
        for name, (*_, probe, load) in read.items():
            force = probe.acting(commands[name].applied)
            at[name], moved[name] = acting(columns[name], moved[name], force, load)
        after, done, loads = joint.advance(joint_prepared, before._replace(axis=named(moved)), at, time, T)
        signals: dict[str, Number] = {}
        for name, (setpoint, motion, motor, reading, *_) in read.items():
            row = reported(setpoint, motion, motor, reading, commands[name], done[name], loads[name])
            signals |= {f"{name}.{signal}": value for signal, value in zip(Signals._fields, row, strict=True)}
        if self.geometry is not None:
            position = {name: row[1].position_load for name, row in read.items()}
            signals |= {f"{_TOOL}.{way}": at for way, at in self.geometry.tool(position).items()}
        held = {name: Loop.State(controls[name], axis) for name, axis in zip(axes, after.axis, strict=True)}
        return self.State(named(held), after.shared, after.couplings, between), signals


System: TypeAlias = Loop | Machine  # what is traced to a program


def each_controlled(coupling: Coupling) -> tuple[str, ...]:
    """Return the axes whose controllers a coupling corrects."""
    return coupling.axes() if coupling.controls else ()


def noise_of(noise: Noise, place: int) -> Noise:
    """Return the noise of the axis with this index."""
    # the first axis has the noise of its loop alone
    return noise if place == 0 else Noise(noise.seed + place * _SEEDS, noise.sample)


def turning_ports(system: System) -> frozenset[str]:
    """Return the signal prefixes of the rotary axes."""
    pairs = zip(system.loops().values(), system.ports(), strict=True)
    return frozenset(port for loop, port in pairs if loop.axis.rotary)


def velocity_ports(system: System) -> frozenset[str]:
    """Return the signal prefixes of the axes whose drives are commanded by velocities."""
    pairs = zip(system.loops().values(), system.ports(), strict=True)
    return frozenset(port for loop, port in pairs if loop.axis.actuator.commanded == "velocity")


def check_system(system: Any) -> None:
    """Raise ParameterError, with a remedy, for anything but a loop or a machine."""
    if not isinstance(system, Loop | Machine):
        remedy = getattr(system, "instead", "") or "a loop or a machine comes first, then what it follows or is asked"
        raise ParameterError(f"a Loop or a Machine is needed here, not a {type(system).__name__}: {remedy}")
