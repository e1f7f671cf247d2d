"""Claims of a paper with the rule that decides them and the result, and the page that shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from feeddrive.language.table import Result, Table
from feeddrive.report.content import Shown
from feeddrive.report.page import render


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
    """The experiments of one paper: claims, further tables, pictures, what was run, and remarks.

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
    pictures = [(f"figure-{shown.key}", shown.title) for shown in experiment.pictures]
    return render(
        "paper.html",
        title=experiment.title,
        lead=[experiment.citation, experiment.sentence()],
        links=[("claims", "Claims"), *pictures, ("facts", "What was run")],
        heads=CELLS,
        claims=experiment.claims,
        notes=experiment.notes,
        tables=experiment.tables,
        pictures=experiment.pictures,
        facts=experiment.facts.items(),
    )
