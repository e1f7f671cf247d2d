"""Numbers that the documentation states, for tests which compare them with what they are of."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import pytest

from feeddrive.papers.claims import Claim, within

DOCS = Path(__file__).parents[1] / "docs"


def claims_documented(author: str) -> int:
    """Return how many claims docs/reference/reproduced.md states for the paper whose row begins with this author."""
    page = (DOCS / "reference" / "reproduced.md").read_text(encoding="utf-8")
    found = re.search(rf"(?m)^\| {author}[^|]*\| (\d+) \|", page)
    assert found, author
    return int(found[1])


def loose(claims: Iterable[Claim]) -> list[str]:
    """Return the claims that accept too much: anything on one side without a reason, or a range of more than 1 to 3."""
    found = []
    for claim in claims:
        wide = claim.least is not None and claim.most is not None and 0.0 < 3.0 * claim.least < claim.most
        if claim.unexplained or wide:
            found.append(f"{claim.key}, {claim.claim}: {claim.bounds}")
    return found


def misstated(claims: Iterable[Claim]) -> list[str]:
    """Return the claims whose bounds are not those of their words, as in `12.8, to 20 %` or `28.5 by scipy, to 6 %`."""
    found, read = [], 0
    for claim in claims:
        words = re.fullmatch(r"([\d.]+)(?![\d./]| /| ->)[^;]*?\bto (\d+) %", str(claim.expected))
        if words is None:
            continue
        read += 1
        figure, share = float(words[1]), 0.01 * float(words[2])
        # the figure is printed to three digits or so
        if (claim.least, claim.most) != pytest.approx(within(figure, share), rel=0.006):
            found.append(f"{claim.key}, {claim.claim}: {claim.expected}, {claim.bounds}")
    assert read > 3
    return found
