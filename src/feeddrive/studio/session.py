"""One page that is open: the values that its person has moved, what can be undone, and what was kept to compare."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.table import shown
from feeddrive.loop.simulate import Run
from feeddrive.studio.bench import Bench
from feeddrive.studio.pictures import charts
from feeddrive.studio.wire import message
from feeddrive.tuning.by_hand import Look

TODAY, NOW = "today", "now"
SNAPSHOTS = ("A", "B", "C")
_UNDONE = 200  # steps that are kept

Values = dict[str, float]


class Session:
    """The state of one page. It is not shared: what one page moves, no other one sees."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.values: Values = bench.by_hand.values
        self.snapshots: dict[str, Values] = {}
        self._past: list[Values] = []
        self._future: list[Values] = []
        self._begins = True  # whether the next change is a step of its own, and not one more of a drag
        self._seen: dict[str, tuple[Values, Look, Run | None]] = {}

    def answer(self, asked: Mapping[str, Any]) -> bytes:
        """The message that a request of the page gets: state and pictures, or what is wrong with the request."""
        given = asked.get("number")
        number = given if isinstance(given, int) else 0
        try:
            said = self._done(asked)
        except FeeddriveError as error:
            return message({"number": number, "error": str(error), **self._state()})
        if said is not None:
            return message({"number": number, **said})
        return self._pictures(number)

    def _done(self, asked: Mapping[str, Any]) -> dict[str, Any] | None:
        """Do what is asked; a message without pictures if there is one."""
        acts: dict[str, Callable[[Mapping[str, Any]], dict[str, Any] | None]] = {
            "show": lambda _: None, "move": self._move, "undo": lambda _: self._back(self._past, self._future),
            "redo": lambda _: self._back(self._future, self._past), "reset": self._reset, "keep": self._keep,
            "take": self._take, "drop": self._drop, "file": self._file,
        }  # fmt: skip
        act = acts.get(str(asked.get("do")))
        if act is None:
            raise ParameterError(f"the page asks for '{asked.get('do')}', which is none of {', '.join(acts)}")
        return act(asked)

    def _move(self, asked: Mapping[str, Any]) -> None:
        """One number; `first` begins a drag, whose other moves are undone with it."""
        name, value = str(asked.get("name")), asked.get("value")
        if name not in self.values:
            raise ParameterError(f"the control has no number '{name}'")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ParameterError(f"{name} must be a number, not {value!r}")
        wanted = {**self.values, name: float(value)}
        self.bench.by_hand.control(wanted)
        self._change(wanted, begins=bool(asked.get("first", True)))

    def _change(self, wanted: Values, *, begins: bool = True) -> None:
        self._begins = self._begins or begins
        if wanted == self.values:
            return
        if self._begins:
            self._past = [*self._past, self.values][-_UNDONE:]
            self._future.clear()
        self.values, self._begins = wanted, False

    def _back(self, source: list[Values], other: list[Values]) -> None:
        if source:
            other.append(self.values)
            self.values, self._begins = source.pop(), True

    def _reset(self, _: Mapping[str, Any]) -> None:
        self._change(self.bench.by_hand.values)

    def _keep(self, asked: Mapping[str, Any]) -> None:
        self.snapshots[self._letter(asked)] = dict(self.values)

    def _take(self, asked: Mapping[str, Any]) -> None:
        letter = self._letter(asked)
        if letter not in self.snapshots:
            raise ParameterError(f"nothing was kept as {letter} yet")
        self._change(dict(self.snapshots[letter]))

    def _drop(self, asked: Mapping[str, Any]) -> None:
        self.snapshots.pop(self._letter(asked), None)

    def _file(self, _: Mapping[str, Any]) -> dict[str, Any]:
        return {"file": self.bench.text(self.values), "file_name": f"{self.bench.machine.file.name}"}

    @staticmethod
    def _letter(asked: Mapping[str, Any]) -> str:
        letter = str(asked.get("letter"))
        if letter not in SNAPSHOTS:
            raise ParameterError(f"a snapshot is one of {', '.join(SNAPSHOTS)}, not '{letter}'")
        return letter

    def _pictures(self, number: int) -> bytes:
        found = {TODAY: self._look(TODAY, self.bench.by_hand.values)}
        found |= {letter: self._look(letter, values) for letter, values in sorted(self.snapshots.items())}
        found[NOW] = self._look(NOW, self.values)
        _, now, _ = found[NOW]
        said = {"judged": [{"text": self._verdict(each), "keeps": each.keeps} for each in now.judged]}
        drawn = charts(
            {name: look for name, (_, look, _) in found.items()},
            {name: run for name, (_, _, run) in found.items() if run is not None},
        )
        return message({"number": number, **said, "stable": now.stable, **self._state()}, drawn)

    def _verdict(self, each: Any) -> str:
        return f"{each}, limit: {self.bench.by_hand.limits.only(each.kind)}"

    def _look(self, name: str, values: Values) -> tuple[Values, Look, Run | None]:
        known = self._seen.get(name)
        if known is None or known[0] != values:
            look, run = self.bench.by_hand.at(values), None
            if look.stable:
                try:
                    run = self.bench.run(values, name)
                except FeeddriveError:  # it leaves its bounds: what is linear of it is shown
                    run = None
            known = self._seen[name] = (dict(values), look, run)
        return known

    def _state(self) -> dict[str, Any]:
        return {
            "title": self.bench.title, "values": self.values, "undo": len(self._past), "redo": len(self._future),
            "kept": sorted(self.snapshots),
        }  # fmt: skip

    def knobs(self) -> list[dict[str, Any]]:
        """What the page shows of each number, in the units that people read."""
        found = list[dict[str, Any]]()
        for each in self.bench.by_hand.knobs:
            declared = each.declared.of_axis(self.bench.loop.axis.rotary)
            unit, factor = shown(declared.unit)
            dragged = each.declared.unit == "Hz" and each.name.startswith("filters.")
            found.append({
                "name": each.name, "block": each.block, "unit": unit, "factor": factor, "low": each.low,
                "high": each.high, "logarithmic": each.logarithmic, "meaning": declared.meaning, "today": each.value,
                "dragged": dragged,
            })  # fmt: skip
        return found
