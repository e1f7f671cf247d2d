"""The report of a comparison, and its result directory."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.comparison import pictures
from feeddrive.comparison.advice import advice
from feeddrive.comparison.compare import PLAIN, TODAY, Comparison
from feeddrive.comparison.figures import CRITERIA
from feeddrive.comparison.judge import Competitor
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import CROSSOVER, DELAY_MARGIN, NOISE_GAIN, SENSITIVITY_PEAK
from feeddrive.figures.of_runs import SNAP_SETTLING
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.run_files import figure_key, file_names, summary_text
from feeddrive.files.to_toml import to_toml
from feeddrive.language import tree
from feeddrive.language.quantity import Quantity, Units
from feeddrive.language.table import UNIT, Cell, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.loop.lifting import compliance, tracking
from feeddrive.report.laws import RESPONSE_LINES, Entry, LawsContents
from feeddrive.report.laws_report import laws_report
from feeddrive.report.page import html
from feeddrive.report.report import Marked, Picture, Report, Section, Verdict
from feeddrive.report.sentences import block_sentence, described


def contents(found: Comparison) -> LawsContents:
    """What the report is made from."""
    loop = found.competitors[0].loop
    duty = found.duty
    facts = {
        "Machine": f"{found.machine.name}, axis {found.axis}",
        "Source of its numbers": found.machine.source or "not stated",
        "Sample time": Text(f"{Quantity(loop.sample_time, 's'):6}, {loop.axis.substeps} substep(s) of exact hold"),
        "Move": Text(f"{block_sentence(duty.move)}; the first {Quantity(duty.skip, 's'):6 SI} do not count"),
        "Rope snap": Text(
            f"the table pulled back by {Quantity(duty.force, 'N'):6}, let go after {Quantity(duty.begin, 's'):6 SI}"
        ),
        "Force step": Text(f"{Quantity(duty.force, 'N'):6} switched on after {Quantity(duty.begin, 's'):6 SI}"),
        "Settled": Text(
            f"what stays within {Quantity(duty.near, 'm'):6} until the end, {Quantity(duty.rest, 's'):6 SI} after the "
            "force changed"
        ),
        "Noise": f"seed {found.seed}, the same for all laws; in the force: from counts and noise of the encoders",
        "Linear model": Text(f"sliding at {Quantity(found.velocity, 'm/s')}"),
    }
    if found.machine.remark:
        facts["Remark"] = found.machine.remark
    return LawsContents(
        title=found.title,
        entries=[_entry(found, each) for each in found.competitors if each.move is not None],
        facts=facts,
        rule=found.rule,
        versions=found.versions,
        notes=found.remarks,
        extras=(
            _ranked(found, CRITERIA[:5]),
            _ranked(found, CRITERIA[5:9]),
            _ranked(found, CRITERIA[9:]),
            _tuning(found),
        ),
        details=(
            Section(
                "tunables", "What was tuned, and what was refused", (_tunables(found), *_refused(found)), folded=True
            ),
        ),
        command="feeddrive compare",
        overview=Picture(
            "tradeoff",
            "Stiffness against tracking, at equal robustness",
            "A dot for each law, better is left and up. Hollow: today's gains where they are outside of the rule, "
            "and laws that have not settled.",
            "Stiffness at 10 Hz and at 100 Hz over the RMS tracking error, one dot a law.",
            found.chart,
        ),
        pictures=_pictures(found),
    )


def comparison_report(found: Comparison) -> Report:
    """Return the report of a comparison."""
    judgment, sentence = advice(found)
    report = laws_report(contents(found))
    return replace(report, verdict=Verdict((sentence, *report.verdict.sentences), good=not judgment.bad))


def _entry(found: Comparison, each: Competitor) -> Entry:
    """A competitor as a law of a report."""
    assert each.move is not None
    loop_gain = track = None
    nyquist = 0.5 / each.loop.sample_time
    frequency = np.geomspace(min(1.0, 0.01 * nyquist), nyquist, RESPONSE_LINES)
    if each.model is not None:
        loop_gain = each.model.loop_gain(frequency)
        track = tracking(each.loop, frequency, velocity=found.velocity)
    remark = f" ({each.remark})" if each.remark and each.name != TODAY else ""
    text = Text(f"{described(each.loop.control)}{remark}")
    soft = compliance(each.loop, frequency, velocity=found.velocity)
    return Entry(each.name, text, each.move, each.loop, loop_gain, soft, track)


def _ranked(found: Comparison, criteria: tuple[Figure, ...]) -> Marked:
    """Figures, each with its place in brackets."""
    rows: list[list[Cell]] = [[each.name] for each in found.competitors]
    best: list[int | None] = []
    for criterion in criteria:
        places = found.places(criterion)
        for row, each, place in zip(rows, found.competitors, places, strict=True):
            value = each.figures.get(criterion.key)
            remark = each.unplaced.partition(":")[0] or place
            row.append(None if value is None else Text(f"{figure(value, criterion)} ({remark})"))
        best.append(places.index(1) if places.count(1) == 1 else None)
    columns = ["law", *(criterion.column() for criterion in criteria)]
    return Marked(Table("Figures, and in brackets the place of the law by this criterion.", columns, rows), best)


def figure(value: float, criterion: Figure) -> str:
    """Return a figure without its unit, as a marked text."""
    if np.isinf(value):
        return "never" if criterion.unit == "s" else "∞"
    return f"{replace(criterion.shown(value), bare=True)}"


_ROBUSTNESS = (SENSITIVITY_PEAK, DELAY_MARGIN, NOISE_GAIN, CROSSOVER)


def _tuning(found: Comparison) -> Marked:
    """Robustness, what held the tuning back, and its proof."""
    rows: list[list[Cell]] = []
    for each in found.competitors:
        values = (each.figures.get(figure.key) for figure in _ROBUSTNESS)
        cells = [each.name, *("∞" if value is not None and np.isinf(value) else value for value in values)]
        if each.unfit:
            rows.append([each.name, *[None] * 4, each.unfit, None, None])
        elif each.tuned is None:
            rows.append([*cells, each.held_by, None, None])
        else:
            open_lines = [line.what for line in each.tuned.proof if line.holds is not True]
            proof = Text(f"not proven: {joined(', ', open_lines)}") if open_lines else "holds"
            rows.append([*cells, each.held_by, each.tuned.evaluations, proof])
    columns = ["law", *(figure.column() for figure in _ROBUSTNESS), "held back by", "loops judged", "proof"]
    title = Text(
        f"Robustness: {found.rule}. Proof: poles, limits on other frequency lines, and the rope-snap error by a "
        "run of the loop with its friction, counts and limits, all computed independently of the search."
    )
    return Marked(Table(title, columns, rows))


def _tunables(found: Comparison) -> Marked:
    """The tunables of each law, before and after."""
    rows = [
        [each.name, name, *(Quantity(x, unit, form="SI") for x in (each.tuned.started[name], value)), UNIT]
        for each in found.competitors
        if each.tuned is not None
        for name, value in each.tuned.tunables.items()
        for unit in [_unit(each.tuned.control, name)]
    ]
    return Marked(
        Table(
            "Knobs, where the search began and where it ended.", ["law", "tunable", "begun at", "tuned", "unit"], rows
        )
    )


def _unit(control: Control, name: str) -> str:
    there = {leaf for leaf, _ in tree.leaves(control)}
    return tree.declaration(control, name).unit if name in there else ""


def _refused(found: Comparison) -> list[Marked]:
    if not found.refusals:
        return []
    rows = [[each.name, each.reason] for each in found.refusals]
    return [Marked(Table("Laws that cannot control this axis, and why.", ["law", "reason"], rows), text=True)]


def _pictures(found: Comparison) -> list[Picture]:
    drawn = [
        Picture(
            "ratios",
            "All laws against plain P-PI",
            "Each figure divided by that of P-PI under the same rule. Blue: better, orange: worse; for stiffness more "
            "is better, for all else less.",
            "Ratios of all figures of all laws to those of P-PI.",
            lambda: pictures.ratios_chart([(each.name, each.figures) for each in found.competitors], PLAIN),
        )
    ]
    if any(each.snap is not None for each in found.competitors):
        drawn.append(
            Picture(
                "recovery",
                "Recovery after a rope snap and a force step",
                "Position of the table against its setpoint. Dashed: within it a law counts as settled.",
                "Position of the table after a force was taken away and after it was switched on, of all laws.",
                lambda: _recovery(found),
            )
        )
    return drawn


def _recovery(found: Comparison) -> Any:
    """Over twice the median of what the laws need to settle, at least 20 samples."""
    rows = [(each.name, each.snap, each.step) for each in found.competitors if each.snap and each.step]
    times = [each.figures.get(SNAP_SETTLING.key) for each in found.competitors]
    finite = [t for t in times if t is not None and np.isfinite(t)]
    T, duty = float(found.competitors[0].loop.sample_time), found.duty
    span = min(max(2.0 * float(np.median(finite)) if finite else duty.rest, 20.0 * T), duty.rest)
    return pictures.recovery_chart(rows, begin=duty.begin, near=duty.near, span=float(span))


def write_comparison(found: Comparison, out: str | Path, more: Mapping[str, str] | None = None) -> Path:
    """Write the directory whole or not at all, and return the path of the report.

    more  texts of other files in it, by name

    Raises FileError if `out` cannot be written, or is a directory that feeddrive did not write.
    """
    page = html(comparison_report(found))
    figures = summary_text(summary(found), rotary=found.rotary, quoted=found.quoted)
    with new_directory(out) as folder:
        (folder / "report.html").write_text(page, encoding="utf-8")
        (folder / "summary.json").write_text(figures, encoding="utf-8")
        (folder / "figures.csv").write_text(figures_csv(found), encoding="utf-8")
        (folder / "machine.toml").write_text(found.machine.file.text, encoding="utf-8")
        for name, text in (more or {}).items():
            (folder / name).write_text(text, encoding="utf-8")
        controls = folder / "controls"
        controls.mkdir()
        for name, each in zip(file_names(found.competitors), found.competitors, strict=True):
            text = to_toml(each.loop.control, f"axis.{found.axis}.control", rotary=found.rotary)
            (controls / f"{name}.toml").write_text(text, encoding="utf-8")
    return Path(out) / "report.html"


def summary(found: Comparison) -> dict[str, Any]:
    """All figures as plain numbers; what does not occur is null, what is infinite the text "infinite"."""
    places = {criterion.key: found.places(criterion) for criterion in CRITERIA}
    return {
        "title": found.title,
        "machine": found.machine.name,
        "source": found.machine.source,
        "axis": found.axis,
        "rule": found.rule,
        "seed": found.seed,
        "force_N": found.duty.force,
        "settled_within_m": found.duty.near,
        "velocity_of_the_linear_model_m_per_s": found.velocity,
        "versions": dict(found.versions),
        "laws": {
            each.name: {
                **{key: _plain(value) for key, value in each.figures.items()},
                "places": {key: row[i] for key, row in places.items()},
                **_tuned(each),
            }
            for i, each in enumerate(found.competitors)
        },
        "refused": {each.name: each.reason for each in found.refusals},
        "remarks": list(found.remarks),
    }


def _tuned(each: Competitor) -> dict[str, Any]:
    said: dict[str, Any] = {"unfit": each.unfit or None, "remark": each.remark or None}
    if each.tuned is not None:
        said |= {
            "tunables": {
                f"{each.loop.place_of('control')}.{name}": value for name, value in each.tuned.tunables.items()
            },
            "active": [held.sentence() for held in each.tuned.held],
            "loops_judged": each.tuned.evaluations,
            "settled": each.settled,
            "not_settled": each.tuned.unsettled or None,
            "not_placed": each.unplaced or None,
            "spread_of_searches": each.tuned.spread,
            "proof": {line.what: {"holds": line.holds, "said": line.said} for line in each.tuned.proof},
        }
    return said


def _plain(value: float | None) -> float | str | None:
    return "infinite" if value is not None and math.isinf(value) else value


def figures_csv(found: Comparison) -> str:
    """The figures as CSV; what does not occur is empty."""
    keys = list(dict.fromkeys(key for each in found.competitors for key in each.figures))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["law", *(figure_key(key, Units(rotary=found.rotary)) for key in keys)])
    for each in found.competitors:
        cells = (each.figures.get(key) for key in keys)
        writer.writerow([each.name, *("" if cell is None else repr(float(cell)) for cell in cells)])
    return text.getvalue()
