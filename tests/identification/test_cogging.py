"""Cogging: harmonics that stand out by more than chance, and friction kept apart by the direction."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.identification.cogging import CoggingRun, cogging_passes, identify_cogging
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError

TURNS = np.arange(512) / 512.0


def runs(seed: int, noise: float = 0.05, cogging: float = 0.5, ripple: float = 0.2) -> list[CoggingRun]:
    """Order 12 is cogging, order 5 varies with the friction; Coulomb 0.3, constant 0.1."""
    rng = np.random.default_rng(seed)
    found = []
    for direction in (1, -1):
        force = 0.1 + direction * (0.3 + ripple * np.sin(2.0 * np.pi * 5 * TURNS))
        force = force + cogging * np.sin(2.0 * np.pi * 12 * TURNS + 0.7) + noise * rng.standard_normal(512)
        found.append(CoggingRun(TURNS, force, direction))
    return found


def test_cogging_and_friction_come_apart_by_the_direction() -> None:
    fit = identify_cogging(runs(1))
    twelve, five = fit.order(12), fit.order(5)
    assert twelve.even is not None
    assert five.odd is not None
    # an amplitude of 1024 rows with noise 0.05 has the error 0.05 √(2/1024) = 0.0022; four of them
    assert twelve.even.value == pytest.approx(0.5, abs=0.009)
    assert twelve.even_phase == pytest.approx(0.7, abs=0.02)
    assert five.odd.value == pytest.approx(0.2, abs=0.009)
    assert fit.coulomb is not None
    assert fit.coulomb.value == pytest.approx(0.3, abs=0.007)
    assert fit.offset.value == pytest.approx(0.1, abs=0.007)
    assert twelve.even.error == pytest.approx(0.05 * np.sqrt(2.0 / 1024.0), rel=0.25)
    assert [each.order for each in fit.significant[:2]] == [12, 5]
    assert any("order 5" in remark for remark in fit.remarks)


def test_orders_that_are_not_there_are_called_significant_in_few_cases() -> None:
    """5 % of 30 noise-only sets are 1.5; 6 or more come by chance once in 250."""
    false = sum(
        bool(identify_cogging(runs(seed, cogging=0.0, ripple=0.0), range(1, 21)).significant) for seed in range(30)
    )
    assert false <= 5


def test_the_block_balances_what_was_measured() -> None:
    fit = identify_cogging(runs(3, noise=0.0, ripple=0.0))
    block = fit.block(period=0.01, force_per_unit=40.0, most=1)
    x = TURNS * 0.01
    harmonic = block.harmonics[0]
    made = (
        float(block.force)
        * float(harmonic.share)
        * np.sin(2.0 * np.pi * harmonic.order * x / 0.01 + float(harmonic.phase))
    )
    # the force that held the axis is the opposite of what pulled it, 0.5 A at 40 N/A
    np.testing.assert_allclose(made, -20.0 * np.sin(2.0 * np.pi * 12 * TURNS + 0.7), atol=1e-9)


def test_a_long_log_is_cut_at_its_reversals_and_averaged() -> None:
    way = np.linspace(0.0, 3.2, 100_000)
    x = np.concatenate([way, np.full(500, 3.2), way[::-1], way[:20_000]])
    direction = np.repeat([1.0, 1.0, -1.0, 1.0], [100_000, 500, 100_000, 20_000])
    force = 0.3 * direction + np.sin(2.0 * np.pi * 20 * x)
    made = cogging_passes(np.mod(x, 1.0), force, highest=20)
    # the last way is 0.64 periods and is left out
    assert [run.direction for run in made] == [1, -1]
    assert all(run.turns.size <= 32 * 20 * 3.2 for run in made)
    fit = identify_cogging(made, range(1, 21))
    even = fit.order(20).even
    assert even is not None
    # a mean over 1/32 of a wave has sin(π/32) / (π/32) = 0.9984 of its amplitude
    assert even.value == pytest.approx(0.9984, abs=2e-4)
    assert fit.coulomb is not None
    assert fit.coulomb.value == pytest.approx(0.3, abs=1e-3)


def test_what_runs_cannot_tell_is_said() -> None:
    one = identify_cogging(runs(1)[:1])
    assert one.coulomb is None
    assert "the other way" in one.remarks[0]
    with pytest.raises(NotIdentifiableError, match="goes both ways"):
        CoggingRun(np.sin(np.arange(100) / 10.0), np.ones(100))
    with pytest.raises(NotIdentifiableError, match="whole turn"):
        identify_cogging([CoggingRun(0.3 * TURNS, np.sin(TURNS))], range(1, 13))
    with pytest.raises(LogError, match="not finite at row 3"):
        CoggingRun(np.arange(5.0), np.array([1.0, 2.0, np.nan, 1.0, 1.0]))
    with pytest.raises(ParameterError, match="orders"):
        identify_cogging(runs(1), (0, 1))


def test_a_single_sample_is_left_out_of_the_harmonics_and_said() -> None:
    turns = np.concatenate([np.linspace(0.0, 1.0, 2000), np.linspace(1.0, 0.0, 2000)])
    rng = np.random.default_rng(5)
    force = 0.2 * np.sin(2.0 * np.pi * 7.0 * turns) + 0.01 * rng.standard_normal(4000)
    struck = force.copy()
    struck[700] = -30.0
    clean, found = (
        identify_cogging(cogging_passes(turns, each, highest=12, name="slow.csv"), range(1, 13))
        for each in (force, struck)
    )
    # one row less of 2000 moves an amplitude by some of the noise over 2000, 5e-6; -30 A would move it by 15e-3 A
    assert found.order(7).amplitude == pytest.approx(clean.order(7).amplitude, abs=1e-4)
    assert clean.remarks == ()
    assert "slow.csv, force: 1 single sample" in found.remarks[0]
    assert "row 701" in found.remarks[0]


# ---------------------------------------------------------------- what decides: a case on either side of each bound


def test_an_order_is_significant_below_a_probability_of_5_percent() -> None:
    """One order is tried on the same noise with amplitudes from none to certain: so are probabilities of all sizes."""
    noise = np.random.default_rng(2).standard_normal(64)
    turns = np.arange(64) / 64.0
    judged: dict[float, bool] = {}
    for size in np.linspace(0.2, 0.7, 40):
        found = identify_cogging([CoggingRun(turns, noise + size * np.sin(2.0 * np.pi * 3 * turns))], (3,)).order(3)
        judged[found.p_value] = found.significant
    assert all(significant is (p < 0.05) for p, significant in judged.items())
    assert any(0.026 < p < 0.049 for p in judged)
    assert any(0.051 < p < 0.098 for p in judged)


def test_a_column_has_three_rows() -> None:
    """Sixty places hold ten orders of two columns each."""
    turns = np.arange(60) / 60.0
    assert len(identify_cogging([CoggingRun(turns, np.sin(2.0 * np.pi * turns) + turns)]).orders) == 10


@pytest.mark.parametrize(("back", "one_way"), [(1, True), (3, False)])
def test_98_of_100_steps_go_one_way(back: int, one_way: bool) -> None:
    steps = np.where(np.arange(100) < back, -1e-3, 1e-2)
    turns = np.concatenate([[0.0], np.cumsum(steps)])
    if one_way:
        assert CoggingRun(turns, np.sin(turns)).direction == 1
        return
    with pytest.raises(NotIdentifiableError, match="goes both ways"):
        CoggingRun(turns, np.sin(turns))


@pytest.mark.parametrize(("back", "passes"), [(0.014, 1), (0.03, 2)])
def test_a_fiftieth_of_the_travel_back_is_a_reversal(back: float, passes: int) -> None:
    there, again = np.linspace(0.0, 1.5, 3000), np.linspace(1.5 - 3.0 * back, 3.0, 3000)
    x = np.concatenate([there, np.linspace(1.5, 1.5 - 3.0 * back, 50)[1:-1], again])
    assert len(cogging_passes(x, np.sin(2.0 * np.pi * x))) == passes


def test_half_a_percent_at_each_end_of_a_pass_is_left_out() -> None:
    x = np.linspace(0.0, 2.0, 20001)
    (run,) = cogging_passes(x, np.sin(2.0 * np.pi * x), highest=1000)
    assert (run.turns[0], run.turns[-1]) == pytest.approx((0.01, 1.99), abs=1.1e-4)


@pytest.mark.parametrize(("periods", "enough"), [(0.92, False), (0.98, True)])
def test_a_pass_is_a_period_less_a_twentieth(periods: float, enough: bool) -> None:
    x = np.linspace(0.0, periods, 3000)
    if enough:
        assert len(cogging_passes(x, np.sin(2.0 * np.pi * x))) == 1
        return
    with pytest.raises(NotIdentifiableError, match="needs a whole one"):
        cogging_passes(x, np.sin(2.0 * np.pi * x))
