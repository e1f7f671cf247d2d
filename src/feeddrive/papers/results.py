"""What `reproduce` leaves behind: a page for each paper, an index of all claims, and the figures as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path

from feeddrive.files.atomic_io import new_directory
from feeddrive.files.provenance import versions
from feeddrive.papers.page import claims_table
from feeddrive.papers.papers import Reproduced
from feeddrive.report.page import header, page


def write_reproduced(reproduced: Sequence[Reproduced], out: str | Path) -> Path:
    """Write the directory whole or not at all, and return the path of the report to open.

    Raises FileError if `out` cannot be written, or is a directory that feeddrive did not write.
    """
    with new_directory(out) as folder:
        fill(folder, reproduced)
    return Path(out) / "report.html"


def fill(folder: Path, reproduced: Sequence[Reproduced]) -> None:
    """The files of the directory, for whoever opened it before the work began."""
    for each in reproduced:
        name = "report" if len(reproduced) == 1 else each.name
        (folder / f"{name}.html").write_text(each.page, encoding="utf-8")
    if len(reproduced) > 1:
        (folder / "report.html").write_text(_index(reproduced), encoding="utf-8")
    (folder / "claims.json").write_text(json.dumps(_figures(reproduced), indent=2) + "\n", encoding="utf-8")


def _figures(reproduced: Sequence[Reproduced]) -> dict[str, object]:
    """All claims as plain figures; what is not finite is null."""
    papers = {
        each.name: [
            {
                "key": claim.key,
                "claim": claim.claim,
                "rule": claim.rule,
                "expected": claim.expected or claim.bounds,
                "least": claim.least,
                "most": claim.most,
                "got": claim.got if math.isfinite(claim.got) else None,
                "unit": claim.unit,
                "holds": claim.holds,
            }
            for claim in each.claims
        ]
        for each in reproduced
    }
    return {"versions": versions(), "papers": papers}


def _index(reproduced: Sequence[Reproduced]) -> str:
    title = "The four papers, reproduced"
    lead = [f"{each.title}: {each.sentence}" for each in reproduced]
    parts = [header("feeddrive reproduce", title, lead, [(each.name, each.title) for each in reproduced])]
    for each in reproduced:
        link = f'<h2><a href="{each.name}.html">{escape(each.title)}</a></h2>'
        parts.append(f'<section id="{each.name}">\n{link}\n{claims_table(each.claims)}\n</section>\n')
    return page(title, parts)
