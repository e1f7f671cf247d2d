"""The table of the benchmark for people: report page, CSV, JSON, and Markdown and LaTeX to be cited in a paper."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from feeddrive.benchmark.advice import advice
from feeddrive.benchmark.score import FIGURES, Benchmark
from feeddrive.benchmark.work import ROBUST
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.run_files import summary_text
from feeddrive.language.quantity import DRAWN, Quantity
from feeddrive.language.table import Cell, Column, Grid, Table
from feeddrive.language.text import Text
from feeddrive.report.page import html
from feeddrive.report.report import Facts, Picture, Report, Section, Verdict, facts

CITE = "feeddrive benchmark of feed-drive control laws"
_LATEX = str.maketrans({"%": r"\%", "&": r"\&", "_": r"\_", "±": r"$\pm$", "½": r"\textonehalf{}", "^": ""})


def write_benchmark(found: Benchmark, out: str | Path) -> Path:
    """Write the directory whole or not at all, and return the path of the report.

    Raises FileError if `out` cannot be written, or is a directory that feeddrive did not write.
    """
    with new_directory(out) as folder:
        (folder / "report.html").write_text(html(benchmark_report(found)), encoding="utf-8")
        (folder / "summary.json").write_text(summary_text(summary(found)), encoding="utf-8")
        (folder / "figures.csv").write_text(figures_csv(found), encoding="utf-8")
        (folder / "table.md").write_text(markdown(found), encoding="utf-8")
        (folder / "table.tex").write_text(latex(found), encoding="utf-8")
    return Path(out) / "report.html"


def citation(found: Benchmark) -> str:
    """What a paper says beside the table."""
    seed = f", seed {found.own}" if found.own else ""
    return (
        f"{CITE}, rules {found.rules.version} (sha256 {found.rules.digest()[:12]}), feeddrive "
        f"{found.versions['feeddrive']}{seed}"
    )


def benchmark_report(found: Benchmark) -> Report:
    """Return the report of a benchmark."""
    drawn = Picture(
        "scores",
        "What a law wins, and on which plants",
        "Times better than P-PI at equal robustness; a line is a law, a small dot a plant, the large one the "
        "geometric mean.",
        "Ratios to P-PI of rope snap, stiffness and tracking, by law.",
        found.chart,
    )
    rules, (judgment, sentence) = found.rules, advice(found)
    stated = [
        ("To be cited as", citation(found)),
        (
            "Rule",
            Text(
                f"Ms <= {Quantity(rules.sensitivity_peak)}, delay margin >= "
                f"{Quantity(rules.delay_margin_samples, 'samples')}, noise in the force at most "
                f"{Quantity(rules.noise_ratio)} times that of P-PI, at every position of a plant"
            ),
        ),
        ("Searches", f"{rules.repeats} whole tunings of each law on each plant; settled if all end within 5 %"),
        ("Runs", f"{rules.seeds} with different noise at each position; the worst figure counts"),
        ("Versions", ", ".join(f"{name} {value}" for name, value in found.versions.items())),
    ]
    plants = [(name, rules.plants[name]) for name in found.plants]
    return Report(
        f"Control laws on {_plants(found)}",
        "feeddrive benchmark",
        Verdict((sentence, citation(found)), good=not judgment.bad),
        (
            Section("scores", "Scores", (found.table(), *([found.recipe_table()] if found.recipes else []))),
            Section("winners", "Who wins where", (found.winners(),)),
            Section(
                "unplaced",
                "No place",
                (Facts((f"{law}, {where}", why) for law, where, why in reasons(found).marked().rows),),
            ),
            Section(
                "plants",
                "Plants",
                (
                    Facts((name, f"{plant.title}. {plant.source}. {plant.remark}") for name, plant in plants),
                    *(_of_plant(found, name) for name in found.plants),
                ),
                folded=True,
            ),
            facts("Rules", stated),
        ),
        drawn,
    )


def _plants(found: Benchmark) -> str:
    return f"{len(found.plants)} plant{'s' if len(found.plants) > 1 else ''}"


def _of_plant(found: Benchmark, name: str) -> Grid:
    """Return the figures of a plant in its own units: the page has plants that move and plants that turn."""
    rotary = found.rules.plants[name].loop.axis.rotary
    return plant_table(found, name).grid(replace(DRAWN, rotary=rotary))


def reasons(found: Benchmark) -> Table:
    """Which law has no place on which plants, and why."""
    rows = [
        [law, "all" if len(plants) == len(found.plants) else ", ".join(plants), why]
        for law, each in found.unplaced().items()
        for why, plants in each.items()
    ]
    return Table("Laws without a place, and why", ["law", "plants", "reason"], rows, sentences=2)


def plant_table(found: Benchmark, plant: str) -> Table:
    """Return all figures of one plant."""
    rows: list[list[Cell]] = []
    for each in found.rows:
        if each.plant != plant or not each.figures.get(FIGURES[0].key):
            continue
        cells = [_cell(each.figures.get(criterion.key)) for criterion in FIGURES]
        mark = each.unplaced.partition(":")[0]
        rows.append([each.law, *cells, _cell(each.figures.get(ROBUST)), mark])
    columns = ["law", *(each.column() for each in FIGURES), Column("Ms varied", form="3"), ""]
    return Table(f"{plant}: figures", columns, rows)


def _cell(value: float | None) -> Cell:
    return "never" if value is not None and math.isinf(value) else value


def summary(found: Benchmark) -> dict[str, Any]:
    """Everything as plain numbers in SI; what is infinite is the text "infinite"."""
    return {
        "citation": citation(found),
        "rules": found.rules.numbers(),
        "rules_sha256": found.rules.digest(),
        "seed": found.own,
        "versions": dict(found.versions),
        "scores": {
            law: {each.key: vars(found.score(law, each)) for each in FIGURES} for law in (*found.laws, *found.recipes)
        },
        "rows": [
            {
                "plant": each.plant,
                "law": each.law,
                "recipe": each.recipe,
                "unplaced": each.unplaced or None,
                "remark": each.remark or None,
                "spread": each.spread,
                "held": list(each.held),
                "tunables": dict(each.tunables),
                "figures": {
                    key: "infinite" if value is not None and math.isinf(value) else value
                    for key, value in each.figures.items()
                },
            }
            for each in found.rows
        ],
    }


def figures_csv(found: Benchmark) -> str:
    """A line a plant and law, in SI; of axes that turn m is rad, N is N m."""
    keys = list(dict.fromkeys(key for each in found.rows for key in each.figures))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["plant", "law", "unplaced", *keys])
    for each in found.rows:
        cells = (each.figures.get(key) for key in keys)
        writer.writerow(
            [each.plant, each.law, each.unplaced, *("" if cell is None else repr(float(cell)) for cell in cells)]
        )
    return text.getvalue()


def markdown(found: Benchmark) -> str:
    """The tables of scores in Markdown."""
    made = [found.table(), *([found.recipe_table()] if found.recipes else []), found.winners()]
    return "\n\n".join([*map(_markdown, made), f"{citation(found)}."]) + "\n"


def _markdown(table: Table) -> str:
    made = table.grid()
    rows = [made.heads, ["---", *["--:"] * (len(made.heads) - 1)], *made.rows]
    return "\n".join([f"{made.title}.", "", *(f"| {' | '.join(row)} |" for row in rows)])


def latex(found: Benchmark) -> str:
    """The table of scores as a LaTeX tabular (booktabs), its source in a comment."""
    made = found.table().grid()

    def line(cells: Any) -> str:
        return " & ".join(str(cell).translate(_LATEX) for cell in cells) + r" \\"

    head = [f"% {citation(found)}", rf"\begin{{tabular}}{{l{'r' * (len(made.heads) - 1)}}}", r"\toprule"]
    rows = [line(made.heads), r"\midrule", *map(line, made.rows), r"\bottomrule", r"\end{tabular}"]
    return "\n".join([*head, *rows]) + "\n"
