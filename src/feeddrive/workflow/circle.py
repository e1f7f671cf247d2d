"""`feeddrive circle`: a circular test, evaluated from measured circles or simulated on a machine.

report.html    the circle plot, unrolled circles, ranked causes
circle.json    every figure in SI units
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.blocks.reference.circle import Circle
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.columns import Column
from feeddrive.files.machine import MachineFile, read_machine
from feeddrive.files.read_log import OpenedFile, read_log
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text, capitalized
from feeddrive.loop.simulate import simulate
from feeddrive.machining.circle_test import (
    Cause,
    CircleCauses,
    CirclePath,
    CircleTest,
    circle_causes,
    circle_of_run,
    circle_path,
    circle_test,
    peaks_table,
    quadrant_peaks,
)
from feeddrive.report.machining_report import circle_report
from feeddrive.report.page import html
from feeddrive.report.report import Report
from feeddrive.workflow.command import OUT, Outcome, Request, argument, command, line, option

# a whole turn at constant feed must remain between run-in and run-out, which use parts of the first and last turn
_TURNS = 2.2
# two feeds: the lag grows with the square of the feed, scale and squareness do not depend on it
_RADIUS, _FEEDS = 0.02, (0.02, 0.1)  # m, m/s, of a simulated machine


class CircleRequest(Request):
    """The circles to evaluate, the roles of their columns, and known data of the machine."""

    sources: tuple[Path, ...] = argument(
        "Logs of one circle each (MAT, CSV, Parquet), best in both directions at two feeds; or one machine file "
        "(TOML), or the name of a bundled machine, which then runs the circles"
    )
    x: str = option("column of the first axis, as x:mm; for a machine the name of the axis", default="x")
    y: str = option("column of the second axis; for a machine the name of the axis", default="y")
    time: str | None = option("column of the time, name:unit", default=None)
    sample_time: float | None = option("sample time of logs without a clock", unit="s", default=None, above=0.0)
    encoders: bool = option("the columns are readings of encoders, which do not see the tool", default=False)
    radius: float | None = option(
        "nominal radius; if left out, that of the fit to 0.1 mm for a log, 20 mm for a machine",
        unit="m",
        entered="mm",
        default=None,
        above=0.0,
    )
    feed: tuple[float, ...] = option(
        "feed of the circles of a machine; may be repeated", unit="m/s", entered="mm/min", default=(), above=0.0
    )
    pitch_x: float | None = option(
        "pitch of the screw of x, to look for its error", unit="m", entered="mm", default=None, above=0.0
    )
    pitch_y: float | None = option("pitch of the screw of y", unit="m", entered="mm", default=None, above=0.0)
    note: str = option("a line for the circle plot: date, place, compensation on or off", default="")
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"circle_{self.sources[0].stem}"


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredCircle(Result):
    """The figures of a circular test, and the causes of its path deviations."""

    test: CircleTest
    causes: CircleCauses

    def table(self) -> Table:
        return self.test.table()


def measured_circle_report(measured: MeasuredCircle, note: str = "") -> Report:
    """Return the report of a circular test; `note` is a line for the circle plot."""
    return circle_report(measured.test, measured.causes, note)


@command(CircleRequest)
def circle(request: CircleRequest, progress: Progress) -> Outcome[MeasuredCircle]:
    """Evaluate a circular test to ISO 230-4, measured (logs of x and y) or simulated, and separate the error causes.

    Raises LogError for a log without a full circle at constant feed, and ParameterError for incompatible circles.
    """
    machine = _machine(request.sources)
    if machine is None:
        circles = [_measured(path, request) for path in _reported(request.sources, progress)]
    else:
        circles = _simulated(machine, request, progress)
    test = circle_test(circles)
    pitch = {
        axis: value
        for axis, value in zip(circles[0].axes, (request.pitch_x, request.pitch_y), strict=True)
        if value is not None
    }
    progress.step("causes")
    measured = MeasuredCircle(test, circle_causes(circles, pitch=pitch))
    files: dict[str, Path] = {}
    if request.out is not None:
        with new_directory(request.out) as folder:
            (folder / "report.html").write_text(html(measured_circle_report(measured, request.note)), encoding="utf-8")
            (folder / "circle.json").write_text(json.dumps(_summary(measured), indent=1) + "\n", encoding="utf-8")
        files = {"Report": request.out / "report.html", "Figures": request.out / "circle.json"}
    tables = [test.table(), peaks_table(test), measured.causes.table()]
    return Outcome(
        measured,
        tables,
        _remarks(measured),
        files=files,
        page=partial(measured_circle_report, measured, request.note),
        then="" if machine is None else _tuning(request.sources[0], test),
    )


def _tuning(machine: Path, test: CircleTest) -> str:
    """Return the command that tunes the axis with the largest peak after a reversal; empty if there are no peaks."""
    peaks = quadrant_peaks(test)
    return line("tune", machine, axis=max(peaks, key=lambda peak: abs(peak.height)).axis) if peaks else ""


def _reported(paths: tuple[Path, ...], progress: Progress) -> Iterator[Path]:
    """Yield the paths, reporting progress for each."""
    for path in paths:
        progress.step(f"reading {path.name}")
        yield path


def _machine(sources: tuple[Path, ...]) -> MachineFile | None:
    """Return the machine if the source is one; None for logs. Raise ParameterError for a machine with other sources."""
    first = sources[0]
    # a bundled machine is a bare name; a file without a suffix that exists is a log
    is_machine = first.suffix.lower() == ".toml" or (not first.suffix and not first.is_file())
    if not is_machine:
        return None
    if len(sources) > 1:
        raise ParameterError(f"{first} is a machine: give it alone, or logs")
    return read_machine(first)


def _measured(path: Path, request: CircleRequest) -> CirclePath:
    """Read a measured circle from a log."""
    file = OpenedFile(path)
    # read each in turn as the position of a table: that role has the unit of a length
    kept = {} if request.time is None else {"time": Column.of(request.time)}
    logs = [
        read_log(file, {"position_load": Column.of(text), **kept}, sample_time=request.sample_time)
        for text in (request.x, request.y)
    ]
    names = tuple(Column.of(text).name for text in (request.x, request.y))
    return circle_path(
        logs[0]["position_load"],
        logs[1]["position_load"],
        time=logs[0].time,
        radius=request.radius,
        axes=(names[0], names[1]),
        source="encoder" if request.encoders else "tool",
        name=path.name,
    )


def _simulated(file: MachineFile, request: CircleRequest, progress: Progress) -> list[CirclePath]:
    """Simulate circles in both directions at all feeds, centered in the travel range if it is stated."""
    machine = file.machine()
    axes = (request.x, request.y)
    for name in axes:
        if name not in machine.loops():
            raise ParameterError(f"the machine has no axis '{name}'; it has {', '.join(machine.loops())}: --x, --y")
        if machine.loops()[name].axis.rotary:
            raise ParameterError(f"axis '{name}' turns: a circular test needs two straight axes, --x and --y")
    radius = _RADIUS if request.radius is None else request.radius
    feeds = request.feed or _FEEDS
    center = tuple(_middle(file, name, radius) for name in axes)
    circles: list[CirclePath] = []
    signal = "reading_load" if request.encoders else "tool"
    for feed in feeds:
        for direction in ("counterclockwise", "clockwise"):
            progress.step(Text(f"{direction} at {Quantity(feed, 'm/s'):mm/min}"))
            motion = {
                name: Circle(
                    radius=radius,
                    feed=feed,
                    turns=_TURNS,
                    phase=phase,
                    direction=direction,
                    center=at,
                    # at most half a turn, so that a full turn at constant feed is left also at a high feed
                    run_up_time=min(0.3, np.pi * radius / feed),  # s
                )
                for name, phase, at in zip(axes, (0, 90), center, strict=True)
            }
            # a machine runs only with a reference for each axis: those outside of the plane stand still
            still = {
                name: Recorded(position=np.zeros(2), sample_time=float(loop.sample_time))
                for name, loop in machine.loops().items()
                if name not in axes
            }
            ends = next(iter(motion.values())).duration
            run = simulate(machine, {**motion, **still}, duration=ends, name=file.name)
            slower = f"at {Quantity(feed, 'm/s'):mm/min} the axes settle too late: give a lower --feed"
            circles.append(
                circle_of_run(run, axes, radius=radius, center=(center[0], center[1]), signal=signal, remedy=slower)
            )
    return circles


def _middle(file: MachineFile, name: str, radius: float) -> float:
    """Return the center of an axis's travel range in m, or 0 if the range is unknown.

    Raises ParameterError if the range is too short for the circle.
    """
    limits = file.limits.get(name)
    if limits is None or limits.travel_least is None or limits.travel_most is None:
        return 0.0
    least, most = float(limits.travel_least), float(limits.travel_most)
    if most - least < 2.0 * radius:
        raise ParameterError(
            f"radius = {Quantity(radius, 'm'):6 mm}: axis '{name}' travels {Quantity((most - least), 'm'):6 mm}, a "
            f"circle needs {Quantity(2.0 * radius, 'm'):6 mm}: give a smaller --radius"
        )
    return 0.5 * (least + most)


def _remarks(measured: MeasuredCircle) -> list[str]:
    first = measured.test.circles[0]
    remarks = [] if first.source == "tool" else ["Readings of encoders do not see what lies between them and the tool."]
    there = {path.direction for path in measured.test.circles}
    if len(there) == 1:
        remarks.append("One direction only: G(b) and D of both directions need the other one.")
    notes = list(dict.fromkeys(cause.note for cause in measured.causes.causes if cause.note))
    return [*remarks, *(capitalized(f"{note}.") for note in notes)]


def _summary(measured: MeasuredCircle) -> dict[str, Any]:
    """Return all figures in SI for JSON; the value of a cause that cannot be separated is null."""
    first = measured.test.circles[0]
    return {
        "radius_m": measured.test.radius,
        "plane": "".join(first.axes),
        "source": first.source,
        "center_of_F": measured.test.about,
        "figures": [
            {
                "name": figure.name,
                "both_directions": figure.both,
                "G_m": figure.G,
                "F_max_m": figure.F_max,
                "F_min_m": figure.F_min,
                "D_m": figure.D,
                "center_m": figure.center.tolist(),
            }
            for figure in measured.test.figures
        ],
        "quadrant_peaks": [
            {
                "circle": measured.test.circles[peak.circle].name,
                "axis": peak.axis,
                "side": peak.side,
                "angle_rad": peak.angle,
                "deviation_m": peak.deviation,
                "height_m": peak.height,
            }
            for peak in quadrant_peaks(measured.test)
        ],
        "causes": [
            {
                "name": cause.name,
                "value": _known(cause.value, cause),
                "standard_error": _known(cause.error, cause),
                "unit": cause.unit,
                "draws_m": cause.effect,
                "note": cause.note,
            }
            for cause in measured.causes.causes
        ],
        "not_explained_rms_m": measured.causes.residual,
    }


def _known(value: float, cause: Cause) -> float | None:
    # a cause that the circles cannot separate has an infinite error, for which JSON has no number
    return value if np.isfinite(cause.error) else None
