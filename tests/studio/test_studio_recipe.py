"""What was done on the page gives the same numbers from the command line, from Python and as a job."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language import tree
from feeddrive.language.block import declarations
from feeddrive.studio.bench import bench_of
from feeddrive.studio.rooms.export import recipe_of
from feeddrive.studio.server import Session
from feeddrive.workflow.tune import TuneRequest


def done(session: Session, do: str, **more: Any) -> None:
    """An act, and the end of the work that it began."""
    said = session.answer({"number": 1, "do": do, **more})
    assert re.search(rb'"error": ?"[^"]', said) is None, said
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
    done(session, "export.export", target="parameters")
    done(session, "export.machine")
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


def words_of(session: Session) -> list[list[str]]:
    """The commands of the recipe in words, without comments."""
    return [shlex.split(each) for each in recipe_of(session.desk).commands.splitlines() if each[:1] not in ("", "#")]


def test_the_last_command_writes_the_control_of_now_after_an_undo(tmp_path: Path) -> None:
    session = Session(tmp_path, bench_of("linear_motor"))
    for value in (110.0, 130.0):
        done(session, "tune.move", name="law.Kv", value=value, begins=True)
        session.desk.machine_path()
    assert [each[-2:] for each in words_of(session)][-1][-1] == str(tmp_path / "machine.toml")
    assert [each[each.index("--set") + 1] for each in words_of(session)] == ["law.Kv=110.0", "law.Kv=130.0"]
    done(session, "tune.undo")
    wanted = ["law.Kv=110.0", "law.Kv=130.0", "law.Kv=110.0"]
    assert [each[each.index("--set") + 1] for each in words_of(session)] == wanted
    session.desk.machine_path()
    assert [each[each.index("--set") + 1] for each in words_of(session)] == wanted
    assert fd.read_machine(tmp_path / "machine.toml").loop(None).control.law.Kv == 110.0  # type: ignore[attr-defined]


def test_two_part_programs_have_a_job_and_a_run_each(tmp_path: Path) -> None:
    session = Session(tmp_path, bench_of("xy_table", "x"))
    (tmp_path / "other").mkdir()
    for text in ("G1 X1 F600", "G1 X2 F600"):  # brought under the same name, one after the other
        part = tmp_path / "other" / "part.ngc"
        part.write_text(f"G21 G90\n{text}\nM2\n", encoding="utf-8")
        session.desk.programs["part.ngc"] = part
        done(session, "program.plan", name="part.ngc")
        done(session, "program.run", name="part.ngc")
    jobs = [Path(each[2]) for each in words_of(session) if each[1] == "run"]
    assert len(set(jobs)) == len(jobs) == 2
    for job, text in zip(jobs, ("X1", "X2"), strict=True):
        part = tmp_path / tomllib.loads(job.read_text(encoding="utf-8"))["program"]["file"]
        assert text in part.read_text(encoding="utf-8")
        assert f"# {job}: the job of {part.name}" in recipe_of(session.desk).commands
    assert session.rooms["export"].show().words["results"] == [{"name": name, "said": ""} for name in ("run", "run_2")]


def test_what_led_to_a_source_stays_in_the_recipe(tmp_path: Path) -> None:
    """Responses are estimated from a log, two of them are chosen, and a control is certified on another machine."""
    (tmp_path / "brought").mkdir()
    random = np.random.default_rng(1)
    force = 100.0 * random.standard_normal(6000)
    velocity = np.convolve(force, 1e-4 * 0.9 ** np.arange(200.0))[:6000]  # 10 kg with friction, at 1 kHz
    position = np.concatenate([[0.0], 1e-3 * np.cumsum(velocity)[:-1]])
    table = np.column_stack([np.arange(6000) * 1e-3, force, 1e3 * position])
    log = tmp_path / "brought" / "log.csv"
    np.savetxt(log, table, delimiter=",", header="t,kraft_N,lageistwert_mm", comments="")
    session = Session(tmp_path)
    session.desk.files["log.csv"] = log
    done(session, "import.look", names=["log.csv"])
    done(session, "import.estimate", name="log.csv")
    (estimated,) = words_of(session)
    roles = Path(estimated[estimated.index("--channels") + 1])
    assert f"# {roles}: roles of columns" in recipe_of(session.desk).commands
    bring: Any = session.rooms["import"]
    name = next(each.name for each in bring.files.values() if each.responses)
    load = bring.files[name].responses[0]
    done(session, "import.responses", name=name, load=load, machine="linear_motor")
    assert words_of(session) == [estimated]
    chosen = str(session.desk.needed.sources.source)
    session.desk.did("tune", TuneRequest(chosen))
    assert f"# {chosen}: responses that were chosen" in recipe_of(session.desk).commands
    done(session, "import.bundled", name="linear_motor")
    assert words_of(session)[0] == estimated


def test_the_job_begins_with_the_control_that_was_brought(bare: Path, tmp_path: Path) -> None:
    """Though the control of now stands in another file that a command has written."""
    folder = tmp_path / "page"
    folder.mkdir()
    session = Session(folder, bench_of(bare))
    done(session, "tune.add", kind="notch")
    done(session, "export.guard", following_error_limit=2.5)
    begun: Any = session.desk.control
    session.desk.exchange(replace(begun, law=replace(begun.law, Tn=0.01)), folder / "tuned.toml")
    assert session.desk.base == folder / "tuned.toml"
    path = tmp_path / "job.toml"
    path.write_text(recipe_of(session.desk).job, encoding="utf-8")
    job = fd.read_job(path)
    assert Path(tomllib.loads(path.read_text(encoding="utf-8"))["machine"]) == bare
    today, by_hand = (each.control for each in job.loops.values())
    wanted = replace(session.desk.control, guard=by_hand.guard)
    assert dict(tree.leaves(today)) == dict(tree.leaves(session.desk.needed.before.start))
    assert dict(tree.leaves(by_hand)) == dict(tree.leaves(wanted))
    assert {"law.Tn", "filters.0.frequency"} <= dict(tree.leaves(by_hand)).keys() - dict(tree.leaves(today)).keys()


def test_the_job_of_an_axis_that_turns_names_its_units(tmp_path: Path) -> None:
    job = recipe_of(Session(tmp_path, bench_of("rotary_table")).desk).job
    said = {each.partition("#")[2].split(":")[0].strip() for each in job.splitlines() if ":" in each.partition("#")[2]}
    assert {"rad", "N m"} <= said
    assert not said & {"m", "N", "m/s", "m/s²", "m/s^2"}


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
    fields = {each["name"]: each for each in session.rooms["export"].show().words["bounds"]}
    assert list(fields) == [name for name in declarations(fd.Guard) if not getattr(fd.Guard(), name)]
    assert (fields["following_error_limit"]["unit"], fields["velocity_limit"]["unit"]) == ("mm", "m/s")
    assert b"a guard needs a bound" in session.answer({"number": 1, "do": "export.guard", "safe_force": 3.0})
    done(session, "tune.move", name="law.Kv", value=55.0)
    done(session, "export.guard", following_error_limit=2.5, velocity_limit=1.5)
    done(session, "export.machine")
    assert session.rooms["export"].show().words["bounds"] == []
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
    assert session.rooms["export"].show().words["bounds"] != []


def test_a_goal_that_needs_an_integral_says_so_before_the_search(bare: Path, tmp_path: Path) -> None:
    """What it advises works: the law by its name begins with one. What is accepted stands in the file of the search."""
    folder = tmp_path / "page"
    folder.mkdir()
    session = Session(folder, bench_of(bare))
    goal = session.rooms["optimize"]
    assert "no integral action" in goal.show().words["begins"]
    done(session, "optimize.set", field="law", value="cascade_ppi")
    assert goal.show().words["begins"] == ""
    done(session, "optimize.set", field="starts", value="1")
    done(session, "optimize.tune")
    done(session, "optimize.accept")
    assert "law.Tn" in session.desk.values
    assert session.desk.machine_path() == folder / "tuned" / "machine.toml"
    assert session.desk.kept == {}
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
