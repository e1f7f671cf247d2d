"""Numbers that the documentation states, for tests which compare them with what they are of."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def claims_documented(author: str) -> int:
    """Return how many claims docs/reproduced.md states for the paper whose row begins with this author."""
    found = re.search(rf"(?m)^\| {author}[^|]*\| (\d+) \|", (DOCS / "reproduced.md").read_text(encoding="utf-8"))
    assert found, author
    return int(found[1])
