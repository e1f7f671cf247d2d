"""Start values of laws, observers and compensations on an axis: what each of their numbers is chosen for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import feeddrive as fd
from feeddrive.blocks.axis_model import AxisModel
from feeddrive.blocks.compensation.disturbance_rejection import DisturbanceRejection
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.generalized_predictive import GeneralizedPredictive
from feeddrive.blocks.controller.lqg import LQG
from feeddrive.blocks.controller.super_twisting import SuperTwisting
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.observer.kalman_recovery import KalmanRecovery
from feeddrive.language.errors import StructureError
from field_axes import R, T, W, judged

PRESENT = CascadePPI(Kv=50.0, Kp=1e4)


def axis(late: int = 1, plant: Any = R, **changes: Any) -> AxisModel:
    """The model of R, or of W with two encoders, with `late` samples of dead time."""
    encoders = 1 if plant is R else 2
    encoder = "load" if plant is R else "motor"
    values = {"mass": 40.0, "viscous": 60.0, "frictions": (), "encoders": encoders, "velocity_encoder": encoder}
    return AxisModel(delay=late * T, sample_time=T, plant=plant, **{**values, **changes})


@pytest.mark.parametrize("late", [0, 3, 10])
def test_a_cascade_starts_far_from_its_limit_at_any_dead_time(late: int) -> None:
    """Twice as fast it would start beyond Ms = 2, half as fast without any peak by which a search could judge."""
    law = CascadePPI.begin(axis(late), fd.blocks.LinearADRC(mass=40.0, omega_c=100.0, omega_o=400.0))[0].law
    assert 1.25 < judged(law, late=late)["Ms"] < 1.6


def test_the_horizon_of_the_start_is_better_than_half_and_twice_of_it_at_one_peak_of_sensitivity() -> None:
    """Each horizon has the fastest observer with which Ms <= 2, by bisection."""

    def error(horizon: int) -> float:
        low, high, best = 200.0, 2e4, float("inf")
        for _ in range(5):
            omega_o = (low * high) ** 0.5
            law = GeneralizedPredictive(mass=40.0, viscous=60.0, omega_o=omega_o, horizon=horizon, delay_samples=1)
            figures = judged(law)
            low, high = (omega_o, high) if figures["Ms"] <= 2.0 else (low, omega_o)
            best = figures["ISE"] if figures["Ms"] <= 2.0 else best
        return best

    horizon = GeneralizedPredictive.begin(axis(), PRESENT)[0].law.horizon
    assert error(horizon) < 0.8 * min(error(horizon // 2), error(2 * horizon))


def test_an_encoder_that_gives_in_costs_some_percent_of_the_error() -> None:
    law = LQG.begin(axis(plant=W), PRESENT)[0].law
    cost = judged(law, W)["ISE"] / judged(replace(law, offset_rate=None), W)["ISE"]
    assert 1.015 < cost < 1.035


def test_three_standard_deviations_of_the_noise_stay_inside_the_zone_at_a_quarter_of_its_time() -> None:
    law = SuperTwisting.begin(axis(reading_noise=1e-6), PRESENT)[0].law
    fastest = 0.25 * law.zone_time
    zone = fastest * fastest * law.sign_factor * law.disturbance_rate
    assert zone == pytest.approx(3.0 * 2.0**0.5 * 1e-6 / T, rel=1e-3)


def test_without_noise_the_zone_is_wide_enough_for_five_g_in_a_millisecond() -> None:
    law = SuperTwisting.begin(axis(), PRESENT)[0].law
    assert law.disturbance_rate == pytest.approx(5.0 * 9.81 / 1e-3, rel=0.05)


def test_the_kalman_filter_starts_with_the_count_whose_rounding_has_the_noise_of_the_encoder() -> None:
    """Rounding to counts of q is uniform over q: its variance is q²/12."""
    form = next(form for form in DisturbanceRejection.begin(axis(reading_noise=1e-7)) if "Kalman" in form.name)
    observer: Any = form.block.observer
    assert isinstance(observer, KalmanRecovery)
    assert observer.resolution / 1e-7 == pytest.approx(12.0**0.5, rel=1e-9)


@pytest.mark.parametrize(("force", "is_friction"), [(0.75e-9, False), (1.5e-9, True)])
def test_less_than_a_nanonewton_is_no_friction(force: float, is_friction: bool) -> None:
    model = axis(frictions=(fd.blocks.Coulomb(coulomb=force),))
    if is_friction:
        assert DisturbanceCompensator.begin(model).coulomb_positive == pytest.approx(force)
    else:
        with pytest.raises(StructureError, match="no dry friction"):
            DisturbanceCompensator.begin(model)
