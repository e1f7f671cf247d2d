"""The command line as a user meets it: what it writes, and one line for everything that can go wrong."""

from __future__ import annotations

import importlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from feeddrive import cli
from feeddrive.files.read_log import read_log
from feeddrive.language.judgment import Judgment

SHARED = Path(__file__).parents[3] / "shared"
LOG = SHARED / "data" / "emps" / "DATA_EMPS.mat"

MACHINE = """
sample_time_ms = 1.0
[axis.x.plant]
kind = "rigid"
mass = 100
[axis.x.control]
force_limit = 2000
[axis.x.control.law]
kind = "cascade_ppi"
Kv = 40
Kp = 1.0e4
"""
JOB = """
machine = "m.toml"
[reference]
kind = "snap_limited_move"
distance_mm = 10
velocity = 0.1
acceleration = 1
jerk = 50
snap = 5000
"""


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs the command line in a folder of its own: returns exit code, output and errors."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["feeddrive", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return call


def given(machine: str = MACHINE, job: str = JOB) -> None:
    Path("m.toml").write_text(machine, encoding="utf-8")
    Path("j.toml").write_text(job, encoding="utf-8")


def refused(run, *words: str, code: int = 2) -> str:
    """The one line of a refusal; nothing is left behind."""
    before = sorted(Path().rglob("*"))
    ended, _, errors = run(*words)
    assert ended == code, errors
    assert errors.startswith("feeddrive: error: ")
    assert errors.count("\n") == 1, "one line, no traceback"
    assert "Traceback" not in errors
    assert sorted(Path().rglob("*")) == before, "nothing half-written"
    return errors


@pytest.mark.pictures
def test_the_demo_writes_all_it_promises_and_ends_with_the_report(run) -> None:
    code, out, errors = run("demo", "--out", "d")
    assert code == 0, errors
    last = out.strip().splitlines()[-1]
    assert last.startswith("Report: ")
    report = Path(last.removeprefix("Report: "))
    assert report.is_file()
    assert report.stat().st_size < 1_000_000
    summary = json.loads(Path("d/summary.json").read_text(encoding="utf-8"))
    assert set(summary["versions"]) >= {"feeddrive", "python", "numpy", "llvmlite"}
    assert (Path("d") / "job.toml").read_text(encoding="utf-8")
    assert (Path("d") / "machine.toml").read_text(encoding="utf-8")
    laws = summary["laws"]
    assert next(iter(laws)) == "today"
    log = read_log("d/runs/today.parquet")
    # what the table says is what the file holds
    assert np.sqrt(np.mean(log["following_error"] ** 2)) == pytest.approx(
        laws["today"]["following_error_rms_m"], rel=1e-12
    )
    csv = read_log("d/runs/today.csv")
    assert np.array_equal(csv["force"], log["force"]), "CSV and Parquet hold the same bits"


def test_the_written_job_repeats_the_run_to_the_last_bit(run) -> None:
    code, out, _ = run("run", "emps", "--out", "a")
    assert code == 0
    assert "Next: feeddrive tune a/machine.toml" in out
    assert run("run", "a/job.toml", "--out", "b")[0] == 0
    for law in Path("a/runs").glob("*.parquet"):
        assert law.read_bytes() == (Path("b/runs") / law.name).read_bytes()


@pytest.mark.skipif(not LOG.exists(), reason="NOT RUN: DATA_EMPS.mat is not in ../shared")
def test_a_measured_log_is_put_beside_its_prediction(run) -> None:
    code, out, errors = run("run", "emps_log", "--log", str(LOG), "--out", "d")
    assert code == 0, errors
    today = json.loads(Path("d/summary.json").read_text(encoding="utf-8"))["laws"]["today"]
    assert today["position_residual_rms_m"] < 1.3e-6
    assert "predicted - measured" in out
    assert read_log("d/measured.parquet")["position_load"].size == 24841
    assert run("run", "d/job.toml", "--out", "again")[0] == 0
    assert Path("again/runs/today.parquet").read_bytes() == Path("d/runs/today.parquet").read_bytes()


@pytest.mark.parametrize(
    ("machine", "job", "message"),
    [
        (MACHINE.replace("mass = 100", "mass = -3"), JOB, r"m\.toml:5: .*mass = -3 kg .* must be > 0 kg"),
        (MACHINE.replace("mass = 100", "mass = nan"), JOB, r"m\.toml:5: .*mass = nan kg .* must be a finite number"),
        (MACHINE.replace("mass = 100", "maas = 100"), JOB, r"m\.toml:5: .*'axis\.x\.plant\.maas'.*did you mean mass"),
        (MACHINE.replace("mass = 100", "mass_mm = 100"), JOB, r"m\.toml:5: .*mass_mm.*kg"),
        (MACHINE.replace("mass = 100", "mass = 1e400"), JOB, r"m\.toml:5: .*finite"),
        (MACHINE.replace("sample_time_ms = 1.0", ""), JOB, r"m\.toml.*sample_time is missing \(s, "),
        (MACHINE.replace('"rigid"', '"ridgid"'), JOB, r"m\.toml:4: .*'ridgid' is not known; did you mean rigid"),
        (MACHINE, JOB.replace("velocity = 0.1", "velocity = -0.1"), r"j\.toml:6: .*velocity = -0\.1 m/s .* > 0"),
        (MACHINE, JOB.replace("[reference]", "[referense]"), r"j\.toml:3: key 'referense' .* mean reference"),
        (MACHINE, JOB.replace('"m.toml"', '"n.toml"'), r"j\.toml:2: machine: n\.toml"),
        (MACHINE, JOB + '[[law]]\nname = "a"\nset = { "axis.x.control.law.Kx" = 3 }\n', r"j\.toml.*law\.Kx'; did"),
        (MACHINE, JOB + '[[law]]\nname = "a"\nset = { "axis.x.control.law.Kv" = -3 }\n', r"j\.toml.*must be > 0 1/s"),
        (MACHINE, JOB + "seed = 1.5\n", r"j\.toml"),
        (MACHINE, 'machine = "m.toml"\nseed = -1\n' + JOB.split("\n", 2)[2], r"j\.toml:2: seed = -1 .* must be >= 0"),
        (MACHINE + "x = [1,\n", JOB, r"m\.toml:\d+: is not valid TOML"),
    ],
)
def test_a_wrong_file_is_refused_by_file_line_key_value_bound_and_unit(run, machine, job, message) -> None:
    given(machine, job)
    assert re.search(message, refused(run, "run", "j.toml"))


def test_a_loop_that_is_not_stable_is_refused_with_its_frequency(run) -> None:
    given(MACHINE.replace("Kp = 1.0e4", "Kp = 3.0e5"))
    line = refused(run, "run", "j.toml", code=1)
    assert re.search(r"law 'today'.*unstable.*Hz", line)


def test_a_recorded_reference_whose_rows_do_not_fall_on_the_samples(run) -> None:
    job = 'machine = "m.toml"\n[reference]\nkind = "recorded"\nsample_time_ms = 1.5\nposition = [0.0, 1e-4, 2e-4]\n'
    given(job=job)
    line = refused(run, "run", "j.toml")
    assert "0.0015 s" in line
    assert "0.001 s" in line


def test_a_dead_time_longer_than_can_be_simulated_is_refused(run) -> None:
    given(MACHINE + "[axis.x.actuator]\ndead_time = 2.0\n")
    assert "1000 samples" in refused(run, "run", "j.toml")


@pytest.mark.parametrize("content", [b"", b"\x00\x01\x02", b"t,x\n1,2\n", b"PK\x03\x04rubbish"])
def test_a_log_that_is_empty_short_or_of_another_kind(run, content) -> None:
    Path("log.mat").write_bytes(content)
    assert "log.mat" in refused(run, "run", "emps_log", "--log", "log.mat")


def test_a_log_with_a_gap_names_the_row(run) -> None:
    rows = [f"{k * 1e-3:.6f};{k * 1e-4:.7f};{k * 1e-4:.7f};0.0" for k in range(200) if not 100 <= k < 110]
    Path("log.csv").write_text("t;qg;qm;vir\n" + "\n".join(rows) + "\n", encoding="utf-8")
    line = refused(run, "run", "emps_log", "--log", "log.csv")
    assert re.search(r"log\.csv.*(gap|step|jump).*(row|line)|log\.csv.*(row|line).*(gap|step|jump)", line), line


def test_a_log_at_another_rate_than_the_control(run) -> None:
    rows = [f"{k * 2e-3:.6f};{k * 1e-4:.7f};{k * 1e-4:.7f};0.0" for k in range(200)]
    Path("log.csv").write_text("t;qg;qm;vir\n" + "\n".join(rows) + "\n", encoding="utf-8")
    assert "0.002 s" in refused(run, "run", "emps_log", "--log", "log.csv")


def test_a_directory_that_is_not_ours_is_not_replaced(run) -> None:
    given()
    Path("mine").mkdir()
    Path("mine/thesis.txt").write_text("years of work", encoding="utf-8")
    refused(run, "run", "j.toml", "--out", "mine")
    assert Path("mine/thesis.txt").read_text(encoding="utf-8") == "years of work"


def test_a_directory_that_feeddrive_wrote_is_replaced(run) -> None:
    given()
    assert run("run", "j.toml", "--out", "d")[0] == 0
    first = Path("d/summary.json").read_bytes()
    assert run("run", "j.toml", "--out", "d")[0] == 0
    assert Path("d/summary.json").read_bytes() == first


def test_a_place_that_cannot_be_written(run) -> None:
    given()
    Path("file").write_text("", encoding="utf-8")
    assert "file" in refused(run, "run", "j.toml", "--out", "file/d")


@pytest.mark.skipif(sys.platform == "win32", reason="NOT RUN: signals work otherwise on Windows")
def test_a_place_that_cannot_be_written_is_named_before_the_work(run) -> None:
    """The log that is missing is not even looked for."""
    Path("mine").mkdir()
    Path("mine/thesis.txt").write_text("years of work", encoding="utf-8")
    for words in (("frf", "missing.csv"), ("excite", "missing.toml", "--band", "5..50", "--amplitude", "1")):
        assert "mine: exists and was not written by feeddrive" in refused(run, *words, "--out", "mine")


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="NOT RUN: /proc does not tell when the work begins")
def test_ctrl_c_ends_with_one_line_and_nothing_written(tmp_path) -> None:
    command = [sys.executable, "-c", "from feeddrive.cli import main; main()", "run", "emps", "--out", "d"]
    child = subprocess.Popen(
        command,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # ignored by what a background job starts
    )
    until = time.monotonic() + 60.0  # until the work has begun: the compiler of the loop is loaded for it
    while "llvmlite" not in Path(f"/proc/{child.pid}/maps").read_text() and time.monotonic() < until:
        time.sleep(0.01)
    os.killpg(child.pid, signal.SIGINT)
    _, errors = child.communicate(timeout=60)
    if child.returncode == 0:
        pytest.fail("the run was over before it could be stopped")
    assert child.returncode in (130, -signal.SIGINT)
    assert "Traceback" not in errors
    assert not any(tmp_path.iterdir()), "nothing half-written"


@pytest.mark.skipif(os.name != "posix", reason="NOT RUN: a termination is a signal on POSIX only")
def test_a_termination_ends_as_ctrl_c_does(tmp_path) -> None:
    """When files of results are open: the hidden folder that holds them is there."""
    lines = "\n".join(f"X{k % 7} Y{k % 5}" for k in range(20_000))
    (tmp_path / "part.ngc").write_text(f"G64 P0.01\nG1 F1000 X1\n{lines}\nM2\n")
    words = ["plan", "part.ngc", "--machine", "xy_table", "--out", "out"]
    command = [sys.executable, "-c", "from feeddrive.cli import main; main()", *words]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        until = time.monotonic() + 60.0
        while not list(tmp_path.glob(".out.*")) and time.monotonic() < until:
            time.sleep(0.01)
        child.send_signal(signal.SIGTERM)
        _, errors = child.communicate(timeout=60)
    assert errors == "feeddrive: stopped; nothing was written\n"
    assert child.returncode == 130
    assert [each.name for each in tmp_path.iterdir()] == ["part.ngc"]


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("run_job.run_laws", ("demo",)),
        ("frf._read", ("frf", "a.csv")),
        ("excite.design_excitation", ("excite", "emps", "--band", "5..50", "--amplitude", "1")),
        ("tune._tuned", ("tune", "ball_screw")),
        ("reproduce.claims.reproduce", ("reproduce", "all")),
    ],
)
def test_ctrl_c_within_a_command_says_that_it_stopped(run, monkeypatch, place, words) -> None:
    def stopped(*_args: object, **_options: object) -> None:
        raise KeyboardInterrupt

    module, *parts, name = place.split(".")
    holder: object = importlib.import_module(f"feeddrive.workflow.{module}")
    for part in parts:
        holder = getattr(holder, part)
    monkeypatch.setattr(holder, name, stopped)
    code, _, errors = run(*words)
    assert (code, errors) == (130, "feeddrive: stopped; nothing was written\n")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="NOT RUN: there is no /dev/full to stand for a full disk")
def test_a_full_disk_is_named(run, monkeypatch) -> None:
    from feeddrive.workflow import run_job

    given()
    whole = run_job.write_run_csv

    def full(path, *rest) -> None:
        with open("/dev/full", "w") as disk:
            disk.write("x" * 100_000)
        whole(path, *rest)

    monkeypatch.setattr(run_job, "write_run_csv", full)
    assert "no space left" in refused(run, "run", "j.toml", "--out", "d")


def test_a_row_that_says_nothing_of_the_guard_keeps_it(run) -> None:
    guard = "[axis.x.control.guard]\nfollowing_error_limit = 1e-9\n"
    machine = MACHINE.replace("[axis.x.control.law]", guard + "[axis.x.control.law]")
    law = '[[law]]\nname = "b"\n[law.control.law]\nkind = "cascade_ppi"\nKv = 50\nKp = 1.0e4\n'
    given(machine, JOB + law)
    code, out, errors = run("run", "j.toml", "--out", "d")
    assert (code, errors) == (1, f"feeddrive: {Judgment.TRIPPED.says}\n")
    assert "'today': the guard tripped" in out
    assert "'b': the guard tripped" in out
    assert np.max(np.abs(read_log("d/runs/b.parquet")["force"])) <= 2000.0


@pytest.mark.parametrize(("old", "new"), [("mass = 100", "mass = 1e-300"), ("Kp = 1.0e4", "Kp = 1e300")])
def test_absurd_numbers_end_in_one_line(run, old, new) -> None:
    given(MACHINE.replace(old, new))
    code, _, errors = run("run", "j.toml")
    assert code in (1, 2)
    assert errors.startswith("feeddrive: error: ")
    assert errors.count("\n") == 1
    assert "law 'today'" in errors


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("current_loop_kHz = 1e6", "current_loop = 1e\\+09 Hz is over within a substep of 0.001 s: leave it out"),
        ("dead_time = 1e-3\n[axis.x.friction_load]\nkind = 'viscous'\nviscous = 1e12", "fastest motion dies out in"),
    ],
)
def test_an_axis_far_too_fast_for_its_substeps_is_refused(run, text, message) -> None:
    given(MACHINE + "[axis.x.actuator]\n" + text + "\n")
    assert re.search(message, refused(run, "run", "j.toml"))


def test_names_with_brackets_are_shown_as_they_are(run) -> None:
    given(job='title = "what [/red] x"\n' + JOB + '[[law]]\nname = "x [/b]"\nset = { "axis.x.control.law.Kv" = 41 }\n')
    code, out, errors = run("run", "j.toml", "--out", "d")
    assert code == 0, errors
    assert "what [/red] x" in out
    assert "x [/b]" in out


def test_help_names_every_command(run) -> None:
    code, out, _ = run("--help")
    assert code == 0
    for command in ("run", "demo"):
        assert re.search(rf"^\W*{command}\b", out, re.MULTILINE)


def test_an_unknown_command_is_refused(run) -> None:
    code, _, errors = run("tume")
    assert code == 2
    assert "Traceback" not in errors
