"""The Compare page: laws on this axis at equal robustness, their trade-off, and the selection of a law to tune."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from feeddrive.comparison.compare import TODAY
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.machine import MachineFile, read_machine
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import DRAWN
from feeddrive.loop.box import AUTO, BOXES
from feeddrive.loop.control import Control
from feeddrive.studio.desk import Asked, Desk, Room, Said, act, free_name
from feeddrive.studio.works import Shown, compared
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal, candidates
from feeddrive.workflow.compare import TAKEN, CompareRequest, taken


class Compare(Room):
    """The page for the comparison of laws."""

    name = "compare"
    lasting = ("box",)
    of_source = ("left_out", "shown", "_asked")

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.box = AUTO
        self.begin()

    def begin(self) -> None:
        """Discard the comparison of the previous axis."""
        self.shown: Shown | None = None
        self._asked: CompareRequest | None = None
        self._machine: MachineFile | None = None  # that was compared on
        self.left_out = set[str]()
        self._laws: tuple[tuple[Candidate, ...], tuple[Refusal, ...]] | None = None

    def show(self) -> Said:
        """Return the available laws, the selected ones, and the result of the comparison."""
        bench = self.desk.bench
        if bench is None or bench.machine is None:
            return Said({"ready": False, "found": None})
        fit, refused = self._candidates()
        words: dict[str, Any] = {
            "ready": True,
            "always": PLAIN,
            "laws": [{"name": e.name, "wanted": e.name not in self.left_out, "remark": e.remark} for e in fit],
            "box": self.box,
            "offered": list(BOXES),
            "over": bench.over(self.box).shown(replace(DRAWN, rotary=bench.rotary)),
            "refused": [{"name": refusal.name, "reason": refusal.reason} for refusal in refused],
            "found": None,
        }
        if self.shown is None:
            return Said(words)
        return Said({**words, "found": dict(self.shown.words)}, self.shown.charts)

    def resume(self, kept: Mapping[str, Any]) -> None:
        """Take up the choice of laws and the result."""
        super().resume(kept)
        self.left_out = set(self.left_out)
        if self._asked is not None:
            # the recipe finds its step by identity
            steps = [step.request for step in self.desk.done if step.request == self._asked]
            self._asked = steps[-1] if steps and isinstance(steps[-1], CompareRequest) else None
        if self._asked is not None:
            self._machine = read_machine(self._asked.machine)

    @act
    def choose(self, asked: Asked) -> None:
        """Select laws by name. P-PI, the reference of the comparison, is always included."""
        known = [candidate.name for candidate in self._candidates()[0]]
        wanted = asked.texts("laws")
        # the page never runs code that a request names
        if any(":" in wanted_law for wanted_law in wanted):
            raise ParameterError("a law of a module is compared by the command line alone: feeddrive compare --law")
        for wanted_law in wanted:
            if wanted_law not in known:
                raise ParameterError(
                    f"law '{wanted_law:.60}' cannot be compared on this axis; there are: {', '.join(known)}"
                )
        self.left_out = set(known) - {PLAIN, *wanted}

    @act
    def over(self, asked: Asked) -> None:
        """Set the box of plants over which the rule holds, as the option --box states it; empty: the default."""
        box = asked.text("box").strip() or AUTO
        self.desk.needed.over(box)
        self.box = box

    @act
    def start(self, asked: Asked) -> None:
        """Tune and evaluate the selected laws. Completed ones are reused in the next comparison."""
        bench = self.desk.needed
        bench.needed_loop()
        names = [candidate.name for candidate in self._candidates()[0]]
        wanted = tuple(law for law in names if law not in self.left_out)
        # taken now: the control may be changed while the comparison runs
        machine = self.desk.machine()
        request = CompareRequest(
            self.desk.machine_path(),
            axis=bench.axis,
            law=wanted if self.left_out else (),
            box=self.box,
            starts=int(asked.number("starts")),
            keep=self.desk.folder / "compared_laws",
        )

        def then(shown: Shown) -> None:
            self.desk.did("compare", request)
            self.shown, self._asked, self._machine = shown, request, machine

        self.desk.start(self.name, "compare the laws", partial(compared, request), then)

    @act
    def take(self, asked: Asked) -> Said:
        """Make the controller of a law, as tuned for the comparison, the current one."""
        name = asked.text("law")
        if self.shown is None or name not in self.shown.controls:
            raise ParameterError(f"the comparison has no law '{name:.60}'")
        control = self.shown.controls[name]
        # today's control needs no new file: that of the source holds it
        if name == TODAY or self._asked is None or self._machine is None:
            self.desk.take(control)
        else:
            self.desk.exchange(control, self._written(name, control, self._asked, self._machine))
        answer = self.show()
        return Said({**answer.words, "go": "tune"}, answer.charts)

    def _written(self, name: str, control: Control, asked: CompareRequest, machine: MachineFile) -> Path:
        """Write the machine file with one of the compared laws, and record a request that writes the same file."""
        law = re.sub(r"\W+", "_", name).strip("_").lower() or "law"
        # a law that was taken before keeps its file, to which an undo may return
        out = free_name(self.desk.folder / "compared", law)
        axis = machine.named(asked.axis)
        with new_directory(out) as folder:
            (folder / TAKEN).write_text(taken(machine, axis, control), encoding="utf-8")
        request = replace(asked, take=name, out=out)
        if request not in [step.request for step in self.desk.done]:
            self.desk.said_again(asked, request, also=asked.take is not None)
            self._asked = request
        return out / TAKEN

    def _candidates(self) -> tuple[tuple[Candidate, ...], tuple[Refusal, ...]]:
        """Return the laws that can control the axis, and those that cannot, with reasons."""
        if self._laws is None:
            self._laws = candidates(self.desk.needed.needed_loop())
        return self._laws
