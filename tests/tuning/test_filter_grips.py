"""Filters held in the open loop: a place goes where it is dragged, by numbers in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.margins import Margins
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.filter.second_order import SecondOrder
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.loop import Loop
from feeddrive.tuning.by_hand import ByHand
from feeddrive.tuning.filters import filter_dragged, filter_grips, filter_response, filter_stepped
from feeddrive.tuning.operating_point import modelled_point

PACK = (
    Notch(frequency=460.0, damping_zero=0.06, damping_pole=0.6),
    LowPass(frequency=1200.0),
    LowPass2(frequency=900.0),
    SecondOrder(frequency_zero=300.0, frequency_pole=700.0),
)


@pytest.fixture(scope="module")
def loop() -> Loop:
    found = fd.read_machine("ball_screw").loop(None)
    return replace(found, control=replace(found.control, filters=PACK))


@pytest.fixture(scope="module")
def by_hand(loop: Loop) -> ByHand:
    return ByHand(loop.control, [modelled_point(loop)])


def margins(by_hand: ByHand, values: dict[str, float]) -> Margins:
    return by_hand.at(values).leading.margins


def level(found: Margins, frequency: float) -> float:
    L = found.loop_gain
    return float(np.interp(np.log(frequency), np.log(L.frequency), 20.0 * np.log10(L.magnitude)))


@pytest.mark.parametrize(
    ("name", "x", "change"),
    [
        ("filters.0.frequency", 460.0, -8.0),
        ("filters.0.frequency", 380.0, 5.0),
        ("filters.2.frequency", 900.0, 4.0),
        ("filters.2.frequency", 1100.0, -3.0),
        ("filters.3.frequency_zero", 250.0, -6.0),
        ("filters.3.frequency_pole", 800.0, 6.0),
    ],
)
def test_the_open_loop_goes_through_the_place_where_a_filter_is_dragged(
    loop: Loop, by_hand: ByHand, name: str, x: float, change: float
) -> None:
    before = margins(by_hand, {})
    y = level(before, x) + change
    moved = filter_dragged(loop.control, name, x, y, before, loop.sample_time)
    after = margins(by_hand, moved)
    assert moved[name] == x
    assert level(after, x) == pytest.approx(y, abs=0.02)  # four digits of a ratio, and the lines
    (grip,) = (
        each for each in filter_grips(tree.vary(loop.control, moved), after, loop.sample_time) if each.name == name
    )
    assert (grip.x, grip.y) == (x, pytest.approx(y, abs=0.02))


def test_a_frequency_alone_keeps_the_depth(loop: Loop, by_hand: ByHand) -> None:
    found = margins(by_hand, {})
    assert filter_dragged(loop.control, "filters.0.frequency", 333.0, None, found, loop.sample_time) == {
        "filters.0.frequency": 333.0
    }
    assert filter_dragged(loop.control, "filters.1.frequency", 333.0, -9.0, found, loop.sample_time) == {
        "filters.1.frequency": 333.0
    }


def test_the_edge_of_a_deep_notch_lies_where_it_attenuates_by_3_dB(loop: Loop, by_hand: ByHand) -> None:
    """|H|² = (u² + 4 ζn²)/(u² + 4 ζd²), u = f/f0 - f0/f: at u = 2 ζd it is (1 + r²)/2 with the depth r."""
    found, T = margins(by_hand, {}), 1e-6  # so that f is not warped
    moved = filter_dragged(loop.control, "filters.0.width", 600.0, None, found, T)
    assert moved["filters.0.damping_pole"] == pytest.approx(0.5 * (600.0 / 460.0 - 460.0 / 600.0), rel=1e-3)
    assert moved["filters.0.damping_zero"] == pytest.approx(0.1 * moved["filters.0.damping_pole"], rel=1e-3)
    notch = tree.vary(loop.control, moved).filters[0]
    assert abs(filter_response(notch, np.array([600.0]), T)[0]) ** 2 == pytest.approx(0.505, rel=1e-3)
    below = filter_dragged(loop.control, "filters.0.width", 460.0**2 / 600.0, None, found, T)
    assert below == pytest.approx(moved, rel=1e-3)


@pytest.mark.parametrize("y", [-500.0, 500.0])
def test_a_notch_stays_a_notch_wherever_it_is_dragged(loop: Loop, by_hand: ByHand, y: float) -> None:
    found = margins(by_hand, {})
    moved = filter_dragged(loop.control, "filters.0.frequency", 1e9, y, found, loop.sample_time)
    notch = tree.vary(loop.control, moved).filters[0]
    assert isinstance(notch, Notch)
    assert 0.0006 <= notch.damping_zero <= 0.6
    assert notch.frequency == 0.45 / loop.sample_time


def test_a_notch_without_a_bottom_can_be_lifted(loop: Loop) -> None:
    """damping_zero = 0 has no logarithm."""
    control = replace(loop.control, filters=(Notch(frequency=300.0, damping_zero=0.0, damping_pole=0.5),))
    open_loop = margins(ByHand(control, [modelled_point(loop)]), {})
    moved = filter_dragged(control, "filters.0.frequency", 310.0, level(open_loop, 310.0) + 6.0, open_loop, 5e-5)
    assert 0.0005 <= moved["filters.0.damping_zero"] <= 0.5


def test_a_key_moves_a_little(loop: Loop, by_hand: ByHand) -> None:
    found, T = margins(by_hand, {}), loop.sample_time
    assert filter_stepped(loop.control, "filters.0.frequency", 1.0, 0.0, found, T)["filters.0.frequency"] == 469.2
    deeper = filter_stepped(loop.control, "filters.0.frequency", 0.0, -2.0, found, T)
    assert deeper["filters.0.damping_zero"] == pytest.approx(0.06 * 10.0 ** (-1.0 / 20.0), rel=2e-3)
    wider = filter_stepped(loop.control, "filters.0.width", 1.0, 0.0, found, T)
    assert wider["filters.0.damping_pole"] == pytest.approx(0.612)


def test_a_place_that_there_is_not_is_refused(loop: Loop, by_hand: ByHand) -> None:
    for name in ("filters.9.frequency", "law.Kv", "filters.1.width"):
        with pytest.raises(ParameterError, match="there is no filter grip"):
            filter_dragged(loop.control, name, 100.0, None, margins(by_hand, {}), loop.sample_time)
