"""What is no terminal gets every sentence on one line, however long its paths are and whatever COLUMNS says."""

from __future__ import annotations

import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import feeddrive
from feeddrive import cli
from feeddrive.cli.commands import app
from feeddrive.cli.terminal import open_console
from feeddrive.language.errors import FeeddriveError

RUN = CliRunner(env={"COLUMNS": "40"})


@pytest.fixture
def far(tmp_path: Path) -> Path:
    """A folder with a path of more than a thousand characters, with blanks, at which a line could be broken."""
    folder = tmp_path.joinpath(*[f"{k} a long name of a folder " + "x" * 180 for k in range(5)])
    folder.mkdir(parents=True)
    return folder


@pytest.fixture
def log(far: Path) -> Path:
    force = np.random.default_rng(1).standard_normal(2000)
    # 100 kg on a spring, in mm: a mass that a feed drive has
    position = np.convolve(force, 1e3 * np.exp(-np.arange(200) / 40.0) * np.sin(np.arange(200) / 10.0) * 1e-7)[:2000]
    table = np.column_stack([np.arange(2000) * 1e-3, force, position])
    np.savetxt(far / "log.csv", table, delimiter=",", header="t,force_N,position_mm", comments="")
    return far / "log.csv"


def test_a_message_with_a_long_path_is_one_line(log: Path) -> None:
    out = log.parent / "r.toml"
    done = RUN.invoke(app, ["channels", str(log), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert f"Written: {out}; correct it and give it with --channels {out}" in done.output.splitlines()


def test_remarks_and_tables_are_not_broken(log: Path) -> None:
    done = RUN.invoke(app, ["frf", str(log), "--out", str(log.parent / "o")])
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    assert any(
        f"feeddrive channels {log} --out channels.toml, edit that file, then --channels" in each for each in lines
    )
    row = " ".join(next(each for each in lines if "force_N" in each).split())
    assert row == "force force_N N force, by its name --force 'force_N'"


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["frf", "{far}", "--bla"], "Error: No such option: --bla"),
        (["tune", "emps", "--starts", "{far}"], "Error: Invalid value for '--starts': it must be a whole number, not "),
        (["tune", "--help"], "  Tune gains and filters of an axis within limits; write a machine file and a report "),
    ],
)
def test_help_and_usage_errors_are_plain_lines(far: Path, words: list[str], line: str) -> None:
    output = RUN.invoke(app, [each.format(far=far) for each in words]).output
    assert any(each.startswith(line) for each in output.splitlines()), output
    assert not set("╭│╰─") & set(output), "no box"


def test_a_terminal_breaks_lines_at_its_width(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert open_console().width == 60


def error_classes() -> dict[str, type[FeeddriveError]]:
    """Every error that a user can cause, of all modules, by name."""
    for each in pkgutil.walk_packages(feeddrive.__path__, "feeddrive."):
        file = Path(str(each.module_finder.path), f"{each.name.rpartition('.')[2]}.py")  # pyright: ignore
        if file.exists() and re.search(r"^class \w+Error\(", file.read_text(encoding="utf-8"), re.MULTILINE):
            importlib.import_module(each.name)
    found, rest = {}, [FeeddriveError]
    while rest:
        one = rest.pop()
        found[one.__name__] = one
        rest += [each for each in one.__subclasses__() if each.__module__.startswith("feeddrive.")]
    return found


def test_every_error_has_the_code_of_the_table_and_ends_with_it(monkeypatch, capsys) -> None:
    """The table of the docs names every class once, under the code with which `main` ends."""
    page = (Path(__file__).parents[2] / "docs/reference/files.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| [^|]* \| ([^|]*) \|$", page, re.MULTILINE)
    told = {name: int(code) for code, names in rows for name in re.findall(r"`(\w+)`", names)}
    classes = error_classes()
    assert told == {name: one.exit_code for name, one in classes.items()}
    for name, one in classes.items():
        error = one.__new__(one)
        Exception.__init__(error, "the reason")

        def app(error: FeeddriveError = error) -> None:
            raise error

        monkeypatch.setattr("feeddrive.cli.commands.app", app)
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == told[name]
        said = capsys.readouterr().err
        assert said == ("feeddrive: the reason\n" if told[name] == 130 else "feeddrive: error: the reason\n")


NOISY = """
import logging, sys, warnings
import numpy as np
from feeddrive.cli import main
from feeddrive.workflow import force as command
work = command.work
def noisy(request, progress):
    np.ones(1) / np.zeros(1)
    warnings.warn("an old name", DeprecationWarning)
    logging.getLogger("canopen").error("aborted")
    progress.remark("our own remark")
    return work(request, progress)
command.work = noisy
sys.argv = ["feeddrive", "force", "percent", "--column", "trq", "--rated", "3.2:Nm", "--lead", "0.01"]
main()
"""


def test_what_libraries_warn_of_is_not_seen_and_our_remarks_are() -> None:
    """A RuntimeWarning of numpy, a DeprecationWarning of the program itself and a log line without a handler."""
    done = subprocess.run([sys.executable, "-c", NOISY], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "our own remark" in done.stdout
    asked = subprocess.run(
        [sys.executable, "-W", "always", "-c", NOISY], capture_output=True, text=True, timeout=120, check=False
    )
    assert "divide by zero" in asked.stderr
    assert "an old name" in asked.stderr
