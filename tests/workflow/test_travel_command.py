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


def test_payloads_that_do_not_fit_the_files_are_refused(tmp_path: Path) -> None:
    command, files = load("travel"), machine_files(tmp_path)
    certify = {"certify": Path("p.json"), "payload": (0.0, 1.0, 2.0)}
    for given, said in (
        ({"payload": (0.0, 1.0)}, r"--payload is given 2 times for 3 machine files: give the payload of each file"),
        ({"robust": True}, "--robust is about payloads: give the payload of each"),
        ({"prove_payload": 3.0, "certify": Path("p.json")}, "--prove-payload is about payloads"),
        (certify, "a proof along the travel is that of one payload: name it by --prove-payload"),
        ({"payload": (0.0, 1.0, 2.0), "prove_payload": 0.0}, "--prove-payload is about a proof"),
        ({"payload": (5.0, 5.0, 5.0), "position": (0.4, 1.5, 1.5)}, r"1\.5 m with --payload 5 kg is given twice"),
    ):
        with pytest.raises(ParameterError, match=said):
            command.build_request(**{"machines": tuple(files), "position": PLACES, **given})
    # a payload at each position alone: the pairs leave out what lies between
    request = command.build_request(machines=tuple(files), position=PLACES, payload=(0.0, 200.0, 400.0))
    with pytest.raises(ParameterError, match=r"no measurement at 0\.4 m with 400 kg"):
        command.run(request, Progress())


@pytest.mark.slow(reason="a tuning at nine pairs and the proof of one payload take 15 s")
def test_the_file_of_a_schedule_over_pairs_has_the_payload_of_the_first_file(tmp_path: Path) -> None:
    command, text = load("travel"), (folder(1) / "machines/screw_long.toml").read_text(encoding="utf-8")
    files: list[str] = []
    pairs = [(x, m) for x in PLACES for m in (100.0, 300.0, 700.0)]
    for x, m in pairs:
        value = 1e-6 / (1.0 / 300e6 + x / EA)
        changed = text.replace("stiffness_N_per_um = 131", f"stiffness_N_per_um = {value:.12g}")
        file = tmp_path / f"x{round(1000 * x)}_m{m:.0f}.toml"
        file.write_text(changed.replace("mass_load_kg = 500", f"mass_load_kg = {500.0 + m}"), encoding="utf-8")
        files.append(str(file))
    out, page = tmp_path / "schedule.toml", tmp_path / "page.html"
    request = command.build_request(
        machines=tuple(files),
        position=tuple(x for x, _ in pairs),
        payload=tuple(m for _, m in pairs),
        starts=1,
        between=1,
        out=out,
        report=page,
        certify=tmp_path / "proof.json",
        prove_payload=450.0,
        frozen=True,
    )
    outcome = command.run(request, Progress())
    assert outcome.judgment.exit_code == 0
    assert "with a payload of 450 kg" in outcome.verdict
    assert "with the worst payload" in page.read_text(encoding="utf-8")
    assert "<svg" in page.read_text(encoding="utf-8")
    law = fd.read_machine(out).loop("x").control.law
    assert isinstance(law, GainSchedule)
    assert law.payload == 100.0
    assert [[load.payload for load in place.loads] for place in law.places] == [[100.0, 300.0, 700.0]] * 3
    with pytest.raises(ParameterError, match=r"payload = 50 kg must be between 100 kg and 700 kg"):
        law.with_payload(50.0)


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
    assert "with the worst payload" not in page.read_text(encoding="utf-8")
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
