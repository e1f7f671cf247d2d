"""The routine of a controller or an axis for a target: its functions, their tracing, and their reference outputs.

A routine consists of four functions with named inputs and outputs:

    configure   parameters -> numbers that depend on parameters only, or the first condition that is violated
    reset       inputs -> the state at the position of the axis, disabled
    step        state, inputs -> state, outputs: one sample
    retune      state, parameters before and after -> state

All four are traced from the code that is simulated: `prepare`, `start`, `step` and `retune` of the blocks.  The code
for every target is generated from these graphs, so no law is implemented twice.

The reference outputs of a routine are computed by the simulator; every target must reproduce them bit for bit.  To
compute them, the step is traced again, with the precomputed coefficients as inputs, and run by the engine of the
simulation; `prepare`, `start` and `retune` run on plain numbers.  No code generated for a target is used.
"""

import inspect
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple, Self, cast

import numpy as np

from feeddrive.blocks.families import Coupling
from feeddrive.blocks.signals import Motion, Noise
from feeddrive.language import ops, tree
from feeddrive.language.block import Block, Declaration, Number, Rule, part
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.graph import Graph, Symbol, reachable
from feeddrive.language.naming import Name, Names
from feeddrive.language.quantity import USUAL, Units
from feeddrive.language.ring import Ring, gathered, spread
from feeddrive.language.text import resolve
from feeddrive.language.units import turning_docstring
from feeddrive.loop.axis import Axis
from feeddrive.loop.core import Acting, Joint, acting, advance, named
from feeddrive.loop.engine.llvm import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.loop import Loop, quantity, unit_of
from feeddrive.loop.machine import (
    Controlled,
    Controller,
    Controllers,
    Drive,
    Machine,
    System,
    controller_of,
    motors,
    noise_of,
    turning_ports,
    velocity_ports,
)
from feeddrive.loop.trace import Carried, Program, concrete, leaf, node, numbers

MEANINGS = {
    "set_position": ("m", "where the axis should be"),
    "set_velocity": ("m/s", "its derivative"),
    "set_acceleration": ("m/s2", "its second derivative"),
    "set_jerk": ("m/s3", "its third derivative"),
    "set_snap": ("m/s4", "its fourth derivative"),
    "reading": ("m", "position that the encoder reads"),
    "reading_motor": ("m", "position that the motor's encoder reads, seen at the table"),
    "reading_load": ("m", "position that the load's encoder reads"),
    "enable": ("", "on if above 0.5"),
    "force": ("N", "commanded force at the table, within the limit"),
    "trip": ("", "0, or what tripped: 1 reading, 2 following error, 3 velocity, 4 travel, 5 command"),
    "enabled": ("", "1 while the loop runs, 0 while it is off or tripped"),
    "load_force": ("N", "force of the process on the table"),
    "position_motor": ("m", "true position of the motor's body"),
    "position_load": ("m", "true position of the table"),
    "velocity_motor": ("m/s", "true velocity of the motor's body"),
    "velocity_load": ("m/s", "true velocity of the table"),
    "start_position": ("m", "where the axis stands at a reset"),
    "sample": ("", "index of the sample, for noise and forces that depend on time"),
}


def meaning_of(name: str, turning: Collection[str]) -> tuple[str, str]:
    """Return the unit and meaning of an input or output; `turning` holds the name prefixes of rotary axes, such as
    `c.`.
    """
    unit, meaning = MEANINGS[quantity(name)]
    return unit_of(name, turning, unit), meaning


class Variable(NamedTuple):
    """An input, output, state or parameter of a routine: name on the target, dotted name, meaning, and node."""

    name: str
    path: str
    unit: str
    meaning: str
    node: int
    value: float = 0.0  # where it is a parameter
    declared: Declaration | None = None  # of a parameter: its bounds


class Condition(NamedTuple):
    """A condition on the parameters: the node of its truth value, and the sentence that states it.

    Its code is its position among all conditions, counted from 1; 0 means that none is violated.
    """

    node: int
    sentence: str


class Function(NamedTuple):
    """The nodes that compute the results of one function of a routine, in the order of its states and outputs."""

    states: tuple[int, ...]
    outputs: tuple[int, ...] = ()


class Retune(NamedTuple):
    """The state after a live change, as a separate graph. Its leaves are the old and new parameters and precomputed
    coefficients, and the state: node -> ("old" | "new" | "old_prepared" | "new_prepared" | "state", index).
    """

    graph: Graph
    leaves: dict[int, tuple[str, int]]
    states: tuple[int, ...]
    names: dict[int, Name]
    makers: dict[int, str]

    def keeping(self, live: Sequence[int]) -> Self:
        """Return the live change restricted to these states, which must not depend on any other state."""
        places = {old: new for new, old in enumerate(live)}
        states = tuple(self.states[i] for i in live)
        read = set(reachable(self.graph, states))
        leaves = {
            node: (kind, places[i] if kind == "state" else i)
            for node, (kind, i) in self.leaves.items()
            if node in read and (kind != "state" or i in places)
        }
        return self._replace(states=states, leaves=leaves)


@dataclass(frozen=True, eq=False, repr=False)
class Routine:
    """The four functions of a routine in one graph; see the module docstring.

    conditions  checked by `configure` and `retune`: the bounds of the parameters in order, then the rules of the blocks
    origin      the loop with its guard; for several axes, their machine
    prepared    precomputed coefficients of the blocks by name; `prepared_leaves` holds their indices among the leaves
                of the result of `prepare`
    tables      rows of numbers: dotted name, node, numbers
    names       names of nodes in the source code of the law
    makers      dotted names of the blocks that compute the nodes
    memory      owner of the state: "controller" or "plant"
    meanings    description of each state or precomputed coefficient, by dotted name
    blocks      the blocks by dotted name, outermost first
    """

    name: str
    origin: System
    parameters: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    graph: Graph
    sample_time_node: int
    prepared: tuple[tuple[str, int], ...]
    prepared_leaves: tuple[int, ...]
    reset: Function
    step: Function
    retune: Retune | None
    conditions: tuple[Condition, ...]
    tables: tuple[tuple[str, int, np.ndarray], ...]
    names: dict[int, Name]
    makers: dict[int, str]
    memory: str
    meanings: dict[str, str]
    blocks: tuple[tuple[str, Block], ...]

    @property
    def sentences(self) -> dict[int, str]:
        """The conditions in words, by error code."""
        return {code: condition.sentence for code, condition in enumerate(self.conditions, 1)}

    @property
    def loop(self) -> Loop:
        """The loop from which a controller, or one axis, was traced."""
        assert isinstance(self.origin, Loop)
        return self.origin

    @property
    def sample_time(self) -> float:
        """The sample time in s."""
        return float(self.origin.sample_time)


def off_outputs(routine: Routine) -> dict[str, float]:
    """Return the outputs of a controller while its parameters are invalid: disabled, with the safe force of the machine
    file.
    """
    outputs: dict[str, float] = {}
    for loop, port in zip(routine.origin.loops().values(), routine.origin.ports(), strict=True):
        guard, motor = loop.control.guard, loop.axis.actuator.motor
        held = 0.0 if guard is None else float(guard.safe_force)
        command = {} if motor is None else {"command": held / float(motor.force_per_unit())}
        off = {"force": held, **command, "trip": 0.0, "enabled": 0.0}
        by_velocity = velocity_ports(routine.origin)
        outputs |= {output_name(f"{port}{name}", by_velocity): value for name, value in off.items()}
    return outputs


def output_name(signal: str, by_velocity: Collection[str]) -> str:
    """Return the name of an output on a target: a velocity that is commanded must not be called a force."""
    prefix = signal.removesuffix(quantity(signal))
    is_velocity = quantity(signal) == "force" and prefix in by_velocity
    return target_name(f"{prefix}commanded_velocity" if is_velocity else signal)


def target_name(path: str) -> str:
    """Return the name of a number on a target: `control.law.Kv` -> `law_Kv`."""
    words = [word for word in path.split(".") if word not in ("control", "memory", "prepared")]
    return "_".join(words)


# cells: on a target each access selects among all of them, since a routine has no indexed memory
LONGEST_RING = 256
# dropped from the meaning of a parameter that is present
_ABSENT = re.compile(r"; absent[^;]*$")


class Physics(Block):
    """The physics of all axes of a machine and the couplings between them."""

    axis: Any = part("axes by name")
    couplings: tuple[Coupling, ...] = part("what acts between them", default=())

    def joint(self) -> Joint:
        """Return the joint physics of all axes."""
        return Joint(self.axis._asdict(), self.couplings)

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the conditions on couplings and shared modes."""
        yield from self.joint().rules(T)


def on_target(system: System) -> Controller | Controllers:
    """Return the part of a loop, or of all loops of a machine, that runs on a target."""
    if isinstance(system, Loop):
        return controller_of(system)
    axes = {
        name: Controlled(
            control=loop.control, actuator=Drive(motor=loop.axis.actuator.motor), encoders=loop.axis.encoders()
        )
        for name, loop in system.axes().items()
    }
    return Controllers(
        axis=named(axes),
        # None for a coupling of the physics: the others keep their index, which is part of their path
        couplings=tuple(coupling if coupling.controls else None for coupling in system.couplings),
    )


def controller_routine(system: System, name: str) -> Routine:
    """Return the routine of the controller of a loop, or of all controllers of a machine, with names prefixed by the
    axis.

    Raises StructureError if a part uses operations outside `ops`.
    """
    block = on_target(system)
    traced = _Traced(block, system)
    inputs = {signal: traced.input(signal) for signal in block.inputs()}
    T, both = traced.T, traced.symbolic
    with traced.words:
        prepared = both.prepare(T)
        begun = both.start(prepared, inputs)
        _check_rings(begun, name)
        names = [state for state, _ in spread(begun)]
        before = gathered(begun, (traced.graph.input(f"state.{state}") for state in names))
        after, answers = both.step(prepared, before, inputs, T)
    units = {f"{port}command": motor.unit for port, motor in motors(block) if motor is not None}
    velocities = {f"{port}force" for port in velocity_ports(system)}
    outputs = {
        signal: (units[signal], "the same in the unit of the drive", value)
        if signal in units
        else ("m/s", "commanded velocity at the table, within the limit", value)
        if signal in velocities
        else (*MEANINGS[quantity(signal)], value)
        for signal, value in answers.items()
    }
    return traced.routine(name, system, prepared, inputs, names, begun, after, outputs, _retune(block, prepared, begun))


def _check_rings(state: Any, name: str) -> None:
    """Check that ring buffers are short, since on a target each access to one evaluates every cell."""
    for path, value in tree.leaves(state):
        if isinstance(value, Ring) and value.length > LONGEST_RING:
            raise StructureError(
                f"{name}: {path} is a ring of {value.length} cells, more than the {LONGEST_RING} that an export may "
                f"hold: give its block a shorter memory"
            )


def plant_routine(loop: Loop, name: str, seed: int = 0) -> Routine:
    """Return the routine of the axis of a loop: a step moves it from kT to (k+1)T under a force.

    The outputs are those at (k+1)T.  `reset` sets the axis to `start_position` and outputs the signals there; the noise
    has this `seed`.
    """
    traced = _Traced(loop.axis, loop)
    inputs = {signal: traced.input(signal) for signal in ("force", "load_force", "start_position")}
    T, axis, timing = traced.T, traced.symbolic, loop.timing()
    zero = inputs["start_position"] - inputs["start_position"]

    def seen(state: Any, sample: Any) -> tuple[Any, list[Any]]:
        motion = axis.motion(state)
        state, motor, load = axis.read(state, motion, Noise(float(seed), sample), T)
        return state, [motor, load, *motion]

    with traced.words:
        prepared = axis.prepare(T, timing)
        begun, at_start = seen(axis.start(cast(Number, inputs["start_position"]), zero, timing), zero)
        _check_rings(begun, name)
        names = [state for state, _ in spread(begun)]
        before = gathered(begun, (traced.graph.input(f"state.{state}") for state in names))
        sample = traced.graph.input("state.sample")
        force, load_force = cast(Number, inputs["force"]), cast(Number, inputs["load_force"])
        moved, _ = advance(axis, prepared, before, force, load_force, cast(Number, sample * T), T)
        after, values = seen(moved, sample + 1.0)
    outputs = {signal: (*MEANINGS[signal], value) for signal, value in zip(_SEEN, values, strict=True)}
    first: dict[str, Any] = dict(zip(_SEEN, at_start, strict=True))
    # the queue of commands is part of the graph: another dead time must not need another length
    same = timing.unchanged(axis.actuator.dead_time, T), f"actuator dead_time has {timing.sentence()}"
    return traced.routine(
        name,
        loop,
        prepared,
        inputs,
        [*names, "sample"],
        (begun, zero),
        (after, sample + 1.0),
        outputs,
        None,
        first,
        [same],
    )


def machine_routine(machine: Machine, name: str, seed: int = 0) -> Routine:
    """Return the routine of the axes of a machine with their couplings: a step moves all axes from kT to (k+1)T.

    Inputs and outputs are those of `plant_routine`, prefixed by the axis; the noise is that of a run with `seed`.
    """
    traced = _Traced(
        Physics(axis=named({n: axis.axis for n, axis in machine.axes().items()}), couplings=machine.couplings), machine
    )
    signals = [f"{port}{signal}" for port in machine.ports() for signal in ("force", "load_force", "start_position")]
    inputs = {signal: traced.input(signal) for signal in signals}
    T, joint = traced.T, traced.symbolic.joint()
    timings = {axis: loop.timing() for axis, loop in machine.loops().items()}
    places = {axis: cast(Number, inputs[f"{axis}.start_position"]) for axis in timings}
    zero = next(iter(places.values())) - next(iter(places.values()))

    def seen(state: Joint.State, sample: Any) -> tuple[Joint.State, dict[str, Any]]:
        states, values = state.axis._asdict(), dict[str, Any]()
        for i, (axis, axis_block) in enumerate(joint.axes.items()):
            motion = joint.motion(axis, state)
            noise = noise_of(Noise(float(seed), sample), i)
            states[axis], motor, load = axis_block.read(states[axis], motion, noise, T)
            values |= {f"{axis}.{what}": v for what, v in zip(_SEEN, (motor, load, *motion), strict=True)}
        return state._replace(axis=named(states)), values

    with traced.words:
        prepared = joint.prepare(T, timings)
        starts = {axis: axis_block.start(places[axis], zero, timings[axis]) for axis, axis_block in joint.axes.items()}
        motions = {axis: Motion(at, at, zero, zero) for axis, at in places.items()}
        begun, at_start = seen(joint.start(prepared, starts, motions), zero)
        _check_rings(begun, name)
        names = [state for state, _ in spread(begun)]
        before = gathered(begun, (traced.graph.input(f"state.{state}") for state in names))
        sample = traced.graph.input("state.sample")
        columns, states, at = joint.columns(prepared), before.axis._asdict(), dict[str, Acting]()
        for axis in joint.axes:
            force, load = (cast(Number, inputs[f"{axis}.{kind}"]) for kind in ("force", "load_force"))
            at[axis], states[axis] = acting(columns[axis], states[axis], force, load)
        moved, _, _ = joint.advance(prepared, before._replace(axis=named(states)), at, cast(Number, sample * T), T)
        after, values = seen(moved, sample + 1.0)
    outputs = {signal: (*MEANINGS[quantity(signal)], value) for signal, value in values.items()}
    same = [
        (
            timings[axis].unchanged(axis_block.actuator.dead_time, T),
            f"{axis}.actuator dead_time has {timings[axis].sentence()}",
        )
        for axis, axis_block in joint.axes.items()
    ]
    return traced.routine(
        name,
        machine,
        prepared,
        inputs,
        [*names, "sample"],
        (begun, zero),
        (after, sample + 1.0),
        outputs,
        None,
        at_start,
        same,
    )


_SEEN = ("reading_motor", "reading_load", "position_motor", "position_load", "velocity_motor", "velocity_load")


class _Traced:
    """A block traced on symbols, and the parts of its routine collected by the trace."""

    def __init__(self, block: Any, loop: System) -> None:
        self.graph = Graph()
        self.loop = loop
        self.block = block
        self.T = cast(Number, self.graph.input("sample_time"))
        rows = {name: self.graph.table(name, len(row)) for name, row in tree.tables(block)}
        self.tables = tuple((name, rows[name].index, row) for name, row in tree.tables(block))
        paths = [name for name, _ in tree.leaves(block)]
        self.parameters = [(name, self.graph.input(name)) for name in paths]
        symbolic = tree.rebuild(block, iter([symbol for _, symbol in self.parameters]))
        self.symbolic: Any = tree.with_tables(symbolic, rows)
        self.owners = tuple(_owners(self.symbolic))
        self.turning, self.by_velocity = turning_ports(loop), velocity_ports(loop)
        self.units = Units(rotary=True) if self.turning else USUAL
        # the code of a controller only passes values on: its local names would take precedence over those of the law
        runs = isinstance(block, Controller | Controllers)
        self.words = Names(self.graph, {id(owner): path for path, owner in self.owners if path or not runs})

    def input(self, name: str) -> Any:
        """Return the symbol of an input."""
        return self.graph.input(name)

    def routine(
        self,
        name: str,
        loop: System,
        prepared: Any,
        inputs: Mapping[str, Any],
        states: list[str],
        begun: Any,
        after: Any,
        outputs: Mapping[str, tuple[str, str, Any]],
        retune: Retune | None,
        first: Mapping[str, Any] | None = None,
        conditions: Sequence[tuple[Any, str]] = (),
    ) -> Routine:
        """Return the routine with names, units and meanings."""
        values = dict(tree.leaves(self.block))
        node = self.graph.symbol
        for signal, (_, _, value) in outputs.items():
            # a result without a variable in the text of the law has the name of its output
            self.words.by_node.setdefault(node(value).index, Name("", signal))
        after_nodes = [node(value).index for _, value in spread(after)]
        before_nodes = [self.graph.input(f"state.{state}").index for state in states]
        begun_nodes = [node(value).index for _, value in spread(begun)]
        leaves = [
            (i, f"prepared.{leaf}", value.index)
            for i, (leaf, value) in enumerate(tree.leaves(prepared))
            # constants of the code need no memory on a target
            if type(value) is not float and not self._is_text(value.index)
        ]
        output_nodes = tuple(node(value).index for _, _, value in outputs.values())
        live = _live(self.graph, output_nodes, before_nodes, after_nodes, retune)
        if retune is not None:
            retune = retune.keeping(live)
        states = [states[i] for i in live]
        before_nodes, after_nodes, begun_nodes = (
            [row[i] for i in live] for row in (before_nodes, after_nodes, begun_nodes)
        )
        first_nodes = tuple(node((first or {})[signal]).index for signal in outputs) if first else ()
        read = set(reachable(self.graph, [*begun_nodes, *first_nodes, *after_nodes, *output_nodes]))
        if retune is not None:
            read |= {self.parameters[i][1].index for kind, i in retune.leaves.values() if kind in ("old", "new")}
        used = [i for i, (_, symbol) in enumerate(self.parameters) if symbol.index in read]
        places = {old: new for new, old in enumerate(used)}
        if retune is not None:
            moved = {
                leaf: (kind, places[i] if kind in ("old", "new") else i) for leaf, (kind, i) in retune.leaves.items()
            }
            retune = retune._replace(leaves=moved)
        return Routine(
            name=name,
            origin=loop,
            parameters=tuple(
                self._parameter(parameter, symbol.index, float(values[parameter]))
                for parameter, symbol in (self.parameters[i] for i in used)
            ),
            inputs=tuple(Variable(target_name(i), i, *meaning_of(i, self.turning), s.index) for i, s in inputs.items()),
            outputs=tuple(
                Variable(
                    output_name(signal, self.by_velocity),
                    signal,
                    unit_of(signal, self.turning, unit, self.by_velocity),
                    meaning,
                    node(value).index,
                )
                for signal, (unit, meaning, value) in outputs.items()
            ),
            states=tuple(
                Variable(target_name(state), state, "", "", before)
                for state, before in zip(states, before_nodes, strict=True)
            ),
            graph=self.graph,
            sample_time_node=node(self.T).index,
            prepared=tuple((leaf, index) for _, leaf, index in leaves),
            prepared_leaves=tuple(i for i, _, _ in leaves),
            reset=Function(tuple(begun_nodes), first_nodes),
            step=Function(tuple(after_nodes), output_nodes),
            retune=retune,
            conditions=tuple(self._conditions({self.parameters[i][0] for i in used}, conditions)),
            tables=self.tables,
            names=self.words.by_node,
            makers=self.words.makers,
            memory="controller" if isinstance(self.block, Controller | Controllers) else "plant",
            meanings={
                name: turning_docstring(text) if self.turning else text
                for name, text in (*_meanings(begun), *_meanings(prepared, "prepared"))
            },
            blocks=tuple((path, block) for path, block in _owners(self.block)),
        )

    def _declared(self, name: str) -> tuple[str, Declaration]:
        """Return the path of a leaf in the loop, and its declaration."""
        is_axis = isinstance(self.block, Axis)
        path = f"{self.loop.place_of('axis')}.{name}" if is_axis else tree.path_of(self.block, name)
        declared = tree.declaration(self.block, name if is_axis else path)
        return path, declared.of_axis(bool(self.turning & {"", f"{path.split('.')[1]}."}))

    def _parameter(self, name: str, node: int, value: float) -> Variable:
        path, declared = self._declared(name)
        return Variable(self._word(name), path, declared.unit, _ABSENT.sub("", declared.meaning), node, value, declared)

    def _word(self, name: str) -> str:
        """Return the name of a parameter on a target, prefixed by the axis if there are several."""
        return target_name(name.removeprefix("axis.") if isinstance(self.block, Physics | Controllers) else name)

    def _conditions(self, used: set[str], more: Sequence[tuple[Any, str]]) -> Iterator[Condition]:
        """Yield the bounds of the parameters in use, then the rules of the blocks that depend on any parameter.

        A parameter that is not read on the target enters a rule as a constant with its present value.
        """
        values = dict(tree.leaves(self.block))
        for path, symbol in self.parameters:
            if path in used:
                _, declared = self._declared(path)
                bounds = f", {declared.bounds()}" if declared.bounds() else ""
                holds = reduce(ops.both, declared.conditions(cast(Number, symbol)))
                sentence = f"{self._word(path)} is a finite number{bounds}"
                yield Condition(holds.index, resolve(sentence, self.units))
        leaves = iter([symbol if path in used else np.float64(values[path]) for path, symbol in self.parameters])
        traced = tree.with_tables(tree.rebuild(self.block, leaves), dict(tree.tables(self.symbolic)))
        with np.errstate(all="ignore"):
            for path, block in _owners(traced):
                for rule in (*block.rules(), *block.sampled_rules(self.T)):
                    if isinstance(rule.holds, Symbol):
                        where = path.removeprefix("control").removeprefix(".")
                        sentence = f"{where}: {rule.sentence}" if where else rule.sentence
                        yield Condition(rule.holds.index, resolve(sentence, self.units))
        unused = {symbol.index for path, symbol in self.parameters if path not in used}
        for holds, sentence in more:
            if not unused & set(reachable(self.graph, [holds.index])):
                yield Condition(holds.index, sentence)

    def _is_text(self, index: int) -> bool:
        return self.graph.nodes[index][0] in ("const", "truth")


def _live(
    graph: Graph, outputs: Sequence[int], before: Sequence[int], after: Sequence[int], retune: Retune | None
) -> list[int]:
    """Return the indices of the states on which an output of this or any later sample depends; no target needs to store
    the others.
    """
    live: set[int] = set()
    while True:
        below = set(reachable(graph, [*outputs, *(after[i] for i in live)]))
        grown = {i for i, node in enumerate(before) if node in below}
        if retune is not None:
            below = set(reachable(retune.graph, [retune.states[i] for i in grown]))
            grown |= {i for node, (kind, i) in retune.leaves.items() if kind == "state" and node in below}
        if grown == live:
            return sorted(live)
        live = grown


def _retune(block: Controller | Controllers, prepared: Any, begun: Any) -> Retune:
    """Trace the live change of a controller on symbols."""
    graph = Graph()
    leaves: dict[int, tuple[str, int]] = {}

    def symbols(values: Any, kind: str) -> Iterator[Any]:
        """Yield a symbol for each number; constants of the code remain constants."""
        for i, (_, value) in enumerate(values if kind == "state" else tree.leaves(values)):
            if type(value) is float and kind.endswith("prepared"):
                yield value
                continue
            symbol = graph.input(f"{kind}.{i}")
            leaves[symbol.index] = (kind, i)
            yield symbol

    old: Any = tree.rebuild(block, symbols(block, "old"))
    new: Any = tree.rebuild(block, symbols(block, "new"))
    old_constants = tree.rebuild(prepared, symbols(prepared, "old_prepared"))
    new_constants = tree.rebuild(prepared, symbols(prepared, "new_prepared"))
    state = gathered(begun, symbols(spread(begun), "state"))
    names = Names(graph, {id(owner): path for path, owner in _owners(new) if path})
    with names:
        after = new.retune(state, old, old_constants, new_constants)
    states = tuple(graph.symbol(value).index for _, value in spread(after))
    read = set(reachable(graph, states))
    leaves = {node: leaf for node, leaf in leaves.items() if node in read}
    return Retune(graph, leaves, states, names.by_node, names.makers)


def _owners(block: Any, path: str = "") -> Iterator[tuple[str, Block]]:
    """Yield the dotted name and block of every block of a tree, outermost first."""
    if isinstance(block, Block):
        yield path, block
        parts = {name: getattr(block, name) for name, d in tree.declarations(type(block)).items() if d.role == "part"}
        for name, inner in parts.items():
            yield from _owners(inner, f"{path}.{name}" if path else name)
    elif isinstance(block, tuple):
        names = getattr(block, "_fields", None) or range(len(block))
        for name, inner in zip(names, block, strict=True):
            yield from _owners(inner, f"{path}.{name}")


def _meanings(values: Any, path: str = "", text: str = "") -> Iterator[tuple[str, str]]:
    """Yield, for each leaf of a tree of named tuples, the docstring of the innermost named tuple that contains it."""
    if isinstance(values, tuple):
        names = getattr(values, "_fields", None)
        text = inspect.getdoc(type(values)) or "" if names else text
        for name, value in zip(names or map(str, range(len(values))), values, strict=True):
            yield from _meanings(value, f"{path}.{name}" if path else name, text)
    else:
        yield path, text


Changes = Mapping[int, Mapping[str, float]]


class ControllerRun:
    """A simulator run of a routine's controller, which starts with a reset; `step` may be called repeatedly."""

    def __init__(self, routine: Routine, first: np.ndarray) -> None:
        """Reset the controller with the inputs `first`, shape (inputs,)."""
        if routine.memory != "controller":
            raise ParameterError(f"{routine.name} is an axis; its answers are those of `simulate`")
        self.routine = routine
        self.T = np.float64(routine.sample_time)
        self._both: Any = on_target(routine.origin)
        self._prepare()
        first_inputs = dict(zip((v.path for v in routine.inputs), map(np.float64, first), strict=True))
        with np.errstate(all="ignore"):
            self.state = self._plain.start(self._prepared, first_inputs)
        self._native = self._compiled()
        self._load()

    def _prepare(self) -> None:
        # NumPy numbers, without warnings: on a target a division by 0 gives infinity
        self._plain = concrete(self._both)
        with np.errstate(all="ignore"):
            self._prepared = self._plain.prepare(self.T)
        self._numbers = {**dict(tree.leaves(self._plain)), **dict(numbers(self._prepared, "prepared")), "T": self.T}

    def _compiled(self) -> Native:
        """Compile the step of one sample to machine code."""
        graph = Graph()
        constants: dict[str, int] = {}
        inputs: dict[str, int] = {}

        def symbol(name: str, nodes: dict[str, int]) -> Any:
            node = graph.input(name)
            nodes[name] = node.index
            return node

        rows = {name: graph.table(name, len(row)) for name, row in tree.tables(self._both)}
        leaves = iter([symbol(name, constants) for name, _ in tree.leaves(self._both)])
        both: Any = tree.with_tables(tree.rebuild(self._both, leaves), rows)
        prepared = tree.rebuild(
            self._prepared,
            (v if type(v) is float else symbol(name, constants) for name, v in tree.leaves(self._prepared, "prepared")),
        )
        names = [name for name, _ in tree.leaves(self.state)]
        begun = tree.leaves(self.state)
        before = tree.rebuild(self.state, (leaf(graph, f"state.{name}", value) for name, value in begun))
        signals = {v.path: symbol(v.path, inputs) for v in self.routine.inputs}
        T = cast(Number, symbol("T", constants))
        after, values = both.step(prepared, before, signals, T)
        carried = zip(names, tree.leaves(before), tree.leaves(after), strict=True)
        program = Program(
            graph=graph,
            constants=constants,
            inputs=inputs,
            states=tuple(
                Carried(name, node(graph, first), node(graph, value)) for name, (_, first), (_, value) in carried
            ),
            outputs={v.path: graph.symbol(values[v.path]).index for v in self.routine.outputs},
            sample=None,
            tables={name: row.index for name, row in rows.items()},
        )
        return native(plan(program))

    def _load(self) -> None:
        """Copy state, constants and tables to arrays in the order of the machine code."""
        plan, values, rows = self._native.plan, dict(tree.leaves(self.state)), dict(tree.tables(self._both))
        held = [np.float64(values[state.name]) for state in plan.states]
        for name, _, length in plan.rings:
            cells = values[name.removeprefix("state.")].cells
            held += [0.0] * length if cells is None else list(cells)
        self._states = np.array(held, dtype=np.float64)[:, None]
        self._constants = np.array([[self._numbers[name]] for name, _ in plan.constants], dtype=np.float64)
        self._rows = [rows[name] for name, _ in plan.tables]

    def _unload(self) -> None:
        """Copy the state from the arrays of the machine code back to the tree of the blocks."""
        values = dict(tree.leaves(self.state))
        plan = self._native.plan
        values |= {state.name: np.float64(self._states[i, 0]) for i, state in enumerate(plan.states)}
        first = len(plan.states)
        for name, _, length in plan.rings:
            values[name.removeprefix("state.")] = Ring(length, self._states[first : first + length, 0].copy())
            first += length
        self.state = tree.rebuild(self.state, iter(values[name] for name, _ in tree.leaves(self.state)))

    def step(self, inputs: np.ndarray) -> np.ndarray:
        """Compute n samples from inputs of shape (n, inputs); return outputs of shape (n, outputs), both in routine
        order.
        """
        row = np.ascontiguousarray(inputs, dtype=np.float64)
        out = np.empty((len(row), len(self.routine.outputs)))
        self._native.run(len(row), 0, self._constants, row, self._states, out, self._rows)
        return out

    def retune(self, changes: Mapping[str, float]) -> None:
        """Change parameters, by path, from the next sample onward. Raises ParameterError for values that the blocks
        reject.
        """
        self._unload()
        before, prepared = self._plain, self._prepared
        changed = tree.vary(self._both, changes)
        tree.check_sampled(changed, float(self.T))
        self._both = changed
        self._prepare()
        with np.errstate(all="ignore"):
            self.state = self._plain.retune(self.state, before, prepared, self._prepared)
        self._load()


def run(routine: Routine, inputs: np.ndarray, changes: Changes | None = None) -> np.ndarray:
    """Reset a controller with the first row of `inputs`, run it over all rows, and return the outputs.

    Shapes are (n, inputs) and (n, outputs). `changes` holds new parameter values by sample and path, valid from that
    sample onward.
    """
    held = ControllerRun(routine, inputs[0])
    pieces, start = [], 0
    for place in sorted(changes or {}):
        pieces.append(held.step(inputs[start:place]))
        held.retune((changes or {})[place])
        start = place
    return np.vstack([*pieces, held.step(inputs[start:])])
