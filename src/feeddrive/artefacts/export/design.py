"""What is exported: the control, or the axis, of a machine file, under a name."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import feeddrive
from feeddrive.artefacts.export.exportable import check_exportable
from feeddrive.artefacts.export.identifiers import check_name
from feeddrive.artefacts.export.layout import Layout, layout
from feeddrive.artefacts.files.machine import Machine, read_machine
from feeddrive.loop.loop import Loop
from feeddrive.loop.routine import Routine
from feeddrive.loop.routine_trace import controller_routine, plant_routine

CONTROL, PLANT = "control", "plant"
MACHINE_FILE = "machine.toml"  # the copy of the machine file in an export


@dataclass(frozen=True, eq=False)
class Design:
    """A control or an axis of a machine file, as a routine that is laid out in some precision."""

    machine: Machine
    axis: str
    loop: Loop
    what: str
    layout: Layout

    @property
    def routine(self) -> Routine:
        """Its four functions."""
        return self.layout.routine

    @property
    def name(self) -> str:
        """The prefix of all its names."""
        return self.routine.name

    @property
    def title(self) -> str:
        """What it is, in a line."""
        kind = self.loop.control.law.kind if self.what == CONTROL else self.loop.axis.plant.kind
        return f"{self.what.capitalize()} of axis {self.axis} of '{self.machine.name}': {kind}"

    @property
    def digest(self) -> str:
        """The SHA-256 of the machine file."""
        return hashlib.sha256(self.machine.file.text.encode()).hexdigest()

    @property
    def made_by(self) -> str:
        """Who made it, from what."""
        file = Path(self.machine.file.name).name
        return f"Made by feeddrive {feeddrive.__version__} from {file}, SHA-256 {self.digest}."


def read_design(
    source: str | Path, axis: str | None = None, *, name: str | None = None, what: str = CONTROL,
    precision: str = "double",
) -> Design:  # fmt: skip
    """The design of a machine file, or of a bundled machine.

    name  prefix of all names on the target; absent: `axis_x`, or `plant_x` for an axis
    what  "control" or "plant"

    Raises FileError and ParameterError as `read_machine`, ParameterError for a name that a target cannot have,
    StructureError for a part that leaves the language of `ops`, and both as `check_exportable`.
    """
    machine = read_machine(source)
    loop = machine.loop(axis)
    called = next(each for each, found in machine.loops.items() if found is loop)
    prefix = name or f"{'axis' if what == CONTROL else 'plant'}_{called}"
    check_name(prefix, "--name" if name else "the name of the axis")
    routine = controller_routine(loop, prefix) if what == CONTROL else plant_routine(loop, prefix)
    made = layout(routine, precision)
    check_exportable(made)
    return Design(machine, called, loop, what, made)
