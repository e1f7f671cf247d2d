"""`feeddrive setpath`: the written path is the one that the table follows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language.errors import FeeddriveError, ParameterError


def test_the_written_path_is_followed(tmp_path: Path) -> None:
    out = tmp_path / "path.csv"
    found = fd.workflow.setpath("linear_motor", out=out)
    rows = np.loadtxt(out, delimiter=",", skiprows=1)
    assert np.array_equal(rows[:, 1], found.reference.position)
    loop = fd.read_machine("linear_motor").loop("x")
    path = fd.blocks.Recorded(position=rows[:, 1], sample_time=float(loop.sample_time))
    run = fd.simulate(loop, path, record=["position_load"])
    off = 1e6 * np.max(np.abs(run["position_load"] - rows[: run.time.size, 2]))
    assert off < 3.0  # friction and ripple are left


def test_what_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="--window = 20 is for --method splines"):
        fd.workflow.setpath("linear_motor", window=20)
    with pytest.raises(ParameterError, match="polynomials of degree 12 have lost their digits; take filtered splines"):
        fd.workflow.setpath("ball_screw")
    with pytest.raises(FeeddriveError, match="no_such"):
        fd.workflow.setpath("no_such", out=tmp_path / "path.csv")
    assert not (tmp_path / "path.csv").exists()
