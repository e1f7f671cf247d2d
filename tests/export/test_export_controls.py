"""The controls of several axes with the contour control between them, exported as one."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import iec_compiler
import numpy as np
import pytest
import structured_text_machine

from feeddrive.blocks.compensation.pitch_compensation import PitchCompensation
from feeddrive.blocks.coupling.cross_beam import CrossBeam
from feeddrive.blocks.coupling.cross_coupled import CrossCoupled
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.circle import Circle
from feeddrive.export import linuxcnc_session as session
from feeddrive.export.design import Trial, read_design, trial
from feeddrive.export.fmu import answers, model_header, variables
from feeddrive.export.layout import layout
from feeddrive.export.linuxcnc import (
    Limits,
    axis_hal,
    axis_ini,
    controller_comp,
    desk_ini,
    input_pin,
    joints,
    limits,
    servo_period,
)
from feeddrive.export.linuxcnc_session import halrun, stream_pin
from feeddrive.export.structured_text import check, check_parts, program
from feeddrive.export.targets import write_all, write_export
from feeddrive.export.verify import verify_export
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.loop import SETPOINT, quantity
from feeddrive.loop.machine import Machine
from feeddrive.loop.routine import ControllerRun, Routine, controller_routine
from feeddrive.loop.simulate import Run, simulate
from hal_programs import needs_linuxcnc

HAS_GCC = pytest.mark.skipif(
    shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc"
)
PATH = {"x": Circle(radius=0.02, feed=0.1, turns=0.5, phase=0), "y": Circle(radius=0.02, feed=0.1, turns=0.5, phase=90)}


def crossed(gain: float = 60.0) -> Machine:
    """The bundled table under cross-coupled control, with pitch errors of x taken out."""
    machine = read_machine("xy_table").machine(CrossCoupled(contour_axes=("x", "y"), contour_gain=gain))
    pitch = PitchCompensation(
        forward=np.array([0.0, 4e-6, 6e-6]), backward=np.array([-3e-6, 1e-6, 4e-6]), table_start=-0.03, spacing=0.03
    )
    x = machine.loop("x")
    return machine.with_loops({"x": replace(x, control=replace(x.control, compensation=(pitch,)))})


def written(place: Path, machine: Machine) -> Path:
    path = place / "table.toml"
    path.write_text(machine_toml(machine, "table"), encoding="utf-8")
    return path


@HAS_GCC
def test_c_has_the_simulators_bits(tmp_path: Path) -> None:
    """Without --axis the controls are one, since something runs between them; live changes, trips and NaN included."""
    ((design, _),) = write_all(written(tmp_path, crossed()), "c", tmp_path / "out")
    assert (design.name, design.axis) == ("axes", "x, y")
    assert "couplings.0.contour_gain" in [each.path for each in design.routine.parameters]
    found = verify_export(tmp_path / "out", samples=5_000)
    assert found.holds
    assert found.trips > 10
    assert found.changes > 10


def test_the_routine_is_the_run_of_the_machine() -> None:
    """Fed with setpoints and readings of a run, its forces are those of the run, bit for bit, after a change too."""
    machine = crossed()
    run = simulate(machine, PATH, changes={3000: {"couplings.0.contour_gain": 90.0}})
    without = simulate(crossed(0.0), PATH)
    assert np.max(np.abs(run["y.force"] - without["y.force"])) > 1.0  # N: the coupling acts
    routine = controller_routine(machine, "axes")
    rows = {
        f"{axis}.{name}": row
        for axis, each in PATH.items()
        for name, row in zip(SETPOINT, each.at(run.time), strict=True)
    }
    for axis in PATH:
        rows |= {f"{axis}.reading": run[f"{axis}.reading_load"], f"{axis}.enable": np.ones(run.samples)}
    given = np.column_stack([rows[each.path] for each in routine.inputs])
    before = given[0].copy()  # a run begins one sample before, at rest
    controls = ControllerRun(routine, before)
    first = controls.step(given[:3000])
    controls.retune({"couplings.0.contour_gain": 90.0})
    force = np.vstack([first, controls.step(given[3000:])])
    names = [each.path for each in routine.outputs]
    for axis in PATH:
        assert np.array_equal(force[:, names.index(f"{axis}.force")], run[f"{axis}.force"])


def test_what_cannot_be_one_is_refused(tmp_path: Path) -> None:
    source = written(tmp_path, crossed())
    with pytest.raises(ParameterError, match="leave out --axis"):
        write_export(source, "c", tmp_path / "out", axis="x")
    with pytest.raises(ParameterError, match="can be exported to c, linuxcnc, fmu2, fmu3, cortex-m, st"):
        write_all(source, "linuxcnc-pid", tmp_path / "out")
    with pytest.raises(ParameterError, match="leave out --axis and --plant"):
        write_export("xy_table", "c", tmp_path / "out", axis="x", together=True)
    unguarded = source.read_text().replace("[axis.y.control.guard]", "[axis.y.control.nothing]")
    assert unguarded != source.read_text()
    source.write_text(unguarded.replace("\n[axis.y.control.nothing]", "\n[unused]"))
    with pytest.raises((StructureError, ParameterError)):
        write_all(source, "c", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_coupling_of_the_physics_has_no_part_in_a_live_change_of_the_controls() -> None:
    """It is absent among the couplings of the controls, which once ended the check of a change with a TypeError."""
    routine = controller_routine(read_machine("gantry").machine(), "axes")
    tried = trial(routine, 200, 1, changes=4)
    assert len(tried.changes) == 4
    assert not any("couplings" in variable.path for variable in routine.parameters)


def test_controls_without_a_coupling_are_one_if_asked(tmp_path: Path) -> None:
    ((design, readme),) = write_all("xy_table", "c", tmp_path / "out", together=True)
    assert design.title.startswith("Controls of the axes x, y")
    assert "x_force" in readme.read_text()


def sampled(machine: Machine, run: Run) -> tuple[Routine, np.ndarray]:
    """The routine of all controls, and what they are given along a run of the machine."""
    routine = controller_routine(machine, "axes")
    rows = {
        f"{axis}.{name}": row
        for axis, each in PATH.items()
        for name, row in zip(SETPOINT, each.at(run.time), strict=True)
    }
    for axis in PATH:
        rows |= {f"{axis}.reading": run[f"{axis}.reading_load"], f"{axis}.enable": np.ones(run.samples)}
    return routine, np.column_stack([rows[each.path] for each in routine.inputs])


def same(found: np.ndarray, run: Run, routine: Routine) -> bool:
    """Whether outputs have the bits of the forces of a run."""
    names = [each.path for each in routine.outputs]
    return all(np.array_equal(found[:, names.index(f"{axis}.force")], run[f"{axis}.force"]) for axis in PATH)


def test_structured_text_of_all_controls_is_the_run_of_the_machine() -> None:
    """By the interpreter of the tests: the forces of a run under cross-coupled control; and the check block passes."""
    machine = crossed()
    run = simulate(machine, PATH, duration=0.06)
    routine, given = sampled(machine, run)
    planned = layout(routine)
    text = program(planned, "under test")
    checking = "\n".join(part.text() for part in check_parts(text, check(planned, text)))
    blocks = structured_text_machine.program(f"{text.text()}\n{checking}").blocks
    block = blocks["axes"].instance()
    found = np.empty((len(given), len(routine.outputs)))
    for k, row in enumerate(given):
        values = {v.name: x > 0.5 if v.name.endswith("enable") else x for v, x in zip(routine.inputs, row, strict=True)}
        answer = block.call(**values)
        found[k] = [float(getattr(answer, v.name)) for v in routine.outputs]
    assert same(found, run, routine)
    assert np.ptp(run["x.force"]) > 5.0
    tried = blocks["axes_check"].instance()
    while not tried.call().done:
        pass
    assert (tried.s.wrong, tried.s.first_wrong) == (0, -1)


@pytest.mark.slow(reason="300,000 samples of two axes, compiled by matiec and gcc")
@pytest.mark.parametrize("name", ["crossed", "gantry"])
def test_a_real_compiler_makes_of_the_text_of_all_controls_what_the_c_computes(name: str, tmp_path: Path) -> None:
    machine = crossed() if name == "crossed" else read_machine(name).machine()
    planned = layout(controller_routine(machine, "axes"))
    iec_compiler.agree(planned, program(planned, "under test"), 300_000, 6, tmp_path)


@HAS_GCC
@pytest.mark.slow(reason="two interfaces and two machines, compiled with optimization")
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["crossed", "gantry"])
def test_an_fmu_of_all_controls_has_the_simulators_bits(name: str, version: int, tmp_path: Path) -> None:
    """In FMPy: random samples with trips, broken numbers and live changes, and the run of the machine."""
    pytest.importorskip("fmpy", reason="NOT TESTED: pip install fmpy")
    machine = crossed() if name == "crossed" else read_machine(name).machine()
    source = written(tmp_path, machine)
    write_export(source, f"fmu{version}", tmp_path / "out", together=True)
    found = verify_export(tmp_path / "out", samples=10_000)
    assert found.holds
    assert min(found.trips, found.changes) > 10
    run = simulate(machine, PATH)
    routine, given = sampled(machine, run)
    assert same(answers(tmp_path / "out" / "axes.fmu", routine, Trial(given, {})), run, routine)


def test_an_fmu_of_all_controls_says_which_axis_tripped() -> None:
    """Its messages name the axis, and before the first step all loops are off."""
    routine = controller_routine(read_machine("gantry").machine(), "axes")
    text = model_header(routine, "", variables(routine))
    assert '"axis x: ", "axis y: "' in text
    assert "off.x_enable = 0.0;\n    off.y_enable = 0.0;" in text
    kinds = {v.name: v.kind for v in variables(routine)}
    assert [kinds[name] for name in ("x_enable", "y_trip", "y_enabled")] == ["truth", "enumeration", "truth"]


@needs_linuxcnc
@pytest.mark.slow(reason="controls and plants of two machines, compiled and run in halrun")
@pytest.mark.parametrize("name", ["crossed", "gantry"])
def test_all_controls_and_axes_in_hal_are_the_simulation(name: str, tmp_path: Path) -> None:
    """The component of the controls and that of the coupled axes, as on the desk, against `simulate`, bit for bit."""
    machine = crossed() if name == "crossed" else read_machine(name).machine()
    place = write_export(written(tmp_path, machine), "linuxcnc", tmp_path / "out", together=True)[1].parent
    found = verify_export(place, samples=10_000)
    assert found.holds
    assert found.trips > 10
    run = simulate(machine, PATH)
    routine, given = sampled(machine, run)
    commands = [i for i, v in enumerate(routine.inputs) if quantity(v.path) != "reading"]
    pins = [input_pin(routine.inputs[i].path) for i in commands]
    kinds = "".join("b" if pin.endswith("enable") else "f" for pin in pins)
    wiring = [
        "loadrt axes",
        "loadrt axes_plant",
        "setp axes.units-per-m 1",
        "setp axes-plant.units-per-m 1",
        "setp axes.late-limit 0",
        *(
            f"setp axes-plant.{axis}.start-position {float(each.at(np.zeros(1))[0][0])!r}"
            for axis, each in PATH.items()
        ),
        "addf axes-plant.read servo-thread",
        "addf axes servo-thread",
        "addf axes-plant.write servo-thread",
        *(f"net in-{i} {stream_pin(i)} => axes.{pin}" for i, pin in enumerate(pins)),
    ]
    for i, axis in enumerate(PATH):
        wiring += [
            f"net {axis}-force axes.{axis}.force-cmd => axes-plant.{axis}.force sampler.0.pin.{2 * i}",
            f"net {axis}-load axes-plant.{axis}.load-position-fb => axes.{axis}.position-fb sampler.0.pin.{2 * i + 1}",
        ]
    components = [place / "axes.comp", place / "axes_plant.comp"]
    folder = tmp_path / "hal"
    folder.mkdir()
    got = halrun(components, folder, servo_period(routine), wiring, given[:, commands], kinds, "ffff").rows
    for i, signal in enumerate(("x.force", "x.reading_load", "y.force", "y.reading_load")):
        assert np.array_equal(got[:, i], run[signal]), signal


def portal() -> Machine:
    """The bundled gantry with a second drive for its beam; both axes shake its frame."""
    file = read_machine("gantry")
    y = file.loops["y"]
    half = replace(y, axis=replace(y.axis, plant=Rigid(mass=110.0)))
    law = replace(half.control.law, Kp=33_000.0)  # type: ignore[type-var]
    y, y2 = (replace(half, control=replace(half.control, law=each)) for each in (law, replace(law, Kp=25_000.0)))
    beam = CrossBeam(axis="y", follower="y2", stiffness=4e7, damping=3000.0)
    return Machine.of({"x": file.loops["x"], "y": y, "y2": y2}, (*file.couplings, beam))


def test_two_drives_of_a_beam_have_one_letter_in_linuxcnc(tmp_path: Path) -> None:
    """trivkins takes a letter twice; the axis of the letter has one section, each joint its own."""
    design = read_design(written(tmp_path, portal()), name="axes", together=True)
    wired = joints(design, 1)
    desk, hal = desk_ini(design.routine, wired), axis_hal(design.routine, wired, design.title, "by a test")
    assert "KINEMATICS = trivkins coordinates=ZXYY kinstype=BOTH\nJOINTS = 4" in desk
    limit = Limits(0.5, 2.5, 5e-4, -0.5, 0.5, 2e-4, 900.0, True)
    ini = axis_ini(design.routine, wired, dict.fromkeys(("x", "y", "y2"), limit), design.title, "by a test")
    assert ini.count("[AXIS_Y]") == 1
    assert [f"[JOINT_{i}]" in ini for i in range(5)] == [False, True, True, True, False]
    for line in (
        "net axes-y2-position-cmd joint.3.motor-pos-cmd => axes.y2.position-cmd",
        "net axes-y2-fault axes.y2.fault => joint.3.amp-fault-in",
    ):
        assert line in hal
    with pytest.raises(ParameterError, match="joint = 7 must be from 0 to 6"):
        joints(design, 7)


def test_a_component_of_all_controls_has_the_pins_of_each_axis_and_common_ones() -> None:
    """Parameters of an axis begin with it, those of a coupling do not; a fault of one axis takes `ok` away."""
    routine = controller_routine(crossed(), "axes")
    comp = controller_comp(routine, "under test", "by a test")
    declared = [line.split()[3] for line in comp.splitlines() if line.startswith(("pin ", "param "))]
    assert {"x.position-cmd", "y.enable", "x.force-cmd", "y.fault-code", "x.law.Kv", "couplings.0.contour-gain"} <= set(
        declared
    )
    assert [declared.count(name) for name in ("ok", "reset", "heartbeat", "parameter-rule")] == [1, 1, 1, 1]
    assert "enum { AXES = 2 };" in comp
    assert "fine = fine && fault_now[1] == 0;" in comp


@pytest.mark.slow(reason="a coupled machine of three axes is simulated until a move fits")
def test_both_drives_of_a_beam_make_the_move_from_which_the_limits_come(tmp_path: Path) -> None:
    place = write_export(written(tmp_path, portal()), "linuxcnc", tmp_path / "out", together=True)[1].parent
    ini = (place / "axes.ini").read_text()
    fastest = [line for line in ini.splitlines() if line.startswith("MAX_VELOCITY")]
    assert fastest[2] == fastest[3] == fastest[4], "axis and joints of the letter Y"
    bounds = limits(portal(), ["y", "y2"])
    assert bounds.peak_error < 0.7e-3
    assert limits(portal(), ["y"]).velocity < bounds.velocity, "one drive alone works against the beam"


@needs_linuxcnc
@pytest.mark.slow(reason="components of three axes are compiled")
def test_the_desk_of_a_gantry_is_taken_by_the_real_motion_module(tmp_path: Path) -> None:
    """Every line of `desk.hal` and `axes.hal`, with those in comments that set parameters; three drives' bits too."""
    write_export(written(tmp_path, portal()), "linuxcnc", tmp_path / "out", together=True)
    assert verify_export(tmp_path / "out", samples=5_000).holds, "21 inputs take two streamers"
    folder = tmp_path / "hal"
    folder.mkdir()
    for file in (tmp_path / "out").glob("*.hal"):
        (folder / file.name).write_text(file.read_text().replace("#   setp", "setp"))
    values = {
        "[KINS]KINEMATICS": "trivkins coordinates=XYY kinstype=BOTH",
        "[EMCMOT]EMCMOT": "motmod",
        "[EMCMOT]SERVO_PERIOD": "250000",
        "[KINS]JOINTS": "3",
    }
    desk = (folder / "desk.hal").read_text()
    for key, value in values.items():
        desk = desk.replace(key, value)
    lines = [line for line in desk.splitlines() if "iocontrol" not in line]  # that belongs to a program of its own
    (folder / "desk.hal").write_text("\n".join(["loadrt tpmod", "loadrt homemod", *lines, "start", "show funct", ""]))
    components = [tmp_path / "out" / "axes.comp", tmp_path / "out" / "axes_plant.comp"]
    printed = session.session(folder, components, "halrun -f desk.hal")
    assert "axes-plant.write" in printed
    assert not [line for line in printed.splitlines() if "setp" in line or "error" in line.lower()], printed
