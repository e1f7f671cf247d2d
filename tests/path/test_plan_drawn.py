"""Drawn programs through the whole of `feeddrive plan`: each is planned, proven and sampled, or refused at its line."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.files.machine import planned_limits
from feeddrive.language.errors import ProgramError
from feeddrive.path.limits import MachineLimits
from feeddrive.path.program.moves import Arc, Move, Straight
from feeddrive.path.program.reading import read_program
from feeddrive.path.setpoints import Setpoints
from fresh_draws import Seeded

LIMITS = planned_limits(fd.read_machine("mill"), None)
MODES = (
    "G64",
    "G64 P0.01",
    "G64 P0.2",
    "G61",
    "G61.1",
    "G4 P0.01",
    "M3 S100",
    "M5",
    "G91",
    "G90",
    "G17",
    "M8",
    "G2",
    "G5",
)


def program(draw: random.Random) -> str:
    """Lines, arcs with I J and R, helices, modes, dwells and switches, from 1 um to 10 mm long."""
    size = draw.choice([0.001, 0.01, 1.0, 10.0])

    def word() -> str:
        return f"{draw.uniform(-size, size):.4f}"

    lines = [f"G21 G90 F{draw.choice([100, 600, 3000, 50000])}"]
    for _ in range(draw.randint(1, 25)):
        kind = draw.random()
        if kind < 0.15:
            lines.append(draw.choice([*MODES, f"F{draw.uniform(200.0, 9000.0):.3f}"]))
        elif kind < 0.3:
            lines.append(f"G0 X{word()} Y{word()}")
        elif kind < 0.7:
            lines.append("G1 " + " ".join(axis + word() for axis in draw.sample("XYZ", draw.randint(1, 3))))
        elif kind < 0.8:
            lines.append(f"G2 X{word()} Y{word()} R{draw.uniform(2.0 * size, 4.0 * size):.4f}")
        elif kind < 0.9:
            lines.append(f"G3 I{word()} J{word()} Z{word()}")
        else:
            lines.append(f"G1 X{word()} Y{word()}\nX0.00{draw.randint(0, 9)}")
    return "\n".join(lines) + "\nM2\n"


def check(path: Path, T: float, limits: MachineLimits) -> bool:
    """The samples of a program keep limits, follow from each other and end where it ends; False if it is refused."""
    ends: list[tuple[float, ...]] = [(0.0, 0.0, 0.0)]

    def noted(moves: Iterator[Move]) -> Iterator[Move]:
        for move in moves:
            if isinstance(move, Straight | Arc):
                ends.append(move.end[:3])
            yield move

    moves = read_program(path, axes=limits.travel, front_end="own")
    setpoints = Setpoints(noted(moves), limits, T)
    try:
        values = np.concatenate([each.values for each in setpoints])
    except ProgramError:
        return False
    finally:
        moves.close()
    most = limits.array
    assert setpoints.proven, setpoints.prover.proof().faults[0]
    assert np.all(np.abs(values[:, :, 1:]) <= most * (1.0 + 1e-9))
    assert len(values) == setpoints.samples == int(np.ceil(setpoints.time / T * (1.0 - 1e-12))) + 1
    assert np.max(np.abs(values[-1, :, 0] - ends[-1])) <= 1e-12
    assert not np.any(values[-1, :, 1:])
    # a Taylor step to snap misses by the jumps of the snap, at most 2 s T^4 / 24, and by rounding
    x, v, a, j, s = np.moveaxis(values[:-1], 2, 0)
    ahead = x + T * (v + T * (a / 2.0 + T * (j / 6.0 + T * s / 24.0)))
    assert np.all(np.abs(ahead - values[1:, :, 0]) <= most[:, 3] * T**4 / 12.0 + 1e-14)
    assert sum(setpoints.seconds.values()) == pytest.approx(setpoints.time, abs=2.01 * T)
    return True


def run(count: int, seed: int, folder: Path) -> int:
    """How many of so many programs are planned."""
    draw, planned = random.Random(seed), 0
    for _ in range(count):
        path = folder / "part.ngc"
        path.write_text(program(draw), encoding="utf-8")
        planned += check(path, draw.choice([1e-3, 2.5e-4, 1e-2]), LIMITS)
    return planned


def test_drawn_programs_become_setpoints_or_one_error(tmp_path: Path, seeded: Seeded) -> None:
    """Of ten some are planned: three of four have no G5, no G2 without a center and no radius that is too short."""
    assert run(10, seeded(1), tmp_path) > 1


@pytest.mark.slow(reason="500 programs: 60 s")
def test_very_many_drawn_programs_become_setpoints_or_one_error(tmp_path: Path) -> None:
    assert run(500, 2, tmp_path) > 250
