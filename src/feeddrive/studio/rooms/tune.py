"""Tuning by hand: numbers that are moved, pictures that follow, and what was kept to compare."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.table import shown
from feeddrive.loop.control import Control
from feeddrive.loop.simulate import Run
from feeddrive.studio.desk import Desk, Values
from feeddrive.studio.pictures import charts
from feeddrive.studio.room import Asked, Room, Said, act
from feeddrive.tuning.by_hand import ByHand, Look

TODAY, NOW = "today", "now"
SNAPSHOTS = ("A", "B", "C")
_BESIDE = ThreadPoolExecutor(thread_name_prefix="run")  # the run is simulated while the loop is looked at


class Tune(Room):
    """The numbers of the control, moved by hand."""

    name = "tune"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.begin()

    def begin(self) -> None:
        """Forget what was kept of the source before."""
        self.snapshots: dict[str, Values] = {}
        self._seen: dict[str, tuple[Values, Look, Run | None]] = {}

    def show(self) -> Said:
        """The numbers with their declarations, and the pictures."""
        if self.desk.bench is None:
            return Said({"knobs": []})
        said = self._pictures()
        return Said({**said.words, "knobs": self._knobs()}, said.charts)

    @act
    def move(self, asked: Asked) -> Said:
        """One number; `first` begins a drag, whose other moves are undone with it."""
        name = asked.text("name")
        if name not in self.desk.values:
            raise ParameterError(f"the control has no number '{name:.60}'")
        self.desk.change({**self.desk.values, name: asked.number("value")}, begins=asked.yes("first", True))
        return self._pictures()

    @act
    def undo(self, _: Asked) -> Said:
        """Back to the step before."""
        self.desk.back()
        return self._pictures()

    @act
    def redo(self, _: Asked) -> Said:
        """A step that was undone, again."""
        self.desk.again()
        return self._pictures()

    @act
    def reset(self, _: Asked) -> Said:
        """Today's numbers."""
        self.desk.change(self.desk.needed.by_hand.values)
        return self._pictures()

    @act
    def keep(self, asked: Asked) -> Said:
        """Keep the numbers of now under a letter."""
        self.snapshots[asked.choice("letter", SNAPSHOTS)] = dict(self.desk.values)
        return self._pictures()

    @act
    def take(self, asked: Asked) -> Said:
        """Go to the numbers that were kept."""
        letter = asked.choice("letter", SNAPSHOTS)
        if letter not in self.snapshots:
            raise ParameterError(f"nothing was kept as {letter} yet")
        self.desk.change(self.snapshots[letter])
        return self._pictures()

    @act
    def drop(self, asked: Asked) -> Said:
        """Forget what was kept."""
        self.snapshots.pop(asked.choice("letter", SNAPSHOTS), None)
        return self._pictures()

    @act
    def file(self, _: Asked) -> Said:
        """The machine file with the numbers of now."""
        bench = self.desk.needed
        return Said(
            {"file": bench.text(self.desk.values), "file_name": bench.machine.file.name if bench.machine else ""}
        )

    def _pictures(self) -> Said:
        bench, values = self.desk.needed, self.desk.values
        found = {TODAY: self._look(TODAY, bench.before, bench.before.values)}
        found |= {letter: self._look(letter, bench.by_hand, kept) for letter, kept in sorted(self.snapshots.items())}
        found[NOW] = self._look(NOW, bench.by_hand, values)
        _, now, _ = found[NOW]
        drawn = charts(
            {name: look for name, (_, look, _) in found.items()},
            {name: run for name, (_, _, run) in found.items() if run is not None},
            rotary=bench.rotary,
        )
        limits = bench.by_hand.limits
        said = {
            "judged": [{"text": f"{each}, limit: {limits.only(each.kind)}", "keeps": each.keeps}
                       for each in now.judged],
            "remarks": bench.remarks, "places": len(bench.by_hand.points), "leading": now.leading.point,
            "stable": now.stable, "values": values, "undo": len(self.desk.undo), "redo": len(self.desk.redo),
            "kept": sorted(self.snapshots),
        }  # fmt: skip
        return Said(said, drawn)

    def _look(self, name: str, by_hand: ByHand, values: Values) -> tuple[Values, Look, Run | None]:
        known = self._seen.get(name)
        if known is None or known[0] != values:
            running = _BESIDE.submit(self._run, name, by_hand.control(values))
            look, run = by_hand.at(values), running.result()
            known = self._seen[name] = (dict(values), look, run if look.stable else None)
        return known

    def _run(self, name: str, control: Control) -> Run | None:
        """None if the axis leaves its bounds: then what is linear of it is shown."""
        bench = self.desk.needed
        with suppress(FeeddriveError):
            return None if bench.loop is None else bench.run(control, name)
        return None

    def _knobs(self) -> list[dict[str, Any]]:
        """What the page shows of each number, in the units that people read."""
        bench, found = self.desk.needed, list[dict[str, Any]]()
        for each in bench.by_hand.knobs:
            declared = each.declared.of_axis(bench.rotary)
            unit, factor = shown(declared.unit)
            dragged = each.declared.unit == "Hz" and each.name.startswith("filters.")
            found.append({
                "name": each.name, "block": each.block, "unit": unit, "factor": factor, "low": each.low,
                "high": each.high, "logarithmic": each.logarithmic, "meaning": declared.meaning, "today": each.value,
                "dragged": dragged,
            })  # fmt: skip
        return found
