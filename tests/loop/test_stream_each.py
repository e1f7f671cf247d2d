"""Systems that differ in numbers, run together in the lanes of a vector."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language.errors import DivergedError
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate, stream_each

T = 0.0005
MOVE = fd.blocks.SnapLimitedMove(distance=0.002, velocity=0.05, acceleration=2.0, jerk=100.0, snap=1e4)


def axis_of(loop: Loop, mass: float, late: int) -> Loop:
    plant: Any = loop.axis.plant
    return replace(loop, axis=replace(loop.axis, plant=replace(plant, mass_load=mass * plant.mass_load))).later(late)


def machines(count: int) -> dict[str, Machine]:
    """Machines of two structures: every third one has one more sample of dead time."""
    loop = fd.read_machine("ball_screw").loop("x")
    return {f"m{k}": Machine.of({loop.name: axis_of(loop, 1.0 + 0.02 * k, int(k % 3 == 0))}) for k in range(count)}


def test_each_lane_has_the_bits_of_its_own_run() -> None:
    there = machines(14)
    axis = next(iter(next(iter(there.values())).axes()))
    force = fd.blocks.RecordedForce(force=np.linspace(0.0, 20.0, 40), sample_time=T)
    seeds = {name: 3 + 7 * k for k, name in enumerate(there)}
    record = [f"{axis}.position_load", f"{axis}.force"]
    found: dict[str, list[np.ndarray]] = {name: [] for name in there}
    firsts: list[int] = []
    # chunks that are no divisor of the run; nine machines of one structure need a second vector
    for runs in stream_each(there, {axis: MOVE}, added_force={axis: force}, seeds=seeds, record=record, chunk=37):
        assert list(runs) == list(there)
        firsts.append(runs["m0"].first)
        for name, run in runs.items():
            found[name].append(np.column_stack([run[signal] for signal in record]))
    assert firsts == [37 * k for k in range(len(firsts))]
    for name, machine in there.items():
        alone = simulate(machine, {axis: MOVE}, added_force={axis: force}, seed=seeds[name], record=record)
        assert np.array_equal(np.concatenate(found[name]), np.column_stack([alone[signal] for signal in record])), name


def test_a_run_that_leaves_its_bounds_is_named() -> None:
    there = machines(4)
    axis = next(iter(there["m0"].axes()))
    loop = there["m2"].loop(axis)
    law: Any = loop.control.law
    fast = replace(loop, control=replace(loop.control, law=replace(law, Kp=300.0 * law.Kp), force_limit=None))
    there["m2"] = there["m2"].with_loops({axis: fast})
    with pytest.raises(DivergedError, match=r"^m2: the loop left its bounds"):
        list(stream_each(there, {axis: MOVE}, duration=2.0))
