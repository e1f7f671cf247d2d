"""The Commission page of the studio: a drive is taken from unknown to a proven loop, and each question is asked here.

Only the connection through which a commissioning was begun may answer its questions.  If it ends, because the tab was
closed or loaded again, the axis is stopped, as by a terminal that is closed.
"""

from __future__ import annotations

import inspect
import os
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from feeddrive.commissioning.record import FILE, read_commissioned
from feeddrive.export.targets import TARGETS
from feeddrive.figures.catalogue import goals, limitable
from feeddrive.files.machine import BUNDLED, read_machine
from feeddrive.language import units
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.studio.bench import bench_of
from feeddrive.studio.desk import Asked, Desk, Room, Said, act, free_name
from feeddrive.studio.works import Shown, commissioned, shown_report
from feeddrive.workflow.command import fields_of
from feeddrive.workflow.commission_report import commission_report
from feeddrive.workflow.commission_steps import AXIS, STEPS, CommissionRequest

_VIRTUAL, _DRIVE = "virtual", "drive"
_OWN = "the axis of this page"
_BRAKING = 20.0  # s in which a commissioning that is stopped may brake and put back what was in the drive
_RULERS = {"m": ("mm", "m", "in"), "rad": ("deg", "rad")}  # units in which a person measures, the usual one first
# the noise of the encoders is not known before the drive is
_LIMITS = {figure.limit.option: figure for figure in limitable() if figure.limit is not None and not figure.limit.noise}
_FIELDS = {field.name: field for field in fields_of(CommissionRequest)}


class Commission(Room):
    """The page for the commissioning of a drive, virtual or real."""

    name = "commission"
    lasting = ("request", "source")

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.request: CommissionRequest | None = None  # the one that runs, or the last
        self.source = ""  # its drive, by the name that the page shows
        self._page: object = None  # that began it
        self._read: tuple[tuple[int, int], Shown] | None = None  # of the record that was shown last
        desk.left.append(self._left)

    def show(self) -> Said:
        """Return the drives, the steps with their results, and the report of what was done so far."""
        found = self._found()
        done = {} if found is None else dict(found.result)
        words: dict[str, Any] = {
            "sources": [{"name": name, "kind": kind} for name, kind in self._sources().items()],
            "goals": list(goals()),
            "goal": _FIELDS["goal"].default,
            "targets": list(TARGETS),
            "steps": [{"name": name, "does": _does(work), "says": done.get(name, "")} for name, work in STEPS.items()],
            "going": self._going,
            "rulers": _RULERS,
            "source": self.source,
            "folder": "" if self.request is None else str(self.request.out),
            "line": "" if self.request is None else self.request.command_line("commission"),
            "found": None if found is None else found.words,
            "archive": "" if self.archive is None else self.archive.name,
            "machine": self._machine is not None,
            "hint": "Another drive: name its drive file with --commission when feeddrive studio is started.",
        }
        return Said(words, {} if found is None else found.charts)

    @act
    def start(self, asked: Asked) -> None:
        """Begin the commissioning of a drive, or go on with one that was interrupted."""
        self.desk.check_free()
        sources = self._sources()
        name = asked.choice("source", sources)
        virtual = sources[name] == _VIRTUAL
        yes = asked.yes("yes")
        if yes and not virtual:
            raise ParameterError(f"{name} may move something real: its questions are answered one by one")
        # the same drive goes on where it was
        out = self.request.out if self.request is not None and name == self.source else None
        if out is None or asked.yes("anew"):
            out = free_name(self.desk.folder, f"commission_{Path(name).stem}".replace(" ", "_"))
        limits: dict[str, Any] = {option: self.desk.limits.bound(figure) for option, figure in _LIMITS.items()}
        request = CommissionRequest(
            None if virtual else Path(name),
            virtual=self._machine_of(name) if virtual else None,
            goal=asked.choice("goal", goals()),
            target=asked.choice("target", TARGETS),
            yes=yes,
            out=out,
            **limits,
        )

        def then(_: None) -> None:
            self.desk.did("commission", request)

        work = partial(commissioned, request)
        self.desk.start(self.name, f"commission {name}", work, then, patience=_BRAKING)
        self.request, self.source, self._page = request, name, asked.page

    @act
    def answer(self, asked: Asked) -> None:
        """Answer the question that is open: yes or no, or a number with its unit; no number if it was not measured."""
        job = self.desk.job
        if job is None or not self._going:
            raise ParameterError("no commissioning is running on this page, so there is no question to answer")
        if asked.page is not self._page:
            raise ParameterError(
                "this commissioning was begun in another tab of the browser, and only that one answers: answer there, "
                "or stop it here"
            )
        number, question = round(asked.number("question")), job.state.question
        if question is None or question.expected is None:
            job.answer(number, asked.yes("yes"))
            return
        value = asked.number_or_none("value")
        if value is not None:
            unit = asked.choice("unit", _RULERS.get(question.unit, (question.unit,)))
            value = units.scaled(value, units.factor(unit, question.unit))
        job.answer(number, value)

    @act
    def open(self, _: Asked) -> Said:
        """Open the tuned machine file for further tuning."""
        if self._machine is None:
            raise ParameterError("there is no tuned machine file yet")
        self.desk.put(bench_of(self._machine, AXIS))
        answer = self.show()
        return Said({**answer.words, "go": "tune"}, answer.charts)

    @property
    def archive(self) -> Path | None:
        """The packed folder, once the commissioning has ended."""
        if self.request is None or self.request.out is None or self._going:
            return None
        path = self.request.out.with_name(f"{self.request.out.name}.zip")
        return path if path.is_file() else None

    @property
    def _going(self) -> bool:
        state = self.desk.job_state()
        return state is not None and state.going and state.room == self.name

    @property
    def _machine(self) -> Path | None:
        """The machine file of the step `tune`."""
        if self.request is None or self.request.out is None or self._going:
            return None
        path = self.request.out / f"{list(STEPS).index('tune') + 1}_tune" / "machine.toml"
        return path if path.is_file() else None

    def _left(self, page: object) -> None:
        """Stop the axis if the tab that began the commissioning has gone: nobody is there to answer or to watch."""
        if self._going and page is self._page:
            self.desk.cancel()

    def _sources(self) -> dict[str, str]:
        """Return the drives by name: those of the command line, and virtual ones of machines with one axis."""
        named = {str(path): _DRIVE for path in self.desk.drives}
        bench = self.desk.bench
        single = bench is not None and bench.machine is not None and len(bench.machine.loops) == 1
        return {**named, **({_OWN: _VIRTUAL} if single else {}), **dict.fromkeys(_bundled(), _VIRTUAL)}

    def _machine_of(self, name: str) -> str | Path:
        return self.desk.machine_path() if name == _OWN else name

    def _found(self) -> Shown | None:
        """Return the report of the record, as far as it goes; it is read anew only if it has changed."""
        if self.request is None or self.request.out is None:
            return None
        out = self.request.out
        try:
            status = os.stat(out / FILE)
            known = status.st_mtime_ns, status.st_size
            if self._read is None or self._read[0] != known:
                result = read_commissioned(out)
                shown = shown_report(commission_report(result, out), bad=bool(result.refusal))
                sections = [part for part in shown.words["sections"] if part["key"] != "steps"]
                done = {step.name: step.says for step in result.steps}
                # the steps stand in the list of the page
                self._read = known, replace(shown, words={**shown.words, "sections": sections}, result=done)
        except (OSError, FeeddriveError):
            # the first step has not ended yet, or its files are just being replaced: the last report stays
            return None if self._read is None else self._read[1]
        return self._read[1]


def _does(work: Any) -> str:
    """Return what a step will do: the first paragraph of its docstring."""
    return " ".join((inspect.getdoc(work) or "").partition("\n\n")[0].split())


@cache
def _bundled() -> list[str]:
    """Return the names of the bundled machines with one axis."""
    names = sorted(path.stem for path in (BUNDLED / "machines").glob("*.toml"))
    return [name for name in names if len(read_machine(name).loops) == 1]
