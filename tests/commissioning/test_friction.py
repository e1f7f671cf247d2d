"""Place and curve of the friction of an axis that is known, by strokes of a foreign simulator with a known truth."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.force.backlash import Backlash
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.commissioning import friction, motions
from feeddrive.commissioning.friction import fit_friction
from feeddrive.commissioning.motions import Pace
from feeddrive.commissioning.trial import predicted
from feeddrive.files.log import Log
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language.errors import DivergedError, NotIdentifiableError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

T = 1e-3  # s
STIFFNESS, DAMPING = 8e6, 1500.0
KV, KP, TN = 25.0, 6000.0, 0.05
STROKES = motions.strokes(0.03, Pace(speed=0.1, acceleration=2.0), T)
# friction on the motor with a level alone, and on the load with a curve
LOADED, EXTRA = (0.0, 1.0), (0.0, 30.0)


@cache
def foreign() -> tuple[Log, Log]:
    axes = fa.Axes(
        mass=50.0,
        mass_load=30.0,
        stiffness=STIFFNESS,
        damping=DAMPING,
        viscous=200.0,
        coulomb_positive=60.0,
        coulomb_negative=60.0,
        stribeck=np.array(EXTRA),
        stribeck_velocity=0.004,
        share_load=np.array(LOADED),
        dead_time=T,
        resolution=1e-8,
        resolution_load=1e-8,
    )
    law = fa.Cascade(Kv=KV, Kp=KP, rate=1.0 / TN, ff=1.0, position_load=True)
    rng = np.random.default_rng(8)
    logs = fa.simulate(axes, law, STROKES.set_position, T, rng, count=2, substeps=2)
    assert np.all(logs.stable)
    return log_of(logs.log(0), 0.3), log_of(logs.log(1), 0.0)


def log_of(columns: dict[str, np.ndarray], start: float) -> Log:
    """The log as a drive gives it, whose count at the beginning is not 0."""
    channels = {
        "set_position": start + STROKES.set_position,
        "reading_load": start + columns["position_load"],
        "commanded": columns["force"],
    }
    rows = STROKES.set_position.size
    return Log(name="strokes", time=T * np.arange(rows), channels=channels, units={}, sample_time=T)


def loop(plant: Any, **more: Any) -> Loop:
    axis = Axis(
        plant=plant,
        actuator=Actuator(dead_time=T),
        encoder_motor=Encoder(resolution=1e-8) if isinstance(plant, TwoMass) else None,
        encoder_load=Encoder(resolution=1e-8),
        **more,
    )
    return Loop(axis=axis, control=Control(law=CascadePPI(Kv=KV, Kp=KP, Tn=TN)), sample_time=T, name="x")


TWO = TwoMass(mass_motor=50.0, mass_load=30.0, stiffness=STIFFNESS, damping=DAMPING)


@pytest.mark.parametrize("axis", [0, 1], ids=["level on the motor", "curve on the load"])
def test_place_and_curve_are_those_of_a_foreign_axis(axis: int) -> None:
    """The viscous friction of the foreign axis acts on the motor, and the fit has one body for all friction."""
    wrong = loop(TWO, friction_load=Coulomb(coulomb=5.0), friction_motor=Coulomb(coulomb=5.0))
    fit = fit_friction(wrong, foreign()[axis], 80.0)
    assert fit.body == ("motor", "load")[axis]
    assert fit.curve == ("coulomb", "stribeck")[axis]
    found = (fit.axis.friction_motor, fit.axis.friction_load)[axis]
    other = (fit.axis.friction_load, fit.axis.friction_motor)[axis]
    assert other is None, "what was there is replaced"
    assert found is not None
    assert float(found.coulomb) == pytest.approx(60.0, rel=0.05)
    assert float(found.viscous) == pytest.approx(200.0, rel=0.1)
    if axis:
        assert isinstance(found, Stribeck)
        assert float(found.breakaway) == pytest.approx(90.0, rel=0.1)
        assert float(found.stribeck_velocity) == pytest.approx(0.004, rel=0.2)
    # a twentieth of the following error that there is
    log = foreign()[axis]
    assert fit.left < 0.05 * float(np.std(log["set_position"] - log["reading_load"]))


# which candidate is taken, by what each leaves


class Fits:
    """What each candidate leaves of the position, in place of a fit; records what was asked for."""

    def __init__(self, left: dict[tuple[str, str], float | None]) -> None:
        self.left, self.skips = left, set[int]()

    def __call__(self, loop: Loop, log: MotionLog, names: list[str], *, delays: tuple[int, ...], skip: int) -> Any:
        body = "motor" if loop.axis.friction_motor is not None else "load"
        curve = "stribeck" if any(name.endswith("breakaway") for name in names) else "coulomb"
        assert all(f".friction_{body}." in name for name in names)
        assert delays == (0,)
        self.skips.add(skip)
        left = self.left[body, curve]
        if left is None:
            raise DivergedError(f"{body} {curve} diverged")
        return SimpleNamespace(loop=loop, by_delay={0: left})


def chosen(patch: pytest.MonkeyPatch, plant: Any, **left: float | None) -> tuple[str, str]:
    fits = Fits({tuple(name.split("_")): value for name, value in left.items()})  # pyright: ignore[reportArgumentType]
    patch.setattr(friction, "refine", fits)
    fit = fit_friction(loop(plant), foreign()[0], 60.0)
    # a fifth of a second of 1 ms
    assert fits.skips == {200}
    return fit.body, fit.curve


@pytest.mark.parametrize(("left", "curve"), [(0.9, "stribeck"), (0.94, "stribeck"), (0.96, "coulomb")])
def test_a_curve_is_taken_if_it_leaves_a_twentieth_less(
    monkeypatch: pytest.MonkeyPatch, left: float, curve: str
) -> None:
    rigid = Rigid(mass=80.0)
    assert chosen(monkeypatch, rigid, load_coulomb=1e-6, load_stribeck=left * 1e-6) == ("load", curve)


def test_the_better_place_is_taken_and_one_that_fits_where_others_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    far = {"load_coulomb": 3e-6, "load_stribeck": 3e-6, "motor_coulomb": 2.9e-6, "motor_stribeck": 2.9e-6}
    assert chosen(monkeypatch, TWO, **far) == ("motor", "coulomb")
    only = {"load_coulomb": None, "load_stribeck": None, "motor_coulomb": None, "motor_stribeck": 5e-6}
    assert chosen(monkeypatch, TWO, **only) == ("motor", "stribeck")


def test_where_nothing_fits_the_last_reason_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(NotIdentifiableError, match=r"no friction explains the strokes: load stribeck diverged"):
        chosen(monkeypatch, Rigid(mass=80.0), load_coulomb=None, load_stribeck=None)


def test_one_encoder_has_no_motor_to_put_friction_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a rigid axis the motor is the load: a candidate for it would be a KeyError here."""
    assert chosen(monkeypatch, Rigid(mass=80.0), load_coulomb=1e-6, load_stribeck=1e-6) == ("load", "coulomb")


def test_a_play_is_told_by_strokes_that_are_read_at_both_ends() -> None:
    """30 um of play, with friction on both ends of it; 1 um is less than a reading of the strokes tells at 1 ms."""
    gap = 30e-6
    rubs = {f"friction_{body}": Coulomb(coulomb=30.0, viscous=100.0) for body in ("motor", "load")}
    real = loop(TWO, forces=(Backlash(gap=gap),), **rubs)
    log = predicted(real, STROKES, 1e-8, 0.0)
    fit = fit_friction(loop(TWO), log, 60.0, play=True)
    assert fit.gap == pytest.approx(gap, rel=0.1)
    assert [float(force.gap) for force in fit.axis.forces if isinstance(force, Backlash)] == [fit.gap]
    assert fit.axis.friction_motor is not None
    assert float(fit.axis.friction_motor.coulomb) == pytest.approx(30.0, rel=0.1)
    without = fit_friction(loop(TWO), log, 60.0)
    assert without.gap == 0.0
    assert without.left > 3.0 * fit.left
    # a rigid axis has no spring in which it could be
    assert fit_friction(loop(Rigid(mass=80.0)), log, 60.0, play=True).gap == 0.0
