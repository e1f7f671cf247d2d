"""Blocks of one's own: found by opt-in alone, in the battery, in machine files, exported and refused with reasons."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

import feeddrive as fd
from feeddrive.blocks.catalogue import VARIABLE, catalogue, with_blocks
from feeddrive.blocks.families import Law
from feeddrive.cli.commands import app
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.testing import battery
from feeddrive.tuning.candidates import candidates

EXAMPLES = Path(__file__).parents[1] / "examples"
LAW = '''\
import math
from pathlib import Path
from feeddrive.blocks.families import Law
from feeddrive.language import ops
from feeddrive.language.block import parameter

Path("imported.txt").write_text("")

class {name}(Law):
    """F = gain (x_set - x)."""

    gain: float = parameter("N/m", "force over error", above=0)

    def start(self, prepared, setpoint, reading):
        return (reading.position_load,)

    def step(self, prepared, state, setpoint, reading, T):
        v = (reading.position_load - state[0]) / T
        force = self.gain * (setpoint.position - reading.position_load + 0.01 * (setpoint.velocity - v))
        return (reading.position_load,), {force}

    def retune(self, state, old, old_prepared, prepared):
        return state
'''
MACHINE = """\
sample_time_us = 100
[axis.x.plant]
kind = "rigid"
mass_kg = 10
[axis.x.control]
force_limit_N = 500
[axis.x.control.law]
kind = "{kind}"
gain = 1e5
[axis.x.control.guard]
following_error_limit_mm = 2
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty directory in which one works; what is imported from it is forgotten."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield tmp_path
    own = (str(tmp_path), str(EXAMPLES))
    for name in [name for name, each in sys.modules.items() if str(getattr(each, "__file__", "")).startswith(own)]:
        del sys.modules[name]


def written(folder: Path, name: str, module: str, force: str = "force") -> Path:
    file = folder / f"{module}.py"
    file.write_text(LAW.format(name=name, force=force), encoding="utf-8")
    (folder / "machine.toml").write_text(MACHINE.format(kind=module), encoding="utf-8")
    return file


def test_a_file_that_is_read_runs_nothing_and_says_how_to_opt_in(folder: Path) -> None:
    written(folder, "SpringLaw", "spring_law")
    for words in (["certify", "machine.toml"], ["export", "machine.toml", "--target", "c"]):
        result = CliRunner().invoke(app, words)
        assert isinstance(result.exception, ParameterError)
        assert "kind = 'spring_law' is not known" in str(result.exception)
        assert all(word in str(result.exception) for word in ("--blocks FILE.py", "FEEDDRIVE_BLOCKS", "installed"))
    assert not (folder / "imported.txt").exists()


@pytest.mark.parametrize("place", ["own_law.py", "own_law", "own_law:OwnLaw"])
def test_blocks_are_named_by_file_module_or_class(place: str, folder: Path) -> None:
    written(folder, "OwnLaw", "own_law")
    with pytest.raises(ParameterError, match="not known"):
        fd.read_machine("machine.toml")
    with with_blocks([place]):
        assert fd.read_machine("machine.toml").loop("x").control.law.kind == "own_law"
        assert "own law" in {each.name for each in candidates(fd.read_machine("machine.toml").loop("x"))[0]}
    assert "own_law" not in catalogue()[Law]
    assert VARIABLE not in os.environ


def test_the_environment_names_them_too(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = written(folder, "PlainLaw", "plain_law")
    monkeypatch.setenv(VARIABLE, str(file))
    assert fd.read_machine("machine.toml").loop("x").control.law.kind == "plain_law"
    law = catalogue()[Law]["plain_law"]
    loop = fd.read_machine("machine.toml").loop("x")
    names = [each.name for each in candidates(loop, [law])[0]]
    assert names.count("plain law") == 1, "named by --law and found in the catalogue, it is one law"


def test_an_installed_package_names_them_by_entry_point(folder: Path) -> None:
    (folder / "site" / "packaged_law-1.dist-info").mkdir(parents=True)
    written(folder / "site", "PackagedLaw", "packaged_law")
    info = folder / "site" / "packaged_law-1.dist-info"
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: packaged-law\nVersion: 1\n", encoding="utf-8")
    (info / "entry_points.txt").write_text("[feeddrive.blocks]\npackaged_law = packaged_law\n", encoding="utf-8")
    code = "import feeddrive as fd; print(fd.read_machine('site/machine.toml').loop('x').control.law.kind)"
    path = os.pathsep.join([str(folder / "site"), str(Path(fd.__file__).parents[1])])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path}, check=True
    )
    assert done.stdout.strip() == "packaged_law"
    (folder / "site" / "packaged_law.py").write_text("import nothing_of_this_name\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path}
    )
    assert "the installed package 'packaged-law' (mend or uninstall it): it cannot be imported" in done.stderr


WRONG = {
    "no_file.py": "there is no file",
    "os.path": "holds no concrete block",
    "nothing_of_this_name": "No module named 'nothing_of_this_name'",
    "broken.py": "SyntaxError: .*line 2",
    "failing.py": "NameError: .*line 2 of failing.py",
    "json.py": "Python already has a module 'json'",
    "cascade_ppi_too.py": "the kind 'cascade_ppi' is that of feeddrive.blocks.controller.cascade_ppi:CascadePPI",
}


@pytest.mark.parametrize("place", WRONG)
def test_places_that_cannot_be_used_say_why(place: str, folder: Path) -> None:

    (folder / "broken.py").write_text("x = 1\ndef f(:\n", encoding="utf-8")
    (folder / "failing.py").write_text("x = 1\ny = z\n", encoding="utf-8")
    (folder / "json.py").write_text("x = 1\n", encoding="utf-8")
    (folder / "cascade_ppi_too.py").write_text(LAW.format(name="CascadePPI", force="force"), encoding="utf-8")
    result = CliRunner().invoke(app, ["certify", "emps", "--blocks", place])
    assert isinstance(result.exception, ParameterError | StructureError)
    assert re.search(WRONG[place], str(result.exception)), result.exception


@pytest.mark.parametrize(
    ("force", "said"),
    [
        ("math.sqrt(force)", r"bent_law.py, line \d+: .*: a law writes ops\.sqrt"),
        ("force if force > 0.0 else 0.0", r"bent_law.py, line \d+: .*ops\.where"),
        ("forse", r"bent_law.py, line \d+: NameError: name 'forse' is not defined"),
        ("setpoint.speed", r"bent_law.py, line \d+: AttributeError: .*'speed'"),
    ],
)
def test_a_law_that_leaves_its_language_is_an_error_in_one_line(force: str, said: str, folder: Path) -> None:
    """It was a traceback of a TypeError."""
    written(folder, "BentLaw", "bent_law", force)
    result = CliRunner().invoke(app, ["certify", "machine.toml", "--blocks", "bent_law.py"])
    assert isinstance(result.exception, StructureError)
    assert re.search(said, str(result.exception)), result.exception


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        ("return force", "step must return (state, force), not Symbol"),
        ("return state, force, force", "step must return (state, force), not tuple"),
        ("return (*state, 0.0), force", "step returns a state with the numbers 0, 1; start gave one with 0"),
    ],
)
def test_a_step_that_returns_something_else_says_what(returned: str, said: str, folder: Path) -> None:
    """It was a traceback: "cannot unpack non-iterable Symbol object"."""
    file = written(folder, "OtherLaw", "other_law")
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("return (reading.position_load,), force", returned), encoding="utf-8")
    result = CliRunner().invoke(app, ["certify", "machine.toml", "--blocks", "other_law.py"])
    assert isinstance(result.exception, StructureError)
    assert said in str(result.exception)


def test_the_battery_is_a_class_outside_of_tests() -> None:
    """Called in a test it would ask nothing, and pass."""
    with pytest.raises(StructureError, match=r"TestMyLaw = battery\(MyLaw\)"):
        battery(fd.blocks.CascadePPI)


@pytest.mark.parametrize(
    ("given", "said"),
    [("CascadePPI", "must be"), ("Law", "it lacks start, step"), ("", "needs a block")],
)
def test_the_battery_takes_concrete_blocks(given: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTEST_CURRENT_TEST")
    blocks = {"CascadePPI": [fd.blocks.CascadePPI(Kv=1.0, Kp=1.0)], "Law": [Law], "": []}[given]
    with pytest.raises(fd.FeeddriveError, match="no class" if given == "CascadePPI" else said):
        battery(*blocks)  # type: ignore[arg-type]


OWN_TEST = """\
from feeddrive.testing import battery
from {module} import {name}

Test{name} = battery({name})
"""


@pytest.mark.parametrize(
    ("force", "rows"),
    [
        ("force", set[str]()),
        ("force if force > 0.0 else 2.0 * force", {"symbols", "lanes", "native", "c", "slopes"}),
        ("ops.where(force < 1e308, force, 0.0) / 0.0", {"answers"}),
    ],
    ids=["sound", "branch", "infinite"],
)
@pytest.mark.slow(reason="a pytest in a process of its own, which compiles the law: 10 s each")
def test_the_battery_finds_what_is_wrong_with_a_law(force: str, rows: set[str], folder: Path) -> None:
    written(folder, "AskedLaw", "asked_law", force)
    (folder / "test_asked_law.py").write_text(OWN_TEST.format(module="asked_law", name="AskedLaw"), encoding="utf-8")
    path = os.pathsep.join([str(Path(fd.__file__).parents[1])])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        timeout=250,
    )
    found = {line.split("::test_")[1].split("_")[0] for line in done.stdout.splitlines() if line.startswith("FAILED")}
    assert found == rows if not rows else found >= rows, done.stdout[-3000:]
    assert "passed" in done.stdout


TWISTING = """
[[law]]
name = "twisting"
[law.control.law]
kind = "square_root_mode"
rate = 60
reaching = 1000
twisting = 3000
"""


def test_a_job_runs_a_law_without_a_slope_and_says_that_nothing_is_proven(folder: Path) -> None:
    """It printed a phase margin of a slope that one count of the encoder had made."""
    moves = 'kind = "snap_limited_move"\ndistance_mm = 20\nvelocity = 0.2\nacceleration = 2\njerk = 100\nsnap = 1e4\n'
    (folder / "job.toml").write_text(f'machine = "linear_motor"\n[reference]\n{moves}{TWISTING}', encoding="utf-8")
    with with_blocks([str(EXAMPLES / "square_root_mode.py")]):
        found = fd.workflow.run("job.toml")
    assert re.search(r"twisting +[\d.]+ +[\d.]+ +[\d.]+ +- +- +-", str(found.table()))
    said = next(each for each in found.remarks if each.startswith("'twisting': no margins"))
    assert "that it is stable is not proven" in said
    assert "no finite slope (square_root_mode, square_root_mode.py, line" in said


def test_an_export_of_a_law_without_a_slope_is_equal_and_says_it_too(folder: Path) -> None:
    """It was refused: "a parameter overflows; check masses"."""
    law = str(EXAMPLES / "square_root_mode.py")
    bundled = Path(fd.files.__file__).parent / "bundled" / "machines" / "linear_motor.toml"
    text = bundled.read_text(encoding="utf-8")
    before, _, after = text.partition("[axis.x.control.law]")
    own = TWISTING.partition("[law.control.law]")[2]
    machine = f"{before}[axis.x.control.law]{own}\n[[axis{after.partition('[[axis')[2]}"
    (folder / "machine.toml").write_text(machine, encoding="utf-8")
    words = ["export", "machine.toml", "--target", "c", "--out", "c", "--blocks", law]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1, result.output
    assert "whether the loop is stable was not decided" in result.output
    if shutil.which("gcc") is None:
        pytest.skip("NOT TESTED: exported C needs gcc: apt-get install gcc libc6-dev")
    result = CliRunner().invoke(app, ["verify", "c", "--samples", "5000", "--blocks", law])
    assert result.exit_code == 0, result.output
    assert "EQUAL, bit for bit" in result.output


def made(name: str, *words: str) -> Path:
    result = CliRunner().invoke(app, ["new", "law", name, *words])
    assert result.exit_code == 0, result.output
    return Path(words[-1] if words else name)


def test_a_new_law_is_a_package_that_works(folder: Path) -> None:
    """Every file names it, its entry point is its module, and its machine file is stable with it."""
    place = made("spring_damper")
    wanted = {"pyproject.toml", "spring_damper.py", "test_spring_damper.py", "machine.toml", "README.md"}
    assert {each.name for each in place.iterdir()} == wanted
    text = "".join(each.read_text(encoding="utf-8") for each in place.iterdir())
    assert not re.search(r"my.?law", text, re.IGNORECASE)
    project = tomllib.loads((place / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["entry-points"]["feeddrive.blocks"] == {"spring_damper": "spring_damper"}
    with with_blocks([str(place / "spring_damper.py")]):
        loop = fd.read_machine(place / "machine.toml").loop("x")
        assert type(loop.control.law).__name__ == "SpringDamper"
        assert fd.stability(loop).stable


def test_a_class_name_keeps_its_capitals(folder: Path) -> None:
    place = made("PDLaw", "--out", "here")
    assert "class PDLaw(Law):" in (place / "pd_law.py").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["law", "cascade_ppi"], "there is a law of the kind 'cascade_ppi'"),
        (["law", "json"], "Python already has a module 'json'"),
        (["law", "class"], "cannot be the name of a law"),
        (["law", "a b"], "cannot be the name of a law"),
        (["law", "../above"], "cannot be the name of a law"),
        (["law", "a_b_c"], "would be the class ABC"),
        (["filter", "mine"], "feeddrive new law NAME"),
        (["law", "there"], "there: exists and was not written by feeddrive"),
    ],
)
def test_names_that_cannot_be_are_refused_and_nothing_is_written(words: list[str], said: str, folder: Path) -> None:
    (folder / "there").mkdir()
    (folder / "there" / "law.py").write_text("mine\n", encoding="utf-8")
    result = CliRunner().invoke(app, ["new", *words])
    assert isinstance(result.exception, fd.FeeddriveError)
    assert said in str(result.exception)
    assert [each.name for each in folder.rglob("*")] == ["there", "law.py"]


@pytest.mark.slow(reason="the rows of a law compile it: 10 s")
def test_a_law_without_a_slope_passes_the_battery(folder: Path) -> None:
    """Where all numbers are 0 it stands at its root, and has nothing to compare with differences."""
    text = OWN_TEST.format(module="square_root_mode", name="SquareRootMode")
    (folder / "test_square_root_mode.py").write_text(text, encoding="utf-8")
    path = os.pathsep.join([str(Path(fd.__file__).parents[1]), str(EXAMPLES)])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        timeout=250,
    )
    assert done.returncode == 0, done.stdout[-3000:]


@pytest.mark.slow(reason="the page of ten commands in a fresh environment: a minute")
def test_the_page_is_walked_from_an_empty_folder(folder: Path) -> None:
    """Every command of docs/tutorials/own_law.md in its order; the package is installed into its own environment."""
    subprocess.run([sys.executable, "-m", "venv", str(folder / "env")], check=True)
    site = next((folder / "env" / "lib").glob("python*/site-packages"))
    # no network: feeddrive and what it needs are those of this interpreter
    beside = [str(Path(fd.__file__).parents[1]), str(Path(pytest.__file__).parents[1])]
    (site / "beside.pth").write_text("\n".join(beside), encoding="utf-8")
    python, here = str(next((folder / "env").glob("*/python"))), folder
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTEST", "PYTHONPATH"))}
    page = (Path(__file__).parents[1] / "docs" / "tutorials" / "own_law.md").read_text(encoding="utf-8")
    consoles = re.findall(r"^```console\n\$ (.*)\n((?:.*\n)*?)```", page, re.MULTILINE)
    assert len(consoles) == 9
    for command, printed in consoles:
        words = shlex.split(command)
        if words[0] == "cd":
            here = here / words[1]
            continue
        if words[:3] == ["python", "-m", "pip"]:
            words = [*words[:4], "--no-deps", "--no-build-isolation", "--no-index", "-e", "."]
        if words[0] == "feeddrive":
            words = ["python", "-c", "from feeddrive.cli import main; main()", *words[1:]]
        done = subprocess.run(
            [python, *words[1:]], cwd=here, env=environment, capture_output=True, text=True, timeout=250
        )
        if "verify" in words and shutil.which("gcc") is None:
            pytest.skip("NOT TESTED to its end: `feeddrive verify` needs gcc: apt-get install gcc libc6-dev")
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
        for line in printed.splitlines():
            assert line in done.stdout, f"{command}: '{line}' is not in\n{done.stdout}"
