"""`feeddrive reproduce` as a user meets it: the report, the exit code, and an end by Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from feeddrive import cli
from feeddrive.language.progress import Progress
from feeddrive.papers import claims as papers
from feeddrive.papers.claims import Claim, Experiment


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


def stated(got: float) -> Callable[[str, Progress], Experiment]:
    """An experiment of one claim, which holds up to 1."""

    def made(paper: str, progress: Progress) -> Experiment:
        progress.step("the only run")
        claim = Claim("1", "it is small", "alone", got, most=1.0, unit="um")
        return Experiment(paper, "A paper", "Somebody 2009", [claim])

    return made


@pytest.mark.parametrize(("got", "code", "said"), [(0.5, 0, "holds"), (1.5, 1, "DOES NOT HOLD")])
def test_the_exit_code_is_1_if_a_claim_does_not_hold(run, monkeypatch, got: float, code: int, said: str) -> None:
    monkeypatch.setattr(papers, "run", stated(got))
    ended, out, _ = run("reproduce", "wu2017")
    assert ended == code
    assert said in out
    assert out.strip().splitlines()[-1] == "Report: results/wu2017/report.html"
    assert said in Path("results/wu2017/report.html").read_text(encoding="utf-8")


@pytest.mark.slow(reason="claims are tested beside their experiment, the door above, a page with its pictures there")
@pytest.mark.pictures
def test_a_paper_runs_and_writes_every_claim(run) -> None:
    """The quickest of the four, through the door; the claims themselves are tested beside their experiment."""
    code, out, _ = run("reproduce", "gordon2013", "--out", "there")
    claims = json.loads(Path("there/claims.json").read_text(encoding="utf-8"))["papers"]["gordon2013"]
    assert code == 0, out
    assert f"All {len(claims)} claims hold." in out
    assert len(claims) > 40


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("gordon2031",), "did you mean gordon2013?"),
        (("gordon2013", "--out", "file/below"), "file"),
    ],
)
def test_bad_input_is_one_line(run, monkeypatch, words: tuple[str, ...], said: str) -> None:
    monkeypatch.setattr(papers, "run", stated(0.5))
    Path("file").write_text("", encoding="utf-8")
    code, _, errors = run("reproduce", *words)
    assert code == 2
    assert said in errors
    assert len(errors.strip().splitlines()) == 1


@pytest.mark.skipif(os.name == "nt", reason="Ctrl-C is no signal to one process there")
def test_ctrl_c_writes_nothing(tmp_path: Path) -> None:
    """All papers, in processes of their own, as from a terminal: the signal goes to the whole group."""
    asked = [sys.executable, "-c", "from feeddrive.cli import main; main()", "reproduce", "all", "--out", "out"]
    process = subprocess.Popen(
        asked,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # ignored by what a background job starts
    )
    until = time.monotonic() + 120.0
    while not list(tmp_path.iterdir()) and time.monotonic() < until:
        time.sleep(0.1)  # the place is opened when all is imported and the work begins
    time.sleep(1.0)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "nothing was written" in errors
    assert not list(tmp_path.iterdir())
