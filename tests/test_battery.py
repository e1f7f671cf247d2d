"""The battery: every block that is found in the packages passes every row that applies to it.

Whoever adds a block writes no test for this.  The rows stand in `feeddrive.testing`, where those of a user's law are
taken from as well.  That files of a step import neither `math` nor `numpy` and that a block is final stands in
test_architecture.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.controller.gain_schedule import GainSchedule
from feeddrive.blocks.controller.lqg import LQG
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.force.harmonic import Harmonic
from feeddrive.blocks.force.ripple import Ripple
from feeddrive.testing import battery
from feeddrive.testing.battery import check_slopes
from feeddrive.testing.exercise import Exercise, Inputs, run_of

# both Riccati equations of two masses are 40,000 operations, and a schedule may hold two to four of them
LARGE = (LQG, GainSchedule)
TestBlock = battery(*(block for members in catalogue().values() for block in members.values() if block not in LARGE))
TestLargeBlock = pytest.mark.slow(reason="both Riccati equations of two masses are 40,000 operations")(battery(*LARGE))


def test_a_block_whose_answers_need_no_number_is_compiled_for_lanes() -> None:
    """Drawn by chance: nothing is fed forward, so that the program has no constants, and laying out none failed."""
    nothing = DisturbanceCompensator()
    found = Exercise(nothing, run_of(DisturbanceCompensator), Inputs(*(0.0 for _ in Inputs._fields))).native(8)
    assert found.shape[1] == 8
    assert not found.any()


def test_a_ripple_whose_period_is_the_step_of_a_difference_is_not_taken_for_a_constant() -> None:
    """Drawn by chance: position 1 m moves by 1 um for its slope, and the ripple repeats every 1 um."""
    numbers = dict.fromkeys(Inputs._fields, 0.5) | {"T": 5e-5, "position_motor": 1.0, "force": -962.0}
    ripple = Ripple(period=1e-6, harmonics=(Harmonic(order=3, share=0.05, phase=0.1),))
    check_slopes(Exercise(ripple, run_of(Ripple), Inputs(**{name: np.float64(x) for name, x in numbers.items()})))
