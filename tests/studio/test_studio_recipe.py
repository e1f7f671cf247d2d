"""What was done on the page gives the same numbers from the command line, from Python and as a job."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import feeddrive as fd
from feeddrive.language import tree
from feeddrive.studio.bench import bench_of
from feeddrive.studio.recipe import recipe_of
from feeddrive.studio.session import Session


def done(session: Session, do: str, **more: Any) -> None:
    """An act, and the end of the work that it began."""
    said = session.answer({"number": 1, "do": do, **more})
    assert b'"error": "' not in said
    job = session.desk.job
    if job is not None:
        job.join(120.0)
        assert job.state.error == ""


@pytest.fixture(scope="module")
def worked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Session, Path]:
    """A page on which a number was moved, a filter added, the loop certified and its control exported."""
    folder = tmp_path_factory.mktemp("page")
    session = Session(folder, bench_of("linear_motor"))
    name = next(each for each in session.desk.values if each.startswith("law."))
    done(session, "tune.move", name=name, value=0.9 * session.desk.values[name])
    done(session, "tune.add", kind="notch")
    done(session, "tune.move", name="filters.0.damping_pole", value=0.2)
    done(session, "prove.certify")
    done(session, "take.export", target="parameters")
    done(session, "take.machine")
    return session, folder


def kept(folder: Path) -> tuple[str, Any]:
    """The machine file and what the certificate says, without when and where."""
    certificate = json.loads((folder / "certificate" / "certificate.json").read_text(encoding="utf-8"))
    return (folder / "machine.toml").read_text(encoding="utf-8"), certificate["control"]


def test_commands_and_python_write_the_same(worked: tuple[Session, Path], tmp_path: Path) -> None:
    session, folder = worked
    found = recipe_of(session.desk)
    wanted = kept(folder)
    main = f"{sys.executable} -c 'from feeddrive.cli.commands import app; app()'"
    commands = found.commands.replace("feeddrive ", f"{main} ").replace(str(folder), str(tmp_path / "commands"))
    (tmp_path / "commands").mkdir()
    subprocess.run(["sh", "-e", "-c", commands], check=True, capture_output=True, timeout=120.0)
    assert kept(tmp_path / "commands") == wanted
    (tmp_path / "python").mkdir()
    script = found.python.replace(str(folder), str(tmp_path / "python"))
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, timeout=120.0)
    assert kept(tmp_path / "python") == wanted
    assert len(found.python.splitlines()) <= 10


def test_the_job_runs_today_and_the_control_by_hand(worked: tuple[Session, Path], tmp_path: Path) -> None:
    session, _ = worked
    job = tmp_path / "job.toml"
    job.write_text(recipe_of(session.desk).job, encoding="utf-8")
    today, by_hand = fd.workflow.run(str(job)).rows
    bench = session.desk.needed
    for row, control in ((today, bench.before.start), (by_hand, session.desk.control)):
        run = bench.run(control, row.name)
        assert float(abs(row.run["following_error"]).max()) == pytest.approx(
            float(abs(run["following_error"]).max()), rel=1e-9
        )


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """A machine file as an identification writes it: a cascade without integral, filters or guard."""
    path = tmp_path / "bare.toml"
    text = fd.read_machine("linear_motor").file.text
    control = text.index("[axis.x.control]")
    law = "[axis.x.control]\n[axis.x.control.law]\nkind = 'cascade_ppi'\nKv = 60\nKp = 2e4\n"
    path.write_text(text[:control] + law, encoding="utf-8")
    return path


def test_a_guard_is_added_on_the_page_and_by_the_commands(bare: Path, tmp_path: Path) -> None:
    folder = tmp_path / "page"
    folder.mkdir()
    session = Session(folder, bench_of(bare))
    fields = {each["name"]: each for each in session.rooms["take"].show().words["bounds"]}
    assert (fields["following_error_limit"]["unit"], fields["velocity_limit"]["unit"]) == ("mm", "m/s")
    assert b"a guard needs a bound" in session.answer({"number": 1, "do": "take.guard", "safe_force": 3.0})
    done(session, "tune.move", name="law.Kv", value=55.0)
    done(session, "take.guard", following_error_limit=2.5, velocity_limit=1.5)
    done(session, "take.machine")
    assert session.rooms["take"].show().words["bounds"] == []
    wanted = fd.read_machine(folder / "machine.toml").loop(None).control
    assert wanted.guard is not None
    assert (wanted.guard.following_error_limit, wanted.guard.velocity_limit) == (2.5e-3, 1.5)
    assert dict(tree.leaves(wanted))["law.Kv"] == 55.0
    (tmp_path / "again").mkdir()
    script = recipe_of(session.desk).python.replace(str(folder), str(tmp_path / "again"))
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, timeout=120.0)
    again = fd.read_machine(tmp_path / "again" / "guarded.toml").loop(None).control
    assert tree.structure(again) == tree.structure(wanted)
    assert dict(tree.leaves(again)) == dict(tree.leaves(wanted))
    done(session, "tune.undo")
    assert session.rooms["take"].show().words["bounds"] != []


def test_a_goal_that_needs_an_integral_says_so_before_the_search(bare: Path, tmp_path: Path) -> None:
    """What it advises works: the law by its name begins with one. What is accepted stands in the file of the search."""
    folder = tmp_path / "page"
    folder.mkdir()
    session = Session(folder, bench_of(bare))
    goal = session.rooms["goal"]
    assert "no integral action" in goal.show().words["begins"]
    done(session, "goal.set", field="law", value="cascade_ppi")
    assert goal.show().words["begins"] == ""
    done(session, "goal.set", field="starts", value="1")
    done(session, "goal.tune")
    done(session, "goal.accept")
    assert "law.Tn" in session.desk.values
    assert session.desk.machine_path() == folder / "tuned" / "machine.toml"
    assert session.desk.kept == []
    done(session, "tune.undo")
    assert "law.Tn" not in session.desk.values


def test_the_recipe_names_a_control_that_no_command_writes(bare: Path, tmp_path: Path) -> None:
    """As the best so far of a search that was stopped: its file is to be kept."""
    folder = tmp_path / "page"
    folder.mkdir()
    session = Session(folder, bench_of(bare))
    control: Any = session.desk.control
    session.desk.take(replace(control, law=replace(control.law, Tn=0.01)))
    done(session, "prove.certify")
    found = recipe_of(session.desk)
    assert found.commands.startswith(f"# {folder / 'begun.toml'}: a control that was chosen on the page")
    assert f"# {folder / 'begun.toml'}" in found.python
