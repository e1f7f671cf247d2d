"""A machine: named axes with a common sample time, and the couplings between them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any, NamedTuple, TypeAlias

from feeddrive.blocks.coupling.geometry import Geometry
from feeddrive.blocks.machine_families import Coupling
from feeddrive.blocks.signals import Motion, Noise
from feeddrive.language.block import Block, Number, Rule, parameter, part
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.controls import Controls, Given
from feeddrive.loop.core import Acting, Shared, acting
from feeddrive.loop.hold import JointHold
from feeddrive.loop.joint import Joint, named
from feeddrive.loop.loop import Loop, Signals, inputs_of, reported

_TOOL = "tool"  # prefix of the signals of the tool point
_SEEDS = 2.0**40  # between the noise of one axis and that of the next


class DrivenAxis(Block):
    """An axis of a machine: its physics and the control that runs on it, control + axis = one loop."""

    control: Control = part("all that runs on the controller")
    axis: Axis = part("all that is physics", inline=True)


class Machine(Block):
    """Axes by name that run at one sample time, as one program; signals are named `x.tracking_error`.

        for each substep:   coupling forces at its middle → forces of each axis → exact hold → friction

    Axes that share structure modes move in one exact hold; all others have their own, so that a machine of one axis
    computes what its loop does.  Couplings act at common substeps, from the motions of all axes at the same instant.
    `axis` is a mapping from names to `DrivenAxis`; `Machine.of` takes loops.
    """

    axis: Any = part("axes by name")
    couplings: tuple[Coupling, ...] = part("what acts between them", default=())
    geometry: Geometry | None = part("geometry errors; with them there are the signals tool.x ...", default=None)
    sample_time: Number = parameter("s", "time from sample to sample", above=0)

    class Prepared(NamedTuple):
        """The prepared numbers of the controls, the linear cores and the couplings."""

        control: Any
        cores: tuple[JointHold, ...]
        couplings: tuple[Any, ...]

    class State(NamedTuple):
        """States of the axes by name, of the modes of each core, of the couplings, and of those on the controller."""

        axis: Any
        shared: tuple[Shared, ...]
        couplings: tuple[Any, ...]
        coordination: tuple[Any, ...]

    def __post_init__(self) -> None:
        if isinstance(self.axis, Mapping):
            axes: Mapping[str, DrivenAxis] = self.axis
            object.__setattr__(self, "axis", named(axes))
        super().__post_init__()

    @classmethod
    def of(
        cls, loops: Mapping[str, Loop], couplings: tuple[Coupling, ...] = (), geometry: Geometry | None = None
    ) -> Machine:
        """Return the machine of some loops. Raises ParameterError if their sample times differ."""
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
        """Return one axis alone, without couplings. Raises ParameterError for a name that does not exist."""
        axes = self.axes()
        if name not in axes:
            raise ParameterError(f"the machine has no axis '{name}'; it has {', '.join(axes)}")
        return Loop(control=axes[name].control, axis=axes[name].axis, sample_time=self.sample_time, name=name)

    def loops(self) -> dict[str, Loop]:
        """Return the loop of each axis alone."""
        return {name: self.loop(name) for name in self.axes()}

    def with_loops(self, loops: Mapping[str, Loop]) -> Machine:
        """Return the same machine with other loops on its axes."""
        return Machine.of({**self.loops(), **loops}, self.couplings, self.geometry)

    def check(self) -> None:
        """Check that couplings name existing axes, that substeps are common, and that each axis runs as a loop of its
        own.
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
        """Yield the conditions of couplings and shared modes; the rules of the axes are those of their loops."""
        yield from self.joint().rules(self.sample_time)

    def joint(self) -> Joint:
        """Return the physics of all axes."""
        return Joint({name: axis.axis for name, axis in self.axes().items()}, self.couplings)

    def ports(self) -> tuple[str, ...]:
        """Return the signal prefix of each axis."""
        return tuple(f"{name}." for name in self.axes())

    def signals(self) -> list[str]:
        """Return the names of its signals: those of each axis, and with a geometry those of the tool point."""
        there = [f"{port}{name}" for port in self.ports() for name in Signals._fields]
        return there if self.geometry is None else [*there, *(f"{_TOOL}.{way}" for way in self.geometry.axes())]

    def timing(self, partial: Collection[str] = ()) -> Any:
        """Return the delay structure of the dead time of each axis, with a fraction of a sample for those named."""
        if not isinstance(self.sample_time, float):
            raise StructureError("machine.sample_time is a constant of the design: it cannot vary within a batch")
        return named({name: loop.timing(partial) for name, loop in self.loops().items()})

    def prepare(self, timing: Any) -> Prepared:
        """Compute everything that depends on parameters only."""
        T, axes = self.sample_time, self.axes()
        controls = named({name: axis.control.prepare(T) for name, axis in axes.items()})
        return self.Prepared(controls, *self.joint().prepare(T, dict(zip(axes, timing, strict=True))))

    def start(self, prepared: Prepared, timing: Any, setpoint: Any, position: Any, velocity: Any) -> State:
        """Return the state with each axis at its position (m), moving with its velocity (m/s); see `Loop.start`. All
        are by axis.
        """
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
        """Return the controls of all axes and what runs between them."""
        return Controls({name: axis.control for name, axis in self.axes().items()}, self.couplings)

    def sample(
        self, prepared: Prepared, state: State, inputs: Mapping[str, Number], noise: Noise, time: Number
    ) -> tuple[State, dict[str, Number]]:
        """Compute one sample from named inputs such as `x.set_position`; signals by name."""
        T, axes, joint = self.sample_time, self.axes(), self.joint()
        states = dict(zip(axes, state.axis, strict=True))
        joint_prepared = Joint.Prepared(prepared.cores, prepared.couplings)
        columns = joint.columns(joint_prepared)
        moved: dict[str, Axis.State] = {name: held.axis for name, held in states.items()}
        before = Joint.State(named(moved), state.shared, state.couplings)
        read: dict[str, Any] = {}
        readings: dict[str, Given] = {}
        at: dict[str, Acting] = {}
        for i, (name, axis) in enumerate(axes.items()):
            setpoint, load, enable, probe = inputs_of(inputs, f"{name}.")
            motion = joint.motion(name, before)
            moved[name], motor, reading = axis.axis.read(moved[name], motion, noise_of(noise, i), T)
            motor, reading = probe.read(motor, reading)
            readings[name] = Given(setpoint, motor, reading, enable)
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
    """Return the axes whose controls a coupling corrects."""
    return coupling.axes() if coupling.controls else ()


def noise_of(noise: Noise, place: int) -> Noise:
    """Return the noise of the axis at an index among all axes."""
    return noise if place == 0 else Noise(noise.seed + place * _SEEDS, noise.sample)


def turning_ports(system: System) -> frozenset[str]:
    """Return the prefixes of the signals of axes that turn."""
    pairs = zip(system.loops().values(), system.ports(), strict=True)
    return frozenset(port for loop, port in pairs if loop.axis.rotary)


def check_system(system: Any) -> None:
    """Raise ParameterError, stating what to give, for anything but a loop or a machine."""
    if not isinstance(system, Loop | Machine):
        remedy = getattr(system, "instead", "") or "a loop or a machine comes first, then what it follows or is asked"
        raise ParameterError(f"a Loop or a Machine is needed here, not a {type(system).__name__}: {remedy}")
