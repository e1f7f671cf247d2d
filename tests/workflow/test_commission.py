"""`feeddrive commission` on virtual drives in virtual time: bad input by name, a stop at any step, and going on.

Each end leaves the drive disabled, with what was in it before.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import feeddrive as fd
from feeddrive.bus.cia402 import PowerState
from feeddrive.bus.drive_file import drive_of
from feeddrive.bus.live import BusAxis
from feeddrive.bus.virtual_bus import VirtualCANopen, VirtualEtherCAT
from feeddrive.bus.virtual_drive import DrivenAxis, Firmware, drive_text, scaling_of
from feeddrive.commissioning.record import FILE, Commissioned, read_commissioned
from feeddrive.files.machine import machine_of_text
from feeddrive.files.toml_file import parse_toml
from feeddrive.language.errors import BusError, FileError, ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.workflow.commission import commission
from feeddrive.workflow.commission_steps import STEPS, CommissionRequest
from small_axis import MACHINE

LOOP = machine_of_text(MACHINE, "small.toml").loop(None)
SCALING = scaling_of(LOOP)
TEXT = drive_text(LOOP, SCALING, "ethercat", "virtual", 1, 1e-3)
MOVING = ("small_move", "friction_and_mass", "responses", "trial")


class Drive:
    """A virtual drive and its axis, over a short travel."""

    def __init__(self, text: str = TEXT, transport: Callable[[Firmware], Any] = VirtualEtherCAT) -> None:
        self.firmware = Firmware(DrivenAxis(LOOP), SCALING, 1e-3)
        # as somebody has set it by the maker's tool
        self.firmware.values |= {
            "max_torque": 2900,
            "following_error_window": 170_000,
            "following_error_timeout": 100,
            "disable_operation_option": 0,
            "fault_reaction_option": 1,
        }
        whole = BusAxis(drive_of(parse_toml(text, "drive.toml")), lambda _: transport(self.firmware), paced=False)
        self.axis = self.within(whole, travel=0.1)
        self.before = {} if self.firmware.state is PowerState.ENABLED else dict(self.axis.inside())

    @staticmethod
    def within(axis: BusAxis, **limits: float) -> BusAxis:
        """The same axis under tighter limits."""
        return axis.limited(replace(axis.limits, **limits))

    def is_as_it_was(self) -> bool:
        """True if the drive is off and holds what it held before."""
        return self.firmware.state is not PowerState.ENABLED and dict(self.axis.inside()) == self.before


class Person(Progress):
    """Answers with yes and with what the drive counts, until a step; there with no, or by the stop."""

    def __init__(self, until: str = "", *, stops: bool = False) -> None:
        super().__init__()
        self.until, self.stops, self.asked = until, stops, list[str]()
        self.steps, self.remarks = list[str](), list[str]()

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        if what not in self.steps:
            self.steps.append(what)
        # in the middle of the first motion, long before its end
        if self.stops and done is not None and of is not None and of > 100 and done > of // 3:
            self.cancel()

    def show_remark(self, message: Any) -> None:
        self.remarks.append(str(message))

    def confirm(self, question: str) -> bool:
        self.asked.append(question)
        return self.stops or not (self.until and self.steps and self.steps[-1] == self.until)

    def measured(self, question: str, expected: float, unit: str) -> float | None:
        self.asked.append(question)
        return expected


def begun(axis: Any, out: Path | None, person: Progress) -> Commissioned:
    return commission.run(CommissionRequest(axis, out=out), person).result


@pytest.fixture(scope="module")
def small_moved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Mapping[str, str]]:
    """A commissioning to which a person said no after the small move, and what was in its drive."""
    folder, drive = tmp_path_factory.mktemp("commission") / "axis", Drive()
    result = begun(drive.axis, folder, Person("friction and mass"))
    assert [step.name for step in result.steps] == ["listen", "small_move", "start_law"]
    assert "was not confirmed" in result.refusal
    assert drive.is_as_it_was()
    return folder, drive.before


@pytest.fixture
def folder(small_moved: tuple[Path, Mapping[str, str]], tmp_path: Path) -> Path:
    return Path(shutil.copytree(small_moved[0], tmp_path / "axis"))


# no drive, a wrong one, one of somebody else


def test_one_drive_is_asked_for_real_or_virtual(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="either a drive file, or --virtual with a machine"):
        fd.commission()
    with pytest.raises(ParameterError, match="either a drive file, or --virtual"):
        fd.commission(Drive().axis, virtual="emps")
    with pytest.raises(FileError, match=r"nothing\.toml"):
        fd.commission(tmp_path / "nothing.toml")


def test_a_bus_on_which_no_drive_answers_is_named() -> None:
    class Silent(VirtualEtherCAT):
        def open(self) -> None:
            raise BusError("EtherCAT eth1, station 1: no drive answers")

    with pytest.raises(BusError, match="station 1: no drive answers"):
        fd.commission(BusAxis(drive_of(parse_toml(TEXT, "d")), lambda _: Silent(Drive().firmware), paced=False))


def test_a_device_that_is_no_drive_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    drive = Drive()
    drive.firmware.values["device_type"] = 401
    held = dict(drive.firmware.values)
    with pytest.raises(BusError, match="is not a CiA 402 drive but a device of profile 401"):
        begun(drive.axis, tmp_path / "out", Person())
    assert drive.firmware.values == held


def test_scaling_that_the_drive_contradicts_ends_it_with_both_numbers(tmp_path: Path) -> None:
    drive = Drive(TEXT.replace("rated_force = 500.0", "rated_force = 400.0"))
    person = Person()
    result = begun(drive.axis, tmp_path / "out", person)
    assert not result.kept
    assert "scaling.rated_force = 400" in result.refusal
    assert "the drive says 500" in result.refusal
    assert drive.is_as_it_was()


def test_a_drive_that_somebody_else_has_enabled_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    drive = Drive(TEXT.replace('"ethercat"', '"canopen"'), VirtualCANopen)
    drive.firmware.state = PowerState.ENABLED
    drive.firmware.values["statusword"] = PowerState.ENABLED.status
    held = dict(drive.firmware.values)
    with pytest.raises(BusError, match="is 'operation enabled' already: another master or the tool of its maker"):
        begun(drive.axis, tmp_path / "out", Person())
    # the end of the connection is a fault of a drive that is enabled: that it tells by itself
    told = {"statusword", "error_code"}
    assert {k: v for k, v in drive.firmware.values.items() if k not in told} == {
        k: v for k, v in held.items() if k not in told
    }
    assert drive.firmware.axis.last.position == 0.0


# limits


@pytest.mark.parametrize("key", ["travel", "velocity", "force", "following_error"])
def test_a_limit_that_is_missing_is_named_with_the_file(tmp_path: Path, key: str) -> None:
    path = tmp_path / "drive.toml"
    path.write_text("\n".join(line for line in TEXT.splitlines() if not line.startswith(f"{key} ")))
    with pytest.raises((FileError, ParameterError), match=rf"drive\.toml.*{key}"):
        fd.commission(path)


def test_questions_of_a_real_drive_are_not_answered_by_an_option(tmp_path: Path) -> None:
    drive = Drive()
    real = type("Real", (BusAxis,), {"is_virtual": False})
    axis = real(drive.axis.file, lambda _: VirtualEtherCAT(drive.firmware), paced=False)
    with pytest.raises(ParameterError, match=r"--yes is for a virtual drive only: .* may move something real"):
        fd.commission(axis, yes=True, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow(reason="excitations are designed until none is left: 40 s")
def test_a_travel_that_is_too_small_for_the_excitation_is_named(folder: Path) -> None:
    drive = Drive()
    narrow = Drive.within(drive.axis, travel=2e-5)
    result = begun(narrow, folder, Person())
    assert not result.kept
    assert "no excitation within limits.travel" in result.refusal
    assert drive.is_as_it_was()


# a stop, and going on


def test_no_to_the_first_question_moves_nothing(tmp_path: Path) -> None:
    drive = Drive()
    result = begun(drive.axis, tmp_path / "out", Person("small move"))
    assert [step.name for step in result.steps] == ["listen"]
    assert drive.firmware.axis.last.position == 0.0
    assert drive.is_as_it_was()


@pytest.mark.parametrize("moved", [False, True], ids=["small_move", "friction_and_mass"])
def test_a_stop_while_it_moves_leaves_the_drive_off_and_as_it_was(tmp_path: Path, folder: Path, moved: bool) -> None:
    drive = Drive()
    result = begun(drive.axis, folder if moved else tmp_path / "out", Person(stops=True))
    assert len(result.steps) == (3 if moved else 1)
    assert "stopped" in result.refusal
    assert drive.is_as_it_was()


def test_it_goes_on_after_the_power_was_off_and_does_nothing_twice(folder: Path) -> None:
    """A drive whose power was lost holds what it had at the beginning."""
    drive, person = Drive(), Person("friction and mass")
    result = begun(drive.axis, folder, person)
    assert [step.name for step in result.steps] == ["listen", "small_move", "start_law"]
    assert len(person.asked) == 1
    assert person.asked[0].startswith("Friction and mass")
    assert any("small move: done before" in remark for remark in person.remarks)
    assert drive.firmware.axis.last.position == 0.0
    assert drive.is_as_it_was()


def test_a_drive_that_somebody_has_changed_in_between_is_named_by_object(folder: Path) -> None:
    drive = Drive()
    drive.firmware.values["following_error_window"] = 160_000
    held = dict(drive.firmware.values)
    with pytest.raises(FileError, match=r"the drive held 0x6065:00 = .*, at the beginning 170000, and now 160000"):
        begun(drive.axis, folder, Person())
    assert drive.firmware.values == held


def test_a_file_of_another_machine_in_its_folder_is_named_and_made_again(folder: Path) -> None:
    (folder / "3_start_law" / "machine.toml").write_text(MACHINE)
    drive, person = Drive(), Person("friction and mass")
    begun(drive.axis, folder, person)
    assert any("3_start_law/machine.toml is not what its step wrote" in remark for remark in person.remarks)
    assert (folder / "3_start_law" / "machine.toml").read_text() != MACHINE
    assert drive.is_as_it_was()


def test_the_folder_of_another_drive_or_of_something_else_is_refused(folder: Path, tmp_path: Path) -> None:
    other = Drive(TEXT.replace("velocity = 0.5", "velocity = 0.4"))
    with pytest.raises(FileError, match="is the record of another drive file, or of this one before it was changed"):
        begun(other.axis, folder, Person())
    assert other.is_as_it_was()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years of work")
    with pytest.raises(FileError, match=f"holds other files, and no {FILE}"):
        begun(Drive().axis, tmp_path / "mine", Person())
    (folder / FILE).write_text('{"format": "something else"}')
    with pytest.raises(FileError, match="is no record of a commissioning"):
        begun(Drive().axis, folder, Person())


# what is shown of it


def test_one_that_is_not_finished_is_read_and_shown(folder: Path) -> None:
    found = read_commissioned(folder)
    assert [step.name for step in found.steps] == ["listen", "small_move", "start_law"]
    assert found.trial is None
    assert found["small_move"].figures["rough_mass"] == pytest.approx(100.0, rel=0.1)
    with pytest.raises(ParameterError, match="ended before the first strokes"):
        found.chart()
    report = found.report()
    assert [section.key for section in report.sections] == ["steps"]
    assert report.verdict.good is False


@pytest.mark.slow(reason="half a minute of CPU: the whole chain on a virtual drive")
def test_the_whole_chain_ends_in_a_control_that_is_as_predicted_and_stops_anywhere(tmp_path: Path) -> None:
    drive, person, out = Drive(), Person(), tmp_path / "out"
    outcome = commission.run(CommissionRequest(drive.axis, out=out), person)
    result = outcome.result
    assert result.kept, result.refusal
    assert outcome.judgment is Judgment.COMMISSIONED
    assert [step.name for step in result.steps] == list(STEPS)
    assert len(person.asked) == result.questions <= 8
    assert result.trial is not None
    for name in ("following_rms", "stiffness"):
        assert result.trial.ratio(name) == pytest.approx(1.0, abs=0.1)
    # 99.5 kg are found of 100
    assert result["friction_and_mass"].figures["mass"] == pytest.approx(100.0, rel=0.03)
    assert drive.is_as_it_was()
    stored = json.loads((out / FILE).read_text())
    assert stored["kept"]
    assert stored["measured"]["stiffness"] == pytest.approx(result.trial.measured.stiffness)

    # what was written is what the result shows
    page = (out / "report.html").read_text(encoding="utf-8")
    assert Judgment.COMMISSIONED.says in page
    assert [picture.key for picture in result.report().pictures] == ["trial", "responses", "strokes"]
    error, deflection, *_ = result.chart().panels
    assert [curve.name for curve in error.curves] == ["measured", "predicted"]
    pulse = 1e6 * 1.0 / result.trial.measured.stiffness
    assert max(abs(deflection.curves[0].y)) > 100.0 * pulse
    assert read_commissioned(out).table().rows == result.table().rows

    # the control of another machine in place of the exported one: named, and written again before it moves anything
    foreign = out / "10_export" / "axis_x.h"
    assert foreign.is_file()
    foreign.write_text("/* of another machine */")
    again, second = Drive(), Person("trial")
    result = begun(again.axis, out, second)
    assert any("10_export/axis_x.h is not what its step wrote" in remark for remark in second.remarks)
    assert "of another machine" not in foreign.read_text()
    assert not result.kept
    assert again.is_as_it_was()

    # a stop in each motion that is left
    for name in MOVING[1:]:
        place = tmp_path / name
        shutil.copytree(out, place)
        for step in list(STEPS)[list(STEPS).index(name) :]:
            for left in place.glob(f"*_{step}"):
                shutil.rmtree(left)
        stopped = Drive()
        result = begun(stopped.axis, place, Person(stops=True))
        assert [step.name for step in result.steps] == list(STEPS)[: list(STEPS).index(name)], name
        assert "stopped" in result.refusal
        assert stopped.is_as_it_was()
