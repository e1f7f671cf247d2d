"""Sweeps on this machine that are disturbed for real: killed processes, a killed client, Ctrl-C, memory."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from feeddrive.language.errors import WorkerError
from feeddrive.language.progress import Progress
from feeddrive.study.study import Study, read_study
from feeddrive.study.sweep import sweep
from small_study import small_study

MODEL = '"sensitivity_peak", "stiffness_least_N_per_m"'
DEADLY = """
import os, signal
from feeddrive.figures import Figure

def of(run):
    os.kill(os.getpid(), signal.SIGKILL)

deadly = Figure("deadly", "ends the process that computes it", "", "run", of)
"""
REASON = "each process takes a second to begin"


def file(folder: Path, count: int, chunk: int, measure: str) -> Path:
    found = folder / "small.toml"
    found.write_text(small_study(count=count, chunk=chunk, measure=measure), encoding="utf-8")
    return found


def study(folder: Path, count: int, chunk: int, measure: str) -> Study:
    return read_study(file(folder, count, chunk, measure))


def rows(out: Path) -> dict[str, bytes]:
    place = out / "rows"
    return {each.name: each.read_bytes() for each in place.iterdir() if each.name[0] != "."} if place.is_dir() else {}


def until(true: Callable[[], bool], seconds: float = 60.0) -> None:
    ends = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < ends
        time.sleep(0.02)


class Killer(Progress):
    """Kills one of the processes when so many variants are done, once for each number."""

    def __init__(self, *when: int) -> None:
        super().__init__()
        self.when, self.killed = list(when), list[int]()

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        if self.when and done is not None and done >= self.when[0]:
            self.when.pop(0)
            child = multiprocessing.active_children()[0]
            assert child.pid is not None
            os.kill(child.pid, signal.SIGKILL)
            self.killed.append(child.pid)


@pytest.mark.slow(reason=REASON)
def test_killed_processes_are_replaced(tmp_path) -> None:
    """Two of the processes are killed, and the rows are those of a sweep that nothing disturbed."""
    given = study(tmp_path, 48, 4, MODEL)
    killer = Killer(8, 24)
    sweep(given, tmp_path / "disturbed", workers=2, progress=killer)
    assert len(set(killer.killed)) == 2
    sweep(given, tmp_path / "whole", workers=1)
    assert rows(tmp_path / "disturbed") == rows(tmp_path / "whole")


@pytest.mark.slow(reason=REASON)
def test_a_variant_that_kills_every_process_is_named(tmp_path, monkeypatch) -> None:
    """After four losses in a row the sweep gives up, and says at which chunks."""
    (tmp_path / "deadly_figures.py").write_text(DEADLY, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    given = read_study(file(tmp_path, 4, 4, '"deadly"'), ["deadly_figures"])
    with pytest.raises(
        WorkerError, match=r"killed 4 times in a row, at chunk 0 \(variants 0 to 3\): .* nothing was written"
    ):
        sweep(given, tmp_path / "out", workers=1)


def client(path: Path, out: Path, *options: str) -> subprocess.Popen[str]:
    """The command as a process with a group of its own, which Ctrl-C may end whatever began the tests."""
    main = "from feeddrive.cli import main; main()"
    line = [sys.executable, "-c", main, "sweep", str(path), "--workers", "2", "--out", str(out), *options]
    return subprocess.Popen(
        line,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def processes(group: int) -> int:
    """How many processes there are in a group."""
    found = 0
    for each in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, of = each.read_text().rpartition(")")[2].split()[:3]
        except OSError:  # it has just ended
            continue
        found += int(of) == group and state != "Z"
    return found


@pytest.mark.slow(reason=REASON)
@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_a_client_that_ends_is_resumed(tmp_path, ending) -> None:
    """Killed or stopped, it leaves whole chunks and no process; --resume comes to the same files."""
    path, out = file(tmp_path, 96, 4, MODEL), tmp_path / "out"
    process = client(path, out)
    until(lambda: len(rows(out)) >= 3)
    if ending == signal.SIGINT:
        os.killpg(process.pid, ending)  # as a terminal does: to the processes, too
    else:
        process.send_signal(ending)
    said, _ = process.communicate(timeout=30)
    if ending != signal.SIGKILL:
        assert process.returncode == 130, said
        assert said.startswith("feeddrive: stopped; "), said
        assert "of 96 variants are in" in said
        assert "--resume" in said
    until(lambda: processes(process.pid) == 0)
    kept = rows(out)
    assert 3 <= len(kept) < 24
    process = client(path, out, "--resume")
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 0, said
    sweep(read_study(path), tmp_path / "whole", workers=2)
    assert rows(out) == rows(tmp_path / "whole")
    assert kept.items() <= rows(out).items()


MEASURED = """
import resource, sys
from feeddrive.study import read_study
from feeddrive.study.sweep import sweep
sweep(read_study(sys.argv[1]), sys.argv[2], workers=2)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


@pytest.mark.slow(reason="30,000 variants, in a process of their own")
def test_memory_does_not_grow_with_the_variants(tmp_path) -> None:
    """Ten times the variants take at most 15 MB more: what fragments of the arrays of chunks leave."""
    peaks = []
    for count in (3_000, 30_000):
        path, out = file(tmp_path, count, 250, '"following_error_rms_m"'), tmp_path / f"out{count}"
        done = subprocess.run([sys.executable, "-c", MEASURED, path, out], capture_output=True, text=True, check=True)
        peaks.append(float(done.stdout))
    assert peaks[1] - peaks[0] < 15.0, peaks
