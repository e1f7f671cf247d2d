"""A folder that somebody sent is read, and nothing in it is run: docs/reference/security.md."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from feeddrive.files.read_log import read_columns
from small_study import small_study

# modules that Python, numpy or feeddrive import in child processes
NAMES = ("json", "numpy", "multiprocessing", "struct", "h5py", "feeddrive")
STUDY = small_study(4, 2)


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with modules that write a file when they are imported."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.py").write_text(f"open({str(tmp_path / 'run')!r}, 'a').write('{name} ')\n", encoding="utf-8")
    monkeypatch.chdir(folder)
    return folder


def test_the_process_that_reads_hdf5_imports_nothing_from_there(foreign: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="pip install 'feeddrive[matlab]'")
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file["x"] = np.arange(3.0)
    assert read_columns("log.mat", content.getvalue(), None).values["x"].tolist() == [0.0, 1.0, 2.0]
    assert not (foreign.parent / "run").exists()


@pytest.mark.slow(reason="the command and its processes take seconds to begin")
def test_the_workers_of_a_command_import_nothing_from_there(foreign: Path) -> None:
    """The command as a script in another folder, as pip installs it."""
    (foreign / "small.toml").write_text(STUDY, encoding="utf-8")
    script = foreign.parent / "feeddrive_command.py"
    script.write_text("from feeddrive.cli import main\n\nif __name__ == '__main__':\n    main()\n", encoding="utf-8")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    words = [sys.executable, str(script), "sweep", "small.toml", "--out", "../rows", "--workers", "2"]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert not (foreign.parent / "run").exists()
