"""Two drives on one beam commissioned together, on virtual drives whose plants are simulated as one machine."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from feeddrive.bus.drive_file import drive_of
from feeddrive.bus.gantry import Gantry
from feeddrive.bus.live import BusAxis
from feeddrive.bus.virtual_bus import VirtualEtherCAT
from feeddrive.bus.virtual_drive import Firmware, drive_text, scaling_of
from feeddrive.bus.virtual_gantry import DrivenGantry, DrivenSide, virtual_gantry
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.files.toml_file import TomlEdit, parse_toml
from feeddrive.language.errors import ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.workflow.commission import commission
from feeddrive.workflow.commission_steps import CommissionRequest
from gantries import COULOMB, MASSES, STIFFNESS, gantry

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


@pytest.mark.parametrize("signs", [(1, 1), (1, -1)])
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


def test_a_machine_with_a_beam_is_two_drives() -> None:
    made = virtual_gantry(gantry())
    assert [side.file.drive.station for side in made.sides] == [1, 2]
    assert [side.file.axis for side in made.sides] == ["y", "y2"]
