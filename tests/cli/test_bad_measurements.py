"""Logs and responses with which no command goes on: each says what is wrong, where, and ends with a code."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from feeddrive import cli

T, N = 1e-3, 4000
F = np.geomspace(1.0, 400.0, 200)
S = 2j * np.pi * F
G = 1.0 / (100.0 * S * S + 200.0 * S)


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs `feeddrive` in an empty folder: exit code, output and errors together on one line."""
    monkeypatch.chdir(tmp_path)

    def asked(*words: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["feeddrive", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out + captured.err

    return asked


def log(change: str) -> str:
    """A drive under noise and a swinging force, with something wrong."""
    random = np.random.default_rng(0)
    t = T * np.arange(N)
    force = 40.0 * np.sin(2.0 * np.pi * 1.5 * t) + 10.0 * random.standard_normal(N)
    if change == "saturated":
        force = np.clip(force, -30.0, 30.0)
    position = T * np.cumsum(lfilter([T / 100.0], [1.0, -1.0 + 2.0 * T], force))
    if change == "nan":
        position[100] = np.nan
    elif change == "constant":
        force[:] = 3.0
    elif change == "shifted":
        position = np.roll(position, 60)
        position[:60] = position[60]
    elif change == "gap":
        t[2000:] += 0.5
    elif change == "backward":
        t[2000:] -= 0.5
    rows = "".join(f"{a:.6f},{b:.9g},{c:.12g}\n" for a, b, c in zip(t, force, position, strict=True))
    return "t [s],force,position_load\n" + rows


@pytest.mark.parametrize("command", ["frf", "identify"])
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("nan", "'position_load' is nan at line 102"),
        ("constant", "'force' is"),
        ("gap", "a gap lies before line 2002: 1.999 s is followed by 2.5 s"),
        ("backward", "time runs backward at line 2002"),
    ],
)
def test_a_channel_that_is_wrong_is_named_and_its_line(call, command: str, change: str, said: str) -> None:
    Path("logs").mkdir()
    Path("logs/log.csv").write_text(log(change))
    code, text = call(command, "logs/log.csv")
    assert code == (1 if (command, change) == ("identify", "constant") else 2)  # a log that reads, and says nothing
    assert "feeddrive: error: logs/log.csv: " in text
    assert said in text


def test_a_saturated_channel_is_named(call) -> None:
    """A rigid drive is not fitted through it; a response is, and the reader is told."""
    Path("log.csv").write_text(log("saturated"))
    code, text = call("identify", "log.csv")
    assert code == 1
    assert "error: log.csv: the force sits at 30 N in" in text
    code, text = call("frf", "log.csv", "--method", "h1")
    assert code == 0
    assert "'force' is clipped: it stays at its largest value 30" in text


def test_channels_of_two_clocks_are_named(call) -> None:
    Path("log.csv").write_text(log("shifted"))
    code, text = call("identify", "log.csv")
    assert code == 1
    assert "error: log.csv: force and position are not synchronised" in text
    assert "record both channels with one recorder and one trigger" in text


def response(change: str) -> str:
    frequency, values, coherence = F.copy(), G.copy(), np.full(F.size, 0.99)
    if change == "negative":
        frequency[0] = -1.0
    elif change == "unsorted":
        frequency[[10, 90]], values[[10, 90]] = frequency[[90, 10]], values[[90, 10]]
    elif change == "twice":
        frequency[11] = frequency[10]
    elif change == "coherence":
        coherence[20] = 1.2
    elif change == "nan":
        values[5] = np.nan
    else:
        values[:] = 0.0
    rows = zip(frequency, values.real, values.imag, coherence, strict=True)
    return "f_Hz,re_m_per_N,im_m_per_N,coherence\n" + "".join("{:.12g},{:.12g},{:.12g},{}\n".format(*r) for r in rows)


@pytest.mark.parametrize("command", [("identify",), ("tune", "--sample-time", "1e-3", "--law", "cascade_ppi")])
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("negative", "the frequency is -1 Hz at line 2"),
        ("unsorted", "the frequency falls at line 13"),
        ("twice", "the frequency stands still at line 13"),
        ("coherence", "the coherence 'coherence' is 1.2 at line 22 (1 such lines), outside 0 to 1"),
        ("nan", "'re_m_per_N' is nan at line 7"),
        ("nothing", "is 0"),
    ],
)
def test_lines_that_no_response_has_are_named(call, command: tuple[str, ...], change: str, said: str) -> None:
    Path("frf.csv").write_text(response(change))
    code, text = call(command[0], "frf.csv", *command[1:])
    assert code == 2
    assert said in text
    assert "Traceback" not in text
