"""`feeddrive compare` as a user meets it."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import pytest

from feeddrive import cli


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


RIGID = """
sample_time_ms = 1.0
[axis.x.plant]
kind = "rigid"
mass = 100
[axis.x.encoder_load]
kind = "encoder"
resolution_um = 1
[axis.x.control]
force_limit = 2000
[axis.x.control.law]
kind = "cascade_ppi"
Kv = 40
Kp = 1.0e4
"""


@pytest.mark.pictures
def test_a_machine_of_ones_own(run) -> None:
    Path("m.toml").write_text(RIGID, encoding="utf-8")
    code, out, errors = run("compare", "m.toml", "--starts", "1", "--law", "pole placement", "--out", "d")
    assert code == 0, errors
    assert "today's gains" in out
    assert "cannot control this axis" in out
    assert out.strip().splitlines()[-1].startswith("Report: ")
    laws = json.loads(Path("d/summary.json").read_text(encoding="utf-8"))["laws"]
    # a P velocity loop never comes back from a force
    assert laws["today's gains"]["rope_snap_ISE_root_m_per_N"] == "infinite"
    assert laws["P-PI"]["tunables"]["axis.x.control.law.Tn"] > 0.0
    assert "integral" in laws["P-PI"]["remark"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nowhere",), "there is no such file"),
        (("linear_motor", "--axis", "y"), "axis 'y' is not there"),
        (("linear_motor", "--law", "PID"), "law 'PID' is not known here; there are: P-PI, "),
        (("mill",), "there are the axes x, y, z: name one of them"),
        (("bad.toml",), "bad.toml:4"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(run, words, said) -> None:
    Path("bad.toml").write_text(RIGID.replace('"rigid"', '"rigit"'), encoding="utf-8")
    before = sorted(Path().rglob("*"))
    code, _, errors = run("compare", *words)
    assert code == 2
    assert errors.count("\n") == 1
    assert errors.startswith("feeddrive: error: ")
    assert said in errors
    assert sorted(Path().rglob("*")) == before


def test_ctrl_c_writes_nothing(run, monkeypatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    module = importlib.import_module("feeddrive.workflow.compare")
    monkeypatch.setattr(module, "compare_laws", interrupted)
    code, _, errors = run("compare", "linear_motor", "--out", "d")
    assert code == 130
    assert "nothing was written" in errors
    assert not Path("d").exists()
