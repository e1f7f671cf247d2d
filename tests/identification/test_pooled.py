"""Several logs of one axis: pooled values whose intervals hold the truth, with the scatter of the logs in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.pooled import PooledFit, identify_pooled, pooled, scatter_of
from feeddrive.identification.motion.rigid import RigidFit, identify_rigid
from feeddrive.language.errors import ParameterError

T = 1e-3
MASSES = np.array([95.0, 95.0, 95.0])


def three_logs(masses: np.ndarray) -> list[MotionLog]:
    """Logs of the foreign simulator, 3 s each."""
    axes = fa.Axes(
        mass=masses, viscous=200.0, coulomb_positive=40.0, coulomb_negative=40.0, dead_time=0.4e-3, noise_log=3.0
    )
    law = fa.Cascade(Kv=25.0, Kp=95.0 * 150.0, rate=15.0, ff=1.0)
    xs = fa.smooth_moves(T, (0.1, 0.0) * 2, 0.2, 2.0, 80.0, 0.1, 0.2)
    logs = fa.simulate(axes, law, xs, T, np.random.default_rng(3), count=masses.size)
    columns = [logs.log(i) for i in range(masses.size)]
    return [
        MotionLog(
            name=str(i), position=log["position"], force=log["force"], set_position=log["setpoint"], sample_time=T
        )
        for i, log in enumerate(columns)
    ]


def fit_like(fit: RigidFit, mass: float, error: float) -> RigidFit:
    first = replace(fit.estimates[0], value=mass, error=error)
    return replace(fit, estimates=(first, *fit.estimates[1:]))


def drawn(fit: RigidFit, rng: np.random.Generator, logs: int, error: float, scatter: float) -> PooledFit:
    true = 100.0 + scatter * rng.standard_normal(logs)
    return pooled([fit_like(fit, m + error * rng.standard_normal(), error) for m in true])


def test_logs_that_agree_are_pooled_by_their_errors() -> None:
    found = identify_pooled(three_logs(MASSES))
    mass = found["mass"]
    assert abs(mass.value - 95.0) < 3.0 * mass.error
    alone = min(fit["mass"].error for fit in found.fits)
    # three alike logs: 1/√3 of one, if their scatter is within their errors
    assert mass.error < 0.9 * alone or found.scatter["mass"] > 0.0
    assert "mass" not in found.differing


def test_logs_of_different_masses_are_said_to_differ_and_the_interval_holds_all() -> None:
    found = identify_pooled(three_logs(np.array([93.0, 95.0, 97.0])), friction="symmetric")
    assert "mass" in found.differing
    assert "mass by" in str(found.remark)
    # the sample deviation of 93, 95, 97 is 2
    assert found.scatter["mass"] == pytest.approx(2.0, abs=0.2)
    low, high = found["mass"].interval
    # Student with two degrees of freedom: 95 ± 4.3 · 2 / √3
    assert high - low == pytest.approx(2.0 * 4.303 * 2.0 / np.sqrt(3.0), rel=0.15)


@pytest.mark.parametrize(("logs", "scatter"), [(2, 0.0), (5, 0.0), (5, 3.0)])
def test_intervals_of_pooled_logs_hold_the_truth(logs: int, scatter: float) -> None:
    """1000 draws: the standard deviation of a share of 0.95 is 0.007; the scatter of five logs is not well known."""
    fit = identify_rigid(three_logs(MASSES[:1])[0], friction="symmetric")
    rng = np.random.default_rng(1)
    within = []
    for _ in range(1000):
        low, high = drawn(fit, rng, logs, 1.0, scatter)["mass"].interval
        within.append(low <= 100.0 <= high)
    # without scatter the scatter that is found by chance only widens
    assert 0.92 < np.mean(within) < (0.98 if scatter else 1.0)


def test_the_scatter_solves_its_equation() -> None:
    y, variance = np.array([1.0, 3.0, 8.0]), np.array([0.1, 0.2, 0.3])
    tau = scatter_of(y, variance)
    w = 1.0 / (variance + tau**2)
    assert w @ (y - w @ y / w.sum()) ** 2 == pytest.approx(2.0, abs=1e-9)
    assert scatter_of(y, 100.0 * np.ones(3)) == 0.0


def test_one_log_and_different_models_are_refused() -> None:
    log = three_logs(MASSES[:1])[0]
    with pytest.raises(ParameterError, match="must be >= 2"):
        identify_pooled([log])
    with pytest.raises(ParameterError, match="friction models"):
        pooled([identify_rigid(log, friction=model) for model in ("symmetric", "directional")])
