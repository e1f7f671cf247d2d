"""Sweeps: rows do not depend on chunks, workers, neighbors or interruptions; a bad variant is a row with its reason."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as arrow
import pytest

from feeddrive.figures.of_loops import LinearLoop
from feeddrive.files.machine import BUNDLED
from feeddrive.language.errors import CancelledError, FileError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.hold import Timing
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Batch, simulate, simulate_batch
from feeddrive.study.chunk import run_chunk
from feeddrive.study.study import Study, read_study
from feeddrive.study.sweep import sweep
from feeddrive.study.variants import variant_groups, variants
from feeddrive.workflow.sweep import SweepRequest
from feeddrive.workflow.sweep import sweep as command

# Kp up to 60 times leaves the bounds, dry friction above 110 N is more than the breakaway force, which its block
# refuses, and the dead time crosses a sample of 50 us, which is another graph.
STUDY = """
title = "Small"
machine = "free.toml"
count = 40
chunk = 16
seed = 3
measure = [{measure}]

[reference]
kind = "snap_limited_move"
distance_mm = 1
velocity = 0.1
acceleration = 5
jerk = 800
snap = 2e5
dwell_after = 0.02

[[vary]]
scale = ["axis.x.control.law.Kp"]
name = "gain"
kind = "loguniform"
least = 0.5
most = 60

[[vary]]
parameter = "axis.x.friction_motor.coulomb"
least_N = 50
most_N = 115

[[vary]]
parameter = "axis.x.actuator.dead_time"
least_us = 30
most_us = 90
"""
STATISTICS = '"following_error_rms_m", "force_peak_N"'


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return read(tmp_path, STATISTICS)


def read(folder: Path, measure: str) -> Study:
    machine = (BUNDLED / "machines/ball_screw.toml").read_text(encoding="utf-8")
    for limit in (r"\[axis\.x\.actuator\.motor\][^[]*", r"\[axis\.x\.control\.guard\][^[]*", r"force_limit_N = .*\n"):
        machine, count = re.subn(limit, "", machine)
        assert count == 1  # without limits an unstable loop leaves its bounds
    (folder / "free.toml").write_text(machine, encoding="utf-8")
    file = folder / "small.toml"
    file.write_text(STUDY.format(measure=measure), encoding="utf-8")
    return read_study(file)


def rows(study: Study) -> arrow.Table:
    return arrow.concat_tables([run_chunk(study, number) for number in range(study.chunks)])


def test_rows_are_those_of_each_variant_alone(study) -> None:
    """Each good row has the bits of a single run, whatever the size of the chunks and the threads."""
    found = rows(study)
    assert found.equals(rows(replace(study, chunk=7)))
    assert found.equals(rows(replace(study, chunk=1)))
    assert found.equals(run_chunk(replace(study, chunk=study.count), 0, threads=2))
    assert found.column("variant").to_pylist() == list(range(study.count))
    row = {each["variant"]: each for each in found.to_pylist()}
    seen = set[int]()
    for group in variant_groups(study, variants(study)):
        for place, variant in enumerate(group.rows.tolist()):
            if row[variant]["reason"] is None:
                run = simulate(group.one(place), group.references, seed=int(group.seed[place]))
                error = run["following_error"]
                assert row[variant]["force_peak_N"] == np.max(np.abs(run["force"]))
                # the sum of squares is taken in another order: n rounding errors of 1e-16
                assert row[variant]["following_error_rms_m"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
                seen.add(group.one(place).timing().whole)
    assert seen == {0, 1}


def test_a_bad_variant_is_a_row_with_its_reason(study) -> None:
    """What a block refuses and what leaves its bounds has a reason and no figure; the others have figures."""
    found = rows(study).to_pylist()
    for each in found:
        bad = each["reason"] is not None
        assert all((each[name] is None) == bad for name in ("following_error_rms_m", "force_peak_N"))
        refused = each["axis.x.friction_motor.coulomb"] > 110.0
        assert not refused or "axis.x.friction_motor" in each["reason"]
        assert "left its bounds at sample" in each["reason"] if bad and not refused else True
    reasons = [each["reason"] for each in found if each["reason"]]
    assert any("left its bounds" in each for each in reasons)
    assert any("breakaway" in each for each in reasons)
    assert len(reasons) < 0.75 * len(found)


def test_each_structure_is_one_batch(tmp_path, monkeypatch) -> None:
    """One, one and a half and two samples of dead time are three graphs: three batches, and the bits of single runs."""
    text = read(tmp_path, STATISTICS).text
    uniform = "least_us = 30\nmost_us = 90"
    assert uniform in text
    text = text.replace(uniform, 'kind = "discrete"\nvalues = [5e-5, 7.5e-5, 1e-4]').replace("most = 60", "most = 1.1")
    (tmp_path / "small.toml").write_text(text.replace("chunk = 16", "chunk = 40"), encoding="utf-8")
    study, batches = read_study(tmp_path / "small.toml"), list[Timing]()

    def counted(system: Loop, *args: Any, **kwargs: Any) -> Batch:
        batches.append(system.timing())
        return simulate_batch(system, *args, **kwargs)

    monkeypatch.setattr("feeddrive.study.chunk.simulate_batch", counted)
    found = rows(study)
    assert sorted(batches) == [Timing(1, False), Timing(1, True), Timing(2, False)]
    assert found.equals(rows(replace(study, chunk=1)))


def test_workers_change_nothing_and_a_sweep_goes_on(study, tmp_path) -> None:
    """The files of one worker and of three are equal to the byte; what is missing is computed again, and only that."""
    first = sweep(study, tmp_path / "one", workers=1)
    second = sweep(study, tmp_path / "three", workers=3)
    assert first.ran == study.count
    assert first.bad == second.bad
    assert first.bad[0] == sum(each is not None for each in rows(study).column("reason").to_pylist())
    files = sorted((tmp_path / "one" / "rows").iterdir())
    assert len(files) == study.chunks
    for file in files:
        assert file.read_bytes() == (tmp_path / "three" / "rows" / file.name).read_bytes()
    kept = files[1].read_bytes()
    files[1].unlink()
    with pytest.raises(FileError, match="--resume"):
        sweep(study, tmp_path / "one")
    again = sweep(study, tmp_path / "one", resume=True)
    assert again.ran == len(study.range(1))
    assert files[1].read_bytes() == kept


class Ended(Progress):
    """Cancels when a number of variants is done, or at a step of a name."""

    def __init__(self, after: int, at: str = "") -> None:
        super().__init__()
        self.after, self.at, self.said = after, at, list[tuple[str, Any, Any]]()

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        self.said.append((what, done, of))
        if what == self.at or (done is not None and done >= self.after):
            self.cancel()


def test_a_cancel_keeps_what_is_done(study, tmp_path) -> None:
    """After a cancel the chunks that are done are there, the message says so, and the rest follows with `resume`."""
    ended = Ended(10)
    with pytest.raises(CancelledError, match=r"stopped; 16 of 40 variants are in .*: go on with --resume"):
        sweep(study, tmp_path / "out", workers=1, progress=ended)
    what, done, of = ended.said[-1]
    assert (done, of) == (16, 40)
    assert "a second" in what
    assert "left" in what
    whole = sweep(study, tmp_path / "out", resume=True)
    assert whole.ran == 24
    assert whole.store.table().equals(rows(study))


def test_a_cancel_before_the_report_says_that_the_rows_are_there(study, tmp_path) -> None:
    """What is stopped between rows and report has all rows."""
    out = tmp_path / "out"
    request = SweepRequest(study, out=out, workers=1)
    with pytest.raises(CancelledError, match=r"stopped; all rows are in .*: --resume makes the report"):
        command.run(request, Ended(study.count + 1, "answers"))
    assert len(list((out / "rows").iterdir())) == study.chunks
    assert not (out / "report.html").exists()


def test_figures_of_one_variant_need_processes_and_are_those_of_this_one(tmp_path) -> None:
    """Linear models and runs are computed in processes, to the bits that this process computes."""
    study = read(tmp_path, '"sensitivity_peak", "stiffness_35_Hz_N_per_m", "limited_share", "force_peak_N"')
    found = sweep(study, tmp_path / "out", workers=2).store.table()
    assert found.equals(rows(study))
    row = found.to_pylist()
    assert any("not stable" in (each["reason"] or "") for each in row)
    group = next(variant_groups(study, variants(study)))
    good = next(place for place, variant in enumerate(group.rows.tolist()) if row[variant]["reason"] is None)
    linear = LinearLoop(group.loop(good), group.speed)
    assert row[int(group.rows[good])]["sensitivity_peak"] == linear.margins.sensitivity_peak


def test_impossible_workers_are_refused(study, tmp_path) -> None:
    with pytest.raises(ParameterError, match="workers = 0 must be 1 to 1024"):
        sweep(study, tmp_path / "out", workers=0)
    assert not (tmp_path / "out").exists()
