"""What shapers leave of a vibration when the frequency is off, and what a notch costs: closed forms against blocks."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.reference.pulses import pulses

F, ZETA = 30.0, 0.02


def left(shaper: str, factor: float) -> float:
    """The share of the vibration of a mode at `factor` times the frequency that the shaper is made for."""
    heights, times = (np.array(each) for each in pulses(shaper, F, ZETA, 0.05))
    w = 2.0 * np.pi * F * factor
    damped = w * np.sqrt(1.0 - ZETA * ZETA)
    grown = heights * np.exp(ZETA * w * times)
    return float(np.exp(-ZETA * w * times[-1]) * np.abs(np.sum(grown * np.exp(1j * damped * times))))


def test_golden_pulses() -> None:
    heights, times = pulses("zv", F, ZETA, 0.05)
    assert heights == pytest.approx([0.5157059370, 0.4842940630], rel=1e-9)
    assert times[1] == pytest.approx(0.01667000100, rel=1e-9)
    heights, times = pulses("zvd", F, ZETA, 0.05)
    assert heights == pytest.approx([0.2659526135, 0.4995066471, 0.2345407394], rel=1e-9)
    assert float(np.dot(heights, times)) == pytest.approx(16.15e-3, abs=5e-6)


def test_what_is_left_beside_the_frequency() -> None:
    """12.a."""
    assert [left("zv", each) for each in (0.9, 0.95, 1.0, 1.05)] == pytest.approx(
        [0.152, 0.0761, 0.0, 0.0759], abs=5e-4
    )
    found = [left("zvd", each) for each in (0.9, 0.95, 1.0, 1.05)]
    assert found == pytest.approx([0.0231, 0.0058, 0.0, 0.0058], abs=5e-5)


def test_what_a_notch_costs_below_it() -> None:
    """12.c: 460 Hz, 0.06/0.6, at 60 Hz: 8.135 deg; the rule 2 (ζp - ζz)/ωn gives 8.071."""
    T = 1e-5
    notch = Notch(frequency=460.0, damping_zero=0.06, damping_pole=0.6)
    prepared = notch.prepare(T)
    state, t = notch.start(prepared, 0.0), np.arange(20_000) * T
    out = np.empty(t.size)
    for k, value in enumerate(np.sin(2.0 * np.pi * 60.0 * t)):
        state, out[k] = notch.step(prepared, state, float(value))
    whole = slice(10_000, 20_000)  # six periods
    turn = np.exp(-2j * np.pi * 60.0 * t[whole])
    lag = -np.degrees(np.angle(np.sum(out[whole] * turn) / np.sum(np.sin(2.0 * np.pi * 60.0 * t[whole]) * turn)))
    assert lag == pytest.approx(8.135, abs=2e-3)
    assert np.degrees(2.0 * 0.54 / (2.0 * np.pi * 460.0) * 2.0 * np.pi * 60.0) == pytest.approx(8.071, abs=1e-3)
