"""Couplings in machine files: read, written, refused with line and key, and run in a job."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.coupling.cut_sections import CutSections
from feeddrive.blocks.coupling.drilling_cut import DrillingCut
from feeddrive.blocks.coupling.dynamometer_force import DynamometerForce
from feeddrive.blocks.coupling.force_record import ForceRecord
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.coupling.structure_mode import StructureMode
from feeddrive.blocks.coupling.turning_cut import TurningCut
from feeddrive.blocks.cutting.drill import Drill
from feeddrive.blocks.cutting.edge_coefficients import EdgeCoefficients
from feeddrive.blocks.cutting.helical_cutter import HelicalCutter
from feeddrive.blocks.cutting.mechanistic_cutter import MechanisticCutter
from feeddrive.blocks.cutting.turning_tool import TurningTool
from feeddrive.files.job import read_job
from feeddrive.files.machine import BUNDLED, machine_toml, read_machine
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.workflow.run_job import run, summary
from feeddrive.workflow.tune import tune

GANTRY = (BUNDLED / "machines" / "gantry.toml").read_text(encoding="utf-8")
JOB = (BUNDLED / "jobs" / "gantry.toml").read_text(encoding="utf-8")


def test_a_file_with_couplings_is_a_machine() -> None:
    file = read_machine("gantry")
    (mode,) = file.couplings
    assert isinstance(mode, StructureMode)
    assert (mode.frequency, mode.mass, mode.axes()) == (18.0, 900.0, ("x", "y"))
    machine = file.machine()
    assert tree.parameters(machine)["couplings.0.shapes.0.load"] == 0.8
    assert tree.get(machine, "axis.y.plant.mass") == 220.0


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    """Every kind of coupling, with parts in parts: all numbers, structures and tables come back."""
    x, y = read_machine("gantry").loops.values()
    cut = MillingCut(cutter=HelicalCutter.beltran2013(), spindle_speed=6000.0, cut_to=1.5, remembered=600)
    sections = CutSections(start=[0.0, 0.5], axial_depth=[0.0, 1e-3], spindle_speed=[0.0, 6000.0])
    tool = MechanisticCutter(teeth=3, diameter=0.01, axial_depth=1e-3, Ktc=6e8, Kte=2e4, runout_offset=1e-5)
    other = MillingCut(cutter=tool, spindle_speed=6000.0, sections=sections, direction=0.5)
    rows = (ForceRecord(axis="y", row=[0.0, 3.5, -1e-3]), ForceRecord(axis="x", row=[1.0, 2.0]))
    edge = EdgeCoefficients(Ktc=7e8, Kfc=3e8, Kfe=2e4)
    turning = TurningCut(tool=TurningTool(cutting_depth=2e-3, edge=edge), spindle_speed=900.0, along_feed="y")
    drill = Drill(diameter=0.01, lip=edge, chisel=EdgeCoefficients(Ktc=2e9))
    drilling = DrillingCut(tool=drill, spindle_speed=900.0, along="x", thickness=0.01)
    couplings = (*read_machine("gantry").couplings, cut, other, turning, drilling)
    couplings = (*couplings, DynamometerForce(components=rows, interval=0.01))
    machine = Machine.of({"x": x, "y": y}, couplings)
    path = tmp_path / "written.toml"
    path.write_text(machine_toml(machine, 'a "quoted" name', remark="two\nlines"), encoding="utf-8")
    file = read_machine(path)
    again = file.machine()
    assert (file.name, file.source, file.remark) == ('a "quoted" name', "", "two\nlines")
    assert tree.parameters(again) == tree.parameters(machine)
    assert tree.structure(again) == tree.structure(machine)
    for (name, row), (other, back) in zip(tree.tables(machine), tree.tables(again), strict=True):
        assert name == other
        assert np.array_equal(row, back)


REFUSED = {
    "bound": ("frequency_Hz = 18", "frequency_Hz = -1", r"couplings\.0\.frequency = -1 Hz .* must be > 0 Hz"),
    "unit": ("mass_kg = 900", "mass_mm = 900", r"key 'couplings\.0\.mass_mm' is not known to structure_mode; if mass"),
    "kind": ('kind = "structure_mode"', 'kind = "structure"', r"couplings\.0\.kind = 'structure' is not known"),
    "axis": ('axis = "x"', 'axis = "q"', r"couplings\.0: structure_mode acts on axis 'q', which is not there"),
    "twice": ('axis = "x"', 'axis = "y"', r"couplings\.0: structure_mode\.shapes must name .*each axis once"),
    "shape": ("load = 0.8", 'load = "0.8"', r"couplings\.0\.shapes\.0\.load = '0\.8' .* without quotes"),
    "too fast": (
        "frequency_Hz = 18",
        "frequency_Hz = 1e8",
        r"the modes under x, y: its fastest mode, 1e\+08 Hz",
    ),
    "substeps": ("substeps = 4", "substeps = 2", r"couplings\.0: the axes of a machine have one number of substeps"),
    "no list": ("[[couplings]]", "[couplings]", r"couplings must be a list of sections, each under \[\[couplings\]\]"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_wrong_coupling_is_refused_with_file_line_and_key(case: str, tmp_path: Path) -> None:
    old, new, words = REFUSED[case]
    path = tmp_path / "gantry.toml"
    path.write_text(GANTRY.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(FeeddriveError) as caught:
        read_machine(path)
    assert re.match(rf"{re.escape(str(path))}:\d+: ", str(caught.value))
    assert re.search(words, str(caught.value)), str(caught.value)


def test_what_works_on_one_axis_refuses_a_coupled_one() -> None:
    file = read_machine("gantry")
    with pytest.raises(ParameterError, match=r"axis 'x' is coupled with y by couplings\.0 \(structure_mode\)"):
        file.loop("x")
    with pytest.raises(ParameterError, match="coupled with y"):
        fd.compare(file, axis="x")
    with pytest.raises(ParameterError, match="coupled with y"):
        tune("gantry", axis="x")


def test_a_job_runs_all_axes_of_a_coupled_machine(tmp_path: Path) -> None:
    """Row and other axes are those of one run of the machine; margins are those of the coupled axis."""
    (tmp_path / "job.toml").write_text(JOB[: JOB.rindex("[[law]]")], encoding="utf-8")
    result = run(tmp_path / "job.toml")
    job, rows = result.job, result.rows
    path = {"x": job.reference, "y": job.others["y"].reference}
    for row in rows:
        found = simulate(job.machines[row.name], path, seed=job.seed)  # type: ignore[arg-type]
        assert np.array_equal(row.run["following_error"], found["x.following_error"])
        assert row.together is not None
        assert np.array_equal(row.together["y.force"], found["y.force"])
    alone = fd.simulate(job.loops["today"], path["x"], seed=job.seed)  # type: ignore[arg-type]
    assert rows[0].rms("following_error") > 1.05 * float(np.sqrt(np.mean(alone["following_error"] ** 2)))
    assert rows[0].stiffness is not None
    stiff = fd.stiffness(fd.compliance(job.loops["today"], rows[0].compliance.frequency, velocity=result.velocity))  # type: ignore[union-attr]
    assert rows[0].stiffness.minimum < 0.95 * stiff.minimum
    assert set(summary(result)["laws"]) == {"today", "beam with half the gains"}
    (others,) = result.contents().extras
    assert [row[:2] for row in others.rows] == [["today", "y"], ["beam with half the gains", "y"]]
    assert "structure mode" in result.contents().facts["Couplings"]


WRONG_JOBS = {
    "no such axis": ("[others.y.reference]", "[others.q.reference]", r"others\.q: there is no other axis 'q'"),
    "the axis itself": ("[others.y.reference]", "[others.x.reference]", r"others\.x: there is no other axis 'x'"),
    "not control": ('"axis.y.control.law.Kv"', '"axis.y.plant.mass"', r"not part of the control: .* or axis\.y\."),
    "bound": ('law.Kp" = 33000.0', 'law.Kp" = -1.0', r"axis\.y\.control\.law\.Kp = -1"),
}


@pytest.mark.parametrize("case", WRONG_JOBS)
def test_a_wrong_job_is_refused(case: str, tmp_path: Path) -> None:
    old, new, words = WRONG_JOBS[case]
    path = tmp_path / "job.toml"
    path.write_text(JOB.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ParameterError, match=words) as caught:
        read_job(path)
    assert re.match(rf"{re.escape(str(path))}:\d+: ", str(caught.value))
