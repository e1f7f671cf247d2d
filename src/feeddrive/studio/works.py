"""Long-running jobs of the page that produce texts and pictures: each runs in its own process and returns little."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.errors import sentence
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import DRAWN, Quantity
from feeddrive.language.table import Grid
from feeddrive.language.text import Text, resolve
from feeddrive.plot.chart import Chart
from feeddrive.studio.desk import tabled
from feeddrive.studio.jobs import perform

if TYPE_CHECKING:
    from feeddrive.analysis.friction_map import FrictionMap
    from feeddrive.loop.control import Control
    from feeddrive.machining.circle_test import CircleTest
    from feeddrive.studio.uploads import Understood
    from feeddrive.workflow.certify import CertifyRequest
    from feeddrive.workflow.circle import CircleRequest
    from feeddrive.workflow.command import Outcome
    from feeddrive.workflow.compare import CompareRequest
    from feeddrive.workflow.export import ExportRequest
    from feeddrive.workflow.request import Request
    from feeddrive.workflow.run_job import RunRequest
    from feeddrive.workflow.tour import TourRequest

_PLACES = 8  # worst places of a part program, and quadrant peaks of circles, that can be looked at
_TURN = 12.0  # degrees on both sides of a quadrant peak


@dataclass(frozen=True)
class Shown:
    """The result of a job, as the page shows it.

    words     JSON data with the keys said, tables, verdict, failure, bad
    charts    charts by name
    controls  controls of a comparison by name of the law
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


def words_of(outcome: Outcome[Any]) -> dict[str, Any]:
    """Return sentences and tables of an outcome for the page; a failed outcome always has a sentence."""
    sentences, tables = list[str](), list[dict[str, Any]]()
    verdict = resolve(outcome.verdict, outcome.units)
    for item in outcome.shown():
        if isinstance(item, Grid):
            tables.append(tabled(item))
        elif item != verdict:
            sentences.append(item.removeprefix("- "))
    bad = outcome.judgment.bad
    failure = resolve(outcome.failure, outcome.units)
    if bad and not failure and not verdict:
        failure = sentence(outcome.judgment.says)
    return {"said": sentences, "tables": tables, "verdict": verdict, "failure": failure, "bad": bad}


def fitted(command: str, request: Request, progress: Progress) -> Shown:
    """Identify a model or frequency responses from logs, with charts of the fit."""
    outcome = perform(command, request, progress)
    charts = dict(_fit_charts(outcome.result))
    charts = _drawn(charts, outcome)
    files = {what: Path(str(path)) for what, path in outcome.files.items()}
    return Shown(words_of(outcome), charts=charts, files=files, friction=getattr(outcome.result, "friction", None))


def _drawn(charts: Mapping[str, Chart], outcome: Outcome[Any]) -> dict[str, Chart]:
    """Return charts with their texts in the drawing units of an outcome."""
    units = replace(outcome.units, typographic=True)
    return {name: chart.shown(units) for name, chart in charts.items()}


def _fit_charts(result: Any) -> Iterator[tuple[str, Chart]]:
    """Yield the charts of a fit: model over log and friction for a motion, each response and the
    model for responses.
    """
    from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
    from feeddrive.identification.motion.identify import Identified
    from feeddrive.identification.response.modal_fit import ModalFit
    from feeddrive.identification.response.plant_fit import AxisFits
    from feeddrive.plot.identification import friction_chart, identified_chart
    from feeddrive.plot.over_frequency import estimates_chart, response_fit_chart

    if isinstance(result, Identified):
        yield "made", identified_chart(result)
        if result.loop is not None and result.friction is not None:
            yield "friction", friction_chart(result.loop, measured=result.friction)
    elif isinstance(result, AxisFits | ModalFit):
        yield "response", response_fit_chart((result.fit if isinstance(result, AxisFits) else result).agreement)
    else:
        known = [estimate for estimate in result if isinstance(estimate, FrequencyEstimate)]
        if known:
            yield "response", estimates_chart(known)


def toured(request: TourRequest, progress: Progress) -> list[Understood]:
    """Write and read the log of the tour."""
    from feeddrive.studio.uploads import understand

    outcome = perform("tour", request, progress)
    return understand([Path(str(path)) for path in outcome.files.values()], progress)


def certified(request: CertifyRequest, progress: Progress) -> Shown:
    """Compute a stability certificate, and draw it over frequency and as discs in the complex plane."""
    from feeddrive.plot.complex_plane import certificate_chart, certificate_discs_chart

    outcome = perform("certify", request, progress)
    charts = {"certificate": certificate_chart(outcome.result)}
    if not outcome.result.two_rates:  # with two rates one L has no disc of its own
        charts["discs"] = certificate_discs_chart(outcome.result)
    return Shown(words_of(outcome), _drawn(charts, outcome))


def circled(request: CircleRequest, progress: Progress) -> Shown:
    """Run the circle test of the machine; `circle_shown` draws the resulting circles."""
    outcome = perform("circle", request, progress)
    return Shown(words_of(outcome), result=outcome.result.test)


def circle_shown(shown: Shown, before: CircleTest | None) -> Shown:
    """Draw the deviation of a circle test, magnified and over the angle, and list the largest quadrant peaks.

    before  the same circles under another control, for comparison
    """
    from feeddrive.machining.circle_test import quadrant_peaks
    from feeddrive.plot.machining import circle_chart, unrolled_chart

    test: CircleTest = shown.result
    peaks = list[dict[str, Any]]()
    for peak in quadrant_peaks(test)[:_PLACES]:
        at = float(np.degrees(peak.angle))
        text = Text(f"{Quantity(peak.height, 'm'):3} at {peak.side}{peak.axis}, {test.circles[peak.circle].name}")
        peaks.append({"text": text.shown(DRAWN), "view": [max(at - _TURN, 0.0), min(at + _TURN, 360.0)]})
    charts = {"circle": circle_chart(test, before), "unrolled": unrolled_chart(test, before)}
    charts = {name: chart.shown(DRAWN) for name, chart in charts.items()}
    return replace(shown, words={**shown.words, "peaks": peaks}, charts=charts)


def program_run(request: RunRequest, progress: Progress) -> Shown:
    """Run a part program on the machine, and show the contour error on the path and its worst places."""
    from feeddrive.plot.part_program import contour_on_path_chart, part_zoom_chart, place_chart, place_view

    outcome = perform("run", request, progress)
    progress.step("pictures")
    words = words_of(outcome)
    charts, worst = dict[str, Chart](), list[dict[str, Any]]()
    row = outcome.result.rows[0]
    if row.part is not None:
        places = row.part.worst(_PLACES)
        charts["path"] = contour_on_path_chart(row.part.contour, places=places)
        for i, place in enumerate(places):
            charts[f"place_{i}"] = place_chart(row.part.contour, place)
            charts[f"time_{i}"] = part_zoom_chart({row.name: row.part}, place.time)
            coordinates = (Quantity(value, "m", form=".3f mm", stays=True, bare=True) for value in place.position)
            where = ", ".join(f"{coordinate}" for coordinate in coordinates)
            line = "" if place.line is None else f", line {place.line}"
            text = Text(f"{Quantity(abs(place.error), 'm'):3} at {Quantity(place.time, 's'):.3f SI} ({where} mm{line})")
            worst.append(
                {
                    "text": text.shown(replace(outcome.units, typographic=True)),
                    "view": place_view(row.part.contour, place),
                }
            )
        words["tables"] = [tabled(row.part.table()), *words["tables"]]
    return Shown({**words, "worst": worst}, _drawn(charts, outcome))


def compared(request: CompareRequest, progress: Progress) -> Shown:
    """Compare laws at equal robustness; return trade-off, table, and the control of each law."""
    from feeddrive.comparison.pictures import tradeoff_chart

    outcome = perform("compare", request, progress)
    comparison = outcome.result
    chart = tradeoff_chart(
        [(competitor.name, competitor.figures, competitor.unplaced) for competitor in comparison.competitors]
    )
    drawn = {mark.key for panel in chart.panels for mark in panel.marks}
    laws = [
        {
            "name": competitor.name,
            "why": competitor.unfit or competitor.unplaced,
            "held": competitor.held_by,
            "drawn": competitor.name in drawn,
        }
        for competitor in comparison.competitors
    ]
    words = {**words_of(outcome), "laws": laws, "seed": comparison.seed}
    controls = {competitor.name: competitor.loop.control for competitor in comparison.competitors}
    return Shown(words, _drawn({"tradeoff": chart}, outcome), controls)


def exported(request: ExportRequest, progress: Progress) -> Shown:
    """Write an export, and pack it as a ZIP archive next to its directory."""
    outcome = perform("export", request, progress)
    assert request.out is not None
    return Shown({**words_of(outcome), "archive": packed(request.out).name})


def packed(folder: Path) -> Path:
    """Pack a directory as a ZIP archive next to it, completely or not at all."""
    from feeddrive.files.atomic_io import written_whole

    archive = folder.with_name(f"{folder.name}.zip")
    with written_whole(archive) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted(folder.rglob("*")):
            if path.is_file() and not path.is_symlink():
                file.write(path, Path(folder.name) / path.relative_to(folder))
    return archive
