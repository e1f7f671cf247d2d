"""The Commission page of the studio: a drive is taken from unknown to a proven loop, and each question is asked here.

Only the connection through which a commissioning was begun may answer its questions.  If it ends, because the tab was
closed or loaded again, the axis is stopped, as by a terminal that is closed.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from feeddrive.commissioning.record import FILE, Step, read_commissioned
from feeddrive.export.targets import TARGETS
from feeddrive.figures.catalogue import goals, limitable
from feeddrive.files.machine import BUNDLED, read_machine
from feeddrive.language import units
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.quantity import DRAWN, Quantity
from feeddrive.language.text import Text
from feeddrive.studio.bench import bench_of
from feeddrive.studio.desk import Asked, Desk, Room, Said, act, free_name
from feeddrive.studio.jobs import DONE
from feeddrive.studio.works import Shown, commissioned, shown_report
from feeddrive.workflow.command import fields_of
from feeddrive.workflow.commission_report import commission_report
from feeddrive.workflow.commission_steps import AXIS, STEPS, STOPPED, CommissionRequest

if TYPE_CHECKING:
    from feeddrive.bus.live import LiveAxis

_VIRTUAL, _DRIVE = "virtual", "drive"
_OWN = "the axis of this page"
_BRAKING = 20.0  # s in which a commissioning that is stopped may brake and put back what was in the drive
_RULERS = {"m": ("mm", "m", "in"), "rad": ("deg", "rad")}  # units in which a person measures, the usual one first
# the noise of the encoders is not known before the drive is
_LIMITS = {figure.limit.option: figure for figure in limitable() if figure.limit is not None and not figure.limit.noise}
_FIELDS = {field.name: field for field in fields_of(CommissionRequest)}
TODO, RUNS, FOUND, REFUSED, UNDONE = "todo", "runs", "done", "refused", "undone"
_SAID = {TODO: "to do", RUNS: "runs", FOUND: "done", REFUSED: "refused", UNDONE: "stopped, drive put back"}
_FILES = "Nothing to undo: it writes files, and nothing in the drive changes"
_PUT_BACK = "What it writes into the drive is written back and read back, and the drive is switched off"


class _Step(NamedTuple):
    """What a person must know of a step before it runs: what moves, what is asked, how it is undone, its picture."""

    moves: str = ""
    asks: str = ""
    undone: str = _FILES
    picture: str = ""


_STEPS = {
    "listen": _Step(undone="Nothing to undo: nothing is written into the drive"),
    "small_move": _Step(
        "first nothing, while the drive holds the axis under its own limit of force; then slowly there and back",
        "Is the travel clear? By how much did it move?",
        _PUT_BACK,
    ),
    "start_law": _Step(),
    "friction_and_mass": _Step("strokes to and fro, slowly first", "Is the travel clear?", _PUT_BACK, "strokes"),
    "excitation": _Step(picture="strokes"),
    "responses": _Step("slowly, with a multisine on it", "Is the travel clear?", _PUT_BACK, "responses"),
    "model": _Step(picture="responses"),
    "tune": _Step(picture="responses"),
    "certificate": _Step(picture="responses"),
    "export": _Step(picture="responses"),
    "trial": _Step(
        "under the new control: slowly, to and fro, and again with a pulse of force; then under the one before",
        "Is the travel clear? Keep the new control?",
        "Without a yes to keep it the control before is put back; what was written into the drive is written back",
        "trial",
    ),
}
# figures of the steps, as `Quantity` reads them; the trial has a table of its own
_FIGURES = {
    "listened_noise": ("noise at standstill", "m"),
    "holding": ("holding force", "N"),
    "friction": ("friction", "N"),
    "resistance": ("largest resistance", "N"),
    "lag": ("following error over speed", "s"),
    "rough_mass": ("mass, roughly", "kg"),
    "length_factor": ("true length of a count", "1"),
    "mass": ("mass", "kg"),
    "mass_error": ("its error", "kg"),
    "coulomb": ("dry friction", "N"),
    "viscous": ("viscous friction", "N s/m"),
    "dead_time": ("dead time", "s"),
    "along_force": ("cogging force", "N"),
    "along_period": ("its period", "m"),
    "amplitude": ("largest force", "N"),
    "model_band": ("model holds up to", "Hz"),
    "gap": ("play", "m"),
}


class Commission(Room):
    """The page for the commissioning of a drive, virtual or real."""

    name = "commission"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.request: CommissionRequest | None = None  # the one that runs, or the last
        self.source = ""  # its drive, by the name that the page shows
        self.chosen = ""  # the drive that would be commissioned next
        self._limits: dict[str, list[dict[str, str]]] = {}  # what is told of the motions of a drive, by its name
        self._page: object = None  # that began it
        self._read: tuple[tuple[int, int], Shown] | None = None  # of the record that was shown last
        desk.left.append(self._left)

    def show(self) -> Said:
        """Return the drives, the steps with their results, and the report of what was done so far."""
        found = self._found()
        done: dict[str, Step] = {} if found is None else dict(found.result)
        words: dict[str, Any] = {
            "sources": [{"name": name, "kind": kind} for name, kind in self._sources().items()],
            "goals": list(goals()),
            "goal": _FIELDS["goal"].default,
            "targets": list(TARGETS),
            "steps": self._steps(done),
            "chosen": self._chosen,
            "safety": self._safety(),
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
    def choose(self, asked: Asked) -> None:
        """Choose a drive, whose limits are then shown."""
        self.chosen = asked.choice("source", self._sources())

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
        self.chosen = name

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
    def _chosen(self) -> str:
        sources = self._sources()
        return next((name for name in (self.chosen, self.source, *sources) if name in sources), "")

    def _steps(self, done: Mapping[str, Step]) -> list[dict[str, Any]]:
        """Return the steps with their state, what they will do, what they found, and how they are undone."""
        job = self.desk.job_state()
        mine = job is not None and job.room == self.name
        ended = mine and job is not None and not job.going and self.request is not None
        refusal = "" if self._read is None else self._read[1].words["refusal"]
        following = next((name for name in STEPS if name not in done), "")
        # a trial that is not kept is done, and refused
        refused = (following or list(STEPS)[-1]) if refusal and not self._going else ""
        steps = list[dict[str, Any]]()
        for name, work in STEPS.items():
            state = FOUND if name in done else TODO
            if name == following and self._going:
                state = RUNS
            elif name == refused:
                state = UNDONE if refusal == STOPPED else REFUSED
            elif name == following and ended and job is not None and job.state != DONE:
                state = UNDONE
            told, step = _STEPS[name], done.get(name)
            says = step.says if step is not None else refusal if state == REFUSED else ""
            steps.append(
                {
                    "name": name,
                    "title": name.replace("_", " "),
                    "state": state,
                    "word": _SAID[state],
                    "does": _does(work),
                    "moves": told.moves,
                    "asks": told.asks,
                    "undone": told.undone,
                    "picture": told.picture,
                    "says": says,
                    "figures": [] if step is None else self._figures(step),
                }
            )
        return steps

    def _figures(self, step: Step) -> list[list[str]]:
        units = replace(DRAWN, rotary=self._read is not None and self._read[1].words["rotary"])
        return [
            [title, Text(f"{Quantity(step.figures[key], unit):3}").shown(units)]
            for key, (title, unit) in _FIGURES.items()
            if key in step.figures
        ]

    def _safety(self) -> list[dict[str, str]]:
        """Return what moves, how far, how fast and how strongly, of the chosen drive; why it is not known, if it is."""
        name = self._chosen
        if not name:
            return []
        if name not in self._limits or name == _OWN:
            try:
                self._limits[name] = _told(self._axis_of(name))
            except FeeddriveError as error:
                return [{"title": "This drive cannot be moved", "value": str(error), "note": ""}]
        return self._limits[name]

    def _axis_of(self, name: str) -> LiveAxis:
        # imported on use: the first page must not wait for the drives
        from feeddrive.bus.live import virtual_bus_axis
        from feeddrive.workflow.commission import live_axis

        if name == _OWN:
            # today's control: that of the page would be written to a file, which is a step
            return virtual_bus_axis(self.desk.needed.needed_loop())
        virtual = self._sources()[name] == _VIRTUAL
        return live_axis(CommissionRequest(None if virtual else Path(name), virtual=name if virtual else None))

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
                done = {step.name: step for step in result.steps}
                # the steps stand in the list of the page
                words = {**shown.words, "sections": sections, "refusal": result.refusal, "rotary": result.rotary}
                self._read = known, replace(shown, words=words, result=done)
        except (OSError, FeeddriveError):
            # the first step has not ended yet, or its files are just being replaced: the last report stays
            return None if self._read is None else self._read[1]
        return self._read[1]


def _told(axis: LiveAxis) -> list[dict[str, str]]:
    """Return what a person must know before an axis moves."""
    limits, units = axis.limits, replace(DRAWN, rotary=axis.rotary)

    def cell(title: str, size: Quantity, note: str, spec: str = "3") -> dict[str, str]:
        return {"title": title, "value": Text(f"≤ {size:{spec}}").shown(units), "note": note}

    what = "nothing real" if axis.is_virtual else "the axis, for real"
    return [
        {"title": "Moves", "value": what, "note": "a simulated drive" if axis.is_virtual else axis.where},
        cell("How far", Quantity(limits.travel, "m"), "to both sides of where it stands", "3 mm"),
        cell("How fast", Quantity(limits.velocity, "m/s"), "it is stopped beyond that"),
        cell("How hard", Quantity(limits.force, "N"), "a tenth in the small move"),
        cell("Following error", Quantity(limits.following_error, "m"), "it is stopped beyond that", "3 mm"),
    ]


def _does(work: Any) -> str:
    """Return what a step will do: the first paragraph of its docstring."""
    return " ".join((inspect.getdoc(work) or "").partition("\n\n")[0].split())


@cache
def _bundled() -> list[str]:
    """Return the names of the bundled machines with one axis."""
    names = sorted(path.stem for path in (BUNDLED / "machines").glob("*.toml"))
    return [name for name in names if len(read_machine(name).loops) == 1]
