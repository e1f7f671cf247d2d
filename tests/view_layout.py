"""Where the parts of a view stand in the window: what is scrolled away, and what lies over something else."""

from __future__ import annotations

from typing import Any

import numpy as np

_BOXES = """(chosen) => [...document.querySelectorAll(chosen)].filter((each) => each.checkVisibility()).map((each) => {
    const { left, top, right, bottom } = each.getBoundingClientRect();
    return [left, top, right, bottom];
})"""
APART = ("[role=tab]", "header > *")


def boxes(page: Any, chosen: str) -> np.ndarray:
    """Left, top, right and bottom of the elements that are shown."""
    return np.array(page.evaluate(_BOXES, chosen)).reshape(-1, 4)


def overlaps(rows: np.ndarray) -> int:
    """How many pairs of boxes share more than a pixel in both directions."""
    low, high = np.maximum(rows[:, None, :2], rows[None, :, :2]), np.minimum(rows[:, None, 2:], rows[None, :, 2:])
    shared = np.all(high - low > 1.0, axis=2)
    return int(np.count_nonzero(np.triu(shared, 1)))


def unscrolled(page: Any, *places: str) -> None:
    """Nothing of the window, of the view and of these parts of it is scrolled away."""
    for place in ("html", "main", *places):
        wide, tall = page.eval_on_selector(
            place, "each => [each.scrollWidth - each.clientWidth, each.scrollHeight - each.clientHeight]"
        )
        assert wide <= 0, place
        assert tall <= 0, place
