"""Sweeps that are disturbed for real: the rows are those of an undisturbed one, to the last byte of every file."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest

from dask_cluster import DaskCluster, dask_cluster, until
from feeddrive.evaluation.cluster import finished
from feeddrive.language.errors import FileError, ParameterError, WorkerError
from feeddrive.language.progress import Progress
from feeddrive.study.chunk import Chunk
from feeddrive.study.study import Study, read_study
from feeddrive.study.sweep import sweep
from feeddrive.version import __version__

# Good variants; some that cannot be made, since a mode is too fast for the sample time; and, where margins are asked,
# some that are not stable: a gain that is fifty times too high.
POISONED = """
title = "some of them are poisoned"
job = "ball_screw"
sampler = "monte_carlo"
count = {count}
chunk = {chunk}
seed = 3
measure = {measure}
[[vary]]
parameter = "axis.x.plant.mass_load"
nominal_kg = 36
tolerance_kg = 10
[[vary]]
parameter = "axis.x.plant.stiffness"
kind = "discrete"
values = [1.7e7, 1.8e7, 1.9e7, 1e18]
[[vary]]
parameter = "axis.x.control.law.Kv"
kind = "discrete"
values = [40, 41, 42, 2000]
"""


def study_of(folder: Path, count: int, chunk: int, *more: str) -> Path:
    path = folder / "study.toml"
    path.write_text(POISONED.format(count=count, chunk=chunk, measure=["following_error_rms_m", "force_rms_N", *more]))
    return path


def rows(folder: Path) -> dict[str, bytes]:
    return {each.name: each.read_bytes() for each in sorted((folder / "rows").iterdir()) if each.name[0] != "."}


class Watched(Progress):
    """Calls something when so many variants are done."""

    def __init__(self, then: dict[int, object]) -> None:
        super().__init__()
        self.then, self.remarks = then, list[str]()

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        for at in [each for each in self.then if done is not None and done >= each]:
            call = self.then.pop(at)
            assert callable(call)
            call()

    def show_remark(self, said: object) -> None:
        self.remarks.append(str(said))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Path]:
    folder = tmp_path_factory.mktemp("undisturbed")
    study = read_study(study_of(folder, 24, 4))
    sweep(study, folder / "out", workers=1)
    return study, folder / "out"


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Generator[DaskCluster]:
    with dask_cluster(tmp_path_factory.mktemp("cluster"), 2) as found:
        yield found


@pytest.fixture(scope="module")
def mortal(tmp_path_factory: pytest.TempPathFactory) -> Generator[DaskCluster]:
    """A cluster whose two workers are not started again."""
    with dask_cluster(tmp_path_factory.mktemp("mortal"), 2, "--no-nanny") as found:
        yield found


def test_a_worker_is_killed_and_the_rows_are_the_same(
    mortal: DaskCluster, undisturbed: tuple[Study, Path], tmp_path: Path
) -> None:
    study, wanted = undisturbed
    progress = Watched({4: lambda: os.kill(mortal.pids()[0], signal.SIGKILL)})
    found = sweep(study, tmp_path / "out", scheduler=mortal.address, progress=progress)
    assert rows(tmp_path / "out") == rows(wanted)
    assert not progress.then
    reasons = found.store.table(["reason"]).column("reason").to_pylist()
    assert 0 < sum(each is not None for each in reasons) < len(reasons)


def test_an_address_that_nobody_answers_leaves_nothing(undisturbed: tuple[Study, Path], tmp_path: Path) -> None:
    for address, reason in (("nonsense", "missing port number"), ("smoke://127.0.0.1:99", "unknown address scheme")):
        with pytest.raises(ParameterError, match=f"no Dask scheduler answers at '{address}' .{reason}.*dask scheduler"):
            sweep(undisturbed[0], tmp_path / "out", scheduler=address)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("listens", [False, True])
def test_a_port_without_a_scheduler_is_given_up_in_time(undisturbed: tuple[Study, Path], listens: bool) -> None:
    with socket.socket() as other:  # one that listens takes the connection, and never says a word
        other.bind(("127.0.0.1", 0))
        if listens:
            other.listen()
        address = f"tcp://127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(ParameterError, match=f"answers at '{address}' .nothing within 0.5 s"):
            next(finished([Chunk(undisturbed[0], 0)], address, Progress(), timeout=0.5))


def test_a_cluster_with_another_version_is_named(
    mortal: DaskCluster, undisturbed: tuple[Study, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("feeddrive.evaluation.cluster.__version__", "0.0.9")
    said = rf"the scheduler at {mortal.address} has feeddrive {__version__}, and this is 0\.0\.9"
    with pytest.raises(ParameterError, match=said):
        sweep(undisturbed[0], tmp_path / "out", scheduler=mortal.address)
    assert not (tmp_path / "out").exists()


def test_a_disk_that_fills_up_ends_the_sweep_in_order(undisturbed: tuple[Study, Path], tmp_path: Path) -> None:
    study, wanted = undisturbed
    disk = tmp_path / "disk"
    disk.mkdir()
    options = ("-t", "tmpfs", "-o")
    if subprocess.run(["mount", *options, "size=24k", "tmpfs", str(disk)], capture_output=True, check=False).returncode:
        pytest.skip("a small disk (mount -t tmpfs) takes root")
    try:
        with pytest.raises(FileError, match=r"cannot be written: no space left on device; free some space.*--resume"):
            sweep(study, disk / "out", workers=1)
        there = rows(disk / "out")
        assert 0 < len(there) < study.chunks
        assert there.items() <= rows(wanted).items()
        assert not [each for each in (disk / "out" / "rows").iterdir() if each.name[0] == "."]
        subprocess.run(["mount", *options, "remount,size=1m", "tmpfs", str(disk)], check=True)
        sweep(study, disk / "out", workers=1, resume=True)
        assert rows(disk / "out") == rows(wanted)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


REASON = "starts Dask clusters and ends their parts amid sweeps of 20 s"


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A study of 100 chunks and its undisturbed rows."""
    folder = tmp_path_factory.mktemp("long")
    study = study_of(folder, 200, 2, "phase_margin_deg")
    sweep(study, folder / "out", workers=2)
    return study, folder / "out"


@pytest.mark.slow(reason=REASON)
def test_workers_are_killed_five_times(cluster: DaskCluster, long: tuple[Path, Path], tmp_path: Path) -> None:
    study, wanted = long
    draw = random.Random(8)
    kills = list[int]()

    def kill() -> None:
        until(lambda: len(cluster.pids()) == 2)  # the last one that was killed is back
        kills.append(draw.choice(cluster.pids()))
        os.kill(kills[-1], signal.SIGKILL)

    sweep(
        study,
        tmp_path / "out",
        scheduler=cluster.address,
        progress=Watched(dict.fromkeys((4, 40, 80, 120, 160), kill)),
    )
    assert len(set(kills)) == 5
    assert rows(tmp_path / "out") == rows(wanted)


@contextmanager
def client(study: Path, out: Path, address: str, *options: str) -> Generator[subprocess.Popen[str]]:
    """The command, as a process that ends with the block."""
    line = [
        sys.executable,
        "-c",
        "from feeddrive.cli import main; main()",
        "sweep",
        study,
        "--scheduler",
        address,
        "--out",
        out,
        *options,
    ]
    process = subprocess.Popen(list(map(str, line)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def chunks(out: Path) -> int:
    return len(rows(out)) if (out / "rows").exists() else 0


@pytest.mark.slow(reason=REASON)
def test_a_client_that_is_killed_is_resumed(cluster: DaskCluster, long: tuple[Path, Path], tmp_path: Path) -> None:
    study, wanted = long
    out = tmp_path / "out"
    for share in (10, 40, 70):
        with client(study, out, cluster.address, "--resume") as process:
            until(lambda least=share: chunks(out) >= least or process.poll() is not None)
            assert process.poll() is None
    assert chunks(out) < 100
    with client(study, out, cluster.address, "--resume") as process:
        said, _ = process.communicate(timeout=120)
    assert process.returncode == 0, said
    assert rows(out) == rows(wanted)


@pytest.mark.slow(reason=REASON)
def test_ctrl_c_cancels_what_is_handed_out(cluster: DaskCluster, long: tuple[Path, Path], tmp_path: Path) -> None:
    study, wanted = long
    out = tmp_path / "out"
    with client(study, out, cluster.address) as process:
        # the first one: on a busy machine all could be done before the signal arrives
        until(lambda: chunks(out) >= 1 or process.poll() is not None)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=30)
    assert process.returncode == 130, said
    assert "--resume" in said
    with cluster.client() as looking:
        until(lambda: not any(looking.processing().values()))
    kept = rows(out)
    assert kept.items() <= rows(wanted).items()


def with_own_figure(folder: Path, body: str, patch: pytest.MonkeyPatch) -> Study:
    """A study that measures a figure of a module in the folder; two chunks."""
    name = f"figure_{folder.name}"
    (folder / f"{name}.py").write_text(
        f"import os\nfrom feeddrive.figures import Figure\ndef of(statistics): {body}\n"
        "own = Figure('own_N', 'a figure', 'N', 'statistics', of, signals=('force',))\n"
    )
    patch.syspath_prepend(folder)
    return read_study(study_of(folder, 8, 4, "own_N"), allow=[name])


@pytest.mark.slow(reason=REASON)
def test_a_worker_with_another_version_is_named(undisturbed: tuple[Study, Path], tmp_path: Path) -> None:
    other = tmp_path / "other"  # a folder in which nobody is started: Python looks there first
    (other / "feeddrive").mkdir(parents=True)
    (other / "feeddrive" / "__init__.py").touch()
    (other / "feeddrive" / "version.py").write_text("__version__ = '0.0.9'")
    with dask_cluster(tmp_path, 0) as own:
        own.start_workers(1, environment={"PYTHONPATH": str(other)})
        with pytest.raises(ParameterError, match=r"worker tcp://\S+ .*has feeddrive 0\.0\.9, and this is"):
            sweep(undisturbed[0], tmp_path / "out", scheduler=own.address)
    assert not (tmp_path / "out").exists()


def test_a_module_that_the_workers_lack_is_named(
    mortal: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = with_own_figure(tmp_path, "return statistics.rms('force')", monkeypatch)
    with pytest.raises(WorkerError, match=r"chunk \d .*No module named 'figure_.*install on the workers"):
        sweep(study, tmp_path / "out", scheduler=mortal.address)


@pytest.mark.slow(reason=REASON)
def test_a_chunk_that_ends_every_worker_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = with_own_figure(tmp_path, "os._exit(1)", monkeypatch)
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")  # 3 without it, and 16 workers to wait for
    with dask_cluster(tmp_path, 0) as own:
        own.start_workers(2, environment={"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])})
        with pytest.raises(WorkerError, match=r"chunk [01] \(variants \d to \d\) was given up 4 times"):
            sweep(study, tmp_path / "out", scheduler=own.address)


@pytest.mark.slow(reason=REASON)
def test_a_scheduler_that_is_killed_is_named_and_the_sweep_resumed(long: tuple[Path, Path], tmp_path: Path) -> None:
    study, wanted = long
    with dask_cluster(tmp_path, 2) as own:
        progress = Watched({20: lambda: own.scheduler.kill()})
        with pytest.raises(WorkerError, match=f"scheduler at {own.address} is lost"):
            sweep(study, tmp_path / "out", scheduler=own.address, progress=progress)
        before = rows(tmp_path / "out")
        assert 0 < len(before) < 100
        own.scheduler.wait()
        own.start_scheduler()
        own.start_workers(2)
        sweep(study, tmp_path / "out", scheduler=own.address, resume=True)
    assert rows(tmp_path / "out") == rows(wanted)


@pytest.mark.slow(reason=REASON)
def test_a_cluster_without_workers_is_waited_for(long: tuple[Path, Path], tmp_path: Path) -> None:
    study = read_study(study_of(tmp_path, 8, 4))
    with dask_cluster(tmp_path, 0) as own:
        starts = threading.Timer(2.0, own.start_workers, (1,))
        starts.start()
        sweep(study, tmp_path / "out", scheduler=own.address)
        starts.join()
    assert chunks(tmp_path / "out") == 2
