"""A machine file with a safe start law, where the law that ran cannot be found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.files.machine import read_machine
from feeddrive.workflow.identify import identify


def test_a_log_without_set_position_gives_a_machine_with_a_start_law_that_says_so(tmp_path: Path) -> None:
    """The loop is closed in the drive: position and force alone."""
    T = 1e-3
    axes = fa.Axes(mass=100.0, viscous=200.0, coulomb_positive=60.0, coulomb_negative=60.0, dead_time=T, noise_log=1.0)
    xs = fa.smooth_moves(T, (0.1, 0.02, 0.13, 0.0), 0.2, 2.0, 60.0, 0.1, 0.1)
    log = fa.simulate(axes, fa.Cascade(Kv=20.0, Kp=6000.0), xs, T, np.random.default_rng(1), substeps=1).log(0)
    path = tmp_path / "drive.csv"
    rows = np.column_stack([log["time"], 1e3 * log["position"], log["force"]])
    np.savetxt(path, rows, delimiter=",", header="time [s],x [mm],force [N]", comments="", fmt="%.9g")
    done = identify(path, out=tmp_path / "out")
    said = [remark for remark in done.remarks if "NOT the law that ran" in remark]
    assert len(said) == 1
    machine = read_machine(tmp_path / "out" / "machine.toml")
    assert "did not run" in machine.source
    assert "NOT the law that ran" in machine.remark
    loop = machine.loop(None)
    law = loop.control.law
    assert isinstance(law, CascadePPI)
    # th is at least the dead time of 1 ms and a sample: wc is at most 125 1/s
    assert float(law.Kp) <= 1.01 * 100.0 * 125.0
    assert float(law.Kp) == pytest.approx(
        4.0 * float(law.Kv) * float(loop.axis.plant.rigid_mass()), rel=1e-4
    )  # digits of the file
