"""A machine: named axes with a common sample time, and the couplings between them."""

from __future__ import annotations

import keyword
from collections.abc import Collection, Iterator, Mapping
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

from feeddrive.blocks.coupling.geometry import Geometry
from feeddrive.blocks.machine_families import Coupling
from feeddrive.blocks.signals import Motion, Noise
from feeddrive.language import ops
from feeddrive.language.block import Block, Number, Rule, parameter, part
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.axis import Axis, slow_enough
from feeddrive.loop.control import Control
from feeddrive.loop.core import Acting, Core, Push, Shared, acting
from feeddrive.loop.hold import Columns, JointHold, Timing
from feeddrive.loop.loop import Loop, Signals, inputs_of, reported

_TOOL = "tool"  # prefix of the signals of the tool point
_SEEDS = 2.0**40  # between the noise of one axis and that of the next


class DrivenAxis(Block):
    """An axis of a machine: its physics and the control that runs on it, control + axis = one loop."""

    control: Control = part("all that runs on the controller")
    axis: Axis = part("all that is physics", inline=True)


class Joint:
    """The physics of axes by name with what acts between them: all of a machine but its controls.

    Axes that share structure modes move in one exact hold; all others have their own.  Couplings act at common
    substeps, from the motions of all axes at the same instant.
    """

    class Prepared(NamedTuple):
        """What the linear cores and the couplings prepared."""

        cores: tuple[JointHold, ...]
        couplings: tuple[Any, ...]

    class State(NamedTuple):
        """Of the axes by name, of the modes of each core, and of the couplings."""

        axis: Any
        shared: tuple[Shared, ...]
        couplings: tuple[Any, ...]

    def __init__(self, axes: Mapping[str, Axis], couplings: tuple[Coupling, ...]) -> None:
        self.axes, self.couplings = dict(axes), couplings
        self.cores = self._cores()
        self._where = {name: place for place, core in enumerate(self.cores) for name in core.axes}

    def _cores(self) -> list[Core]:
        """Groups of axes that share modes, in the order of the axes."""
        groups: list[tuple[list[str], list[Any]]] = [([name], []) for name in self.axes]
        for coupling in self.couplings:
            modes = coupling.modes()
            if modes:
                joined = [group for group in groups if set(group[0]) & set(coupling.axes())]
                first = joined[0]
                for other in joined[1:]:
                    first[0].extend(other[0])
                    first[1].extend(other[1])
                    groups.remove(other)
                first[1].extend(modes)
        axes = ({name: axis for name, axis in self.axes.items() if name in names} for names, _ in groups)
        return [Core(own, modes) for own, (_, modes) in zip(axes, groups, strict=True)]

    def substeps(self) -> int:
        """Of every axis: they are the same."""
        return self.cores[0].substeps()

    def rules(self, T: Number) -> Iterator[Rule]:
        """What couplings and shared modes ask for at the substeps."""
        h = T / self.substeps()
        for core in self.cores:
            if core.modes:
                yield from slow_enough(core.mechanics(), None, h, f"the modes under {', '.join(core.axes)}")
        for coupling in self.couplings:
            yield from coupling.substep_rules(h)

    def prepare(self, T: Number, timings: Mapping[str, Timing]) -> Prepared:
        """All work that depends on parameters only."""
        h = T / self.substeps()
        holds = tuple(core.prepare(T, timings) for core in self.cores)
        return self.Prepared(holds, tuple(coupling.prepare(h) for coupling in self.couplings))

    def start(self, prepared: Prepared, states: Mapping[str, Axis.State], motions: Mapping[str, Motion]) -> State:
        """The axes as they begin, moving like this, with modes at rest."""
        zero = ops.zero(next(iter(motions.values())).position_load)
        shared = tuple(Shared((zero,) * len(core.modes), (zero,) * len(core.modes)) for core in self.cores)
        couplings = zip(self.couplings, prepared.couplings, strict=True)
        begun = tuple(each.start(made, {name: motions[name] for name in each.axes()}) for each, made in couplings)
        return self.State(named(states), shared, begun)

    def motion(self, name: str, state: State) -> Motion:
        """True position and velocity of the two bodies of an axis."""
        place = self._where[name]
        return self.cores[place].motion(name, state.axis._asdict(), state.shared[place])

    def columns(self, prepared: Prepared) -> dict[str, Columns]:
        """What the forces of each axis do."""
        return {
            name: each
            for core, made in zip(self.cores, prepared.cores, strict=True)
            for name, each in zip(core.axes, made.axes, strict=True)
        }

    def advance(
        self, prepared: Prepared, state: State, at: Mapping[str, Acting], time: Number, T: Number
    ) -> tuple[State, dict[str, Axis.Step], dict[str, Number | None]]:
        """All axes from kT to (k+1)T; what each leaves behind for the record, and the mean force on its table."""
        moved: dict[str, Axis.State] = state.axis._asdict()
        shared, remembered = list(state.shared), list(state.couplings)
        loads: dict[str, list[Any]] = {name: [] for name in self.axes}
        done: dict[str, Axis.Step] = {}
        substeps = self.substeps()
        h = T / substeps
        for index in range(substeps):
            now = time + index * h
            pushes = self._coupled(prepared, moved, shared, remembered, now + 0.5 * h, h)
            for name, push in pushes.items():
                loads[name].append(push.load)
            for place, core in enumerate(self.cores):
                own = {name: moved[name] for name in core.axes}
                after, shared[place], steps = core.substep(
                    prepared.cores[place], own, shared[place], at, pushes, index, now, h
                )
                moved.update(after)
                done.update(steps)
        mean = {name: _mean(at[name].load, each) for name, each in loads.items()}
        return self.State(named(moved), tuple(shared), tuple(remembered)), done, mean

    def _coupled(
        self, prepared: Prepared, states: Mapping[str, Axis.State], shared: list[Shared], remembered: list[Any],
        middle: Number, h: Number,
    ) -> dict[str, Push]:  # fmt: skip
        """The forces of all couplings by axis over a substep, whose middle is given; their states move on."""
        motions: dict[str, Motion] = {}
        found: dict[str, Push] = {}
        for i, (coupling, made) in enumerate(zip(self.couplings, prepared.couplings, strict=True)):
            for name in coupling.axes():
                if name not in motions:
                    core = self.cores[self._where[name]]
                    motions[name] = core.middle(name, states, shared[self._where[name]], h)
            own = {name: motions[name] for name in coupling.axes()}
            remembered[i], forces = coupling.step(made, remembered[i], own, middle, h)
            for name, pair in forces.items():
                found[name] = found.get(name, Push()) + pair
        return found


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
        """What the controls, the linear cores and the couplings prepared."""

        control: Any
        cores: tuple[JointHold, ...]
        couplings: tuple[Any, ...]

    class State(NamedTuple):
        """Of the axes by name, of the modes of each core, and of the couplings."""

        axis: Any
        shared: tuple[Shared, ...]
        couplings: tuple[Any, ...]

    def __post_init__(self) -> None:
        if isinstance(self.axis, Mapping):
            given: Mapping[str, DrivenAxis] = self.axis
            object.__setattr__(self, "axis", named(given))
        super().__post_init__()

    @classmethod
    def of(
        cls, loops: Mapping[str, Loop], couplings: tuple[Coupling, ...] = (), geometry: Geometry | None = None
    ) -> Machine:
        """The machine of some loops. Raises ParameterError if their sample times differ."""
        times = {name: float(loop.sample_time) for name, loop in loops.items()}
        if len(set(times.values())) != 1:
            shown = ", ".join(f"{name}: {time:g} s" for name, time in times.items())
            raise ParameterError(f"the axes of a machine have one sample time, not {shown or 'none'}")
        axes = {name: DrivenAxis(control=loop.control, axis=loop.axis) for name, loop in loops.items()}
        return cls(axis=named(axes), couplings=couplings, geometry=geometry, sample_time=next(iter(times.values())))

    def axes(self) -> dict[str, DrivenAxis]:
        """The axes by name."""
        return dict(zip(self.axis._fields, self.axis, strict=True))

    def loop(self, name: str) -> Loop:
        """One axis alone, without couplings. Raises ParameterError for a name that does not exist."""
        axes = self.axes()
        if name not in axes:
            raise ParameterError(f"the machine has no axis '{name}'; it has {', '.join(axes)}")
        return Loop(control=axes[name].control, axis=axes[name].axis, sample_time=self.sample_time, name=name)

    def loops(self) -> dict[str, Loop]:
        """The loop of each axis alone."""
        return {name: self.loop(name) for name in self.axes()}

    def with_loops(self, loops: Mapping[str, Loop]) -> Machine:
        """The same machine with other loops on its axes."""
        return Machine.of({**self.loops(), **loops}, self.couplings, self.geometry)

    def check(self) -> None:
        """Couplings name axes that are there; substeps are common; each axis runs as a loop of its own."""
        axes = self.axes()
        if not axes:
            raise StructureError("a machine needs at least one axis")
        substeps = {name: each.axis.substeps for name, each in axes.items()}
        if len(set(substeps.values())) > 1:
            shown = ", ".join(f"{name}: {count}" for name, count in substeps.items())
            raise StructureError(
                f"the axes of a machine have one number of substeps, at which forces between them act, not {shown}"
            )
        for i, coupling in enumerate(self.couplings):
            for name in coupling.axes():
                if name not in axes:
                    raise StructureError(f"couplings.{i}: {coupling.kind} acts on axis '{name}', which is not there")
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
        """What couplings and shared modes ask for; the rules of the axes are those of their loops."""
        yield from self.joint().rules(self.sample_time)

    def joint(self) -> Joint:
        """The physics of all axes."""
        return Joint({name: each.axis for name, each in self.axes().items()}, self.couplings)

    def ports(self) -> tuple[str, ...]:
        """The prefix of the names of inputs and signals of each axis."""
        return tuple(f"{name}." for name in self.axes())

    def signals(self) -> list[str]:
        """The names of its signals: those of each axis, and with a geometry those of the tool point."""
        there = [f"{port}{name}" for port in self.ports() for name in Signals._fields]
        return there if self.geometry is None else [*there, *(f"{_TOOL}.{way}" for way in self.geometry.axes())]

    def timing(self, partial: Collection[str] = ()) -> Any:
        """The delay structure of the dead time of each axis, with a fraction of a sample for those named."""
        if not isinstance(self.sample_time, float):
            raise StructureError("machine.sample_time is a constant of the design: it cannot vary within a batch")
        return named({name: each.timing(partial) for name, each in self.loops().items()})

    def prepare(self, timing: Any) -> Prepared:
        """All work that depends on parameters only."""
        T, axes = self.sample_time, self.axes()
        controls = named({name: each.control.prepare(T) for name, each in axes.items()})
        return self.Prepared(controls, *self.joint().prepare(T, dict(zip(axes, timing, strict=True))))

    def start(self, prepared: Prepared, timing: Any, setpoint: Any, position: Any, velocity: Any) -> State:
        """Each axis at its position (m), moving with its velocity (m/s); see `Loop.start`. All are by axis."""
        found: dict[str, Loop.State] = {}
        motions: dict[str, Motion] = {}
        for name, made, held in zip(self.axes(), prepared.control, timing, strict=True):
            at, speed = position[name], velocity[name]
            found[name] = self.loop(name).started(made, held, setpoint[name], at, speed)
            motions[name] = Motion(at, at, speed, speed)
        states = {name: each.axis for name, each in found.items()}
        begun = self.joint().start(Joint.Prepared(prepared.cores, prepared.couplings), states, motions)
        return self.State(named(found), begun.shared, begun.couplings)

    def sample(
        self, prepared: Prepared, state: State, inputs: Mapping[str, Number], noise: Noise, time: Number
    ) -> tuple[State, dict[str, Number]]:
        """One sample from named inputs such as `x.set_position`; signals by name."""
        T, axes, joint = self.sample_time, self.axes(), self.joint()
        states = dict(zip(axes, state.axis, strict=True))
        made = Joint.Prepared(prepared.cores, prepared.couplings)
        columns = joint.columns(made)
        moved: dict[str, Axis.State] = {name: held.axis for name, held in states.items()}
        before = Joint.State(named(moved), state.shared, state.couplings)
        found: dict[str, Any] = {}
        controls: dict[str, Any] = {}
        at: dict[str, Acting] = {}
        for i, (name, each) in enumerate(axes.items()):
            setpoint, load, enable, probe = inputs_of(inputs, f"{name}.")
            motion = joint.motion(name, before)
            moved[name], motor, reading = each.axis.read(moved[name], motion, noise_of(noise, i), T)
            motor, reading = probe.read(motor, reading)
            controls[name], command = each.control.step(
                prepared.control[i], states[name].control, setpoint, motor, reading, enable, T
            )
            found[name] = setpoint, motion, motor, reading, command
            at[name], moved[name] = acting(columns[name], moved[name], probe.acting(command.applied), load)
        after, done, loads = joint.advance(made, before._replace(axis=named(moved)), at, time, T)
        signals: dict[str, Number] = {}
        for name, (setpoint, motion, motor, reading, command) in found.items():
            row = reported(setpoint, motion, motor, reading, command, done[name], loads[name])
            signals |= {f"{name}.{signal}": value for signal, value in zip(Signals._fields, row, strict=True)}
        if self.geometry is not None:
            position = {name: row[1].position_load for name, row in found.items()}
            signals |= {f"{_TOOL}.{way}": at for way, at in self.geometry.tool(position).items()}
        held = {name: Loop.State(controls[name], axis) for name, axis in zip(axes, after.axis, strict=True)}
        return self.State(named(held), after.shared, after.couplings), signals


System: TypeAlias = Loop | Machine  # what is traced to a program


def noise_of(noise: Noise, place: int) -> Noise:
    """The noise of the axis at a place among all."""
    return noise if place == 0 else Noise(noise.seed + place * _SEEDS, noise.sample)


def named(values: Mapping[str, Any]) -> Any:
    """A named tuple of values by axis."""
    return _type(tuple(values))(*values.values())


@lru_cache(maxsize=256)
def _type(names: tuple[str, ...]) -> Any:
    for name in names:
        if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
            raise ParameterError(f"'{name}' cannot be the name of an axis: letters, digits and _ , first a letter")
    make: Any = NamedTuple  # names are known at run time only
    return make("Axes", [(name, Any) for name in names])


def _mean(held: Any, coupled: list[Any]) -> Any:
    """The mean force on a table over the sample; None where there is none."""
    total: Any = None
    for each in coupled:
        total = each if total is None else total + each
    mean = None if total is None else total / float(len(coupled)) if len(coupled) > 1 else total
    return mean if held is None else held if mean is None else held + mean


def turning_ports(system: System) -> frozenset[str]:
    """The prefixes of the signals of those axes that turn."""
    pairs = zip(system.loops().values(), system.ports(), strict=True)
    return frozenset(port for loop, port in pairs if loop.axis.rotary)


def check_system(system: Any) -> None:
    """Raise ParameterError, with what to give, for what is no loop and no machine."""
    if not isinstance(system, Loop | Machine):
        remedy = getattr(system, "instead", "") or "a loop or a machine comes first, then what it follows or is asked"
        raise ParameterError(f"a Loop or a Machine is needed here, not a {type(system).__name__}: {remedy}")
