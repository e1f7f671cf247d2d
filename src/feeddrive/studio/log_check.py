"""Check of the column roles of a log: peak figures, and contradictions between samples, roles and units."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from feeddrive.files.columns import ROLES
from feeddrive.files.mapping import log_preview
from feeddrive.files.read_log import OpenedFile
from feeddrive.identification.plausibility import outside
from feeddrive.language.errors import FeeddriveError, sentence
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import DRAWN
from feeddrive.plot.chart import Chart, Curve, Panel
from feeddrive.plot.over_time import preview_chart
from feeddrive.studio.desk import tabled
from feeddrive.studio.jobs import fault
from feeddrive.workflow.channels import mapped

if TYPE_CHECKING:
    import numpy as np

    from feeddrive.files.columns import Column
    from feeddrive.files.log import Log
    from feeddrive.files.mapping import Guess
    from feeddrive.files.role_checks import RoleDoubt

_NO_FIGURES: Mapping[str, Any] = {"figures": None, "outside": [], "readings": None, "choices": [], "notes": 0}
# how a command line corrects a role: on the page it is chosen in the row
_WITH_OPTIONS = re.compile(r" \((?=[^()]*--)[^()]*\)")


@dataclass(frozen=True, eq=False)
class Check:
    """The check of a log's column roles before a fit, which shows whether the log matches the user's machine.

    words      data for the page: peak figures and, if the units are doubtful, the two likeliest interpretations
    sentences  contradictions between samples, roles and units; the last ones are notes, whose number is in `words`
    doubts     the roles that the samples certainly contradict
    open_      the roles that the samples neither confirm nor contradict
    chart      position, speed and force over time; if there is no position, the columns as they are
    """

    words: Mapping[str, Any]
    sentences: tuple[str, ...]
    doubts: tuple[RoleDoubt, ...]
    chart: Chart
    open_: tuple[RoleDoubt, ...] = ()


def checked(
    guess: Guess,
    log: Log | None,
    clock: Column | None,
    columns: Mapping[str, tuple[np.ndarray, np.ndarray]],
    units: Mapping[str, str],
) -> Check:
    """Check a log with the given column roles: peak figures, and contradictions by its samples.

    guess    roles of the columns
    log      columns as in the file; its time was computed with `clock`, the time column and its unit
    columns  time and values of each column, for a picture
    units    units of the columns, as stated in the file
    """
    plain = partial(_preview, guess, columns, units)
    log = _on_its_clock(log, clock, guess.mapping.get("time"))
    if log is None:
        return Check(_NO_FIGURES, (), (), plain())
    # the log has its clock already, whatever its column was called in the file
    columns_, reasons = (
        {role: value for role, value in there.items() if role != "time"}
        for there in (guess.mapping.columns, guess.mapping.reasons)
    )
    mapping = replace(guess.mapping, columns=columns_, reasons=reasons)
    try:
        read = mapped(OpenedFile(log), {}, mapping, ROLES, None, Progress())
        preview = log_preview(log, mapping, guess.needs)
    except FeeddriveError as error:
        return Check(_NO_FIGURES, (str(error),), (), plain())
    except Exception as error:
        # the table must stay usable: the user may have chosen the wrong column
        return Check(_NO_FIGURES, (fault(error),), (), plain())
    wrong = () if preview is None else outside(preview.frame, preview.sizes)
    doubt = read.doubt if read.doubt.why and not read.doubt.told else None
    notes = [str(doubt.why) for doubt in read.contradictions if not doubt.certain]
    sentences = [str(doubt.why) for doubt in read.contradictions if doubt.certain]
    if doubt is not None:
        sentences.append(doubt.cause or doubt.why)
    elif wrong:
        sentences.append("check the units: no feed drive has such figures")
    words = {
        "figures": None if preview is None else tabled(preview.table(), DRAWN),
        "outside": [span.quantity for span in wrong],
        "readings": None if doubt is None or doubt.readings is None else tabled(doubt.readings, DRAWN),
        "choices": [] if doubt is None else doubt.choices,
        "notes": len(notes),
    }
    name = f"{log.name}: "
    return Check(
        words,
        tuple(sentence(_WITH_OPTIONS.sub("", text.removeprefix(name))) for text in (*sentences, *notes)),
        tuple(doubt for doubt in read.contradictions if doubt.certain),
        plain() if preview is None else preview_chart(preview),
        tuple(doubt for doubt in read.contradictions if doubt.kind == "open"),
    )


def _on_its_clock(log: Log | None, before: Column | None, now: Column | None) -> Log | None:
    """Return a log with its time converted to the present unit; None if another column is now the time."""
    if log is None or before == now:
        return log
    if before is None or now is None or before.name != now.name:
        return None
    ratio = (now.scale("time") or 1.0) / (before.scale("time") or 1.0)
    return replace(log, time=ratio * log.time, sample_time=ratio * log.sample_time)


def _preview(guess: Guess, columns: Mapping[str, tuple[np.ndarray, np.ndarray]], units: Mapping[str, str]) -> Chart:
    """Plot up to six columns with a role over time, or the first four columns if none has a role."""
    roles: Mapping[str, str] = {column.name: role for role, column in guess.mapping.items() if role != "time"}
    names = [name for name in columns if name in roles][:6] or list(columns)[:4]
    panels = tuple(
        Panel(units.get(name) or "no unit", (Curve(*columns[name], name, i),)) for i, name in enumerate(names)
    )
    return Chart("time (s)", panels, height=1.4 * max(len(panels), 1))
