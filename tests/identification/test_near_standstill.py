"""Output error where friction near standstill is more than its model holds: the errors say so."""

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


def fitted(stribeck: float) -> Refinement:
    """Strokes at five speeds, from 4 to 60 mm/s, with plain friction fitted: most acceleration is beside standstill."""
    path = foreign.constant_speeds(T, [0.004, 0.01, 0.02, 0.04, 0.06], 0.008, 0.8)
    axis = foreign.replace(AXIS, stribeck=stribeck, stribeck_velocity=2e-3)
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


def off(fit: Refinement) -> dict[str, float]:
    """Value less truth in standard errors, by name."""
    return {name: (fit[name].value - truth) / fit[name].error for name, truth in TRUTH.items()}


def test_friction_at_starts_and_stops_that_the_model_lacks_is_in_the_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every start has the same extra friction, so that the residual does not show how much of it the values took."""
    wide = off(fitted(25.0))
    # 2.5 standard errors: one value in eighty is further off by chance
    assert max(map(abs, wide.values())) < 2.5, wide
    monkeypatch.setattr(output_error, "_moved_near_rest", lambda *_: 0.0)
    narrow = off(fitted(25.0))
    assert max(map(abs, narrow.values())) > 3.0, narrow


def test_plain_friction_keeps_its_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    wide = fitted(0.0)
    monkeypatch.setattr(output_error, "_moved_near_rest", lambda *_: 0.0)
    narrow = fitted(0.0)
    for name in TRUTH:
        assert math.isclose(wide[name].value, narrow[name].value, rel_tol=1e-9)
        # by less than a factor of 2: any term that is added moves a value by chance, and a finite sample time makes
        # the friction of a start differ a little between two simulators
        assert narrow[name].error <= wide[name].error < 2.0 * narrow[name].error
