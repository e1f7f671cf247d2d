"""The line of the part program at each sample, against the path as programmed."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from feeddrive.path.limits import AxisLimits, MachineLimits
from feeddrive.path.program.moves import Arc, Straight
from feeddrive.path.program.reading import read_program
from feeddrive.path.setpoints import Setpoints

AXIS = AxisLimits(velocity=0.5, acceleration=5.0, jerk=100.0, snap=5e4)


def planned_rows(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions, m, shape (n, 3), and lines of a program at 1 kHz."""
    setpoints = Setpoints(read_program(path), MachineLimits(dict.fromkeys("XYZ", AXIS)), 1e-3)
    rows = [(samples.values[:, :, 0], samples.line) for samples in setpoints]
    assert setpoints.proven
    return np.concatenate([row[0] for row in rows]), np.concatenate([row[1] for row in rows])


def test_lines_of_one_direction_have_their_own_numbers(tmp_path: Path) -> None:
    """500 moves along X from 1 um to 5 mm are one piece of path: x alone says which line it is, up to 1e-12 m."""
    draw = np.random.default_rng(3)
    ends = np.cumsum(np.round(10.0 ** draw.uniform(-3.0, 0.7, 500), 4))
    path = tmp_path / "part.ngc"
    path.write_text("G64 P0.01 F6000\n" + "".join(f"G1 X{end:.4f}\n" for end in ends) + "M2\n", encoding="utf-8")
    positions, lines = planned_rows(path)
    x = positions[:, 0]
    early, late = (2 + np.searchsorted(1e-3 * ends, x + side) for side in (-1e-12, 1e-12))
    assert np.all((early <= lines) & (lines <= np.minimum(late, 501)))
    assert len(np.unique(lines)) > 250  # the path passes about 500 lines in 1,400 samples


def drawn(draw: np.random.Generator) -> str:
    """Lines from 2 um to 20 mm that go on straight, bend or turn sharply, and arcs between them."""
    point, heading, rows = np.zeros(2), 0.0, [f"G64 P{draw.choice([0.002, 0.01, 0.1])} F{draw.choice([600, 6000])}"]
    for _ in range(40):
        heading += float(draw.choice([0.0, 0.0, 0.01, 0.3, draw.uniform(-3.0, 3.0)]))
        if draw.random() < 0.15:
            radius = draw.uniform(0.5, 5.0)
            center = point + radius * np.array([-np.sin(heading), np.cos(heading)])
            heading += draw.uniform(0.2, 3.0)
            end = center + radius * np.array([np.sin(heading), -np.cos(heading)])
            i, j = center - point
            rows.append(f"G3 X{end[0]:.7f} Y{end[1]:.7f} I{i:.7f} J{j:.7f}")
            point = end
            continue
        for _ in range(int(draw.choice([1, 1, 5]))):
            point = point + 10.0 ** draw.uniform(-2.7, 1.3) * np.array([np.cos(heading), np.sin(heading)])
            rows.append(f"G1 X{point[0]:.7f} Y{point[1]:.7f}")
    return "\n".join([*rows, "M2\n"])


def distances(move: Straight | Arc, points: np.ndarray) -> np.ndarray:
    """The distance of points, shape (n, 2), to a move in X and Y, m."""
    start, end = np.array(move.start[:2]), np.array(move.end[:2])
    ends = np.minimum(*(np.linalg.norm(points - end_, axis=1) for end_ in (start, end)))
    if isinstance(move, Straight):
        way = end - start
        share = np.clip((points - start) @ way / (way @ way), 0.0, 1.0)
        return np.linalg.norm(points - start - share[:, None] * way, axis=1)
    from_center = points - np.array(move.center)
    begin = np.arctan2(*(start - np.array(move.center))[::-1])
    turned = np.mod(np.arctan2(from_center[:, 1], from_center[:, 0]) - begin, 2.0 * np.pi)
    on = turned <= move.angle
    return np.where(on, np.abs(np.linalg.norm(from_center, axis=1) - move.radius), ends)


@pytest.mark.parametrize("seed", range(4))
def test_each_sample_is_within_the_tolerance_of_its_line(seed: int, tmp_path: Path) -> None:
    """The point of the path that belongs to a sample lies on the line that the sample names; 1e-8 m for I and J.

    No line is named after a later one.
    """
    path = tmp_path / "part.ngc"
    text = drawn(np.random.default_rng(seed))
    path.write_text(text, encoding="utf-8")
    tolerance = 1e-3 * float(text.split("P", 1)[1].split(" ", 1)[0])
    moves = {move.source.number: move for move in read_program(path) if isinstance(move, Straight | Arc)}
    positions, lines = planned_rows(path)
    assert np.all(np.diff(lines) >= 0)
    apart = np.concatenate([distances(moves[n], positions[lines == n, :2]) for n in np.unique(lines)])
    assert np.max(apart) <= tolerance + 1e-8


def test_a_line_that_runs_again_is_named_again(tmp_path: Path) -> None:
    """A subroutine of collinear moves, called twice: its lines come twice, in order."""
    path = tmp_path / "part.ngc"
    body = "G91\nG1 X1\nX1\nX1\nG90\n"
    path.write_text(f"o1 sub\n{body}o1 endsub\nG64 P0.01 F6000\no1 call\no1 call\nM2\n", encoding="utf-8")
    _, lines = planned_rows(path)
    changes = [before for before, after in pairwise([*lines.tolist(), 0]) if before != after]
    assert changes == [3, 4, 5, 3, 4, 5]
