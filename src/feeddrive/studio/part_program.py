"""A part program for the page: its plan, its runs on the machine and its correction, as sentences, charts and numbers.

All of it runs in the process of a job.  What goes to the page is reduced there: a plan to `_POINTS` instants of its
path, a run to as many instants with its largest deviations.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.files.machine import BUNDLED, MachineFile, read_machine
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import DRAWN, Quantity
from feeddrive.language.text import Text
from feeddrive.path.kinematics import LINEAR
from feeddrive.plot.chart import Chart, Curve, Level, Panel
from feeddrive.plot.style import envelope
from feeddrive.studio.jobs import perform
from feeddrive.studio.pictures import NUMBERS
from feeddrive.studio.works import packed, shown

if TYPE_CHECKING:
    from feeddrive.machining.contour import ContourError, Worst
    from feeddrive.path.planned import Planned
    from feeddrive.workflow.command import Outcome
    from feeddrive.workflow.plan import PlanRequest
    from feeddrive.workflow.run_job import RunRequest
    from feeddrive.workflow.setpath import SetpathRequest

_POINTS = 4000  # of a path on the page: more than it has pixels across
_PLACES = 8  # worst places that are listed
_FALLS = 12  # falls of the feed that are listed
_TOOL, _SHANK = 0.012, 0.22  # of the same: radius and length of the tool as drawn, where no diameter is known
_SPAN = 1e-6  # m: a path is drawn at least this large
MOVES_TIP = re.compile(r"^\s*(?:N\d+\s*)?(?:G0\s*)?G43\.[45]|^\s*TRAORI", re.MULTILINE)
_WORD = re.compile(r"([XYZABC])\s*[-+#\[.\d]")
_ENTRY = re.compile(r"([A-Z])\s*([-+]?\d*\.?\d+)")
EXAMPLE = "trunnion_ac", "s_curve.ngc"
"""The machine and the part program of the example."""
_REMARK = re.compile(r"\([^)]*\)|;.*")
NOW, TODAY, CORRECTED = "now", "today", "corrected"
_OF = {TODAY: NUMBERS["today"], NOW: NUMBERS["now"], CORRECTED: NUMBERS["found"]}


@dataclass(frozen=True, eq=False)
class Way:
    """One run of a part program, reduced for the page.

    name       `TODAY`, `NOW` or `CORRECTED`
    rms, within, largest  contour error on the samples that count, m
    line       line of the largest one; None if it is not known
    direction_largest  largest angle of the tool to its direction, rad; None unless the program moves the tip
    time, size, direction  instants, s, with the contour error, m, and the angle of the tool, rad; NaN where a sample
               does not count
    foot, vector  nearest point of the path, and from there to the tool, m, shape (n, 3)
    """

    name: str
    rms: float
    within: float
    largest: float
    line: int | None
    direction_largest: float | None
    time: np.ndarray
    size: np.ndarray
    direction: np.ndarray
    foot: np.ndarray
    vector: np.ndarray

    def rows(self) -> np.ndarray:
        """Return what the page draws: time, foot (mm), deviation (um), and vector (um), shape (8, n)."""
        return np.vstack([self.time, 1e3 * self.foot.T, 1e6 * self.size, 1e6 * self.vector.T])


@dataclass(frozen=True, eq=False)
class Stage:
    """The result of planning, running or correcting a part program.

    words   report of the command, as `Shown.words`
    plan    of the plan alone: what the page draws; see `_path`
    figures figures of the plan by name, in SI
    ways    runs, of which the last one is the latest
    places  worst places of the program
    charts  charts by name
    falls   falls of the feed
    """

    words: Mapping[str, Any]
    charts: Mapping[str, Chart]
    plan: np.ndarray | None = None
    figures: Mapping[str, Any] = field(default_factory=dict[str, Any])
    ways: tuple[Way, ...] = ()
    places: tuple[Mapping[str, Any], ...] = ()
    falls: tuple[Mapping[str, Any], ...] = ()


def planned(request: PlanRequest, progress: Progress) -> Stage:
    """Plan a part program; return its path, the speed along it, and why it is slower than its feed."""
    from feeddrive.plot.part_program import plan_axes_chart, plan_feed_chart

    outcome = perform("plan", request, progress)
    progress.step("pictures")
    plan: Planned = outcome.result
    charts = {"feed": plan_feed_chart(plan), "axes": plan_axes_chart(plan)}
    falls = sorted(plan.loss.falls, key=lambda fall: -fall.lost)[:_FALLS]
    listed = tuple(
        {
            "line": fall.first,
            "time": fall.time + 0.5 * fall.duration,
            "text": Text(f"{Quantity(fall.lost, 's'):3 SI}").shown(DRAWN),
            "said": f"{fall.cause}{f' ({fall.limit})' if fall.limit else ''}",
        }
        for fall in falls
    )
    tip = plan.tip
    figures = {
        "cycle": plan.cycle_time,
        "lost": plan.loss.lost,
        "stops": plan.stop_count,
        "violations": plan.violations,
        "tip": None if tip is None else tip.deviation,
        "angle": None if tip is None else tip.angle,
        "kinematics": plan.kinematics is not None,
    }
    assert request.out is not None
    archive = packed(request.out).name
    words = {**shown(outcome, ()).words, "letters": plan.limits.letters, "size": _extent(plan), "archive": archive}
    return Stage(words, _drawn(charts, outcome), _path(plan), figures, falls=listed)


def _path(plan: Planned) -> np.ndarray:
    """Return a plan as rows of numbers, shape (9 + joints, n): time (s), line, point (mm), tool axis, part of the speed
    below the feed (%; NaN on a traverse), and the position of each axis (mm, deg).

    The point is the tip of the tool in the frame of the workpiece, or that of the linear axes.
    """
    course, n = plan.course, len(plan.course.time)
    axis = np.zeros((3, n))
    axis[2] = 1.0
    place = _points(plan)
    if plan.kinematics is not None:
        letters = plan.limits.letters
        rotary = [course.position[:, letters.index(letter)] for letter in plan.kinematics.rotary_letters]
        axis = np.stack([np.broadcast_to(part, n) for part in plan.kinematics.tool_axis(rotary)])
    with np.errstate(divide="ignore", invalid="ignore"):
        below = np.where(
            np.isfinite(course.feed) & (course.feed > 0.0), 100.0 * (1.0 - course.speed / course.feed), np.nan
        )
    joints = (course.position * [factor for factor, _ in plan.limits.shown]).T
    rows = np.vstack([course.time, course.line, 1e3 * place.T, axis, np.clip(below, 0.0, 100.0), joints])
    kept = np.unique(np.linspace(0, n - 1, min(n, _POINTS)).astype(int))
    return rows[:, kept]


def _points(plan: Planned) -> np.ndarray:
    """Return the points of the path, m, shape (n, 3)."""
    if plan.kinematics is not None:
        return plan.tips
    letters, position = plan.limits.letters, plan.course.position
    columns = [position[:, letters.index(a)] if a in letters else np.zeros(len(position)) for a in LINEAR]
    return np.column_stack(columns)


def _extent(plan: Planned) -> float:
    """Return the largest extent of the path at a feed, m."""
    points = _points(plan)
    at_feed = points[np.isfinite(plan.course.feed) & (plan.course.feed > 0.0)]
    return max(float(np.max(np.ptp(at_feed, axis=0), initial=0.0)) if len(at_feed) else 0.0, _SPAN)


@cache
def example_path() -> np.ndarray:
    """Return the bundled example as it is programmed, in the rows of `_path`: what the page shows without a machine."""
    kinematics = read_machine(EXAMPLE[0]).kinematics
    assert kinematics is not None
    at, feed, rows = dict.fromkeys("XYZAC", 0.0), 0.0, list[list[float]]()
    for number, text in enumerate((BUNDLED / "programs" / EXAMPLE[1]).read_text(encoding="utf-8").splitlines(), 1):
        words = [(letter, float(value)) for letter, value in _ENTRY.findall(_REMARK.sub("", text))]
        at |= {letter: value for letter, value in words if letter in at}
        feed = next((value for letter, value in words if letter == "F"), feed)
        if feed and any(letter in at for letter, _ in words):
            rows.append([number, *at.values()])
    line, x, y, z, a, c = np.array(rows).T
    length = np.append(0.0, np.cumsum(np.hypot(np.hypot(np.diff(x), np.diff(y)), np.diff(z))))
    axis = [np.broadcast_to(part, len(x)) for part in kinematics.tool_axis((np.radians(a), np.radians(c)))]
    return np.vstack([60.0 * length / feed, line, x, y, z, *axis, np.zeros(len(x)), x, y, z, a, c])


def tool_drawn(extent: float) -> dict[str, float]:
    """Return radius and length of the tool as it is drawn, mm, for a path of this extent, m."""
    return {"radius": 1e3 * _TOOL * extent, "length": 1e3 * _SHANK * extent}


def ran(request: RunRequest, progress: Progress) -> Stage:
    """Run a part program on the machine, under today's control and the one of now if they differ."""
    outcome = perform("run", request, progress)
    progress.step("pictures")
    rows = [row for row in outcome.result.rows if row.part is not None]
    names = (TODAY, NOW)[-len(rows) :]
    ways, runs = list[Way](), list[tuple[str, int, Any]]()
    for name, row in zip(names, rows, strict=True):
        assert row.part is not None
        tip = row.part.tip
        ways.append(_way(name, row.part.contour, None if tip is None else tip.direction))
        runs.append((name, _OF[name], row.part.contour))
    places, charts = _worst(runs, runs[-1][2], rows[-1].part.worst(_PLACES))
    return Stage(shown(outcome, ()).words, _drawn(charts, outcome), ways=tuple(ways), places=places)


def corrected(request: SetpathRequest, progress: Progress) -> Stage:
    """Correct a part program; return its run on the nominal machine without and with the correction."""
    outcome = perform("setpath", request, progress)
    progress.step("pictures")
    result = outcome.result
    assert request.out is not None
    archive = packed(request.out).name if result.accepted else ""
    page = shown(outcome, ())
    words = {**page.words, "archive": archive, "worst_machine": result.worst.name}
    before, after = result.contours.get("plain"), result.contours.get("corrected")
    if before is None or after is None:
        return Stage(words, {})
    runs = [(NOW, _OF[NOW], before), (CORRECTED, _OF[CORRECTED], after)]
    apart = max(3e-3, 2e-3 * float(before.along[-1]))
    places, charts = _worst(runs, before, before.worst(_PLACES, apart=apart))
    figures = {"worst": result.worst.corrected.rms, "worst_plain": result.worst.plain.rms, "accepted": result.accepted}
    ways = (_way(NOW, before), _way(CORRECTED, after))
    return Stage(words, _drawn(charts, outcome), figures=figures, ways=ways, places=places)


def _way(name: str, contour: ContourError, direction: np.ndarray | None = None) -> Way:
    """Return a run reduced to the instants that the page draws, its largest deviations among them."""
    counted, error = contour.counted, np.abs(contour.error)
    size = np.where(counted, error, 0.0)
    kept = envelope(np.arange(len(size), dtype=np.float64), size, _POINTS)[0].astype(np.intp)
    worst = int(np.argmax(size))
    foot, vector = (contour.position - contour.vector)[kept], contour.vector[kept]
    seen = counted[kept]
    angle = np.full(len(size), np.nan) if direction is None else direction
    return Way(
        name,
        contour.rms,
        contour.within(),
        contour.largest,
        None if contour.line is None else int(contour.line[worst]),
        None if direction is None else float(np.max(np.abs(direction[counted]), initial=0.0)),
        contour.time[kept],
        np.where(seen, error[kept], np.nan),
        np.where(seen, np.abs(angle[kept]), np.nan),
        _in_space(foot, contour.axes),
        _in_space(vector, contour.axes),
    )


def _in_space(points: np.ndarray, axes: Sequence[str]) -> np.ndarray:
    """Return points of some axes with three coordinates, 0 along X, Y or Z where no axis moves."""
    space = np.zeros((len(points), 3))
    for column, name in enumerate(axes):
        if name.upper() in LINEAR:
            space[:, LINEAR.index(name.upper())] = points[:, column]
    return space


def _worst(
    runs: Sequence[tuple[str, int, ContourError]], of: ContourError, places: Sequence[Worst]
) -> tuple[tuple[Mapping[str, Any], ...], dict[str, Chart]]:
    """Return worst places of one run as the page lists them, with all runs there, and the close-up of each."""
    from feeddrive.plot.part_program import place_chart

    listed, charts = list[Mapping[str, Any]](), dict[str, Chart]()
    for i, place in enumerate(places):
        charts[f"place_{i}"] = place_chart(of, place, runs)
        row = int(np.argmin(np.abs(of.time - place.time)))
        sizes = [
            Text(f"{Quantity(float(np.abs(run.error[min(row, len(run.error) - 1)])), 'm'):3}").shown(DRAWN)
            for _, _, run in runs
        ]
        listed.append({"line": place.line or 0, "time": place.time, "text": sizes[-1], "said": sizes})
    return tuple(listed), charts


def deviation_chart(ways: Sequence[Way], bounds: tuple[float, float] | None) -> Chart:
    """Plot the deviation of runs versus time and, of a program of the tip, the angle of the tool.

    bounds  what is proven of the plan: distance of its tip from the program, m, and angle of its tool, rad
    """
    curves = tuple(
        Curve(way.time, 1e6 * way.size, way.name, _OF[way.name], caption=Text(f"{Quantity(way.rms, 'm')} RMS"))
        for way in ways
    )
    label, levels, caption = "deviation (µm)", (), ""
    if bounds is not None:
        label, levels = "tip (µm)", (Level(1e6 * bounds[0], dashed=True),)
        caption = Text(f"dashed: the plan off the program, proven ≤ {Quantity(bounds[0], 'm'):3}")
    panels = [Panel(label, curves, levels=levels, low=0.0, caption=caption)]
    turned = [way for way in ways if way.direction_largest is not None]
    if bounds is not None and turned:
        curves = tuple(Curve(way.time, 1e6 * way.direction, "", _OF[way.name]) for way in turned)
        proven = Quantity(bounds[1], "rad", form="3 urad", stays=True)
        caption = Text(f"dashed: the plan, proven ≤ {proven}")
        levels = (Level(1e6 * bounds[1], dashed=True),)
        most = 1e6 * max(bounds[1], *(way.direction_largest or 0.0 for way in turned))
        panels.append(Panel("tool angle (µrad)", curves, levels=levels, low=0.0, high=1.08 * most, caption=caption))
    return Chart("time (s)", tuple(panels))


def _drawn(charts: Mapping[str, Chart], outcome: Outcome[Any]) -> dict[str, Chart]:
    units = replace(outcome.units, typographic=True)
    return {name: chart.shown(units) for name, chart in charts.items()}


def letters_of(text: str) -> set[str]:
    """Return the letters of the axes that a part program names."""
    return set(_WORD.findall(_REMARK.sub("", text)))


def bundled_programs(machine: MachineFile | None) -> list[str]:
    """Return the bundled part programs for a machine: it must have their axes, and kinematics to move the tip.

    For a machine with kinematics those that move the tip come first.
    """
    found = list[tuple[bool, str]]()
    five = machine is not None and machine.kinematics is not None
    axes = None if machine is None else {name.upper() for name in machine.loops}
    for path in sorted((BUNDLED / "programs").glob("*.ngc")):
        text = path.read_text(encoding="utf-8")
        tip = bool(MOVES_TIP.search(text))
        if (five or not tip) and (axes is None or letters_of(text) <= axes):
            found.append((not tip, path.name))
    return [name for _, name in sorted(found)]


def read_text(path: Path, most: int) -> list[str]:
    """Return the lines of a part program, at most `most`."""
    with path.open(encoding="utf-8", errors="replace") as file:
        return [line.rstrip("\r\n") for _, line in zip(range(most), file, strict=False)]
