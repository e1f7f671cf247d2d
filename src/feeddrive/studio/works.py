"""Long-running jobs of the page: each runs in its own process and returns the strings and pictures to show."""

from __future__ import annotations

import zipfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.figures.of_loops import ROPE_SNAP, SENSITIVITY_PEAK, STIFFNESS_AT, STIFFNESS_LEAST
from feeddrive.figures.of_runs import TRACKING_RMS
from feeddrive.language.errors import sentence
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import DRAWN, Quantity, Units
from feeddrive.language.table import drawn_in
from feeddrive.language.text import Text, resolve
from feeddrive.plot.chart import Chart
from feeddrive.studio.jobs import perform

if TYPE_CHECKING:
    from feeddrive.analysis.friction_map import FrictionMap
    from feeddrive.figures.figure import Figure
    from feeddrive.loop.control import Control
    from feeddrive.loop.loop import Loop
    from feeddrive.machining.circle_test import CircleTest
    from feeddrive.report.report import Report
    from feeddrive.studio.uploads import Understood
    from feeddrive.tuning.tune import Tuned
    from feeddrive.workflow.circle import CircleRequest
    from feeddrive.workflow.command import Outcome, Request
    from feeddrive.workflow.commission_steps import CommissionRequest
    from feeddrive.workflow.compare import CompareRequest
    from feeddrive.workflow.export import ExportRequest
    from feeddrive.workflow.tour import TourRequest
    from feeddrive.workflow.tune import TuneRequest

_OF_ROWS = (ROPE_SNAP, TRACKING_RMS, STIFFNESS_AT[0], SENSITIVITY_PEAK)  # figures in the row of a law
# numbers of finished laws after which rows are shown: each time all of them run once more, which takes seconds a law
_ROWS = (1, 2, 3, 4, 8, 16)
_PEAKS = 8  # quadrant peaks of circles that can be looked at
# degrees on both sides of a quadrant peak: its reversal is in view, and no other one
_TURN = 12.0


@dataclass(frozen=True)
class Shown:
    """The result of a job, as the page shows it.

    words     JSON data with the keys verdict, failure, bad, said, picture and sections
    charts    charts by name
    controls  controllers of a comparison, by name of the law
    files     written files by name
    friction  identified friction over velocity
    result    data for further charts
    """

    words: Mapping[str, Any]
    charts: Mapping[str, Chart] = field(default_factory=dict[str, Chart])
    controls: Mapping[str, Control] = field(default_factory=dict[str, "Control"])
    files: Mapping[str, Path] = field(default_factory=dict[str, Path])
    friction: FrictionMap | None = None
    result: Any = None


@dataclass(frozen=True)
class Tuning:
    """The controller of a search and, by picture, its loop at the plant of the box that is the worst there."""

    control: Control
    worst: Mapping[str, Loop]


def shown(outcome: Outcome[Any], drawn: Collection[str] | None = None) -> Shown:
    """Return the report of an outcome for the page: the same sections as in HTML, with the charts of its pictures.

    drawn  keys of the pictures to draw; None: all. The others are drawn by the tab itself or shown only in the report.

    Pictures that the page cannot draw are left out. The result of a failed outcome always contains a sentence on the
    failure.
    """
    report, failure = outcome.report(), outcome.failure
    if outcome.judgment.bad and not failure and not report.verdict.sentences:
        failure = sentence(outcome.judgment.says)
    # a general report, made from the outcome, already contains the notes
    notes = () if outcome.page is None else outcome.notes
    return shown_report(report, drawn, bad=outcome.judgment.bad, failure=failure, notes=notes)


def shown_report(
    report: Report,
    drawn: Collection[str] | None = None,
    *,
    bad: bool = False,
    failure: str = "",
    notes: Sequence[str] = (),
) -> Shown:
    """Return a report for the page; see `shown`.

    bad      True if its result must not be used, for the reason `failure`
    notes    what the page says beside the verdict
    """
    units = replace(DRAWN, rotary=report.rotary)
    with drawn_in(units):
        pictures = [picture for picture in report.pictures if drawn is None or picture.key in drawn]
        charts = {picture.key: picture.chart().shown(units) for picture in pictures}
    # the others are in the report, which the user can export
    charts = {key: chart for key, chart in charts.items() if _drawable(chart)}
    record = report.record(units, rendered=True)

    def kept(part: Mapping[str, Any]) -> bool:
        return part["kind"] != "picture" or part["key"] in charts

    sections = [{**section, "parts": [*filter(kept, section["parts"])]} for section in record["sections"]]
    verdict, told = record["verdict"]["sentences"], resolve(failure, units)
    parts = [part for section in sections for part in section["parts"] if part["kind"] == "remarks"]
    remarked = {text for part in parts for text in part["sentences"]}
    words = {
        "verdict": verdict,
        "failure": "" if told in verdict else told,
        "bad": bad,
        # what a section of the report says is not said twice
        "said": [said for note in notes if (said := resolve(note, units)) not in remarked],
        "picture": record["picture"] if record["picture"] is not None and kept(record["picture"]) else None,
        "sections": [section for section in sections if section["parts"]],
    }
    return Shown(words, charts)


def _drawable(chart: Chart) -> bool:
    """Return True if the page can draw a chart: one abscissa, and no boxes, fields or named ticks."""
    plain = (not (panel.boxes or panel.ticks or panel.field or panel.abscissa) for panel in chart.panels)
    return not chart.ticks and all(plain)


def reported(command: str, request: Request, progress: Progress) -> Shown:
    """Run a command, and return its report with all pictures."""
    return shown(perform(command, request, progress))


def fitted(command: str, request: Request, progress: Progress) -> Shown:
    """Run an identification, and return its report with files and friction."""
    outcome = perform(command, request, progress)
    progress.step("pictures")
    files = {what: Path(str(path)) for what, path in outcome.files.items()}
    return replace(shown(outcome), files=files, friction=getattr(outcome.result, "friction", None))


def tuned(request: TuneRequest, progress: Progress) -> Shown:
    """Tune a controller.

    The tab itself draws the pictures over frequency, which also show the current controller of the page.
    """
    outcome = perform("tune", request, progress)
    progress.step("pictures")
    files = {what: Path(str(path)) for what, path in outcome.files.items()}
    # no more than this: all that a job returns is pickled
    found = Tuning(outcome.result.control, _worst(outcome.result))
    return replace(shown(outcome, ("cascade",)), files=files, result=found)


def _worst(tuned: Tuned) -> dict[str, Loop]:
    """Return the loops at the plants with the largest Ms and with the least stiffness; none without a box."""
    found = {"sensitivity": SENSITIVITY_PEAK, "stiffness": STIFFNESS_LEAST}
    spreads = {name: None if tuned.box is None else tuned.box.spread(figure) for name, figure in found.items()}
    return {
        name: replace(spread.at, control=tuned.control)
        for name, spread in spreads.items()
        if spread is not None and spread.at is not None
    }


def _drawn(charts: Mapping[str, Chart], outcome: Outcome[Any]) -> dict[str, Chart]:
    """Return charts with their labels in the units of an outcome."""
    units = replace(outcome.units, typographic=True)
    return {name: chart.shown(units) for name, chart in charts.items()}


def toured(request: TourRequest, progress: Progress) -> list[Understood]:
    """Write the log of the tour, and read it like an upload."""
    from feeddrive.studio.uploads import understand

    outcome = perform("tour", request, progress)
    return understand([Path(str(path)) for path in outcome.files.values()], progress)


def circled(request: CircleRequest, progress: Progress) -> Shown:
    """Run the circle test of the machine; `circle_shown` draws the resulting circles."""
    outcome = perform("circle", request, progress)
    return replace(shown(outcome, ("causes",)), result=outcome.result.test)


def circle_shown(latest: Shown, before: CircleTest | None) -> Shown:
    """Plot the deviation of a circle test twice, magnified on the circle and versus angle, and list the largest peaks.

    before  the same circles under another controller, for comparison
    """
    from feeddrive.machining.circle_test import quadrant_peaks
    from feeddrive.plot.machining import circle_chart, unrolled_chart

    test: CircleTest = latest.result
    peaks = list[dict[str, Any]]()
    for peak in quadrant_peaks(test)[:_PEAKS]:
        at = float(np.degrees(peak.angle))
        text = Text(f"{Quantity(peak.height, 'm'):3} at {peak.side}{peak.axis}, {test.circles[peak.circle].name}")
        peaks.append({"text": text.shown(DRAWN), "view": [max(at - _TURN, 0.0), min(at + _TURN, 360.0)]})
    charts = {"circle": circle_chart(test, before), "unrolled": unrolled_chart(test, before)}
    charts = {name: chart.shown(DRAWN) for name, chart in charts.items()}
    return replace(latest, words={**latest.words, "peaks": peaks}, charts={**latest.charts, **charts})


def compared(request: CompareRequest, names: Sequence[str], progress: Progress) -> Shown:
    """Compare laws at equal robustness, and report a comparison of those that are finished meanwhile.

    names  the laws in the order in which they are tuned; `request` compares all of them
    """
    for count in (count for count in _ROWS if count < len(names)):
        # laws that are finished are kept, so that only those that are new are tuned here
        some = replace(request, law=tuple(names[:count]))
        found = _compared(some, progress.named(names[count - 1]).quiet())
        progress.better(-count, found)
    return _compared(request, progress)


def _compared(request: CompareRequest, progress: Progress) -> Shown:
    """Return trade-off, table, and the controller of each law."""
    outcome = perform("compare", request, progress)
    comparison = outcome.result
    units = replace(outcome.units, typographic=True)
    chart = comparison.chart()
    drawn = {mark.key for panel in chart.panels for mark in panel.marks}
    laws = [
        {
            "name": competitor.name,
            "why": competitor.unplaced,
            "held": competitor.held_by,
            "drawn": competitor.name in drawn,
            "figures": [_figure(figure, competitor.figures.get(figure.key), units) for figure in _OF_ROWS],
        }
        for competitor in comparison.competitors
    ]
    page = shown(outcome, ("ratios", "recovery"))
    heads = [resolve(figure.column().named(), units) for figure in _OF_ROWS]
    words = {**page.words, "laws": laws, "heads": heads, "seed": comparison.seed}
    controls = {competitor.name: competitor.loop.control for competitor in comparison.competitors}
    return Shown(words, {**page.charts, **_drawn({"tradeoff": chart}, outcome)}, controls)


def _figure(figure: Figure, value: float | None, units: Units) -> str:
    return "" if value is None else resolve(figure.bare(value), units)


def exported(request: ExportRequest, progress: Progress) -> Shown:
    """Write an export, and pack it as a ZIP archive next to its directory."""
    outcome = perform("export", request, progress)
    assert request.out is not None
    return Shown({**shown(outcome).words, "archive": packed(request.out).name})


def commissioned(request: CommissionRequest, progress: Progress) -> None:
    """Commission a drive, whose record the page reads, and pack its directory as a ZIP archive next to it."""
    perform("commission", request, progress)
    assert request.out is not None
    packed(request.out)


def packed(folder: Path) -> Path:
    """Pack a directory as a ZIP archive next to it, completely or not at all."""
    from feeddrive.files.atomic_io import written_whole

    archive = folder.with_name(f"{folder.name}.zip")
    with written_whole(archive) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted(folder.rglob("*")):
            # a symbolic link could bring files from elsewhere into the archive
            if path.is_file() and not path.is_symlink():
                file.write(path, Path(folder.name) / path.relative_to(folder))
    return archive
