"""Output error with friction near standstill, elasticity or a dead time that its model lacks: the errors say so."""

from __future__ import annotations

import math

import numpy as np
import pytest

import feeddrive as fd
import foreign_axis as foreign
from feeddrive.identification.motion import output_error
from feeddrive.identification.motion.identify_law import identify_control
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.output_error import Refinement, refine

T = 1e-3
AXIS = foreign.Axes(mass=100.0, viscous=250.0, coulomb_positive=60.0, coulomb_negative=60.0, noise_drive=1.0)
LAW = foreign.Cascade(Kv=18.0, Kp=5000.0, ff=1.0, n=1)
TRUTH = {"mass": 100.0, "viscous": 250.0, "coulomb": 60.0}


def fitted(path: np.ndarray, **changes: float) -> Refinement:
    """Return the fit of a foreign log along a path, with plain friction and a dead time of whole samples."""
    axis = foreign.replace(AXIS, **changes)
    columns = foreign.simulate(axis, LAW, path, T, np.random.default_rng(3)).log(0)
    log = MotionLog(
        name="starts",
        position=columns["position"],
        force=columns["force"],
        set_position=columns["setpoint"],
        sample_time=T,
    )
    friction = fd.blocks.Coulomb(coulomb=50.0, viscous=200.0)
    begun = fd.Axis(plant=fd.blocks.Rigid(mass=90.0), friction_load=friction)
    return refine(fd.Loop(control=identify_control(log).control(), axis=begun, sample_time=T), log)


# strokes at five speeds: most acceleration lies beside standstill
SLOW = foreign.constant_speeds(T, [0.004, 0.01, 0.02, 0.04, 0.06], 0.008, 0.8)
FAST = foreign.smooth_moves(T, (0.05, 0.0, 0.06, 0.01), 0.15, 2.0, 40.0, 0.2, 0.3)


SHARP = foreign.smooth_moves(T, (0.05, 0.0, 0.06, 0.01), 0.15, 4.0, 300.0, 0.2, 0.3)


def off(fit: Refinement) -> dict[str, float]:
    """Value less truth in standard errors, by name."""
    return {name: (fit[name].value - truth) / fit[name].error for name, truth in TRUTH.items()}


def test_friction_at_starts_and_stops_that_the_model_lacks_is_in_the_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every start has the same extra friction, so that the residual does not show how much of it the values took."""
    wide = off(fitted(SLOW, stribeck=25.0, stribeck_velocity=2e-3))
    # 2.5 standard errors: one value in eighty is further off by chance
    assert max(map(abs, wide.values())) < 2.5, wide
    monkeypatch.setattr(output_error, "_doubt", lambda *_: 0.0)
    narrow = off(fitted(SLOW, stribeck=25.0, stribeck_velocity=2e-3))
    assert max(map(abs, narrow.values())) > 3.0, narrow


@pytest.mark.parametrize("resonance", [30.0, 50.0])
def test_elasticity_that_the_model_lacks_is_in_the_error_of_the_mass(
    resonance: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two masses on a spring, in Hz: the rigid mass is up to 2 % off, by more than the residual shows."""
    stiffness = (2.0 * math.pi * resonance) ** 2 * 25.0
    two = {"mass": 50.0, "mass_load": 50.0, "stiffness": stiffness, "damping": 0.04 * math.sqrt(25.0 * stiffness)}
    wide = off(fitted(SHARP, **two))["mass"]
    assert abs(wide) < 2.5, wide
    monkeypatch.setattr(output_error, "_BENDING", ())
    narrow = off(fitted(SHARP, **two))["mass"]
    assert abs(narrow) > 3.0, narrow


@pytest.mark.slow(reason="two more fits of a long log")
def test_plain_friction_keeps_its_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    wide = fitted(SLOW)
    monkeypatch.setattr(output_error, "_doubt", lambda *_: 0.0)
    narrow = fitted(SLOW)
    for name in TRUTH:
        assert math.isclose(wide[name].value, narrow[name].value, rel_tol=1e-9)
        # by less than a factor of 3: any term that is added moves a value by chance, and a finite sample time makes
        # the friction of a start differ a little between two simulators
        assert narrow[name].error <= wide[name].error < 3.0 * narrow[name].error


def test_a_dead_time_between_two_samples_is_in_the_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """With half a sample of dead time, a whole number of samples is half a sample off."""
    late = fitted(FAST, dead_time=0.5 * T)
    assert late.delay in (0, 1)
    assert max(map(abs, off(late).values())) < 2.5
    monkeypatch.setattr(output_error, "_doubt", lambda *_: 0.0)
    assert max(map(abs, off(fitted(FAST, dead_time=0.5 * T)).values())) > 5.0
