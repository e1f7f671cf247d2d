"""How fast a law may be over the dead time: against the poles, and for another law, mass and sample time."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.analysis.stiffness import robustness
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.papers.altintas2009.testbed import cascade
from feeddrive.papers.altintas2009.testbed import loop as axis_loop
from feeddrive.tuning.scaling import delay_map

TUNABLES = [f"axis.x.control.law.{name}" for name in DADSC.tunables]


@pytest.mark.parametrize(("mass", "T"), [(5.0, 5e-5), (400.0, 1e-3)])
def test_the_map_in_p_times_T_is_that_of_every_rigid_axis(mass: float, T: float) -> None:
    """Without friction only p T and the dead time in samples count."""
    law = DADSC(mass=mass, tracking_rate=0.05 / T, reaching_rate=0.05 / T, adaptation_rate=0.05 / T)
    loop = Loop(control=Control(law=law), axis=Axis(plant=Rigid(mass=mass)), sample_time=T)
    found = delay_map(loop, TUNABLES, [0.0, T, 2.0 * T, 3.0 * T])
    np.testing.assert_allclose(T * found.at_edge(TUNABLES[0]), [0.418, 0.198, 0.132, 0.0995], rtol=0.005)
    np.testing.assert_allclose(T * found.at_robust(TUNABLES[0]), [0.197, 0.096, 0.064, 0.048], rtol=0.005)


def test_the_edge_is_where_the_poles_leave_the_circle() -> None:
    law = CascadePPI(Kv=50.0, Kp=2e4, Tn=0.01)
    actuator = Actuator(dead_time=1.5e-4)
    loop = Loop(control=Control(law=law), axis=Axis(plant=Rigid(mass=40.0), actuator=actuator), sample_time=1e-4)
    names = ["axis.x.control.law.Kv", "axis.x.control.law.Kp", "axis.x.control.law.Tn"]
    found = delay_map(loop, names, [1.5e-4])
    for factor, stable in ((0.999, True), (1.001, False)):
        f = factor * found.edge[0]
        values = {names[0]: 50.0 * f, names[1]: 2e4 * f, names[2]: 0.01 / f}  # a time is divided
        assert robustness(tree.vary(loop, values)).stable == stable
    f = found.robust[0]
    held = robustness(tree.vary(loop, {names[0]: 50.0 * f, names[1]: 2e4 * f, names[2]: 0.01 / f}))
    assert held.sensitivity_peak == pytest.approx(2.0, rel=1e-3)
    assert "Ms <= 2 up to" in str(found)
    assert list(found.to_pandas().columns) == ["edge", "robust"]
    assert found.plot().axes


def test_knobs_that_do_not_bring_the_loop_to_an_edge_are_refused() -> None:
    with pytest.raises(ParameterError, match="no bound lies within a factor"):
        delay_map(axis_loop(cascade(300.0)), ["axis.x.control.law.velocity_feedforward"], [0.0])
