"""Models of the plants of a box from their matrices are those of the linearized step, or are not used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.loop.box import Box, Corner
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.tuning import worst
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.sampled_plants import INPUTS, OUTPUTS, SampledPlants
from feeddrive.tuning.worst import BoxPlants, over_box


def apart(loop: Loop, corner: Corner, box: Box) -> float:
    """The largest relative difference of a response, below the antiresonances at which both are rounding."""
    f = 0.5 / float(loop.sample_time) * np.geomspace(1e-4, 0.9, 15)
    other = linearize(box.plant(loop, corner), list(INPUTS), list(OUTPUTS))
    model = SampledPlants(box, loop).model(corner)
    pairs = [
        tuple(system.response(f, output, source).response for system in (model, other))
        for output in OUTPUTS
        for source in INPUTS
    ]
    return max(float(np.max(np.abs(a / b - 1.0))) for a, b in pairs)


@pytest.mark.parametrize("dead", [0.0, 0.3, 1.0, 2.7])
@pytest.mark.parametrize("bandwidth", [None, 900.0])
def test_dead_time_and_current_loop_are_exact(dead: float, bandwidth: float | None) -> None:
    loop = fd.read_machine("machining_center").loop("x")
    T = float(loop.sample_time)
    loop = replace(loop, axis=replace(loop.axis, actuator=Actuator(dead_time=dead * T, current_loop=bandwidth)))
    for corner in (Corner((0.0, 0.0, 0.0), 0), Corner((0.4, -0.9, 0.7), 1)):
        assert apart(loop, corner, Box()) < 1e-7


@pytest.mark.parametrize(("machine", "axis"), [("ball_screw", "x"), ("rotary_table", "c"), ("mill", "x")])
def test_other_plants_are_those_of_the_linearized_step(machine: str, axis: str) -> None:
    loop = fd.read_machine(machine).loops[axis]
    assert SampledPlants(Box(), loop).agree(0.05)


def with_modes() -> Loop:
    """A free axis with two modes, whose stiffnesses are not affine in their masses and frequencies."""
    loop = fd.read_machine("linear_motor").loop("x")
    modes = (
        Mode(frequency=80.0, damping_ratio=0.02, mass=4000.0, motor=1.0, load=1.0),
        Mode(frequency=210.0, damping_ratio=0.04, mass=6000.0, motor=1.0, load=-1.0),
    )
    plant = Modal(mass=40.0, viscous=10.0, modes=modes)
    return replace(loop, axis=replace(loop.axis, plant=plant, friction_load=None))


def test_modes_have_the_matrices_of_each_plant() -> None:
    """Stiffness and damping of a mode are products: matrices between those of the ends would be others."""
    loop = with_modes()
    box = Box(0.3, 0.4, 1)
    assert SampledPlants(box, loop).agree(0.05)
    for corner in (Corner((1.0, -1.0, 1.0, -1.0, 1.0), 0), Corner((-0.3, 0.8, -0.6, 0.5, 0.9), 1)):
        assert apart(loop, corner, box) < 1e-7


def test_what_depends_on_velocity_is_not_used() -> None:
    """Friction that falls with velocity is linearized as before."""
    table = fd.read_machine("machining_center").loop("x")
    assert SampledPlants(Box(), table).agree(0.05)
    assert not SampledPlants(Box(), table).agree(5e-4)


@pytest.mark.parametrize(("modes", "box"), [(False, Box(0.0, 0.3, 1)), (True, Box(0.1, 0.0, 1))])
def test_an_examination_finds_the_same_with_either_model(
    monkeypatch: pytest.MonkeyPatch, modes: bool, box: Box
) -> None:
    loop, limits = with_modes() if modes else fd.read_machine("linear_motor").loop("x"), Limits()
    fast = over_box(loop.control, [BoxPlants(box, loop, "model", 0.05)], limits)[0]
    monkeypatch.setattr(worst.SampledPlants, "agree", lambda *_: False)
    slow = over_box(loop.control, [BoxPlants(box, loop, "model", 0.05)], limits)[0]
    assert fast.used == pytest.approx(slow.used, rel=1e-7)
    assert str(fast.plant) == str(slow.plant)
