"""Two drives on one beam commissioned together, on virtual drives whose plants are simulated as one machine."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bus_bench import in_a_namespace
from feeddrive.bus.drive_file import drive_of, read_drive
from feeddrive.bus.gantry import Gantry
from feeddrive.bus.live import BusAxis
from feeddrive.bus.virtual_bus import VirtualEtherCAT
from feeddrive.bus.virtual_drive import Firmware, drive_text, scaling_of
from feeddrive.bus.virtual_gantry import SKEW, DrivenGantry, DrivenSide, virtual_gantry
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.files.toml_file import TomlEdit, parse_toml
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.workflow.commission import commission
from feeddrive.workflow.commission_steps import CommissionRequest
from feeddrive.workflow.play import VirtualDriveRequest, virtual_drive
from gantries import COULOMB, MASSES, STIFFNESS, gantry
from slow_share import all_but

SLOW = 1e-3  # s, the cycle of the drives of the quick tests


class Person(Progress):
    """Somebody who says yes so many times, and then no."""

    def __init__(self, yes: int) -> None:
        super().__init__()
        self.yes, self.asked = yes, list[str]()

    def confirm(self, question: str) -> bool:
        self.asked.append(str(question))
        return len(self.asked) <= self.yes


def drives(signs: Sequence[int] = (1, 1)) -> Gantry:
    """Two virtual drives whose torques have these signs against their positions, and whose files say nothing of it."""
    axes = []
    for station, (side, sign) in enumerate(zip(DrivenGantry(gantry(sample_time=SLOW)).sides, signs, strict=True), 1):
        axes.append(_axis(side, station, sign))
    return Gantry(*axes)


def _axis(side: DrivenSide, station: int, sign: int) -> BusAxis:
    scaling = scaling_of(side.loop)
    firmware = Firmware(side, replace(scaling, force_sign=sign), SLOW)
    edit = TomlEdit(drive_text(side.loop, scaling, "ethercat", "virtual", station, SLOW), side.name)
    edit.set(("lag",), 2)
    edit.set(("limits", "skew"), 1e-3, "m")
    return BusAxis(
        drive_of(parse_toml(edit.text, side.name)), lambda _: VirtualEtherCAT(firmware, station), paced=False
    )


@pytest.mark.parametrize("signs", all_but([((1, -1),)], [((1, 1),), ((1, -1),)], "the other sense of the second motor"))
def test_the_skew_comes_first_and_tells_beam_and_signs(signs: tuple[int, int], tmp_path: Path) -> None:
    """Whoever stops after it has what was found, and drives that are as they were."""
    axis, person = drives(signs).common, Person(yes=1)
    before = axis.inside()
    outcome = commission.run(CommissionRequest(axis, out=tmp_path / "out"), person)
    result = outcome.result
    assert [step.name for step in result.steps] == ["listen", "skew"]
    facts = result["skew"].figures
    assert (facts["skew_sign_first"], facts["skew_sign_second"]) == signs
    assert facts["beam_stiffness"] == pytest.approx(STIFFNESS, rel=0.05)
    assert abs(facts["skew_free"]) < max(COULOMB) / STIFFNESS  # m: within what friction hides
    assert "against its positions" in result["skew"].says or signs == (1, 1)
    assert "it was not confirmed" in result.refusal
    assert person.asked[0].startswith("Skew: the drives' own controls move both sides slowly the same way")
    assert "by at most 0.00025 m of skew" in person.asked[0]
    assert "at most 40 % of limits.force" in person.asked[0]
    assert axis.inside() == before
    written = (tmp_path / "out" / "2_skew" / "drive_second.toml").read_text(encoding="utf-8")
    assert ("force_sign = -1" in written) == (signs[1] < 0)


def test_a_gantry_is_two_drives_of_one_segment_or_a_machine_with_a_beam(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="--second is a drive; a virtual gantry is a machine with a cross_beam"):
        commission.run(CommissionRequest(virtual="gantry", second=drives().second), Progress())
    with pytest.raises(ParameterError, match="on one EtherCAT segment"):
        commission.run(CommissionRequest(drives().common, second=drives().second), Progress())
    first = drives().first
    with pytest.raises(ParameterError, match="are both station 1"):
        commission.run(CommissionRequest(first, second=first), Progress())


@pytest.mark.slow(reason="the whole chain on two virtual drives, their responses twice: 2 to 3 minutes")
@pytest.mark.timeout(900)
def test_a_gantry_is_commissioned_from_its_skew_to_its_trial(tmp_path: Path) -> None:
    (tmp_path / "portal.toml").write_text(machine_toml(gantry(), "portal"), encoding="utf-8")
    out = tmp_path / "out"
    outcome = commission.run(CommissionRequest(virtual=tmp_path / "portal.toml", yes=True, out=out), Progress())
    result = outcome.result
    assert result.refusal == ""
    assert outcome.judgment is Judgment.COMMISSIONED
    assert result.trial is not None
    for name in ("following_rms", "stiffness", "skew_stiffness"):
        assert result.trial.ratio(name) == pytest.approx(1.0, abs=0.1)
    facts = result.figures
    assert facts["share_first"] == pytest.approx(MASSES[0] / sum(MASSES), abs=0.01)
    assert facts["mass"] == pytest.approx(sum(MASSES), rel=0.01)
    assert facts["beam_stiffness"] == pytest.approx(STIFFNESS, rel=0.05)
    machine = read_machine(out / "10_tune" / "gantry.toml").machine()
    assert sum(float(loop.axis.plant.rigid_mass()) for loop in machine.loops().values()) == pytest.approx(
        sum(MASSES), rel=0.02
    )
    record = json.loads((out / "commission.json").read_text(encoding="utf-8"))
    assert record["kept"]
    assert record["measured"]["skew_stiffness"] == result.trial.measured.skew_stiffness
    # the drives are new, and the record knows it: only the trial is done again
    said = list[str]()

    class Listening(Progress):
        def show_remark(self, message: object) -> None:
            said.append(str(message))

    again = commission.run(CommissionRequest(virtual=tmp_path / "portal.toml", yes=True, out=out), Listening())
    assert sum("done before" in each for each in said) == len(result.steps) - 1
    assert again.judgment is Judgment.COMMISSIONED


OVER_A_SEGMENT = """
import json
import sys
from pathlib import Path
from feeddrive.bus.drive_file import read_drive
from feeddrive.bus.gantry import Gantry
from feeddrive.bus.live import BusAxis
from feeddrive.language.progress import Progress
from feeddrive.workflow.commission import commission
from feeddrive.workflow.commission_steps import CommissionRequest



class Person(Progress):
    left = int(sys.argv[1])

    def confirm(self, question):
        self.left -= 1
        return self.left >= 0

    def measured(self, question, expected, unit):
        return expected


first, second = (BusAxis(read_drive(f"drive_{name}.toml"), paced=False) for name in ("y", "y2"))
axis = Gantry(first, second).common
before = dict(axis.inside())
result = commission.run(CommissionRequest(axis, out=Path("out")), Person()).result
names = ("following_rms", "stiffness", "skew_stiffness")
found = {
    "where": axis.where,
    "steps": [step.name for step in result.steps],
    "figures": dict(result.figures),
    "refusal": result.refusal,
    "kept": result.kept,
    "ratios": None if result.trial is None else [result.trial.ratio(name) for name in names],
    "as_it_was": dict(axis.inside()) == before,
}
Path("found.json").write_text(json.dumps(found), encoding="utf-8")
"""
SERVED = """
set -e
: > ready.txt
{feeddrive} virtual-drive portal.toml --interface veth1 --master veth0 --drive-file drive.toml > ready.txt 2>&1 &
served=$!
trap 'kill -KILL $served 2>/dev/null || true' EXIT
for attempt in $(seq 300); do grep -q Ready ready.txt && break; sleep 0.1; done
{python} over_a_segment.py {yes}
kill -INT $served
wait $served
"""


def over_a_segment(tmp_path: Path, yes: int) -> dict[str, Any]:
    """What came of a commissioning of both drives, which a process of their own serves on a veth pair.

    It is ended by the question after so many.
    """
    (tmp_path / "portal.toml").write_text(machine_toml(gantry(sample_time=SLOW), "portal"), encoding="utf-8")
    (tmp_path / "over_a_segment.py").write_text(OVER_A_SEGMENT, encoding="utf-8")
    feeddrive = f"{sys.executable} -c 'from feeddrive.cli import main; main()'"
    script = SERVED.format(feeddrive=feeddrive, python=sys.executable, yes=yes)
    done = in_a_namespace("bash", "-c", script, timeout=1100.0, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr + (tmp_path / "ready.txt").read_text(encoding="utf-8")
    return json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))


@pytest.mark.slow(reason="three steps of a commissioning with every frame through two sockets: half a minute")
@pytest.mark.timeout(600)
def test_two_drives_of_a_segment_on_one_beam_are_commissioned_together(tmp_path: Path) -> None:
    """Their skew and the first moves; whoever stops then has what was found, and drives that are as they were."""
    found = over_a_segment(tmp_path, yes=2)
    assert found["where"] == "EtherCAT veth0, station 1 and EtherCAT veth0, station 2"
    assert found["steps"] == ["listen", "skew", "small_move", "start_law"]
    assert found["figures"]["beam_stiffness"] == pytest.approx(STIFFNESS, rel=0.05)
    # roughly, from a push
    assert found["figures"]["rough_mass"] == pytest.approx(sum(MASSES), rel=0.3)
    assert "it was not confirmed" in found["refusal"]
    assert found["as_it_was"]


def test_two_drives_that_are_served_have_one_plant_and_a_file_each(tmp_path: Path) -> None:
    """Their files say what a gantry needs; the interface is none, and so the serving ends there."""
    (tmp_path / "portal.toml").write_text(machine_toml(gantry(), "portal"), encoding="utf-8")
    asked = VirtualDriveRequest(tmp_path / "portal.toml", interface="none0", drive_file=tmp_path / "drive.toml")
    with pytest.raises(FeeddriveError):
        virtual_drive.run(asked, Progress())
    one, other = (read_drive(tmp_path / f"drive_{name}.toml") for name in ("y", "y2"))
    assert (one.drive.station, other.drive.station, one.axis, other.axis) == (1, 2, "y", "y2")
    assert Gantry(BusAxis(one), BusAxis(other)).skew == SKEW
    with pytest.raises(ParameterError, match=r"portal\.toml: the drives of a gantry begin at 0: leave out --position"):
        virtual_drive.run(replace(asked, position=0.1), Progress())


def test_a_machine_with_a_beam_is_two_drives() -> None:
    made = virtual_gantry(gantry())
    assert [side.file.drive.station for side in made.sides] == [1, 2]
    assert [side.file.axis for side in made.sides] == ["y", "y2"]
