"""The bundled ball-screw axis against figures that another program computed for the same drive.

The figures are those of P-PI on the truth plant of Gordon & Erkorkmaz 2013 as this project re-computed it before it
began, by transfer functions in z; they were given to the digits that stand here.
"""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.analysis.margins import margins
from feeddrive.files.machine import read_machine
from feeddrive.loop.linearize import compliance, loop_gain
from feeddrive.loop.loop import Loop

F = np.geomspace(0.5, 10_000, 4000)


@pytest.fixture(scope="module")
def loop() -> Loop:
    return read_machine("ball_screw").loop("x")


def test_sensitivity_peak_and_first_crossover(loop: Loop) -> None:
    found = margins(loop_gain(loop, F))
    assert found.sensitivity_peak == pytest.approx(1.95, abs=0.01)
    # 70.0 was read off a grid of lines: half a per cent
    assert found.crossover == pytest.approx(70.0, rel=0.005)


@pytest.mark.parametrize(
    ("frequency", "stiffness"),
    [(1, 118), (5, 25), (10, 14.5), (20, 10.0), (30, 8.5), (60, 7.4), (100, 6.8), (131, 5.9)],
)
def test_dynamic_stiffness(loop: Loop, frequency: float, stiffness: float) -> None:
    """In N/um; the last digit of the figure is half a unit uncertain, and the peak of the mode steep."""
    found = 1e-6 / abs(compliance(loop, np.array([frequency], dtype=float)).response[0])
    assert found == pytest.approx(stiffness, rel=0.01)


def test_peak_compliance(loop: Loop) -> None:
    assert 1e6 * np.max(compliance(loop, F).magnitude) == pytest.approx(0.199, abs=0.0005)
