"""The force that repeats along the strokes, against forces in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.force.cogging import Cogging
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.commissioning.cogging import acting, moved, periodic_force
from feeddrive.commissioning.motions import Pace, strokes
from feeddrive.commissioning.trial import predicted
from feeddrive.files.log import Log
from feeddrive.files.machine import read_machine
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.tuning.start_law import start_law

T, MASS, COULOMB, VISCOUS, DELAY = 1e-3, 50.0, 40.0, 300.0, 3e-3  # s, kg, N, N s/m, s
TRAVEL, BEGIN = 0.06, 0.4213  # m
NOISE = 2.0  # N


def log_of(pull: Callable[[np.ndarray], np.ndarray], travel: float = TRAVEL, seed: int = 0) -> Log:
    """Strokes that are followed exactly, and the force that this takes under a pull (N) along the travel."""
    path = strokes(travel, Pace(0.05, 0.5), T).set_position
    speed = np.gradient(path, T)
    falls = 1.0 + 0.4 * np.exp(-np.abs(speed) / 2e-3)
    needed = MASS * np.gradient(speed, T) + VISCOUS * speed + COULOMB * falls * np.sign(speed) - pull(path + BEGIN)
    time = T * np.arange(path.size)
    commanded = np.interp(time + DELAY, time, needed) + NOISE * np.random.default_rng(seed).standard_normal(path.size)
    channels = {"set_position": path + BEGIN, "reading_load": path + BEGIN, "commanded": commanded}
    return Log(
        name="strokes",
        time=time,
        channels=channels,
        units={"set_position": "m", "reading_load": "m", "commanded": "N"},
        sample_time=T,
    )


def wave(period: float, second: float = 0.3, size: float = 30.0) -> Callable[[np.ndarray], np.ndarray]:
    def pull(x: np.ndarray) -> np.ndarray:
        angle = 2.0 * np.pi * x / period + 0.7
        return size * (np.sin(angle) + second * np.sin(2.0 * angle))

    return pull


@pytest.mark.parametrize(
    ("period", "span"),
    [
        # many periods in the travel, as on a screw; some, as of a linear motor; not even one
        (2.5e-3, TRAVEL),
        (0.024, TRAVEL),
        (0.1, TRAVEL),
    ],
)
def test_it_is_found_along_the_travel_to_a_tenth_whatever_its_period(period: float, span: float) -> None:
    found = periodic_force(log_of(wave(period), span), DELAY)
    assert found is not None
    x = BEGIN + np.linspace(0.02, 0.98, 500) * span
    off = found.at(x) - wave(period)(x)
    # a constant is a holding force
    assert np.std(off) < 0.1 * np.std(wave(period)(x))


def test_its_period_is_found_where_the_travel_has_several() -> None:
    found = periodic_force(log_of(wave(0.012)), DELAY)
    assert found is not None
    # a tenth of a step of the grid, which is a tenth of a wave in the travel
    assert TRAVEL / float(found.period) == pytest.approx(TRAVEL / 0.012, abs=0.02)
    assert float(found.force) == pytest.approx(30.0, rel=0.05)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("travel", [TRAVEL, 0.01])
def test_noise_and_friction_are_no_periodic_force(seed: int, travel: float) -> None:
    """Of 1,000 periods that are tried on few rows some fit noise and friction, and not in the other direction."""
    assert periodic_force(log_of(np.zeros_like, travel, seed), DELAY) is None


def test_what_the_windows_average_away_is_no_periodic_force() -> None:
    """A stiff linear motor without one, on short strokes under a soft law: 47 windows, of which one of 1,000 periods
    explains four fifths, in both directions, by a force of 44 N that they would show as 4 N.
    """
    real = read_machine("linear_motor").loop("x")
    fed = (Inertia(mass=40.07), FrictionFeedforward(coulomb_positive=24.5, coulomb_negative=24.5, smoothing=1e-3))
    law = CascadePPI(Kv=23.1, Kp=3702.0, Tn=0.0433)
    guard = Guard(following_error_limit=5e-3, velocity_limit=0.5)
    loop = replace(real, control=Control(law=law, feedforward=fed, force_limit=2000.0, guard=guard))
    made = strokes(TRAVEL, Pace(0.3, 5.0), float(real.sample_time))
    assert periodic_force(predicted(loop, made, 1e-8, 0.0), 2e-3) is None


def test_the_force_that_acts_is_that_of_an_axis_without_it() -> None:
    """It acts at once, and the command a dead time later."""
    log = log_of(wave(2.5e-3))
    found = periodic_force(log, DELAY)
    assert found is not None
    assert found.at(log["reading_load"]) == pytest.approx(wave(2.5e-3)(log["reading_load"]), abs=3.0)
    left = acting(log, found, DELAY)["acting"] - log_of(np.zeros_like)["commanded"]
    # what two noises leave, and a tenth of 30 N
    assert np.std(left) < np.hypot(1.5 * NOISE, 0.1 * 30.0 / np.sqrt(2.0))
    late = acting(log, found, 0.0)["acting"] - log_of(np.zeros_like)["commanded"]
    assert np.std(late) > 1.5 * np.std(left)


def test_a_loop_begins_where_the_axis_stands() -> None:
    axis = Axis(plant=Rigid(mass=MASS))
    started = start_law(axis, T, count=1e-7, force_limit=1e3, force=1e3, motion=(TRAVEL, 0.05, 0.5), spread=0.3)
    loop = started.loop
    found = periodic_force(log_of(wave(0.012)), DELAY)
    assert found is not None
    begun = moved(replace(loop, axis=replace(loop.axis, forces=(found,))), BEGIN)
    (there,) = begun.axis.forces
    assert isinstance(there, Cogging)
    x = np.linspace(0.0, TRAVEL, 50)
    assert there.at(x) == pytest.approx(found.at(x + BEGIN), abs=1e-6)
