"""The report of `feeddrive identify`, and the files beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path

from feeddrive import plot
from feeddrive.files.atomic_io import new_directory
from feeddrive.identification.motion.identify import Identified
from feeddrive.language.table import Table
from feeddrive.report.content import Shown
from feeddrive.report.page import definitions, header, page, picture, table


def write_identified(found: Identified, machine: str | None, out: str | Path, facts: Mapping[str, str]) -> Path:
    """Write `report.html` and, if there is one, `machine.toml` into a directory; the path of the report."""
    with new_directory(out) as folder:
        if machine is not None:
            (folder / "machine.toml").write_text(machine, encoding="utf-8")
        (folder / "report.html").write_text(build(found, facts), encoding="utf-8")
    return Path(out) / "report.html"


def build(found: Identified, facts: Mapping[str, str]) -> str:
    """The page. Pure: the same identification gives the same text."""
    drawn = list(_pictures(found))
    made = "".join(table(f"{each.title[:1].upper()}{each.title[1:]}.", each.heads, each.rows) for each in tables(found))
    said = "".join(f"<li>{escape(f'{remark[:1].upper()}{remark[1:]}.')}</li>" for remark in found.remarks)
    remarks = f'<div class="remarks"><h3>Remarks</h3><ul>{said}</ul></div>' if said else ""
    links = [("result", "Result"), *((f"figure-{each.key}", each.title) for each in drawn), ("facts", "The log")]
    parts = [
        header("feeddrive identify", f"A rigid drive in {found.log.name}", [found.recommendation], links),
        f'<section id="result">\n<h2>Result</h2>\n{made}{remarks}\n</section>\n',
        f'<section id="pictures">\n<h2>Pictures</h2>\n{"".join(picture(each) for each in drawn)}</section>\n',
        f'<section id="facts">\n<h2>The log</h2>\n{definitions(facts.items())}\n</section>\n',
    ]
    return page(f"Identified: {found.log.name}", parts)


def tables(found: Identified) -> list[Table]:
    """Everything that was estimated, each with its errors."""
    made = [found.rigid.table()]
    if found.refinement is not None:
        made.append(found.refinement.table())
        rows = [[str(d), f"{1e6 * rms:.4g}"] for d, rms in found.refinement.by_delay.items()]
        made.append(Table("position residual in closed loop by dead time", ["samples more", "um RMS"], rows))
    if found.control is not None:
        made.append(found.control.table())
    return [*made, found.delay.table(), found.rigid.residuals.table(), found.rigid.validation.table()]


def _pictures(found: Identified) -> Iterator[Shown]:
    rigid = found.rigid
    left = f"{100.0 * rigid.residuals.relative:.3g} %"
    yield Shown(
        "fit",
        "Fitted and measured force",
        "Inverse dynamics: mass times acceleration plus friction, over the force that was commanded. Reversals are "
        "left out: there friction is no single number.",
        f"Measured and fitted force over time; the residual is {left} of the force.",
        rigid.plot,
    )
    if found.refinement is not None:
        replay = found.refinement.replay
        yield Shown(
            "closed",
            "The loop, simulated along the same reference",
            "Gray: the log. Blue: the fitted loop, given only the reference and how the log starts.",
            f"Measured and predicted signals; residual of the position {1e6 * replay.rms('position_load'):.3g} µm RMS.",
            replay.plot,
        )
    if found.loop is not None and found.friction is not None:
        loop, seen = found.loop, found.friction
        yield Shown(
            "friction",
            "Friction",
            "Points: what is left of the force when the inertia is taken out, by velocity. Line: the fitted friction; "
            "a constant force is in the points and not in the line.",
            "Friction force over velocity in both directions, measured and fitted.",
            lambda: plot.friction(loop, measured=seen),
        )
    yield Shown(
        "residual",
        "Residual and its memory",
        "A white residual would stay between the dashed lines; beyond them errors that assume one are too small.",
        "Residual by row and its autocorrelation.",
        rigid.residuals.plot,
    )
    yield Shown(
        "delay",
        "Dead time",
        "What the inverse dynamics leave if the force is taken to act so many samples later than its hold says.",
        f"Residual over dead time; least at {found.delay.dead_time:.2f} samples.",
        found.delay.plot,
    )
