"""What the arena leaves behind: one directory with the report, all figures, and each tuned control.

report.html         for people
summary.json        every figure in SI, tunables, bounds that were active, proofs, refusals; versions and seed
figures.csv         one row a law, one column a figure, in SI
machine.toml        the machine as it was given
controls/LAW.toml   the tuned control of each law, as the section [axis.NAME.control] of a machine file
"""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

from feeddrive.comparison.arena import Comparison, Competitor
from feeddrive.comparison.criteria import CRITERIA
from feeddrive.comparison.report import study
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.blocks_to_toml import to_toml
from feeddrive.files.provenance import file_names
from feeddrive.report import build


def write_arena(found: Comparison, out: str | Path) -> Path:
    """Write the directory whole or not at all, and return the path of the report.

    Raises FileError if `out` cannot be written, or is a directory that feeddrive did not write.
    """
    page = build(study(found))
    with new_directory(out) as folder:
        (folder / "report.html").write_text(page, encoding="utf-8")
        (folder / "summary.json").write_text(json.dumps(summary(found), indent=2) + "\n", encoding="utf-8")
        (folder / "figures.csv").write_text(figures_csv(found), encoding="utf-8")
        (folder / "machine.toml").write_text(found.machine.file.text, encoding="utf-8")
        controls = folder / "controls"
        controls.mkdir()
        for name, each in zip(file_names(found.competitors), found.competitors, strict=True):
            text = to_toml(each.loop.control, f"axis.{found.axis}.control")
            (controls / f"{name}.toml").write_text(text, encoding="utf-8")
    return Path(out) / "report.html"


def summary(found: Comparison) -> dict[str, Any]:
    """All figures as plain numbers; what does not occur is null, what is infinite the text "infinite"."""
    places = {criterion.key: found.places(criterion) for criterion in CRITERIA}
    return {
        "title": found.title,
        "machine": found.machine.name,
        "source": found.machine.source,
        "axis": found.axis,
        "rule": found.rule,
        "seed": found.seed,
        "force_N": found.work.force,
        "settled_within_m": found.work.near,
        "velocity_of_the_linear_model_m_per_s": found.velocity,
        "versions": dict(found.versions),
        "laws": {
            each.name: {
                **{key: _plain(value) for key, value in each.figures.items()},
                "places": {key: row[i] for key, row in places.items()},
                **_tuned(each),
            }
            for i, each in enumerate(found.competitors)
        },
        "refused": {each.name: each.reason for each in found.refusals},
        "remarks": list(found.remarks),
    }


def _tuned(each: Competitor) -> dict[str, Any]:
    said: dict[str, Any] = {"unfit": each.unfit or None, "remark": each.remark or None}
    if each.tuned is not None:
        said |= {
            "tunables": {
                f"{each.loop.place_of('control')}.{name}": value for name, value in each.tuned.tunables.items()
            },
            "active": [held.sentence() for held in each.tuned.held],
            "loops_judged": each.tuned.evaluations,
            "settled": each.settled,
            "spread_of_searches": each.tuned.spread,
            "proof": {line.what: {"holds": line.holds, "said": line.said} for line in each.tuned.proof},
        }
    return said


def _plain(value: float | None) -> float | str | None:
    return "infinite" if value is not None and math.isinf(value) else value


def figures_csv(found: Comparison) -> str:
    """The figures as CSV; what does not occur is empty."""
    keys = list(dict.fromkeys(key for each in found.competitors for key in each.figures))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["law", *keys])
    for each in found.competitors:
        cells = (each.figures.get(key) for key in keys)
        writer.writerow([each.name, *("" if cell is None else repr(float(cell)) for cell in cells)])
    return text.getvalue()
