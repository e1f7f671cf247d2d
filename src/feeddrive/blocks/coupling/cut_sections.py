"""Cutting conditions that change from section to section of a program."""

from itertools import pairwise
from typing import Any, NamedTuple

from feeddrive.blocks.families import Edge
from feeddrive.language import ops
from feeddrive.language.block import Block, Number, table
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Symbol
from feeddrive.language.quantity import Quantity


class Settings(NamedTuple):
    """The cutting conditions within one section."""

    edge: Edge
    spindle_speed: Any  # rpm
    direction: Any  # rad; None: that of the motion


class CutSections(Block):
    """Depth of cut, engagement, spindle speed and feed direction, constant within each section of time.

    A quantity whose row is absent keeps the value of the cut or its cutter.  Section i is active for start[i] <= t <
    start[i+1]; the last section has no end, and the first is also active before its start.  A section must not be
    shorter than a substep.  An axial_depth of 0 m means that the tool does not cut.
    `entry` and `exit` are those of the chip: 0 .. π in a slot, 0 .. arccos(1 - 2 width / diameter) in up milling.
    Raises ParameterError, naming the section, for conditions that no tool can cut.
    """

    start: Any = table("s", "when each section begins; the first one holds before it, too", least=0)
    axial_depth: Any = table("m", "depth of cut of each section; 0 out of the work", least=0, default=None)
    entry: Any = table("rad", "angle at which the chip begins", least=0, below=3.1416, default=None)
    exit: Any = table("rad", "angle at which it ends", above=0, below=3.1416, default=None)
    spindle_speed: Any = table("rpm", "turns of the spindle", least=0, default=None)
    direction: Any = table("rad", "direction of the feed, from x towards y", default=None)

    def check(self) -> None:
        """Raise ParameterError unless the sections are in order and each can be cut."""
        rows = self.rows()
        if not rows:
            # in a trace the rows are symbols: their numbers were checked when the block was made
            return
        start = rows.pop("start")
        for name, row in rows.items():
            if len(row) != len(start):
                raise ParameterError(
                    f"cut_sections.{name} has {len(row)} values for {len(start)} sections: one for each start"
                )
        for i, (before, after) in enumerate(pairwise(start), 1):
            if after <= before:
                raise ParameterError(
                    f"cut_sections.start[{i}] = {Quantity(after, 's'):6 SI} must be > start[{i - 1}] = "
                    f"{Quantity(before, 's'):6 SI}: sections follow each other"
                )
        if ("entry" in rows) != ("exit" in rows):
            raise ParameterError("cut_sections.entry and .exit (rad) belong together: give both or neither")
        for i, (entry, leave) in enumerate(zip(rows.get("entry", ()), rows.get("exit", ()), strict=True)):
            if leave <= entry:
                raise ParameterError(
                    f"cut_sections.exit[{i}] = {Quantity(leave, 'rad'):6}, of the section that begins at "
                    f"{Quantity(start[i], 's'):6 SI}, must be above its entry of {Quantity(entry, 'rad'):6}: a tooth "
                    "goes from entry to exit"
                )
        for i, (speed, cuts) in enumerate(zip(rows.get("spindle_speed", ()), self.cutting(), strict=False)):
            if speed == 0.0 and cuts:
                raise ParameterError(
                    f"cut_sections.spindle_speed[{i}] = 0 rpm, of the section that begins at "
                    f"{Quantity(start[i], 's'):6 SI}, must be > 0 rpm where the tool cuts (axial_depth > 0 m): start "
                    "the spindle before, or cut later"
                )

    def rows(self) -> dict[str, list[float]]:
        """Return the rows that are present as lists of numbers by name; empty while tracing."""
        names = ("start", "axial_depth", "entry", "exit", "spindle_speed", "direction")
        present: dict[str, Any] = {name: row for name in names if (row := getattr(self, name)) is not None}
        if isinstance(self.start, Symbol):
            return {}
        return {name: row.tolist() for name, row in present.items()}

    def cutting(self) -> list[bool]:
        """Return one value per section: True if the tool cuts."""
        rows = self.rows()
        return [depth > 0.0 for depth in rows.get("axial_depth", [1.0] * len(rows["start"]))]

    def section(self, before: Any, time: Number) -> Any:
        """Return the index of the section at a time in s: `before`, that of the previous substep, or the next one."""
        start: Any = self.start
        # no section is shorter than a substep, so that the table need not be searched
        after = before + 1.0
        there = ops.both(after < float(ops.length(start)), time >= ops.gather(start, after))
        return ops.where(there, after, before)

    def settings(self, section: Any, usual: Settings) -> Settings:
        """Return the conditions in a section; a quantity without a row keeps its value in `usual`."""
        changing = ("axial_depth", "entry", "exit", "spindle_speed", "direction")
        rows: dict[str, Any] = {name: row for name in changing if (row := getattr(self, name)) is not None}
        changed_rows = {name: ops.gather(row, section) for name, row in rows.items()}
        changed = {name: changed_rows[name] for name in ("axial_depth", "entry", "exit") if name in changed_rows}
        return Settings(
            usual.edge._replace(**changed),
            changed_rows.get("spindle_speed", usual.spindle_speed),
            changed_rows.get("direction", usual.direction),
        )
