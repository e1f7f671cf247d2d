"""What a paper claims, by which rule, what came out, and the page that shows it: claims first, then figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

from feeddrive.language.table import Result, Table
from feeddrive.report.content import Shown
from feeddrive.report.page import definitions, header, page, picture
from feeddrive.report.tables import table


@dataclass(frozen=True)
class Claim:
    """One statement that can fail: it holds if  least <= got <= most  (a bound may be absent).

    key       of the row, as "1.d"
    claim     what is stated, as a sentence
    rule      by what the two sides are comparable; plant, noise and seed
    got       the figure that came out, in `unit`
    expected  what was expected, in words; absent: the bounds
    """

    key: str
    claim: str
    rule: str
    got: float
    least: float | None = None
    most: float | None = None
    unit: str = ""
    expected: str = ""

    @property
    def holds(self) -> bool:
        """Whether the figure lies within its bounds; what is not a number holds nothing."""
        above = self.least is None or self.got >= self.least
        below = self.most is None or self.got <= self.most
        return above and below and not math.isnan(self.got)

    @property
    def bounds(self) -> str:
        """The bounds as text, with the unit."""
        if self.least is not None and self.most is not None:
            text = f"{self.least:.4g} to {self.most:.4g}"
        elif self.least is not None:
            text = f"at least {self.least:.4g}"
        elif self.most is not None:
            text = f"at most {self.most:.4g}"
        else:
            text = "any number"
        return f"{text} {self.unit}".rstrip()

    @property
    def shown(self) -> str:
        """The figure as text, with the unit."""
        return f"{self.got:.4g} {self.unit}".rstrip()

    def cells(self) -> list[str]:
        """The row of a table."""
        expected = f"{self.expected} ({self.bounds})" if self.expected else self.bounds
        return [self.key, self.claim, self.rule, expected, self.shown, "holds" if self.holds else "DOES NOT HOLD"]


CELLS = ("row", "claim", "rule", "expected", "got", "holds?")


@dataclass(frozen=True, eq=False, repr=False)
class Experiment(Result):
    """The experiments of one paper: claims, further tables, pictures, what was run, and honest remarks.

    name      as on the command line, "altintas2009"
    citation  authors, title, journal, year
    """

    name: str
    title: str
    citation: str
    claims: Sequence[Claim]
    tables: Sequence[Table] = ()
    pictures: Sequence[Shown] = ()
    facts: Mapping[str, str] = field(default_factory=dict[str, str])
    notes: Sequence[str] = ()

    @property
    def broken(self) -> list[Claim]:
        """The claims that do not hold."""
        return [claim for claim in self.claims if not claim.holds]

    def table(self) -> Table:
        """The claims."""
        return Table(self.title, CELLS, [claim.cells() for claim in self.claims])

    def sentence(self) -> str:
        """How many claims hold, and which do not."""
        held = len(self.claims) - len(self.broken)
        if not self.broken:
            return f"All {held} claims hold."
        listed = ", ".join(claim.key for claim in self.broken)
        return f"{held} of {len(self.claims)} claims hold; these do not: {listed}."


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
