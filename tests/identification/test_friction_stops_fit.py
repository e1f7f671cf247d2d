"""Stops learned from a log: what made the log comes back, and what it does not show is refused."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.feedforward.friction_stops import FrictionStops
from feeddrive.identification.friction_curve import LearnedStops, _with_bells, learned_stops, stretches
from feeddrive.identification.motion.motion_log import MotionLog, Preparation
from feeddrive.language.errors import NotIdentifiableError, ParameterError

T = 2e-4
STIFFNESS, WIDTH = (4e6, 2e6, 1e6, 5e5), (4.5e-6, 9e-6, 12e-6, 24e-6)  # 60 N; none is a width that is offered
EXACT = Preparation(cutoff=2000.0, delay=0.0, decimation=1, reversals=True)
TIME = np.arange(15_000) * T
SWINGS = ((1e-3, 0.7, 0.0), (2e-4, 2.3, 1.0), (3e-5, 7.0, 2.0), (6e-6, 23.0, 0.5))  # m, Hz, rad


def position() -> np.ndarray:
    """3 s of swings from 6 um to 1 mm."""
    return sum((a * np.sin(2.0 * np.pi * f * TIME + p) for a, f, p in SWINGS), np.zeros(TIME.size))


def friction(x: np.ndarray) -> np.ndarray:
    bank = sum((k * stretches(x, w) for k, w in zip(STIFFNESS, WIDTH, strict=True)), np.zeros(x.size))
    return bank + 100.0 * np.gradient(x, T)


def log(x: np.ndarray, force: np.ndarray, noise: float = 1.0) -> MotionLog:
    noisy = force + noise * np.random.default_rng(0).standard_normal(x.size)
    return MotionLog(name="presliding", position=x, force=noisy, sample_time=T)


def missed(found: LearnedStops, x: np.ndarray) -> float:
    """N RMS between the friction without noise and the learned one."""
    block = found.stops
    ours = sum(k * stretches(x, float(w)) for k, w in zip(block.stiffness, block.width, strict=True))
    ours = ours + found["viscous"].value * np.gradient(x, T) + found["offset"].value
    return float(np.sqrt(np.mean((friction(x) - ours) ** 2)))


def test_the_friction_comes_back_from_three_seconds_with_1_N_of_noise() -> None:
    """Level to 0.1 %, stiffness to 1 %, whose error does not know that other widths were offered than the true ones."""
    x = position()
    found = learned_stops(log(x, friction(x)), mass=0.0, how=EXACT)
    assert missed(found, x) < 0.25
    assert found["level"].value == pytest.approx(60.0, rel=1e-3)
    assert found["stiffness"].value == pytest.approx(7.5e6, rel=1e-2)
    for name, true in (("level", 60.0), ("viscous", 100.0), ("offset", 0.0)):
        assert abs(found[name].value - true) < 3.0 * found[name].error
    # left are 1 N of noise and what the widths offered cannot say
    assert found.left == pytest.approx((1.02, 1.01), abs=0.02)
    assert found.plain == pytest.approx((20.9, 22.0), rel=0.02)


@pytest.mark.slow(reason="two fits of 15,000 rows")
def test_the_mass_is_found_beside_it_and_the_rest_taken_by_bells() -> None:
    """A drive that accelerates 40 kg, with 0.1 N of noise and a Stribeck curve of 8 N beside the stops."""
    x = position()
    v = np.gradient(x, T)
    force = friction(x) + 40.0 * np.gradient(v, T) + 8.0 * np.tanh(v / 2e-4) * np.exp(-((v / 4e-3) ** 2))
    how = Preparation(cutoff=500.0, delay=0.0, decimation=10, reversals=True)
    plain, belled = (learned_stops(log(x, force, 0.1), how=how, bells=count) for count in (0, 16))
    for found in (plain, belled):
        assert found["mass"].value == pytest.approx(40.0, rel=0.02)
    assert belled.left[0] < 0.8 * plain.left[0]
    assert belled.left[1] < plain.left[1]
    assert belled.stops.residual(np.float64(2.0 * np.max(np.abs(v)))) == 0.0


def test_one_stop_is_a_table_of_two() -> None:
    x = position()
    found = learned_stops(log(x, 4e6 * stretches(x, 1e-5), 0.1), mass=0.0, widths=(1e-5, 4e-5))
    assert found.stops.width.tolist() == [1e-5, 4e-5]
    assert found.stops.stiffness == pytest.approx([4e6, 0.0], rel=1e-2, abs=1e4)


def test_what_a_log_does_not_show_is_refused() -> None:
    x = position()
    with pytest.raises(NotIdentifiableError, match=r"moves by 2363 um, less than twice the widest stop of 2000 um"):
        learned_stops(log(x, friction(x)), widths=(1e-6, 2e-3))
    with pytest.raises(ParameterError, match=r"widths = .* must be two or more lengths > 0"):
        learned_stops(log(x, friction(x)), widths=(1e-6, -1e-6))
    with pytest.raises(ParameterError, match="mass = -1 kg must be >= 0"):
        learned_stops(log(x, friction(x)), mass=-1.0)
    with pytest.raises(ParameterError, match="bells = 1 must be 0 or at least 2"):
        learned_stops(log(x, friction(x)), bells=1)
    against = log(x, -friction(x))  # the sign of the force is wrong
    with pytest.raises(NotIdentifiableError, match="it does not show presliding"):
        learned_stops(against, mass=0.0)


# ---------------------------------------------------------------- what decides: a case on either side of each bound


def borne(monkeypatch: pytest.MonkeyPatch, level: float, strange: float = 0.0) -> LearnedStops:
    """Stops of a level, where nine tenths of a force of ±10 N are 1 N; another force at 0.75 of the log."""
    x = 1e-3 * np.sin(2.0 * np.pi * np.arange(3000) / 500)
    force = np.where(np.arange(3000) % 500 < 225, 10.0, 1.0) * np.sign(np.cos(2.0 * np.pi * np.arange(3000) / 500))
    force *= 1.0 + 1e-3 * np.sin(np.arange(3000.0))  # no force is held, as a limit would be
    force[2250] += strange

    def solved(columns: np.ndarray, _: np.ndarray) -> tuple[np.ndarray, float]:
        solution = np.zeros(columns.shape[1])
        elongation = stretches(x, 1e-5)
        solution[0] = level / 1e-5 * np.sqrt(np.mean(elongation**2))
        return solution, 0.0

    monkeypatch.setattr("scipy.optimize.nnls", solved)
    log = MotionLog(name="log", position=x, force=force, sample_time=T)
    return learned_stops(log, mass=0.0, widths=(1e-5, 4e-5), how=EXACT)


@pytest.mark.parametrize(("level", "shown"), [(25.0, True), (40.0, False)])
def test_stops_bear_three_times_the_largest_force_of_all_but_a_thousandth(
    monkeypatch: pytest.MonkeyPatch, level: float, shown: bool
) -> None:
    if shown:
        assert borne(monkeypatch, level, 30.0)["level"].value == pytest.approx(level, rel=1e-3)
        return
    with pytest.raises(NotIdentifiableError, match="it does not show presliding"):
        borne(monkeypatch, level, 30.0)


def test_the_last_third_tests_what_the_others_gave(monkeypatch: pytest.MonkeyPatch) -> None:
    plain, strange = borne(monkeypatch, 25.0), borne(monkeypatch, 25.0, 30.0)
    assert strange.left[0] == pytest.approx(plain.left[0])
    assert strange.left[1] > 1.001 * plain.left[1]


def test_bells_have_a_prior_a_thousand_times_as_wide_as_the_noise_of_a_row() -> None:
    """Two bells at speeds of ±1 with values q = e^-½ at each other, and a residual of ±1: h = (1-q)/((1-q)² + 2 ρ)."""
    v = np.repeat([-1.0, 1.0], 500)
    stops = FrictionStops(width=np.array([1e-5, 4e-5]), stiffness=np.array([1.0, 1.0]))
    found = _with_bells(stops, 0.5 * v, v, slice(0, 1000), 2)
    q = np.exp(-0.5)
    expected = (1.0 - q) / ((1.0 - q) ** 2 + 2e-3)
    assert np.asarray(found.residual_force) == pytest.approx([-expected, expected], rel=1e-3)
