"""`feeddrive follow` as a user meets it: a log that another process writes, a pipe, and drives over their buses."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bus_bench import in_a_namespace
from falling_drive import BESIDE, FEEDDRIVE, HANGING
from feeddrive.cli.commands import app
from feeddrive.files.read_log import read_log
from feeddrive.language.errors import FeeddriveError
from hal_programs import needs_linuxcnc

KEPT = """follow drive.toml --channel position --level -{fallen} --edge falling --window 0.4 --before 0.4 \\
    --out heard.parquet"""
KILLED = """
{feeddrive} follow drive.toml --channel status --level 1e9 --out never.parquet > killed.txt 2>&1 &
killed=$!
sleep 3
kill -KILL $killed
sleep 1
"""
WRITER = """
import math, time
with open("run.csv", "w") as file:
    file.write("t_s,x_mm,force_N\\n")
    for k in range(3000):
        file.write(f"{k * 1e-3:.3f},{math.sin(k * 0.02):.6f},{5 * math.cos(k * 0.02):.5f}\\n")
        if k % 20 == 0:
            file.flush()
            time.sleep(0.02)
"""


def follow(folder: Path, *words: str, given: str | None = None) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-c", "from feeddrive.cli import main; main()", "follow", *words]
    return subprocess.run(program, cwd=folder, input=given, capture_output=True, text=True, timeout=120, check=False)


def test_the_window_around_the_trigger_is_kept_of_a_log_that_another_process_writes(tmp_path: Path) -> None:
    """Of sin(20 t) at 0.5, rising, with 0.1 s before it: not the first one, whose 0.1 s are not there."""
    (tmp_path / "run.csv").write_text("", encoding="utf-8")
    writer = subprocess.Popen([sys.executable, "-c", WRITER], cwd=tmp_path)
    try:
        words = ("--channel", "x_mm", "--level", "0.5", "--window", "0.2", "--before", "0.5", "--out", "w.parquet")
        done = follow(tmp_path, "run.csv", *words)
    finally:
        writer.kill()
        writer.wait()
    assert done.returncode == 0, done.stderr
    log = read_log(tmp_path / "w.parquet")
    zero = (np.arcsin(0.5) + 2.0 * np.pi) / 20.0
    assert log.time[0] >= -0.1
    assert log.time[-1] <= 0.1
    assert len(log) == pytest.approx(200, abs=1)
    np.testing.assert_allclose(log["x_mm"], np.sin(20.0 * (log.time + zero)), atol=1e-4)  # the instant: to 5e-6 s
    assert dict(log.units) == {"x_mm": "mm", "force_N": "N"}


def test_rows_from_a_pipe_and_what_is_wrong_is_said(tmp_path: Path) -> None:
    rows = "".join(f"{k} {k / 4:f} {k % 3} \n" for k in range(400))
    done = follow(tmp_path, "-", "--window", "0.1", "--sample-time", "1e-3", "--out", "p.parquet", given=rows)
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(np.diff(read_log(tmp_path / "p.parquet")["column_2"]), 0.25)
    for words, reason in (
        (("-", "--window", "0.1"), "has no clock: give the sample time"),
        (("-", "--channel", "column_9"), "there is no channel 'column_9' to trigger by"),
        (
            ("-", "--channel", "column_2", "--level", "-1", "--sample-time", "1e-3"),
            "no window came (the pipe has ended; 400 rows in all)",
        ),
        (("nowhere/run.csv",), "there is no folder nowhere"),
        (("run.csv", "--timeout", "0.2"), "within 0.2 s (waits for the file: it is not there"),
    ):
        refused = follow(tmp_path, *words, "--out", "q.parquet", given=rows)
        assert refused.returncode != 0
        assert reason in refused.stderr, words
    assert not (tmp_path / "q.parquet").exists()


@pytest.mark.parametrize("trigger", [(), ("--channel", "c1", "--level", "0.5", "--before", "0")])
def test_a_window_that_does_not_fit_into_the_memory_is_refused(tmp_path: Path, trigger: tuple[str, ...]) -> None:
    """Of 99 channels 10,000 rows are kept: 10 s at 1 kHz, of which an eighth is spare."""
    heads = ",".join(["t_s", *(f"c{k}" for k in range(99))])
    rows = "".join(f"{k / 1e3:.3f},0,{k % 2}{',0' * 97}\n" for k in range(14_000))
    (tmp_path / "run.csv").write_text(f"{heads}\n{rows}", encoding="utf-8")
    words = ["follow", str(tmp_path / "run.csv"), *trigger, "--timeout", "5", "--out", str(tmp_path / "w.parquet")]
    done = CliRunner().invoke(app, [*words, "--window", "11"])
    assert isinstance(done.exception, FeeddriveError)
    said = "a window of 11 s is longer than what is kept of 99 channels at this rate: make it 8.7 s"
    assert said in str(done.exception)
    assert not (tmp_path / "w.parquet").exists()
    done = CliRunner().invoke(app, [*words, "--window", "8.7"])
    assert done.exit_code == 0, done.output
    log = read_log(tmp_path / "w.parquet")
    assert log.time[-1] - log.time[0] == pytest.approx(8.7, abs=2e-3)


@pytest.mark.parametrize(
    ("drive", "before", "killed", "fallen"),
    [
        ("--interface veth1 --master veth0", "", True, 0.08),
        (
            "--bus canopen --station 9 --interface udp_multicast:239.74.163.2",
            "ip link set lo up; ip route add 239.0.0.0/8 dev lo\n",
            False,
            2e-4,
        ),
    ],
    ids=["ethercat", "canopen"],
)
def test_a_drive_is_sampled_over_its_bus_and_neither_enabled_nor_held(
    tmp_path: Path, drive: str, before: str, killed: bool, fallen: float
) -> None:
    """It falls by Newton all the while: x = -a t²/2 with a = 0.01 m/s², v = -a t; and stays switched off.

    Where one who samples it was killed before, the drive was left in order, or it would be refused to the next one.
    """
    (tmp_path / "hanging.toml").write_text(HANGING, encoding="utf-8")
    command = f"{FEEDDRIVE} {KEPT.format(fallen=fallen)}"
    if killed:
        command = KILLED.format(feeddrive=FEEDDRIVE) + command
    script = before + BESIDE.format(feeddrive=FEEDDRIVE, drive=drive, command=command)
    done = in_a_namespace("bash", "-c", script, cwd=tmp_path)
    assert done.returncode == 0, done.stderr + done.stdout
    assert "last in 'switch on disabled'" in done.stdout
    log = read_log(tmp_path / "heard.parquet")
    assert log.sample_time == 1e-3
    assert len(log) == pytest.approx(400, abs=1)
    # since it began to fall: its time passes with the cycles alone, before and after
    elapsed = log.time + np.sqrt(2.0 * fallen / 0.01)
    # increments of 10 nm; a velocity is a difference over some samples, up to 10 ms old
    np.testing.assert_allclose(log["position"], -0.005 * elapsed**2, atol=0.01 * 1e-3 * 0.6)
    np.testing.assert_allclose(log["velocity"], -0.01 * elapsed, atol=1e-4)
    assert np.ptp(log["force"]) == log["force"][0] == 0.0
    assert np.all(log["status"].astype(int) & 0x4F == 0x40)  # switch on disabled


@needs_linuxcnc
def test_halsampler_of_a_real_linuxcnc_through_a_pipe(tmp_path: Path) -> None:
    """HAL counts periods of 1 ms: the window of numbers of samples around the trigger has each of them once."""
    from feeddrive.export.linuxcnc_session import session

    lines = [
        "loadrt threads name1=servo-thread period1=1000000",
        "loadrt siggen",
        "loadrt sampler depth=4000 cfg=ff",
        "setp siggen.0.frequency 5",
        "setp siggen.0.amplitude 2",
        "net a siggen.0.sine => sampler.0.pin.0",
        "net b siggen.0.cosine => sampler.0.pin.1",
        "addf siggen.0.update servo-thread",
        "addf sampler.0 servo-thread",
        "start",
        "loadusr -w bash sampled.sh",
    ]
    words = "--channel column_2 --level 1 --window 0.3 --sample-time 1e-3 --timeout 20 --out window.parquet"
    out = tmp_path / "run"
    out.mkdir()
    path = ":".join(each for each in sys.path if each)
    (out / "sampled.sh").write_text(
        f"export PYTHONPATH={path} PYTHONDONTWRITEBYTECODE=1\nhalsampler -t -n 2000 | {FEEDDRIVE} follow - {words}\n",
        encoding="utf-8",
    )
    (out / "run.hal").write_text("\n".join(lines) + "\n", encoding="utf-8")
    printed = session(out, [], "halrun -f run.hal")
    log = read_log(out / "window.parquet")
    assert "triggered at" in printed
    assert len(log) == pytest.approx(300, abs=1)
    assert log.time[0] == pytest.approx(-0.06, abs=1e-3)
    turn = 2.0 * np.pi * 5.0 * log.time + np.arcsin(0.5)
    # six decimals; siggen's own phase runs by the measured period; a sample of 1 ms is 0.063
    np.testing.assert_allclose(log["column_2"], 2.0 * np.sin(turn), atol=5e-3)
    np.testing.assert_allclose(log["column_3"], 2.0 * np.cos(turn), atol=5e-3)
