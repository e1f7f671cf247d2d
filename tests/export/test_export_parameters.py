"""Makers' files: every number in them, read back and turned into SI by factors that stand here, is the design's."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.feedforward.inverse_dynamics import InverseDynamics
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.filter.second_order import SecondOrder
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.prefilter.trajectory_prefilter import TrajectoryPrefilter
from feeddrive.export import linuxcnc_pid
from feeddrive.export.design import Design, read_design
from feeddrive.export.drive_quantities import CONSEQUENCES, Cascade, DriveTrain, drive_train, items, lost, read_cascade
from feeddrive.export.parameters import MAKERS, SINUMERIK, lines_of, write_parameters
from feeddrive.language import tree
from feeddrive.language.block import declarations
from feeddrive.language.errors import FileError, ParameterError, StructureError
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop

LEAD, GEAR = 0.02, 1.0  # of the ball screw, m
R = 2.0 * math.pi * GEAR / LEAD  # rad of the motor in a meter of the table
TURN = 2.0 * math.pi
KV_PER_1000_MIN = 1000.0 / 60.0  # 16.667
SIX = 5e-6  # relative: half a unit of the sixth digit

# value in the file -> SI at the table, and how far the printed digits may be off (relative, or absolute if decimals)
BACK: dict[str, tuple[Callable[[float], float], float]] = {
    "MD31030 $MA_LEADSCREW_PITCH": (lambda x: 1e-3 * x, SIX),
    "MD32200 $MA_POSCTRL_GAIN[0]": (lambda x: KV_PER_1000_MIN * x, SIX),
    "MD32610 $MA_VELO_FFW_WEIGHT[0]": (lambda x: x, SIX),
    "MD32650 $MA_AX_INERTIA": (lambda x: x * R**2, SIX),
    "MD36200 $MA_AX_VELO_LIMIT[0]": (lambda x: x / 60e3, SIX),
    "MD36100 $MA_POS_LIMIT_MINUS": (lambda x: 1e-3 * x, SIX),
    "MD36110 $MA_POS_LIMIT_PLUS": (lambda x: 1e-3 * x, SIX),
    "p1460[0]": (lambda x: x * R**2, SIX),
    "p1462[0]": (lambda x: 1e-3 * x, SIX),
    "p1520[0]": (lambda x: x * R, SIX),
    "p1521[0]": (lambda x: -x * R, SIX),
    "NC: Position control: Proportional Factor Kv": (lambda x: x, SIX),
    "NC: weight of the velocity pre-control (0x0B)": (lambda x: x, SIX),
    "NC: Maximum Position Lag Value (0x12)": (lambda x: 1e-3 * x, SIX),
    "S-0-0104": (lambda x: KV_PER_1000_MIN * x, 0.005 / 6.0),
    "S-0-0296": (lambda x: 0.01 * x, SIX),
    "S-0-0100": (lambda x: x * R**2, 0.0005 / 0.689),
    "S-0-0101": (lambda x: 1e-3 * x, 0.05 / 5.4),
    "0x3140:01": (lambda x: x * R**2, SIX),
    "0x3140:02": (lambda x: x, SIX),
    "0x3062:01": (lambda x: x, SIX),
    "odrv0.axis0.controller.config.pos_gain": (lambda x: x, SIX),
    "odrv0.axis0.controller.config.vel_gain": (lambda x: x / TURN * R**2, SIX),
    "odrv0.axis0.controller.config.vel_integrator_gain": (lambda x: x / TURN * R**2, SIX),
    "odrv0.axis0.controller.config.vel_limit": (lambda x: x * TURN / R, SIX),
    "odrv0.axis0.motor.config.torque_lim": (lambda x: x * R, SIX),
    "odrv0.axis0.controller.config.inertia": (lambda x: x / TURN * R**2, SIX),
}
LINE = re.compile(r"^(?P<name>[^#;/=][^=]*?) = (?P<value>\S+)$")


def with_travel(folder: Path, name: str = "ball_screw") -> Design:
    """A bundled machine with ends of the travel in its guard."""
    text = read_design(name, "x").machine.file.text
    text = text.replace("[axis.x.control.guard]", "[axis.x.control.guard]\ntravel_least_mm = -40\ntravel_most_mm = 400")
    file = folder / "machine.toml"
    file.write_text(text, encoding="utf-8")
    return read_design(file, "x")


def numbers(text: str) -> dict[str, float]:
    """Every assignment of a maker's file."""
    return {m["name"]: float(m["value"]) for line in text.splitlines() if (m := LINE.match(line))}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Design, Path]:
    """The design, and the folder with its files."""
    folder = tmp_path_factory.mktemp("ball_screw")
    design = with_travel(folder)
    return design, write_parameters(design, folder / "out").parent


class TestBallScrew:
    """A design with notch, low pass, feedforward and two encoders, in every file."""

    @pytest.mark.parametrize("maker", MAKERS)
    def test_every_number_comes_back_as_the_design(self, written: tuple[Design, Path], maker: str) -> None:
        design, folder = written
        text = (folder / f"{maker}.txt").read_text(encoding="utf-8")
        control = design.loop.control
        law, guard = control.law, control.guard
        assert isinstance(law, CascadePPI)
        assert guard is not None
        truth = {
            "axis.x.control.law.Kv": law.Kv,
            "axis.x.control.law.Kp": law.Kp,
            "axis.x.control.law.Tn": law.Tn,
            "axis.x.control.law.Kp / axis.x.control.law.Tn": law.Kp / law.Tn,
            "axis.x.control.law.velocity_feedforward": law.velocity_feedforward,
            "axis.x.control.feedforward, mass": 163.0,
            "axis.x.control.force_limit": control.force_limit,
            "axis.x.control.guard.velocity_limit": guard.velocity_limit,
            "axis.x.control.guard.following_error_limit": guard.following_error_limit,
            "axis.x.control.guard.travel_least": guard.travel_least,
            "axis.x.control.guard.travel_most": guard.travel_most,
            "axis.x.actuator.motor.lead": LEAD,
        }
        blocks = re.findall(r"from (?P<path>[^=\n]+) = (?P<si>\S+).*\n(?:[;/#]+ .*\n)*(?P<line>.+)", text)
        seen = 0
        for path, si, line in blocks:
            found = LINE.match(line)
            assert found, line
            if "filters" in path:
                continue
            back, tolerance = BACK[found["name"]]
            assert float(si) == truth[path]  # to the last bit
            assert back(float(found["value"])) == pytest.approx(truth[path], rel=tolerance), found["name"]
            seen += 1
        assert seen == len([name for name in numbers(text) if name in BACK])
        assert seen == len([row for row in MAKERS[maker].rows if row.name in text])

    def test_the_two_units_of_kv_of_one_maker_are_told_apart(self, written: tuple[Design, Path]) -> None:
        _, folder = written
        found = numbers((folder / "twincat.txt").read_text(encoding="utf-8"))
        by_nc, by_drive = found["NC: Position control: Proportional Factor Kv"], found["S-0-0104"]
        assert by_nc == 100.0
        assert by_drive == 6.0
        assert by_nc / by_drive == pytest.approx(16.667, rel=1e-4)

    @pytest.mark.parametrize("file", ["sinumerik.txt", "twincat.txt", "odrive.txt", "linuxcnc.txt", "parameters.csv"])
    def test_every_file_states_safety_and_kv_in_four_units(self, written: tuple[Design, Path], file: str) -> None:
        text = (written[1] / file).read_text(encoding="utf-8")
        for word in (
            "for a person to check",
            "Compare every unit",
            "emergency stop",
            "uncoupled",
            "vertical axis",
            "100 1/s",
            "(mm/s)/mm",
            "6 (m/min)/mm",
            "6 1000/min",
            "0.01/s",
            "16.667",
        ):
            assert word in text, word

    def test_filters_of_sinamics_have_the_response_of_the_design(self, written: tuple[Design, Path]) -> None:
        """Rebuilt from the numbers in the file as continuous filters; the design's are sampled at 20 kHz."""
        design, folder = written
        found = numbers((folder / "sinumerik.txt").read_text(encoding="utf-8"))
        assert [found["p1657[0]"], found["p1662[0]"]] == [2.0, 1.0]
        T = design.loop.sample_time

        def second(f: np.ndarray, frequency: float, damping: float) -> np.ndarray:
            s = 1j * f / frequency
            return s**2 + 2.0 * damping * s + 1.0

        def general(f: np.ndarray) -> np.ndarray:
            return second(f, found["p1660[0]"], found["p1661[0]"]) / second(f, found["p1658[0]"], found["p1659[0]"])

        def low(f: np.ndarray) -> np.ndarray:
            return 1.0 / second(f, found["p1663[0]"], found["p1664[0]"])

        f = np.geomspace(10.0, 1000.0, 200)
        notch, pt2 = design.loop.control.filters
        for block, expected, own in ((notch, general, 460.0), (pt2, low, 2500.0)):
            # sampled filters are exact at their own frequency ...
            at = np.array([own])
            assert np.abs(sampled(block, at, T) - expected(at))[0] < 1e-9
            # ... and below it Tustin bends the frequency axis by at most (π f T)²/3 of itself
            slope = np.max(np.abs(np.gradient(expected(f), np.log(f))))
            bend = (np.pi * max(own, f[-1]) * T) ** 2 / 3.0
            assert np.max(np.abs(sampled(block, f, T) - expected(f))) < 1.2 * bend * slope

    def test_csv_holds_each_number_in_si(self, written: tuple[Design, Path]) -> None:
        lines = (written[1] / "parameters.csv").read_text(encoding="utf-8").splitlines()
        rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
        found = {(row["name"], row["unit"]): (float(row["value"]), float(row["SI value"])) for row in rows}
        assert found["Kv", "(m/min)/mm"] == (6.0, 100.0)
        assert found["Kp at the motor", "N m s/rad"][0] == pytest.approx(6.8e4 / R**2, rel=1e-8)
        assert found["velocity_limit at the motor", "rpm"] == (9600.0, 3.2)
        assert found["force_limit at the motor", "N m"][0] == pytest.approx(9000.0 / R, rel=1e-8)
        assert found["filters.0 notch.frequency", "Hz"] == (460.0, 460.0)

    def test_loops_that_are_unstable_without_their_notch_say_so(self, written: tuple[Design, Path]) -> None:
        for file, unstable in (("sinumerik", False), ("twincat", True), ("odrive", True), ("linuxcnc", False)):
            text = (written[1] / f"{file}.txt").read_text(encoding="utf-8")
            assert ("UNSTABLE WITH THESE NUMBERS ALONE" in text) == unstable, file
        assert (written[1] / "README.md").read_text(encoding="utf-8").count("UNSTABLE") == 2

    def test_what_no_manual_was_read_for_says_so(self, written: tuple[Design, Path]) -> None:
        text = (written[1] / "sinumerik.txt").read_text(encoding="utf-8")
        assert re.search(r"NOT CHECKED.*\np1460\[0\] = ", text)
        assert re.search(r"Parameter Manual, 08/2015, p. 234\nMD32200", text)


def sampled(block: object, f: np.ndarray, T: float) -> np.ndarray:
    """The response of a filter as it is simulated, from its answer to a pulse."""
    made = block.prepare(T)  # type: ignore[attr-defined]
    state, answer = block.start(made, 0.0), []  # type: ignore[attr-defined]
    for k in range(20000):
        state, output = block.step(made, state, 1.0 if k == 0 else 0.0)  # type: ignore[attr-defined]
        answer.append(float(output))
    return np.exp(-2j * np.pi * np.outer(f, np.arange(len(answer))) * T) @ np.array(answer)


def test_a_linear_motor_has_linear_units(tmp_path: Path) -> None:
    design = read_design("linear_motor", "x")
    folder = write_parameters(design, tmp_path / "out").parent
    text = (folder / "sinumerik.txt").read_text(encoding="utf-8")
    assert "[Ns/m]" in text
    assert "[Nms/rad]" not in text
    assert numbers(text)["p1460[0]"] == 4.0e4
    assert numbers(text)["MD32652 $MA_AX_MASS"] == 40.0
    assert numbers(text)["p1520[0]"] == 2000.0
    assert "linear motor" in text
    assert not (folder / "odrive.txt").exists()
    assert "No file: odrive counts in turns" in (folder / "README.md").read_text(encoding="utf-8")


def test_a_lead_that_is_given_makes_a_rotary_axis(tmp_path: Path) -> None:
    design = read_design("emps", "x")
    folder = write_parameters(design, tmp_path / "out", lead=0.01, gear=2.0).parent
    r = 2.0 * math.pi * 2.0 / 0.01
    found = numbers((folder / "sinumerik.txt").read_text(encoding="utf-8"))
    assert found["p1460[0]"] * r**2 == pytest.approx(8557.426200790131, rel=SIX)
    assert "p1462[0]" not in found  # the law has no integral time


@pytest.mark.parametrize(
    ("axis", "expected"),
    [("ball_screw", DriveTrain(0.02, 1.0)), ("mill", DriveTrain(0.01, 1.0)), ("linear_motor", DriveTrain(None))],
)
def test_the_drive_train_is_found(axis: str, expected: DriveTrain) -> None:
    found = drive_train(read_design(axis, "x").loop)
    assert (found.lead, found.gear) == (expected.lead, expected.gear)


class TestBadInput:
    """Named, with what to do, and nothing is written."""

    def test_a_law_that_is_no_cascade(self, tmp_path: Path) -> None:
        with pytest.raises(StructureError, match=r"active_disturbance_rejection is not a P-PI.*target c or linuxcnc"):
            write_parameters(read_design("mill", "x"), tmp_path / "out")
        assert not (tmp_path / "out").exists()

    def test_an_axis_without_a_motor(self, tmp_path: Path) -> None:
        text = read_design("linear_motor", "x").machine.file.text
        text = re.sub(r"\[axis\.x\.actuator\.motor\].*?(?=\[axis)", "", text, flags=re.DOTALL)
        (tmp_path / "machine.toml").write_text(text, encoding="utf-8")
        design = read_design(tmp_path / "machine.toml", "x")
        with pytest.raises(ParameterError, match=r"axis\.actuator\.motor is not there.*give lead and gear"):
            write_parameters(design, tmp_path / "out")
        assert not (tmp_path / "out").exists()
        write_parameters(design, tmp_path / "out", makers=["csv", "linuxcnc"])  # these need no motor
        assert "N m" not in (tmp_path / "out" / "parameters.csv").read_text(encoding="utf-8").split("name,value")[1]

    def test_a_maker_that_is_not_known(self, tmp_path: Path) -> None:
        with pytest.raises(ParameterError, match="maker 'fanuc' is not known; there are sinumerik, twincat, odrive"):
            write_parameters(read_design("ball_screw", "x"), tmp_path / "out", makers=["fanuc"])

    def test_a_linear_motor_where_turns_are_counted(self, tmp_path: Path) -> None:
        with pytest.raises(ParameterError, match="odrive counts in turns"):
            write_parameters(read_design("linear_motor", "x"), tmp_path / "out", makers=["odrive"])

    @pytest.mark.parametrize("lead", [0.0, -0.01, math.inf, math.nan])
    def test_a_lead_that_is_none(self, lead: float, tmp_path: Path) -> None:
        with pytest.raises(ParameterError, match=r"lead = .* must be positive and finite"):
            write_parameters(read_design("emps", "x"), tmp_path / "out", lead=lead)

    def test_a_gear_without_a_lead(self) -> None:
        with pytest.raises(ParameterError, match="give the lead of the screw too"):
            drive_train(read_design("emps", "x").loop, gear=3.0)

    def test_a_directory_of_somebody_else(self, tmp_path: Path) -> None:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "mine.txt").write_text("keep")
        with pytest.raises(FileError, match="not written by feeddrive"):
            write_parameters(read_design("ball_screw", "x"), tmp_path / "out")
        assert [file.name for file in (tmp_path / "out").iterdir()] == ["mine.txt"]

    def test_a_gain_that_a_drive_cannot_take_is_listed_and_not_written(self) -> None:
        loop = read_design("ball_screw", "x").loop
        law = CascadePPI(Kv=2000.0, Kp=6.8e4, Tn=0.0054)
        cascade = read_cascade(replace(loop, control=replace(loop.control, law=law)))
        lines, missing = lines_of(MAKERS["twincat"], cascade, drive_train(loop))
        assert "S-0-0104" not in [line.name for line in lines]
        assert any("S-0-0104 takes at most 100" in each.why for each in missing)


def full(loop: Loop) -> Loop:
    """A control with something of every kind."""
    spring = TwoMass(mass_motor=100.0, mass_load=50.0, stiffness=1e7, viscous_load=100.0)
    law = CascadePPI(
        Kv=50.0,
        Kp=4e4,
        Tn=0.01,
        viscous=30.0,
        velocity_samples=2,
        velocity_lag=1e-3,
        velocity_encoder="load",
        position_every=2,
        model_mass=150.0,
    )
    guard = Guard(following_error_limit=1e-3, velocity_limit=2.0, travel_least=-0.1, travel_most=0.5, safe_force=300.0)
    control = Control(
        law=law,
        prefilter=TrajectoryPrefilter(theta1=0.0, theta2=1e-6, theta3=0.0, theta4=0.0),
        filters=(
            Notch(frequency=300.0),
            LowPass(frequency=900.0),
            LowPass2(frequency=2000.0),
            SecondOrder(frequency_zero=700.0, frequency_pole=500.0),
            LowPass2(frequency=3000.0),
        ),
        force_limit=5000.0,
        guard=guard,
        feedback_delay=1e-4,
    )
    return replace(loop, control=replace(control, feedforward=(InverseDynamics(model=spring),)))


@pytest.mark.parametrize("target", [*MAKERS, "linuxcnc"])
def test_every_item_of_a_design_is_held_or_stands_in_the_table(target: str) -> None:
    loop = full(read_design("ball_screw", "x").loop)
    more = (
        DisturbanceCompensator(
            mass=10.0, viscous=5.0, coulomb_positive=20.0, coulomb_negative=20.0, jerk_feedforward=0.1
        ),
    )
    friction = (Inertia(mass=10.0), FrictionFeedforward(coulomb_positive=10.0, coulomb_negative=10.0))
    if target == "linuxcnc":
        held, outside = linuxcnc_pid.HELD, linuxcnc_pid.OUTSIDE
    else:
        held, outside = MAKERS[target].held, MAKERS[target].outside
    kinds = set()
    for feedforward in (loop.control.feedforward, more, friction):
        cascade = read_cascade(replace(loop, control=replace(loop.control, feedforward=feedforward)))
        there = list(items(cascade))
        kinds |= {item.kind for item in there}
        rows = lost(cascade, held, outside)
        assert len(rows) == sum(item.kind not in held for item in there)
        assert all(row.path and row.why and row.consequence for row in rows)
    assert kinds == set(CONSEQUENCES) - {"feedforward", "compensation"}


# every field that does nothing by default does something here
GUARD = Guard(following_error_limit=1e-3, velocity_limit=0.5, travel_least=-0.2, travel_most=0.3, safe_force=90.0)
OTHER = {name: 2 * value for name, value in tree.leaves(GUARD)} | {"travel_least": -0.1}


def entered(target: str, cascade: Cascade) -> object:
    """The numbers that a target takes from a design."""
    if target == "linuxcnc":
        return linuxcnc_pid.ini_fragment(cascade, linuxcnc_pid.stock_law(cascade), 0, ())
    return [line.text for line in lines_of(MAKERS[target], cascade, drive_train(cascade.loop))[0]]


@pytest.mark.parametrize("target", [*MAKERS, "linuxcnc"])
@pytest.mark.parametrize("field", declarations(Guard))
def test_every_field_of_a_guard_is_converted_or_lost(written: tuple[Design, Path], field: str, target: str) -> None:
    loop = written[0].loop
    designs = [
        read_cascade(replace(loop, control=replace(loop.control, guard=guard)))
        for guard in (GUARD, replace(GUARD, **{field: OTHER.get(field, False)}))
    ]
    whole = linuxcnc_pid if target == "linuxcnc" else MAKERS[target]
    held, outside = (whole.HELD, whole.OUTSIDE) if isinstance(whole, ModuleType) else (whole.held, whole.outside)
    listed = [(row.path, row.value) for design in designs for row in lost(design, held, outside)]
    converted = entered(target, designs[0]) != entered(target, designs[1])
    assert converted or any(path == f"control.guard.{field}" for path, _ in listed)


def test_a_fifth_filter_and_a_first_order_one_are_listed() -> None:
    cascade = read_cascade(full(read_design("ball_screw", "x").loop))
    found = [SINUMERIK.filters(block, i) for i, block in enumerate(cascade.loop.control.filters)]
    assert [bool(each.lines) for each in found] == [True, False, True, True, False]
    assert found[1].why == "current setpoint filters are PT2 or general second order"
    assert found[4].why == "a drive has 4 current setpoint filters"
