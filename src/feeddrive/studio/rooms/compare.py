"""The Compare page: laws on this axis at equal robustness, their trade-off, and the selection of a law to tune."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from feeddrive import benchmark
from feeddrive.comparison.compare import TODAY
from feeddrive.evaluation.designs import Designs
from feeddrive.figures.of_loops import ROPE_SNAP
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.machine import MachineFile
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import DRAWN, unit_name
from feeddrive.language.text import resolve
from feeddrive.loop.box import AUTO, BOXES
from feeddrive.loop.control import Control
from feeddrive.studio.desk import Asked, Desk, Room, Said, act, free_name
from feeddrive.studio.jobs import Found
from feeddrive.studio.works import Shown, compared
from feeddrive.tuning.candidates import LIKELIEST, PLAIN, STANDING, Candidate, Refusal, candidates, likeliest
from feeddrive.workflow.compare import TAKEN, CompareRequest, taken

# designs of rules 2 of the benchmark for a ball screw with two encoders
_DESIGNS, _EXAMPLE = "rules_2/designs/stiffness_0_2_mass_0_2_dead_time_1sample", "screw_light"


@cache
def example() -> dict[str, Any]:
    """Return the rope-snap errors of the likeliest laws on an axis of the benchmark, from its stored designs."""
    stored = Designs(Path(benchmark.__file__).parent / _DESIGNS, _EXAMPLE, 2)
    designs = [(name, stored.design(name)) for name in (PLAIN, *STANDING[2][:3])]
    rows = [(name, design.figures[ROPE_SNAP.key]) for name, design in designs if design is not None]
    units = replace(DRAWN, typographic=True)
    return {
        "of": "light ball screw of the benchmark",
        "unit": resolve(unit_name(ROPE_SNAP.unit), units),
        "rows": [[name, value, resolve(ROPE_SNAP.bare(value), units)] for name, value in rows],
    }


class Compare(Room):
    """The page for the comparison of laws."""

    name = "compare"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.box = AUTO
        self.begin()

    def begin(self) -> None:
        """Discard the comparison of the previous axis."""
        self.shown: Shown | None = None
        self._partial = False  # rows are still to come, or never came
        self._asked: CompareRequest | None = None
        self._machine: MachineFile | None = None  # that was compared on
        self.wanted: tuple[str, ...] | None = None  # laws that a person chose; None: the likeliest
        self._begun: tuple[str, ...] = ()  # laws of the latest comparison, in the order in which they are finished
        self._laws: tuple[tuple[Candidate, ...], tuple[Refusal, ...]] | None = None

    def show(self) -> Said:
        """Return the available laws, the selected ones, and the result of the comparison."""
        bench = self.desk.bench
        if bench is None or bench.machine is None:
            return Said({"ready": False, "found": None, "example": example()})
        fit, refused = self._candidates()
        wanted = self._wanted()
        words: dict[str, Any] = {
            "ready": True,
            "always": PLAIN,
            "rule": LIKELIEST,
            "laws": [{"name": law.name, "wanted": law.name in wanted, "remark": law.remark} for law in fit],
            "likeliest": likeliest(bench.needed_loop(), fit),
            "box": self.box,
            "offered": list(BOXES),
            "over": bench.over(self.box).shown(replace(DRAWN, rotary=bench.rotary)),
            "refused": [{"name": refusal.name, "reason": refusal.reason} for refusal in refused],
            "found": None,
            "to_come": [],
        }
        if self.shown is None:
            return Said({**words, "example": example(), "to_come": self._begun if self._going else ()})
        finished = {law["name"] for law in self.shown.words["laws"]} if self._partial or not self._going else set[str]()
        words["to_come"] = [name for name in self._begun if name not in finished]
        return Said({**words, "found": dict(self.shown.words), "partial": self._partial}, self.shown.charts)

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
        self.wanted = tuple(law for law in known if law in {PLAIN, *wanted})

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
        if asked.yes("all"):
            self.wanted = tuple(names)
        wanted, first = self._wanted(), likeliest(bench.needed_loop(), self._candidates()[0])
        # those that are likely to be chosen are finished first
        order = (*(law for law in first if law in wanted), *(law for law in wanted if law not in first))
        # taken now: the control may be changed while the comparison runs
        machine = self.desk.machine()
        request = CompareRequest(
            self.desk.machine_path(),
            axis=bench.axis,
            law=wanted if len(wanted) < len(names) else (),
            box=self.box,
            starts=int(asked.number("starts")),
            keep=self.desk.folder / "compared_laws",
        )

        def met(report: Found) -> None:
            # a row more; the file of a law that is chosen now is written by the page, since no command has ended
            self.shown, self._asked, self._machine, self._partial = report.best, None, None, True

        def then(shown: Shown) -> None:
            self.desk.did("compare", request)
            self.shown, self._asked, self._machine, self._partial = shown, request, machine, False

        self.desk.start(self.name, f"compare {len(wanted)} laws", partial(compared, request, order), then, met)
        self._begun = order

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

    def _wanted(self) -> tuple[str, ...]:
        """Return the laws to compare: those that were chosen, or the likeliest."""
        if self.wanted is None:
            return likeliest(self.desk.needed.needed_loop(), self._candidates()[0])
        return self.wanted

    @property
    def _going(self) -> bool:
        """True while a comparison is running."""
        state = self.desk.job_state()
        return state is not None and state.going and state.room == self.name

    def _candidates(self) -> tuple[tuple[Candidate, ...], tuple[Refusal, ...]]:
        """Return the laws that can control the axis, and those that cannot, with reasons."""
        if self._laws is None:
            self._laws = candidates(self.desk.needed.needed_loop())
        return self._laws
