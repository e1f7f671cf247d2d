"""Machine and job files: what they say is what is simulated, and every mistake is named with its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.files.columns import Column
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError

MACHINE = """name = "mill"
sample_time_ms = 0.25
[axis.x]
substeps = 2
[axis.x.plant]
kind = "two_mass"
mass_motor = 100
mass_load_t = 0.35
stiffness_N_per_um = 180
[axis.x.friction_load]
kind = "stribeck"
coulomb = 100
breakaway = 150
stribeck_velocity_mm_per_s = 2
[axis.x.control.law]
kind = "cascade_ppi"
Kv_m_per_min_per_mm = 2.4
Kp = 4e4
"""
JOB = """machine = "m.toml"
[reference]
kind = "snap_limited_move"
distance_mm = 100
velocity = 0.5
acceleration = 5
jerk = 200
snap = 2e4
[[law]]
name = "half"
set = { "axis.x.control.law.Kv" = 20 }
[[law]]
name = "nested"
set = { axis = { x = { control = { law = { Kv = 10 } } } } }
[[law]]
name = "other"
[law.control.law]
kind = "cascade_ppi"
Kv = 1
Kp = 2
"""
LOG = """machine = "m.toml"
[log]
file = "run.csv"
sample_time_ms = 0.25
[log.channels]
setpoint_position = "x"
force = { column = "i", factor = -3 }
"""


def written(folder: Path, job: str = JOB, machine: str = MACHINE) -> Path:
    (folder / "m.toml").write_text(machine, encoding="utf-8")
    (folder / "j.toml").write_text(job, encoding="utf-8")
    return folder / "j.toml"


def test_a_machine_is_what_its_file_says(tmp_path: Path) -> None:
    loop = read_machine(written(tmp_path).parent / "m.toml").loop("x")
    assert loop.sample_time == 0.25e-3
    assert loop.axis.substeps == 2
    assert isinstance(loop.axis.plant, TwoMass)
    assert (loop.axis.plant.mass_load, loop.axis.plant.stiffness) == (350.0, 1.8e8)
    assert isinstance(loop.axis.friction_load, Stribeck)
    assert loop.axis.friction_load.stribeck_velocity == 2e-3
    assert isinstance(loop.control.law, CascadePPI)
    assert loop.control.law.Kv == pytest.approx(40.0, rel=1e-15)  # 2.4 (m/min)/mm


def test_the_laws_of_a_job(tmp_path: Path) -> None:
    job = read_job(written(tmp_path))
    assert {name: loop.control.law.Kv for name, loop in job.loops.items()} == pytest.approx(
        {"today": 40.0, "half": 20.0, "nested": 10.0, "other": 1.0}
    )
    assert {loop.sample_time for loop in job.loops.values()} == {0.25e-3}
    assert job.title == "j"


def test_the_log_of_a_job(tmp_path: Path) -> None:
    request = read_job(written(tmp_path, LOG)).log
    assert request is not None
    assert request.path == tmp_path / "run.csv"
    assert request.mapping.sample_time == 0.25e-3
    assert request.mapping.columns == {"setpoint_position": Column(name="x"), "force": Column(name="i", factor=-3.0)}
    other = read_job(tmp_path / "j.toml", tmp_path / "other.csv").log
    assert other is not None
    assert other.path == tmp_path / "other.csv"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mass_motor = 100", "mass_motor = -1", r"m\.toml:7: axis\.x\.plant\.mass_motor = -1 kg .* must be > 0 kg"),
        (
            "mass_motor = 100",
            "mass_moto = 1",
            r"m\.toml:7: key 'axis\.x\.plant\.mass_moto' is not known to two_mass; did",
        ),
        ("mass_load_t = 0.35", "mass_load_s = 1", r"m\.toml:8: .*unit 's' does not measure the same thing as 'kg'"),
        (
            "breakaway = 150",
            "breakaway = 1",
            r"m\.toml:10: axis\.x\.friction_load: stribeck\.breakaway = 1 N must be >=",
        ),
        ("sample_time_ms = 0.25", "", r"m\.toml: sample_time is missing \(s, time from sample to sample, > 0 s\)"),
        (
            "sample_time_ms = 0.25",
            "sample_time = 1\nsampletime = 1",
            r"m\.toml:3: key 'sampletime' is not known; did you mean sample_time\?",
        ),
        ("[axis.x.control.law]", "[axis.x.law]", r"m\.toml:15: key 'axis\.x\.law' is not known to axis"),
        ("substeps = 2", "substeps = 2.5", r"m\.toml:4: axis\.x\.substeps = 2\.5 .* must be a whole number"),
        ('name = "mill"', "name = 1", r"m\.toml:1: name must be a text in quotes"),
        ("[axis.x.plant]", "[axis.x.plan]", r"m\.toml:5: key 'axis\.x\.plan' is not known to axis; did you mean plant"),
    ],
)
def test_what_is_wrong_with_a_machine(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in MACHINE
    written(tmp_path, machine=MACHINE.replace(old, new))
    with pytest.raises(FeeddriveError, match=message):
        read_machine(tmp_path / "m.toml")
    with pytest.raises(FeeddriveError, match=message):  # a job that names it says the same
        read_job(tmp_path / "j.toml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (JOB.replace('"m.toml"', '"n.toml"'), r"j\.toml:1: machine: .*n\.toml: .*no such file"),
        (JOB.replace('machine = "m.toml"', ""), r"j\.toml: machine is missing"),
        (JOB + 'title = "x"', r"j\.toml:21: key 'law\.2\.control\.law\.title' is not known"),
        ("titel = 1\n" + JOB, r"j\.toml:1: key 'titel' is not known; did you mean title\?"),
        ("seed = -1\n" + JOB, r"j\.toml:1: seed = -1 \(seed of the noise\) must be >= 0"),
        ("axis = 'y'\n" + JOB, r"j\.toml:1: axis: .*axis 'y' is not there"),
        ("duration = 0\n" + JOB, r"j\.toml:1: duration = 0 s \(duration of the runs\) must be > 0 s and < 1000000 s"),
        (JOB + '[[law]]\nname = "half"\nset = {}', r"j\.toml:22: law\.3\.name must be a text that no other row has"),
        (JOB + '[[law]]\nname = "a"', r"j\.toml:21: law\.3: a row needs either set = .* or sections: \[law\.control\]"),
        (
            JOB + '[[law]]\nname = "a"\nset = { "axis.x.control.law.Kx" = 1 }',
            r"j\.toml:23: .*no parameter 'axis\.x\.control\.law\.Kx'",
        ),
        (JOB + '[[law]]\nname = "a"\nset = { "axis.x.control.law.Kv" = "b" }', r"j\.toml:23: .*must be a number"),
        (JOB + '[[law]]\nname = "a"\nset = { "axis.x.plant.mass_load" = 1 }', r"j\.toml:23: .*not part of the control"),
        (
            JOB + "[log]\nfile = 'a'",
            r"j\.toml: a job needs one of the sections .*\[program\], not \[reference\] and \[log\]",
        ),
        (LOG.replace("file", "fiel"), r"j\.toml:3: key 'log\.fiel' is not known; did you mean file\?"),
        (
            LOG.replace("sample_time_ms", "sample_time_mm"),
            r"j\.toml:4: key 'log\.sample_time_mm' is not known; if sample_time is meant: unit 'mm' does not measure",
        ),
        (
            LOG.replace("0.25", "0"),
            r"j\.toml:4: log\.sample_time = 0 s \(.*\) must be > 0 s .*\(given as sample_time_ms = 0\)",
        ),
        (LOG.replace("setpoint_", "setpont_"), r"j\.toml:6: key 'log\.channels\.setpont_position' is not known; did"),
        (
            LOG.replace("factor = -3", "factor = nan"),
            r"j\.toml:7: log\.channels\.force\.factor = nan \(.*\) must be a finite number",
        ),
        (LOG.replace("factor = -3", "unit = 'kg'"), r"j\.toml:7: log\.channels\.force: unit 'kg' does not measure"),
        (LOG.replace("factor = -3", f"factor = 1{'0' * 400}"), r"j\.toml:7: log\.channels\.force\.factor = inf "),
        (LOG.replace('column = "i", ', ""), r"j\.toml:7: log\.channels\.force must be the name of a column"),
    ],
)
def test_what_is_wrong_with_a_job(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FeeddriveError, match=message) as error:
        read_job(written(tmp_path, text))
    assert "\n" not in str(error.value)


def test_bundled_files_are_found_by_name_and_others_are_not() -> None:
    assert read_machine("emps").loops.keys() == {"x"}
    with pytest.raises(
        FileError, match=r"emsp: there is no such file, and no bundled one of that name; did you mean emps"
    ):
        read_machine("emsp")
    with pytest.raises(FileError, match="no such file"):
        read_job("emsp.toml")
    with pytest.raises(ParameterError, match=r"axis 'z' is not there; there are: x"):
        read_machine("emps").loop("z")
