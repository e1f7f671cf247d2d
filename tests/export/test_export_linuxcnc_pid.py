"""The target linuxcnc-pid: its fragments in a real HAL around the axis, bit for bit as simulated."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove
from feeddrive.export.c_code import texts
from feeddrive.export.design import Design, read_design
from feeddrive.export.drive_quantities import Cascade, read_cascade
from feeddrive.export.layout import layout
from feeddrive.export.linuxcnc import core, plant_comp
from feeddrive.export.linuxcnc_pid import (
    ROUTES,
    difference,
    moves,
    require_stable_pids,
    stock_law,
    stock_loop,
    write_linuxcnc_pid,
)
from feeddrive.export.linuxcnc_session import halrun, session
from feeddrive.language.errors import FileError, ParameterError, StructureError, UnstableError
from feeddrive.loop.linearize import loop_gain
from feeddrive.loop.loop import Loop
from feeddrive.loop.routine import plant_routine
from feeddrive.loop.simulate import simulate
from hal_programs import needs_linuxcnc
from slow_share import all_but

# it needs the notch that its velocity over 30 samples is, and a pid differences over one
LONG_DIFFERENCE = (
    ("Kv = 100 ", "velocity_samples = 30\nKv = 30 "),
    ("Kp = 6.8e4", "Kp = 3e4"),
    ("Tn_ms = 5.4", "Tn_ms = 30"),
)
ONE_LOW_PASS = (
    (
        "[[axis.x.control.feedforward]]",
        '[[axis.x.control.filters]]\nkind = "low_pass"\nfrequency = 1500\n[[axis.x.control.feedforward]]',
    ),
)
HANGING = (
    ("[axis.x.encoder_load]", '[[axis.x.forces]]\nkind = "gravity"\nforce_N = -390\n[axis.x.encoder_load]'),
    ("[axis.x.control.guard]", "[axis.x.control.guard]\nsafe_force_N = 390"),
)
CASES = {
    "hanging axis": ("linear_motor", "two", HANGING),
    "hanging axis, one pid": ("linear_motor", "one", HANGING),
    "linear motor, two pids": ("linear_motor", "two", ()),
    "linear motor, one pid": ("linear_motor", "one", ()),
    "linear motor, one pid and a low pass": ("linear_motor", "one", ONE_LOW_PASS),
    "two encoders, notch and low pass": ("ball_screw", "two", ()),
    "no integral, no feedforward": ("emps", "two", ()),
    "stick and slip, learned feedforward": ("xy_table", "one", ()),
}


def without_filters(text: str) -> str:
    """A machine file without the filters of its control."""
    return re.sub(r"\[\[axis\.x\.control\.filters\]\].*?(?=\[)", "", text, flags=re.DOTALL)


def changed(folder: Path, machine: str, changes: tuple[tuple[str, str], ...], *, filters: bool = True) -> Design:
    """A bundled machine with other numbers, or without its filters."""
    text = read_design(machine, "x").machine.file.text
    text = text if filters else without_filters(text)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / f"{machine}.toml").write_text(text, encoding="utf-8")
    return read_design(folder / f"{machine}.toml", "x")


def simulated(loop: Loop, reference: Reference) -> dict[str, np.ndarray]:
    free = replace(loop, control=replace(loop.control, guard=None))
    run = simulate(
        free, reference, record=("set_position", "set_velocity", "set_acceleration", "force", "reading_load")
    )
    return dict(run.signals)


def in_hal(directory: Path, folder: Path, loop: Loop, law: LinuxcncPid, run: dict[str, np.ndarray]) -> np.ndarray:
    """Output of the last pid and position of the table, in HAL's units: the fragments as they were written.

    The pins of LinuxCNC's motion are those of a streamer here, and the drive is the axis as a component.
    """
    plant = layout(plant_routine(loop, "axis_x_plant"))
    (folder / "axis_x_plant.comp").write_text(plant_comp(plant.routine, "axis", "a test"))
    (folder / "axis_x_plant.h").write_text(core("axis_x_plant", texts(plant, "axis", "a test")))
    fragment = (directory / "axis-x.hal").read_text(encoding="utf-8")
    for pin, source in {
        "joint.0.motor-pos-cmd": "streamer.0.pin.0",
        "joint.0.vel-cmd": "streamer.0.pin.1",
        "joint.0.acc-cmd": "streamer.0.pin.2",
        "joint.0.amp-enable-out": "streamer.0.pin.3",
        "joint.0.motor-pos-fb": "axis-x-plant.load-position-fb",
    }.items():
        assert pin in fragment
        fragment = fragment.replace(pin, source)
    fragment = re.sub(r"^net .*index-enable.*$", "", fragment, flags=re.MULTILINE)
    if "net axis-x-motor" in fragment:
        fragment += "net axis-x-motor axis-x-plant.motor-position-fb\n"
    (folder / "fragment.hal").write_text(fragment)
    (folder / "fragment.ini").write_text((directory / "axis-x.ini").read_text(encoding="utf-8"))
    output = re.search(r"^net axis-x-output +(\S+)$", fragment, re.MULTILINE)
    assert output
    wiring = [
        "loadrt axis_x_plant",
        "addf axis-x-plant.read servo-thread",
        "loadusr -w halcmd -i fragment.ini -f fragment.hal",
        f"setp axis-x-plant.units-per-m {float(law.units)!r}",
        "loadrt mult2 names=amplifier",
        "addf amplifier servo-thread",
        "addf axis-x-plant.write servo-thread",
        f"net axis-x-output {output[1]} => amplifier.in0 sampler.0.pin.0",
        f"setp amplifier.in1 {float(law.force_per_output)!r}",
        "net axis-x-force amplifier.out => axis-x-plant.force",
        "net axis-x-load sampler.0.pin.1",
    ]
    units = float(law.units)
    rows = np.column_stack(
        [
            units * run["set_position"],
            units * run["set_velocity"],
            units * run["set_acceleration"],
            run["force"] * 0 + 1,
        ]
    )
    period = round(loop.sample_time * 1e9)
    return halrun([folder / "axis_x_plant.comp"], folder, period, wiring, rows, "fffb", "ff").rows


@needs_linuxcnc
@pytest.mark.parametrize(
    "case",
    all_but(
        ("linear motor, one pid and a low pass", "stick and slip, learned feedforward"),
        CASES,
        "a session of HAL for each; the quick ones have both routes and every part",
    ),
)
def test_the_fragments_close_the_loop_as_it_was_simulated(case: str, tmp_path: Path) -> None:
    """A move beyond the force limit where there is one: outputs of the pids and positions, every sample, every bit."""
    machine, route, changes = CASES[case]
    design = changed(tmp_path, machine, changes)
    directory = write_linuxcnc_pid(design, tmp_path / "out", route=route).parent
    cascade = read_cascade(design.loop)
    law = stock_law(cascade, route=route)
    loop = stock_loop(cascade, law)
    gentle, beyond = moves(design.loop)
    # HAL loads its components at rest at 0, so the move begins there
    run = simulated(loop, replace(beyond or gentle, dwell_before=0.01))
    folder = tmp_path / "hal"
    folder.mkdir()
    found = in_hal(directory, folder, loop, law, run)
    assert np.array_equal(float(law.force_per_output) * found[:, 0], run["force"])
    assert np.array_equal(found[:, 1], float(law.units) * run["reading_load"])
    limit = design.loop.control.force_limit
    if limit is not None:
        assert np.max(np.abs(run["force"])) == pytest.approx(limit, rel=1e-12)  # the limit was met


@pytest.mark.parametrize("case", CASES)
def test_the_loop_gain_is_that_of_the_design(case: str, tmp_path: Path) -> None:
    """A P-PI cascade over one sample and its pids are one linear law, filters and all, but for rounding."""
    machine, route, changes = CASES[case]
    cascade = read_cascade(changed(tmp_path, machine, changes).loop)
    if cascade.law.velocity_samples > 1:
        law = CascadePPI(Kv=cascade.law.Kv, Kp=cascade.law.Kp, velocity_feedforward=cascade.law.velocity_feedforward)
        cascade = read_cascade(replace(cascade.loop, control=replace(cascade.loop.control, law=law)))
    f = np.geomspace(1.0, 0.49 / cascade.loop.sample_time, 200)
    L = loop_gain(cascade.loop, f).response
    by_pid = loop_gain(stock_loop(cascade, stock_law(cascade, route=route)), f).response
    # rounding of the gains, and what cancels between terms that are 1e8 apart near 1 Hz
    assert np.max(np.abs(by_pid / L - 1.0)) < 1e-6


@pytest.mark.parametrize("viscous", [None, 3e3])
@pytest.mark.parametrize("route", ROUTES)
def test_viscous_friction_that_the_law_gives_back_is_held(viscous: float | None, route: str) -> None:
    loop = read_design("linear_motor", "x").loop
    law = CascadePPI(Kv=250.0, Kp=4e4, Tn=4e-3, viscous=viscous)
    cascade = read_cascade(replace(loop, control=replace(loop.control, law=law)))
    f = np.geomspace(1.0, 4e3, 100)
    by_pid = loop_gain(stock_loop(cascade, stock_law(cascade, route=route)), f).response
    assert np.max(np.abs(by_pid / loop_gain(cascade.loop, f).response - 1.0)) < 1e-6


@pytest.mark.parametrize("route", ROUTES)
def test_the_bias_carries_the_weight_of_a_hanging_axis(route: str, tmp_path: Path) -> None:
    """At rest from the start it sinks only while the first force is on its way, not until an integral has grown."""
    cascade = read_cascade(changed(tmp_path, "linear_motor", HANGING).loop)
    law = stock_law(cascade, route=route)
    last = law.position if law.velocity is None else law.velocity
    assert last.bias == 390.0 / 100.0
    rest = JerkLimitedMove(distance=0.0, velocity=0.1, acceleration=1.0, jerk=10.0, dwell_after=0.1)
    sunk = [
        np.min(simulated(each, rest)["reading_load"]) for each in (stock_loop(cascade, law), without_bias(cascade, law))
    ]
    # it falls freely for the dead time, and the velocity loop stops it within m/Kp
    fall, dead = 390.0 / 40.0, cascade.loop.axis.actuator.dead_time
    assert sunk[0] > -(0.5 * fall * dead**2 + fall * dead * 40.0 / 4e4)
    assert sunk[1] < 10.0 * sunk[0]


def without_bias(cascade: Cascade, law: LinuxcncPid) -> Loop:
    bare = [None if pid is None else replace(pid, bias=0.0) for pid in (law.position, law.velocity)]
    return stock_loop(cascade, replace(law, position=bare[0], velocity=bare[1]))


def test_figures_of_both_controls_stand_in_the_readme(tmp_path: Path) -> None:
    design = read_design("linear_motor", "x")
    text = write_linuxcnc_pid(design, tmp_path / "out").read_text(encoding="utf-8")
    cascade = read_cascade(design.loop)
    figures = difference(cascade, stock_loop(cascade, stock_law(cascade))).figures
    assert len(figures) == 11
    for figure in figures:
        assert figure.design is not None
        assert figure.stock is not None
        assert f"| {figure.what} | {figure.unit} | {figure.design:.4g} | {figure.stock:.4g} |" in text
    by_name = {figure.what: figure for figure in figures}
    assert by_name["phase margin"].design == pytest.approx(by_name["phase margin"].stock, abs=1e-3)
    after = by_name["largest following error after that move has ended"]
    assert abs(after.design - after.stock) > 1.0  # um: the anti-windup is another


def test_numbers_of_the_ini_are_the_pids_to_the_last_bit(tmp_path: Path) -> None:
    design = read_design("xy_table", "x")
    text = (write_linuxcnc_pid(design, tmp_path / "out", joint=2).parent / "axis-x.ini").read_text(encoding="utf-8")
    law = stock_law(read_cascade(design.loop))
    assert "[JOINT_2]" in text
    for prefix, pid in (("POSITION", law.position), ("VELOCITY", law.velocity)):
        for name in ("Pgain", "Igain", "FF0", "FF1", "maxoutput"):
            found = re.search(rf"^{prefix}_{name.upper()} = (\S+)$", text, re.MULTILINE)
            assert found
            assert float(found[1]) == getattr(pid, name)


class TestBadInput:
    """Named, with what to do, and nothing is written."""

    def test_an_axis_that_pids_do_not_hold(self, tmp_path: Path) -> None:
        """The gains of the hint are stable ones."""
        design = changed(tmp_path, "ball_screw", LONG_DIFFERENCE, filters=False)
        with pytest.raises(UnstableError, match=r"but not with the design: .*oscillation.*target linuxcnc") as raised:
            write_linuxcnc_pid(design, tmp_path / "out")
        assert not (tmp_path / "out").exists()
        named = (re.search(rf"{name} = (\S+)", str(raised.value)) for name in ("Kv", "Kp", "Tn"))
        kv, kp, tn = (float(found[1]) for found in named if found)
        law = CascadePPI(Kv=kv, Kp=kp, Tn=tn, velocity_samples=30)
        slower = read_cascade(replace(design.loop, control=replace(design.loop.control, law=law)))
        require_stable_pids(slower, stock_loop(slower, stock_law(slower)), "two", 1000.0)

    def test_a_design_that_is_unstable_itself(self, tmp_path: Path) -> None:
        design = changed(tmp_path, "ball_screw", (), filters=False)
        with pytest.raises(UnstableError, match=r"^the design: the loop is unstable.*notch at"):
            write_linuxcnc_pid(design, tmp_path / "out")

    def test_a_law_that_gives_back_more_than_its_gain(self) -> None:
        loop = read_design("linear_motor", "x").loop
        law = CascadePPI(Kv=250.0, Kp=4e4, viscous=5e4)
        with pytest.raises(ParameterError, match="must be below Kp = 40000 N s/m"):
            stock_law(read_cascade(replace(loop, control=replace(loop.control, law=law))))

    def test_one_pid_for_two_encoders(self, tmp_path: Path) -> None:
        with pytest.raises(StructureError, match=r"two encoders.*take route = two"):
            write_linuxcnc_pid(read_design("ball_screw", "x"), tmp_path / "out", route="one")

    def test_one_pid_with_a_share_of_the_velocity_and_an_integral(self, tmp_path: Path) -> None:
        design = changed(tmp_path, "linear_motor", (("Tn_ms = 4", "Tn_ms = 4\nvelocity_feedforward = 0.5"),))
        with pytest.raises(StructureError, match=r"velocity_feedforward = 0\.5 under an integral"):
            write_linuxcnc_pid(design, tmp_path / "out", route="one")

    def test_a_law_that_is_no_cascade(self, tmp_path: Path) -> None:
        with pytest.raises(StructureError, match=r"is not a P-PI cascade.*target c or linuxcnc"):
            write_linuxcnc_pid(read_design("mill", "x"), tmp_path / "out")

    def test_a_route_and_a_joint_that_are_none(self, tmp_path: Path) -> None:
        design = read_design("linear_motor", "x")
        with pytest.raises(ParameterError, match="route = 'three' must be one of two, one"):
            write_linuxcnc_pid(design, tmp_path / "out", route="three")
        with pytest.raises(ParameterError, match="joint = 16 must be 0 to 15"):
            write_linuxcnc_pid(design, tmp_path / "out", joint=16)

    def test_a_sample_time_that_is_no_whole_number_of_nanoseconds(self, tmp_path: Path) -> None:
        design = changed(tmp_path, "linear_motor", (("sample_time_us = 100", "sample_time_us = 100.00003"),))
        with pytest.raises(ParameterError, match="not a whole number of nanoseconds"):
            write_linuxcnc_pid(design, tmp_path / "out")

    def test_a_name_that_is_too_long_for_hal(self, tmp_path: Path) -> None:
        design = read_design("linear_motor", "x", name="a_name_that_is_much_too_long")
        with pytest.raises(ParameterError, match="take a name of at most"):
            write_linuxcnc_pid(design, tmp_path / "out")

    def test_a_directory_of_somebody_else(self, tmp_path: Path) -> None:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "mine.txt").write_text("keep")
        with pytest.raises(FileError, match="not written by feeddrive"):
            write_linuxcnc_pid(read_design("linear_motor", "x"), tmp_path / "out")


@needs_linuxcnc
@pytest.mark.parametrize(
    "case", ["linear motor, two pids", "linear motor, one pid", "two encoders, notch and low pass"]
)
def test_the_fragments_load_beside_linuxcncs_motion(case: str, tmp_path: Path) -> None:
    """Word for word, with the joints of a real motion controller: every pin that they name is there and fits."""
    machine, route, _ = CASES[case]
    design = read_design(machine, "x")
    directory = write_linuxcnc_pid(design, tmp_path / "out", route=route).parent
    folder = tmp_path / "hal"
    folder.mkdir()
    for file in ("axis-x.hal", "axis-x.ini"):
        (folder / file).write_bytes((directory / file).read_bytes())
    lines = [
        "loadrt homemod",
        "loadrt tpmod",
        "loadrt trivkins",
        "loadrt motmod servo_period_nsec=100000 num_joints=1",
        "loadusr -w halcmd -i axis-x.ini -f axis-x.hal",
        "show pin axis-x",
        "show thread",
    ]
    (folder / "load.hal").write_text("\n".join(lines) + "\n")
    printed = session(folder, [], "halrun -f load.hal")
    law = stock_law(read_cascade(design.loop), route=route)
    for name in ("Pgain", "Igain", "FF1", "maxoutput"):
        found = re.search(rf"float IN +(\S+) +axis-x\.position\.{name}\b", printed)
        assert found
        assert float(found[1]) == pytest.approx(getattr(law.position, name), rel=1e-6)  # shown to seven digits

    order = re.findall(r"^ +\d+ +(\S+)$", printed, re.MULTILINE)
    functions = [name for name in order if name.startswith("axis-x")]
    middle = ["axis-x.speed"] if route == "two" else []
    last = ["axis-x.velocity.do-pid-calcs"] if route == "two" else []
    filters = ["feedback", "filter0", "filter1", "total", "limit"] if machine == "ball_screw" else []
    behind = [f"axis-x.{name}" for name in filters]
    assert functions == [*middle, "axis-x.forward", "axis-x.position.do-pid-calcs", *last, *behind]
