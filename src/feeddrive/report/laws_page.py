"""The report about laws over the same work as one page: its tables, and the values of the template `laws.html`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from feeddrive.analysis.replay import Replay
from feeddrive.language import tree
from feeddrive.language.declaration import Declaration
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, number, unit_name
from feeddrive.language.table import UNIT, Cell, Column, Table
from feeddrive.language.text import Text, capitalized, joined
from feeddrive.report import part_page, sentences
from feeddrive.report.figures import chosen, figures
from feeddrive.report.page import Entry, LawsReport, ShownTable, page_units, render
from feeddrive.report.part_page import ran


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
        units=page_units(rotary=contents.entries[0].loop.axis.rotary),
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
    figures = [
        (entry.rms("following_error"), entry.peak("following_error"), entry.rms("tracking_error"),
         entry.peak("tracking_error"))
        for entry in contents.entries
    ]  # fmt: skip
    rows = [
        [entry.name, *errors, _against(entry, "force", "peak"), _against(entry, "force", "rms")]
        for entry, errors in zip(contents.entries, figures, strict=True)
    ]
    best = [*map(_least, zip(*figures, strict=True)), None, None]
    heads = ("following error RMS", "peak", "tracking error RMS", "peak")
    columns = [Column("law"), *(Column(head, "m", "3") for head in heads),
               Column("force peak", "N"), Column("force RMS", "N")]  # fmt: skip
    title = (
        "Errors and force. Following error: setpoint minus the controller's reading. "
        "Tracking error: setpoint minus true position."
    )
    return ShownTable(Table(title, columns, rows), best if len(rows) > 1 else ())


def _against(entry: Entry, signal: str, what: str) -> Text:
    """A force, and in brackets its share of the limit."""
    value = entry.peak(signal) if what == "peak" else entry.rms(signal)
    bounds = entry.limits
    limit = (
        bounds.get("motor continuous (RMS)")
        if what == "rms"
        else bounds.get("motor peak", bounds.get("commanded limit"))
    )
    share = "" if limit is None else f" ({Quantity(value / limit, 'share'):3})"
    return Text(f"{Quantity(value, 'N', bare=True):3}{share}")


def limits(contents: LawsReport) -> str:
    """One sentence on what the percentages of the forces refer to."""
    stated = contents.entries[0].limits
    if not stated:
        return "The machine file states no force limits."
    listed = joined(", ", (f"{name} {Quantity(limit, 'N')}" for name, limit in stated.items()))
    return Text(f"Percentages of force: peak against the peak limit, RMS against the continuous one. Stated: {listed}.")


def frequency(contents: LawsReport) -> list[ShownTable]:
    """Margins, sensitivity peak and stiffness of each law; none if no law has a loop gain."""
    if all(entry.margins is None and entry.stiffness is None for entry in contents.entries):
        return []
    rows: list[list[Cell]] = []
    for entry in contents.entries:
        m, k = entry.margins, entry.stiffness
        row: list[Cell] = [entry.name]
        if m is None:
            row += [None] * 6
        else:
            delay = None if m.delay_margin is None else Quantity(m.delay_margin, "s", form="3", bare=True)
            samples = "" if m.delay_margin_samples is None else f" ({number(m.delay_margin_samples, 3)})"
            row += [
                m.crossover, m.phase_margin_deg, m.gain_increase_dB, m.gain_reduction_dB,
                None if delay is None else Text(f"{delay}{samples}"),
                Text(f"{number(m.sensitivity_peak, 3)} ({Quantity(m.modulus_frequency, 'Hz', bare=True):3})"),
            ]  # fmt: skip
        at = "" if k is None else f"{Quantity(k.minimum_frequency, 'Hz', bare=True):3}"
        row.append(None if k is None else Text(f"{Quantity(k.minimum, 'N/m', bare=True):3} ({at})"))
        row.append(None if k is None or not k.frequency[0] <= 1.0 <= k.frequency[-1] else k.at(1.0))
        rows.append(row)
    hertz, stiff = unit_name("Hz"), unit_name("N/m")
    columns = [
        Column("law"), Column("crossover", "Hz", "3"), Column("phase margin", "deg", ".1f"),
        Column("gain may rise", "dB", ".1f"), Column("gain may fall", "dB", ".1f"),
        Column(f"delay margin {unit_name('s')}{' (samples)' if _sampled(contents) else ''}"),
        Column(f"Ms (at {hertz})"), Column(f"least stiffness {stiff} (at {hertz})"),
        Column("stiffness at 1 Hz", "N/m", "3"),
    ]  # fmt: skip
    title = "Robustness and stiffness, of the loop in motion, opened at the drive."
    return [ShownTable(Table(title, columns, rows))]


def _sampled(contents: LawsReport) -> bool:
    return any(
        entry.margins is not None and entry.margins.delay_margin_samples is not None for entry in contents.entries
    )


def prediction(replay: Replay) -> ShownTable:
    """Measured and predicted."""
    table = replay.table()
    return ShownTable(replace(table, title=capitalized(f"{table.title}.")))


def parameters(contents: LawsReport) -> ShownTable:
    """Every parameter of every law with its unit and meaning; rows in which the laws differ are marked."""
    rows: dict[str, tuple[Declaration, list[Any]]] = {}
    count = len(contents.entries)
    for i, entry in enumerate(contents.entries):
        for name, value in tree.parameters(entry.loop).items():
            row = rows.setdefault(name, (tree.declaration(entry.loop, name), [None] * count))
            row[1][i] = value
    body: list[list[Cell]] = []
    for name in sorted(rows, key=_place):
        declaration, values = rows[name]
        form = "6" if declaration.unit == "m" else "6 SI"
        cells = [
            None if value is None else Quantity(float(value), declaration.unit, form=form, stays=True)
            for value in values
        ]
        differs = count > 1 and any(value != values[0] for value in values)
        body.append([f"{name} *" if differs else name, *cells, UNIT, declaration.meaning])
    heads = ["parameter", *(entry.name for entry in contents.entries), "unit", "meaning"]
    note = "Parameters of the loop; * marks those in which the laws differ." if count > 1 else "Parameters of the loop."
    return ShownTable(Table(note, heads, body))


def _place(name: str) -> int:
    """Control before axis, otherwise as in the loop."""
    return 0 if ".control." in name else 1


def _least(values: Sequence[float]) -> int | None:
    low = min(range(len(values)), key=values.__getitem__)
    return low if sum(value <= values[low] * 1.0001 for value in values) == 1 else None
