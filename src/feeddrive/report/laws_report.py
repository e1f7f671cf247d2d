"""The report about laws over the same work: its tables, and which section they stand in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from feeddrive.analysis.replay import Replay
from feeddrive.language import tree
from feeddrive.language.declaration import Declaration
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, number, unit_name
from feeddrive.language.table import UNIT, Cell, Column, Table
from feeddrive.language.text import Text, joined
from feeddrive.report import part_report, sentences
from feeddrive.report.laws import Entry, LawsContents
from feeddrive.report.laws_pictures import chosen, pictures
from feeddrive.report.part_report import ran
from feeddrive.report.report import Code, Facts, Marked, Part, Remarks, Report, Section, Verdict, facts


def laws_report(contents: LawsContents) -> Report:
    """Return the report; its page has less than 1 MB (of a part program 1.5 MB).

    Raises ParameterError for contents without entries.
    """
    if not contents.entries:
        raise ParameterError("a report needs at least one law")
    along = ran(contents)
    drawn = [*contents.pictures, *part_report.pictures(contents), *pictures(contents)]
    first = contents.overview or next(iter(drawn), None)
    replay = next((entry.replay for entry in contents.entries if entry.replay is not None), None)
    rule = [("Rule of comparison", contents.rule)] if contents.rule else []
    laws, shown = len(contents.entries), len(chosen(contents).entries)
    some = f"The pictures show {shown} of {laws} laws: the first, and those that follow best." if shown < laws else ""
    tables: list[Part] = [
        *([prediction(replay)] if replay is not None else []),
        *part_report.tables(contents),
        *contents.extras,
        *([] if along else [errors(contents)]),
        limits(contents),
        *frequency(contents),
        Remarks(sentences.remarks(contents)),
    ]
    sentences_ = part_report.lead(contents) if along else sentences.result(contents)
    tripped = any(np.any(entry.run["trip"] > 0.0) for entry in contents.entries)
    same = "The same job, with the same versions and seed, gives the same numbers to the last bit."
    return Report(
        contents.title,
        contents.command,
        Verdict(sentences_, good=False if tripped else None),
        (
            Section("result", "Result", tables),
            Section("pictures", "Pictures", (some, *(picture for picture in drawn if picture is not first))),
            *contents.details,
            Section("details", "Axes, motors, spindle and observers", part_report.details(contents), folded=True),
            facts(
                "What was run",
                [
                    *contents.facts.items(),
                    *((f"Law '{entry.name}'", entry.description) for entry in contents.entries),
                    *rule,
                ],
            ),
            Section("parameters", "All parameters", (parameters(contents),), folded=True),
            Section(
                "repeat",
                "How to repeat it",
                (same, *([Code("Job", contents.job)] if contents.job else []), Facts(contents.versions)),
                folded=True,
            ),
        ),
        first,
        contents.entries[0].loop.axis.rotary,
    )


def errors(contents: LawsContents) -> Marked:
    """Tabulate RMS and peak errors and force of each law."""
    figures = [
        (
            entry.rms("following_error"),
            entry.peak("following_error"),
            entry.rms("tracking_error"),
            entry.peak("tracking_error"),
        )
        for entry in contents.entries
    ]
    rows = [
        [entry.name, *errors, _against(entry, "force", "peak"), _against(entry, "force", "rms")]
        for entry, errors in zip(contents.entries, figures, strict=True)
    ]
    best = [*map(_least, zip(*figures, strict=True)), None, None]
    heads = ("following error RMS", "peak", "tracking error RMS", "peak")
    columns = [
        Column("law"),
        *(Column(head, "m", "3") for head in heads),
        Column("force peak", "N"),
        Column("force RMS", "N"),
    ]
    title = (
        "Errors and force. Following error: setpoint minus the controller's reading. "
        "Tracking error: setpoint minus true position."
    )
    return Marked(Table(title, columns, rows), best if len(rows) > 1 else ())


def _against(entry: Entry, signal: str, what: str) -> Text:
    """Return a force, and in brackets its share of the limit."""
    value = entry.peak(signal) if what == "peak" else entry.rms(signal)
    bounds = entry.limits
    limit = (
        bounds.get("motor continuous (RMS)")
        if what == "rms"
        else bounds.get("motor peak", bounds.get("commanded limit"))
    )
    share = "" if limit is None else f" ({Quantity(value / limit, 'share'):3})"
    return Text(f"{Quantity(value, 'N', bare=True):3}{share}")


def limits(contents: LawsContents) -> str:
    """Return a sentence on the limits to which the percentages of the forces refer."""
    stated = contents.entries[0].limits
    if not stated:
        return "The machine file states no force limits."
    listed = joined(", ", (f"{name} {Quantity(limit, 'N')}" for name, limit in stated.items()))
    return Text(f"Percentages of force: peak against the peak limit, RMS against the continuous one. Stated: {listed}.")


def frequency(contents: LawsContents) -> list[Table]:
    """Tabulate margins, sensitivity peak and stiffness of each law; no table if no law has a loop gain."""
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
                m.crossover,
                m.phase_margin_deg,
                m.gain_increase_dB,
                m.gain_reduction_dB,
                None if delay is None else Text(f"{delay}{samples}"),
                Text(f"{number(m.sensitivity_peak, 3)} ({Quantity(m.modulus_frequency, 'Hz', bare=True):3})"),
            ]
        at = "" if k is None else f"{Quantity(k.minimum_frequency, 'Hz', bare=True):3}"
        row.append(None if k is None else Text(f"{Quantity(k.minimum, 'N/m', bare=True):3} ({at})"))
        row.append(None if k is None or not k.frequency[0] <= 1.0 <= k.frequency[-1] else k.at(1.0))
        rows.append(row)
    hertz, stiff = unit_name("Hz"), unit_name("N/m")
    columns = [
        Column("law"),
        Column("crossover", "Hz", "3"),
        Column("phase margin", "deg", ".1f"),
        Column("gain may rise", "dB", ".1f"),
        Column("gain may fall", "dB", ".1f"),
        Column(f"delay margin {unit_name('s')}{' (samples)' if _sampled(contents) else ''}"),
        Column(f"Ms (at {hertz})"),
        Column(f"least stiffness {stiff} (at {hertz})"),
        Column("stiffness at 1 Hz", "N/m", "3"),
    ]
    title = "Robustness and stiffness, of the loop in motion, opened at the drive."
    return [Table(title, columns, rows)]


def _sampled(contents: LawsContents) -> bool:
    return any(
        entry.margins is not None and entry.margins.delay_margin_samples is not None for entry in contents.entries
    )


def prediction(replay: Replay) -> Table:
    """Tabulate measured against predicted signals."""
    return replay.table()


def parameters(contents: LawsContents) -> Table:
    """Tabulate every parameter of every law with its unit and meaning; rows in which the laws differ are marked."""
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
    heads: list[Column | str] = ["parameter", *(entry.name for entry in contents.entries), "unit"]
    note = "Parameters of the loop; * marks those in which the laws differ." if count > 1 else "Parameters of the loop."
    return Table(note, [*heads, Column("meaning", sentences=True)], body)


def _place(name: str) -> int:
    """Sort the control before the axis, otherwise as in the loop."""
    return 0 if ".control." in name else 1


def _least(values: Sequence[float]) -> int | None:
    low = min(range(len(values)), key=values.__getitem__)
    return low if sum(value <= values[low] * 1.0001 for value in values) == 1 else None
