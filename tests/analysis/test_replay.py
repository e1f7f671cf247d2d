"""What a log must hold so that it can be replayed."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.analysis.replay import replay
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.language.errors import LogError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop


def test_forty_samples_do_not_tell_how_a_log_starts() -> None:
    """Position and velocity at its start are those of a parabola over fifty."""
    loop = Loop(control=Control(law=CascadePPI(Kv=20.0, Kp=1e3)), axis=Axis(plant=Rigid(mass=50.0)), sample_time=1e-3)
    still = np.zeros(40)
    with pytest.raises(LogError, match="40 samples; 51 are needed"):
        replay(loop, {"set_position": still, "position_load": still})
