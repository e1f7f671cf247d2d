"""What a person sees and types in Python: short reprs, answers to misuse, and the ways to other tools."""

from __future__ import annotations

import builtins
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
import scipy.io
import scipy.signal

import feeddrive as fd
from feeddrive.cli import main

MACHINES = sorted(each.stem for each in (Path(fd.files.__file__).parent / "bundled" / "machines").glob("*.toml"))
MOVE = fd.blocks.SnapLimitedMove(distance=0.01, velocity=0.1, acceleration=0.8, jerk=20, snap=1000)
LINES = np.geomspace(1.0, 480.0, 40)


def axis() -> Any:
    """EMPS with a dead time of 1.37 samples: a whole one in the queue, and a fraction."""
    return fd.vary(
        fd.read_machine("emps").loop("x"), {"axis.x.actuator.dead_time": 1.37e-3, "axis.x.control.law.Kv": 60}
    )


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_file_shows_one_short_table(name: str) -> None:
    """It printed its whole text, 5,000 characters and more."""
    machine = fd.read_machine(name)
    assert len(repr(machine)) < 1500
    assert all(f"\n{axis}" in repr(machine) for axis in machine.loops)
    for loop in machine.loops.values():
        assert len(repr(loop).splitlines()) < 25
        assert "<table>" in loop._repr_html_()
    assert len(repr(machine.file)) < 300


def test_a_job_and_blocks_show_a_table_with_units_and_bounds() -> None:
    job = fd.read_job("emps")
    assert len(repr(job)) < 1500
    assert "friction feedforward" in repr(job)
    law = job.loops["today"].control.law
    assert "<td>Kp</td>" in law._repr_html_()
    assert "<td>N s/m</td><td>&gt; 0 N s/m</td><td>velocity gain</td>" in law._repr_html_()
    paths = {row[0] for row in job.loops["today"].table().rows}
    assert set(fd.parameters(job.loops["today"])) - {"sample_time"} <= paths
    assert repr(law).startswith("CascadePPI(Kv=")


MISUSE: dict[str, tuple[Callable[[], object], str]] = {
    "a machine file for a loop": (
        lambda: fd.simulate(fd.read_machine("emps"), MOVE),
        r"not a MachineFile: .*\.loop\('x'\)",
    ),
    "also in a batch": (lambda: fd.simulate_batch(fd.read_machine("emps"), MOVE), r"\.loop\('x'\)"),
    "and to vary": (lambda: fd.vary(fd.read_machine("emps"), {"Kv": 1}), r"\.loop\('x'\)"),
    "and for a response": (lambda: fd.loop_gain(fd.read_machine("emps"), LINES), r"\.loop\('x'\)"),
    "swapped arguments": (lambda: fd.simulate(MOVE, axis()), r"a loop or a machine comes first"),
    "an array for a reference": (lambda: fd.simulate(axis(), np.zeros(9)), r"Recorded for an array, not a ndarray"),
    "a signal": (lambda: fd.simulate(axis(), MOVE, record=["postion_load"]), r"did you mean position_load"),
    "a job for a machine": (lambda: fd.compare(fd.read_job("emps")), r"not a Job: fd\.run\(job\)"),
    "a machine for a job": (lambda: fd.run(fd.read_machine("emps")), r"fd\.compare\(file\)"),
    "an option": (lambda: fd.tune("emps", max_Ms=2.0), r"no option 'max_Ms'; did you mean max_ms"),
    "nothing": (lambda: fd.compare(), r"needs machine \(A machine file"),
    "a bundled name": (lambda: fd.compare("ball_scew"), r"did you mean ball_screw"),
    "a joint": (lambda: fd.write_export("emps", "linuxcnc", "x", joint="a"), r"--joint = 'a' must be a whole number"),
    "a joint of the command": (
        lambda: fd.workflow.export("emps", target="linuxcnc", joint="a"),
        r"--joint = 'a' .* whole number",
    ),
    "a loop for a file": (lambda: fd.write_export(axis(), "c", "x"), r"not a Loop"),
    "a parameter": (lambda: fd.blocks.CascadePPI(Kv=1.0, kp=1.0), r"CascadePPI has no parameter 'kp'; did you mean"),
    "a missing parameter": (lambda: fd.blocks.CascadePPI(Kv=1.0), r"CascadePPI needs Kp \(velocity gain\)"),
    "parameters by place": (lambda: fd.blocks.CascadePPI(1.0, 2.0), r"by name: Kv, Kp"),
    "swapped for a file": (lambda: fd.write_frf(axis(), "x.csv"), r"write_frf\(path, frf, \.\.\.\)"),
    "a name": (lambda: fd.simulat, r"did you mean fd\.simulate"),
    "a name of a room": (lambda: fd.blocks.CascadePI, r"did you mean CascadePPI"),
    "a block": (lambda: fd.CascadePI, r"did you mean fd\.blocks\.CascadePPI"),
    "what is no model": (lambda: fd.files.write_mat("x.mat", axis()), r"an FRF, a StateSpace .* not a Loop"),
}


@pytest.mark.parametrize("case", MISUSE)
def test_misuse_is_answered_in_the_words_of_the_api(case: str) -> None:
    call, said = MISUSE[case]
    with pytest.raises((fd.FeeddriveError, AttributeError), match=said):
        call()


def model() -> Any:
    return fd.linearize(axis(), ["set_position", "load_force"], ["position_load", "force"])


def test_python_control_and_scipy_have_our_response_with_the_dead_time_as_it_is() -> None:
    """1.37 samples: the shift register and the fraction are states, nothing is approximated; 1e-9 is rounding."""
    found = model()
    ours = found.response(LINES, "position_load", "load_force").response
    theirs = control.frequency_response(found.to_control(), 2.0 * np.pi * LINES).frdata[0, 1]
    np.testing.assert_allclose(theirs, ours, rtol=1e-9)
    system = found.to_scipy()
    assert isinstance(system, scipy.signal.StateSpace)
    assert system.dt == found.sample_time
    z = np.exp(2j * np.pi * LINES * system.dt)
    direct = [
        (system.C @ np.linalg.solve(each * np.eye(len(system.A)) - system.A, system.B) + system.D)[0, 1] for each in z
    ]
    np.testing.assert_allclose(direct, ours, rtol=1e-9)


def test_without_python_control_the_install_command_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: Any) -> Any:
        if name == "control":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(fd.FeeddriveError, match=r"pip install 'feeddrive\[control\]'"):
        model().to_control()


def test_a_mat_file_comes_back_bit_for_bit(tmp_path: Path) -> None:
    found = model()
    fd.files.write_mat(tmp_path / "m.mat", found)
    back = scipy.io.loadmat(tmp_path / "m.mat", squeeze_me=True)
    for name in "ABCD":
        np.testing.assert_array_equal(back[name], getattr(found, name))
    assert list(back["inputs"]) == ["set_position", "load_force"]
    assert back["sample_time_s"] == 1e-3
    frf = fd.compliance(axis(), LINES)
    fd.files.write_mat(tmp_path / "f.mat", frf)
    back = scipy.io.loadmat(tmp_path / "f.mat", squeeze_me=True)
    np.testing.assert_array_equal(back["response"], frf.response)
    np.testing.assert_array_equal(back["frequency_Hz"], frf.frequency)
    assert (back["input"], back["unit"]) == ("load_force", "m/N")
    run = fd.simulate(fd.read_machine("emps").machine(), {"x": MOVE})
    fd.files.write_mat(tmp_path / "r.mat", run)
    back = scipy.io.loadmat(tmp_path / "r.mat", squeeze_me=True)
    np.testing.assert_array_equal(back["x_force"], run["x.force"])
    assert back["units"]["x_force"].item() == "N"
    again = fd.read_log(tmp_path / "r.mat", {"time": ("time_s", "s"), "force": "x_force"})
    np.testing.assert_array_equal(again["force"], run["x.force"])


def test_a_csv_of_a_model_and_of_a_response_comes_back_bit_for_bit(tmp_path: Path) -> None:
    found = model()
    fd.files.write_csv(tmp_path / "m.csv", found)
    rows = [
        line.split(",")
        for line in (tmp_path / "m.csv").read_text().splitlines()
        if line[:2] in ("A,", "B,", "C,", "D,")
    ]
    for name in "ABCD":
        matrix = np.zeros_like(getattr(found, name))
        for _, i, j, value in (row for row in rows if row[0] == name):
            matrix[int(i) - 1, int(j) - 1] = float(value)
        np.testing.assert_array_equal(matrix, getattr(found, name))
    frf = fd.compliance(axis(), LINES)
    fd.files.write_csv(tmp_path / "f.csv", frf)
    np.testing.assert_array_equal(fd.read_frf(tmp_path / "f.csv").response, frf.response)
    run = fd.simulate(axis(), MOVE)
    fd.files.write_csv(tmp_path / "r.csv", run)
    np.testing.assert_array_equal(fd.read_log(tmp_path / "r.csv")["force"], run["force"])


@pytest.mark.parametrize(
    ("given", "seconds"),
    [("sample_time_us = 100", "0.0001"), ("sample_time_us = 50", "5e-05"), ("sample_time_ms = 0.3", "0.0003")],
)
def test_a_decimal_number_in_another_unit_is_the_same_decimal_number_in_si(
    tmp_path: Path, given: str, seconds: str
) -> None:
    """100 us were 9.999999999999999e-05 s."""
    text = fd.read_machine("emps").file.text
    (tmp_path / "m.toml").write_text(re.sub(r"(?m)^sample_time\w* *=.*$", given, text))
    assert repr(float(fd.read_machine(tmp_path / "m.toml").loop("x").sample_time)) == seconds


def test_what_a_job_names_is_not_quoted(tmp_path: Path) -> None:
    """A job may name any file; its error says the line, and nothing of what stands there."""
    (tmp_path / "secret").write_text("password: hunter2\n")
    (tmp_path / "a.toml").write_text(f"machine = '{tmp_path}/secret'\n[reference]\nkind = 'snap_limited_move'\n")
    channels = "[log.channels]\nsetpoint_position = 'a'\nposition_load = 'b'\n"
    (tmp_path / "b.toml").write_text(f"machine = 'emps'\n[log]\nfile = 'secret'\n{channels}")
    for name in ("a.toml", "b.toml"):
        with pytest.raises(fd.FeeddriveError, match="secret") as error:
            fd.run(tmp_path / name)
        assert "hunter2" not in str(error.value)


def test_no_name_from_a_file_obeys_the_terminal(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A column's name that sets the title of the window, clears the screen and turns the text round."""
    name = "\x1b]0;owned\x07\x1b[2J\u202eforce"
    rows = np.linspace(0.0, 1.0, 300)
    log = fd.Log(
        name="l", time=1e-3 * np.arange(300), channels={name: rows, "position_m": rows}, units={}, sample_time=1e-3
    )
    fd.files.write_log(tmp_path / "l.parquet", log)
    monkeypatch.setattr("sys.argv", ["feeddrive", "channels", str(tmp_path / "l.parquet")])
    with pytest.raises(SystemExit):
        main()
    out, errors = capfd.readouterr()
    assert "\\x1b]0;owned" in out
    assert not {"\x1b", "\x07", "\u202e"} & {*out, *errors}
    assert "\x1b" not in str(log.table())
