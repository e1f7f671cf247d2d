"""Measured files that are not part of the repository: they lie beside it, or the tests that need them are skipped."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).parents[2].parent / "shared" / "data"


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
