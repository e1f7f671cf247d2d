"""Comparison, benchmark and run on the engine: equal results on cores and on a cluster, and resumed after a stop."""

from __future__ import annotations

import json
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import forked_jobs
from feeddrive.benchmark.benchmark import score
from feeddrive.benchmark.report import summary
from feeddrive.benchmark.rules import read_rules
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.comparison.compare import Comparison, compare_laws
from feeddrive.comparison.report import summary as compared
from feeddrive.evaluation import engine as cores
from feeddrive.evaluation.engine import Engine
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.jobs.run_laws import JobResult, numbers, run_laws
from feeddrive.language.errors import CancelledError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.workflow.benchmark import BenchmarkRequest, benchmark
from feeddrive.workflow.compare import CompareRequest, compare
from feeddrive.workflow.evaluated import engine_of
from feeddrive.workflow.run_job import RunRequest, run

if TYPE_CHECKING:
    from dask_cluster import DaskCluster

SHORT = SnapLimitedMove(
    distance=0.02, velocity=0.2, acceleration=5.0, jerk=400.0, snap=4e4, back=True, dwell_before=0.5, dwell_after=0.2
)
LAWS = ["P-PI + compensator", "DADSC", "LADRC"]
PLANT = "rotary_table"


@pytest.fixture(scope="module", autouse=True)
def _forked() -> Iterator[None]:
    """Cores are processes that are forked with what they need; the tests of the engine have those that begin anew."""
    with forked_jobs.forked(cores):
        yield


def laws(engine: Engine) -> Comparison:
    return compare_laws(read_machine("linear_motor"), laws=LAWS, reference=SHORT, starts=1, engine=engine)


@pytest.fixture(scope="module")
def alone() -> Comparison:
    return laws(Engine())


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Generator[DaskCluster]:
    from dask_cluster import dask_cluster  # takes half a second, which each process of the engine would spend, too

    with dask_cluster(tmp_path_factory.mktemp("cluster"), 2, "--no-nanny") as found:
        yield found


def equal(a: Comparison, b: Comparison) -> None:
    """To the last bit, in all that is written."""
    assert json.dumps(compared(a)) == json.dumps(compared(b))
    assert a.ranking().rows == b.ranking().rows


def test_processes_compare_to_the_same_bits(alone: Comparison) -> None:
    equal(laws(Engine(2)), alone)


@pytest.mark.slow(reason="processes give the same quickly, and the engine on a cluster")
def test_a_cluster_compares_to_the_same_bits(alone: Comparison, cluster: DaskCluster) -> None:
    equal(laws(Engine(scheduler=cluster.address)), alone)


def test_processes_and_a_cluster_score_to_the_same_bits(cluster: DaskCluster) -> None:
    rules = read_rules(1)
    asked: dict[str, Any] = {"plants": [rules.plants[PLANT]], "laws": ["DADSC", "LADRC"]}
    alone = json.dumps(summary(score(rules, **asked)))
    for engine in (Engine(2), Engine(scheduler=cluster.address)):
        assert json.dumps(summary(score(rules, **asked, engine=engine))) == alone


def equal_rows(beside: JobResult, alone: JobResult) -> None:
    """To the last bit, with the signals of all axes."""
    assert beside.remarks == alone.remarks
    for row, other in zip(beside.rows, alone.rows, strict=True):
        assert (row.name, row.description, numbers(row)) == (other.name, other.description, numbers(other))
        assert (row.together is None) == (other.together is None)
        for here, there in ((row.run, other.run), (row.together, other.together)):
            if here is not None and there is not None:
                assert all(np.array_equal(here[name], there[name], equal_nan=True) for name in there.signals)


def test_processes_run_a_job_to_the_same_bits() -> None:
    job = read_job("ball_screw")
    equal_rows(run_laws(job, engine=Engine(2)), run_laws(job))


def test_a_cluster_runs_a_job_of_two_axes_to_the_same_bits(cluster: DaskCluster) -> None:
    """The job has run before: what its machines keep of that does not travel."""
    job = read_job("circle")
    alone = run_laws(job)
    equal_rows(run_laws(job, engine=Engine(scheduler=cluster.address)), alone)


def test_the_command_run_takes_workers_and_counts_its_stages() -> None:
    told = Stopping()
    outcome = run.run(RunRequest("ball_screw", workers=2), told)
    laws = [row.name for row in outcome.result.rows]
    assert {what for what in told.steps if what in laws} == {*laws}
    for law in laws:
        assert f"{law}: the run" in told.steps
    with pytest.raises(ParameterError, match="the scheduler has its own"):
        run.run(RunRequest("ball_screw", workers=2, scheduler="tcp://127.0.0.1:1"), Progress())


class Stopping(Progress):
    """Cancels at a step that begins with some words."""

    def __init__(self, at: str = "never") -> None:
        super().__init__()
        self.at, self.steps = at, list[str]()

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        self.steps.append(what)
        if what.startswith(self.at):
            self.cancel()


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in (".csv", ".json", ".md")}


def test_a_comparison_that_was_stopped_is_resumed(tmp_path: Path) -> None:
    """Stopped after P-PI is tuned: it is not searched again, and the end is that of a comparison never stopped."""
    asked: dict[str, Any] = {"law": ("P-PI + compensator",), "starts": 1, "workers": 1}
    out, beside = tmp_path / "out", tmp_path / "out_cases"
    with pytest.raises(CancelledError, match=r"stopped; finished cases in .*out_cases: 1; go on with --resume"):
        compare.run(CompareRequest("linear_motor", out=out, **asked), Stopping("P-PI: the work"))
    assert [path.name.partition("-")[0] for path in beside.iterdir()] == ["p_pi"]
    assert not out.exists()
    told = Stopping()
    compare.run(CompareRequest("linear_motor", out=out, resume=True, **asked), told)
    assert next(what for what in told.steps if what.startswith("P-PI: ")) == "P-PI: as it was kept"
    assert not beside.exists()  # the report has it all
    told = Stopping()
    compare.run(CompareRequest("linear_motor", out=tmp_path / "never", **asked), told)
    assert "P-PI: as it was kept" not in told.steps
    assert files(out) == files(tmp_path / "never")


def test_ctrl_c_leaves_the_finished_cases_and_says_so(tmp_path: Path) -> None:
    """An interrupt between two looks at the progress is a `KeyboardInterrupt`, which said that nothing was written."""
    out, asked = tmp_path / "out", CompareRequest("linear_motor", out=tmp_path / "out")
    with pytest.raises(KeyboardInterrupt), engine_of(asked, None, out):
        raise KeyboardInterrupt
    kept = tmp_path / "out_cases" / "p_pi-0123456789abcdef.json"
    kept.parent.mkdir()
    kept.write_text("{}", encoding="utf-8")
    with (
        pytest.raises(CancelledError, match=r"stopped; finished cases in .*out_cases: 1; go on with --resume"),
        engine_of(asked, None, out),
    ):
        raise KeyboardInterrupt
    assert kept.exists()


def test_a_stopped_comparison_begins_anew_without_resume(tmp_path: Path) -> None:
    asked: dict[str, Any] = {"law": ("P-PI",), "starts": 1, "workers": 1, "out": tmp_path / "out"}
    with pytest.raises(CancelledError):
        compare.run(CompareRequest("linear_motor", **asked), Stopping("P-PI: the work"))
    told = Stopping()
    compare.run(CompareRequest("linear_motor", **asked), told)
    assert "P-PI: as it was kept" not in told.steps
    with pytest.raises(ParameterError, match="resume: name with --out or --keep"):
        compare.run(CompareRequest("linear_motor", resume=True), Progress())


@pytest.mark.slow(reason="a comparison that is resumed is quick")
def test_a_benchmark_that_was_stopped_is_resumed(tmp_path: Path) -> None:
    asked: dict[str, Any] = {"rules": 1, "plant": (PLANT,), "law": ("DADSC", "LADRC"), "workers": 1}
    out, beside = tmp_path / "out", tmp_path / "out_cases"
    with pytest.raises(CancelledError, match=r"finished cases in .*out_cases: 2; go on with --resume"):
        benchmark.run(BenchmarkRequest(out=out, **asked), Stopping(f"{PLANT}: DADSC"))
    before = {path.name.partition("-")[0] for path in beside.iterdir()}
    assert before == {f"{PLANT}_p_pi", f"{PLANT}_dadsc"}
    benchmark.run(BenchmarkRequest(out=out, resume=True, **asked), Progress())
    assert not beside.exists()
    benchmark.run(BenchmarkRequest(out=tmp_path / "never", **asked), Progress())
    assert files(out) == files(tmp_path / "never")
