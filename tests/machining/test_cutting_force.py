"""The force on the tool, from a finished run: that of the run itself, and of the sections it had."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.coupling.cut_sections import CutSections
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.cutting.mechanistic_cutter import MechanisticCutter
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.sine import Sine
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import Run, simulate
from feeddrive.machining import cutting_forces

TOOL = MechanisticCutter(
    teeth=2, slices=2, diameter=0.01, axial_depth=1e-3, helix_angle=0.5, Ktc=8e8, Krc=2e8, Kac=1e8, Kte=2e4, Kre=1e4
)
SECTIONS = CutSections(
    start=[0.0, 0.04], axial_depth=[1e-3, 2e-3], entry=[0.0, 2.0], exit=[1.0, 3.1], spindle_speed=[6000.0, 9000.0]
)


def cut_of(substeps: int) -> tuple[Run, MillingCut]:
    """A circle under a spindle that changes its speed, with the cut from 20 ms on."""
    axis = Axis(plant=Rigid(mass=20.0), substeps=substeps)
    loop = Loop(control=Control(law=CascadePPI(Kv=60.0, Kp=2e4, Tn=0.01)), axis=axis, sample_time=1e-4)
    cut = MillingCut(cutter=TOOL, spindle_speed=1.0, sections=SECTIONS, cut_from=0.02, along_z="z", remembered=1024)
    path = {
        "x": Sine(amplitude=0.01, frequency=2.0, cycles=9),
        "y": Sine(amplitude=0.01, frequency=3.0, cycles=9),
        "z": Sine(amplitude=1e-4, frequency=1.0, cycles=9),
    }
    return simulate(Machine.of(dict.fromkeys("xyz", loop), (cut,)), path, duration=0.08), cut


def test_they_are_the_forces_of_the_run() -> None:
    """To the bit along the spindle, to rounding in the plane, which the run turns into its axes itself."""
    run, cut = cut_of(1)
    found = cutting_forces(run, cut)
    assert np.array_equal(-found.axial, run["z.load_force"])
    x = found.feed * found.along - found.normal * found.across
    y = found.feed * found.across + found.normal * found.along
    assert np.max(np.abs(x - run["x.load_force"])) < 1e-12 * np.max(np.abs(x))
    assert np.max(np.abs(y - run["y.load_force"])) < 1e-12 * np.max(np.abs(y))
    assert np.all(found.torque[found.time < 0.0199] == 0.0)
    assert set(found.spindle_speed) == {6000.0, 9000.0}
    assert found.power[500] == pytest.approx(found.torque[500] * 300.0 * np.pi, rel=1e-14)
    assert np.max(np.abs(x)) > 1.0
    assert "cuts in" in str(found)
    # 100 turns in a second up to 40 ms, then 150
    assert found.angle[700] == pytest.approx(2.0 * np.pi * (4.0 + 150.0 * 0.03005), abs=1e-9)
    assert np.array_equal(found.to_pandas()["power"], found.power)
    assert len(found.plot().axes) == 3


def test_more_substeps_are_seen_as_samples() -> None:
    """The mean over a sample of the force at two substeps: what is left is of second order in the sample."""
    run, cut = cut_of(2)
    found = cutting_forces(run, cut)
    assert np.mean(np.abs(found.axial + run["z.load_force"])) < 0.03 * np.mean(np.abs(found.axial))


def test_what_is_missing_is_named() -> None:
    run, cut = cut_of(1)
    with pytest.raises(ParameterError, match=r"the run has no y.velocity_load: record these"):
        cutting_forces(replace(run, signals={n: v for n, v in run.signals.items() if n != "y.velocity_load"}), cut)
    with pytest.raises(ParameterError, match="begins at sample 7"):
        cutting_forces(replace(run, first=7), cut)
