"""Exported components in a real HAL, compared bit for bit with the simulator."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from exported import LAWS
from feeddrive.export import linuxcnc_session as session
from feeddrive.export.c_code import texts
from feeddrive.export.design import read_design, trial
from feeddrive.export.layout import layout
from feeddrive.export.linuxcnc import (
    STOCK,
    check_component,
    controller_comp,
    core,
    hal,
    limits,
    pin,
    servo_period,
    write_linuxcnc,
)
from feeddrive.export.linuxcnc_session import HalError, answers, halrun
from feeddrive.language.errors import FileError, MissingProgramError, ParameterError, StructureError
from feeddrive.loop.routine import controller_routine, run
from slow_share import all_but


def _missing() -> str:
    try:
        session.check_session()
    except (MissingProgramError, HalError) as error:
        return f"NOT TESTED against LinuxCNC: {error!s}"
    return ""


needs_linuxcnc = pytest.mark.skipif(bool(_missing()), reason=_missing())
AXES = [("ball_screw", "x"), ("emps", "x"), ("mill", "z")]  # two encoders and filters; one encoder; a GPI observer
OBSERVER = "a compiler reads thousands of lines of configure of an observer"


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """Designs and directories of the axes, written once."""
    made = {}

    def get(machine, axis="x"):
        if (machine, axis) not in made:
            design = read_design(machine, axis)
            place = tmp_path_factory.mktemp("export") / machine
            made[machine, axis] = design, write_linuxcnc(design, place).parent
        return made[machine, axis]

    return get


def same_bits(a, b):
    """Equal to the last bit; all NaN are one."""
    a, b = np.ascontiguousarray(a), np.ascontiguousarray(b)
    return bool(np.all((a.view(np.uint64) == b.view(np.uint64)) | (np.isnan(a) & np.isnan(b))))


@needs_linuxcnc
@pytest.mark.parametrize(("machine", "axis"), all_but(AXES[1:2], AXES, "a compiler reads each; every law runs quickly"))
def test_controller_in_hal_has_the_simulators_bits(exported, tmp_path, machine, axis):
    """Random samples with NaN, denormals, trips and saturation, as a stream through a real halrun."""
    design, place = exported(machine, axis)
    inputs = trial(design.routine, 10_000, 7, changes=0).inputs
    for k in range(500, 10_000, 1000):
        inputs[k : k + 3, -2] = np.nan  # longer than a reading is held
    inputs[:, -1] = inputs[:, -1] > 0.5
    expected = run(design.routine, inputs)
    got = answers(design.routine, place, tmp_path, inputs).rows
    outputs = [v.name for v in design.routine.outputs]
    tripped = expected[:, outputs.index("trip")]
    assert same_bits(got, expected)
    assert np.any(tripped == 1.0), "the trial holds broken readings"
    assert 0.2 < np.mean(expected[:, outputs.index("enabled")]) < 1.0


@needs_linuxcnc
@pytest.mark.slow(reason="a million samples through halrun")
@pytest.mark.timeout(600)
def test_a_million_samples_in_hal(exported, tmp_path):
    design, place = exported("ball_screw")
    inputs = trial(design.routine, 1_000_000, 5, changes=0).inputs
    inputs[:, -1] = inputs[:, -1] > 0.5
    got = answers(design.routine, place, tmp_path, inputs, patience=500.0).rows
    assert same_bits(got, run(design.routine, inputs))


@needs_linuxcnc
@pytest.mark.parametrize("law", all_but(set(LAWS) - {"active_disturbance_rejection"}, LAWS, OBSERVER))
def test_every_law_in_hal_has_the_simulators_bits(tmp_path, law):
    """The laws of the papers, alone, with all that a guard can watch."""
    routine = controller_routine(LAWS[law], "axis_x")
    made = tmp_path / "made"
    made.mkdir()
    (made / "axis_x.comp").write_text(controller_comp(routine, law, "by a test"))
    (made / "axis_x.h").write_text(core("axis_x", texts(layout(routine), law, "by a test")))
    inputs = trial(routine, 10_000, 11, changes=0).inputs
    inputs[:, -1] = inputs[:, -1] > 0.5
    expected = run(routine, inputs)
    assert same_bits(answers(routine, made, tmp_path, inputs).rows, expected)
    assert len(np.unique(expected[:, [v.name for v in routine.outputs].index("trip")])) > 2


@needs_linuxcnc
@pytest.mark.parametrize(
    ("machine", "axis"),
    all_but(AXES[1:2], AXES, "a compiler reads a plant and a law for each; the wiring is one"),
)
def test_closed_loop_in_hal_is_the_simulation(exported, tmp_path, machine, axis):
    """Controller and axis as components, against `simulate` of the same loop: no bit differs over a whole move."""
    design, place = exported(machine, axis)
    loop, routine = design.routine.origin, design.routine
    move = fd.blocks.SnapLimitedMove(
        distance=0.02, velocity=0.1, acceleration=1.0, jerk=50.0, snap=5000.0, back=True, dwell_after=0.02
    )
    signals = ("force", "reading_motor", "reading_load", "position_motor", "position_load", "trip")
    expected = fd.simulate(loop, move, record=signals)
    time = expected.time
    given = np.column_stack([*move.at(time), np.ones(time.size)])
    c, p = hal(routine.name), hal(f"{routine.name}_plant")
    two = len(routine.inputs) == 8
    commands = ["position-cmd", "velocity-cmd", "acceleration-cmd", "jerk-cmd", "snap-cmd", "enable"]
    wiring = [
        f"loadrt {routine.name}",
        f"loadrt {routine.name}_plant",
        f"setp {c}.units-per-m 1",
        f"setp {p}.units-per-m 1",
        f"setp {c}.late-limit 0",
        f"addf {p}.read servo-thread",
        f"addf {c} servo-thread",
        f"addf {p}.write servo-thread",
        *(f"net in-{i} streamer.0.pin.{i} => {c}.{pin}" for i, pin in enumerate(commands)),
        f"net force {c}.force-cmd => {p}.force sampler.0.pin.0",
        f"net motor {p}.motor-position-fb => sampler.0.pin.1",
        f"net load {p}.load-position-fb => sampler.0.pin.2 {c}.{'load-position-fb' if two else 'position-fb'}",
        *([f"net motor => {c}.motor-position-fb"] if two else []),
        f"net true-motor {p}.motor-position => sampler.0.pin.3",
        f"net true-load {p}.load-position => sampler.0.pin.4",
        f"net trip {c}.trip-code => sampler.0.pin.5",
    ]
    components = [place / f"{routine.name}.comp", place / f"{routine.name}_plant.comp"]
    got = halrun(components, tmp_path, servo_period(routine), wiring, given, "fffffb", "fffffs").rows
    assert same_bits(got, np.column_stack([expected[each] for each in signals]))
    assert np.max(np.abs(expected["position_load"])) > 0.019


@needs_linuxcnc
def test_lengths_in_mm_are_divided_once(exported, tmp_path):
    """In a machine in mm the law gets pin / 1000: the bits of the simulator on that number."""
    design, place = exported("emps")
    routine = design.routine
    inputs = trial(routine, 4000, 3, changes=0, broken=0.0).inputs
    inputs[:, -1] = inputs[:, -1] > 0.5
    got = answers(routine, place, tmp_path, inputs, units_per_m=1000.0).rows
    rounded = inputs.copy()
    rounded[:, :-1] = inputs[:, :-1] * 1000.0 / 1000.0
    assert same_bits(got, run(routine, rounded))
    assert np.any(rounded != inputs), "the trial tells a division from none"


# until ten samples have passed, and not for a time: a busy computer may run none in it
PASSED = (
    'python3 -c \'import subprocess; n = lambda: int(subprocess.getoutput("halcmd -s getp sampler.0.sample-num")); '
    "begun = n(); next(k for k in iter(n, None) if k > begun + 10)'"
)


def between(command):
    """Run for some samples, and do something between two of them: the thread stands still, however long it takes."""
    return [f"loadusr -w {PASSED}", "stop", command, "start"]


@needs_linuxcnc
def test_parameters_change_while_it_runs(exported, tmp_path):
    """`setp` acts at a sample as `retune`; the recorded count of changes tells at which."""
    design, place = exported("ball_screw")
    routine = design.routine
    T = routine.sample_time
    count = 40_000
    time = np.arange(count) * T
    inputs = np.zeros((count, len(routine.inputs)))
    inputs[:, 0], inputs[:, 1] = 1e-3 * np.sin(20.0 * time), 0.02 * np.cos(20.0 * time)
    inputs[:, 5] = inputs[:, 6] = inputs[:, 0] - 2e-5 * np.sin(35.0 * time)
    inputs[:, -1] = 1.0
    changes = [
        ("axis.x.control.law.Kv", 80.0),
        ("axis.x.control.law.Tn", 0.01),
        ("axis.x.control.filters.0.frequency", 400.0),
        ("axis.x.control.force_limit", 300.0),
    ]
    path = {name: name.removeprefix("axis.x.control.").replace("_", "-") for name, _ in changes}
    meanwhile = [line for name, value in changes for line in between(f"setp axis-x.{path[name]} {value}")]
    # out of bounds: does not act, and does not count
    meanwhile += between("setp axis-x.law.Kv -1") + between("setp axis-x.law.Kv 80")
    got = answers(
        routine,
        place,
        tmp_path,
        inputs,
        paced=True,
        meanwhile=meanwhile,
        more=[("retunes", "u"), ("parameter-bad", "b"), ("parameter-rule", "s")],
    ).rows
    outputs, retunes, bad, rule = got[:, :-3], got[:, -3], got[:, -2], got[:, -1]
    assert {int(code) for code in rule[bad == 1.0]} == {1}
    assert routine.sentences[1].startswith("law_Kv")
    places = np.flatnonzero(np.diff(retunes)) + 1
    assert len(places) == len(changes), "each change acted at a sample of its own"
    assert np.any(bad == 1.0)
    assert bad[-1] == 0.0
    by_sample = {int(k): {name: value} for k, (name, value) in zip(places, changes, strict=True)}
    assert same_bits(outputs, run(routine, inputs, by_sample))
    assert np.max(np.abs(outputs[places[-1] :, 0])) <= 300.0


@needs_linuxcnc
def test_changes_that_wait_act_together(exported, tmp_path):
    """With `hold-parameters` two changes act at one sample, when it goes off."""
    design, place = exported("emps")
    routine = design.routine
    count = 2000
    inputs = np.zeros((count, len(routine.inputs)))
    inputs[:, 0] = 1e-4
    inputs[:, -1] = 1.0
    meanwhile = between("setp axis-x.hold-parameters 1")
    meanwhile += between("setp axis-x.law.Kv 9") + between("setp axis-x.law.Kp 900")
    meanwhile += between("setp axis-x.hold-parameters 0")
    got = answers(routine, place, tmp_path, inputs, paced=True, meanwhile=meanwhile, more=[("retunes", "u")]).rows
    (at,) = np.flatnonzero(np.diff(got[:, -1])) + 1
    expected = run(routine, inputs, {int(at): {"axis.x.control.law.Kv": 9.0, "axis.x.control.law.Kp": 900.0}})
    assert same_bits(got[:, :-1], expected)


@needs_linuxcnc
def test_broken_reading_holds_trips_and_stays_faulted(exported, tmp_path):
    """NaN on the reading: held for one sample, then tripped; enable off and on clears it."""
    design, place = exported("emps")
    routine = design.routine
    columns = {v.name: i for i, v in enumerate(routine.inputs)}
    inputs = np.zeros((400, len(routine.inputs)))
    inputs[:, columns["set_position"]] = 1e-4
    inputs[:, columns["enable"]] = 1.0
    inputs[50, columns["reading"]] = np.nan  # one sample: held
    inputs[100:103, columns["reading"]] = np.nan  # three: a trip
    inputs[200:220, columns["enable"]] = 0.0
    inputs[300, columns["reading"]] = np.inf
    inputs[301, columns["reading"]] = np.nan
    more = [("fault", "b"), ("fault-code", "s"), ("ok", "b"), ("heartbeat", "b")]
    got = answers(routine, place, tmp_path, inputs, more=more).rows
    expected = run(routine, inputs)
    width = expected.shape[1]
    assert same_bits(got[:, :width], expected)
    names_ = [v.name for v in routine.outputs]
    force, trip, on = (got[:, names_.index(each)] for each in ("force", "trip", "enabled"))
    fault, code, ok, beat = (got[:, width + i] for i in range(4))
    assert force[50] == force[49] != 0.0
    assert on[50] == 1.0
    assert trip[101] == 1.0
    assert on[101] == 0.0
    assert force[101] == 0.0
    assert np.all(fault[101:220] == 1.0), "a fault outlasts the enable that it took away"
    assert np.all(code[101:220] == 1.0)
    assert np.all(fault[220:300] == 0.0)
    assert np.all(on[220:300] == 1.0)
    assert code[301] == 1.0
    assert np.all(ok == 1.0 - fault)
    assert np.all(np.diff(beat[:101]) != 0.0), "the heart beats"
    assert np.all(np.diff(beat[101:220]) == 0.0), "and stops with the fault"


@needs_linuxcnc
def test_reset_clears_a_fault_only_while_enable_is_off(exported, tmp_path):
    design, place = exported("emps")
    routine = design.routine
    inputs = np.zeros((300, len(routine.inputs)))
    inputs[:, -1] = 1.0
    inputs[10:20, -2] = np.nan
    inputs[200:, -1] = 0.0
    reset = np.zeros(300)
    reset[50:60] = reset[195:205] = reset[250:260] = 1.0
    got = answers(routine, place, tmp_path, inputs, also={"reset": reset}, more=[("fault", "b")]).rows
    fault = got[:, -1]
    assert np.all(fault[11:250] == 1.0), "neither a reset under enable clears it, nor one that was held down since"
    assert np.all(fault[250:] == 0.0)
    assert same_bits(got[:, :-1], run(routine, inputs)), "the law does not see it"


@needs_linuxcnc
def test_a_thread_of_another_period_is_a_fault(exported, tmp_path):
    """The law is made for 1 ms: at 1.002 ms it does not run, at 1.0005 ms it does."""
    design, place = exported("emps")
    routine = design.routine
    assert servo_period(routine) == 1_000_000
    inputs = np.zeros((50, len(routine.inputs)))
    inputs[:, 0], inputs[:, -1] = 1e-4, 1.0
    for period, code in ((1_002_000, 11.0), (1_000_500, 0.0)):
        folder = tmp_path / str(period)
        folder.mkdir()
        got = answers(routine, place, folder, inputs, period=period, more=[("fault-code", "s")]).rows
        assert np.all(got[:, -1] == code)
        assert np.all((got[:, 0] != 0.0) == (code == 0.0))


@needs_linuxcnc
def test_a_late_call_is_a_fault(exported, tmp_path):
    """With a limit below the period every paced call is late."""
    design, place = exported("emps")
    inputs = np.zeros((50, len(design.routine.inputs)))
    inputs[:, -1] = 1.0
    got = answers(
        design.routine,
        place,
        tmp_path,
        inputs,
        paced=True,
        setup=["setp axis-x.late-limit 100000"],
        more=[("fault-code", "s")],
    ).rows
    code = got[:, -1]
    assert code[0] == 0.0, "nothing was called before the first call"
    assert code[-1] == 12.0
    assert np.all(np.diff(code) >= 0.0), "it is latched"
    assert np.all(got[code == 12.0, 0] == 0.0)


@needs_linuxcnc
@pytest.mark.parametrize(
    "setting",
    all_but(
        ["law.Kv nan", "units-per-m -1000"],
        ["law.Kv nan", "law.Kv 0", "units-per-m -1000", "guard.hold-samples inf"],
        "a HAL session for each; C has a test of each rule",
    ),
)
def test_bad_parameters_at_enable_are_a_fault(exported, tmp_path, setting):
    design, place = exported("emps")
    inputs = np.zeros((50, len(design.routine.inputs)))
    inputs[:, 0], inputs[:, -1] = 1e-4, 1.0
    got = answers(
        design.routine,
        place,
        tmp_path,
        inputs,
        setup=[f"setp axis-x.{setting}"],
        more=[("fault-code", "s"), ("parameter-bad", "b")],
    ).rows
    assert np.all(got[:, -2:] == [13.0, 1.0])
    assert np.all(got[:, 0] == 0.0)


def test_directory_says_all(exported):
    """Every pin and parameter stands in the README; the planner's commands and the trips are wired."""
    design, place = exported("ball_screw")
    files = {each.name for each in place.iterdir()} - {".feeddrive"}
    assert files == {
        "export.json",
        "machine.toml",
        "axis_x.comp",
        "axis_x.h",
        "axis_x.hal",
        "axis_x.ini",
        "axis_x_plant.comp",
        "axis_x_plant.h",
        "desk.hal",
        "desk.ini",
        "README.md",
    }
    comp, readme = (place / "axis_x.comp").read_text(), (place / "README.md").read_text()
    assert comp.isascii(), "halcompile reads it in the locale of its user"
    declared = [line.split()[3] for line in comp.splitlines() if line.startswith(("pin ", "param "))]
    assert len(declared) > 30
    for name in declared:
        assert f"`{name}`" in readme
    for variable in design.routine.parameters:
        short = variable.path.removeprefix("axis.x.").removeprefix("control.").removeprefix("actuator.")
        assert short.replace("_", "-") in declared
    wiring = (place / "axis_x.hal").read_text()
    for each in (
        "joint.0.motor-pos-cmd",
        "joint.0.vel-cmd",
        "joint.0.acc-cmd",
        "joint.0.amp-enable-out",
        "joint.0.amp-fault-in",
        "joint.0.motor-pos-fb",
    ):
        assert each in wiring
    assert "emergency stop" in readme
    assert "uncoupled" in readme
    assert f"SERVO_PERIOD = {servo_period(design.routine)}" in readme


def test_writing_twice_gives_the_same_bytes(exported, tmp_path):
    design, place = exported("ball_screw")
    again = write_linuxcnc(design, tmp_path / "again").parent
    for file in place.iterdir():
        assert file.read_bytes() == (again / file.name).read_bytes(), file.name


@needs_linuxcnc
@pytest.mark.parametrize(
    ("machine", "axis"),
    all_but([("xy_table", "y")], [("ball_screw", "x"), ("xy_table", "y")], "the same wiring, of a larger component"),
)
def test_wiring_is_taken_by_the_real_motion_module(tmp_path, machine, axis):
    """`desk.hal` with motmod in place: every line is taken, those in comments that set parameters as well."""
    design = read_design(machine, axis)
    name = design.name
    write_linuxcnc(design, tmp_path / "made")
    place = tmp_path / "made"
    for file in place.glob("*.hal"):
        (tmp_path / file.name).write_text(file.read_text().replace("#   setp", "setp"))
    values = {
        "[KINS]KINEMATICS": f"trivkins coordinates={'XY'[: 'xy'.index(axis) + 1]}",
        "[EMCMOT]EMCMOT": "motmod",
        "[EMCMOT]SERVO_PERIOD": str(servo_period(design.routine)),
        "[KINS]JOINTS": str("xy".index(axis) + 1),
    }
    desk = (tmp_path / "desk.hal").read_text()
    for key, value in values.items():
        desk = desk.replace(key, value)
    lines = [line for line in desk.splitlines() if "iocontrol" not in line]  # that belongs to a program of its own
    (tmp_path / "desk.hal").write_text("\n".join(["loadrt tpmod", "loadrt homemod", *lines, "start", "show funct", ""]))
    components = [place / f"{name}.comp", place / f"{name}_plant.comp"]
    printed = session.session(tmp_path, components, "halrun -f desk.hal")
    order = [line.split()[-1] for line in printed.splitlines() if line.split()[-1:] and "servo" not in line]
    assert f"{hal(name)}" in order
    shown = [line for line in printed.splitlines() if "setp" in line or "error" in line.lower()]
    assert not shown, printed


@needs_linuxcnc
def test_no_processor_contracts_a_product_and_a_sum(exported, tmp_path):
    """Compiled for a processor with fused multiply-adds and LinuxCNC's flags, the law has none."""
    if platform.machine() != "x86_64":
        pytest.skip("-mfma is an option of x86")
    _, place = exported("ball_screw")
    header = (place / "axis_x.h").read_text()
    found = []
    for text in (header, header.replace("#pragma GCC optimize", "// ")):
        (tmp_path / "law.c").write_text(
            text + "\nvoid (*const kept)(axis_x_controller *, const axis_x_inputs *, axis_x_outputs *) = axis_x_step;\n"
        )
        subprocess.run(["gcc", "-Os", "-mfma", "-S", "law.c"], cwd=tmp_path, check=True)
        found.append(len(re.findall(r"vfn?m(?:add|sub)", (tmp_path / "law.s").read_text())))
    assert found[0] == 0
    assert found[1] > 0, "without the line there are some"


def test_limits_of_the_ini_leave_a_margin():
    """A move at the limits of the .ini uses at most 70 % of force and following error, and half of FERROR."""
    loop = read_design("ball_screw").loop
    found = limits(loop)
    assert found.peak_force <= 0.7 * 9000.0
    assert found.peak_error <= 0.7 * 1e-3
    assert found.following_error >= 2.0 * found.peak_error
    slow = replace(loop, control=replace(loop.control, guard=fd.Guard(following_error_limit=1e-9)))
    with pytest.raises(ParameterError, match="cannot be moved"):
        limits(slow)


def test_another_joint_has_its_own_desk(tmp_path):
    design = read_design("xy_table", "y")
    place = write_linuxcnc(design, tmp_path / "y").parent
    assert "joint.1.motor-pos-cmd" in (place / "axis_y.hal").read_text()
    desk = (place / "desk.ini").read_text()
    assert "coordinates=XY" in desk
    assert "JOINTS = 2" in desk
    assert "[JOINT_1]" in (place / "axis_y.ini").read_text()
    with pytest.raises(ParameterError, match="joint = 9 must be from 0 to 8"):
        write_linuxcnc(design, tmp_path / "no", joint=9)
    assert not (tmp_path / "no").exists()


def test_names_that_hal_cannot_have(tmp_path):
    for name, reason in (("pid", "replace"), ("halui", "replace"), (f"axis_{'x' * 40}", "47")):
        design = read_design("emps", name=name)
        with pytest.raises(ParameterError, match=reason):
            write_linuxcnc(design, tmp_path / name)
        assert not (tmp_path / name).exists()
    item = pin("a-b", "bit", "in", "")
    with pytest.raises(StructureError, match="one name"):
        check_component("axis_x", (), [item, pin("a.b", "bit", "in", "")])


@needs_linuxcnc
def test_stock_components_are_known():
    """The list holds what the installed LinuxCNC brings; a name of them would be replaced."""
    installed = {each.stem for each in Path(session.MODULES).glob("*.so")}
    assert {"pid", "motmod", "streamer"} <= STOCK
    assert len(installed & STOCK) > 100
    assert "axis_x" not in STOCK


@pytest.mark.parametrize(
    ("sample_time", "reason"), [(1.0 / 3e3, "whole number of nanoseconds"), (5e-6, "0.01 ms"), (0.2, "100 ms")]
)
def test_sample_times_that_no_thread_has(sample_time, reason):
    design = read_design("emps")
    routine = replace(design.routine, origin=_timed(design.routine.origin, sample_time))
    with pytest.raises(ParameterError, match=reason):
        servo_period(routine)


def _timed(loop, sample_time):
    """The loop at another sample time, unchecked."""
    from feeddrive.language import tree

    return tree.rebuild(loop, (sample_time if name == "sample_time" else v for name, v in tree.leaves(loop)))


def test_single_precision_and_a_taken_place_are_refused(tmp_path):
    with pytest.raises(ParameterError, match="double precision"):
        write_linuxcnc(read_design("emps", precision="float"), tmp_path / "x")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "diary.txt").write_text("dear diary")
    with pytest.raises(FileError, match="was not written by feeddrive"):
        write_linuxcnc(read_design("emps"), tmp_path / "mine")
    assert [each.name for each in (tmp_path / "mine").iterdir()] == ["diary.txt"]


def test_missing_programs_are_named(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None if name in ("halrun", "halcompile") else name)
    with pytest.raises(MissingProgramError, match="apt-get install linuxcnc-uspace linuxcnc-uspace-dev"):
        session.check_programs()


@needs_linuxcnc
def test_a_machine_without_namespaces_is_named(monkeypatch):
    monkeypatch.setattr(session, "MODULES", "/no/such/folder")
    with pytest.raises(HalError, match=r"cannot be run apart .*/no/such/folder.* Run it as root"):
        session.check_session()


@needs_linuxcnc
def test_what_halcompile_refuses_is_said(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "broken.comp").write_text(
        'component broken "";\npin in bit a;\nfunction _;\nlicense "MIT";\n;;\nthis is no C\n'
    )
    with pytest.raises(HalError, match="broken"):
        session.session(tmp_path, [tmp_path / "a" / "broken.comp"], "halrun -f nothing.hal")


@pytest.mark.slow(reason="it waits until a session has hung long enough")
@needs_linuxcnc
def test_a_session_that_hangs_is_killed(tmp_path):
    with pytest.raises(HalError, match="did not end within 2 s"):
        session.session(tmp_path, [], "sleep 60", 2.0)


@pytest.mark.slow(reason="it waits until two sessions have hung long enough")
@needs_linuxcnc
@pytest.mark.parametrize("hangs", ["after the run", "in the run"])
def test_a_run_is_good_if_linuxcnc_hangs_as_it_exits(hangs, tmp_path, monkeypatch):
    line = session.run_line
    rows = np.arange(6.0).reshape(6, 1)
    wiring = [f"net passed {session.stream_pin(0)} => sampler.0.pin.0"]
    at_end = ["loadusr -w /bin/sleep 60"] if hangs == "in the run" else []
    if hangs == "after the run":
        monkeypatch.setattr(session, "run_line", lambda folder, *, paced: f"{line(folder, paced=paced)}; sleep 60")
    # 15 s: a session takes 0.6 s on a free machine
    asked = partial(session.halrun, [], tmp_path, 1_000_000, wiring, rows, "f", "f", at_end=at_end, patience=15.0)
    if hangs == "in the run":
        with pytest.raises(session.HalTimeoutError, match="did not end within 15 s"):
            asked()
    else:
        run = asked()
        np.testing.assert_array_equal(run.rows, rows)
        assert "complete" not in run.printed
