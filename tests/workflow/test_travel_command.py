"""`feeddrive travel`: machine files of three positions become one with a schedule, which holds between them."""

from __future__ import annotations

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
