"""Two drives on one axis, with the beam between them; and a part program that moves them by one word."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.coupling.cross_beam import CrossBeam
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.files.job import read_job
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.language.errors import StructureError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.machining.contour import contour_error

STILL = SnapLimitedMove(distance=0.0, velocity=0.1, acceleration=1.0, jerk=50.0, snap=5e3)
BEAM = CrossBeam(axis="y", follower="y2", stiffness=4e7, damping=3000.0)


def test_the_skew_swings_as_its_closed_form_says():
    """Without control: y = v/w e^(-zwt) sin wt, with the masses against each other on the spring; exact at any step."""
    off = Control(law=CascadePPI(Kv=1e-9, Kp=1e-9))
    loop = Loop(control=off, axis=Axis(plant=Rigid(mass=150.0)), sample_time=1e-3)
    machine = Machine.of({"y": loop, "y2": loop}, (BEAM,))
    found = simulate(machine, {"y": STILL, "y2": STILL}, duration=0.1, start={"y": (0.0, 0.01), "y2": (0.0, -0.01)})
    natural, decay = np.sqrt(2.0 * 4e7 / 150.0), 3000.0 / 150.0
    swing = np.sqrt(natural**2 - decay**2)
    wanted = 0.01 / swing * np.exp(-decay * found.time) * np.sin(swing * found.time)
    assert np.max(np.abs(found["y.position_load"] - wanted)) < 1e-15
    assert np.max(np.abs(found["y2.position_load"] + wanted)) < 1e-15


def portal() -> Machine:
    """The bundled gantry with a second drive for its beam, whose law is softer; both axes shake its frame."""
    file = read_machine("gantry")
    y = file.loops["y"]
    half = replace(y, axis=replace(y.axis, plant=Rigid(mass=110.0)))
    law = replace(half.control.law, Kp=33_000.0)  # type: ignore[type-var]
    y, y2 = (replace(half, control=replace(half.control, law=each)) for each in (law, replace(law, Kp=25_000.0)))
    return Machine.of({"x": file.loops["x"], "y": y, "y2": y2}, (*file.couplings, BEAM))


def test_one_word_of_a_part_program_moves_both(tmp_path: Path):
    machine = portal()
    limits = read_machine("gantry").limits
    (tmp_path / "portal.toml").write_text(machine_toml(machine, "portal", limits=limits))
    (tmp_path / "part.ngc").write_text("G21 G90 G64 P0.05\nG1 X20 Y0 F6000\nG1 X20 Y15\nG1 X0 Y15\nM2\n")
    (tmp_path / "job.toml").write_text('machine = "portal.toml"\naxis = "x"\n[program]\nfile = "part.ngc"\n')
    job = read_job(tmp_path / "job.toml")
    assert set(job.others) == {"y", "y2"}
    assert job.others["y"].reference is job.others["y2"].reference
    paths: Any = {"x": job.reference, **{name: each.reference for name, each in job.others.items()}}
    whole = job.machines["today"]
    with_beam, without = (simulate(each, paths) for each in (whole, Machine.of(whole.loops(), whole.couplings[:-1])))
    skews = [np.max(np.abs(run["y.position_load"] - run["y2.position_load"])) for run in (with_beam, without)]
    assert skews[1] > 1e-6  # m: the laws differ
    assert skews[0] < 0.5 * skews[1]
    assert abs(with_beam["y2.position_load"][-1] - 0.015) < 2e-5
    assert contour_error(with_beam, axes=("x", "y")).largest < 3e-4


def test_a_beam_needs_two_drives():
    with pytest.raises(StructureError, match="between two drives"):
        CrossBeam(axis="y", follower="y", stiffness=1e7)
    with pytest.raises(StructureError, match="axis 'y2', which is not there"):
        read_machine("gantry").machine(BEAM)
