"""`feeddrive travel`: machine files of three positions become one with a schedule, which holds between them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.benchmark.rules import folder
from feeddrive.blocks import GainSchedule
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import load

EA = 210e9 * math.pi * 0.046**2 / 4.0  # N, the screw of screw_long
PLACES = (0.4, 1.5, 2.7)  # m


def machine_files(place: Path) -> list[str]:
    text = (folder(1) / "machines/screw_long.toml").read_text(encoding="utf-8")
    key = "stiffness_N_per_um = 131"
    assert text.count(key) == 1
    files = []
    for x in PLACES:
        file = place / f"at_{round(1000 * x)}.toml"
        value = 1e-6 / (1.0 / 300e6 + x / EA)
        file.write_text(text.replace(key, f"stiffness_N_per_um = {value:.12g}"), encoding="utf-8")
        files.append(str(file))
    return files


def test_the_file_that_is_written_is_the_schedule_that_was_judged(tmp_path: Path) -> None:
    command = load("travel")
    request = command.build_request(
        machines=tuple(machine_files(tmp_path)), position=PLACES, starts=1, between=1, out=tmp_path / "schedule.toml"
    )
    outcome = command.run(request, Progress())
    found = outcome.result
    assert outcome.judgment.exit_code == 0
    assert outcome.files == {"Machine": tmp_path / "schedule.toml"}
    law = fd.read_machine(tmp_path / "schedule.toml").loop("x").control.law
    assert isinstance(law, GainSchedule)
    assert [place.position for place in law.places] == list(PLACES)
    assert dict(tree.leaves(law)) == dict(tree.leaves(found.control.law))
    # all else of the file is that of the first one
    old, new = (fd.read_machine(tmp_path / name).loop("x") for name in ("at_400.toml", "schedule.toml"))
    assert dict(tree.leaves(old.axis)) == dict(tree.leaves(new.axis))
    move = fd.blocks.SnapLimitedMove(start=0.3, distance=2.5, velocity=0.5, acceleration=2.5, jerk=200.0, snap=2e4)
    run = fd.simulate(new, move, record=["tracking_error"])
    assert np.max(np.abs(run["tracking_error"])) < 1e-4  # m: through all places, with friction and counts


def test_positions_that_do_not_fit_the_files_are_refused(tmp_path: Path) -> None:
    command, files = load("travel"), machine_files(tmp_path)
    for given, positions, said in (
        (files, PLACES[:2], r"--position is given 2 times for 3 machine files: give the position of each file"),
        (files, (0.4, 1.5, 1.5), r"--position 1\.5 m is given twice"),
        (files[:2], PLACES[:2], r"known at 2 positions, and 3 are needed at least"),
    ):
        with pytest.raises(ParameterError, match=said):
            command.run(command.build_request(machines=tuple(given), position=positions), Progress())


def test_options_of_a_proof_without_one_are_refused(tmp_path: Path) -> None:
    command, files = load("travel"), machine_files(tmp_path)
    for given, said in (
        ({"kept": True}, r"--kept is about a proof: name its file by --certify proof\.json"),
        ({"prove_ms": 2.0}, "--prove-ms is about a proof"),
        ({"kept": True, "certify": Path("p.json"), "law": "linear_adrc"}, "leave out --law"),
    ):
        with pytest.raises(ParameterError, match=said):
            command.build_request(machines=tuple(files), position=PLACES, **given)


@pytest.mark.slow(reason="a tuning, a proof of its schedule and the check of the file take 30 s")
def test_the_proof_of_a_tuned_schedule_is_that_of_its_file(tmp_path: Path) -> None:
    """The schedule in the file is proven again with the same bound, and the checker accepts both proofs."""
    command, files = load("travel"), machine_files(tmp_path)
    given = {"machines": tuple(files), "position": PLACES, "certify": tmp_path / "proof.json"}
    out, page = tmp_path / "schedule.toml", tmp_path / "page.html"
    outcome = command.run(command.build_request(**given, starts=1, between=1, out=out, report=page), Progress())
    assert outcome.judgment.exit_code == 0
    assert set(outcome.files) == {"Machine", "Proof", "Report"}
    assert "The moving loop is stable up to" in outcome.verdict
    # the picture is drawn into the page
    assert "<svg" in page.read_text(encoding="utf-8")
    proof = json.loads((tmp_path / "proof.json").read_text(encoding="utf-8"))
    assert proof["sensitivity_peak"] == pytest.approx(2.02)
    assert [origin["file"] for origin in proof["made_from"]] == [Path(file).name for file in files]
    # the schedule as a file, on the axis along its travel: nothing is tuned
    text = out.read_text(encoding="utf-8")
    kept = {"machines": (str(out), *files[1:]), "position": PLACES, "certify": tmp_path / "again.json"}
    again = command.run(command.build_request(**kept, kept=True, prove_ms=2.02, frozen=True), Progress())
    assert again.result.proven is True
    assert out.read_text(encoding="utf-8") == text
    check = load("check")
    checked = check.run(check.build_request(file=tmp_path / "again.json"), Progress())
    assert checked.result is True
    with pytest.raises(ParameterError, match="--machine is compared with a certificate, and this is a proof along"):
        check.run(check.build_request(file=tmp_path / "again.json", machine=str(out)), Progress())
