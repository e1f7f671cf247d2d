"""The Program page of the studio: a part program is planned, run on the machine, and corrected before it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.files.machine import BUNDLED
from feeddrive.files.toml_file import quoted
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import DRAWN, Quantity, count_of
from feeddrive.language.text import Text
from feeddrive.plot.part_program import enlargement
from feeddrive.studio.bench import bench_of
from feeddrive.studio.desk import Asked, Desk, Held, Room, Said, act, free_name
from feeddrive.studio.part_program import (
    CORRECTED,
    EXAMPLE,
    MOVES_TIP,
    NOW,
    TODAY,
    Stage,
    Way,
    bundled_programs,
    corrected,
    deviation_chart,
    example_path,
    planned,
    ran,
    read_text,
    tool_drawn,
)
from feeddrive.studio.rooms.export import law_lines, whole
from feeddrive.workflow.plan import PlanRequest
from feeddrive.workflow.run_job import RunRequest
from feeddrive.workflow.setpath import SetpathRequest

_PROGRAM = "a part program, beside its job"
_RULE = "equal setpoints, planned once; today's control and the one that was tuned on the page"
_FIRST = (EXAMPLE[1], "circle_diamond_square.ngc")  # of the bundled ones: short, and with something to see
_LINES = 20_000  # of a program that the page shows
_ERRORS = (("rms", "RMS"), ("largest", "largest"))
PLAN, RUN, CORRECT = "plan", "run", "correct"
_OF_TIP = (
    "This program moves the tip of the tool. A correction works on each axis along its own path: take a program of the "
    "axes X Y Z"
)


class Program(Room):
    """The page for part programs, of the linear axes or of the tip of the tool."""

    name = "program"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.begin()

    def begin(self) -> None:
        """Discard the results for the previous machine."""
        self.chosen = ""
        self.results: dict[Path, dict[str, tuple[Held, Stage]]] = {}  # by program, then by stage

    def show(self) -> Said:
        """Return the programs, and what is known of the chosen one."""
        names, name = self._names(), self._name()
        if not names:
            return self._empty()
        stages = self.results.get(self._path(name), {})
        latest = next(reversed(stages.values()), None)
        plan = stages[PLAN][1] if PLAN in stages else None
        ways = self._ways(stages)
        tip = self._moves_tip(name)
        words: dict[str, Any] = {
            "ready": True,
            "machine": self.desk.needed.title,
            "programs": names,
            "chosen": name,
            "source": _version(self._path(name)),
            "stages": list(stages),
            "next": self._next(stages, tip),
            "refused": _OF_TIP if tip else "",
            "tip": tip,
            "figures": [] if plan is None else _gauges(plan, ways, stages),
            "verdict": _verdict(plan, ways, stages),
            "found": None if latest is None else self.desk.said_of(latest[0], latest[1].words),
            "falls": [] if plan is None else list(plan.falls),
            "places": list(self._placed(stages)),
            "runs": list(ways),
            "heats": {way.name: 1e6 * max(way.largest for way in ways.values()) for way in ways.values()},
        }
        if plan is None:
            return Said(words)
        archives = [stages[key][1].words for key in (CORRECT, PLAN) if key in stages]
        size = float(plan.words["size"])
        largest = max((way.largest for way in ways.values()), default=0.0)
        words |= {
            "letters": plan.words["letters"],
            "cycle": plan.figures["cycle"],
            "tool": tool_drawn(size),
            "magnified": enlargement(size, largest),
            "archive": next((words["archive"] for words in archives if words["archive"]), ""),
        }
        charts = {name: chart for _, stage in stages.values() for name, chart in stage.charts.items()}
        if ways:
            bounds = (plan.figures["tip"], plan.figures["angle"]) if plan.figures["tip"] is not None else None
            charts["deviation"] = deviation_chart(list(ways.values()), bounds).shown(DRAWN)
        rows = {"plan": plan.plan} if plan.plan is not None else {}
        return Said(words, charts, {**rows, **{way.name: way.rows() for way in ways.values()}})

    def _empty(self) -> Said:
        """Return an example, for a page without a machine whose axes a program moves."""
        path = example_path()
        size = 1e-3 * float(np.max(np.ptp(path[2:5], axis=1)))
        words: dict[str, Any] = {
            "ready": False,
            "machine": EXAMPLE[0],
            "chosen": EXAMPLE[1],
            "source": "",
            "tip": True,
            "letters": "XYZAC",
            "cycle": float(path[0, -1]),
            "tool": tool_drawn(size),
            "found": None,
            "heats": {},
            **dict.fromkeys(("programs", "stages", "figures", "falls", "places", "runs"), ()),
            **dict.fromkeys(("next", "refused", "verdict"), ""),
        }
        return Said(words, rows={"plan": path})

    @act
    def choose(self, asked: Asked) -> None:
        """Choose a part program."""
        self.chosen = asked.choice("name", self._names())

    @act
    def text(self, asked: Asked) -> Said:
        """Return the lines of a part program, with the state of the page as it was."""
        name = asked.choice("name", self._names())
        path, answer = self._path(name), self.show()
        text = {"source": _version(path), "lines": read_text(path, _LINES)}
        return replace(answer, words={**answer.words, "text": text})

    @act
    def example(self, _: Asked) -> None:
        """Open a bundled five-axis machine, and plan its S curve."""
        self.desk.put(bench_of(EXAMPLE[0], "x"))
        self._plan(self._name())

    @act
    def plan(self, asked: Asked) -> None:
        """Plan the chosen part program within the limits of the machine."""
        self._plan(self._asked(asked))

    @act
    def run(self, asked: Asked) -> None:
        """Run the chosen part program on the machine, under today's control and the one of now."""
        name = self._asked(asked)
        self._need_plan(name)
        source = self._path(name)
        request = RunRequest(str(self._job(name)), out=free_name(self.desk.folder, "run"))
        held = self.desk.held()

        def then(stage: Stage) -> None:
            self.desk.did("run", request, held.control)
            self._put(source, RUN, held, stage)

        self.desk.start(self.name, f"run {name}", partial(ran, request), then)

    @act
    def correct(self, asked: Asked) -> None:
        """Correct the chosen part program by its plan: setpoints and force offsets, judged on a box of machines."""
        name = self._asked(asked)
        if self._moves_tip(name):
            raise ParameterError(f"{_OF_TIP}.")
        self._need_plan(name)
        job, source = self._job(name), self._path(name)
        request = SetpathRequest(
            str(job), law=NOW if self._changed else None, out=free_name(self.desk.folder, "setpath")
        )
        held = self.desk.held()

        def then(stage: Stage) -> None:
            self.desk.did("setpath", request, held.control)
            self._put(source, CORRECT, held, stage)

        self.desk.start(self.name, f"correct {name}", partial(corrected, request), then)

    def _plan(self, name: str) -> None:
        out, source = free_name(self.desk.folder, "plan"), self._path(name)
        # a copy in the folder of the page, which the commands of the recipe name
        part = self.desk.keep(Path(name).name, source.read_bytes(), _PROGRAM)
        request = PlanRequest(part, machine=whole(self.desk.needed.file), out=out)
        held = self.desk.held()

        def then(stage: Stage) -> None:
            self.desk.did("plan", request)
            # what ran belongs to the plan before
            self.results[source] = {}
            self._put(source, PLAN, held, stage)

        self.desk.start(self.name, f"plan {name}", partial(planned, request), then)

    def _asked(self, asked: Asked) -> str:
        """Return the program that a request names. Raises ParameterError without a machine, and while a job runs."""
        self.desk.needed.needed_loop()
        self.chosen = asked.choice("name", self._names())
        self.desk.check_free()
        return self.chosen

    def _need_plan(self, name: str) -> None:
        if PLAN not in self.results.get(self._path(name), {}):
            raise ParameterError(f"{name} is not planned yet: plan it first")

    def _names(self) -> list[str]:
        bench = self.desk.bench
        if bench is None or bench.machine is None:
            return []
        return [*bundled_programs(bench.machine), *self.desk.programs]

    def _name(self) -> str:
        """Return the chosen program: at first the latest that was imported, or a bundled one."""
        names = self._names()
        if self.chosen in names:
            return self.chosen
        brought = list(self.desk.programs)[-1:]
        return next((name for name in (*brought, *_FIRST, *names) if name in names), "")

    def _path(self, name: str) -> Path:
        return self.desk.programs.get(name) or BUNDLED / "programs" / name

    def _moves_tip(self, name: str) -> bool:
        if not name:
            return False
        with self._path(name).open(encoding="utf-8", errors="replace") as file:
            return bool(MOVES_TIP.search(file.read(1_000_000)))

    def _next(self, stages: Mapping[str, Any], tip: bool) -> str:
        """Return the stage that the main button of the page begins; empty if all are done."""
        wanted = (PLAN, RUN) if tip else (PLAN, RUN, CORRECT)
        return next((stage for stage in wanted if stage not in stages), "")

    def _ways(self, stages: Mapping[str, tuple[Held, Stage]]) -> dict[str, Way]:
        """Return the latest runs by name, today's first."""
        ways = {way.name: way for _, stage in stages.values() for way in stage.ways}
        return {name: ways[name] for name in (TODAY, NOW, CORRECTED) if name in ways}

    def _placed(self, stages: Mapping[str, tuple[Held, Stage]]) -> tuple[Mapping[str, Any], ...]:
        return next((stage.places for _, stage in reversed(list(stages.values())) if stage.places), ())

    @property
    def _changed(self) -> bool:
        """True if the control of now differs from that of the machine file."""
        return bool(law_lines(self.desk, NOW))

    def _job(self, name: str) -> Path:
        """Return a job that runs a part program under today's control and, if it differs, the one of now."""
        bench = self.desk.needed
        # a copy beside the job, which then names it without a folder
        part = self.desk.keep(Path(name).name, self._path(name).read_bytes(), _PROGRAM)
        text = [
            # names come from uploads: quoted, they cannot add keys to the job
            f"title = {quoted(f'{name} on {bench.title}')}",
            f"machine = {quoted(whole(bench.file))}",
            f"axis = {quoted(bench.axis)}",
            f"rule = {quoted(_RULE)}",
            "",
            "[program]",
            f"file = {quoted(part.name)}",
            "",
            *law_lines(self.desk, NOW),
        ]
        return self.desk.keep("job.toml", "\n".join(text).encode(), f"the job of {part.name}, which stands beside it")

    def _put(self, source: Path, stage: str, held: Held, result: Stage) -> None:
        """Store the latest result of a stage."""
        stages = self.results.setdefault(source, {})
        stages.pop(stage, None)
        stages[stage] = held, result


def _version(path: Path) -> str:
    """Return what tells a program from another one that was imported under its name."""
    status = path.stat()
    return f"{path.name} {status.st_size} {status.st_mtime_ns}"


def _gauge(key: str, title: str, quantity: Text | str, note: str = "", state: str = "free") -> dict[str, str]:
    """Return a figure of the strip: its value and unit, a line below it, and its state, which the page shows by shape.

    state  kept, broken, free (nothing to be kept), or open (not computed yet)
    """
    value, _, unit = (quantity.shown(DRAWN) if isinstance(quantity, Text) else quantity).partition(" ")
    return {"key": key, "title": title, "value": value, "unit": unit, "note": note, "state": state}


def _gauges(plan: Stage, ways: Mapping[str, Way], stages: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the figures of the strip: of the plan, then of the latest run over the one before."""
    figures = plan.figures
    cycle, lost = float(figures["cycle"]), float(figures["lost"])
    proven = not figures["violations"]
    feed = Text(f"at its feed {Quantity(cycle - lost, 's'):4 SI}").shown(DRAWN)
    part = Text(f"{Quantity(lost / cycle if cycle else 0.0, 'share'):2} of the cycle time").shown(DRAWN)
    gauges = [
        _gauge("cycle", "Cycle time", Text(f"{Quantity(cycle, 's'):4 SI}"), feed),
        _gauge("lost", "Lost against the feed", Text(f"{Quantity(lost, 's'):3 SI}"), part),
        _gauge(
            "limits",
            "Limits of all axes",
            "proven" if proven else count_of(int(figures["violations"]), "violation"),
            count_of(int(figures["stops"]), "stop"),
            "kept" if proven else "broken",
        ),
    ]
    if figures["tip"] is not None:
        bound = Text(f"tool within {Quantity(figures['angle'], 'rad'):2 deg} of its direction").shown(DRAWN)
        gauges.append(_gauge("tip", "Tip within, planned", Text(f"{Quantity(figures['tip'], 'm'):3}"), bound, "kept"))
    shown = list(ways.values())
    if not shown:
        return [*gauges, *(_gauge(key, f"Contour error, {title}", "–", "not run", "open") for key, title in _ERRORS)]
    last, before = shown[-1], shown[-2] if len(shown) > 1 else None

    def note(size: float | None) -> str:
        return "" if before is None or size is None else Text(f"{before.name} {Quantity(size, 'm'):3}").shown(DRAWN)

    rms = _gauge(
        "rms",
        f"Contour error, RMS, {last.name}",
        Text(f"{Quantity(last.rms, 'm'):3}"),
        note(before and before.rms) or Text(f"95 % within {Quantity(last.within, 'm'):3}").shown(DRAWN),
        _better(last.rms, before and before.rms),
    )
    place = "" if last.line is None else f"line {last.line}"
    largest = _gauge(
        "largest",
        f"Largest, {last.name}",
        Text(f"{Quantity(last.largest, 'm'):3}"),
        ", ".join(filter(None, (place, note(before and before.largest)))),
        _better(last.largest, before and before.largest),
    )
    gauges += [rms, largest]
    if last.direction_largest is not None:
        turned = Text(f"{Quantity(last.direction_largest, 'rad', form='3 urad', stays=True)}")
        gauges.append(_gauge("angle", "Tool off its direction", turned, "at most, behind the path"))
    if CORRECT in stages:
        stage = stages[CORRECT][1]
        worst = Text(f"{Quantity(float(stage.figures['worst']), 'm'):3}")
        plain = Text(f"before {Quantity(float(stage.figures['worst_plain']), 'm'):3}").shown(DRAWN)
        good = bool(stage.figures["accepted"])
        gauges.append(_gauge("worst", "RMS, worst machine of the box", worst, plain, "kept" if good else "broken"))
    return gauges


def _better(size: float, before: float | None) -> str:
    return "free" if before is None else "kept" if size <= before else "broken"


def _verdict(plan: Stage | None, ways: Mapping[str, Way], stages: Mapping[str, tuple[Held, Stage]]) -> str:
    """Return the sentence that says how it stands."""
    if plan is None:
        return ""
    if CORRECT in stages and not stages[CORRECT][1].figures.get("accepted"):
        return "Not corrected: it would make a machine of the box worse. The program runs as it is."
    shown = list(ways.values())
    if not shown:
        fall = plan.falls[0] if plan.falls else None
        why = "" if fall is None else f" Most time is lost at line {fall['line']}: {fall['said']}, {fall['text']}."
        held = "every limit is proven" if not plan.figures["violations"] else "limits are violated"
        return f"Planned, {held}.{why}"
    last = shown[-1]
    off = Text(f"{Quantity(last.largest, 'm'):3}").shown(DRAWN)
    where = "" if last.line is None else f", in line {last.line}"
    if len(shown) == 1:
        return f"The tool is at most {off} off its path{where}."
    before = shown[-2]
    ratio = Text(f"{Quantity(last.rms / before.rms if before.rms else 1.0, 'share'):3}").shown(DRAWN)
    return f"{last.name.capitalize()}: {ratio} of the RMS contour error of {before.name}; at most {off}{where}."
