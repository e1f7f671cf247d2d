"""The loop of a machine file as simulated by a virtual drive, some samples per call, and its drive file.

It runs with its complete control, with the velocity loop only, or with a commanded force.  Increments and rated torque
are taken from the machine file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.actuator.screw import Screw
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.bus.drive_file import DriveScaling
from feeddrive.language.errors import StructureError
from feeddrive.loop.axis import Axis
from feeddrive.loop.engine.native import Native
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop
from feeddrive.loop.runner import Prepared

_RECORD = ("reading_load", "reading_motor", "force", "trip")


class Sample(NamedTuple):
    """The last sample of a call: readings (m), force that acts from it on (N), code of the guard."""

    position: float
    second: float
    force: float
    trip: float


class DrivenAxis:
    """Plant and control as `simulate` runs them, from the same native code, one call at a time.

    A control without a guard gets one without limits, since a drive is switched on and off.
    """

    def __init__(self, loop: Loop, position: float = 0.0, seed: int = 0) -> None:
        if loop.control.guard is None:
            loop = replace(loop, control=replace(loop.control, guard=Guard()))
        self.loop = loop
        self.sample = 0
        begin = Setpoint(np.float64(position), *[np.float64(0.0)] * 4)
        prepared = Prepared(loop, begin, (position, 0.0), seed)
        self._closed = self._native(prepared, "added_force")
        self._open = self._native(prepared, "cut")
        if [s.name for s in self._closed.plan.states] != [s.name for s in self._open.plan.states]:
            raise StructureError("the axis has other states in an open loop: it cannot be driven by force")
        self._states = prepared.states(self._closed)
        self._constants = prepared.constants(self._closed)
        self._of_open = prepared.constants(self._open)
        self._velocity = self._constants.copy()
        for name, value in (("control.law.Kv", 0.0), ("control.law.velocity_feedforward", 1.0)):
            for row, (each, _) in enumerate(self._closed.plan.constants):
                if each == name:
                    self._velocity[row] = value
        self._tables = prepared.rows(self._closed), prepared.rows(self._open)
        motor, load = loop.axis.still(position)
        self.last = Sample(float(load), float(motor), 0.0, 0.0)

    @property
    def encoders(self) -> int:
        """How many positions are read."""
        return self.loop.axis.encoders()

    @property
    def has_velocity_loop(self) -> bool:
        """Whether the law is a cascade, whose velocity loop runs alone when its position gain is 0."""
        return isinstance(self.loop.control.law, CascadePPI)

    @staticmethod
    def _native(prepared: Prepared, probe: str) -> Native:
        program = prepared.program(load=False, enable=True, probes=(probe,))
        return prepared.native(program, record=_RECORD)

    def follow(
        self, position: np.ndarray, velocity: np.ndarray, added_force: float, enable: bool, alone: bool = False
    ) -> Sample:
        """As many samples as there are set positions (m) and velocities (m/s), with a force (N) behind the limit.

        With `alone` only the velocity loop runs.  Disabled, no force acts.
        """
        values = {"set_position": position, "set_velocity": velocity, "added_force": added_force * enable}
        return self._run(self._closed, self._velocity if alone else self._constants, values, enable, position.size, 0)

    def push(self, force: float, samples: int) -> Sample:
        """The force (N) straight to the axis; the control is off."""
        found = self._run(self._open, self._of_open, {"cut": force}, False, samples, 1)
        self.last = found._replace(force=force)
        return self.last

    def _run(
        self, made: Native, constants: np.ndarray, values: Mapping[str, Any], enable: bool, count: int, table: int
    ) -> Sample:
        inputs = np.zeros((count, len(made.plan.inputs)))
        for column, (name, _) in enumerate(made.plan.inputs):
            inputs[:, column] = float(enable) if name == "enable" else values.get(name, 0.0)
        outputs = np.empty((count, len(_RECORD)))
        made.run(count, self.sample, constants, inputs, self._states, outputs, self._tables[table])
        self.sample += count
        names = [name for name, _ in made.plan.outputs]
        row = dict(zip(names, outputs[-1].tolist(), strict=True))
        trip = max(outputs[:, names.index("trip")])
        added = float(inputs[-1, [n for n, _ in made.plan.inputs].index("added_force")]) if table == 0 else 0.0
        self.last = Sample(row["reading_load"], row["reading_motor"], row["force"] + added, float(trip))
        return self.last


_INCREMENT = 10e-9  # m, of an encoder without resolution
_PEAK = 3.0  # peak over rated force, where only the peak is stated
_FORCE = 1000.0  # N, rated, where nothing is stated


def scaling_of(loop: Loop) -> DriveScaling:
    """One increment is one count of the encoder of the position loop; rated is the continuous force of the motor.

    A motor on a screw gets a whole number of counts in a turn; the rated torque is a whole number of mN m.
    """
    sensor = loop.axis.encoder_load or loop.axis.encoder_motor
    resolution = sensor.resolution if isinstance(sensor, Encoder) else None
    increment = _INCREMENT if resolution is None else float(resolution)
    motor = loop.axis.actuator.motor
    peak, continuous = (None, None) if motor is None else motor.limits()
    most = peak if peak is not None else loop.control.force_limit
    rated = float(continuous) if continuous is not None else float(most) / _PEAK if most is not None else _FORCE
    if not isinstance(motor, Screw):
        return DriveScaling(increment=increment, rated_force=max(1e-3, round(rated, 3)))
    lead, gear = float(motor.lead), float(motor.gear)
    torque = rated * float(motor.torque_constant) / float(motor.force_per_unit())
    return DriveScaling(
        counts_per_turn=float(max(1, round(lead / (gear * increment)))), lead=lead, gear=gear,
        rated_torque=max(1e-3, round(torque, 3)),
    )  # fmt: skip


_HELD_UP = 0.02  # s by which an ordinary computer may be late
_RESERVE = 1.5  # of the mass and breakaway force that are stated, over those of the axis
_SLOW = np.logspace(-9.0, -3.0, 25)  # m/s, among which friction is largest


def _resistance(axis: Axis) -> float | None:
    """The largest force against which an axis may stand: friction and weight, N; None if it has other forces."""
    if not all(isinstance(force, Gravity) for force in axis.forces):
        return None
    frictions = [friction for friction in (axis.friction_motor, axis.friction_load) if friction is not None]
    held = sum(max(abs(float(each.steady(v) - each.linear() * v)) for v in (*-_SLOW, *_SLOW)) for each in frictions)
    return held + abs(sum(float(force.force) for force in axis.forces if isinstance(force, Gravity)))


def drive_text(loop: Loop, scaling: DriveScaling, bus: str, interface: str, station: int, cycle_time: float) -> str:
    """A drive file for the virtual drive; its limits are those of the machine's guard and control, if it has any."""
    guard, limits = loop.control.guard, loop.control.force_limit
    velocity = None if guard is None else guard.velocity_limit
    following = None if guard is None else guard.following_error_limit
    force = 1000.0 * 3.0 * scaling.newton if limits is None else float(limits)
    resistance = _resistance(loop.axis)
    axis = "" if resistance is None else (
        f"largest_mass = {_RESERVE * float(loop.axis.plant.rigid_mass()):.4g}   # kg, for mode = \"cst\"\n"
        f"breakaway_force = {_RESERVE * resistance:.4g}   # N, likewise\n"
    )  # fmt: skip
    if scaling.turns:
        units = (
            f"counts_per_turn = {scaling.counts_per_turn:.0f}\nlead = {scaling.lead!r}\ngear = {scaling.gear!r}\n"
            f"rated_torque = {scaling.rated_torque!r}"
        )
    else:
        units = f"increment = {scaling.increment!r}\nrated_force = {scaling.rated_force!r}"
    return (
        f"# The virtual drive of feeddrive; for your own drive look up every number.\n"
        f'bus = "{bus}"\ninterface = "{interface}"\nstation = {station}\ncycle_time = {cycle_time!r}   # s\n'
        f'mode = "csp"\n'
        f"late_cycles = {max(3, round(_HELD_UP / cycle_time))}   # for an ordinary computer; a real axis: 3\n\n"
        f"[scaling]\n{units}\n\n[limits]\ntravel = 0.5   # m, from where it starts, to both sides\n"
        f"velocity = {1.0 if velocity is None else float(velocity)!r}   # m/s\nforce = {force!r}   # N\n"
        f"following_error = {5e-3 if following is None else float(following)!r}   # m\n{axis}"
    )
