"""Laws on this axis at equal robustness: the trade-off, and a law that is chosen to be tuned on."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from feeddrive.comparison.compare import TODAY
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.machine import MachineFile
from feeddrive.language.errors import ParameterError
from feeddrive.loop.control import Control
from feeddrive.studio.desk import Desk, free_name
from feeddrive.studio.room import Asked, Room, Said, act
from feeddrive.studio.works import Shown, compared
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal, candidates
from feeddrive.workflow.compare import TAKEN, CompareRequest, taken


class Compare(Room):
    """The comparison of the laws."""

    name = "compare"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.begin()

    def begin(self) -> None:
        """Forget the comparison of another axis."""
        self.found: Shown | None = None
        self._asked: CompareRequest | None = None
        self._machine: MachineFile | None = None  # that was compared on
        self.left_out = set[str]()
        self._laws: tuple[tuple[Candidate, ...], tuple[Refusal, ...]] | None = None

    def show(self) -> Said:
        """Which laws there are, which are to be compared, and what the comparison came to."""
        bench = self.desk.bench
        if bench is None or bench.machine is None:
            return Said({"ready": False, "found": None})
        fit, refused = self._candidates()
        words: dict[str, Any] = {
            "ready": True,
            "always": PLAIN,
            "laws": [{"name": e.name, "wanted": e.name not in self.left_out, "remark": e.remark} for e in fit],
            "refused": [{"name": each.name, "reason": each.reason} for each in refused],
            "found": None,
        }
        if self.found is None:
            return Said(words)
        return Said({**words, "found": dict(self.found.words)}, self.found.charts)

    @act
    def choose(self, asked: Asked) -> None:
        """The laws that are wanted, by name; P-PI, with which all others are compared, is always there."""
        known = [each.name for each in self._candidates()[0]]
        wanted = asked.texts("laws")
        if any(":" in each for each in wanted):  # the page runs no code that somebody names
            raise ParameterError("a law of a module is compared by the command line alone: feeddrive compare --law")
        for each in wanted:
            if each not in known:
                raise ParameterError(f"law '{each:.60}' cannot be compared on this axis; there are: {', '.join(known)}")
        self.left_out = set(known) - {PLAIN, *wanted}

    @act
    def start(self, asked: Asked) -> None:
        """Tune and judge the laws that are chosen; those that are finished are kept for the next time."""
        bench = self.desk.needed
        bench.needed_loop()
        names = [each.name for each in self._candidates()[0]]
        wanted = tuple(each for each in names if each not in self.left_out)
        machine = self.desk.machine()
        request = CompareRequest(
            self.desk.machine_path(),
            axis=bench.axis,
            law=wanted if self.left_out else (),
            starts=int(asked.number("starts")),
            keep=self.desk.folder / "compared_laws",
        )

        def then(found: Shown) -> None:
            self.desk.did("compare", request)
            self.found, self._asked, self._machine = found, request, machine

        self.desk.start(self.name, "compare the laws", partial(compared, request), then)

    @act
    def take(self, asked: Asked) -> Said:
        """Go on with a law as it was tuned for the comparison."""
        name = asked.text("law")
        if self.found is None or name not in self.found.controls:
            raise ParameterError(f"the comparison has no law '{name:.60}'")
        control = self.found.controls[name]
        if name == TODAY or self._asked is None or self._machine is None:
            self.desk.take(control)
        else:
            self.desk.exchange(control, self._written(name, control, self._asked, self._machine))
        said = self.show()
        return Said({**said.words, "go": "tune"}, said.charts)

    def _written(self, name: str, control: Control, asked: CompareRequest, machine: MachineFile) -> Path:
        """The machine file that the comparison writes which takes this law; it is that which counts as done."""
        law = re.sub(r"\W+", "_", name).strip("_").lower() or "law"
        out = free_name(self.desk.folder / "compared", law)  # one that was taken before stays what it was
        axis = machine.named(asked.axis)
        with new_directory(out) as folder:
            (folder / TAKEN).write_text(taken(machine, axis, control), encoding="utf-8")
        request = replace(asked, take=name, out=out)
        if request not in [each.request for each in self.desk.done]:
            self.desk.said_again(asked, request, also=asked.take is not None)
            self._asked = request
        return out / TAKEN

    def _candidates(self) -> tuple[tuple[Candidate, ...], tuple[Refusal, ...]]:
        """Laws that can control the axis, and those that cannot."""
        if self._laws is None:
            self._laws = candidates(self.desk.needed.needed_loop())
        return self._laws
