"""The report of `feeddrive tune`, and the files beside it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from feeddrive.artefacts import plot
from feeddrive.artefacts.files.blocks_to_toml import to_toml
from feeddrive.artefacts.files.whole import new_directory
from feeddrive.artefacts.report.content import Shown
from feeddrive.artefacts.report.page import definitions, header, page, picture
from feeddrive.artefacts.report.tables import table
from feeddrive.engineer.analysis.margins import Margins
from feeddrive.engineer.analysis.stiffness import Stiffness
from feeddrive.engineer.tuning.shaping.figures import Figures
from feeddrive.engineer.tuning.shaping.shaped_loop import FIGURES, ShapedLoop
from feeddrive.language import tree
from feeddrive.language.table import Table


def write_tuned(found: ShapedLoop, machine: str | None, axis: str, out: str | Path, facts: Mapping[str, str]) -> Path:
    """Write report, summary, the control and, if the tuning holds, the machine file into a directory.

    The path of the report.  Raises FileError if `out` cannot be written.
    """
    with new_directory(out) as folder:
        (folder / "report.html").write_text(build(found, facts), encoding="utf-8")
        (folder / "summary.json").write_text(json.dumps(summary(found), indent=2) + "\n", encoding="utf-8")
        if found.holds:
            (folder / "control.toml").write_text(to_toml(found.control, f"axis.{axis}.control"), encoding="utf-8")
            if machine is not None:
                (folder / "machine.toml").write_text(machine, encoding="utf-8")
    return Path(out) / "report.html"


def build(found: ShapedLoop, facts: Mapping[str, str]) -> str:
    """The page. Pure: the same tuning gives the same text."""
    drawn = list(_pictures(found))
    made = "".join(table(f"{each.title[:1].upper()}{each.title[1:]}.", each.heads, each.rows) for each in tables(found))
    links = [("result", "Result"), *((f"figure-{each.key}", each.title) for each in drawn), ("facts", "What was tuned")]
    parts = [
        header("feeddrive tune", "A tuned loop", [found.recommendation(), f"Rule: {found.rule}."], links),
        f'<section id="result">\n<h2>Result</h2>\n{made}{_said(found)}\n</section>\n',
        f'<section id="pictures">\n<h2>Pictures</h2>\n{"".join(picture(each) for each in drawn)}</section>\n',
        f'<section id="facts">\n<h2>What was tuned</h2>\n{definitions(facts.items())}\n</section>\n',
    ]
    return page("A tuned loop", parts)


def _said(found: ShapedLoop) -> str:
    said = [f"Held back by {each.sentence()}." for each in found.held]
    said += [f"{text[:1].upper()}{text[1:]}." for text in found.advice]
    said += [f"Notch {text}." for text in found.notches]
    listed = "".join(f"<li>{escape(text)}</li>" for text in said)
    return (
        f'<div class="remarks"><h3>What holds it back, and what would help</h3><ul>{listed}</ul></div>' if said else ""
    )


def tables(found: ShapedLoop) -> list[Table]:
    """Old against new: values, figures at each site, the cascade loop by loop; and the proof."""
    rows = [
        [
            name, "none" if math.isnan(found.started[name]) else f"{found.started[name]:.5g}", f"{value:.5g}",
            _change(found.started[name], value), tree.declaration(found.control, name).unit,
        ]
        for name, value in found.knobs.items()
    ]  # fmt: skip
    made = [Table("values", ["parameter", "today", "new", "change", "unit"], rows)]
    for i, after in enumerate(found.after):
        before = found.before[i] if found.before else None
        made.append(_figures(before, after, len(found.after) > 1))
    for name, each in zip(("today", "new"), found.cascade, strict=False):
        shown = each.table()
        made.append(Table(f"{shown.title}, {name}", shown.heads, shown.rows))
    proof = [[line.what, {None: "not proven", True: "holds", False: "does not hold"}[line.holds], line.said]
             for line in found.proof]  # fmt: skip
    made.append(Table("proof: computed anew in other ways", ["what", "", "figures"], proof))
    return made


def _figures(before: Figures | None, after: Figures, several: bool) -> Table:
    rows: list[list[str]] = []
    for head, unit, read in FIGURES:
        cells = [
            "-" if each is None else "unstable" if not each.stable else _number(read(each)) for each in (before, after)
        ]
        if cells != ["-", "-"]:
            rows.append([head, *cells, unit])
    against = ", against a force at the drive" if after.at_drive else ""
    place = f" at {after.site}" if several else ""
    return Table(f"figures{place}{against}", ["what", "today", "new", "unit"], rows)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _change(before: float, after: float) -> str:
    return "-" if math.isnan(before) else f"{100.0 * (after / before - 1.0):+.3g} %"


def _rows(found: ShapedLoop) -> Sequence[tuple[str, Figures]]:
    """Stable loops by name."""
    many = len(found.after) > 1
    return [
        (f"{name}, {each.site}" if many else name, each)
        for name, row in (("today", found.before), ("new", found.after))
        for each in row
        if each.stable
    ]


def _pictures(found: ShapedLoop) -> Iterator[Shown]:
    rows = _rows(found)
    stiff: dict[str, Stiffness] = {name: each.stiffness for name, each in rows}
    loops: dict[str, Margins] = {name: each.margins for name, each in rows}
    yield Shown(
        "stiffness",
        "Dynamic stiffness",
        "The force that moves the table by 1 µm, in closed loop; higher is better.",
        "Dynamic stiffness over frequency, before and after.",
        lambda: plot.stiffness(stiff),
    )
    yield Shown(
        "margins",
        "Open loop and margins",
        "The loop opened at the actuator, filters and dead time included.",
        "Bode plot of the loop gain before and after, with margins.",
        lambda: plot.open_loop(loops),
    )
    yield Shown(
        "sensitivity",
        "Sensitivity",
        "What is left of a disturbance, and the answer to noise; the mark is Ms.",
        "Sensitivity functions before and after.",
        lambda: plot.sensitivity(loops),
    )
    if found.cascade:
        last = found.cascade[-1]
        yield Shown(
            "cascade",
            "Velocity and position loop",
            "The velocity loop without position loop, and the position loop around the closed velocity loop.",
            "Bode plot of velocity loop and position loop of the new gains.",
            last.plot,
        )


def summary(found: ShapedLoop) -> dict[str, Any]:
    """All figures as plain numbers; what does not occur is null."""
    return {
        "rule": found.rule,
        "recommendation": found.recommendation(),
        "holds": found.holds,
        "knobs": dict(found.knobs),
        "today": {name: None if math.isnan(value) else value for name, value in found.started.items()},
        "figures": {
            name: {each.site: _plain(each) for each in row}
            for name, row in (("today", found.before), ("new", found.after))
        },
        "held_back_by": [
            {"what": h.what, "site": h.site, "frequency_Hz": h.frequency, "gain_percent": h.gain} for h in found.held
        ],
        "standard_deviations_kept": found.sure,
        "probability_that_all_limits_hold": found.confidence,
        "proof": {line.what: {"holds": line.holds, "said": line.said} for line in found.proof},
    }


def _plain(each: Figures) -> dict[str, float | bool | None]:
    values = {head: read(each) if each.stable else None for head, _, read in FIGURES}
    return {"stable": each.stable, **{k: None if v is None or not math.isfinite(v) else v for k, v in values.items()}}
