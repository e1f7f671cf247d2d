"""What a run keeps for the next one (preparation, first state, setpoints, inputs) changes no bit of any run."""

import importlib
from functools import partial

import engine_loops as loops
import numpy as np
import pytest

from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.language import tree
from feeddrive.language.recent import Recent
from feeddrive.loop.runner import Prepared, Work
from feeddrive.loop.simulate import simulate

runner = importlib.import_module("feeddrive.loop.runner")
MOVE = SnapLimitedMove(distance=0.002, velocity=0.1, acceleration=1.0, jerk=50.0, snap=5e3)
DURATION = 0.1  # s, inside the move
CHANGES = {
    "as it is": {},
    "gain": {"axis.x.control.law.Kv": 61.0},
    "filter": {"axis.x.control.filters.0.frequency": 165.0},
    "mass": {"axis.x.plant.mass_load": 210.0},
    "part of a sample of dead time": {"axis.x.actuator.dead_time": 70e-6},
    "encoder": {"axis.x.encoder_motor.resolution": 1e-6},
}


def _forget(monkeypatch) -> None:
    for name in ("_holds", "_beginnings", "_references", "_inputs"):
        monkeypatch.setattr(runner, name, Recent(getattr(runner, name).size))


def _runs():
    loop, moves = loops.common(), (MOVE, tree.vary(MOVE, {"distance": 0.001}))
    for change in CHANGES.values():
        changed = tree.vary(loop, change)
        for move in moves:
            for given in ({}, {"start": (0.0001, 0.0)}, {"seed": 2}, {"record": ("force",)}):
                yield partial(simulate, changed, move, duration=DURATION, **given)


def test_no_bit_depends_on_the_runs_before(monkeypatch):
    first = []
    for run in _runs():
        _forget(monkeypatch)
        first.append(run())
    _forget(monkeypatch)
    for _ in range(2):
        for run, expected in zip(_runs(), first, strict=True):
            found = run()
            assert found.signals.keys() == expected.signals.keys()
            for signal, values in expected.signals.items():
                assert found[signal].tobytes() == values.tobytes(), (run, signal)
            assert found.time.tobytes() == expected.time.tobytes()


def test_the_arrays_of_a_run_belong_to_whoever_takes_it():
    loop, reference = loops.common(), MOVE
    one = simulate(loop, reference, duration=DURATION)
    before = {name: values.copy() for name, values in one.signals.items()}
    one.time[:] = 0.0
    for values in one.signals.values():
        values[:] = -1.0
    two = simulate(loop, reference, duration=DURATION)
    assert two.time[-1] == pytest.approx(DURATION, abs=1e-12)  # s
    for name, values in before.items():
        assert np.array_equal(two[name], values)


def test_kept_inputs_cannot_be_written_and_numbers_of_a_run_are_its_own():
    loop, reference = loops.common(), MOVE
    work = Work(loop, reference)
    work.sampled(0, 100)
    one, two = (Prepared(loop, work.first(), seed=seed, bound=bound) for seed, bound in ((0, 1.0), (1, 2.0)))
    assert (one.numbers["seed"], two.numbers["seed"]) == (0.0, 1.0)
    assert (one.numbers["bound"], two.numbers["bound"]) == (1.0, 2.0)
    made = one.native(one.program(), record=("force",))
    with pytest.raises(ValueError, match="read-only"):
        work.inputs(made, 0, 100)[0, 0] = 1.0


def test_a_zero_and_its_negative_are_kept_apart():
    """1 / 0.0 and 1 / -0.0 differ: the key holds all bits."""
    loop = loops.common()
    keys = {runner._key((tree.vary(loop, {"axis.x.plant.damping": value}),)) for value in (0.0, -0.0)}
    assert len(keys) == 2
