"""Numbers that the documentation states, for tests which compare them with what they are of."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from feeddrive.papers.claims import Claim

DOCS = Path(__file__).parents[1] / "docs"


def claims_documented(author: str) -> int:
    """Return how many claims docs/reproduced.md states for the paper whose row begins with this author."""
    found = re.search(rf"(?m)^\| {author}[^|]*\| (\d+) \|", (DOCS / "reproduced.md").read_text(encoding="utf-8"))
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
