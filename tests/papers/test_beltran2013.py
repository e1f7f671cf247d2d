"""Beltrán-Carbajal et al. 2013: every claim holds, and the tables show the rows in which it loses."""

from __future__ import annotations

import pytest

from documented import claims_documented
from feeddrive.language.progress import Progress
from feeddrive.papers.beltran2013 import beltran2013, mill
from feeddrive.papers.claims import Experiment
from feeddrive.plot.drawing import drawn
from mutants import PLACES

pytestmark = pytest.mark.slow(reason="the whole paper: seventeen runs of a machine of three axes")


@pytest.fixture(scope="module")
def found() -> Experiment:
    return beltran2013(Progress())


def test_every_claim_holds(found: Experiment) -> None:
    assert not found.broken, found.table()
    assert len({claim.key for claim in found.claims}) == len(found.claims)


def test_the_documentation_states_how_many_claims_there_are(found: Experiment) -> None:
    assert len(found.claims) == claims_documented("Beltrán")


def test_every_equation_that_is_mutated_is_named_by_a_claim(found: Experiment) -> None:
    named = {name for claim in found.claims for name in claim.equations}
    assert {place.equation for place in PLACES if place.paper == "beltran2013"} <= named


@pytest.mark.parametrize(
    ("key", "least", "most"),
    [
        # the rows that must hold, with their bounds stated a second time
        ("3.a", None, 5.1e-5),  # N, the force to the printed digits
        ("3.c", None, 1e-6),  # power balance
        ("3.i", 22.85, 22.95),  # mm, m g / (M omega_c²)
        ("3.j.x", 100.0, None),
        ("3.j.y", 100.0, None),
        ("3.j.z", 100.0, None),
        ("3.k.x", None, 0.2),
        ("3.k.y", None, 0.2),
        ("3.l.x", 0.35, 1.05),  # m/s²
        ("3.l.y", 0.35, 1.05),
        ("3.l.z", 0.35, 1.05),
        ("3.r", 0.735, 0.745),
        ("3.s", 2.0, 2.02),
        ("3.v", 2.57, 2.59),  # ms
        ("3.w", 0.165, 0.175),  # ms
    ],
)
def test_what_must_hold(found: Experiment, key: str, least: float | None, most: float | None) -> None:
    claim = next(claim for claim in found.claims if claim.key == key)
    assert least is None or claim.got >= least
    assert most is None or claim.got <= most


def test_rows_in_which_it_loses_are_printed(found: Experiment) -> None:
    """Zero-order hold, and every frequency above 72 Hz, where subtracting the estimate does harm."""
    table, _, frequencies = found.tables
    assert any("zero-order" in row[0] for row in table.rows)
    above = [row for row in frequencies.rows if float(row[0]) > 80.0]
    assert above
    assert all(float(row[9]) > 1.0 and float(row[10]) > 1.0 for row in above)


def test_set_valued_friction_keeps_the_order(found: Experiment) -> None:
    """Without the estimate worst, then zero-order hold, linear, Bezier; for x and y, by RMS."""
    rows = {row[0]: row for row in found.tables[1].rows}
    order = ("estimate not used", "reading kept", "estimate subtracted, linear", "estimate subtracted, Bezier")
    for column in (1, 2):
        rms = [
            float(next(row for name, row in rows.items() if name.startswith(begin))[column].split("/")[1])
            for begin in order
        ]
        assert rms == sorted(rms, reverse=True)


def test_the_pictures_are_drawn(found: Experiment) -> None:
    for shown in found.pictures:
        assert shown.key.isalpha()
        figure = drawn(shown.chart())
        assert all(len(line.get_xdata()) for ax in figure.axes for line in ax.get_lines())


@pytest.mark.parametrize("taylor_states", [2, 4, 7])
def test_other_orders_leave_over_what_their_polynomial_says(taylor_states: int) -> None:
    """Measured in the running loop at 60 Hz, within 1 %: the sampled observer turns 0.07 rad of its own a sample."""
    measured, _ = mill.sine_test(60.0, taylor_states)
    expected = mill.left_over(mill.observer_of(taylor_states), 60.0)
    assert abs(measured - expected) <= 0.01 * abs(expected)
