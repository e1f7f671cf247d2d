"""Stability verdicts against poles that were put there, and messages that say what to do."""

from __future__ import annotations

import re

import numpy as np
import pytest

from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import Stability, require_stable, stability
from feeddrive.analysis.stiffness import Robustness
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.language.errors import UnstableError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import StateSpace, loop_gain
from feeddrive.loop.loop import Loop

T = 1e-3


def oscillator(growth: float, frequency: float) -> StateSpace:
    angle = 2 * np.pi * frequency * T
    turn = growth * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    one = np.array([[1.0], [0.0]])
    return StateSpace(turn, one, one.T, np.zeros((1, 1)), T, ("a", "b"), ("load_force",), ("position_load",))


def axis(Kp: float) -> Loop:
    law = CascadePPI(Kv=40.0, Kp=Kp)
    return Loop(sample_time=T, control=Control(law=law), axis=Axis(plant=Rigid(mass=100.0)))


def test_a_growing_oscillation_is_named_with_frequency_and_growth() -> None:
    found = stability(oscillator(1.01, 120.0))
    assert not found.stable
    assert found.frequency == pytest.approx(120.0)
    assert found.time_constant == pytest.approx(T / np.log(1.01))
    with pytest.raises(UnstableError, match=r"x: the loop is unstable: an oscillation of 120 Hz .* notch at 120 Hz"):
        require_stable(oscillator(1.01, 120.0), where="x")


def test_near_nyquist_the_advice_is_the_velocity_gain() -> None:
    with pytest.raises(UnstableError, match=r"close to Nyquist .* lower Kp"):
        require_stable(oscillator(1.2, 499.0))


def test_a_drift_has_no_frequency() -> None:
    with pytest.raises(UnstableError, match=r"a drift grows .* signs of the gains"):
        require_stable(oscillator(1.05, 0.0))


def test_the_edge_is_not_stable_and_a_decaying_one_is() -> None:
    edge = stability(oscillator(1.0, 50.0))
    assert not edge.stable
    assert edge.time_constant is None
    assert "edge of stability" in edge.sentence()
    calm = require_stable(oscillator(0.99, 50.0))
    assert calm.time_constant == pytest.approx(-T / np.log(0.99))
    assert "stable" in calm.table().title


def test_the_edge_found_by_poles_is_the_gain_margin_found_from_the_frequency_response() -> None:
    L = loop_gain(axis(5e4), np.geomspace(1.0, 500.0, 2000))
    edge = 5e4 * 10 ** (margins(L).gain_increase_dB / 20)
    # the margin is read off a grid of 2000 lines: 0.1 % on each side is more than its error
    assert stability(axis(0.999 * edge)).stable
    assert not stability(axis(1.001 * edge)).stable


def test_the_nearest_stable_gains_are_stable_and_a_little_more_is_not() -> None:
    """Discrete P-P loop on a free mass: stable up to a velocity gain that the message must find within 1 %."""
    with pytest.raises(UnstableError, match=r"stable up to Kv = \S+ 1/s, Kp = \S+ N s/m") as caught:
        require_stable(axis(Kp=3e5))
    found = [float(value) for value in re.findall(r"K[vp] = (\S+) ", str(caught.value))]

    def scaled(factor: float) -> bool:
        law = CascadePPI(Kv=factor * found[0], Kp=factor * found[1])
        loop = Loop(sample_time=T, control=Control(law=law), axis=Axis(plant=Rigid(mass=100.0)))
        return stability(loop).stable

    assert scaled(1.0)
    assert not scaled(1.01)


@pytest.mark.parametrize(("below", "stable"), [(0.7e-9, False), (1.5e-9, True)])
def test_a_pole_within_a_billionth_of_the_unit_circle_is_at_the_edge(below: float, stable: bool) -> None:
    """Eigenvalues of a small matrix are less certain than that."""
    slowest = Stability(oscillator(1.0, 50.0), complex(1.0 - below))
    assert slowest.stable is stable
    assert (slowest.time_constant is not None) is stable
    assert Robustness(1.0 - below).stable is stable
