"""The filter pack by hand: where a filter begins, its response, and what leads from one control to another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.margins import Margins, margins
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.notch import Notch
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.control import Control
from feeddrive.tuning.by_hand import ByHand
from feeddrive.tuning.filters import (
    begun_filter,
    difference,
    filter_kinds,
    filter_response,
    read_filter,
    with_filters,
    written_filter,
)
from feeddrive.tuning.operating_point import modelled_point

T = 1e-4


@pytest.fixture(scope="module")
def control() -> Control:
    return fd.read_machine("ball_screw").loop(None).control


def resonant(frequency: float, damping: float) -> Margins:
    """A free mass that crosses over at 20 Hz, and one resonance in series."""
    f = np.geomspace(1.0, 4000.0, 4000)
    s = 1j * f / frequency
    return margins(fd.FRF(f, (20.0 / (1j * f)) ** 2 / (s * s + 2.0 * damping * s + 1.0), "cut", "force", "N/N", T))


def values(block: object) -> dict[str, float]:
    return dict(tree.leaves(block))


def test_the_response_of_a_filter_is_that_of_its_equation() -> None:
    """By Tustin with prewarping the notch is exact at s = jω of the warped frequency axis."""
    notch, f = Notch(frequency=300.0, damping_zero=0.05, damping_pole=0.4), np.array([10.0, 299.0, 300.0, 2500.0])
    s = 1j * np.tan(np.pi * f * T) / np.tan(np.pi * 300.0 * T)
    wanted = (s * s + 2.0 * 0.05 * s + 1.0) / (s * s + 2.0 * 0.4 * s + 1.0)
    assert np.max(np.abs(filter_response(notch, f, T) - wanted)) < 1e-9


def test_a_notch_begins_on_the_resonance() -> None:
    made = begun_filter("notch", resonant(300.0, 0.01), T)
    assert values(made)["frequency"] == pytest.approx(300.0, rel=2e-3)  # the lines are 0.2 % apart
    assert values(begun_filter("notch", resonant(300.0, 0.01), T, at=123.0))["frequency"] == 123.0


def test_of_several_resonances_that_nearest_to_minus_one_is_taken() -> None:
    """The first is a circle of 3 on the side away from -1, the second one of 0.7 towards it."""
    f = np.geomspace(1.0, 1000.0, 6000)

    def circle(at: float) -> np.ndarray:
        return 1.0 / (1.0 + 1j * (f / at - at / f) / 0.02)

    L = (10.0 / (1j * f)) ** 2 + 3.0 * circle(60.0) - 0.7 * circle(200.0)
    loop = margins(fd.FRF(f, L, "cut", "force", "N/N", T))
    assert values(begun_filter("notch", loop, T))["frequency"] == pytest.approx(200.0, rel=2e-3)


@pytest.mark.parametrize("kind", filter_kinds())
@pytest.mark.parametrize("resonance", [35.0, 300.0])
def test_a_filter_begins_with_little_phase_at_the_crossover(kind: str, resonance: float) -> None:
    """10° of it, of which one more digit than four is lost by rounding."""
    loop = resonant(resonance, 0.01)
    assert loop.crossover is not None
    lag = np.degrees(np.angle(filter_response(begun_filter(kind, loop, T), np.array([loop.crossover]), T)[0]))
    assert -10.02 < lag < 0.0


def test_a_filter_is_written_and_read_to_the_same_numbers() -> None:
    for kind in filter_kinds():
        made = begun_filter(kind, resonant(300.0, 0.01), T)
        read = read_filter(written_filter(made))
        assert (read.kind, values(read)) == (kind, values(made))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("notsch:frequency=1", "did you mean notch"),
        ("notch:frequenzy=1", "did you mean frequency"),
        ("notch:frequency=x", "'x' is no number"),
        ("notch:frequency", "NAME=VALUE"),
        ("notch:damping_zero=0.1", "needs frequency in Hz"),
        ("notch:frequency=-5", r"must be > 0 Hz"),
    ],
)
def test_a_filter_that_cannot_be_read_says_why(text: str, reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        read_filter(text)


def test_what_leads_from_one_control_to_another_leads_there(control: Control) -> None:
    other = replace(control, filters=(LowPass(frequency=900.0), *control.filters[1:], Notch(frequency=222.0)))
    other = tree.vary(other, {"law.Kv": 77.0})
    found = difference(control, other)
    assert found is not None
    made = tree.vary(with_filters(control, found.removed, found.added), dict(found.values))
    assert tree.structure(made) == tree.structure(other)
    assert values(made) == values(other)


def test_the_fewest_changes_are_found(control: Control) -> None:
    """Of two notches that one stays whose numbers are the same; a law of another kind cannot be led to."""
    two = replace(control, filters=(Notch(frequency=100.0), Notch(frequency=200.0)))
    found = difference(two, replace(two, filters=(Notch(frequency=200.0),)))
    assert found is not None
    assert (found.removed, found.added, dict(found.values)) == ((0,), (), {})
    same = difference(two, two)
    assert same is not None
    assert same.is_empty
    law = fd.read_machine("linear_motor").loop(None).control.law
    assert type(law) is not type(two.law) or difference(two, replace(two, law=replace(law, position_every=4))) is None


def test_a_filter_that_is_added_and_removed_leaves_the_loop_as_it_was(control: Control) -> None:
    point = modelled_point(fd.read_machine("ball_screw").loop(None))
    more = with_filters(control, (), (Notch(frequency=222.0),))
    before, beside, after = (
        ByHand(each, [point]).at({}).figures[0].loop_gain.response
        for each in (control, more, with_filters(more, (2,), ()))
    )
    assert np.array_equal(before, after)
    assert not np.allclose(before, beside)
    with pytest.raises(ParameterError, match=r"no filters\.2 to remove; the filters are: filters\.0 \(notch\)"):
        with_filters(control, (2,), ())
