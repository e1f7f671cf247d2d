"""The safe start law of an axis whose control law is not known."""

from __future__ import annotations

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.margins import margins
from feeddrive.language import tree
from feeddrive.loop.axis import Axis
from feeddrive.tuning.start_law import PEAK, SPREAD, start_law

B = fd.blocks
T = 1e-3


def axis(dead_time: float = 1e-3, mass: float = 100.0) -> Axis:
    return Axis(
        plant=B.Rigid(mass=mass),
        friction_load=B.Coulomb(coulomb=60.0, viscous=200.0),
        actuator=B.Actuator(dead_time=dead_time),
    )


def test_gains_follow_from_mass_and_delay() -> None:
    """th = 1 ms + T = 2 ms: wc = 125 1/s."""
    found = start_law(axis(), T)
    law = found.law
    assert float(law.Kp) == pytest.approx(100.0 * 125.0)
    assert float(law.Kv) == pytest.approx(125.0 / 4.0)
    assert law.Tn is not None
    assert float(law.Tn) == pytest.approx(4.0 / 125.0)
    assert "NOT the law that ran" in found.sentence


@pytest.mark.parametrize("dead_time", [0.0, 0.7e-3, 5e-3])
def test_ms_is_at_most_1_4_for_masses_within_20_percent(dead_time: float) -> None:
    found = start_law(axis(dead_time), T)
    for factor in (1.0 - SPREAD, 1.0, 1.0 + SPREAD):
        other = tree.vary(found.loop, {f"{found.loop.place_of('axis')}.plant.mass": 100.0 * factor})
        assert margins(other).sensitivity_peak <= PEAK
    # the sheet's maximum of wc th at this Ms is 0.25: half of that would be needlessly soft
    assert float(found.law.Kp) > 0.5 * 100.0 * 0.25 / (dead_time + T)


def test_coarse_counts_are_differenced_over_more_samples() -> None:
    """20 um of 100 kg: one sample would make 500 N of each count, where the log has 300 N at most."""
    found = start_law(axis(), T, count=2e-5, force=300.0)
    assert found.law.velocity_samples > 1
    assert found.left <= 4e-5


def test_two_masses_are_limited_by_their_resonance() -> None:
    plant = B.TwoMass(mass_motor=60.0, mass_load=40.0, stiffness=24.0 * (2.0 * np.pi * 60.0) ** 2, damping=240.0)
    found = start_law(Axis(plant=plant, actuator=B.Actuator(dead_time=1e-3)), T)
    rate = 2.0 * np.pi * 60.0
    zeta = 0.5 * 240.0 / 24.0 / rate
    most = 0.26 * 2.0 * zeta * rate * 60.0 / (1.2 * 40.0)
    assert float(found.law.Kp) <= 100.0 * most * (1.0 + 1e-9)
    assert max(found.peaks) <= PEAK


def test_a_start_law_for_a_mass_that_is_hardly_known_is_slower_and_keeps_its_margin() -> None:
    """30 % off: Ms at most 1.4 for 70 and 130 % of the mass, by the margins of the loop itself."""
    usual, wide = start_law(axis(), T), start_law(axis(), T, spread=0.3)
    assert float(wide.law.Kp) < float(usual.law.Kp)
    assert max(wide.peaks) <= PEAK
    assert "30 %" in wide.sentence
