"""A loop that is made faster as a whole: crossovers move by the factor, margins stay."""

from __future__ import annotations

import math

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.catalogue import members
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.pole_placement import PolePlacement
from feeddrive.blocks.families import Law
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.control import Control
from feeddrive.tuning.by_hand import ByHand
from feeddrive.tuning.candidates import control_with
from feeddrive.tuning.operating_point import measured_point
from feeddrive.tuning.scaling import quickened, speed_powers, speed_range

CONTROL = Control(law=CascadePPI(Kv=30.0, Kp=4000.0, Tn=0.02))


def crossover(control: Control, sample_time: float) -> tuple[float, float]:
    """Hz and phase margin in degrees of a control on a free mass of 40 kg, as it would be measured without delay."""
    f = np.geomspace(0.1, 0.4 / sample_time, 4000)
    mass = fd.FRF(f, -1.0 / (40.0 * (2.0 * np.pi * f) ** 2) + 0j, "force", "position_load", "m/N")
    look = ByHand(control, [measured_point(mass, sample_time=sample_time)]).at({})
    found = look.leading.margins
    assert found.crossover is not None
    assert found.phase_margin_deg is not None
    return found.crossover, found.phase_margin_deg


@pytest.mark.parametrize("factor", [0.3, 1.7, 4.0])
def test_the_crossover_of_a_free_mass_moves_by_the_factor(factor: float) -> None:
    """With the sample time scaled along it is exact: only the interpolation between lines is left."""
    T = 1e-3
    before, margin = crossover(CONTROL, T)
    faster = tree.vary(CONTROL, dict(quickened(CONTROL, factor)))
    after, same = crossover(faster, T / factor)
    assert after / before == pytest.approx(factor, rel=1e-4)
    assert same == pytest.approx(margin, abs=1e-3)
    assert crossover(faster, 1e-6)[0] / crossover(CONTROL, 1e-6)[0] == pytest.approx(factor, rel=1e-3)


def test_a_factor_and_its_inverse_lead_back() -> None:
    there = tree.vary(CONTROL, dict(quickened(CONTROL, 2.0)))
    assert dict(quickened(there, 0.5)) == {"law.Kv": 30.0, "law.Kp": 4000.0, "law.Tn": 0.02}
    assert dict(quickened(CONTROL, 2.0)) == {"law.Kv": 60.0, "law.Kp": 8000.0, "law.Tn": 0.01}


def test_models_filters_and_ratios_stay() -> None:
    control = fd.read_machine("ball_screw").loop(None).control
    assert dict(speed_powers(control)) == {"law.Kv": 1.0, "law.Kp": 1.0, "law.Tn": -1.0}
    assert "bandwidth" in PolePlacement.tunables
    assert "rigid_damping" in PolePlacement.tunables


@pytest.mark.parametrize("law", members(Law).values(), ids=lambda each: each.kind)  # type: ignore[type-abstract]
def test_of_each_law_a_rate_follows(law: type[Law]) -> None:
    """What a law is tuned by has a unit, so that it can be made faster as a whole."""
    loop = fd.read_machine("ball_screw").loop(None)
    try:
        control = control_with(loop, law.kind)
    except ParameterError:
        pytest.skip("does not go on this axis")
    powers = speed_powers(control)
    assert powers
    low, high = speed_range(control, loop.sample_time)
    assert low < 1.0 < high
    for name, value in quickened(control, 0.5 * min(high, 4.0)).items():
        assert tree.declaration(control, name).admits(value)


def test_the_range_ends_where_a_bound_is_met() -> None:
    machine = fd.read_machine("ball_screw").loop(None)
    control = control_with(machine, "pole_placement")
    _, high = speed_range(control, 1e-3)
    assert high == pytest.approx(490.0 / tree.get(control, "law.bandwidth"))
    assert speed_range(CONTROL, 1e-3) == (0.0, math.inf)


@pytest.mark.parametrize("factor", [0.0, -1.0, math.nan, math.inf])
def test_a_factor_is_finite_and_positive(factor: float) -> None:
    with pytest.raises(ParameterError, match="a finite factor > 0"):
        quickened(CONTROL, factor)


def test_a_factor_whose_number_is_too_large_is_refused() -> None:
    with pytest.raises(ParameterError, match="take a factor nearer to 1"):
        quickened(CONTROL, 5e-324)  # Tn goes with its inverse
