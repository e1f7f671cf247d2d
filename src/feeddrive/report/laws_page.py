"""The report about laws over the same work as one page: its tables, and the values of the template `laws.html`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from feeddrive.analysis.replay import Replay
from feeddrive.language import tree
from feeddrive.language.declaration import Declaration
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Table, shown
from feeddrive.report import part_page, sentences
from feeddrive.report.figures import chosen, figures
from feeddrive.report.page import Entry, LawsReport, ShownTable, render
from feeddrive.report.part_page import ran
from feeddrive.report.sentences import decibel, number, percent


def build(contents: LawsReport) -> str:
    """The report as one HTML page: no scripts, no other files, less than 1 MB (of a part program 1.5 MB).

    Pure: the same contents give the same text.  Raises ParameterError for contents without entries.
    """
    if not contents.entries:
        raise ParameterError("a report needs at least one law")
    along = ran(contents)
    drawn = [*contents.pictures, *part_page.pictures(contents), *figures(contents)]
    replay = next((entry.replay for entry in contents.entries if entry.replay is not None), None)
    rule = [("Rule of comparison", contents.rule)] if contents.rule else []
    return render(
        "laws.html",
        rotary=contents.entries[0].loop.axis.rotary,
        quoted=(contents.title, *contents.quoted, *(each.name for each in contents.entries)),
        title=contents.title,
        lead=part_page.lead(contents) if along else sentences.result(contents),
        links=[
            ("result", "Result"),
            ("facts", "What was run"),
            *((f"figure-{each.key}", each.title) for each in drawn),
            ("repeat", "How to repeat it"),
        ],
        tables=[
            *([prediction(replay)] if replay is not None else []),
            *part_page.tables(contents),
            *contents.extras,
            *([] if along else [errors(contents)]),
        ],
        limits=limits(contents),
        robustness=frequency(contents),
        remarks=sentences.remarks(contents),
        facts=[
            *contents.facts.items(),
            *((f"Law '{each.name}'", each.description) for each in contents.entries),
            *rule,
        ],
        overview=contents.overview,
        pictures=drawn,
        laws=len(contents.entries),
        drawn_laws=len(chosen(contents).entries),
        job=contents.job,
        versions=contents.versions,
        parameters=parameters(contents),
    )


def errors(contents: LawsReport) -> ShownTable:
    """RMS and peak errors and force of each law."""
    columns: list[tuple[str, list[float]]] = [
        ("following error RMS µm", [1e6 * entry.rms("following_error") for entry in contents.entries]),
        ("peak µm", [1e6 * entry.peak("following_error") for entry in contents.entries]),
        ("tracking error RMS µm", [1e6 * entry.rms("tracking_error") for entry in contents.entries]),
        ("peak µm", [1e6 * entry.peak("tracking_error") for entry in contents.entries]),
    ]
    rows: list[list[str]] = []
    for i, entry in enumerate(contents.entries):
        cells = [number(values[i]) for _, values in columns]
        rows.append([entry.name, *cells, _against(entry, "force", "peak"), _against(entry, "force", "rms")])
    best = [_least(values) for _, values in columns] + [None, None]
    heads = ["law", *(head for head, _ in columns), "force peak N", "force RMS N"]
    said = (
        "Errors and force. Following error: setpoint minus the controller's reading. "
        "Tracking error: setpoint minus true position."
    )
    return ShownTable(Table(said, heads, rows), best if len(rows) > 1 else ())


def _against(entry: Entry, signal: str, what: str) -> str:
    """A force, and in brackets its share of the limit."""
    value = entry.peak(signal) if what == "peak" else entry.rms(signal)
    bounds = entry.limits
    limit = (
        bounds.get("motor continuous (RMS)")
        if what == "rms"
        else bounds.get("motor peak", bounds.get("commanded limit"))
    )
    return number(value) if limit is None else f"{number(value)} ({percent(value / limit)})"


def limits(contents: LawsReport) -> str:
    """One sentence on what the percentages of the forces refer to."""
    stated = contents.entries[0].limits
    if not stated:
        return "The machine file states no force limits."
    listed = ", ".join(f"{name} {number(limit, 4)} N" for name, limit in stated.items())
    return f"Percentages of force: peak against the peak limit, RMS against the continuous one. Stated: {listed}."


def frequency(contents: LawsReport) -> list[ShownTable]:
    """Margins, sensitivity peak and stiffness of each law; none if no law has a loop gain."""
    if all(entry.margins is None and entry.stiffness is None for entry in contents.entries):
        return []
    rows: list[list[str]] = []
    for entry in contents.entries:
        m, k = entry.margins, entry.stiffness
        row = [entry.name]
        if m is None:
            row += ["–"] * 6
        else:
            delay = number(None if m.delay_margin is None else 1e3 * m.delay_margin)
            if m.delay_margin_samples is not None:
                delay += f" ({number(m.delay_margin_samples)})"
            row += [
                number(m.crossover),
                decibel(m.phase_margin_deg),
                decibel(m.gain_increase_dB),
                decibel(m.gain_reduction_dB),
                delay,
                f"{number(m.sensitivity_peak)} ({number(m.modulus_frequency)})",
            ]
        row.append("–" if k is None else f"{number(1e-6 * k.minimum)} ({number(k.minimum_frequency)})")
        row.append("–" if k is None or not k.frequency[0] <= 1.0 <= k.frequency[-1] else number(1e-6 * k.at(1.0)))
        rows.append(row)
    heads = [
        "law", "crossover Hz", "phase margin deg", "gain may rise dB", "gain may fall dB",
        "delay margin ms (samples)" if _sampled(contents) else "delay margin ms", "Ms (at Hz)",
        "least stiffness N/µm (at Hz)", "stiffness at 1 Hz N/µm",
    ]  # fmt: skip
    title = "Robustness and stiffness, of the loop in motion, opened at the drive."
    return [ShownTable(Table(title, heads, rows))]


def _sampled(contents: LawsReport) -> bool:
    return any(
        entry.margins is not None and entry.margins.delay_margin_samples is not None for entry in contents.entries
    )


def prediction(replay: Replay) -> ShownTable:
    """Measured and predicted."""
    found = replay.table()
    rows = [
        [cell.replace("um", "µm") if i == 1 else "–" if cell == "-" else cell for i, cell in enumerate(row)]
        for row in found.grid().rows
    ]
    return ShownTable(Table(f"{found.title[0].upper()}{found.title[1:]}.", found.heads, rows))


def parameters(contents: LawsReport) -> ShownTable:
    """Every parameter of every law with its unit and meaning; rows in which the laws differ are marked."""
    rows: dict[str, tuple[Declaration, list[Any]]] = {}
    count = len(contents.entries)
    for i, entry in enumerate(contents.entries):
        for name, value in tree.parameters(entry.loop).items():
            row = rows.setdefault(name, (tree.declaration(entry.loop, name), [None] * count))
            row[1][i] = value
    body: list[list[str]] = []
    for name in sorted(rows, key=_place):
        declaration, values = rows[name]
        unit, factor = declaration.unit, 1.0
        if unit == "m":
            unit, factor = shown("m")
        cells = [number(factor * float(value), 6) if value is not None else "–" for value in values]
        differs = count > 1 and any(value != values[0] for value in values)
        body.append(
            [f"{name} *" if differs else name, *map(_trimmed, cells), unit.replace("um", "µm"), declaration.meaning]
        )
    heads = ["parameter", *(entry.name for entry in contents.entries), "unit", "meaning"]
    note = "Parameters of the loop; * marks those in which the laws differ." if count > 1 else "Parameters of the loop."
    return ShownTable(Table(note, heads, body))


def _place(name: str) -> int:
    """Control before axis, otherwise as in the loop."""
    return 0 if ".control." in name else 1


def _trimmed(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text


def _least(values: Sequence[float]) -> int | None:
    low = min(range(len(values)), key=values.__getitem__)
    return low if sum(value <= values[low] * 1.0001 for value in values) == 1 else None
