"""A virtual gantry: two drives of one EtherCAT segment whose plants are simulated as one machine, in virtual time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from feeddrive.blocks.coupling.cross_beam import CrossBeam
from feeddrive.blocks.signals import Setpoint
from feeddrive.bus.drive_file import drive_of
from feeddrive.bus.gantry import Gantry
from feeddrive.bus.live import BusAxis, virtual_cycle_time
from feeddrive.bus.virtual_bus import VirtualEtherCAT
from feeddrive.bus.virtual_drive import DrivenAxis, Firmware, Sample, drive_text, scaling_of
from feeddrive.files.toml_file import TomlEdit, parse_toml
from feeddrive.language.errors import StructureError
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.runner import Prepared

_RECORD = ("reading_load", "reading_motor", "force", "trip")
_LAG = 2  # cycles from a target to its answer: one as on any bus, one for the other drive
SKEW = 1e-3  # m of skew that the drive files of a virtual gantry allow


class _Asked(NamedTuple):
    """What a side is to do in a bus cycle: setpoints by sample, an added force (N), how its control runs, and the
    largest force of both together (N).
    """

    position: np.ndarray
    velocity: np.ndarray
    force: float
    enable: bool
    alone: bool = False
    sign: float = 1.0
    most: float = math.inf


class DrivenGantry:
    """The plants and controls of two drives with the beam between them, simulated by the native code of `simulate`.

    Each side is driven like an axis of its own (`DrivenAxis`).  A bus cycle of both is simulated once both have asked
    for it; what a side then returns is the end of the cycle before, so that its answers are one cycle older than those
    of a drive alone.  A side that is not exchanged coasts.
    """

    def __init__(self, machine: Machine, seed: int = 0) -> None:
        loops = {name: _guarded(loop) for name, loop in machine.loops().items()}
        if len(loops) != 2:
            raise StructureError(f"a gantry has two drives on one beam, not the axes {', '.join(loops)}")
        machine = Machine.of(loops, machine.couplings)
        rest = Setpoint(*[np.float64(0.0)] * 5)
        prepared = Prepared(machine, dict.fromkeys(loops, rest), dict.fromkeys(loops, (0.0, 0.0)), seed)
        probes = [f"{port}added_force" for port in machine.ports()]
        program = prepared.program(load=False, enable=True, probes=probes)
        record = [f"{port}{name}" for port in machine.ports() for name in _RECORD]
        self._native = prepared.native(program, record=record)
        self._states = prepared.states(self._native)
        self.constants = prepared.constants(self._native)
        self.places = {name: row for row, (name, _) in enumerate(self._native.plan.constants)}
        self._tables = prepared.rows(self._native)
        self._sample = 0
        self.sides = tuple(DrivenSide(self, loop, name) for name, loop in loops.items())
        self._asked: dict[str, _Asked] = {}
        self._fresh: dict[str, Sample] = {side.name: side.last for side in self.sides}

    def ask(self, side: DrivenSide, asked: _Asked) -> Sample:
        """Take what a side is to do in its next cycle; return how it ended the last one that was simulated."""
        if side.name in self._asked:
            self._advance()
        before = self._fresh[side.name]
        self._asked[side.name] = asked
        if len(self._asked) == len(self.sides):
            self._advance()
        return before

    def _advance(self) -> None:
        """Simulate one bus cycle of both sides."""
        count = next(iter(self._asked.values())).position.size
        constants, values = self.constants.copy(), dict[str, np.ndarray | float]()
        for side in self.sides:
            still = np.full(count, self._fresh[side.name].position)
            asked = self._asked.get(side.name) or _Asked(still, np.zeros(count), 0.0, False)
            side.change(constants, alone=asked.alone, sign=asked.sign, most=asked.most)
            values |= {
                f"{side.name}.set_position": asked.position,
                f"{side.name}.set_velocity": asked.velocity,
                f"{side.name}.added_force": asked.force,
                f"{side.name}.enable": float(asked.enable),
            }
        inputs = np.zeros((count, len(self._native.plan.inputs)))
        for column, (name, _) in enumerate(self._native.plan.inputs):
            inputs[:, column] = values.get(name, 0.0)
        outputs = np.empty((count, len(self._native.plan.outputs)))
        self._native.run(count, self._sample, constants, inputs, self._states, outputs, self._tables)
        self._sample += count
        rows = {name: outputs[:, column] for column, (name, _) in enumerate(self._native.plan.outputs)}
        for side in self.sides:
            position, second, force, trip = (rows[f"{side.name}.{name}"] for name in _RECORD)
            added = values[f"{side.name}.added_force"]
            # a trip in any sample of the bus cycle is a fault of the drive
            self._fresh[side.name] = Sample(
                float(position[-1]), float(second[-1]), float(force[-1] + added), float(np.max(trip))
            )
        self._asked.clear()


class DrivenSide(DrivenAxis):
    """One side of a `DrivenGantry`, as the firmware of its drive knows it; it has no brake."""

    def __init__(self, whole: DrivenGantry, loop: Loop, name: str) -> None:
        self.loop, self.name, self._whole, self.sample = loop, name, whole, 0
        motor, load = loop.axis.still(0.0)
        self.last = Sample(float(load), float(motor), 0.0, 0.0)
        self.constants, self.places, self.control = whole.constants, whole.places, f"axis.{name}.control"

    def stand(self, samples: int, force: float = 0.0) -> Sample:
        """Refuse to stand on a brake."""
        raise StructureError(f"axis {self.name}: a side of a virtual gantry has no brake")

    def follow(
        self,
        position: np.ndarray,
        velocity: np.ndarray,
        added_force: float,
        enable: bool,
        alone: bool = False,
        sign: float = 1.0,
        most: float = math.inf,
    ) -> Sample:
        """Ask for one sample for each set position; see `DrivenAxis`."""
        added = max(-most, min(most, sign * added_force * enable))
        asked = _Asked(position, np.asarray(velocity), added, enable, alone, sign, most)
        self.last = self._whole.ask(self, asked)
        return self.last

    def push(self, force: float, samples: int) -> Sample:
        """Ask for a force (N) with the control switched off."""
        still = np.full(samples, self.last.position)
        # the control is off: only the added force acts
        self.last = self._whole.ask(self, _Asked(still, np.zeros(samples), force, False))
        return self.last


def _guarded(loop: Loop) -> Loop:
    """Return the loop with a guard, which alone can switch a control on and off."""
    if loop.control.guard is not None:
        return loop
    return replace(loop, control=replace(loop.control, guard=Guard()))


def beam_of(machine: Machine) -> CrossBeam | None:
    """Return the beam between two drives of a machine; None if it has none."""
    return next((coupling for coupling in machine.couplings if isinstance(coupling, CrossBeam)), None)


def virtual_gantry(machine: Machine, *, skew: float = SKEW, seed: int = 0) -> Gantry:
    """Return the two virtual drives of a machine with a `CrossBeam`, whose controls are the old ones of the drives.

    machine  other axes and the couplings to them are left out
    skew     m, limits.skew of both drive files

    Raises StructureError for a machine without a beam.
    """
    driven = driven_gantry(machine, seed)
    sides = [_axis_of(side, station, skew) for station, side in enumerate(driven.sides, start=1)]
    return Gantry(sides[0], sides[1])


def driven_gantry(machine: Machine, seed: int = 0) -> DrivenGantry:
    """Return the two drives of a machine with a `CrossBeam`; its other axes and the couplings to them are left out.

    Raises StructureError for a machine without a beam.
    """
    beam = beam_of(machine)
    if beam is None:
        raise StructureError("a virtual gantry needs a machine with a cross_beam between its two drives")
    names = beam.axes()
    couplings = tuple(coupling for coupling in machine.couplings if set(coupling.axes()) <= set(names))
    loops = {name: loop for name, loop in machine.loops().items() if name in names}
    return DrivenGantry(Machine.of(loops, couplings), seed)


def side_text(side: DrivenSide, interface: str, station: int, cycle_time: float, skew: float = SKEW) -> str:
    """Return the text of the drive file of one side, with limits.skew (m)."""
    text = drive_text(side.loop, scaling_of(side.loop), "ethercat", interface, station, cycle_time)
    edit = TomlEdit(text, f"drive of {side.name}")
    edit.set(("lag",), _LAG)
    edit.set(("axis",), side.name)
    edit.set(("limits", "skew"), skew, "m")
    return edit.text


def _axis_of(side: DrivenSide, station: int, skew: float) -> BusAxis:
    cycle_time = virtual_cycle_time(side.loop)
    firmware = Firmware(side, scaling_of(side.loop), cycle_time)
    text = side_text(side, "virtual", station, cycle_time, skew)
    file = drive_of(parse_toml(text, f"virtual drive of axis {side.name}"))
    return BusAxis(file, lambda _: VirtualEtherCAT(firmware, station), paced=False)
