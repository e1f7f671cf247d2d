"""What was done on the page gives the same numbers from the command line, from Python and as a job."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import feeddrive as fd
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
