"""The starting point of variants: one law of a job with its system, references and loads, and its numbers by path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.reference.linear_move import LinearMove
from feeddrive.files.job import Job, Other
from feeddrive.language import tree
from feeddrive.language.block import Block
from feeddrive.language.declaration import Declaration
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System


@dataclass(frozen=True, eq=False)
class Base:
    """A row of a job: its system at nominal numbers, with the motion and the loads of all axes."""

    job: Job
    row: str

    @property
    def system(self) -> System:
        """The axis, or all axes if they run together."""
        return self.job.machines.get(self.row, self.job.loops[self.row])

    @property
    def loop(self) -> Loop:
        """The axis of the row alone."""
        return self.job.loops[self.row]

    @property
    def axis(self) -> str:
        """The name of that axis."""
        return self.loop.name

    @property
    def moved(self) -> dict[str, Other]:
        """Motion and load by axis."""
        return {self.axis: Other(reference=self.job.reference, load=self.job.load), **self.job.others}

    def references(self, changed: dict[str, Other] | None = None) -> Reference | dict[str, Reference]:
        """The motion as `simulate` takes it; axes without one stand still."""
        moved = self.moved if changed is None else changed
        own = moved[self.axis].reference
        assert own is not None
        if not isinstance(self.system, Machine):
            return own
        still = LinearMove(distance=0.0, travel_time=max(own.duration, float(self.system.sample_time)))
        return {axis: (moved[axis].reference or still) if axis in moved else still for axis in self.system.axes()}

    def loads(self, changed: dict[str, Other] | None = None) -> Load | dict[str, Load] | None:
        """The forces on the tables as `simulate` takes them."""
        moved = self.moved if changed is None else changed
        if not isinstance(self.system, Machine):
            return moved[self.axis].load
        return {axis: other.load for axis, other in moved.items() if other.load is not None} or None

    def place(self, path: str) -> tuple[str, str, str]:
        """Split a path of a motion or load into axis, "reference" or "load", and rest; other paths have no axis."""
        first, _, rest = path.partition(".")
        if first in ("reference", "load"):
            return self.axis, first, rest
        if first == "others":
            axis, _, inside = rest.partition(".")
            kind, _, rest = inside.partition(".")
            if axis not in self.job.others or kind not in ("reference", "load"):
                raise ParameterError(f"there is no '{path}': others.NAME.reference and others.NAME.load of the job")
            return axis, kind, rest
        return "", "", path

    def block(self, path: str) -> tuple[Any, str]:
        """The block that a path belongs to, and the path in it. Raises ParameterError if there is none."""
        axis, kind, rest = self.place(path)
        if not kind:
            return self.system, path
        block = getattr(self.moved[axis], kind)
        if block is None:
            raise ParameterError(f"there is no '{path}': {self.job.file.name} has no [{path.rpartition('.')[0]}]")
        return block, rest

    def declaration(self, path: str) -> Declaration:
        """The declaration of a path. Raises ParameterError, with the row, for one that is not there."""
        block, rest = self.block(path)
        try:
            own = tree.declaration(block, rest)
        except FeeddriveError as error:
            raise type(error)(f"{error} (row '{self.row}' of {self.job.file.name})") from None
        if not isinstance(block, Block):
            return own
        return own.of_axis(self.loop.axis.rotary and block is not self.system)

    def nominal(self, path: str) -> float:
        """The value of a path. Raises ParameterError for one that is not there, or has no value."""
        block, rest = self.block(path)
        value = tree.get(block, rest)
        if value is None:
            raise ParameterError(f"'{path}' has no value in {self.job.machine.file.name}")
        return float(value)

    def blocks(self) -> Iterator[Block]:
        """The system, and the motions and loads of all axes."""
        yield self.system
        for other in self.moved.values():
            yield from (block for block in (other.reference, other.load) if block is not None)
