"""What holds for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# Before numpy is there: the tests share the cores already, and small matrices gain nothing by more threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# No deadline: a busy machine must not fail a proof; a found counterexample prints how to run it again.  CI draws the
# same examples every time, so that a landing does not hang on the dice; everybody else draws new ones.
settings.register_profile("feeddrive", deadline=None, print_blob=True, derandomize=bool(os.environ.get("CI")))
settings.load_profile("feeddrive")

# Measured files that are not part of the repository: they lie beside it, or the tests that need them are skipped.
SHARED = Path(__file__).parents[1].parent / "shared" / "data"


@pytest.fixture
def shared() -> Path:
    """The folder of measured files."""
    if not SHARED.is_dir():
        pytest.skip(f"NOT TESTED on measured files: the folder {SHARED} is not there")
    return SHARED


@pytest.fixture
def emps(shared: Path) -> Path:
    """The log of the EMPS ball-screw axis (Janot, Gautier & Brunot 2019)."""
    path = shared / "emps" / "DATA_EMPS.mat"
    if not path.exists():
        pytest.skip(f"NOT TESTED on the EMPS axis: {path} is not there")
    return path
