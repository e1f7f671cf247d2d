"""Recorded setpoints, smoothed: what the filter does to a motion, and a job that runs them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language.errors import FeeddriveError
from feeddrive.path.smoothing import reach, smoothed

H = 1e-3


@pytest.mark.parametrize("average", [1, 2, 5])
def test_the_filter_moves_a_bend_by_what_is_stated_and_delays_nothing(average: int) -> None:
    """Off by a h² ((n² - 1)/6 + 1/4), and less than 1e-4 of that from higher derivatives, h = 1 ms over 2 s."""

    def motion(t: np.ndarray) -> np.ndarray:
        s = np.clip((t - 0.5) / 2.0, 0.0, 1.0)
        return 0.05 * s**5 * (126.0 - 420.0 * s + 540.0 * s**2 - 315.0 * s**3 + 70.0 * s**4)

    t = np.arange(0.0, 2.9, 2.5e-4)
    found = smoothed(motion(np.arange(3000) * H), H, average, t)
    acceleration = (motion(t + 1e-4) - 2.0 * motion(t) + motion(t - 1e-4)) / 1e-8
    off = acceleration * H**2 * ((average**2 - 1) / 6.0 + 0.25)
    assert np.max(np.abs(found[:, 0] - motion(t) - off)) <= 1e-4 * np.max(np.abs(off))


def test_derivatives_are_those_of_the_position() -> None:
    """Of a corner in time: each derivative integrated by Simpson's rule gives the one below, to 1e-9 of its peak.

    Between rows q is of degree five: with ten steps a row Simpson's rule misses by less than rounding.
    """
    corner = np.concatenate([np.zeros(50), np.arange(200) * 1e-4, np.full(50, 199e-4)])
    rows = smoothed(corner, H, 3, np.arange(0.0, 0.3, H / 10.0))
    for k in range(4):
        steps = (H / 30.0) * (rows[:-2:2, k + 1] + 4.0 * rows[1:-1:2, k + 1] + rows[2::2, k + 1])
        ahead = rows[:-2:2, k] + steps
        assert np.max(np.abs(ahead - rows[2::2, k])) <= 1e-9 * np.max(np.abs(rows[:, k]))
    assert reach(3) == 7
    assert not np.any(rows[: 10 * (50 - 7), 1:])


def recorded(folder: Path, more: str = "") -> Path:
    """A record of x and y in mm that begins in motion."""
    x = np.linspace(0.0, 3.0, 60)
    np.savetxt(folder / "log.csv", np.column_stack([x, 0.5 * x]), delimiter=",", header="x_mm,y_mm", comments="")
    job = folder / "job.toml"
    job.write_text(
        'machine = "xy_table"\naxis = "x"\n[program]\nrecorded = "log.csv"\nsample_time_ms = 1\n'
        f'average_ms = 2\ncolumns = {{ x = "x_mm", y = "y_mm" }}\n{more}',
        encoding="utf-8",
    )
    return job


def test_a_job_takes_recorded_setpoints_from_rest_to_rest(tmp_path: Path) -> None:
    job = fd.read_job(recorded(tmp_path))
    assert "averaged four times over 2 rows" in job.program.description
    x, y = job.reference, job.others["y"].reference
    assert x is not None
    assert y is not None
    assert x.duration == pytest.approx(59e-3 + 2 * reach(2) * H, abs=2.5e-4)
    ends = np.array([0.0, x.duration])
    assert x.at(ends).position == pytest.approx([0.0, 3e-3], abs=1e-12)
    assert np.max(np.abs(x.at(ends).velocity)) == pytest.approx(0.0, abs=1e-9)
    t = np.arange(0.0, x.duration, 2.5e-4)
    np.testing.assert_allclose(y.at(t).position, 0.5 * x.at(t).position, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ('file = "part.ngc"\n', "'program.file' is not known"),
        ('[others.y.reference]\nkind = "circle"\nradius = 1.0\nfeed = 1.0\n', "others.y.reference: the program gives"),
    ],
)
def test_what_does_not_fit_recorded_setpoints_is_refused(more: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(FeeddriveError, match=said):
        fd.read_job(recorded(tmp_path, more))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "average_ms = 2",
            "average_ms = -2",
            r"job.toml:6: program.average = -0.002 s \(.*\) must be > 0 s .*given as average_ms = -2",
        ),
        ("average_ms", "average_mm", r"program.average_mm"),
        ("x_mm", "z_mm", "z_mm"),
        ("{ x =", "{ w =", r"job.toml:7: key 'program.columns.w' is not known"),
    ],
)
def test_a_wrong_record_is_refused(old: str, new: str, said: str, tmp_path: Path) -> None:
    job = recorded(tmp_path)
    job.write_text(job.read_text().replace(old, new), encoding="utf-8")
    with pytest.raises(FeeddriveError, match=said):
        fd.read_job(job)
