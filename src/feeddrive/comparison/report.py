"""The report of a comparison, and its result directory."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.comparison.compare import TODAY, Comparison, advice
from feeddrive.evaluation.competitor import UNFIT, Competitor
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import CROSSOVER, DELAY_MARGIN, NOISE_GAIN, SENSITIVITY_PEAK
from feeddrive.figures.of_runs import SNAP_SETTLING
from feeddrive.figures.ranking import CRITERIA
from feeddrive.files.run_files import figures_text, file_names, summary_text
from feeddrive.files.section import to_toml
from feeddrive.language import tree
from feeddrive.language.quantity import Quantity, Units
from feeddrive.language.table import UNIT, Cell, Table
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import compliance, tracking
from feeddrive.plot.laws import ratios_chart, recovery_chart
from feeddrive.report.laws import Entry, LawsContents, block_sentence, described, facts_of, response_lines
from feeddrive.report.laws_report import laws_report
from feeddrive.report.page import write_page
from feeddrive.report.report import Marked, Picture, Report, Section, Verdict
from feeddrive.tuning.candidates import PLAIN

_TABLES = (CRITERIA[:5], CRITERIA[5:9], CRITERIA[9:])  # that fit side by side
_ROBUSTNESS = (SENSITIVITY_PEAK, DELAY_MARGIN, NOISE_GAIN, CROSSOVER)


def contents(comparison: Comparison) -> LawsContents:
    """Return the contents of the report."""
    machine, duty = comparison.machine, comparison.duty
    work = {
        "Move": Text(f"{block_sentence(duty.move)}; the first {Quantity(duty.skip, 's'):6 SI} do not count"),
        "Rope snap": Text(
            f"the table pulled back by {Quantity(duty.force, 'N'):6}, let go after {Quantity(duty.begin, 's'):6 SI}"
        ),
        "Force step": Text(f"{Quantity(duty.force, 'N'):6} switched on after {Quantity(duty.begin, 's'):6 SI}"),
        "Settled": Text(
            f"what stays within {Quantity(duty.near, 'm'):6} until the end, {Quantity(duty.rest, 's'):6 SI} after the "
            "force changed"
        ),
        "Noise": f"seed {comparison.seed}, the same for all laws; in the force: from counts and noise of the encoders",
    }
    name, loop = f"{machine.name}, axis {comparison.axis}", comparison.competitors[0].loop
    return LawsContents(
        title=comparison.title,
        entries=[_entry(comparison, law) for law in comparison.competitors if law.runs is not None],
        facts=facts_of(machine, name, loop, comparison.velocity, work),
        rule=comparison.rule,
        versions=comparison.versions,
        notes=comparison.remarks,
        extras=(
            *(_ranked(comparison, criteria) for criteria in _TABLES),
            _tuning(comparison),
        ),
        details=(Section("tunables", "What was tuned, and what was refused", _tunables(comparison), folded=True),),
        command="feeddrive compare",
        overview=Picture(
            "tradeoff",
            "Stiffness against tracking, at equal robustness",
            "A dot for each law, better is left and up. Hollow: today's gains where they are outside of the rule, "
            "and laws that have not settled. A line leads to the figures at the worst plant of the box, if there is "
            "one.",
            "Stiffness at 10 Hz and at 100 Hz over the RMS tracking error, one dot a law.",
            comparison.chart,
        ),
        pictures=_pictures(comparison),
    )


def comparison_report(comparison: Comparison) -> Report:
    """Return the report of a comparison."""
    judgment, sentence = advice(comparison)
    report = laws_report(contents(comparison))
    return replace(report, verdict=Verdict((sentence, *report.verdict.sentences), good=not judgment.bad))


def _entry(comparison: Comparison, law: Competitor) -> Entry:
    """Return the report entry of a competitor."""
    assert law.runs is not None
    frequency = response_lines(law.loop)
    remark = f" ({law.remark})" if law.remark and law.name != TODAY else ""
    return Entry(
        law.name,
        Text(f"{described(law.loop.control)}{remark}"),
        law.runs.move,
        law.loop,
        None if law.model is None else law.model.loop_gain(frequency),
        compliance(law.loop, frequency, velocity=comparison.velocity),
        None if law.model is None else tracking(law.loop, frequency, velocity=comparison.velocity),
    )


def _ranked(comparison: Comparison, criteria: tuple[Figure, ...]) -> Marked:
    """Tabulate the figures, each with its rank in brackets."""
    rows: list[list[Cell]] = [[name] for name in comparison.names]
    best: list[int | None] = []
    for criterion in criteria:
        places = comparison.places(criterion)
        for row, law, place in zip(rows, comparison.competitors, places, strict=True):
            value, remark = law.figures.get(criterion.key), law.kind or place
            worst = law.worst.get(criterion.key)
            beside = "" if worst is None else f", {criterion.bare(worst)}"
            row.append(None if value is None else Text(f"{criterion.bare(value)}{beside} ({remark})"))
        best.append(places.index(1) if places.count(1) == 1 else None)
    columns = ["law", *(criterion.column() for criterion in criteria)]
    boxed = comparison.competitors[0].box is not None
    over = "at the model, then at the worst plant of the box, " if boxed else ""
    runs = (
        " Runs are those of the model and of the same plants for all laws: all masses, and all stiffnesses, at either "
        "end of the box, without and with its dead time."
    )
    title = f"Figures, {over}and in brackets the place of the law by this criterion.{runs if boxed else ''}"
    return Marked(Table(title, columns, rows), best)


def _tuning(comparison: Comparison) -> Marked:
    """Tabulate robustness, the active constraints of the tuning, and its proof."""
    rows: list[list[Cell]] = []
    boxed = next((law.box for law in comparison.competitors if law.box is not None), None)
    for law in comparison.competitors:
        values = (law.figures.get(figure.key) for figure in _ROBUSTNESS)
        cells: list[Cell] = [law.name, *("∞" if value is not None and math.isinf(value) else value for value in values)]
        over: list[Cell] = [] if boxed is None else _over_box(law)
        if law.kind == UNFIT:
            rows.append([law.name, *[None] * len(_ROBUSTNESS), *over, law.reason, None, None, None])
        elif law.tuned is None:
            rows.append([*cells, *over, law.held_by, None, None, None])
        else:
            proof = Text(f"not proven: {law.unproven}") if law.unproven else "holds"
            agreed = "{} of {}".format(*law.tuned.agreed)
            rows.append([*cells, *over, law.held_by, law.tuned.evaluations, agreed, proof])
    beside = [] if boxed is None else [SENSITIVITY_PEAK.column("Ms at worst"), "over the box", "worst plant"]
    columns = ["law", *(figure.column() for figure in _ROBUSTNESS), *beside, "held back by", "loops judged"]
    columns += ["searches within 5 %", "proof"]
    title = Text(
        f"Robustness: {comparison.rule}. Proof: poles, limits on other frequency lines, and the rope-snap error by a "
        "run of the loop with its friction, counts and limits, all computed independently of the search."
    )
    return Marked(Table(title, columns, rows))


def _over_box(law: Competitor) -> list[Cell]:
    """Return Ms at the worst plant of the box, the verdict, and that plant."""
    if law.box is None:
        return [None, None, None]
    return [law.worst.get(SENSITIVITY_PEAK.key), law.box.verdict, law.box.plant]


def _tunables(comparison: Comparison) -> list[Marked]:
    """Tabulate the tunables of each law before and after tuning, and the refused laws."""
    rows = [
        [law.name, name, *(Quantity(x, unit, form="SI") for x in (law.tuned.started[name], value)), UNIT]
        for law in comparison.competitors
        if law.tuned is not None
        for name, value in law.tuned.tunables.items()
        for unit in [_unit(law.loop.control, name)]
    ]
    heads = ["law", "tunable", "begun at", "tuned", "unit"]
    tables = [Marked(Table("Knobs, where the search began and where it ended.", heads, rows))]
    if comparison.refusals:
        reasons = [[refusal.name, refusal.reason] for refusal in comparison.refusals]
        refused = Table("Laws that cannot control this axis, and why.", ["law", "reason"], reasons)
        tables.append(Marked(refused, text=True))
    return tables


def _unit(control: Control, name: str) -> str:
    leaves = {leaf for leaf, _ in tree.leaves(control)}
    return tree.declaration(control, name).unit if name in leaves else ""


def _pictures(comparison: Comparison) -> list[Picture]:
    drawn = [
        Picture(
            "ratios",
            "All laws against plain P-PI",
            "Each figure divided by that of P-PI under the same rule. Blue: better, orange: worse; for stiffness more "
            "is better, for all else less.",
            "Ratios of all figures of all laws to those of P-PI.",
            lambda: ratios_chart(list(zip(comparison.names, comparison.figures, strict=True)), PLAIN),
        )
    ]
    rows = [(law.name, law.runs.snap, law.runs.step) for law in comparison.competitors if law.runs is not None]
    # twice the median settling time of the laws, at least 20 samples
    times = [row.get(SNAP_SETTLING.key) for row in comparison.figures]
    finite = [time for time in times if time is not None and math.isfinite(time)]
    T, duty = float(comparison.competitors[0].loop.sample_time), comparison.duty
    span = float(min(max(2.0 * float(np.median(finite)) if finite else duty.rest, 20.0 * T), duty.rest))
    if rows:
        drawn.append(
            Picture(
                "recovery",
                "Recovery after a rope snap and a force step",
                "Position of the table against its setpoint. Dashed: within it a law counts as settled.",
                "Position of the table after a force was taken away and after it was switched on, of all laws.",
                lambda: recovery_chart(rows, begin=duty.begin, near=duty.near, span=span),
            )
        )
    return drawn


def write_comparison(comparison: Comparison, out: str | Path, more: Mapping[str, str] | None = None) -> Path:
    """Write the result directory atomically, and return the path of the report.

    more  texts of further files in it, by name

    Raises FileError if `out` cannot be written, or is a directory that feeddrive did not write.
    """
    place, rotary = f"axis.{comparison.axis}.control", comparison.rotary
    controls = {
        f"controls/{name}.toml": to_toml(law.loop.control, place, rotary=rotary)
        for name, law in zip(file_names(comparison.competitors), comparison.competitors, strict=True)
    }
    texts = {
        "summary.json": summary_text(summary(comparison), rotary=rotary, quoted=comparison.quoted),
        "figures.csv": figures_csv(comparison),
        "machine.toml": comparison.machine.file.text,
    }
    return write_page(out, comparison_report(comparison), {**texts, **(more or {}), **controls})


def summary(comparison: Comparison) -> dict[str, Any]:
    """Return all figures as plain numbers; missing ones are null, and infinity is the text "infinite"."""
    places = {criterion.key: comparison.places(criterion) for criterion in CRITERIA}
    return {
        "title": comparison.title,
        "machine": comparison.machine.name,
        "source": comparison.machine.source,
        "axis": comparison.axis,
        "rule": comparison.rule,
        "seed": comparison.seed,
        "box": next((law.box.text for law in comparison.competitors if law.box is not None), None),
        "force_N": comparison.duty.force,
        "settled_within_m": comparison.duty.near,
        "velocity_of_the_linear_model_m_per_s": comparison.velocity,
        "versions": dict(comparison.versions),
        "laws": {
            law.name: law.record() | {"places": {key: row[i] for key, row in places.items()}}
            for i, law in enumerate(comparison.competitors)
        },
        "refused": {refusal.name: refusal.reason for refusal in comparison.refusals},
        "remarks": list(comparison.remarks),
    }


def figures_csv(comparison: Comparison) -> str:
    """Return the figures as CSV; missing ones are empty cells."""
    return figures_text({"law": comparison.names}, comparison.figures, Units(rotary=comparison.rotary))
