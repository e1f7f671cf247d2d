"""What a run keeps for the next one (preparation, first state, setpoints, inputs) changes no bit of any run."""

from functools import partial

import engine_loops as loops
import numpy as np
import pytest

from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.recent import Recent
from feeddrive.loop import runner
from feeddrive.loop import runner as work
from feeddrive.loop.runner import Prepared, Work
from feeddrive.loop.simulate import simulate

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


KEPT = ((runner, "_holds"), (runner, "_beginnings"), (runner, "_structures"), (work, "_references"))


def _forget(monkeypatch) -> None:
    for module, name in KEPT:
        monkeypatch.setattr(module, name, Recent(getattr(module, name).size))
    monkeypatch.setattr(work, "_sampled_by_numpy", [0])


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


def test_machine_code_begins_as_python_does(monkeypatch):
    """Every bit of what a run is prepared with and of its first state; with more squarings than at the first call."""
    loop, setpoint = loops.common(), Setpoint(0.1, 0.2, 0.3)
    heavier = [tree.vary(loop, {"axis.x.plant.stiffness": 1e8 * 4.0**k}) for k in range(6)]
    changed = [tree.vary(loop, change) for change in CHANGES.values()]
    for start in (None, (0.1, -0.2)):
        for each in (*changed, *heavier, *changed):
            found = {}
            for after in (10**9, 0):
                monkeypatch.setattr(runner, "PAYS_AFTER", after)
                monkeypatch.setattr(runner, "_beginnings", Recent(4))
                found[after] = runner.beginning(each, setpoint, start, ())
            slow, quick = found.values()
            assert (slow.timing, slow.structure) == (quick.timing, quick.structure)
            for one, other in ((slow.numbers, quick.numbers), (slow.first, quick.first)):
                assert list(one) == list(other)
                assert np.array(list(one.values())).tobytes() == np.array(list(other.values())).tobytes()


def test_stretches_by_machine_code_have_the_bits_of_numpy():
    rng = np.random.default_rng(0)
    for _ in range(40):
        T = float(rng.choice([50e-6, 1e-3, 1 / 3e4]))
        move = SnapLimitedMove(
            distance=rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-7.0, -1.0), start=rng.choice([0.0, -0.3]),
            velocity=10.0 ** rng.uniform(-2.0, 0.0), acceleration=10.0 ** rng.uniform(-1.0, 2.0),
            jerk=10.0 ** rng.uniform(0.0, 4.0), snap=10.0 ** rng.uniform(2.0, 6.0), back=bool(rng.integers(2)),
            dwell_before=rng.choice([0.0, 7.0 * T, rng.uniform(0.0, 0.1)]), dwell_after=rng.choice([0.0, 0.01]),
        )  # fmt: skip
        first, count = int(rng.choice([0, 17, 200])), min(int(move.duration / T) + 50, 30_000)
        found = work._by_stretches(move.stretches(), T, first, count)
        assert np.array_equal(found, np.array(move.at((first + np.arange(count)) * T))), move


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
    keys = {runner.key((tree.vary(loop, {"axis.x.plant.damping": value}),)) for value in (0.0, -0.0)}
    assert len(keys) == 2
