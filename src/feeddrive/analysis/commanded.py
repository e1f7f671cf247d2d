"""The force that a control commands on recorded setpoints and readings: a check of a law without an axis model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from feeddrive.analysis.replay import estimate_start
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Block, Number, parameter, part
from feeddrive.language.recent import Recent
from feeddrive.language.ring import Ring
from feeddrive.loop.control import Control
from feeddrive.loop.engine.native import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.loop import SETPOINT
from feeddrive.loop.trace import concrete, numbers, trace

_INPUTS = (*SETPOINT, "reading_motor", "reading_load", "acted")
_compiled: Recent[Native] = Recent(16)


class OnLog(Block):
    """A control that receives setpoint, readings and the force that acted, sample by sample."""

    control: Control = part("the control, without its guard")
    sample_time: Number = parameter("s", "time from row to row", above=0)

    def sample(
        self, prepared: Any, state: Any, inputs: Mapping[str, Number], noise: object, time: object
    ) -> tuple[Any, dict[str, Number]]:
        """One sample.  The force that acted is that of the log: an error of the law does not add up in observers."""
        setpoint = Setpoint(*(inputs[name] for name in SETPOINT))
        state = state._replace(applied=inputs["acted"], requested=inputs["acted"])
        readings = inputs["reading_motor"], inputs["reading_load"]
        after, command = self.control.step(prepared, state, setpoint, *readings, 1.0, self.sample_time)
        return after, {"force": command.applied}


def commanded(
    control: Control,
    sample_time: float,
    set_position: np.ndarray,
    reading: np.ndarray,
    force: np.ndarray,
    reading_motor: np.ndarray | None = None,
) -> np.ndarray:
    """The force in N that a control commands at each row of a log, shape (n,).

    set_position   m, shape (n,), one row a sample of the control
    reading        m, shape (n,): what the encoder of the load read, and that of the motor if `reading_motor` is None
    force          N, shape (n,), as it was commanded at each row

    There is no plant in it: for the control that made the log it is the logged force, apart from rounding and the
    state of the control at the start.  The guard is left out.
    """
    T = np.float64(sample_time)
    motor = reading if reading_motor is None else reading_motor
    _, velocity = estimate_start(reading, float(T))
    path = Recorded(position=set_position, sample_time=float(T)).at(np.arange(set_position.size) * float(T))
    acted = np.concatenate([force[:1], force[:-1]])
    rows = np.column_stack([np.broadcast_to(row, reading.size) for row in (*path, motor, reading, acted)])
    system = concrete(OnLog(control=replace(control, guard=None), sample_time=float(T)))
    with np.errstate(all="ignore"):
        prepared = system.control.prepare(T)
        begun = system.control.start(
            prepared,
            Setpoint(*map(np.float64, rows[0, : len(SETPOINT)])),
            np.float64(motor[0] - velocity * T),
            np.float64(reading[0] - velocity * T),
            np.float64(velocity),
        )
    key = tuple(tree.structure(part) for part in (system, prepared, begun))
    return _ran(
        _compiled.get(key, lambda: native(plan(trace(system, prepared, begun, _INPUTS)))), system, prepared, begun, rows
    )


def _ran(compiled: Native, system: OnLog, prepared: Any, begun: Any, rows: np.ndarray) -> np.ndarray:
    """Run all rows in machine code."""
    steps, held = compiled.plan, dict(tree.leaves(begun))
    values = {**dict(tree.leaves(system)), **dict(numbers(prepared, "prepared")), "seed": 0.0}
    states = [np.float64(held[state.name]) for state in steps.states]
    for name, _, length in steps.rings:
        ring = held[name.removeprefix("state.")]
        states += [0.0] * length if not isinstance(ring, Ring) or ring.cells is None else list(ring.cells)
    constants = np.array([[values[name]] for name, _ in steps.constants], dtype=np.float64).reshape(-1, 1)
    tables = dict(tree.tables(system))
    out = np.empty((len(rows), len(steps.outputs), 1))
    inputs = np.ascontiguousarray(rows[:, [_INPUTS.index(name) for name, _ in steps.inputs]])
    compiled.run(
        len(rows),
        0,
        constants,
        inputs,
        np.array(states, dtype=np.float64).reshape(-1, 1),
        out,
        [tables[name] for name, _ in steps.tables],
    )
    return out[:, 0, 0].copy()
