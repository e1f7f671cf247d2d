"""`feeddrive virtual-drive`, `play` and `listen` as a user meets them, and the walk: excite, play, frf, identify."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bus_bench import in_a_namespace
from feeddrive import cli
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.three_mass_chain import ThreeMassChain
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.files.machine import read_machine
from feeddrive.files.read_log import read_log
from feeddrive.loop.simulate import simulate

FEEDDRIVE = f"{sys.executable} -c 'from feeddrive.cli import main; main()'"
# a virtual drive, and a master beside it as soon as it is ready; the drive is ended as a user would end it
WALK = """
set -e
: > ready.txt
{feeddrive} virtual-drive {machine} {drive} --drive-file drive.toml > ready.txt 2>&1 &
served=$!
trap 'kill -KILL $served 2>/dev/null || true' EXIT
for attempt in $(seq 300); do grep -q Ready ready.txt && break; sleep 0.1; done
{commands}
kill -INT $served
wait $served
"""
EXCITED = ("--band", "2..100", "--amplitude", "20")


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs `feeddrive` in an empty folder: exit code, output, errors."""
    monkeypatch.chdir(tmp_path)

    def asked(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["feeddrive", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return asked


def beside(
    tmp_path: Path, machine: str, drive: str, *commands: str, before: str = "", timeout: float = 240.0
) -> subprocess.CompletedProcess[str]:
    """Commands of feeddrive beside a virtual drive, in a network namespace of their own."""
    lines = "\n".join(f"{FEEDDRIVE} {each}" for each in commands)
    script = before + WALK.format(feeddrive=FEEDDRIVE, machine=machine, drive=drive, commands=lines)
    return in_a_namespace("bash", "-c", script, timeout=timeout, cwd=tmp_path)


def mass_of(path: Path) -> tuple[float, float]:
    """The mass that was identified, and its standard error, from the machine file that `identify` wrote."""
    line = next(line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("mass = "))
    return float(line.split()[2]), float(line.split("standard error ")[1].split()[0])


@pytest.mark.slow(reason="three commands and a bus of two drives: 20 s")
def test_a_plan_is_played_on_all_axes_of_a_segment(call, tmp_path: Path) -> None:
    """Setpoints of the plan reach both drives, rounded to their increments, in the same cycles; the axes follow."""
    (tmp_path / "part.ngc").write_text("G64 P0.05\nG1 X12 F6000\nG1 Y-9\nX0 Y0\nM2\n", encoding="utf-8")
    assert call("plan", "part.ngc", "--machine", "xy_table", "--out", "plan")[0] == 0
    play = "play plan --drive drive_x.toml --drive drive_y.toml --unpaced --out measured"
    done = beside(tmp_path, "xy_table", "--interface veth1 --master veth0", play)
    assert done.returncode == 0, done.stderr + done.stdout
    sent = read_log("plan/setpoints.parquet")
    for axis, reach in (("x", 12e-3), ("y", -9e-3)):
        log = read_log(f"measured/measured_{axis}.parquet")
        assert len(log) == len(sent)
        assert np.max(np.abs(log["set_position"] - sent[f"{axis}.set_position"])) <= 0.5e-7
        farthest = log["reading_load"][np.argmax(np.abs(log["reading_load"]))]
        assert farthest == pytest.approx(reach, abs=1e-4)


def test_a_plan_needs_a_drive_for_each_axis(call, tmp_path: Path) -> None:
    """Nothing reaches the bus: missing, strange and doubled axes, several buses, share of a plan."""
    (tmp_path / "part.ngc").write_text("G1 X12 Y3 F6000\nM2\n", encoding="utf-8")
    assert call("plan", "part.ngc", "--machine", "xy_table", "--out", "plan")[0] == 0
    drive = """{}bus = "{}"
interface = "nothing"
cycle_time_us = 250
[scaling]
increment_um = 0.1
rated_force = 300
[limits]
travel_mm = {}
velocity = 1
force = 1000
following_error_mm = 5
"""
    for name, axis, bus, travel in (
        ("x", "x", "ethercat", 100),
        ("y", "y", "ethercat", 100),
        ("z", "z", "ethercat", 100),
        ("c", "y", "canopen", 100),
        ("n", "", "ethercat", 100),
        ("s", "y", "ethercat", 1),
    ):
        text = drive.format(f'axis = "{axis}"\n' if axis else "", bus, travel)
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    for drives, said in (
        ("x", "there is no drive for y"),
        ("xyz", "there is no axis z"),
        ("xx", "names an axis of its own"),
        ("xc", "on drives of one EtherCAT segment"),
        ("xn", "names an axis of its own"),
        ("xs", "limits.travel"),
        ("xy", "interface 'nothing' is not there"),
    ):
        code, _, error = call(
            "play", "plan", "--yes", *(each for name in drives for each in ("--drive", f"{name}.toml"))
        )
        assert (code, said in error) == (2, True), (drives, error)
    code, _, error = call("play", "plan", "--yes", "--share", "0.5", "--drive", "x.toml")
    assert "a plan is played as it was proven" in error
    code, _, error = call("play", "plan/setpoints.parquet", "a.csv", "--drive", "x.toml", "--drive", "y.toml")
    assert "2 drive files are given" in error


@pytest.mark.slow(reason="six commands and a bus; a move is played over it quickly")
def test_excite_play_frf_identify_gives_the_mass_back(call, tmp_path: Path) -> None:
    """EMPS over EtherCAT: 95.154 kg within four of its own standard errors, and they are under a thousandth."""
    assert call("excite", "emps", *EXCITED, "--out", "sent")[0] == 0
    play = "play sent/excitation_1.csv sent/excitation_2.csv --drive drive.toml --unpaced --out measured"
    done = beside(tmp_path, "emps", "--interface veth1 --master veth0", play)
    assert done.returncode == 0, done.stderr + done.stdout
    assert "feeddrive virtual drive" in done.stdout
    assert "switch on disabled" in (tmp_path / "ready.txt").read_text().splitlines()[-1]
    log = read_log("measured/measured_1.parquet")
    sent = read_log("sent/excitation_1.csv")
    assert len(log) == len(sent)
    assert np.array_equal(log["excitation"], sent["excitation"])
    assert log.units == {
        "set_position": "m",
        "excitation": "N",
        "force": "N",
        "reading_load": "m",
        "velocity_load": "m/s",
    }
    assert log.provenance["origin"]["bus"] == "EtherCAT veth0, station 1"
    assert call("frf", "measured/measured_1.parquet", "measured/measured_2.parquet", "--out", "response")[0] == 0
    code, out, err = call("identify", "response/frf.csv", "--machine", "emps", "--out", "model")
    assert code == 0, err
    assert "rigid" in out
    mass, error = mass_of(tmp_path / "model" / "machine.toml")
    assert error < 1e-3 * mass
    assert abs(mass - 95.1540) < 4.0 * error


@pytest.mark.slow(reason="370 000 bus cycles")
@pytest.mark.timeout(1200)  # 370 000 cycles; a busy machine needs minutes
def test_the_afternoon_with_two_encoders_gives_the_masses_back(call, tmp_path: Path) -> None:
    """The ball screw at 20 kHz over EtherCAT: screw and table by both encoders, the motor by its data sheet."""
    assert call("excite", "ball_screw", "--band", "5..1000", "--amplitude", "400", "--out", "sent")[0] == 0
    play = "play sent/excitation_1.csv sent/excitation_2.csv --drive drive.toml --unpaced --out measured"
    done = beside(tmp_path, "ball_screw", "--interface veth1 --master veth0", play, timeout=900.0)
    assert done.returncode == 0, done.stderr + done.stdout
    assert call("frf", "measured/measured_1.parquet", "measured/measured_2.parquet", "--out", "response")[0] == 0
    code, out, err = call(
        "identify", "response/frf.csv", "--machine", "ball_screw", "--out", "model", "--fix", "mass_motor=85"
    )
    assert code == 0, err + out
    axis = read_machine("model/machine.toml").loop(None).axis
    plant = axis.plant
    assert isinstance(plant, ThreeMassChain)
    # a thousandth is more than the noise leaves, and a sample of misalignment would show in the dead time first
    assert plant.mass_screw == pytest.approx(45.0, rel=1e-3)
    assert plant.mass_load == pytest.approx(33.0, rel=1e-3)
    assert plant.stiffness == pytest.approx(18e6, rel=1e-3)
    assert axis.actuator.dead_time == pytest.approx(50e-6, abs=0.2e-6)


@pytest.mark.slow(reason="two processes that move an axis in real time")
def test_over_canopen_between_processes(call, tmp_path: Path) -> None:
    """The same profile over UDP multicast in a namespace of its own, and a log of the drive at rest after it."""
    assert (
        call(
            "excite",
            "emps",
            "--band",
            "10..100",
            "--amplitude",
            "20",
            "--resolution",
            "10",
            "--periods",
            "2",
            "--realisations",
            "1",
            "--out",
            "sent",
        )[0]
        == 0
    )
    done = beside(
        tmp_path,
        "emps",
        "--bus canopen --station 9 --interface udp_multicast:239.74.163.2",
        "play sent/excitation_1.csv --drive drive.toml --unpaced --out measured",
        "listen --drive drive.toml --unpaced --seconds 0.1 --out heard",
        before="ip link set lo up; ip route add 239.0.0.0/8 dev lo\n",
    )
    assert done.returncode == 0, done.stderr + done.stdout
    log = read_log("measured/measured_1.parquet")
    assert len(log) == len(read_log("sent/excitation_1.csv"))
    # what `excite` simulated, but for the rounding of increments and thousandths
    simulated = read_log("sent/simulated_1.parquet")
    assert np.max(np.abs(log["reading_load"] - simulated["reading_load"])) < 2e-6
    heard = read_log("heard/measured_1.parquet")
    assert len(heard) == 100
    assert np.ptp(heard["reading_load"]) == 0.0


# waits until a play drives the interface
CLAIMED = """
import socket, time
for _ in range(400):
    try:
        socket.socket(socket.AF_UNIX).connect("\\0feeddrive play {name}")
        break
    except OSError:
        time.sleep(0.05)
"""
# a play is held up in motion for a second and as long as another one takes to be refused; a third loses its cable
ATTACK = """
sed -i 's/^late_cycles.*/late_cycles = 300\\nlost_frames = 50\\nwatchdog_ms = {watchdog}/' drive.toml
attack() {{
    : > said.txt
    {feeddrive} play sent.csv --drive drive.toml --yes --reset-fault --out $1 > said.txt 2>&1 &
    played=$!
    {python} -S claimed.py
    sleep 3
}}
attack first
kill -STOP $played; sleep 1
{second}
kill -CONT $played
wait $played && echo "played to its end" || echo "ended with $?"
cat said.txt
attack third
{pulled}
began=$(date +%s%N)
wait $played && echo "played to its end" || echo "ended with $?"
echo "after $((($(date +%s%N) - began) / 1000000)) ms"
cat said.txt
{mended}
"""


def attacked(tmp_path: Path, bus: str, watchdog: int) -> tuple[str, str]:
    """What was said of the play that was held up, with another one meanwhile, and of that whose cable was pulled."""
    t = np.arange(12_000) * 1e-3
    s = t / t[-1]
    rows = np.column_stack([t, 0.05 * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)])
    np.savetxt(tmp_path / "sent.csv", rows, delimiter=",", header="time [s],set_position [m]", comments="", fmt="%.9f")
    name = {"ethercat": "veth0", "canopen": "udp_multicast:239.74.163.2"}[bus]
    (tmp_path / "claimed.py").write_text(CLAIMED.format(name=name))
    words = {
        "ethercat": ("--interface veth1 --master veth0", "ip link set veth0 down", "ip link set veth0 up", ""),
        "canopen": (
            "--bus canopen --station 9 --interface udp_multicast:239.74.163.2",
            "kill -STOP $served",
            "kill -CONT $served",
            "ip link set lo up; ip route add 239.0.0.0/8 dev lo\n",
        ),
    }[bus]
    second = f"{FEEDDRIVE} play sent.csv --drive drive.toml --yes --out second 2>&1 && exit 9 || true"
    script = words[3] + WALK.format(
        feeddrive=FEEDDRIVE,
        machine="emps",
        drive=words[0],
        commands=ATTACK.format(
            feeddrive=FEEDDRIVE,
            python=sys.executable,
            watchdog=watchdog,
            second=second,
            pulled=words[1],
            mended=words[2],
        ),
    )
    done = in_a_namespace("bash", "-c", script, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    held, _, pulled = done.stdout.partition("after ")
    return held, pulled


@pytest.mark.slow(reason="four processes and two motions by the clock: 64 s beside much other work")
@pytest.mark.parametrize("bus", ["ethercat", "canopen"])
def test_a_play_that_is_held_up_stops_and_one_without_cable_ends(tmp_path: Path, bus: str) -> None:
    """SIGSTOP for 1 s in motion; a second play meanwhile; a pulled cable (CANopen: a drive that falls silent)."""
    held, pulled = attacked(tmp_path, bus, watchdog=5000)
    assert "the interface is driven by another feeddrive (process" in held
    assert not (tmp_path / "second").exists()
    assert "ended with 1" in held
    assert "late_cycles = 300 of the drive file" in held
    assert (tmp_path / "first" / "aborted_1.parquet").is_file()
    # 2.2 s on two busy cores, most of it for the log; 29 s when every frame of a stop was waited for
    assert int(pulled.split()[0]) < 10_000  # ms: a machine that does much else needs longer
    assert "50 frames in a row were lost: it does not answer" in pulled
    assert "its own watchdog must do it" in pulled


@pytest.mark.slow(reason="four processes and two motions, once more with a short watchdog")
@pytest.mark.parametrize(
    ("bus", "left"), [("ethercat", "Sync manager watchdog (0x001B)"), ("canopen", "it may have left OPERATIONAL")]
)
def test_the_drive_stops_by_itself_when_its_master_is_held_up(tmp_path: Path, bus: str, left: str) -> None:
    """The watchdog that was set at the start is shorter than the second for which the master stands still."""
    held, _ = attacked(tmp_path, bus, watchdog=500)
    assert "ended with 1" in held
    assert "late_cycles = 300 of the drive file" in held
    assert left in held


def test_the_move_of_a_job_is_played_as_it_was_simulated(call, tmp_path: Path) -> None:
    """EMPS with friction under today's control, which the virtual drive has inside, too.

    Against a simulation of the rounded setpoints there is no difference but of rounding; against the job's own run the
    axis may stick elsewhere in the zone in which friction holds it, F/(Kp Kv) to both sides.
    """
    assert call("demo", "--out", "demo")[0] == 0
    done = beside(
        tmp_path,
        "emps",
        "--interface veth1 --master veth0",
        "play demo/runs/today.csv --drive drive.toml --unpaced --out measured",
    )
    assert done.returncode == 0, done.stderr + done.stdout
    log, run = read_log("measured/measured_1.parquet"), read_log("demo/runs/today.csv")
    assert np.ptp(run["reading_load"]) > 0.1
    assert len(log) == len(run)
    loop = read_machine("emps").loop(None)
    reference = Recorded(position=log["set_position"], sample_time=float(loop.sample_time))
    again = simulate(loop, reference, start=(0.0, 0.0), record=["reading_load", "force"])
    assert np.max(np.abs(log["reading_load"] - again["reading_load"])) <= 1e-12
    assert np.max(np.abs(log["force"] - again["force"])) <= 0.5 * 0.117169 * (1.0 + 1e-6)
    law = loop.control.law
    assert isinstance(law, CascadePPI)
    stuck = 20.6277 / (law.Kp * law.Kv)
    assert np.max(np.abs(log["reading_load"] - run["reading_load"])) <= 2.0 * stuck


def test_an_aborted_motion_leaves_its_log_and_its_reason(call, tmp_path: Path) -> None:
    """0.2 mm of following error are allowed, and a loop without feedforward needs more: the monitor is first."""
    t = np.arange(2001) * 1e-3
    x = 0.05 * np.sin(np.pi * t / 2.0) ** 4
    rows = [f"{a:.4f},{b}" for a, b in zip(t, x, strict=True)]
    (tmp_path / "p.csv").write_text("time [s],set_position [m]\n" + "\n".join(rows) + "\n")
    play = "play p.csv --drive tight.toml --unpaced --out measured || echo code $? > code.txt"
    tighten = "sed 's/^following_error.*/following_error = 2e-4/' drive.toml > tight.toml\n"
    script = WALK.format(
        feeddrive=FEEDDRIVE,
        machine="emps",
        drive="--interface veth1 --master veth0",
        commands=f"{tighten}{FEEDDRIVE} {play}",
    )
    done = in_a_namespace("bash", "-c", script, cwd=tmp_path)
    assert (tmp_path / "code.txt").read_text() == "code 1\n"
    assert "exceeded limits.following_error = 0.0002 m; the axis was stopped" in done.stderr
    log = read_log(tmp_path / "measured" / "aborted_1.parquet")
    assert 100 < len(log) < 2001
    assert "limits.following_error" in log.provenance["origin"]["aborted"]
    assert np.max(np.abs(log["set_position"] - log["reading_load"])) > 1.9e-4


DRIVE = """
bus = "ethercat"
interface = "nowhere0"
cycle_time_ms = 1
[scaling]
increment_nm = 50
rated_force = 117
[limits]
travel_mm = 100
velocity = 0.2
force = 300
following_error_mm = 5
"""


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    t = np.arange(2001) * 1e-3
    x = 10.0 * np.sin(np.pi * t / 2.0) ** 4
    rows = [f"{a},{b},{c}" for a, b, c in zip(t, x, 0.05 * x / 10.0, strict=True)]
    path = tmp_path / "p.csv"
    path.write_text("time [s],excitation [N],set_position [m]\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("", "", "drive.toml: interface 'nowhere0' is not there; there are: "),
        ("force = 300", "force = 5", "plans force = 10 N, and limits.force of the drive file is 5 N"),
        (
            "travel_mm = 100",
            "travel_mm = 10",
            "plans travel = 0.05001 m, and limits.travel of the drive file is 0.01 m",
        ),
        ("velocity = 0.2", "velocity = 0.02", "limits.velocity of the drive file is 0.02 m/s"),
        ("force = 300", "force = 0.1", "less than a thousandth of the rated torque, 0.117 N"),
        ("following_error_mm = 5", "following_error_nm = 5", "less than one increment, 5e-08 m"),
        ("force = 300\n", "", "drive.toml:8: limits.force is missing (N, largest force, > 0 N)"),
        ("rated_force = 117", "rated_torque = 2", "increment and rated_force of a linear motor"),
        ('bus = "ethercat"', 'bus = "profinet"', "drive.toml:2: bus = 'profinet'"),
        ('interface = "nowhere0"', "interface = 3", "drive.toml:3: interface must be a text in quotes"),
        ('bus = "ethercat"', 'bus = "canopen"', "must name what python-can calls interface and channel"),
        ("cycle_time_ms = 1", "cycle_time_ms = 1.5", "is no whole multiple"),
        ("cycle_time_ms = 1", 'cycle_time_ms = 1\nmode = "cst"', 'limits.largest_mass is missing: in mode = "cst"'),
        ("travel_mm", "travel_mN", "key 'limits.travel_mN' is not known"),
    ],
)
def test_what_is_wrong_with_a_drive_file_is_named_before_anything_moves(
    call, tmp_path: Path, profile: Path, old: str, new: str, words: str
) -> None:
    (tmp_path / "drive.toml").write_text(DRIVE.replace(old, new))
    code, _, err = call("play", str(profile), "--drive", "drive.toml", "--yes", "--out", "measured")
    assert code == 2
    assert words in err
    assert err.startswith("feeddrive: error: ")
    assert err.count("\n") == 1
    assert not (tmp_path / "measured").exists()


def test_a_motion_is_refused_where_nothing_follows_it(call, tmp_path: Path, profile: Path) -> None:
    text = DRIVE.replace("cycle_time_ms = 1", 'cycle_time_ms = 1\nmode = "cst"') + "largest_mass = 95\n"
    (tmp_path / "drive.toml").write_text(text)
    code, _, err = call("play", str(profile), "--drive", "drive.toml", "--yes")
    assert (code, "limits.breakaway_force is missing" in err) == (2, True)
    (tmp_path / "drive.toml").write_text(f"{text}breakaway_force = 0\n")
    code, _, err = call("play", str(profile), "--drive", "drive.toml", "--yes")
    assert (code, "nothing follows it in mode cst" in err) == (2, True)


def test_a_person_is_asked_before_the_bus_is_touched(call, tmp_path: Path, profile: Path, monkeypatch) -> None:
    """Nobody answers here: nothing is opened, and the interface that is not there is not even looked for."""
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    (tmp_path / "drive.toml").write_text(DRIVE)
    code, out, err = call("play", str(profile), "--drive", "drive.toml")
    assert code == 1
    assert "Is the travel clear, and the stop at hand?" in out
    assert "nowhere0" not in err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time [s],force [N]\n0,1\n0.001,2\n0.002,1\n", "has neither a column 'excitation' nor 'set_position'"),
        ("time [s],excitation [V]\n0,0\n0.001,2\n0.002,0\n", "excitation in 'V' cannot be played in mode csp"),
        ("time [s],excitation [N]\n0,5\n0.001,5\n0.002,0\n", "begins or ends with 100 % of its peak"),
        ("time [s],set_position [m]\n0,0\n0.001,0.0001\n0.002,0.0002\n", "let it start and end at rest"),
    ],
)
def test_a_profile_that_cannot_be_played_is_refused(call, tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "drive.toml").write_text(DRIVE)
    (tmp_path / "p.csv").write_text(text)
    code, _, err = call("play", "p.csv", "--drive", "drive.toml")
    assert code == 2
    assert words in err


def test_a_band_above_the_rate_of_the_bus_is_refused(call, tmp_path: Path) -> None:
    """400 Hz at 1 kHz over a bus at 500 Hz would come out as 100 Hz."""
    (tmp_path / "drive.toml").write_text(DRIVE.replace("cycle_time_ms = 1", "cycle_time_ms = 2"))
    t = np.arange(1001) * 1e-3
    x = np.sin(np.pi * t) ** 2 * np.sin(2 * np.pi * 400.0 * t)
    rows = [f"{a:.4f},{b}" for a, b in zip(t, x, strict=True)]
    (tmp_path / "p.csv").write_text("time [s],excitation [N]\n" + "\n".join(rows) + "\n")
    code, _, err = call("play", "p.csv", "--drive", "drive.toml")
    assert code == 2
    assert "above 250 Hz, half the rate of the bus" in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--interface", "nowhere0"), "interface 'nowhere0' is not there"),
        (("--interface", "veth1", "--bus", "modbus"), "must be one of 'ethercat', 'canopen'"),
        (("--interface", "lo", "--cycle-us", "1500"), "whole multiple of the sample time of the machine, 1000 us"),
        (("--interface", "lo", "--fault", "melt@150"), "fault 'melt@150' must name a kind"),
        (("--interface", "lo", "--bus", "canopen"), "python-can"),
        (("--interface", "virtual:x", "--bus", "canopen", "--watchdog-ms", "100"), "is of EtherCAT"),
    ],
)
def test_a_virtual_drive_that_cannot_be_is_refused(call, words: tuple[str, ...], message: str) -> None:
    code, _, err = call("virtual-drive", "emps", *words)
    assert code == 2
    assert message in err


def test_a_node_that_is_not_there_is_named(call, tmp_path: Path, profile: Path) -> None:
    text = DRIVE.replace("ethercat", "canopen").replace("nowhere0", "virtual:empty")
    text = text.replace("cycle", "station = 4\ncycle")
    (tmp_path / "drive.toml").write_text(text)
    code, _, err = call("play", str(profile), "--drive", "drive.toml", "--yes")
    assert code == 1
    assert "CANopen virtual:empty, node 4: does not answer; check cable, termination, bit rate" in err


def test_without_the_packages_the_install_command_is_named(call, tmp_path: Path, profile: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "canopen", None)
    monkeypatch.setitem(sys.modules, "pysoem", None)
    for bus in ("ethercat", "canopen"):
        (tmp_path / "drive.toml").write_text(DRIVE.replace("ethercat", bus).replace("nowhere0", "virtual:x"))
        code, _, err = call("play", str(profile), "--drive", "drive.toml", "--yes")
        assert code == 2
        assert "pip install 'feeddrive[bus]'" in err


def test_an_ethercat_segment_without_a_station_is_named(call, tmp_path: Path, profile: Path) -> None:
    (tmp_path / "drive.toml").write_text(DRIVE.replace("nowhere0", "veth0"))
    done = in_a_namespace("bash", "-c", f"{FEEDDRIVE} play {profile.name} --drive drive.toml --yes", cwd=tmp_path)
    assert done.returncode == 1
    assert "EtherCAT veth0: no station answers; check cable, supply" in done.stderr
