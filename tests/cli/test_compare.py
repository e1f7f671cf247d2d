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
    assert code == 1, errors  # one search confirms nothing
    assert "No law that was tuned is ranked: nothing is recommended." in out
    assert "today's gains" in out
    assert "Cannot control this axis: pole placement: pole placement needs the position of the motor and " in out
    assert out.strip().splitlines()[-1].startswith("Report: ")
    laws = json.loads(Path("d/summary.json").read_text(encoding="utf-8"))["laws"]
    # a P velocity loop never comes back from a force
    assert laws["today's gains"]["figures"]["rope_snap_ISE_root_m_per_N"] == "infinite"
    assert laws["P-PI"]["tunables"]["axis.x.control.law.Tn"] > 0.0
    assert "integral" in laws["P-PI"]["remark"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nowhere",), "there is no such file"),
        (("linear_motor", "--axis", "y"), "axis 'y' is not there"),
        (("linear_motor", "--law", "PID"), "law 'PID' is not known here; there are: P-PI, "),
        (("linear_motor", "--law", "cascade_pi"), "law 'cascade_pi' is not known here; did you mean cascade_ppi?"),
        (("linear_motor", "--take", "PID"), "law 'PID' is not known here; there are: P-PI, "),
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


OWN = """
from typing import NamedTuple

from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import parameter


class State(NamedTuple):
    position: float


class Wrong(Law):
    \"\"\"F = gain (x_set - x).\"\"\"

    gain: float = parameter("N/m", "force over error", above=0)

    @classmethod
    def begin(cls, axis, present):
        {begin}
        return super().begin(axis, present)

    def start(self, prepared, setpoint, reading):
        return State(reading.position_load)

    def step(self, prepared, state, setpoint, reading, T):
        {step}
        return State(reading.position_load), self.gain * (setpoint.position - reading.position_load)


class Other(Wrong):
    \"\"\"The same.\"\"\"
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Writes a law of one's own; what is imported from it is forgotten."""
    monkeypatch.setattr(sys, "path", [*sys.path])

    def write(**lines: str) -> None:
        Path("m.toml").write_text(RIGID, encoding="utf-8")
        Path("wrong_law.py").write_text(OWN.format(**{"begin": "", "step": ""} | lines), encoding="utf-8")

    yield write
    sys.modules.pop("wrong_law", None)


def test_a_fault_of_a_law_named_by_law_is_one_line_with_its_place(run, own) -> None:
    """It was a traceback: such a law is in no catalogue."""
    own(begin="axis.weight")
    code, _, errors = run("compare", "m.toml", "--law", "wrong_law:Wrong", "--starts", "1")
    assert code == 2
    assert errors.startswith("feeddrive: error: wrong_law.py, line 21: AttributeError: ")
    assert errors.count("\n") == 1


@pytest.mark.slow(reason="P-PI is tuned, and two processes begin")
def test_a_fault_of_a_law_in_a_process_of_its_own_is_one_line_with_its_place(run, own, monkeypatch) -> None:
    """It was the traceback of that process."""
    monkeypatch.setattr(importlib.import_module("feeddrive.evaluation.engine"), "cores", lambda: 2)
    own(step="speed = setpoint.speed")
    code, _, errors = run("compare", "m.toml", "--law", "wrong_law:Wrong", "--law", "wrong_law:Other", "--starts", "1")
    assert code == 2
    assert errors.startswith("feeddrive: error: wrong_law.py, line 28: AttributeError: ")
    assert errors.count("\n") == 1


def test_ctrl_c_writes_nothing(run, monkeypatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    module = importlib.import_module("feeddrive.workflow.compare")
    monkeypatch.setattr(module, "compare_laws", interrupted)
    code, _, errors = run("compare", "linear_motor", "--out", "d")
    assert code == 130
    assert "nothing was written" in errors
    assert not Path("d").exists()
