"""Several logs of one axis: pooled values whose intervals hold the truth, with the scatter of the logs in them."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.identification.motion.identify import Identified, identify_motion
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.pooled import (
    IdentifiedLogs,
    LogValues,
    PooledFit,
    identify_pooled,
    law_table,
    pool_logs,
    pooled,
    scatter_of,
)
from feeddrive.identification.motion.rigid import RigidFit, identify_rigid
from feeddrive.identification.regression import Estimate
from feeddrive.language import tree
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.judgment import Judgment

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


def test_parameters_that_only_some_logs_have_are_named_and_not_pooled() -> None:
    mass, slope = Estimate("mass", 90.0, "kg", 1.0, 1.0), Estimate("slope", 3.0, "N/m", 1.0, 1.0)
    found = pooled([LogValues("a", (mass, slope)), LogValues("b", (replace(mass, value=91.0),))])
    assert ([estimate.name for estimate in found.estimates], found.apart) == (["mass"], ("slope",))


def test_a_chance_below_one_in_ten_thousand_is_not_told() -> None:
    """Two values that differ by d of their errors: the chance is that of a normal value beyond d / √2."""
    for apart, shown in ((5.4, "0.013 %"), (5.6, "< 0.01 %")):
        values = [LogValues(str(k), (Estimate("mass", k * apart, "kg", 1.0, 1.0),)) for k in (0, 1)]
        assert f"{pooled(values).compared()}".splitlines()[-1].split("  ")[-1].strip() == shown


def test_one_more_log_is_worth_what_students_factor_says() -> None:
    """Two logs that differ by 2 with small errors: 12.7 · √(2 / 2); with a third one 4.30 · √(2 / 3)."""
    values = [LogValues(str(k), (Estimate("mass", 90.0 + 2.0 * k, "kg", 1e-3, 1e-3),)) for k in (0, 1)]
    found = pooled(values)
    assert 1.96 * found["mass"].error == pytest.approx(12.706, rel=1e-3)
    assert 1.96 * found.with_one_more("mass") == pytest.approx(4.303 * np.sqrt(2.0 / 3.0), rel=1e-3)


# logs that were identified alone, with their laws


@pytest.fixture(scope="module")
def alone() -> list[Identified]:
    """Two logs of one foreign axis of drawn size, under a P-P cascade of drawn gains."""
    rng = np.random.default_rng(21)
    mass = rng.uniform(60.0, 150.0)
    axes = fa.Axes(
        mass=np.full(2, mass),
        viscous=2.0 * mass,
        coulomb_positive=0.4 * mass,
        coulomb_negative=0.4 * mass,
        noise_log=0.03 * mass,
        resolution=1e-8,
    )
    law = fa.Cascade(Kv=rng.uniform(20.0, 30.0), Kp=mass * rng.uniform(120.0, 170.0), ff=1.0)
    xs = fa.smooth_moves(T, (0.1, 0.0) * 3, 0.2, 2.0, 80.0, 0.1, 0.1)
    logs = fa.simulate(axes, law, xs, T, rng, count=2)
    columns = [logs.log(i) for i in range(2)]
    found = [
        identify_motion(
            MotionLog(
                name=f"{'ab'[i]}.csv",
                position=log["position"],
                force=log["force"],
                set_position=log["setpoint"],
                sample_time=T,
            ),
            friction="symmetric",
        )
        for i, log in enumerate(columns)
    ]
    assert all(one.control is not None for one in found)
    return found


def scaled(found: Identified, mass: float = 1.0, **gains: float) -> Identified:
    """The result with a mass and gains that are so many times as large."""

    def times(estimates: tuple[Estimate, ...], factors: dict[str, float]) -> tuple[Estimate, ...]:
        return tuple(
            replace(e, value=e.value * factors.get(e.name.rsplit(".", 1)[-1], 1.0), error=e.error) for e in estimates
        )

    assert found.control is not None
    reading, *others = found.control.readings
    readings = (replace(reading, estimates=times(reading.estimates, gains)), *others)
    refinement = found.refinement
    if refinement is not None:
        refinement = replace(refinement, estimates=times(refinement.estimates, {"mass": mass}))
    return replace(
        found,
        rigid=replace(found.rigid, estimates=times(found.rigid.estimates, {"mass": mass})),
        refinement=refinement,
        control=replace(found.control, readings=readings),
    )


def pool(*found: Identified) -> IdentifiedLogs:
    def again(k: int, friction: str) -> Identified:
        raise AssertionError(f"log {k} has {friction} friction already")

    return pool_logs(found, again)


def test_two_logs_become_one_model_with_the_pooled_values_and_the_law(alone: list[Identified]) -> None:
    found = pool(*alone)
    assert found.advice.judgment is Judgment.USE_VALUES
    assert found.loop is not None
    masses = [one.mass.value for one in alone]
    assert min(masses) <= found["mass"].value <= max(masses)
    assert tree.get(found.loop, "axis.x.plant.mass") == found["mass"].value
    errors = [fit["mass"].error for fit in found.pooled.fits]
    assert found["mass"].error < max(errors) or found.pooled.scatter["mass"] > 0.0
    laws = law_table(found)
    assert laws is not None
    assert sum(row[-1] == "taken" for row in laws.rows) == 1


@pytest.mark.parametrize(("times", "pooled_"), [(1.2, True), (1.3, False)])
def test_logs_of_different_axes_are_not_pooled(times: float, pooled_: bool, alone: list[Identified]) -> None:
    first, second = alone[0], scaled(alone[1], mass=times * alone[0].mass.value / alone[1].mass.value)
    if pooled_:
        # two logs that are 20 % apart tell nothing of their mass
        assert pool(first, second).advice.judgment is Judgment.DO_NOT_TRUST
        return
    with pytest.raises(LogError, match=r"b\.csv: gives a mass of .*where a\.csv gives .*different axes or loads"):
        pool(first, second)


def test_a_wrong_clock_shows_in_mass_and_gains_of_the_other_log(alone: list[Identified]) -> None:
    """1.02 in the sample time: 1.02² in the mass, 1.02 in Kp, 1/1.02 in Kv."""
    slow = scaled(alone[1], mass=1.02**2, Kp=1.02, Kv=1.0 / 1.02)
    found = pool(alone[0], slow)
    assert found.advice.judgment is Judgment.SCALES_IN_DOUBT
    # the gains of the two logs differ by half a percent before
    assert re.search(
        r"the sample time of 'b\.csv' is stated (1\.[5-9]|2|2\.[0-5]) % too long", str(found.recommendation)
    )
    assert found.unusable
    # a mass alone is another load, which the scatter holds and a remark says
    loaded = pool(alone[0], scaled(alone[1], mass=1.08))
    assert not loaded.contradicted
    assert any("more mass moves in 'b.csv' than in 'a.csv'" in str(remark) for remark in loaded.remarks)


def test_laws_that_differ_are_said_and_none_is_taken(alone: list[Identified]) -> None:
    """10 % or three errors make another gain."""
    same, other = pool(alone[0], scaled(alone[1], Kv=1.07)), pool(alone[0], scaled(alone[1], Kv=1.3))
    assert same.model.control is not None
    assert (other.model.control, other.loop) == (None, None)
    assert any("the laws of the logs differ (a.csv P-P cascade" in str(remark) for remark in other.remarks)
    assert {estimate.name for estimate in other.pooled.estimates} == {"mass", "viscous", "coulomb", "offset"}
    without = pool(alone[0], replace(alone[1], control=None, refinement=None, loop=None))
    assert without.loop is not None
    assert any("none was found in b.csv" in str(remark) for remark in without.remarks)


def test_the_same_rows_count_once_and_a_faulty_log_is_named(alone: list[Identified]) -> None:
    twin = replace(alone[0], log=replace(alone[0].log, name="copy.csv"))
    with pytest.raises(ParameterError, match=r"copy\.csv: holds the same rows as a\.csv"):
        pool(alone[0], twin)
    with pytest.raises(ParameterError, match="must be >= 2"):
        pool(alone[0])
    doubtful = pool(alone[0], replace(alone[1], contradicted="'v' says that the clock is wrong"))
    assert doubtful.advice.judgment is Judgment.SCALES_IN_DOUBT
    assert "b.csv: 'v' says that the clock is wrong; correct this log, or leave it out" in str(doubtful.recommendation)
