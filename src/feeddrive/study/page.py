"""The report of a study: a page with charts of its answers, and job files that replay the worst machines.

report.html                        for readers
summary.json                       every answer in SI units
worst/variant_00000012.toml        a job:  feeddrive run worst/variant_00000012.toml
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.files.job import Job
from feeddrive.files.machine import machine_toml
from feeddrive.files.part_program import FILES
from feeddrive.files.run_files import summary_text, versions
from feeddrive.files.section import to_toml
from feeddrive.files.toml_file import quoted
from feeddrive.language.errors import FeeddriveError, plain
from feeddrive.language.table import Cell, Column, Table
from feeddrive.language.text import Text
from feeddrive.loop.machine import Machine
from feeddrive.report.page import html
from feeddrive.report.report import Code, Facts, Picture, Remarks, Report, Section, Verdict, further
from feeddrive.study.answers import (
    Answers,
    correlation,
    decides_chart,
    error_band_chart,
    front_chart,
    histograms_chart,
    interval_text,
    name_of,
    share_text,
    short,
    stiffness_band_chart,
    value_cell,
    yields_chart,
)
from feeddrive.study.statistics import INSIDE, QUANTILES, Share
from feeddrive.study.store import place
from feeddrive.study.study import Study
from feeddrive.study.variants import VariantGroup, variant_groups, variants


def replay_files(study: Study, variant: int) -> dict[str, str]:
    """Return the contents of the replay files by file name: first the job, `variant_00000012.toml`, then the machine,
    `variant_00000012_machine.toml`.

    The controller of the variant becomes that of the machine file, so that the job has a single row, `today`.
    Numbers are written with full precision; the cutting process of a part program becomes a coupling of the machine.

    Raises ParameterError or StructureError for a variant that cannot be built.
    """
    group = next(variant_groups(study, variants(study, variant, 1)))
    system = group.one(0)
    machine = system if isinstance(system, Machine) else Machine.of({group.axis: system})
    file = group.base.job.machine
    # An axis that runs alone makes a machine of one axis, in which the limits of the others would name unknown axes.
    limits = {axis: axis_limits for axis, axis_limits in file.limits.items() if axis in machine.axes()}
    # of a whole machine only: they name all of its joints
    five_axes = file.five_axes if isinstance(system, Machine) else None
    name = f"variant_{variant:08d}"
    origin = f"variant {variant} of the study {Path(study.file.name).name}, row '{group.base.row}'"
    return {
        f"{name}.toml": "\n".join(_job(study, group, f"{name}_machine.toml", origin)),
        f"{name}_machine.toml": machine_toml(
            machine, f"{file.name}, {origin}", file.source, file.remark, limits, five_axes
        ),
    }


def _job(study: Study, group: VariantGroup, machine: str, origin: str) -> Iterator[str]:
    """Yield the sections of the job file."""
    job = group.base.job
    values: dict[str, Any] = {"title": f"{study.title}: {origin}", "machine": machine, "axis": group.axis}
    values |= {"seed": int(group.seed[0])} | ({} if group.duration is None else {"duration": group.duration})
    yield "\n".join(f"{key} = {_written(value)}" for key, value in values.items()) + "\n"
    references, loads = _by_axis(group.references, group.axis), _by_axis(group.loads, group.axis)
    if job.program is not None:
        # The motions follow from the program when the job is read, and a job has a program or a reference, not both.
        yield _program(job)
        references = {}
    rotary = {axis: loop.axis.rotary for axis, loop in group.system.loops().items()}
    for kind, blocks in (("reference", references), ("load", loads)):
        for axis, block in blocks.items():
            key = kind if axis == group.axis else f"others.{axis}.{kind}"
            yield to_toml(block, key, rotary=rotary[axis])


def _by_axis(blocks: Any, axis: str) -> Mapping[str, Reference | Load]:
    """Return motions or loads by axis name; an empty mapping if there are none."""
    if blocks is None:
        return {}
    return blocks if isinstance(blocks, Mapping) else {axis: blocks}


def _program(job: Job) -> str:
    """Return the section [program], with absolute file paths."""
    assert job.program is not None
    # The replayed job lies in another folder, where relative paths would lead nowhere.
    folder = Path(job.file.name).parent
    values = dict(job.file.content["program"])
    for key in FILES:
        if isinstance(values.get(key), str):
            path = job.program.file if key == "file" and job.program.file is not None else folder / values[key]
            values[key] = str(path.resolve())
    return "\n".join(["[program]", *(f"{key} = {_written(value)}" for key, value in values.items())]) + "\n"


def _written(value: Any) -> str:
    """Return a value in TOML syntax: a string, a boolean, a number, or an inline table of such values."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{quoted(key)} = {_written(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, bool):
        return "true" if value else "false"
    # `repr` of a float reads back to the same bits
    return quoted(value) if isinstance(value, str) else repr(value)


_FRONT = 40  # largest number of machines in a table
_REPLAYED = 3  # failed variants for which a job file is written
_ITS_INTERVAL = (
    "Brackets: 95 % interval of the share of all machines that such tolerances make, after Clopper and Pearson. It "
    "holds the true share in at least 95 of 100 studies of independent machines."
)
_NARROWER = {
    "latin_hypercube": " A Latin hypercube spreads its machines more evenly than chance does: it holds more often.",
    "sobol": " A Sobol sequence spreads its machines more evenly than chance does: it holds more often.",
}


def write_report(answers: Answers, out: str | Path) -> Path | str:
    """Write the files of the report into a directory or to an fsspec address; return the path of the report.

    Raises FileError for a file that cannot be written.
    """
    # All texts are made before the first is written: an error in one of them leaves no half report.
    there, files = place(out), dict(report_files(answers))
    for name, text in files.items():
        there.write(name, text.encode("utf-8"))
    # Path would fold the `//` of an address.
    return f"{there.address}/report.html" if "://" in there.address else Path(there.address) / "report.html"


def report_files(answers: Answers) -> Iterator[tuple[str, str]]:
    """Yield the name and text of each file of the report; there is no job file for a variant that cannot be built."""
    yield "report.html", html(study_report(answers))
    yield "summary.json", summary_text(summary(answers), rotary=answers.rotary, quoted=answers.quoted)
    chosen = [worst.cases[0].variant for worst in answers.worst] + [variant for variant, _ in answers.bad[:_REPLAYED]]
    # One variant is often the worst in several figures.
    for variant in sorted(set(chosen)):
        try:
            texts = replay_files(answers.study, variant)
        except FeeddriveError:
            # The rows already hold its reason.
            continue
        for name, text in texts.items():
            yield f"worst/{name}", text


def study_report(answers: Answers) -> Report:
    """Return the report of a study; its page is smaller than 1 MB."""
    study = answers.study
    interval = (
        "Points of a grid are no sample: their share has no interval."
        if study.sampler == "grid"
        else _ITS_INTERVAL + _NARROWER.get(study.sampler, "")
    )
    left_out = [f"Variant {variant} has no figures: {plain(reason)}" for variant, reason in answers.bad]
    again = (
        "Each is a job with its machine beside it: feeddrive run worst/variant_NUMBER.toml gives its figures again, "
        "with all signals over time."
    )
    same = (
        "The same study with the same version of feeddrive gives the same rows to the last bit, on any number of "
        "workers."
    )
    overview = Picture(
        "yield",
        "Machines that keep the specification",
        "Each bound by itself, and all together.",
        "Share of the machines that keep each bound, with its interval.",
        lambda: yields_chart(answers.yields),
    )
    front = _front(answers)
    return Report(
        study.title,
        "feeddrive study",
        Verdict(answers.sentences),
        (
            Section("yield", "Yield", (answers.table(), *_choices(answers), interval, Remarks(left_out))),
            Section("worst", "Worst cases", (again, _worst(answers))),
            further(_pictures(answers)),
            Section("decides", "What decides", (_method(answers), *_decides(answers))),
            Section("front", "Pareto front", () if front is None else (front,)),
            Section(
                "repeat", "How to repeat it", (same, Facts(_facts(answers)), Code("Study", study.text)), folded=True
            ),
        ),
        overview,
        answers.rotary,
    )


def _choices(answers: Answers) -> Iterator[Table]:
    for column, shares in answers.yields.choices.items():
        rows = [[value, share.of, interval_text(share)] for value, share in shares.items()]
        columns = [column, Column("machines", "", ",.0f"), "inside"]
        yield Table(f"Machines inside the specification by {column}", columns, rows)


def _worst(answers: Answers) -> Table:
    columns = answers.study.columns
    rows = [
        [
            name_of(worst.figure),
            case.variant,
            value_cell(worst.figure, case.value),
            *(_cell(case.varied[name]) for name in columns),
        ]
        for worst in answers.worst
        for case in worst.cases[:1]
    ]
    heads = ["figure", "variant", "value", *_columns(columns)]
    return Table("The worst machine by each figure, with what varies in it", heads, rows)


def _columns(columns: Mapping[str, str]) -> list[Column]:
    """Return the table columns of the varied numbers, from a mapping of name to SI unit."""
    names = short(list(columns))
    return [Column(names[name], unit) for name, unit in columns.items()]


def _cell(value: Any) -> Cell:
    return value if isinstance(value, float) else str(value)


def _method(answers: Answers) -> str:
    if answers.sobol:
        first = answers.sobol[0]
        left = (
            f" {first.without} points were left out: a variant of theirs has no number there." if first.without else ""
        )
        return (
            f"Sobol indices from {first.points:,} points: alone, the share of the variance that would be gone if this "
            "did not vary; together, what would be left if only this varied. Intervals: 95 %, by bootstrap over the "
            f"points; estimates from few points may lie beyond 0 and 100 %.{left}"
        )
    return (
        "Rank correlations: the square is the share of the variance of the ranks that goes with a quantity, if what it "
        'does is monotone. Shares of the variance without that condition are Sobol indices: sampler = "saltelli", and '
        "count = a power of 2."
    )


def _decides(answers: Answers) -> Iterator[Table]:
    figures = {figure.key: name_of(figure) for figure in answers.study.measure} | {INSIDE: "inside the specification"}
    if answers.sobol:
        factors = answers.sobol[0].factors
        names = [short(factors)[factor] for factor in factors]
        for what, how in (("first", "alone"), ("total", "together with what it does with others")):
            rows = [
                [
                    figures[indices.output],
                    *(
                        share_text(value, interval)
                        for value, interval in zip(
                            getattr(indices, what), getattr(indices, f"{what}_interval").T, strict=True
                        )
                    ),
                ]
                for indices in answers.sobol
            ]
            yield Table(
                f"Share of the variance that each decides {how}, with its 95 % interval", ["figure", *names], rows
            )
    columns = list(dict.fromkeys(rank.column for rank in answers.correlations))
    by = {(rank.output, rank.column): rank.value for rank in answers.correlations}
    rows = [
        [
            figures[output],
            *(Text(correlation(by[output, column])) if (output, column) in by else None for column in columns),
        ]
        for output in dict.fromkeys(rank.output for rank in answers.correlations)
    ]
    if rows:
        yield Table("Rank correlations", ["figure", *(short(columns)[column] for column in columns)], rows)


def _pictures(answers: Answers) -> Iterator[Picture]:
    study = answers.study
    yield Picture(
        "spread",
        "Distributions",
        "Of each figure over the machines; dashed: its bound.",
        "Histograms of the figures over the machines.",
        lambda: histograms_chart(answers.sample, answers.stiffness is not None),
    )
    if answers.sobol or answers.correlations:
        yield Picture(
            "decides",
            "Sensitivity",
            "Of the figures with a bound, and of being inside of all bounds.",
            "Bars of what decides the figures, with intervals.",
            lambda: decides_chart(study, answers.sobol, answers.correlations),
        )
    if answers.stiffness is not None:
        stiff = answers.stiffness
        yield Picture(
            "stiff",
            "Dynamic stiffness over frequency",
            f"Of {stiff.machines:,} machines, at the measured frequencies, with straight lines between them.",
            "Quantile bands of the dynamic stiffness over frequency.",
            lambda: stiffness_band_chart(stiff),
        )
    if answers.error is not None:
        error = answers.error
        yield Picture(
            "error",
            "Following error over time",
            f"Of {error.machines} machines that were run again: the largest absolute value in each of "
            f"{error.x.size} windows.",
            "Quantile bands of the following error over time.",
            lambda: error_band_chart(error),
        )
    if answers.front is not None:
        front = answers.front
        yield Picture(
            "front",
            f"Between {' and '.join(front.figures)}" if len(front.figures) < 3 else "Tracking, stiffness, robustness",
            "Rings: the Pareto front. No other machine is better in one of them and as good in all others.",
            "Scatter of the machines with the Pareto front.",
            lambda: front_chart(front, answers.sample),
        )


def _front(answers: Answers) -> Table | None:
    if answers.front is None:
        return None
    rows, figures = answers.front.rows, list(answers.front.figures.values())
    columns = answers.study.columns
    body = [
        [
            int(rows.variant[i]),
            *(value_cell(figure, float(rows.figures[figure.key][i])) for figure in figures),
            "inside" if rows.inside[i] else "outside",
            *(_cell(rows.varied[name][i]) for name in columns),
        ]
        for i in range(min(_FRONT, rows.variant.size))
    ]
    beyond = f", the first {_FRONT}" if rows.variant.size > _FRONT else ""
    title = f"{rows.variant.size:,} machines of which no other one is better in all{beyond}"
    return Table(title, ["variant", *map(name_of, figures), "specification", *_columns(columns)], body)


def _facts(answers: Answers) -> list[tuple[str, str]]:
    study = answers.study
    base = next(study.bases())
    return [
        ("Machine", base.job.machine.name),
        ("Source of its numbers", base.job.machine.source or "not stated"),
        ("Job", f"{base.job.title}, row '{study.row}'"),
        ("Variants", f"{study.count:,}, sampler {study.sampler}, seed {study.seed}, noise: {study.noise}"),
        ("Digest", study.digest),
        *((name, version) for name, version in versions().items()),
    ]


def summary(answers: Answers) -> dict[str, Any]:
    """Return all answers as plain numbers in SI units; missing numbers are None."""
    study = answers.study
    return {
        "title": study.title,
        "digest": study.digest,
        "variants": study.count,
        "sampler": study.sampler,
        "seed": study.seed,
        "versions": versions(),
        "sentences": answers.sentences,
        "yield": _share(answers.yields.inside)
        | {
            "without_figures": answers.yields.bad,
            "bounds": {
                bound_yield.bound.figure.key: {"least": bound_yield.bound.least, "most": bound_yield.bound.most}
                | _share(bound_yield.kept)
                | {"break_only_this": bound_yield.alone}
                for bound_yield in answers.yields.bounds
            },
            "choices": {
                column: {value: _share(share) for value, share in shares.items()}
                for column, shares in answers.yields.choices.items()
            },
        },
        "worst": {
            worst.figure.key: [
                {"variant": case.variant, "value": _plain(case.value), "varied": dict(case.varied)}
                for case in worst.cases
            ]
            for worst in answers.worst
        },
        "bad": [{"variant": variant, "reason": reason} for variant, reason in answers.bad],
        "sobol": {
            indices.output: {"points": indices.points, "points_left_out": indices.without, "factors": _factors(indices)}
            for indices in answers.sobol
        },
        "rank_correlations": _ranked(answers),
        "bands": {
            name: {
                over: band.x.tolist(),
                "machines": band.machines,
                **{f"quantile_{quantile:g}": [_plain(v) for v in band.at(quantile).tolist()] for quantile in QUANTILES},
            }
            for name, band, over in (
                ("stiffness_N_per_m", answers.stiffness, "frequency_Hz"),
                ("following_error_m", answers.error, "time_s"),
            )
            if band is not None
        },
        "front": None
        if answers.front is None
        else {
            "figures": {subject: figure.key for subject, figure in answers.front.figures.items()},
            "variants": answers.front.rows.variant.tolist(),
        },
    }


def _share(share: Share) -> dict[str, Any]:
    return {
        "machines": share.of,
        "inside": share.kept,
        "share": share.value,
        "interval_95_percent": None if share.interval is None else list(share.interval),
    }


def _factors(indices: Any) -> Mapping[str, Any]:
    return {
        name: {
            "alone": float(indices.first[i]),
            "alone_interval_95_percent": indices.first_interval[:, i].tolist(),
            "together": float(indices.total[i]),
            "together_interval_95_percent": indices.total_interval[:, i].tolist(),
        }
        for i, name in enumerate(indices.factors)
    }


def _ranked(answers: Answers) -> dict[str, dict[str, Any]]:
    ranked: dict[str, dict[str, Any]] = {}
    for rank in answers.correlations:
        interval = None if rank.interval is None else list(rank.interval)
        ranked.setdefault(rank.output, {})[rank.column] = {"value": rank.value, "interval_95_percent": interval}
    return ranked


def _plain(value: float) -> float | str | None:
    """Return a number for JSON: itself if finite, None for NaN, "infinite" if infinite."""
    # JSON has neither NaN nor infinity.
    if np.isnan(value):
        return None
    return value if np.isfinite(value) else "infinite"
