"""A control that closes the loop of a drive in the master: its traced step as machine code, one call in each cycle."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Block, Number, choice, parameter, part
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.recent import Recent
from feeddrive.language.ring import Ring
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.loop.engine.llvm import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.guard import TRIPS, Guard
from feeddrive.loop.loop import SETPOINT, Loop
from feeddrive.loop.trace import concrete, numbers, trace

_INPUTS = (*SETPOINT, "reading_motor", "reading_load", "enable")
_OUTPUTS = ("force", "feedback", "feedforward", "trip")
# states: what was commanded in the sample before, and the motion that the guard saw before it was switched on
_FORCES, _TRAVEL = ("applied", "requested"), "guard.travel"
_compiled: Recent[Native] = Recent(16)


class InMaster(Block):
    """A control whose inputs in each sample are the setpoint, the readings of a drive, and enable."""

    control: Control = part("the control, with its guard")
    sample_time: Number = parameter("s", "time from sample to sample", above=0)
    encoders: int = choice("encoders of the drive", options=(1, 2), default=1)

    def sample(
        self, prepared: Any, state: Any, inputs: Mapping[str, Number], noise: object, time: object
    ) -> tuple[Any, dict[str, Number]]:
        """Compute one sample."""
        setpoint = Setpoint(*(inputs[name] for name in SETPOINT))
        load = inputs["reading_load"]
        motor = inputs["reading_motor"] if self.encoders == 2 else load
        after, command = self.control.step(prepared, state, setpoint, motor, load, inputs["enable"], self.sample_time)
        values = command.applied, command.feedback, command.feedforward, command.trip
        return after, dict(zip(_OUTPUTS, values, strict=True))


class Commanded(NamedTuple):
    """What a control commands in a cycle: the target force, N, and in csv the target velocity, m/s, with its force
    feedforward, N. `trip` names what tripped its guard, "" for nothing.
    """

    force: float
    velocity: float = 0.0
    trip: str = ""


class ControlInMaster:
    """A control that runs in the master of one drive, in `cst` or, for the outer loop of a cascade, in `csv`.

    In a cycle it gets the setpoint and the readings of the last answer; what it commands goes out with the frame of
    that cycle.  From a reading to the force that answers it so pass `lag` + 1 cycles more than within the drive: the
    dead time of the loop is longer by as much.

    A lost frame is a broken reading, NaN: the guard holds the last command, and goes on with the motion as it was.  It
    does so for `lost_frames` samples at least, after which the monitor of the drive ends the motion.

    cst  the force of the control, with its guard; a control without one gets one without limits, as only a guard can
         switch it on.  Its force limit is that of the control, or limits.force where that is smaller
    csv  the velocity of a law that commands one (`PositionLoop`), with its guard, within its velocity limit and
         limits.velocity; or the velocity that the position loop of a `CascadePPI` asks for, with the force feedforward
         of the control, without a guard.  The velocity loop is that of the drive.  Raises StructureError for another
         law, and for filters and compensations that act on a force

    A control starts at rest from the force that acts, which `begin` is given: its integral carries it.
    Raises ParameterError for a loop whose sample time is not that of the drive.  It is made before the drive is opened:
    compiling takes longer than the watchdog of a drive.
    """

    def __init__(
        self,
        control: Control | Loop,
        sample_time: float,
        *,
        mode: str = "cst",
        force: float,
        velocity: float = math.inf,
        encoders: int = 1,
        lost_frames: int = 3,
    ) -> None:
        """Trace and compile the step; `force` and `velocity` are the largest that the drive may get, N and m/s,
        `lost_frames` as in the drive file.
        """
        if isinstance(control, Loop):
            if not math.isclose(float(control.sample_time), sample_time):
                raise ParameterError(
                    f"the control of axis {control.name} runs every {Quantity(control.sample_time, 's'):6 us}, and the "
                    f"drive every {Quantity(sample_time, 's'):6 us} (cycle_time): design it for that sample time"
                )
            encoders = min(encoders, control.axis.encoders())
            control = control.control
        if control.law.positions() > encoders:
            raise StructureError(
                f"control.law: {control.law.kind} needs the position of the motor and that of the load, and the drive "
                "gives one of them (it has no second position, 0x60E4): take a law with one, such as cascade_ppi"
            )
        if mode == "csp":
            raise ParameterError(
                'mode = "csp": the drive closes all loops by itself; a control of ours takes mode = "cst", or "csv" '
                "for the position loop alone"
            )
        self.mode = mode
        # of a cascade only the outer loop runs here
        self._outer = mode == "csv" and control.law.commanded == "force"
        if mode == "cst":
            made = _in_torque(control, force)
        else:
            made = _outer_loop(control) if self._outer else _in_velocity(control, velocity)
        self.control = replace(made, guard=_patient(made.guard, lost_frames))
        self.remarks: list[str] = []
        own = control.force_limit
        if mode == "cst" and (own is None or float(own) > force):
            said = "has no force limit" if own is None else Text(f"is limited to {Quantity(own, 'N')}")
            self.remarks.append(
                Text(f"The control {said}, and limits.force of the drive file to {Quantity(force, 'N')}: that acts.")
            )
        # of the outer loop of a cascade the motor stands for the law, at whatever is given as its position
        self.encoders = 1 if self._outer else encoders
        encoders = 2 if self._outer else encoders
        self.sample_time = sample_time
        self._system = InMaster(control=self.control, sample_time=sample_time, encoders=encoders)
        self._plain = concrete(self._system)
        with np.errstate(all="ignore"):
            self._prepared = self._plain.control.prepare(np.float64(sample_time))
        begun = self._start(0.0, 0.0)
        key = tuple(tree.structure(part) for part in (self._plain, self._prepared, begun))
        self._native = _compiled.get(key, lambda: native(plan(trace(self._plain, self._prepared, begun, _INPUTS))))
        values = {**dict(tree.leaves(self._plain)), **dict(numbers(self._prepared, "prepared")), "seed": 0.0}
        steps = self._native.plan
        self._constants = np.array([[values[name]] for name, _ in steps.constants], dtype=np.float64).reshape(-1, 1)
        tables = dict(tree.tables(self._system))
        self._tables = [tables[name] for name, _ in steps.tables]
        self._inputs = np.zeros((1, len(steps.inputs)))
        self._columns = [(column, _INPUTS.index(name)) for column, (name, _) in enumerate(steps.inputs)]
        outputs = [name for name, _ in steps.outputs]
        self._out = np.empty((len(outputs), 1))
        self._rows = [outputs.index(name) for name in _OUTPUTS]
        self._states = np.empty(0)
        self._lay_out(begun)
        self._forces, self._travel = (
            [row for row, state in enumerate(steps.states) if state.name in names] for names in (_FORCES, (_TRAVEL,))
        )
        self._last = Commanded(0.0)

    @property
    def needs_torque_offset(self) -> bool:
        """True if the control commands a force beside a velocity."""
        return self._outer and bool(self.control.feedforward)

    def begin(self, position: float, motor: float | None) -> None:
        """Start for an axis that stands at a reading, m (`motor`: of the second encoder), before the drive is enabled:
        it takes some cycles.
        """
        self._lay_out(self._start(0.0 if self._outer or motor is None else motor, position))

    def rest(self, position: float, motor: float | None, force: float) -> None:
        """Take the readings (m) of an axis at rest, and the force (N) that holds it: the next sample is enabled, and
        begins with this force; one that commands a velocity begins at rest.
        """
        if self.mode == "csv":
            force = 0.0
        limit = self.control.force_limit
        if limit is not None:
            force = max(-float(limit), min(float(limit), force))
        self.step(Setpoint(position), position, motor, enable=False)
        self._states[self._travel] = 0.0
        self._states[self._forces] = force
        self._last = Commanded(force)

    def step(self, setpoint: Setpoint, load: float, motor: float | None = None, *, enable: bool = True) -> Commanded:
        """Compute a sample from a setpoint and the last readings, m; after a trip the last command is held."""
        second = 0.0 if self._outer or motor is None else motor
        values = (*setpoint, second, load, float(enable))
        inputs = self._inputs
        for column, place in self._columns:
            inputs[0, column] = values[place]
        self._native.run_at(1, 0, self._memory, inputs.strides)
        force, feedback, feedforward, trip = self._out[self._rows, 0].tolist()
        if trip:
            return self._last._replace(trip=f"the guard of the control tripped: {TRIPS[trip]}")
        if self._outer:
            self._last = Commanded(feedforward, feedback)
        else:
            self._last = Commanded(force) if self.mode == "cst" else Commanded(0.0, force)
        return self._last

    def _start(self, motor: float, load: float) -> Any:
        rest = Setpoint(*(np.float64(value) for value in (load, 0.0, 0.0, 0.0, 0.0)))
        position = np.float64(load)
        second = position if self._system.encoders == 1 else np.float64(motor)
        with np.errstate(all="ignore"):
            return self._plain.control.start(self._prepared, rest, second, position)

    def _lay_out(self, begun: Any) -> None:
        """Write a state in the order of the machine code."""
        held = dict(tree.leaves(begun))
        states = [np.float64(held[state.name]) for state in self._native.plan.states]
        for name, _, length in self._native.plan.rings:
            ring = held[name.removeprefix("state.")]
            states += [0.0] * length if not isinstance(ring, Ring) or ring.cells is None else list(ring.cells)
        self._states = np.array(states, dtype=np.float64).reshape(-1, 1)
        rows = (ctypes.c_void_p * max(1, len(self._tables)))(*[row.ctypes.data for row in self._tables])
        kept = self._constants, self._inputs, self._states, self._out
        self._memory = (*(array.ctypes.data for array in kept), ctypes.addressof(rows))
        self._kept = rows  # as long as its address is used


def _patient(guard: Guard | None, lost_frames: int) -> Guard:
    """Return the guard, or one without limits, that holds the command as long as the monitor allows lost frames."""
    guard = Guard() if guard is None else guard
    return replace(guard, holds=True, hold_samples=max(float(guard.hold_samples), float(lost_frames)))


def _in_torque(control: Control, force: float) -> Control:
    """Return the control with a force limit of at most `force`, N. Raises StructureError for a law that commands a
    velocity.
    """
    if control.law.commanded != "force":
        raise StructureError(
            f'control.law: {control.law.kind} commands a {control.law.commanded}, and mode = "cst" takes a force: take '
            'mode = "csv", or a law that commands a force, such as cascade_ppi'
        )
    limit = control.force_limit
    return replace(control, force_limit=force if limit is None else min(force, float(limit)))


def _in_velocity(control: Control, velocity: float) -> Control:
    """Return the control of a law that commands a velocity, with a limit of at most `velocity`, m/s."""
    limit = control.velocity_limit
    most = velocity if limit is None else min(velocity, float(limit))
    return replace(control, velocity_limit=most if math.isfinite(most) else None)


def _outer_loop(control: Control) -> Control:
    """Return the outer loop of a cascade as a control whose feedback is the set velocity, m/s.

    It is the cascade itself, with a velocity gain of 1 and a motor that stands: what is left is its set velocity.
    """
    law = control.law
    if not isinstance(law, CascadePPI):
        raise StructureError(
            f'control.law: {law.kind} commands a force, and mode = "csv" takes the velocity of a position loop around '
            'the velocity loop of the drive: take mode = "cst", or a position_loop or cascade_ppi'
        )
    held = [name for name in ("filters", "compensation") if getattr(control, name)]
    if held:
        raise StructureError(
            f'control.{held[0]} acts on the force of the control, and in mode = "csv" the drive makes the force: take '
            'mode = "cst", or leave it out'
        )
    outer = replace(
        law,
        Kp=1.0,
        Tn=None,
        viscous=None,
        model_mass=None,
        velocity_samples=1,
        velocity_lag=None,
        velocity_encoder="motor",
    )
    return replace(control, law=outer, force_limit=None, guard=None)
