"""Dynamic stiffness against the closed form of a rigid axis."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.analysis.stiffness import Stiffness, static_stiffness, stiffness
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace, compliance, linearize
from feeddrive.loop.loop import Loop

F = np.geomspace(1.0, 500.0, 1500)


def axis(**law: float) -> Loop:
    law = {"Kv": 40.0, "Kp": 2e4, **law}
    return Loop(sample_time=1e-4, control=Control(law=CascadePPI(**law)), axis=Axis(plant=Rigid(mass=100.0)))


def static(loop: Loop) -> float:
    return static_stiffness(linearize(loop, ["load_force"], ["position_load"]))


def test_without_integral_the_static_stiffness_is_kp_kv() -> None:
    # the force of the cascade at rest is Kp Kv x
    assert static(axis()) == pytest.approx(2e4 * 40.0, rel=1e-9)


@pytest.mark.parametrize("Tn", [1e-3, 0.02, 1.0])
def test_with_integral_it_is_infinite(Tn: float) -> None:
    found = static(axis(Tn=Tn))
    assert found == np.inf
    assert "infinite" in str(stiffness(compliance(axis(Tn=Tn), F), found))


def test_an_axis_without_position_loop_drifts() -> None:
    one = np.ones((1, 1))
    free = StateSpace(one, one, one, np.zeros((1, 1)), 1e-3, ("x",), ("load_force",), ("position_load",))
    with pytest.raises(ParameterError, match="drifts away"):
        static_stiffness(free)


def test_a_mass_on_spring_and_damper_has_the_minimum_of_the_closed_form() -> None:
    m, c, k = 100.0, 2e3, 4e6
    w = 2 * np.pi * F
    found = stiffness(FRF(F, 1.0 / (k - m * w**2 + 1j * c * w), "force", "position", "m/N"))
    # |K|² = (k - m w²)² + (c w)² is least at w² = k/m - c²/2m²
    least = np.sqrt(k / m - c**2 / (2 * m**2))
    assert found.minimum_frequency == pytest.approx(least / 2 / np.pi, rel=1e-4)
    assert found.minimum == pytest.approx(c * np.sqrt(k / m - c**2 / (4 * m**2)), rel=1e-4)
    # well above the minimum the mass alone resists
    assert found.at(400.0) == pytest.approx(m * (2 * np.pi * 400.0) ** 2, rel=0.01)
    rows = found.table((10.0, 2000.0)).rows
    assert len(rows) == 2
    assert rows[1][1:] == [10.0, found.at(10.0)]


def test_a_sampled_axis_agrees_with_its_continuous_law_well_below_nyquist() -> None:
    found = stiffness(compliance(axis(), F))
    s = 2j * np.pi * 20.0
    continuous = abs(100.0 * s**2 + 2e4 * s + 2e4 * 40.0)
    # sampling at 10 kHz adds 1.5 samples of delay: 20 Hz * 2π * 150 us = 1.9 % of the velocity feedback
    assert found.at(20.0) == pytest.approx(continuous, rel=0.02)


def test_errors_say_what_is_wrong() -> None:
    with pytest.raises(ParameterError, match="at least one line"):
        stiffness(FRF(np.array([]), np.array([])))
    with pytest.raises(ParameterError, match="zero at 2 Hz"):
        stiffness(FRF(np.array([1.0, 2.0]), np.array([1.0, 0.0])))
    with pytest.raises(ParameterError, match="outside of the stiffness's lines"):
        stiffness(FRF(np.array([1.0, 2.0]), np.array([1.0, 1.0]))).at(3.0)


def test_mean_of_a_power_of_frequency_is_that_of_its_middle() -> None:
    """k = c f² over lines even in ln f: straight on log-log paper, so that the mean is the value at √(f1 f2)."""
    lines = np.geomspace(10.0, 1000.0, 61)
    assert Stiffness(lines, 3.0 * lines**2).mean == pytest.approx(3.0 * 100.0**2, rel=1e-12)


@pytest.mark.parametrize(("left", "expected"), [(1.4e-9, np.inf), (3e-9, 1.0 / 3e-9)])
def test_what_cancels_to_a_billionth_is_rounding(left: float, expected: float) -> None:
    """Two terms of 1 with opposite signs: a compliance of 1e-9 of both is infinite stiffness."""
    one = np.ones((1, 1))
    model = StateSpace(0.0 * one, one, one, (left - 1.0) * one, 1e-3, ("x",), ("load_force",), ("position_load",))
    assert static_stiffness(model) == pytest.approx(expected, rel=1e-6)


def test_the_table_states_the_stiffness_at_the_decades() -> None:
    f = np.geomspace(0.5, 5000.0, 100)
    rows = stiffness(FRF(f, 1e-8 * np.ones(f.size))).table().rows
    assert [float(str(row[1])) for row in rows if row[0] == "dynamic"] == [1.0, 10.0, 100.0, 1000.0]
