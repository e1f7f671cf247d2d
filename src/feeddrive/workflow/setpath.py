"""`feeddrive setpath`: set positions with which the table of a known axis follows a reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.job import JobLike, read_job
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text
from feeddrive.learning.filtered_splines import filtered_splines
from feeddrive.learning.set_path import ChangedReference
from feeddrive.learning.zero_phase import zero_phase
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.iterate import MOVE
from feeddrive.workflow.request import OUT_FILE, Request, argument, called, option

METHODS = ("zero-phase", "splines")


class SetpathRequest(Request):
    """The axis, the motion, and how its set positions are found."""

    source: MachineLike = argument("A machine file (TOML), or the name of a bundled machine")
    axis: str | None = option("its axis, if it has several", default=None)
    job: JobLike | None = option("the job whose reference is followed; default: 100 mm out and back", default=None)
    method: str = option(
        "zero-phase: inverse of the loop (Tomizuka);  splines: fitted answers of splines (Okwudire)",
        default="zero-phase",
        options=METHODS,
    )
    spacing: int = option("samples between the knots of the splines", default=20, least=3, most=10_000)
    window: int | None = option("coefficients of the splines that are known ahead; default: all", default=None)
    out: Path | None = option(OUT_FILE, short="-o", default=None)

    def check(self) -> None:
        """Raise ParameterError for a window of a method that has none."""
        if self.method != "splines" and self.window is not None:
            raise ParameterError(f"--window = {self.window} is for --method splines, not {self.method}: leave it out")


@command(SetpathRequest)
def setpath(request: SetpathRequest, progress: Progress) -> Outcome[ChangedReference]:
    """Change a set path beforehand, by the linear model of the loop, so that the table follows the wanted one.

    Both paths are run on the axis as the file has it, friction included.
    """
    progress.step("model of the loop")
    loop = read_machine(request.source).loop(request.axis)
    reference = _reference(request.job)
    if request.method == "zero-phase":
        changed = zero_phase(loop, reference)
    else:
        changed = filtered_splines(loop, reference, spacing=request.spacing, window=request.window)
    progress.step("runs of both paths")
    rows = [
        ["as it was", *_left(loop, reference, reference)],
        ["changed", *_left(loop, changed.reference, changed.wanted)],
    ]
    title = f"{called(request.source)}, axis {loop.name}: distance of the table from the wanted path, {request.method}"
    remarks = [
        Text(
            f"The changed path is up to {Quantity(changed.shift, 'm')} off the wanted one, and begins "
            f"{Quantity(changed.lead, 's')} earlier than the motion: give every axis of a machine the same lead."
        ),
        "It holds for this load and these gains: after a change of either make it anew.",
    ]
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("writing")
        write_whole(request.out, _text(changed))
        files["Written"] = request.out
    table = Table(title, ["path", Column("largest", "m"), Column("RMS", "m")], rows)
    return Outcome(changed, [table], remarks, files=files, rotary=loop.axis.rotary)


def _reference(job: JobLike | None) -> Reference:
    if job is None:
        return MOVE
    reference = read_job(job).reference
    if reference is None:
        raise ParameterError(f"{called(job)}: has no [reference], only a log: name a job with a reference")
    return reference


def _left(loop: Loop, reference: Reference, wanted: Reference) -> list[float]:
    """Return the largest and the RMS distance of the table, m."""
    run = simulate(loop, reference, record=["position_load"])
    off = run["position_load"] - np.asarray(wanted.at(run.time).position)
    return [float(np.max(np.abs(off))), float(np.sqrt(np.mean(off**2)))]


def _text(changed: ChangedReference) -> str:
    """Return the text of a CSV file: time, the set positions to play, and the wanted positions of the table."""
    T = float(changed.reference.sample_time)
    rows = zip(changed.reference.position, changed.wanted.position, strict=True)
    lines = [f"{k * T:.9g},{float(played)!r},{float(wanted)!r}" for k, (played, wanted) in enumerate(rows)]
    return "\n".join(["time_s,set_position_m,wanted_position_m", *lines, ""])
