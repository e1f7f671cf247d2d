"""Why MDF4 and MATLAB 5 files have readers of our own: damaged files that end the process in the usual libraries.

Each file is a small valid one after the mutations of `test_files_fuzz.damaged` with a fixed seed.  The library reads it
in a process of its own, which is killed by a segmentation fault; our reader refuses it with its name.  A test that
fails here says that the reason may be gone: then the library could take the place of our reader.
"""

from __future__ import annotations

import importlib.util
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from mdf_files import mdf4
from test_files_fuzz import COLUMNS, damaged, mat, outcome

from feeddrive.files.log import Log
from feeddrive.files.read_log import read_log

LOADMAT = "import sys, scipy.io; scipy.io.loadmat(sys.argv[1])"
ASAMMDF = """
import io, logging, pathlib, sys
import asammdf
logging.disable(50)
with asammdf.MDF(io.BytesIO(pathlib.Path(sys.argv[1]).read_bytes())) as file:
    for name in list(file.channels_db):
        try:
            file.get(name)
        except Exception:
            pass
"""


def ends(code: str, path: Path) -> int:
    """How a process that runs some Python on a file ends: its exit code, or minus the signal that killed it."""
    return subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, timeout=100).returncode


def check(code: str, content: bytes, seeds: tuple[int, ...], path: Path) -> None:
    path.write_bytes(content)
    assert ends(code, path) == 0, "the library reads the file as it was before the damage"
    killed = []
    for seed in seeds:
        path.write_bytes(damaged(content, random.Random(seed)))
        found = outcome(lambda: read_log(path))
        assert isinstance(found, Log) or found.startswith(f"{path}: ")
        if ends(code, path) == -signal.SIGSEGV:
            killed.append(seed)
            break
    assert killed, "no file of these crashes the library any more: is a reader of our own still needed?"


def test_loadmat_crashes_on_a_damaged_file(tmp_path: Path) -> None:
    check(LOADMAT, mat(packed=False), (430, 506, 511), tmp_path / "a.mat")


def test_asammdf_crashes_on_a_damaged_file(tmp_path: Path) -> None:
    if importlib.util.find_spec("asammdf") is None:
        pytest.skip("NOT TESTED: asammdf (extra dev) is not installed")
    check(ASAMMDF, mdf4(COLUMNS, 1e-3, packed=True), (389, 592, 1543, 4378, 4973), tmp_path / "a.mf4")
