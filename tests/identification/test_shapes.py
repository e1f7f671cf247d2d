"""What the samples of two channels show of each other: closed forms, and both sides of each threshold."""

from __future__ import annotations

import numpy as np
import pytest

from column_logs import trapezoids
from feeddrive.files.columns import Column
from feeddrive.files.role_checks import RoleDoubt, doubts_of
from feeddrive.identification import shapes

T = 1e-3


def move(rows: int = 4000) -> np.ndarray:
    """A position with ramps, rests and two speeds, m."""
    x = trapezoids(np.random.default_rng(5), T, [0.1, -0.1, 0.05, -0.05, 0.08, -0.08], 0.2, 2.0)
    return x[:rows] if x.size >= rows else np.pad(x, (0, rows - x.size), mode="edge")


def rates(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    v = np.gradient(x, T)
    return v, np.gradient(v, T)


def force(x: np.ndarray, share: float = 0.0, seed: int = 1) -> np.ndarray:
    """The force on 50 kg with friction of 20 N; a share of its power is noise, slow enough to be seen."""
    v, a = rates(x)
    clean = 50.0 * a + 20.0 * np.sign(v) * (np.abs(v) > 1e-6)
    return clean + noise_of(x.size, seed) * np.sqrt(share / (1.0 - share)) * np.std(clean[np.abs(v) > 0.004])


def noise_of(rows: int, seed: int) -> np.ndarray:
    """Noise of standard deviation 1 that a mean over 20 ms hardly lessens."""
    smooth = np.convolve(np.random.default_rng(seed).standard_normal(rows), np.ones(80), mode="same")
    return smooth / np.std(smooth)


def doubts(others: dict[str, np.ndarray] | None = None, **channels: np.ndarray) -> dict[str, RoleDoubt]:
    found = doubts_of(channels, {role: Column(name=role[:3]) for role in channels}, T, others or {})
    return {doubt.kind: doubt for doubt in found}


def delayed(x: np.ndarray, samples: float) -> np.ndarray:
    return np.interp(np.arange(x.size) - samples, np.arange(x.size), x)


@pytest.mark.parametrize("unit", [1.0, 1e-3, -60.0])
def test_a_position_is_the_integral_of_its_velocity(unit: float) -> None:
    """k of Δx = k ∫ v dt is 1 over the unit; 1e-6: the sums of both rules are those of the same trapezoids."""
    x = 0.5 + np.cumsum(noise_of(3000, 2)) * T
    v = np.gradient(x, T)
    explained, k = shapes.integral_of(x, unit * v, T)
    assert explained > 0.999
    assert k == pytest.approx(1.0 / unit, rel=2e-3)  # np.gradient spreads a step over two samples
    assert shapes.integral_of(unit * v, x, T)[0] < 0.5


@pytest.mark.parametrize("lag", [-30.0, -2.5, 0.0, 0.7, 20.0])
def test_a_lag_is_found_to_a_fraction_of_a_sample(lag: float) -> None:
    like = shapes.likeness(move(), 3.0 + 2.0 * delayed(move(), lag), T)
    assert like.lag == pytest.approx(lag, abs=0.1)
    assert like.gain == pytest.approx(2.0, rel=1e-2)  # linear interpolation is a low-pass
    assert like.explained > 0.999


def test_the_mass_of_a_force_by_acceleration() -> None:
    x = move()
    found = shapes.driven(x, force(x), T)
    # 2 %: friction changes its sign within a window
    assert found.mass == pytest.approx(50.0, rel=0.02)
    assert found.explained > 0.99
    by_velocity = shapes.driven(rates(x)[0], force(x), T, is_velocity=True)
    assert by_velocity.mass == pytest.approx(50.0, rel=0.02)
    assert shapes.driven(x, -force(x), T).mass == pytest.approx(-50.0, rel=0.02)


@pytest.mark.parametrize(("rows", "told"), [(150, False), (300, True)])
def test_a_short_log_tells_nothing(rows: int, told: bool) -> None:
    x = 0.1 * np.sin(2.0 * np.pi * 8.0 * T * np.arange(rows))
    assert (shapes.likeness(x, delayed(x, 5.0), T).explained > 0.9) is told


@pytest.mark.parametrize(("seconds", "alike"), [(0.08, True), (0.15, False)])
def test_an_actual_value_trails_by_a_tenth_of_a_second_at_most(seconds: float, alike: bool) -> None:
    x = np.cumsum(noise_of(4000, 3)) * T
    assert (shapes.likeness(x, delayed(x, seconds / T), T).explained > shapes.SAME) is alike


def mixed(x: np.ndarray, explained: float) -> np.ndarray:
    """A channel of which `explained` of the changes are those of x."""
    other = np.cumsum(noise_of(x.size, 9)) * T
    grid = shapes.Grid.of(x.size, T)
    a, b = grid.change(x), grid.change(other)
    b_free = other - (a @ b) / (a @ a) * x
    size = np.sqrt((1.0 - explained) / explained) * np.linalg.norm(a) / np.linalg.norm(grid.change(b_free))
    return x + size * b_free


@pytest.mark.parametrize(
    ("explained", "kind", "certain"),
    [(0.35, "axis", True), (0.7, "axis", False), (0.82, "axis", False), (0.96, "", False)],
)
def test_another_axis_is_one_that_moves_otherwise(explained: float, kind: str, certain: bool) -> None:
    x = move()
    found = doubts(setpoint_position=x, position_load=mixed(x, explained))
    assert set(found) - {"late"} == ({kind} if kind else set())
    assert not kind or found[kind].certain is certain


@pytest.mark.parametrize(("explained", "is_velocity"), [(0.7, False), (0.98, True)])
def test_a_velocity_is_one_whose_integral_is_the_position(explained: float, is_velocity: bool) -> None:
    x = move()
    v = np.gradient(mixed(x, explained), T)
    assert ("axis" in doubts(position_load=x, velocity_load=v)) is not is_velocity


@pytest.mark.parametrize(("noise", "doubted"), [(0.6, True), (0.05, False)])
def test_a_force_follows_acceleration_and_friction(noise: float, doubted: bool) -> None:
    x = move()
    assert ("force" in doubts(position_load=x, force=force(x, noise))) is doubted


@pytest.mark.parametrize(("coulomb", "doubted"), [(0.0, True), (150.0, False)])
def test_a_command_of_a_speed_loop_is_no_force(coulomb: float, doubted: bool) -> None:
    """With 150 N beside 1000 N s/m at 0.2 m/s the velocity explains some 90 %."""
    x = move()
    v, a = rates(x)
    f = 1000.0 * v + 0.5 * a + coulomb * np.sign(v)
    assert ("force" in doubts(position_load=x, command=f)) is doubted


@pytest.mark.parametrize(("lag", "told"), [(0.7, 0.0), (1.5, 0.5), (-1.5, -0.5), (-0.7, 0.0)])
def test_a_lead_of_less_than_a_sample_tells_nothing(lag: float, told: float) -> None:
    x = move()
    assert shapes.order(x, delayed(x, lag), None, T) == told


@pytest.mark.parametrize(
    ("lag", "times", "told"),
    [
        (0.0, 3.0, 0.0),
        (0.0, 6.0, 0.5),
        (5.0, 1.5, 0.5),
        (5.0, 3.0, 1.0),
        (-5.0, 6.0, -0.5),
        (-5.0, 12.0, 1.0),
    ],
)
def test_lead_and_force_tell_the_setpoint_together(lag: float, times: float, told: float) -> None:
    """The force follows the second position; with the first it leaves so many times as much unexplained."""
    actual = move()
    ripple = 1e-6 * np.sin(2.0 * np.pi * 12.0 * T * np.arange(actual.size))

    def case(size: float) -> tuple[np.ndarray, np.ndarray]:
        # without a lag a ripple of the setpoint, which the force does not follow; with it noise, which is of both
        if lag == 0.0:
            return actual + size * ripple, force(actual, 1e-4)
        return delayed(actual, -lag), force(actual, 1e-4 + 0.3 / (1.0 + size), seed=4)

    def ratio(size: float) -> float:
        goal, f = case(size)
        left = [1.0 - shapes.driven(x, f, T).explained for x in (goal, actual)]
        return left[0] / left[1]

    low, high = 0.0, 1.0
    while ratio(high) < times:
        high *= 2.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ratio(middle) < times else (low, middle)
    goal, f = case(high)
    assert shapes.order(goal, actual, f, T) == told


@pytest.mark.parametrize(
    ("errors", "kinds", "certain"), [(1.8, {"open"}, False), (3.5, {"encoders"}, False), (7.0, {"encoders"}, True)]
)
def test_five_standard_errors_tell_motor_and_table_apart(errors: float, kinds: set[str], certain: bool) -> None:
    """The second encoder runs ahead by a compliance that is so many of its standard errors."""
    x = move()
    _, a = rates(x)
    noise = 1e-6 * noise_of(x.size, 6)

    def ahead(compliance: float) -> float:
        return shapes.ahead(x, x + compliance * a + noise, T)

    low, high = 0.0, 1e-5
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if -ahead(middle) < errors else (low, middle)
    found = doubts(position_motor=x, position_load=x + high * a + noise)
    assert set(found) == kinds
    assert all(doubt.certain is certain for doubt in found.values())


@pytest.mark.parametrize(("gain", "doubted"), [(1.5, False), (3.0, True), (0.4, True), (1e-3, True)])
def test_units_differ_by_more_than_a_slow_loop(gain: float, doubted: bool) -> None:
    x = move()
    found = doubts(setpoint_position=x, position_load=gain * x)
    assert ("unit" in found) is doubted
    if gain == 1e-3:
        assert "--set-position 'set:mm'" in found["unit"].why


def test_a_power_is_no_force() -> None:
    x = move()
    found = doubts(position_load=x, force=force(x) * rates(x)[0])
    assert "looks like a power" in found["force"].why
    assert found["force"].certain


def test_nothing_is_said_of_a_log_at_rest() -> None:
    rest = np.full(1000, 0.3)
    assert doubts(setpoint_position=rest, position_load=rest, force=rest) == {}
    short = 1e-3 * np.linspace(0.0, 1.0, 150) ** 2
    assert doubts(position_motor=short, position_load=1.0001 * short) == {}


@pytest.mark.parametrize(("rough", "smooth"), [(0.4, True), (0.7, False)])
def test_a_set_position_is_smoother(rough: float, smooth: bool) -> None:
    """`rough`: its noise over that of the reading, whose third differences have the same ratio."""
    x, noise = move(), noise_of(move().size, 3)
    other = noise_of(move().size, 4)
    assert shapes.smoother(x + rough * 1e-5 * noise, x + 1e-5 * other) is smooth
