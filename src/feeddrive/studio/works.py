"""Long works of the page that end in words and pictures: each runs in a process of its own and gives little back."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feeddrive.language.progress import Progress
from feeddrive.language.table import Table
from feeddrive.studio.jobs import perform
from feeddrive.studio.room import tabled

if TYPE_CHECKING:
    from feeddrive.analysis.friction_map import FrictionMap
    from feeddrive.loop.control import Control
    from feeddrive.plot.chart import Chart
    from feeddrive.studio.inspect_file import Understood
    from feeddrive.workflow.certify import CertifyRequest
    from feeddrive.workflow.circle import CircleRequest
    from feeddrive.workflow.command import Outcome
    from feeddrive.workflow.compare import CompareRequest
    from feeddrive.workflow.export import ExportRequest
    from feeddrive.workflow.request import Request
    from feeddrive.workflow.run_job import RunRequest
    from feeddrive.workflow.tour import TourRequest

_CORNERS = 8  # worst places of a part program that are drawn


@dataclass(frozen=True)
class Shown:
    """What a work came to.

    words   said, tables, verdict, failure
    images  SVG by what they show
    controls  by name of a law, of a comparison
    charts  by what they show
    files   that were written
    friction  over velocity, of an identified motion
    """

    words: Mapping[str, Any]
    images: Mapping[str, str] = field(default_factory=dict[str, str])
    controls: Mapping[str, Control] = field(default_factory=dict[str, "Control"])
    charts: Mapping[str, Chart] = field(default_factory=dict[str, "Chart"])
    files: Mapping[str, Path] = field(default_factory=dict[str, Path])
    friction: FrictionMap | None = None


def words_of(outcome: Outcome[Any]) -> dict[str, Any]:
    """Sentences and tables of an outcome, for the page."""
    said, tables = list[str](), list[dict[str, Any]]()
    for each in outcome.said():
        if isinstance(each, Table):
            tables.append(tabled(each))
        elif str(each) != outcome.verdict:
            said.append(str(each).removeprefix("- "))
    return {"said": said, "tables": tables, "verdict": outcome.verdict, "failure": outcome.failure or ""}


def fitted(command: str, request: Request, progress: Progress) -> Shown:
    """A model or responses from logs; of a motion the model over the log."""
    outcome = perform(command, request, progress)
    charts = dict(_fit_charts(outcome.result))
    if outcome.turns:
        charts = {name: each.turning() for name, each in charts.items()}
    files = {what: Path(str(path)) for what, path in outcome.files.items()}
    return Shown(words_of(outcome), charts=charts, files=files, friction=getattr(outcome.result, "friction", None))


def _fit_charts(found: Any) -> Iterator[tuple[str, Chart]]:
    """Of a motion the model over the log and the friction, of responses each in its band, and the model over them."""
    from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
    from feeddrive.identification.motion.identify import Identified
    from feeddrive.identification.response.fit_axis import AxisFits
    from feeddrive.identification.response.modal_fit import ModalFit
    from feeddrive.plot.friction import friction_chart
    from feeddrive.plot.identification import identified_chart
    from feeddrive.plot.responses import estimates_chart, response_fit_chart

    if isinstance(found, Identified):
        yield "made", identified_chart(found)
        if found.loop is not None and found.friction is not None:
            yield "friction", friction_chart(found.loop, measured=found.friction)
    elif isinstance(found, AxisFits | ModalFit):
        yield "response", response_fit_chart((found.fit if isinstance(found, AxisFits) else found).agreement)
    else:
        known = [each for each in found if isinstance(each, FrequencyEstimate)]
        if known:
            yield "response", estimates_chart(known)


def toured(request: TourRequest, progress: Progress) -> list[Understood]:
    """The log of the tour, written and read."""
    from feeddrive.studio.inspect_file import understand

    outcome = perform("tour", request, progress)
    return understand([Path(str(path)) for path in outcome.files.values()], progress)


def certified(request: CertifyRequest, progress: Progress) -> Shown:
    """A certificate, its discs in the complex plane and over frequency."""
    from feeddrive import plot

    outcome = perform("certify", request, progress)
    progress.step("pictures")
    images = {"certificate": plot.certificate(outcome.result), "discs": plot.certificate_discs(outcome.result)}
    return Shown(words_of(outcome), {name: as_svg(each) for name, each in images.items()})


def circled(request: CircleRequest, progress: Progress) -> Shown:
    """The circle test of the machine: the deviation, magnified, and its causes."""
    from feeddrive import plot

    outcome = perform("circle", request, progress)
    progress.step("pictures")
    test = outcome.result.test
    images = {"circle": plot.circle_test(test), "unrolled": plot.circle_unrolled(test)}
    return Shown(words_of(outcome), {name: as_svg(each) for name, each in images.items()})


def program_run(request: RunRequest, progress: Progress) -> Shown:
    """A part program on the machine: contour error on the path, and the worst places."""
    from feeddrive import plot

    outcome = perform("run", request, progress)
    progress.step("pictures")
    words = words_of(outcome)
    images, worst = dict[str, str](), list[dict[str, Any]]()
    row = outcome.result.rows[0]
    if row.part is not None:
        images["contour"] = as_svg(plot.contour_on_path(row.part.contour))
        for i, each in enumerate(row.part.worst(_CORNERS)):
            images[f"worst_{i}"] = as_svg(plot.part_zoom({row.name: row.part}, each.time))
            where = ", ".join(f"{1e3 * value:.3f}" for value in each.position)
            line = "" if each.line is None else f", line {each.line}"
            worst.append(
                {
                    "image": f"worst_{i}",
                    "text": f"{1e6 * abs(each.error):.3g} um at {each.time:.3f} s ({where} mm{line})",
                }
            )
        words["tables"] = [tabled(row.part.table()), *words["tables"]]
    return Shown({**words, "worst": worst}, images)


def compared(request: CompareRequest, progress: Progress) -> Shown:
    """All laws at equal robustness: the trade-off, the table, and the control of each law."""
    outcome = perform("compare", request, progress)
    progress.step("pictures")
    found = outcome.result
    laws = [{"name": each.name, "why": each.unfit or each.outside, "held": each.held_by} for each in found.competitors]
    words = {**words_of(outcome), "laws": laws, "rule": found.rule, "seed": found.seed}
    return Shown(
        words, {"tradeoff": as_svg(found.plot())}, {each.name: each.loop.control for each in found.competitors}
    )


def exported(request: ExportRequest, progress: Progress) -> Shown:
    """An export, packed as a ZIP archive beside its directory."""
    outcome = perform("export", request, progress)
    assert request.out is not None
    return Shown({**words_of(outcome), "archive": packed(request.out).name})


def packed(folder: Path) -> Path:
    """A ZIP archive of a directory, beside it, whole or not at all."""
    from feeddrive.files.atomic_io import written_whole

    archive = folder.with_name(f"{folder.name}.zip")
    with written_whole(archive) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as file:
        for each in sorted(folder.rglob("*")):
            if each.is_file() and not each.is_symlink():
                file.write(each, Path(folder.name) / each.relative_to(folder))
    return archive


def as_svg(figure: Any) -> str:
    """A picture of matplotlib that stands by itself."""
    import matplotlib

    text = StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "studio"}):
        figure.savefig(text, format="svg", facecolor="white", metadata={"Date": None, "Creator": None})
    return text.getvalue()
