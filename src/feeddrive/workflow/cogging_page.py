"""The report of `feeddrive cogging`, and the machine file with the harmonics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path

import numpy as np

from feeddrive import plot
from feeddrive.blocks.force.cogging import Cogging
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.blocks_to_toml import to_toml
from feeddrive.files.machine import MachineFile
from feeddrive.files.messages import sentence
from feeddrive.files.toml_edit import TomlEdit
from feeddrive.identification.cogging.cogging_run import CoggingRun
from feeddrive.identification.cogging.identify_cogging import CoggingFit, CoggingOrder
from feeddrive.language.block import Number
from feeddrive.report.content import Shown
from feeddrive.report.page import definitions, header, page, picture, table

_NAMED = 6  # orders that a sentence names
_STRONG = 0.05  # share of the strongest from which an order is named


@dataclass(frozen=True)
class AtTable:
    """The table's motion in one period, m, and N at the table per unit of the measured force."""

    period: float
    force_per_unit: float


def write_cogging(
    fit: CoggingFit, runs: Sequence[CoggingRun], machine: str | None, out: str | Path, facts: Mapping[str, str]
) -> Path:
    """Write `report.html` and, if there is one, `machine.toml` into a directory; the path of the report."""
    with new_directory(out) as folder:
        if machine is not None:
            (folder / "machine.toml").write_text(machine, encoding="utf-8")
        (folder / "report.html").write_text(build(fit, runs, facts), encoding="utf-8")
    return Path(out) / "report.html"


def build(fit: CoggingFit, runs: Sequence[CoggingRun], facts: Mapping[str, str]) -> str:
    """The page. Pure: the same fit gives the same text."""
    title = "Cogging by position"
    drawn = list(_pictures(fit, runs))
    found = fit.table()
    items = "".join(f"<li>{escape(sentence(remark))}</li>" for remark in fit.remarks)
    listed = f'<div class="remarks"><h3>Remarks</h3><ul>{items}</ul></div>' if items else ""
    links = [("result", "Result"), *((f"figure-{each.key}", each.title) for each in drawn), ("facts", "The logs")]
    parts = [
        header("feeddrive cogging", title, [recommendation(fit)], links),
        f'<section id="result">\n<h2>Result</h2>\n{table(sentence(found.title), found.heads, found.rows)}{listed}\n'
        f"</section>\n",
        f'<section id="pictures">\n<h2>Pictures</h2>\n{"".join(picture(each) for each in drawn)}</section>\n',
        f'<section id="facts">\n<h2>The logs</h2>\n{definitions(facts.items())}\n</section>\n',
    ]
    return page(title, parts)


def kept_away(fit: CoggingFit, at_table: AtTable | None) -> str:
    """Why the harmonics must not become part of a machine file; empty if they may."""
    if fit.coulomb is None:
        return "one direction cannot tell cogging from friction that varies along the travel"
    if not _cogging(fit):
        return "no order stands out as cogging"
    if at_table is None:
        return "force and period at the table are not known; give --force-constant, or --lead and --gear"
    return ""


def recommendation(fit: CoggingFit) -> str:
    """One sentence with its reason: which orders to take, or what to measure next."""
    if not fit.significant:
        return "Leave cogging out: no order of the position stands out from chance."
    unit = f" {fit.unit}" if fit.unit else ""
    strong = [each for each in fit.significant if each.amplitude >= _STRONG * fit.orders[0].amplitude]
    if fit.coulomb is None:
        return (
            f"Measure the same travel the other way before you compensate anything: {_listed(strong)} stand out, and "
            f"one direction cannot tell cogging from friction that varies along the travel."
        )
    taken = _cogging(fit)
    if not taken:
        return (
            f"Leave cogging out: what stands out, {_listed(strong)}, changes its sign with the direction, so it is "
            f"friction that varies along the travel, or an error of the current's zero."
        )
    even = sum(each.even.value**2 for each in fit.significant if each.even is not None)
    odd = sum(each.odd.value**2 for each in fit.significant if each.odd is not None)
    turned = [each for each in strong if each not in taken]
    rest = (
        f"; do not compensate what changes its sign with it ({np.sqrt(0.5 * odd):.3g}{unit} RMS, {_listed(turned)}) by "
        f"position alone, for that would double it one way"
        if turned
        else ""
    )
    return (
        f"Take {_listed(taken)} as cogging, {np.sqrt(0.5 * even):.3g}{unit} RMS that is the same in both "
        f"directions{rest}."
    )


def machine_text(fit: CoggingFit, at_table: AtTable, machine: MachineFile | None, axis: str) -> str:
    """A machine file with the cogging among its forces, comments kept; without one, the section alone."""
    block = _rounded(fit.block(at_table.period, force_per_unit=at_table.force_per_unit))
    section = _section(block, axis)
    if machine is None:
        head = "# cogging of an axis, from slow runs; add plant, control, limits and encoders\n\n"
        edit, index = TomlEdit(head + section, "cogging.toml"), 0
    else:
        edit = TomlEdit(machine.file.text, machine.file.name)
        forces = machine.loop(axis).axis.forces
        index = next((i for i, each in enumerate(forces) if isinstance(each, Cogging)), len(forces))
        if index < len(forces):
            edit.replace(("axis", axis, "forces", index), section)
        else:
            edit.add(section)
    strongest = max((each.even for each in fit.significant if each.even is not None), key=lambda each: each.value)
    error = at_table.force_per_unit * strongest.error
    edit.comment(("axis", axis, "forces", index, "force"), f"standard error {error:.2g} N")
    return edit.text


def _rounded(block: Cogging) -> Cogging:
    """To six digits, far beyond what the errors leave."""
    harmonics = tuple(replace(each, share=_short(each.share), phase=_short(each.phase)) for each in block.harmonics)
    return replace(block, force=_short(block.force), harmonics=harmonics)


def _short(value: Number) -> float:
    return float(f"{float(value):.6g}")


def _section(block: Cogging, axis: str) -> str:
    key = f"axis.{axis}.forces"
    return to_toml(block, key).replace(f"[{key}]", f"[[{key}]]", 1)


def _cogging(fit: CoggingFit) -> list[CoggingOrder]:
    """Strong orders that do not change their sign with the direction, the strongest first."""
    found = [
        each
        for each in fit.significant
        if each.even is not None and each.odd is not None and each.even.value > each.odd.value
    ]
    found.sort(key=lambda each: -(each.even.value if each.even is not None else 0.0))
    return [each for each in found if each.amplitude >= _STRONG * fit.orders[0].amplitude]


def _listed(orders: Sequence[CoggingOrder]) -> str:
    names = ", ".join(str(each.order) for each in orders[:_NAMED])
    more = f" and {len(orders) - _NAMED} more" if len(orders) > _NAMED else ""
    return f"order{'s' if len(orders) > 1 else ''} {names}{more}"


def _pictures(fit: CoggingFit, runs: Sequence[CoggingRun]) -> Iterator[Shown]:
    yield Shown(
        "turn",
        "Force over one period",
        "Points: what was measured, by direction; half of the distance of their means is Coulomb friction. "
        "Line: what does not change with the direction, which is cogging."
        if fit.coulomb is not None
        else "Points: what was measured in the one direction. Line: the significant orders, friction among them.",
        "Measured force over one period by direction, and the fitted cogging.",
        lambda: plot.cogging_over_turn(fit, runs),
    )
    if fit.significant:
        yield Shown(
            "orders",
            "Amplitude by order",
            "Orders that chance does not explain, with twice their standard error. What changes its sign with the "
            "direction is no cogging but friction that varies along the travel.",
            "Amplitudes of the significant orders with their errors.",
            fit.plot,
        )
