"""FMUs of controllers and plants, run by FMPy: the bits of the simulator, the standard's calls, what is refused."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import feeddrive
from feeddrive import simulate
from feeddrive.blocks import SnapLimitedMove
from feeddrive.export import c_bundle
from feeddrive.export import fmu as binary
from feeddrive.export.design import CONTROL, PLANT, read_design, trial
from feeddrive.export.fmu import fmu, write_fmu
from feeddrive.export.layout import layout
from feeddrive.export.verify import verify_export
from feeddrive.files.machine import BUNDLED, read_machine
from feeddrive.language import tree
from feeddrive.language.errors import FileError, MissingProgramError, ParameterError
from feeddrive.loop.loop import Loop
from feeddrive.loop.routine import Routine, controller_routine, plant_routine, run
from slow_share import all_but

fmpy = pytest.importorskip("fmpy", reason="FMUs are run by FMPy: pip install 'feeddrive[fmu]'")
from fmpy.validation import validate_fmu  # noqa: E402

from exported import LAWS, LOOPS  # noqa: E402
from fmus import Played  # noqa: E402

try:
    c_bundle.compiler()
except MissingProgramError as missing:
    pytest.skip(str(missing), allow_module_level=True)

VERSIONS = (2, 3)
READINGS = ("reading_motor", "reading_load")
T = float(read_machine("ball_screw").loop(None).sample_time)


def ball_screw() -> Loop:
    return read_machine("ball_screw").loop(None)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Controller and plant of an axis with two encoders, in both versions."""
    folder = tmp_path_factory.mktemp("fmus")
    for version in VERSIONS:
        (folder / f"control{version}.fmu").write_bytes(packed(controller_routine(ball_screw(), "axis_x"), version))
        (folder / f"plant{version}.fmu").write_bytes(packed(plant_routine(ball_screw(), "axis_x_plant"), version))
    return folder


def packed(routine: Routine, version: int, *, title: str = "an axis", binary: bool = True) -> bytes:
    return fmu(layout(routine), version, title=title, made_by="Made by a test.", binary=binary)


def bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float64).view(np.int64)


def random_inputs(count: int, seed: int = 3) -> np.ndarray:
    """A motion with noise, a broken reading, a jump that trips, and a second enable."""
    random = np.random.default_rng(seed)
    t = T * np.arange(count)
    inputs = np.zeros((count, 8))
    inputs[:, 0] = 0.01 * np.sin(40.0 * t)
    inputs[:, 1] = 0.4 * np.cos(40.0 * t)
    inputs[:, 2] = -16.0 * np.sin(40.0 * t)
    inputs[:, 5:7] = inputs[:, :1] + 2e-5 * random.standard_normal((count, 2))
    inputs[count // 4, 6] = np.nan
    inputs[count // 2, 5:7] += 0.01
    inputs[:, 7] = 1.0
    inputs[3 * count // 5 : 3 * count // 5 + 5, 7] = 0.0
    return inputs


NAMES = ("set_position", "set_velocity", "set_acceleration", "set_jerk", "set_snap", *READINGS, "enable")
ANSWERS = ("force", "command", "trip", "enabled")


def answers(one: Played, inputs: np.ndarray, changes: dict[int, dict[str, float]] | None = None) -> np.ndarray:
    found = np.empty((len(inputs), len(ANSWERS)))
    for k, row in enumerate(inputs):
        one.set(**(changes or {}).get(k, {}), **dict(zip(NAMES, row, strict=True)))
        one.step(k * T, T)
        found[k] = one.get(*ANSWERS)
    return found


MACHINES = sorted(each.stem for each in (BUNDLED / "machines").glob("*.toml"))
AXES_MORE = ("mill", "machining_center", "head_table_bc", "fork_head_cb", "nutating_head_bc")


@pytest.mark.parametrize(
    ("machine", "version"),
    all_but(
        [*((machine, 3) for machine in MACHINES if machine not in AXES_MORE), ("ball_screw", 2)],
        [(machine, version) for machine in MACHINES for version in VERSIONS],
        "the same texts for more axes, or in the words of the other version",
    ),
)
def test_every_bundled_axis_is_described_by_the_rules(machine: str, version: int, tmp_path: Path) -> None:
    for axis, loop in read_machine(machine).loops.items():
        for routine in (controller_routine(loop, f"axis_{axis}"), plant_routine(loop, f"axis_{axis}_plant")):
            path = tmp_path / f"{routine.name}.fmu"
            path.write_bytes(packed(routine, version, title=f'<{machine}> & "axis" \x01 {axis}', binary=False))
            assert validate_fmu(str(path)) == []
            found = {each.name: each for each in fmpy.read_model_description(str(path)).modelVariables}
            for parameter in routine.parameters:
                assert float(found[parameter.name].start) == parameter.value
                assert found[parameter.name].unit == (parameter.unit or None)
                assert found[parameter.name].variability == ("fixed" if "plant" in routine.name else "tunable")


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_itself_gets_the_bits_of_the_simulator(made: Path, version: int) -> None:
    """`simulate_fmu`, with other gains as start values: row k + 1 is what was computed from input k."""
    inputs = random_inputs(1500)
    kinds = [("time", float), *((name, bool if name == "enable" else float) for name in NAMES)]
    signals = np.array([(k * T, *row[:-1], row[-1] > 0.5) for k, row in enumerate(inputs)], dtype=kinds)
    gains = {"law_Kv": 60.0, "law_Tn": 0.01}
    result = fmpy.simulate_fmu(
        str(made / f"control{version}.fmu"),
        start_values=gains,
        input=signals,
        output=list(ANSWERS),
        step_size=T,
        output_interval=T,
        stop_time=(len(inputs) - 1) * T,
    )
    routine = controller_routine(
        tree.vary(ball_screw(), {f"axis.x.control.law.{k[4:]}": v for k, v in gains.items()}), "axis_x"
    )
    expected = run(routine, inputs)
    found = np.array([[float(row[name]) for name in ANSWERS] for row in result])
    assert len(found) == len(inputs)
    assert (bits(found[1:]) == bits(expected[:-1])).all()
    assert set(expected[:, 2]) >= {0.0, 2.0}  # the jump has tripped, by the following error


@pytest.mark.parametrize("version", VERSIONS)
def test_gains_that_change_between_steps_go_through_retune(made: Path, tmp_path: Path, version: int) -> None:
    inputs = random_inputs(1200)
    changes = {300: {"law_Kv": 150.0, "law_Kp": 4e4}, 500: {"filters_0_frequency": 380.0}, 501: {"force_limit": 2000.0}}
    one = Played(made / f"control{version}.fmu", tmp_path)
    found = answers(one, inputs, changes)
    routine = controller_routine(ball_screw(), "axis_x")
    paths = {each.name: each.path for each in routine.parameters}
    dotted = {k: {paths[name]: value for name, value in each.items()} for k, each in changes.items()}
    assert (bits(found) == bits(run(routine, inputs, dotted))).all()
    assert one.get("law_Kv")[0] == 150.0
    one.close()


def check_random_samples(name: str, version: int, folder: Path, count: int) -> None:
    """A wandering axis with limits, trips, broken numbers and live changes: the simulator's bits."""
    routine = controller_routine(LOOPS[name], "axis_x")
    tried = trial(routine, count, seed=5, changes=20)
    path = folder / f"law{version}.fmu"
    path.write_bytes(packed(routine, version))
    one = Played(path, folder)
    known = {each.path: each.name for each in routine.parameters}
    found = np.empty((count, len(routine.outputs)))
    for k, row in enumerate(tried.inputs):
        one.set(**{known[path]: value for path, value in tried.changes.get(k, {}).items()})
        one.set(**dict(zip((each.name for each in routine.inputs), row, strict=True)))
        one.step(k * routine.sample_time, routine.sample_time)
        found[k] = one.get(*(each.name for each in routine.outputs))
    one.close()
    assert len(tried.changes) > 5
    assert (bits(found) == bits(run(routine, tried.inputs, tried.changes))).all()


@pytest.mark.parametrize(
    ("name", "version"),
    all_but(
        [("cascade_ppi", 2), *((name, 3) for name in LAWS if name != "active_disturbance_rejection")],
        [(name, version) for name in sorted(LAWS) for version in VERSIONS],
        "a compiler reads each; both versions run the same C",
    ),
)
def test_every_law_has_the_bits_of_the_simulator(name: str, version: int, tmp_path: Path) -> None:
    check_random_samples(name, version, tmp_path, 2000)


@pytest.mark.slow(reason="a compiler reads each loop; the laws run quickly, and the C has a test of each part")
@pytest.mark.parametrize("name", sorted(set(LOOPS) - set(LAWS)))
def test_every_part_of_a_control_has_the_bits_of_the_simulator(name: str, tmp_path: Path) -> None:
    check_random_samples(name, 2, tmp_path, 20_000)


@pytest.mark.parametrize("version", VERSIONS)
def test_two_fmus_in_a_loop_are_the_simulated_loop(made: Path, tmp_path: Path, version: int) -> None:
    """The controller first, then the plant: reading at kT, a force that acts from kT on."""
    loop = ball_screw()
    reference = SnapLimitedMove(distance=0.01, velocity=0.2, acceleration=4.0, jerk=200.0, snap=4e4)
    expected = simulate(loop, reference)
    control = Played(made / f"control{version}.fmu", tmp_path, enable=1.0)
    plant = Played(made / f"plant{version}.fmu", tmp_path)
    count = expected.time.size
    setpoints = [np.broadcast_to(row, count) for row in reference.at(np.arange(count) * T)]
    signals = (*READINGS, "position_motor", "position_load", "velocity_motor", "velocity_load")
    found = np.empty((count, len(signals) + 1))
    for k in range(count):
        seen = plant.get(*signals)
        control.set(**{name: row[k] for name, row in zip(NAMES, setpoints, strict=False)})
        control.set(**dict(zip(READINGS, seen, strict=False)))
        control.step(k * T, T)
        (force,) = control.get("force")
        plant.set(force=force)
        plant.step(k * T, T)
        found[k] = (*seen, force)
    for i, name in enumerate((*signals, "force")):
        assert (bits(found[:, i]) == bits(expected[name])).all(), name
    control.close()
    plant.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_plant_starts_where_it_is_told(made: Path, tmp_path: Path, version: int) -> None:
    plant = Played(made / f"plant{version}.fmu", tmp_path, start_position=0.25)
    assert plant.get("reading_load", "position_motor", "velocity_load") == pytest.approx([0.25, 0.25, 0.0], abs=1e-8)
    plant.step(0.0, 10 * T)
    assert plant.get("position_load")[0] == pytest.approx(0.25, abs=1e-12)  # no force: it stays, to rounding
    plant.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_brings_back_every_bit(made: Path, tmp_path: Path, version: int) -> None:
    """Kept, serialized and given to another instance: what follows is the same, trip and changed gain included."""
    inputs = random_inputs(900)
    one = Played(made / f"control{version}.fmu", tmp_path)
    answers(one, inputs[:400])
    one.set(law_Kv=70.0)  # not yet in force: this too is part of the state
    kept = one.state()
    content = one.bytes_of(kept)

    def rest(instance: Played) -> np.ndarray:
        found = np.empty((500, len(ANSWERS)))
        for k, row in enumerate(inputs[400:]):
            instance.set(**dict(zip(NAMES, row, strict=True)))
            instance.step((400 + k) * T, T)
            found[k] = instance.get(*ANSWERS)
        return found

    first = rest(one)
    one.restore(kept)
    assert one.bytes_of(one.state()) == content
    assert (bits(rest(one)) == bits(first)).all()
    other = Played(made / f"control{version}.fmu", tmp_path, name="other")
    other.restore(other.state_of(content))
    assert (bits(rest(other)) == bits(first)).all()
    one.drop(kept)
    with pytest.raises(Exception, match=f"fmi{version}De"):
        other.state_of(b"x" * len(content))
    assert "no state of this FMU" in other.said[-1][2]
    one.close()
    other.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_reset_terminate_and_several_instances(made: Path, tmp_path: Path, version: int) -> None:
    inputs = random_inputs(300)
    one, two = (Played(made / f"control{version}.fmu", tmp_path, name=name) for name in ("one", "two"))
    two.set(law_Kv=20.0)
    first = answers(one, inputs)
    other = answers(two, inputs)
    assert (bits(first) != bits(other)).any()
    one.fmu.terminate()
    with pytest.raises(Exception, match="DoStep"):
        one.step(300 * T, T)
    one.fmu.reset()
    one.begin()
    assert (bits(answers(one, inputs)) == bits(first)).all()
    one.close()
    two.fmu.reset()
    two.begin()
    assert two.get("law_Kv")[0] == 100.0  # the machine's own again
    assert (bits(answers(two, inputs)) == bits(first)).all()
    two.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_steps_are_whole_multiples_of_the_sample_time(made: Path, tmp_path: Path, version: int) -> None:
    one = Played(made / f"control{version}.fmu", tmp_path, at=0.3)
    for step in (0.5 * T, 1.4 * T, 0.0, -T, float("nan"), float("inf"), 1e300):
        with pytest.raises(Exception, match="DoStep") as refused:
            one.step(0.3, step)
        assert refused.value.status == (3 if version == 2 else 2)  # Error, Discard
        assert "whole multiple" in one.said[-1][2]
    with pytest.raises(Exception, match="DoStep") as refused:
        one.step(0.4, T)
    assert refused.value.status == 3
    assert "ended at 0.3" in one.said[-1][2]
    one.set(set_position=1e-4, enable=1.0)
    one.step(0.3, 3 * T)
    assert one.get("time")[0] == 0.3 + 3 * T
    held = np.tile(np.array([1e-4, 0, 0, 0, 0, 0, 0, 1.0]), (3, 1))
    assert one.get("force")[0] == run(controller_routine(ball_screw(), "axis_x"), held)[-1, 0]  # inputs are held
    one.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_what_does_not_belong_together_is_refused(made: Path, tmp_path: Path, version: int) -> None:
    with pytest.raises(Exception, match="Failed to instantiate"):
        Played(made / f"control{version}.fmu", tmp_path, token="{00000000-0000-0000-0000-000000000000}")
    one = Played(made / f"control{version}.fmu", tmp_path)
    for values, why in (
        ({"law_Kv": float("nan")}, "finite"),
        ({"law_Kv": 0.0}, "outside its bounds"),
        ({"law_Kv": -3.0}, "outside its bounds"),
        ({"sample_time": 1e-3}, "designed for it"),
        ({"force": 1.0}, "computed"),
    ):
        with pytest.raises(Exception, match="Set"):
            one.set(**values)
        assert why in one.said[-1][2]
    one.set(sample_time=T)  # its own
    assert one.get("law_Kv")[0] == 100.0
    plant = Played(made / f"plant{version}.fmu", tmp_path)
    with pytest.raises(Exception, match="Set"):
        plant.set(plant_mass_load=10.0)
    assert "before the initialization ends" in plant.said[-1][2]
    for instance in (one, plant):
        instance.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_trip_is_told(made: Path, tmp_path: Path, version: int) -> None:
    one = Played(made / f"control{version}.fmu", tmp_path, enable=1.0)
    one.step(0.0, T)
    one.set(reading_load=0.002, reading_motor=0.002)
    one.step(T, 2 * T)
    told = [text for _, category, text in one.said if category == "logEvents"]
    assert told == ["tripped at 5e-05 s: the following error (trip = 2); no force until enable is taken away"]
    assert list(one.get("trip", "enabled", "force")) == [2.0, 0.0, 0.0]
    one.set(enable=0.0)
    one.step(3 * T, T)
    assert one.said[-1][1:] == ("logEvents", "trip cleared at 0.00015 s")
    one.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_what_is_not_provided_says_so(made: Path, tmp_path: Path, version: int) -> None:
    one = Played(made / f"control{version}.fmu", tmp_path)
    simulated = one.description.coSimulation
    assert simulated.canGetAndSetFMUstate
    assert simulated.canSerializeFMUstate
    root = ElementTree.fromstring(zipfile.ZipFile(made / f"control{version}.fmu").read("modelDescription.xml"))
    name = "providesDirectionalDerivative" + ("s" if version == 3 else "")
    assert root.find("CoSimulation").get(name) == "false"
    with pytest.raises(Exception, match="DirectionalDerivative"):
        one.fmu.getDirectionalDerivative([one.references["force"]], [one.references["set_position"]], [1.0])
    assert "does not provide" in one.said[-1][2]
    one.close()


@pytest.mark.parametrize("version", all_but([3], VERSIONS, "CMake configures a project of the same files"))
def test_a_source_fmu_is_compiled_by_fmpy(made: Path, tmp_path: Path, version: int) -> None:
    """Without a binary; CMake and the local compiler make one, and it gives the same bits."""
    pytest.importorskip("cmake", reason="`fmpy compile` needs CMake: pip install cmake")
    path = tmp_path / f"control{version}.fmu"
    path.write_bytes(packed(controller_routine(ball_screw(), "axis_x"), version, binary=False))
    assert not [name for name in zipfile.ZipFile(path).namelist() if name.startswith("binaries")]
    done = subprocess.run([sys.executable, "-m", "fmpy", "compile", str(path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    inputs = random_inputs(400)
    one = Played(path, tmp_path)
    assert (bits(answers(one, inputs)) == bits(run(controller_routine(ball_screw(), "axis_x"), inputs))).all()
    one.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_its_c_has_no_warning(made: Path, tmp_path: Path, version: int) -> None:
    flags = (
        "-std=c99",
        "-pedantic",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-Wdouble-promotion",
        "-Wshadow",
        "-Werror",
        "-fsyntax-only",
    )
    for kind in ("control", "plant"):
        folder = tmp_path / kind
        zipfile.ZipFile(made / f"{kind}{version}.fmu").extractall(folder)
        sources = sorted(map(str, (folder / "sources").glob("*.c")))
        done = subprocess.run([*binary.compiler(), *flags, *sources], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("kind", ["control", "plant"])
def test_a_careless_importer_meets_no_undefined_behavior(made: Path, tmp_path: Path, kind: str) -> None:
    """Calls in any order and numbers of any kind under ASan and UBSan; the force stays a number all the while."""
    zipfile.ZipFile(made / f"{kind}2.fmu").extractall(tmp_path)
    driver = Path(__file__).parent.parent / "fmu_driver" / "drive2.c"
    flags = ("-std=c99", "-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    sources = sorted(map(str, (tmp_path / "sources").glob("*.c")))
    program = str(tmp_path / "program")
    words = [
        *c_bundle.compiler(),
        *flags,
        "-I",
        str(tmp_path / "sources"),
        "-o",
        program,
        str(driver),
        *sources,
        "-lm",
    ]
    subprocess.run(words, check=True)
    done = subprocess.run([program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told, broken = map(int, done.stdout.split())
    assert told > 1000
    if kind == "control":
        assert broken == 0


def test_units_have_their_base_units(made: Path) -> None:
    root = ElementTree.fromstring(zipfile.ZipFile(made / "control3.fmu").read("modelDescription.xml"))
    units = {each.get("name"): each.find("BaseUnit").attrib for each in root.find("UnitDefinitions")}
    assert units["N s/m"] == {"kg": "1", "s": "-1"}
    assert units["Hz"] == {"s": "-1", "rad": "1", "factor": "6.283185307179586"}
    assert units["1/s"] == {"s": "-1"}
    trip = root.find("TypeDefinitions/EnumerationType")
    assert [item.get("value") for item in trip][:3] == ["0", "1", "2"]


def test_the_same_machine_gives_the_same_bytes(tmp_path: Path) -> None:
    design = read_design("emps", name="x")
    one, two = (write_fmu(design, tmp_path / name, version=3).parent for name in ("one", "two"))
    assert (one / "x.fmu").read_bytes() == (two / "x.fmu").read_bytes()
    tokens = {fmpy.read_model_description(str(one / "x.fmu")).guid}
    slower = replace(design.loop, sample_time=0.5 * design.loop.sample_time)
    for changed in (design.loop, slower):
        for version in VERSIONS:
            path = tmp_path / "again.fmu"
            path.write_bytes(packed(controller_routine(changed, "x"), version, binary=False))
            tokens.add(fmpy.read_model_description(str(path)).guid)
    assert len(tokens) == 5  # another title, sample time or version is another FMU


def test_an_export_is_a_directory_that_can_be_verified(tmp_path: Path) -> None:
    readme = write_fmu(read_design("ball_screw", name="x"), tmp_path / "control", version=2)
    assert "a sample of\n  dead time" in readme.read_text()
    assert validate_fmu(str(tmp_path / "control" / "x.fmu")) == []
    verified = verify_export(tmp_path / "control", samples=2000)
    assert verified.holds
    readme = write_fmu(read_design("ball_screw", name="x", what=PLANT), tmp_path / "plant", version=3)
    assert "start_position" in readme.read_text()
    assert validate_fmu(str(tmp_path / "plant" / "x.fmu")) == []


def test_bad_input_is_named_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    design = read_design("emps", name="x", what=CONTROL)
    with pytest.raises(ParameterError, match="take 2 or 3"):
        write_fmu(design, tmp_path / "a", version=1)
    with pytest.raises(ParameterError, match="double precision"):
        write_fmu(read_design("emps", precision="float"), tmp_path / "a")
    with pytest.raises(ParameterError, match="fmu_model_x"):
        write_fmu(read_design("emps", name="fmu_model"), tmp_path / "a")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("")
    with pytest.raises(FileError, match="was not written by feeddrive"):
        write_fmu(design, tmp_path / "mine")
    monkeypatch.setattr(binary, "compiler", lambda: [sys.executable, "-c", "import sys; sys.exit('no such flag')"])
    with pytest.raises(FileError, match="no such flag"):
        write_fmu(design, tmp_path / "a")
    monkeypatch.undo()
    monkeypatch.setattr(c_bundle.shutil, "which", lambda _: None)
    monkeypatch.setattr(c_bundle.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(MissingProgramError, match="apt-get install gcc"):
        write_fmu(design, tmp_path / "a")
    assert sorted(each.name for each in tmp_path.iterdir()) == ["mine"]
    write_fmu(design, tmp_path / "sources", binary=False)  # needs no compiler
    assert "sources only" in (tmp_path / "sources" / "README.md").read_text()


def test_the_headers_are_those_of_the_standard() -> None:
    """Unchanged copies, each with its own licence (BSD, two clauses)."""
    theirs = Path(fmpy.__file__).parent / "c-code"
    ours = Path(feeddrive.__file__).parent / "export" / "fmi" / "headers"
    for header in ours.glob("*.h"):
        assert header.read_bytes() == (theirs / header.name).read_bytes()
        assert "2-Clause BSD License" in header.read_text()
