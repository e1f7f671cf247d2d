"""The battery: every block that is found in the packages passes every row that applies to it.

Whoever adds a block writes no test for this.  The rows stand in `feeddrive.testing`, where those of a user's law are
taken from as well.  That files of a step import neither `math` nor `numpy` and that a block is final stands in
test_architecture.py.
"""

from __future__ import annotations

import pytest

from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.controller.lqg import LQG
from feeddrive.testing import battery

TestBlock = battery(*(block for members in catalogue().values() for block in members.values() if block is not LQG))
TestLargeBlock = pytest.mark.slow(reason="both Riccati equations of two masses are 40,000 operations")(battery(LQG))
