"""Friction from logs with stops: what friction holds at rest is in no row, and errors cover the truth."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.identification import MotionLog, identify_rigid
from sliding_mass import Cascade, Drive, moved, run, strokes, unknown

T = 1e-3
C, B = 110.0, 800.0


def truth(mass: float) -> dict[str, float]:
    return {"mass": mass, "coulomb": C, "viscous": B, "offset": 0.0}


def test_the_integrator_of_these_logs_stops_where_it_must() -> None:
    """A mass thrown at v under friction c + b v stops after m/b ln(1 + b v/c); at rest it holds any force up to c."""
    drive, v = Drive(95.0, C, B), np.array([0.3])
    x, h = np.zeros(1), 95.0 / B * np.log(1.0 + B * 0.3 / C)
    far = 95.0 / B * (0.3 - C / B * np.log(1.0 + B * 0.3 / C))
    after, speed = moved(drive, x, v, np.zeros(1), 2.0 * h)
    assert after[0] == pytest.approx(far, rel=1e-12)
    assert speed[0] == 0.0
    assert moved(drive, after, speed, np.array([0.99 * C]), T)[0][0] == after[0]
    assert moved(drive, after, speed, np.array([1.01 * C]), T)[0][0] > after[0]


# mass kg, speed m/s, acceleration m/s2, s at speed, stiction over Coulomb, reset time s
STOPS = [
    (95.0, 0.1, 3.0, 0.3, 1.0, 0.0),
    (95.0, 0.1, 3.0, 0.1, 1.3, 0.0),
    (180.0, 0.2, 1.0, 0.4, 1.4, 0.02),
    (60.0, 0.2, 3.0, 0.15, 1.4, 0.02),
]


@pytest.mark.parametrize(("mass", "speed", "acceleration", "seconds", "stiction", "reset"), STOPS)
def test_a_log_without_noise_gives_the_friction_that_made_it(
    mass: float, speed: float, acceleration: float, seconds: float, stiction: float, reset: float
) -> None:
    """Friction was 0.5 to 1 % of Coulomb too small and viscous friction 2 % too large, by 6 of their errors.

    A stop is followed by a step of the acceleration of up to 2 c/m. The position's low pass shows it by 1 % at most in
    a sample that counts, and most rows lie far from one: a tenth of that, 0.1 %, is left of Coulomb friction.  A
    viscous friction that makes up for it at the mean speed is 0.1 % of c over b v: at 0.1 m/s 0.14 %.
    """
    reference = strokes(T, (speed,) * 6, acceleration, seconds=seconds, dwell=0.2)
    law = Cascade(Kv=40.0 if reset == 0.0 else 60.0, Kp=mass * 150.0, Tn=reset)
    position, force = run(Drive(mass, C, B, stiction), law, reference, T)
    fit = identify_rigid(
        MotionLog(name="stops", position=position[0], force=force[0], sample_time=T), friction="symmetric"
    )
    assert fit["coulomb"].value == pytest.approx(C, rel=1e-3)
    assert fit["viscous"].value == pytest.approx(B, rel=1.5e-3)
    assert fit["mass"].value == pytest.approx(mass, rel=1e-3)
    # what is left is the mean of the low pass over a stop, 1 % of c near it; it was 0.7 to 1.7 % of the whole force
    assert fit.residuals.relative < 1e-3


def held(runs: int, mass: float, reset: float, size: float, memory: float, count: float) -> dict[str, float]:
    """Share of 95 % intervals that hold the truth, of so many logs with stops."""
    reference = strokes(T)
    law = Cascade(Kv=30.0, Kp=mass * 150.0) if reset == 0.0 else Cascade(Kv=60.0, Kp=mass * 200.0, Tn=reset, n=2)
    start = count * np.random.default_rng(7).uniform(-0.5, 0.5, runs)
    load = unknown(size, memory, T, runs, reference.size, seed=1)
    drive = Drive(mass, C, B, stiction=1.2, count=count, start=start)
    positions, forces = run(drive, law, reference, T, logs=runs, load=load)
    hits = dict.fromkeys(truth(mass), 0)
    for position, force in zip(positions, forces, strict=True):
        log = MotionLog(name="stops", position=position, force=force, sample_time=T)
        fit = identify_rigid(log, friction="symmetric")
        for name, value in truth(mass).items():
            hits[name] += abs(fit[name].value - value) < 1.96 * fit[name].error
    return {name: hit / runs for name, hit in hits.items()}


# mass kg, reset time s, unknown force N and its memory s, count m
LOGS = [
    (60.0, 0.02, 2.0, 0.005, 5e-8),
    (60.0, 0.0, 2.0, 0.005, 5e-8),
    (60.0, 0.0, 2.0, 0.05, 5e-8),
    (60.0, 0.02, 2.0, 0.05, 5e-8),
    (60.0, 0.02, 2.0, 0.02, 1e-6),
    (180.0, 0.0, 2.0, 0.02, 1e-6),
    (180.0, 0.02, 1.0, 0.02, 5e-6),
    (60.0, 0.0, 1.0, 0.02, 5e-6),
    (60.0, 0.0, 2.0, 0.02, 2e-5),
    (180.0, 0.0, 2.0, 0.02, 2e-5),
]


@pytest.mark.slow(reason="a share of many logs")
def test_intervals_cover_the_truth_of_logs_with_stops() -> None:
    """60 logs: where 95 % are held, fewer than 53 are by a chance of 1 %; 33 to 38 of mass and friction were."""
    shares = held(60, *LOGS[0])
    assert min(shares.values()) >= 53 / 60, shares


@pytest.mark.slow(reason="300 logs of each kind are simulated and identified")
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(
            kind,
            marks=pytest.mark.xfail(
                strict=True,
                reason="counts of 20 um without a set position: least squares takes them for dead time (mass 0.71)",
            ),
        )
        if kind == (60.0, 0.0, 2.0, 0.02, 2e-5)
        else kind
        for kind in LOGS
    ],
)
def test_intervals_cover_the_truth_of_many_logs_with_stops(kind: tuple[float, ...]) -> None:
    """0.90 is meant; of 300 logs that hold 0.90 each, 0.854 or fewer are held by a chance of 0.5 %.

    Wider than needed by half is no error either: not all of the 300 may be held in all four.
    """
    shares = held(300, *kind)
    assert min(shares.values()) >= 0.855, shares
    assert min(shares.values()) < 1.0, shares
