"""The share of slow tests: drawn by a seed, within its seconds, and every test comes round."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from slow_share import UNKNOWN, drawn, limits, missing_reasons

NAMES = [f"test_{k}" for k in range(40)]
SECONDS = {name: 1.0 + k for k, name in enumerate(NAMES)}


@pytest.mark.parametrize("seed", ["a", "b", "c"])
def test_a_share_keeps_within_its_seconds_and_uses_them(seed: str) -> None:
    share = drawn(NAMES, SECONDS, 100.0, seed)
    took = sum(SECONDS[name] for name in share)
    assert 100.0 - min(SECONDS[name] for name in NAMES if name not in share) < took <= 100.0
    assert share == drawn(reversed(NAMES), SECONDS, 100.0, seed), "by the seed alone"


def test_every_test_comes_round() -> None:
    """The longest is drawn with 1 in 8 commits or more: 200 commits without it have a chance of 3e-12."""
    assert set().union(*(drawn(NAMES, SECONDS, 100.0, str(seed)) for seed in range(200))) == set(NAMES)


def test_a_test_that_nobody_timed_counts_as_long() -> None:
    assert len(drawn(NAMES, {}, 3.5 * UNKNOWN, "a")) == 3


def test_a_test_with_half_an_hour_of_its_own_is_not_drawn_before_somebody_timed_it() -> None:
    """A search of 1800 s counted 20 s, and a share of 100 s might have drawn it."""
    marks = {"search": pytest.mark.timeout(1800).mark, "usual": None}
    items = [SimpleNamespace(nodeid=name, get_closest_marker=lambda _, mark=mark: mark) for name, mark in marks.items()]
    assert limits(items) == {"search": 1800.0}
    assert drawn(marks, limits(items), 100.0, "a") == {"usual"}


def test_a_slow_test_says_why() -> None:
    def item(name: str, mark: pytest.MarkDecorator) -> SimpleNamespace:
        return SimpleNamespace(nodeid=name, iter_markers=lambda _: [mark.mark])

    slow = pytest.mark.slow
    items = [item("bare", slow), item("empty", slow(reason=" ")), item("said", slow(reason="an hour of samples"))]
    assert missing_reasons(items) == ["bare", "empty"]
