"""The experiments of Wu, Han, Xiong & Ding 2017: every claim holds, and the rows where something loses are there."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numpy as np
import pytest

from documented import claims_documented, loose
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.language.progress import Progress
from feeddrive.learning.trials import learn_signal
from feeddrive.loop.simulate import samples
from feeddrive.papers.claims import Claim, Experiment, paper_report
from feeddrive.papers.wu2017 import shipped, testbed, wu2017
from feeddrive.papers.wu2017.learning import (
    EACH,
    EXPECTED,
    KNOWN,
    _driven,
    _learned,
    _signal,
    _trials,
    circle,
    pulsed,
    strong,
)
from feeddrive.papers.wu2017.rates import identity_error
from feeddrive.report.page import html

rates_of = import_module("feeddrive.papers.wu2017.rates")  # the package has a function of this name
learning = pytest.mark.slow(reason="some hundred trials of learning; test_iterative_feedforward.py has the law")


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return wu2017(Progress())


@learning
def test_every_claim_holds(experiment: Experiment) -> None:
    assert not [(claim.key, claim.claim, claim.shown, claim.bounds) for claim in experiment.broken]


@learning
def test_no_claim_accepts_anything_on_one_side_without_a_reason(experiment: Experiment) -> None:
    assert not loose(experiment.claims)


@learning
def test_the_documentation_states_how_many_claims_there_are(experiment: Experiment) -> None:
    assert len(experiment.claims) == claims_documented("Wu")


@learning
def test_every_row_is_there_with_its_rule_and_what_loses(experiment: Experiment) -> None:
    assert {claim.key for claim in experiment.claims} == {f"4.{row}" for row in "abcdefghijklmnopqr"}
    assert all(claim.rule for claim in experiment.claims)
    assert any("loses" in claim.claim for claim in experiment.claims)
    assert any("diverges" in claim.claim for claim in experiment.claims)


@learning
def test_errors_over_the_trials_are_those_of_an_independent_program(experiment: Experiment) -> None:
    """Dwells and noise are not the same there: 12 % of each RMS, a little more than what either moves it by."""
    rows = {(row[0], row[1]): row for row in experiment.tables[0].rows}
    for name, (steps, last) in EXPECTED.items():
        for found, wanted in zip(rows[name, "same"][2:8], steps, strict=False):
            assert found == pytest.approx(1e-6 * wanted, rel=0.12), name
        assert rows[name, "changing"][7] == pytest.approx(1e-6 * last, rel=0.12), name


def test_the_words_state_how_well_an_error_is_known() -> None:
    assert EACH.startswith(f"each known to {100.0 * KNOWN:.0f} %")


def test_the_identity_holds_to_rounding() -> None:
    assert identity_error() < 1e-8


@learning
def test_the_page_has_the_papers_kinds_of_pictures(experiment: Experiment) -> None:
    page = html(paper_report(experiment))
    for shown in experiment.pictures:
        assert f"figure-{shown.key}" in page
    assert {s.key for s in experiment.pictures} == {
        "errors",
        "parameters",
        "overtime",
        "convergence",
        "contour",
        "quadrant",
        "signal",
    }


def failed(claims: list[Claim]) -> list[tuple[object, ...]]:
    return [(claim.key, claim.claim, claim.shown, claim.bounds) for claim in claims if not claim.holds]


@pytest.mark.parametrize("row", shipped.ROWS, ids=lambda row: row.__name__)
def test_the_shipped_blocks_are_their_equations(row: Callable[[], list[Claim]]) -> None:
    assert not failed(row())


def test_the_rates_are_those_of_the_assumed_masses() -> None:
    """Each of the published factors of the mass has a row; at the two beyond them the model loop is unstable."""
    claims, table, _ = rates_of._by_mass()
    assert not failed(claims)
    assert [row[0] for row in table.rows if row[3] == "unstable"] == [0.01, 20.0]


def test_the_scatter_is_that_of_an_independent_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a and b, as in the claims; the deviation of 20 runs is known to 16 %: two of its errors."""
    monkeypatch.setattr(rates_of, "SEEDS", 20)
    rows = {row[0]: row for row in rates_of._scatter()[1].rows}
    for name in ("mass", "viscous"):
        scatter, expected = rows[name][1], rows[name][4]
        assert float(scatter) == pytest.approx(float(expected), rel=0.32), name


def test_six_trials_with_coulomb_columns_end_at_the_published_error() -> None:
    """In µm after trials 1 to 6, to the 12 % by which dwells and noise move each."""
    rms = 1e6 * _trials("+ Coulomb").rms
    np.testing.assert_allclose(rms, [15.46, 2.70, 1.58, 1.35, 1.25, 1.23], rtol=0.12)


def test_the_friction_is_a_tanh_of_the_stated_velocity() -> None:
    """The Stribeck curve of x times tanh(v / 0.2 mm/s), the velocity that `TANH` states."""
    friction = testbed.table_axis("x", testbed.SETS["a, b"]).axis.friction_load
    assert isinstance(friction, Regularised)
    assert "v_t 0.2 mm/s" in testbed.TANH
    for velocity in (2e-5, 2e-4, 6e-4):
        level = 95.0 + (130.0 - 95.0) * np.exp(-((velocity / 6e-3) ** 2))
        sliding = float(friction.steady(velocity)) - float(friction.viscous) * velocity
        assert sliding == pytest.approx(level * np.tanh(velocity / 2e-4), rel=1e-9)


@pytest.mark.parametrize(("force", "rms"), [(testbed.noise, 5.0), (strong, 20.0)])
def test_the_noise_has_the_size_of_the_independent_program(force: Callable[[int], object], rms: float) -> None:
    """5 N of the trials, 20 N of the row on scatter; the deviation of 10,000 samples is known to 0.7 %."""
    assert np.std(force(0).force) == pytest.approx(rms, rel=0.03)  # type: ignore[attr-defined]


def test_the_noise_lasts_as_long_as_the_longest_motion() -> None:
    recorded = testbed.noise(0)
    for reference in (*testbed.CHANGING, circle("x")):
        assert recorded.force.size >= samples(reference.duration, float(recorded.sample_time))


def test_the_pulse_acts_where_no_column_changes() -> None:
    """At constant velocity no column of a, b and Coulomb is like a pulse, which a learned signal removes; with 150 N it
    is larger than the friction of 95 N.
    """
    recorded = testbed.noise(3)
    pulse = pulsed(3).force - recorded.force
    acting = np.flatnonzero(pulse)
    along = testbed.SAME.at(acting * float(recorded.sample_time))
    np.testing.assert_allclose(along.velocity, 0.25, rtol=1e-9)
    assert 95.0 < np.max(pulse) < 2.0 * 95.0


def test_the_circle_has_twenty_millimeters_at_a_tenth_of_a_meter_per_second() -> None:
    at = [circle(axis).at(np.linspace(0.6, 2.0, 50)) for axis in "xy"]
    ways, speeds = [along.position for along in at], [along.velocity for along in at]
    np.testing.assert_allclose(np.hypot(*ways), 0.020, rtol=1e-9)
    np.testing.assert_allclose(np.hypot(*speeds), 0.1, rtol=1e-9)


def test_the_largest_contour_error_is_drawn_within_the_circle() -> None:
    """48 µm of the start, inwards: the magnified curve must not pass the center."""
    turn = np.linspace(0.0, 2.0 * np.pi, 50)
    off = (0.020 - 48e-6) * np.array([np.cos(turn), np.sin(turn)])
    (panel,) = testbed.contour_chart({"start": (off[0], off[1])}).panels
    curve = panel.curves[0]
    np.testing.assert_allclose(np.arctan2(curve.y, curve.x), np.arctan2(off[1], off[0]), atol=1e-9)


def test_the_signal_is_compared_at_its_best_bandwidth() -> None:
    """Half of it leaves friction that a signal could learn, twice as much takes in noise above the velocity loop."""
    axis = testbed.table_axis("x", testbed.SETS["a, b"], smooth=False)
    same = (testbed.SAME,) * 4
    last = _signal(axis, same, testbed.noise)[-1]
    for bandwidth in (25.0, 100.0):
        assert last < 0.95 * learn_signal(axis, same, 4, bandwidth=bandwidth, load=testbed.noise).rms[-1]


def test_the_run_up_accelerates_no_more_than_the_circle() -> None:
    """V²/R = 0.5 m/s², so that the largest error is that of the circle and not that of its start."""
    at = [circle(axis).at(np.linspace(0.0, circle(axis).duration, 4000)) for axis in "xy"]
    assert np.max(np.hypot(*(along.acceleration for along in at))) <= 0.1**2 / 0.020 * (1.0 + 1e-9)


def test_what_is_learned_on_a_line_removes_most_of_the_error_on_the_circle() -> None:
    """At least 70 % of the RMS over the whole circle, as row 4.l claims; two trials or a longer start leave more."""
    columns = testbed.SETS["+ Coulomb"]
    start = _driven({axis: testbed.table_axis(axis, columns, exact=True) for axis in "xy"})
    learned = _driven({axis: _learned(axis, columns, True, line=True) for axis in "xy"})
    assert learned.rms < (1.0 - 0.7) * start.rms
