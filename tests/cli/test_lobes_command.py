"""`feeddrive lobes`: a machine file with a cut, modes of the tool, the report, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import feeddrive as fd
from feeddrive.cli.commands import app
from feeddrive.files.machine import find_bundled
from feeddrive.language.errors import FeeddriveError
from feeddrive.machining import Regeneration, ToolMode, stability_lobes, tool_modes

CUT = """
[[couplings]]
kind = "milling_cut"
spindle_speed = 10000

[couplings.cutter]
kind = "helical_cutter"
teeth = 2
diameter_mm = 10
axial_depth_mm = 0.25
radial_depth_mm = 5
specific_energy = 6e8
radial_ratio = 0.3333333333333333
"""
JOB = """
title = "a cut"
machine = "mine.toml"
axis = "x"

[reference]
kind = "snap_limited_move"
distance_mm = 1
velocity_mm_per_s = 10
acceleration_mm_per_s2 = 100
jerk_mm_per_s3 = 1e4
snap_mm_per_s4 = 1e6
"""
runner = CliRunner()


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(find_bundled("xy_table", "machines").read_text(encoding="utf-8") + CUT, encoding="utf-8")
    return path


@pytest.mark.pictures
def test_modes_alone_give_the_limits_of_the_benchmark(mine: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    asked = [str(mine), "--rigid", "--mode", "922:0.011:0.03993:x", "--speeds", "10000:15000:2", "--out", str(out)]
    done = runner.invoke(app, ["lobes", *asked], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    # up milling of half of the diameter: the reference gives 0.2135340337 and 0.2588724931 mm
    assert "0.21353" in done.output
    assert "0.25887" in done.output
    assert "at 10000 rpm and 0.25 mm the cut chatters" in done.output
    rows = np.genfromtxt(out / "lobes.csv", delimiter=",", skip_header=1)
    assert rows[:, 1] == pytest.approx([0.2135340337e-3, 0.2588724931e-3], rel=1e-8)
    assert (out / "lobes.parquet").exists()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "tooth passes every k swings" in page
    assert "1.025" in page  # |µ| of the reference: 1.0254480692


def test_the_drives_and_the_modes_give_way_together(mine: Path) -> None:
    found = fd.workflow.lobes(mine, speeds="9000:11000:2", mode=("922:0.011:0.03993",))
    point = fd.machining.tool_point(fd.read_machine(mine).machine())
    both = point + tool_modes(ToolMode(922, 0.011, 0.03993), ToolMode(922, 0.011, 0.03993, 0.0, 1.0))
    cut = Regeneration(2, 6e8, 2e8, 0.0, 0.5 * np.pi)
    assert found.depth[0] == pytest.approx(stability_lobes(both, cut, [9000]).depth[0], rel=1e-9)
    assert found.own is not None
    assert found.own.speed == 10000.0
    assert found.missed < 1e-3


def test_a_job_and_a_machine_that_was_read_are_taken(mine: Path) -> None:
    job = mine.with_name("job.toml")
    job.write_text(JOB, encoding="utf-8")
    for source in (job, fd.read_job(job), fd.read_machine(mine)):
        found = fd.workflow.lobes(source, rigid=True, mode=("922:0.011:0.03993:x",), speeds="15000:16000:2")
        assert found.depth[0] == pytest.approx(0.2588724931e-3, rel=1e-8)


def test_the_feed_turns_what_gives_way(mine: Path) -> None:
    asked = {"rigid": True, "mode": ("922:0.011:0.03993:x",), "speeds": "15000:16000:2"}
    # along y the mode on x lies across the feed: that is a mode along the normal of up milling, 2.5962383987 mm
    along_y = fd.workflow.lobes(mine, direction=0.5 * np.pi, **asked)
    assert along_y.depth[0] == pytest.approx(2.5962383987e-3, rel=1e-8)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ("no milling_cut among its couplings", ["xy_table"]),
        ("must be first:last:count in rpm", ["--speeds", "5000"]),
        ("must be first:last:count in rpm", ["--speeds", "0:5000:9"]),
        ("must be Hz:damping ratio:kg", ["--mode", "922:0.01"]),
        ("frequency = 0 Hz of a tool mode must be > 0", ["--mode", "0:0.01:1"]),
        ("name the modes of the tool with --mode", ["--rigid"]),
        ("--depth", ["--depth", "0"]),
        ("multiply by 1e6", ["--soft"]),
        ("no such file", ["nothing.toml"]),
    ],
)
def test_what_is_refused(mine: Path, tmp_path: Path, said: str, words: list[str]) -> None:
    if words == ["--soft"]:  # N/mm² in place of N/m²
        mine.write_text(mine.read_text(encoding="utf-8").replace("6e8", "600"), encoding="utf-8")
        words = []
    source = [] if words and not words[0].startswith("--") else [str(mine)]  # or the first word
    out = tmp_path / "out"
    done = runner.invoke(app, ["lobes", *source, *words, "--out", str(out)])
    assert isinstance(done.exception, FeeddriveError), done.output
    assert said in str(done.exception)
    assert not out.exists()
