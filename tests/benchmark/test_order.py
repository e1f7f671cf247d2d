"""The order of laws: intervals by closed forms, and pairs that are decided, open and tied."""

from __future__ import annotations

import math

import numpy as np
import pytest

from feeddrive.benchmark.order import Decision, Logs, Order
from feeddrive.figures import of_loops

SNAP = of_loops.ROPE_SNAP
PLANTS = ("a", "b", "c", "d")


def order(
    logs: Logs, plants: tuple[str, ...] = PLANTS, resamples: int = 4000, unsettled: tuple[str, ...] = ()
) -> Order:
    return Order.of(SNAP, logs, plants, resamples, 0.95, 7, unsettled)


def every(value: float, spread: float = 0.0) -> dict[str, tuple[float, ...]]:
    """The same improvement at each plant, or one that differs from plant to plant."""
    return {plant: (value + spread * sign,) * 3 for plant, sign in zip(PLANTS, (-1.0, 1.0, -1.0, 1.0), strict=True)}


def test_a_law_that_is_the_same_everywhere_has_no_interval() -> None:
    found = order({"one": every(math.log(2.0)), "plain": every(0.0)})
    first, second = found.standings
    assert (first.law, first.place, first.best, first.worst) == ("one", 1, 1, 1)
    assert (first.score, first.low, first.high) == pytest.approx((2.0, 2.0, 2.0))
    assert (second.law, second.place) == ("plain", 2)


def test_the_interval_over_plants_is_that_of_the_binomial_draw() -> None:
    """Four plants at ±1: the mean of a resample is (2 n - 4)/4 with n binomial; 6 % of them have n = 0, so that the
    2.5 % percentile is -1, and so is the other end 1."""
    found = order({"one": every(0.0, 1.0), "plain": every(0.0)})
    one = next(row for row in found.standings if row.law == "one")
    assert (math.log(one.low), math.log(one.high)) == pytest.approx((-1.0, 1.0))
    assert float(np.std(found.resampled[found.laws.index("one")])) == pytest.approx(0.5, abs=0.02)


def test_the_draws_of_a_plant_are_resampled_too() -> None:
    """One plant, four draws of 0, 0, 0 and 4: the mean has the standard deviation sqrt(3)/2."""
    found = order({"one": {"a": (0.0, 0.0, 0.0, 4.0)}, "plain": {"a": (0.0,) * 4}}, ("a",))
    assert float(np.std(found.resampled[found.laws.index("one")])) == pytest.approx(math.sqrt(3.0) / 2.0, abs=0.03)


def test_what_laws_share_cancels_in_their_difference() -> None:
    """Both vary by a factor of e from plant to plant, and one is always 5 % better."""
    found = order({"one": every(0.05, 1.0), "two": every(0.0, 1.0)})
    assert found.better("one", "two") is True
    assert found.better("two", "one") is False
    one, two = found.standings
    assert one.low < two.high


def test_a_law_without_a_figure_somewhere_is_not_ranked() -> None:
    logs = {"plain": every(0.0), "gone": {"a": (1.0,)}, "never": every(0.0) | {"b": (math.inf, 0.0)}}
    found = order(logs)
    assert found.laws == ("plain",)
    assert found.better("plain", "gone") is None
    assert "no place" in found.open_by("plain", "gone")


def test_the_same_seed_gives_the_same_intervals() -> None:
    logs = {"one": every(0.3, 0.2), "plain": every(0.0)}
    assert np.array_equal(order(logs).resampled, order(logs).resampled)


BETTER, WORSE, OPEN = every(0.5), every(-0.5), every(0.1, 1.0)


def verdict(*one: dict[str, tuple[float, ...]] | None) -> Decision:
    names = ("the rules", "box of 10 %", "another draw")
    return Decision(
        {
            name: None if logs is None else order({"one": logs, "plain": every(0.0)})
            for name, logs in zip(names, one, strict=False)
        }
    )


@pytest.mark.parametrize(
    ("views", "decided", "why"),
    [
        ((BETTER, BETTER, BETTER), True, ()),
        ((WORSE, WORSE, WORSE), False, ()),
        ((BETTER, WORSE, BETTER), None, ("box of 10 %: reversed",)),
        ((BETTER, OPEN, BETTER), None, ("box of 10 %: the interval of their ratio contains 1",)),
        ((BETTER, BETTER, None), None, ("another draw: not computed",)),
        ((BETTER, {}, BETTER), None, ("box of 10 %: one has no place on all plants",)),
    ],
)
def test_an_order_is_decided_where_the_rules_and_all_variants_agree(
    views: tuple[dict[str, tuple[float, ...]] | None, ...], decided: bool | None, why: tuple[str, ...]
) -> None:
    found = verdict(*views)
    assert found.decided("one", "plain") is decided
    assert found.decided("plain", "one") is (None if decided is None else not decided)
    doubt = found.doubt("one", "plain")
    assert (() if doubt is None else doubt.why) == why
    first, last = (1, 2) if decided is None else (1, 1) if decided else (2, 2)
    assert found.places("one") == (first, last)
    assert len(found.doubts) == (decided is None)


def test_a_law_behind_whose_search_is_not_settled_may_still_be_better() -> None:
    logs = {"one": every(0.5), "plain": every(0.0)}
    assert order(logs, unsettled=("plain",)).better("one", "plain") is None
    assert "not settled" in order(logs, unsettled=("plain",)).open_by("one", "plain")
    # one that is ahead is at least so good
    assert order(logs, unsettled=("one",)).better("one", "plain") is True


@pytest.mark.parametrize(("apart", "tied"), [(7e-10, True), (1.5e-9, False)])
def test_laws_with_the_same_loop_share_a_place(apart: float, tied: bool) -> None:
    logs = {"plain": every(0.0), "beside": every(-apart), "last": every(-1.0)}
    found = Decision({"the rules": order(logs)})
    assert found.order.tied("plain", "beside") == tied
    assert found.places("plain") == (1, 1)
    assert found.places("beside") == ((1, 1) if tied else (2, 2))
    assert found.places("last") == (3, 3)
    assert len(found.pairs) == (2 if tied else 3)
