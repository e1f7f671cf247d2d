"""Tuning by hand: numbers that are moved, pictures that follow, and what was kept to compare."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.table import shown
from feeddrive.language.tree import check_sampled
from feeddrive.loop.control import Control
from feeddrive.loop.simulate import Run
from feeddrive.studio.desk import Desk, Held, Values
from feeddrive.studio.pictures import charts
from feeddrive.studio.room import Asked, Room, Said, act
from feeddrive.tuning.by_hand import ByHand, Look
from feeddrive.tuning.filter_pack import begun_filter, filter_kinds, with_filters

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
        self.snapshots: dict[str, Held] = {}
        self._seen: dict[str, tuple[ByHand, Values, Look, Run | None]] = {}
        self._told: ByHand | None = None  # whose numbers the page knows

    def show(self) -> Said:
        """The numbers with their declarations, and the pictures."""
        if self.desk.bench is None:
            return Said({"knobs": []})
        self._told = None
        return self._pictures()

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
        """Today's control."""
        self.desk.take(self.desk.needed.before.start)
        return self._pictures()

    @act
    def add(self, asked: Asked) -> Said:
        """One more filter: at a frequency in Hz, or where the loop is likely to want it."""
        bench = self.desk.needed
        *_, now, _ = self._look(NOW, bench.by_hand, self.desk.values)
        T = bench.by_hand.points[0].sample_time
        made = begun_filter(asked.choice("kind", filter_kinds()), now.leading.margins, T, asked.number_or_none("at"))
        check_sampled(made, T)
        self.desk.exchange(with_filters(self.desk.control, (), (made,)))
        return self._pictures()

    @act
    def remove(self, asked: Asked) -> Said:
        """A filter less, by its place in the pack."""
        place = asked.number("place")
        if place != int(place):
            raise ParameterError(f"place must be a whole number, not {place!r}")
        self.desk.exchange(with_filters(self.desk.control, (int(place),), ()))
        return self._pictures()

    @act
    def keep(self, asked: Asked) -> Said:
        """Keep the control of now under a letter."""
        self.snapshots[asked.choice("letter", SNAPSHOTS)] = self.desk.held()
        return self._pictures()

    @act
    def take(self, asked: Asked) -> Said:
        """Go to the control that was kept."""
        letter = asked.choice("letter", SNAPSHOTS)
        if letter not in self.snapshots:
            raise ParameterError(f"nothing was kept as {letter} yet")
        self.desk.restore(self.snapshots[letter])
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
        found |= {letter: self._look(letter, kept.bench.by_hand, kept.values)
                  for letter, kept in sorted(self.snapshots.items())}  # fmt: skip
        found[NOW] = self._look(NOW, bench.by_hand, values)
        now = found[NOW][2]
        drawn = charts(
            {name: look for name, (*_, look, _) in found.items()},
            {name: run for name, (*_, run) in found.items() if run is not None},
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
        if self._told is not bench.by_hand:
            said |= {"knobs": self._knobs(), "kinds": filter_kinds()}
            self._told = bench.by_hand
        return Said(said, drawn)

    def _look(self, name: str, by_hand: ByHand, values: Values) -> tuple[ByHand, Values, Look, Run | None]:
        known = self._seen.get(name)
        if known is None or known[0] is not by_hand or known[1] != values:
            running = _BESIDE.submit(self._run, name, by_hand.control(values))
            look, run = by_hand.at(values), running.result()
            known = self._seen[name] = (by_hand, dict(values), look, run if look.stable else None)
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
