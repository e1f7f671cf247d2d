"""An FMU as the plant of a loop: ours has the simulator's bits, a foreign one its closed form, a wrong one is named."""

from __future__ import annotations

import builtins
import contextlib
import os
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from typer.testing import CliRunner

import feeddrive
from feeddrive import Axis, Control, Guard, Loop, simulate
from feeddrive.blocks import Actuator, CascadePPI, Rigid, SnapLimitedMove, StepForce, Viscous
from feeddrive.cli.commands import app
from feeddrive.cosimulation import simulate_with_fmu
from feeddrive.cosimulation.simulate_with_fmu import _check_entries, cosimulate, importer, write_cosimulation
from feeddrive.export import c_bundle
from feeddrive.export.fmu import fmu
from feeddrive.export.layout import layout
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import (
    DivergedError,
    FeeddriveError,
    FileError,
    FmuError,
    MissingExtraError,
    MissingProgramError,
    ParameterError,
)
from feeddrive.language.judgment import Judgment
from feeddrive.loop.routine import plant_routine
from foreign_fmu import DESCRIPTION, damaged, slide
from slow_share import all_but

pytest.importorskip("fmpy", reason="NOT TESTED: an FMU runs through FMPy: pip install 'feeddrive[fmu]'")
try:
    c_bundle.compiler()
except MissingProgramError as missing:
    pytest.skip(str(missing), allow_module_level=True)

MOVE = SnapLimitedMove(distance=0.01, velocity=0.2, acceleration=4.0, jerk=200.0, snap=4e4)
NAMES = {"force": "motor.F", "reading": "table.x", "velocity_load": "table.v"}


@pytest.fixture(scope="module")
def plants(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plants")
    for machine, version in (("ball_screw", 2), ("ball_screw", 3), ("emps", 2)):
        laid = layout(plant_routine(read_machine(machine).loop(None), "plant"))
        path = folder / f"{machine}{version}.fmu"
        path.write_bytes(fmu(laid, version, title="a plant", made_by="Made by a test."))
    return folder


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return slide(tmp_path_factory.mktemp("foreign"))


def rigid(dead_time: float = 0.0) -> Loop:
    """The machine that the foreign FMU is."""
    return Loop(
        control=Control(law=CascadePPI(Kv=50.0, Kp=3e4, Tn=0.02), guard=Guard(), force_limit=2000.0),
        axis=Axis(
            plant=Rigid(mass=100.0), friction_load=Viscous(viscous=500.0), actuator=Actuator(dead_time=dead_time)
        ),
        sample_time=1e-3,
    )


def same(one: np.ndarray, other: np.ndarray) -> bool:
    return np.array_equal(np.ascontiguousarray(one).view(np.int64), np.ascontiguousarray(other).view(np.int64))


@pytest.mark.parametrize(
    "plant", all_but(["emps2"], ["ball_screw2", "ball_screw3", "emps2"], "the other version of the same")
)
def test_our_own_plant_gives_the_bits_of_the_simulator(plants: Path, plant: str) -> None:
    """Two encoders and one, a load, a start that is not zero, a trip and a second enable."""
    loop = read_machine(plant[:-1]).loop(None)
    loop = replace(loop, control=replace(loop.control, guard=loop.control.guard or Guard()))
    reference = replace(MOVE, start=0.05)
    enable = np.ones(1200)
    enable[600:620] = 0.0
    load = StepForce(force=300.0, start=0.01)
    expected = simulate(loop, reference, load=load, enable=enable)
    found = simulate_with_fmu(loop, plants / f"{plant}.fmu", reference, load=load, enable=enable)
    assert {"force", "trip", "reading_motor", "reading_load", "position_load", "tracking_error"} <= set(found.signals)
    for signal, values in found.signals.items():
        assert same(values, expected[signal]), signal
    assert same(found.time, expected.time)


@pytest.mark.slow(reason="four laws run through an FMU; its command does so quickly")
def test_the_work_of_a_bundled_job_has_the_figures_of_its_simulation(plants: Path, tmp_path: Path) -> None:
    job = read_job("ball_screw")
    found = cosimulate(job, plants / "ball_screw2.fmu")
    for row in found.rows:
        expected = simulate(job.loops[row.name], job.reference, load=job.load, duration=job.duration, seed=job.seed)
        assert same(row.run["following_error"], expected["following_error"])
    assert [line[0] for line in found.table().rows] == list(job.loops)
    summary = write_cosimulation(found, tmp_path / "out")
    assert '"trip": 0.0' in summary.read_text()
    assert len(list((tmp_path / "out" / "runs").glob("*.parquet"))) == len(job.loops)
    assert found.plot() is not None
    assert list(found.to_pandas().columns)[-1] == "trip"


@pytest.mark.parametrize("dead_time", [0.0, 1e-3, 2.25e-3])
def test_a_foreign_plant_in_mm_and_kN_is_the_rigid_mass_that_it_is(foreign: Path, dead_time: float) -> None:
    """Both are exact for a held force; what is left is rounding, some 1e-16 m a sample over 300 samples."""
    expected = simulate(rigid(dead_time), MOVE)
    found = simulate_with_fmu(rigid(), foreign, MOVE, names=NAMES, dead_time=dead_time)
    assert found["reading_load"] == pytest.approx(expected["reading_load"], abs=1e-13)
    assert found["velocity_load"] == pytest.approx(expected["velocity_load"], abs=1e-11)
    assert found["force"] == pytest.approx(expected["force"], abs=1e-6)
    assert np.max(np.abs(found["following_error"])) > 1e-6  # it is a loop, not a copy
    assert found.plot() is not None
    assert "following error" in str(found)


def test_a_unit_that_is_named_wins_and_no_unit_is_si(foreign: Path) -> None:
    plain = simulate_with_fmu(rigid(), foreign, MOVE, names=NAMES)
    named = simulate_with_fmu(rigid(), foreign, MOVE, names=NAMES | {"reading": "table.x:mm", "force": "motor.F:kN"})
    assert same(plain["reading_load"], named["reading_load"])
    slower = simulate_with_fmu(rigid(), foreign, MOVE, names=NAMES | {"velocity_load": "table.v:mm/s"})
    assert slower["velocity_load"] == pytest.approx(1e-3 * plain["velocity_load"])


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_in_an_fmu(plants: Path, tmp_path: Path, version: int) -> None:
    """FMPy's container loads our plant by its own C: an importer and a binary of others, and still every bit."""
    missing = "NOT TESTED: this FMPy has no containers: pip install -U fmpy"
    container = pytest.importorskip("fmpy.container_fmu.cli", reason=missing)
    from fmpy import read_model_description
    from fmpy.container_fmu.config import Component, Configuration
    from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable, Unknown

    loop = read_machine("ball_screw").loop(None)
    inner = read_model_description(str(plants / f"ball_screw{version}.fmu"))
    inner.instantiationToken = inner.guid
    plant = Component(name="plant", filename=plants / f"ball_screw{version}.fmu", modelDescription=inner)
    real = "Real" if version == 2 else "Float64"
    mapped = {
        ModelVariable(
            name=each.name,
            valueReference=0,
            type=real,
            causality=each.causality,
            variability=each.variability,
            initial=each.initial,
            start=each.start,
        ): [(plant, each)]
        for each in inner.modelVariables
        if each.name in ("force", "load_force", "reading_motor", "reading_load", "position_load")
    }
    time = ModelVariable(name="time", valueReference=0, type=real, causality="independent", variability="continuous")
    outer = ModelDescription(fmiVersion=f"{version}.0", modelName="Container", instantiationToken="{box}")
    outer.guid = "{box}"
    outer.coSimulation = CoSimulation(fixedInternalStepSize=float(loop.sample_time))
    outer.modelVariables = [time, *mapped]
    outer.outputs = [Unknown(variable=each) for each in mapped if each.causality == "output"]
    outer.initialUnknowns = [Unknown(variable=each) for each in mapped if each.causality == "output"]
    (tmp_path / "unzipped").mkdir()
    wanted = Configuration(
        parallelDoStep=False, modelDescription=outer, components=[plant], connections=[], variableMappings=mapped
    )
    container.create_container_fmu(wanted, tmp_path / "unzipped", tmp_path / "box.fmu")
    found = simulate_with_fmu(loop, tmp_path / "box.fmu", MOVE)
    expected = simulate(loop, MOVE)
    for signal, values in found.signals.items():
        assert same(values, expected[signal]), signal


def test_an_fmu_of_python_code(tmp_path: Path) -> None:
    """Made by pythonfmu, whose shell is a program of others; Euler in ten pieces: 1 % of the error, 1 µm at most."""
    builder = pytest.importorskip("pythonfmu.builder", reason="NOT TESTED: pip install pythonfmu")
    script = tmp_path / "slide.py"
    script.write_text(
        """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

class Slide(Fmi2Slave):
    def __init__(self, **named):
        super().__init__(**named)
        self.F, self.x, self.v = 0.0, 0.0, 0.0
        self.register_variable(Real("x", causality=Fmi2Causality.output))
        self.register_variable(Real("F", causality=Fmi2Causality.input))

    def do_step(self, time, step):
        for _ in range(10):
            self.v += (self.F - 500.0 * self.v) / 100.0 * step / 10
            self.x += self.v * step / 10
        return True
"""
    )
    path = builder.FmuBuilder.build_FMU(script, dest=tmp_path)
    found = simulate_with_fmu(rigid(), path, MOVE, names={"force": "F", "reading": "x"})
    expected = simulate(rigid(), MOVE)
    assert found["reading_load"] == pytest.approx(expected["reading_load"], abs=1e-6)


def test_a_wrong_sign_diverges_with_a_sentence(foreign: Path) -> None:
    loop = rigid()
    loop = replace(loop, control=replace(loop.control, force_limit=None))
    text = DESCRIPTION.replace('factor="1e3"', 'factor="-1e3"')
    path = damaged(foreign, foreign.parent / "turned.fmu", **{"modelDescription.xml": text.encode()})
    with pytest.raises(DivergedError, match=r"sample \d+ .* m, not <= 0.002 m; check sign and unit"):
        simulate_with_fmu(loop, path, MOVE, names=NAMES, bound=2e-3)


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"names": NAMES | {"force": "motor.G"}}, FmuError, "no variable 'motor.G' for force; did you mean motor.F"),
        ({"names": NAMES | {"thrust": "motor.F"}}, ParameterError, "'thrust'"),
        ({"names": {"force": "motor.F"}}, FmuError, "the control needs reading.*outputs are: table.x"),
        ({"names": {"reading": "table.x"}}, FmuError, "the control needs force.*inputs are: motor.F"),
        ({"names": NAMES | {"force": "table.x"}}, FmuError, "is output, but force needs an input"),
        ({"names": NAMES | {"reading": "motor.F"}}, FmuError, "is input, but reading needs an output"),
        ({"names": NAMES | {"reading": "count"}}, FmuError, "not a scalar of 64 bits"),
        ({"names": NAMES | {"reading": "table.x:kN"}}, ParameterError, "'kN' does not measure the same thing as 'm'"),
        ({"names": NAMES | {"reading": "table.x:furlong"}}, ParameterError, "'furlong'"),
        ({"names": NAMES | {"reading": "heat"}}, ParameterError, "unit 'degC' does not measure"),
        ({"names": {"reading": "table.x", "command": "motor.F"}}, ParameterError, "names no motor"),
        ({"parameters": {"mass": 3.0}}, FmuError, "has no variable 'mass'"),
        ({"parameters": {"m": -3.0}}, FmuError, r"m = -3: the FMU failed \(Error\); it says: a mass of -3 kg"),
        ({"parameters": {"broken_after": 0.005}}, FmuError, "step of 0.001 s at 0.005 s.*the belt is broken"),
        ({"load": StepForce(force=1.0)}, FmuError, "the load needs load_force"),
        ({"dead_time": -1e-3}, ParameterError, "dead_time = -0.001 s must be >= 0 s"),
        ({"dead_time": float("nan")}, ParameterError, "dead_time = nan s"),
    ],
)
def test_what_does_not_fit_is_named(foreign: Path, given: dict, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        simulate_with_fmu(rigid(), foreign, MOVE, **({"names": NAMES} | given))


def test_files_that_are_no_fmu_for_this_machine(foreign: Path, tmp_path: Path) -> None:
    def refused(path: Path, error: type[Exception], words: str) -> None:
        with pytest.raises(error, match=words) as caught:
            simulate_with_fmu(rigid(), path, MOVE, names=NAMES)
        assert str(path) in str(caught.value)

    def other(name: str, **entries: bytes | None) -> Path:
        return damaged(foreign, tmp_path / name, **entries)

    text = tmp_path / "text.fmu"
    text.write_text("no archive")
    refused(text, FmuError, "is damaged or not an FMU: File is not a zip file")
    refused(tmp_path / "none.fmu", FileError, "no such file")
    refused(tmp_path, FileError, "directory")
    refused(other("a.fmu", **{"modelDescription.xml": None}), FmuError, "holds no modelDescription.xml")
    refused(other("b.fmu", **{"modelDescription.xml": b"<fmi"}), FmuError, "is damaged or not an FMU")
    refused(other("c.fmu", **{"modelDescription.xml": b"<a/>"}), FmuError, "is damaged or not an FMU")
    refused(other("d.fmu", **{"../outside": b"x"}), FmuError, "outside its folder")
    assert not (tmp_path / "outside").exists()
    here = Path.cwd()
    one = DESCRIPTION.replace('fmiVersion="2.0"', 'fmiVersion="1.0"')
    refused(other("e.fmu", **{"modelDescription.xml": one.encode()}), FmuError, "FMI 1.0|is damaged or not an FMU")
    exchange = re.sub("<CoSimulation[^>]*>", '<ModelExchange modelIdentifier="slide"/>', DESCRIPTION)
    refused(other("f.fmu", **{"modelDescription.xml": exchange.encode()}), FmuError, "it has no solver")
    token = DESCRIPTION.replace("a-foreign-guid", "another")
    refused(other("g.fmu", **{"modelDescription.xml": token.encode()}), FmuError, "cannot be started")
    (tmp_path / "away").mkdir()
    refused(slide(tmp_path / "away", place="win64"), FmuError, "has binaries for win64, but none for this machine")
    library = next(name for name in ZipFile(foreign).namelist() if name.startswith("binaries"))
    refused(other("h.fmu", **{library: b"not a library"}), FmuError, "cannot be started")
    assert Path.cwd() == here


def test_another_sample_time_is_refused_by_the_plant_itself(plants: Path) -> None:
    loop = replace(read_machine("ball_screw").loop(None), sample_time=7.5e-5)
    with pytest.raises(FmuError, match=r"failed \(Error\); it says: .* is no whole multiple"):
        simulate_with_fmu(loop, plants / "ball_screw2.fmu", MOVE)


def test_fmpy_is_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    known = builtins.__import__

    def without(name: str, *rest: object) -> object:
        if name == "fmpy":
            raise ImportError(name)
        return known(name, *rest)

    monkeypatch.delitem(sys.modules, "fmpy", raising=False)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"pip install 'feeddrive\[fmu\]'"):
        importer()


@pytest.mark.slow(reason="the command with its report, 10 s; the runs of FMUs and what is refused are quick")
def test_the_command(plants: Path, foreign: Path, tmp_path: Path) -> None:
    out = ["--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, ["cosimulate", "ball_screw", str(plants / "ball_screw3.fmu"), *out])
    assert done.exit_code == 0, done.exception
    assert "without inertia feedforward" in done.output
    assert "states no linear model" in done.output
    machine = read_machine("ball_screw").file.text
    close, changed = re.subn(r"(?m)^following_error_limit.*$", "following_error_limit_um = 0.01", machine)
    assert changed == 1
    (tmp_path / "close.toml").write_text(close, encoding="utf-8")
    text = read_job("ball_screw").file.text.replace('machine = "ball_screw"', 'machine = "close.toml"')
    (tmp_path / "job.toml").write_text(text, encoding="utf-8")
    words = ["cosimulate", str(tmp_path / "job.toml"), str(plants / "ball_screw3.fmu"), *out]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 1, done.exception
    assert Judgment.TRIPPED.says in done.output
    for job, words, expected in (
        ("ball_screw", ["--variable", "force"], "give each name once, as name=value"),
        ("ball_screw", ["--variable", "force=motor.F", "--set", "m=heavy"], "'heavy' is no number"),
        (
            "ball_screw",
            ["--variable", "force=motor.F", "--variable", "reading=table.x:mm"],
            "the load needs load_force",
        ),
        ("emps_log", [], "replays a log"),
    ):
        done = CliRunner().invoke(app, ["cosimulate", job, str(foreign), *out, *words])
        assert isinstance(done.exception, FeeddriveError)
        assert expected in str(done.exception)


def test_a_machine_file_cannot_name_an_fmu(tmp_path: Path) -> None:
    """Nothing that is read is ever executed, and analysis needs a model."""
    text = (Path(feeddrive.__file__).parent / "files" / "bundled" / "machines" / "emps.toml").read_text()
    path = tmp_path / "machine.toml"
    path.write_text(re.sub(r'(\[axis\.x\.plant\]\nkind = )"\w+"', r'\1"fmu"', text))
    with pytest.raises(ParameterError, match=r"no linear model.*feeddrive cosimulate"):
        read_machine(path)


@pytest.mark.parametrize(("megabytes", "accepted"), [(300, True), (800, False)])
def test_an_fmu_has_at_most_500_megabytes(
    megabytes: int, accepted: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is read whole for its digest."""
    path, stat = tmp_path / "large.fmu", os.stat
    path.touch()

    def large(name: str | Path) -> object:
        return SimpleNamespace(st_mode=stat(name).st_mode, st_size=megabytes * 1_000_000)

    nothing: Any = SimpleNamespace(reference=MOVE, machines={}, loops={})
    refusal = contextlib.nullcontext() if accepted else pytest.raises(FileError, match="more than the 500")
    with refusal, monkeypatch.context() as patch:
        patch.setattr("feeddrive.files.atomic_io.os.stat", large)
        assert cosimulate(nothing, path).rows == ()


@pytest.mark.parametrize(("gigabytes", "accepted"), [(1.5, True), (3.0, False)])
def test_an_fmu_unpacks_to_at_most_two_gigabytes(gigabytes: float, accepted: bool) -> None:
    """What a hostile archive states in a few bytes would fill the disk."""
    half = SimpleNamespace(file_size=int(0.5e9 * gigabytes))
    packed: Any = SimpleNamespace(namelist=lambda: ["modelDescription.xml"], infolist=lambda: [half, half])
    with contextlib.nullcontext() if accepted else pytest.raises(FmuError, match="more than the 2 GB"):
        _check_entries(packed, "a.fmu")
