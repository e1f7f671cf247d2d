"""The routine of a control or an axis: the four functions, with named inputs and outputs, that run on a target.

    configure   parameters -> numbers that depend on parameters only, or the first condition that they break
    reset       inputs -> the state where the axis is, disabled
    step        state, inputs -> state, outputs: one sample
    retune      state, parameters before and after -> state

All four are traced from the code that is simulated: `prepare`, `start`, `step` and `retune` of the blocks.  Every
printer of code for a target starts from these graphs, so no law is written a second time.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.language.block import Block
from feeddrive.language.declaration import Declaration
from feeddrive.language.graph import Graph, reachable
from feeddrive.language.naming import Name
from feeddrive.loop.loop import Loop, quantity, unit_of
from feeddrive.loop.machine import System

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
    """Return unit and meaning of an input or output; `turning` are the prefixes of the names of axes that turn, as
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
    """A condition on the parameters: its truth node, and the sentence that states it.

    Its code is its place among all conditions, from 1 on; 0 says that none is broken.
    """

    node: int
    sentence: str


class Function(NamedTuple):
    """The nodes of the results of a function of a routine, in the order of `states` and `outputs`."""

    states: tuple[int, ...]
    outputs: tuple[int, ...] = ()


class Retune(NamedTuple):
    """The state after a live change, as a separate graph, whose leaves are parameters and prepared numbers, old and
    new, and the state: node -> ("old" | "new" | "old_prepared" | "new_prepared" | "state", index).
    """

    graph: Graph
    leaves: dict[int, tuple[str, int]]
    states: tuple[int, ...]
    names: dict[int, Name]
    makers: dict[int, str]

    def keeping(self, live: Sequence[int]) -> Retune:
        """Return the live change of these states only; none of the others is read for them."""
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
    """Four functions of named numbers in one graph; see the module.

    conditions what `configure` and `retune` demand of the parameters: the bounds of each, in their order, then what
               blocks demand between them
    origin    the loop, with its guard; of several axes together their machine
    prepared  the named numbers that the blocks call prepared, and `prepared_leaves` their places among the leaves of
              what `prepare` returns
    tables    rows of numbers: dotted name, node, numbers
    names     words of the law's text for nodes
    makers    dotted names of the blocks that compute the nodes
    memory    what holds the state: "controller" or "plant"
    said      what the text says of a group of states or prepared numbers, by the dotted name of each
    blocks    by dotted name, outermost first
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
        """The condition that each code of a refusal stands for."""
        return {code: condition.sentence for code, condition in enumerate(self.conditions, 1)}

    @property
    def loop(self) -> Loop:
        """The loop from which a control, or one axis, was traced."""
        assert isinstance(self.origin, Loop)
        return self.origin

    @property
    def sample_time(self) -> float:
        """The sample time in s."""
        return float(self.origin.sample_time)


def off_outputs(routine: Routine) -> dict[str, float]:
    """Return the outputs of a control without valid parameters: the safe force of the machine file, switched off."""
    outputs: dict[str, float] = {}
    for loop, port in zip(routine.origin.loops().values(), routine.origin.ports(), strict=True):
        guard, motor = loop.control.guard, loop.axis.actuator.motor
        held = 0.0 if guard is None else float(guard.safe_force)
        command = {} if motor is None else {"command": held / float(motor.force_per_unit())}
        off = {"force": held, **command, "trip": 0.0, "enabled": 0.0}
        outputs |= {target_name(f"{port}{name}"): value for name, value in off.items()}
    return outputs


def target_name(path: str) -> str:
    """Return the name of a number on a target: `control.law.Kv` -> `law_Kv`."""
    words = [word for word in path.split(".") if word not in ("control", "memory", "prepared")]
    return "_".join(words)
