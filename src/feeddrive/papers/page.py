"""The page of an experiment: the table of claims first, then figures and how they were made."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from feeddrive.papers.claims import CELLS, Claim, Experiment
from feeddrive.report.page import definitions, header, page, picture
from feeddrive.report.tables import table


def build(experiment: Experiment) -> str:
    """The experiment as one HTML page: no scripts, no other files. Pure: the same experiment gives the same text."""
    parts = [
        _header(experiment),
        _claims(experiment),
        _tables(experiment),
        _pictures(experiment),
        _facts(experiment),
    ]
    return page(experiment.title, parts)


def _header(experiment: Experiment) -> str:
    links = [("claims", "Claims"), *((f"figure-{s.key}", s.title) for s in experiment.pictures)]
    lead = [experiment.citation, experiment.sentence()]
    return header("feeddrive reproduce", experiment.title, lead, [*links, ("facts", "What was run")])


def _claims(experiment: Experiment) -> str:
    notes = "".join(f"<li>{escape(note)}</li>" for note in experiment.notes)
    remarks = f'<div class="remarks"><h3>Remarks</h3><ul>{notes}</ul></div>' if notes else ""
    return f'<section id="claims">\n<h2>Claims</h2>\n{claims_table(experiment.claims)}{remarks}\n</section>\n'


def claims_table(claims: Sequence[Claim]) -> str:
    """The claims as an HTML table; those that do not hold stand out."""
    heads = "".join(f'<th scope="col">{escape(head)}</th>' for head in CELLS)
    rows: list[str] = []
    for claim in claims:
        kind = "" if claim.holds else ' class="broken"'
        rows.append(f"<tr{kind}>{''.join(f'<td>{escape(cell)}</td>' for cell in claim.cells())}</tr>")
    body = f"<thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody>"
    return f'<div class="scroll"><table class="text">{body}</table></div>'


def _tables(experiment: Experiment) -> str:
    if not experiment.tables:
        return ""
    made = "".join(table(each.title, each.heads, each.rows) for each in experiment.tables)
    return f'<section id="tables">\n<h2>Tables</h2>\n{made}\n</section>\n'


def _pictures(experiment: Experiment) -> str:
    made = "".join(picture(shown) for shown in experiment.pictures)
    return f'<section id="pictures">\n<h2>Pictures</h2>\n{made}\n</section>\n' if made else ""


def _facts(experiment: Experiment) -> str:
    facts = definitions(experiment.facts.items())
    return f'<section id="facts">\n<h2>What was run</h2>\n{facts}\n</section>\n'
