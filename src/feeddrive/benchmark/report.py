"""The benchmark results for readers: report page, CSV, JSON, and Markdown and LaTeX tables for papers."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from feeddrive.benchmark.benchmark import FIGURES, Benchmark, Group, advice, order_of
from feeddrive.benchmark.standings import RANKED_BY, decision_of, score_tables
from feeddrive.figures.figure import Figure
from feeddrive.files.run_files import figures_text, summary_text
from feeddrive.language.quantity import DRAWN, Units
from feeddrive.language.table import Table
from feeddrive.report.page import write_page
from feeddrive.report.report import Facts, Picture, Report, Section, Verdict, facts

CITE = "feeddrive benchmark of feed-drive control laws"
DOTS = "Times better than P-PI at equal robustness; a line is a law, a small dot a plant, the large one their mean."
DRAWN_DOTS = (
    "Times better than P-PI at equal robustness; a line is a law, a small dot a drawn machine, the large one the "
    "geometric mean over all machines of the group, the bar its confidence interval. A law without a place on all "
    "plants of the group has no mean and stands below; *: its search is not settled on one of them."
)


def write_benchmark(benchmark: Benchmark, out: str | Path) -> Path:
    """Write the result directory atomically, and return the path of the report.

    Raises FileError if `out` cannot be written, or is a directory that feeddrive did not write.
    """
    texts = {
        "summary.json": summary_text(summary(benchmark)),
        "figures.csv": figures_csv(benchmark),
        "table.md": markdown(benchmark),
        "table.tex": latex(benchmark),
    }
    return write_page(out, benchmark_report(benchmark), texts)


def citation(benchmark: Benchmark) -> str:
    """Return the citation to be printed with the table."""
    seed = f", seed {benchmark.own}" if benchmark.own else ""
    return (
        f"{CITE}, rules {benchmark.rules.version} (sha256 {benchmark.rules.digest()[:12]}), feeddrive "
        f"{benchmark.versions['feeddrive']}{seed}"
    )


def benchmark_report(benchmark: Benchmark) -> Report:
    """Return the report of a benchmark."""
    drawn = Picture(
        "scores",
        "What a law wins, and on which plants",
        DRAWN_DOTS if benchmark.rules.draws else DOTS,
        "Ratios to P-PI of rope snap, stiffness and tracking, by law.",
        benchmark.chart,
    )
    rules, (judgment, sentence), count = benchmark.rules, advice(benchmark), len(benchmark.plants)
    stated = [
        ("To be cited as", citation(benchmark)),
        *rules.stated(),
        ("Versions", ", ".join(f"{name} {value}" for name, value in benchmark.versions.items())),
    ]
    # units by plant: the page has linear and rotary axes
    grids = [benchmark.on(name).grid(_units(benchmark, name)) for name in benchmark.plants]
    described = Facts((name, rules.described(name)) for name in benchmark.plants)
    unplaced = Facts((f"{law}, {where}", why) for law, where, why in reasons(benchmark).marked().rows)
    return Report(
        f"Control laws on {count} plant{'s' if count > 1 else ''}",
        "feeddrive benchmark",
        Verdict((sentence, citation(benchmark)), good=not judgment.bad),
        (
            Section("scores", "Scores", score_tables(benchmark)),
            Section("winners", "Who wins where", (benchmark.winners(),)),
            Section("unplaced", "No place", (unplaced,)),
            Section("plants", "Plants", (described, *grids), folded=True),
            facts("Rules", stated),
        ),
        drawn,
    )


def _units(benchmark: Benchmark, plant: str) -> Units:
    return replace(DRAWN, rotary=benchmark.rules.plants[plant].loop.axis.rotary)


def reasons(benchmark: Benchmark) -> Table:
    """Return a table of the laws that are not ranked, with plants and reasons."""
    rows = [
        [law, "all" if len(plants) == len(benchmark.plants) else ", ".join(plants), why]
        for law, plants_by_reason in benchmark.unplaced().items()
        for why, plants in plants_by_reason.items()
    ]
    return Table("Laws without a place, and why", ["law", "plants", "reason"], rows, sentences=2)


def summary(benchmark: Benchmark) -> dict[str, Any]:
    """Return all results as plain numbers in SI units; infinity is the text "infinite"."""
    return {
        "citation": citation(benchmark),
        "rules": benchmark.rules.numbers(),
        "rules_sha256": benchmark.rules.digest(),
        "seed": benchmark.own,
        "versions": dict(benchmark.versions),
        "variants": {
            name: [{"plant": row.plant, "law": row.name} | row.record() for row in (*variant.rows, *variant.references)]
            for name, variant in benchmark.variants.items()
        },
        "references": [{"plant": row.plant, "law": row.name} | row.record() for row in benchmark.references],
        **_scores(benchmark),
        "rows": [{"plant": row.plant, "law": row.name, "recipe": row.recipe} | row.record() for row in benchmark.rows],
    }


def _scores(benchmark: Benchmark) -> dict[str, Any]:
    """Return the scores of the laws, on drawn plants by groups: a mean is over the same plants as those beside it."""
    if benchmark.rules.draws:
        return {"groups": [_group(benchmark, group) for group in benchmark.groups()]}
    laws = (*benchmark.laws, *benchmark.recipes)
    return {"scores": {law: {figure.key: vars(benchmark.score(law, figure)) for figure in FIGURES} for law in laws}}


def _group(benchmark: Benchmark, group: Group) -> dict[str, Any]:
    """Return the standings of the laws on the plants of a group, best first, and the decided places by the figures by
    which laws are ranked.
    """

    def standings(figure: Figure, *, effort: bool) -> list[dict[str, Any]]:
        order = order_of(benchmark, group, figure, effort=effort)
        return [row._asdict() | {"settled": row.law not in order.unsettled} for row in order.standings]

    decisions = {figure.key: decision_of(benchmark, group, figure) for figure in RANKED_BY}
    return {
        "name": group.name,
        "plants": list(group.plants),
        "at_equal_robustness": {figure.key: standings(figure, effort=False) for figure in RANKED_BY},
        "at_equal_effort": {figure.key: standings(figure, effort=True) for figure in RANKED_BY},
        "decided_places": {
            key: {law: list(decision.places(law)) for law in decision.order.laws} for key, decision in decisions.items()
        },
    }


def figures_csv(benchmark: Benchmark) -> str:
    """Return CSV with one line per plant and law, in SI units; for rotary axes read rad for m, and N m for N."""
    labels = {
        "plant": [row.plant for row in benchmark.rows],
        "law": [row.name for row in benchmark.rows],
        "unplaced": [row.unplaced for row in benchmark.rows],
    }
    return figures_text(labels, [row.figures for row in benchmark.rows], Units())


def markdown(benchmark: Benchmark) -> str:
    """Return the score tables in Markdown."""
    tables = [*score_tables(benchmark), benchmark.winners()]
    return "\n\n".join([*(table.grid().markdown() for table in tables), f"{citation(benchmark)}."]) + "\n"


def latex(benchmark: Benchmark) -> str:
    """Return the score tables as LaTeX tabulars, with the citation in a comment."""
    tables = score_tables(benchmark) if benchmark.rules.draws else [benchmark.table()]
    return "\n".join([f"% {citation(benchmark)}", *(table.grid().latex() for table in tables), ""])
