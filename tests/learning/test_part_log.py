"""Learning from the log of the last part: what it teaches, and which logs teach nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.language.errors import LogError
from feeddrive.learning import part_log
from feeddrive.learning.part_correction import Correction, correct_by_plan
from feeddrive.learning.part_log import LEAST_SHARE, MOST_SHARE, SHARE_FOUND, PartLog, learn_from_log
from feeddrive.learning.plant_box import PlantBox
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from parts import FRICTION, T, loop, machine, plan

PLAN = plan()


def logged(given: Machine, correction: Correction | None = None, seed: int = 1) -> PartLog:
    """The log of a simulated part, as a control writes it: readings with counts."""
    signals = ("set_position", "reading_load", "force")
    run = simulate(
        given,
        PLAN,
        added_force=None if correction is None else correction.added,
        seed=seed,
        record=[f"{axis}.{signal}" for axis in PLAN for signal in signals],
    )
    by = {signal: {axis: run[f"{axis}.{signal}"] for axis in PLAN} for signal in signals}
    return PartLog("part.csv", by["set_position"], by["reading_load"], T, by["force"])


LOG = logged(machine())


@pytest.mark.parametrize("friction", [-0.3, 0.0, 0.3])
def test_the_friction_of_the_machine_is_found(friction: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The model believes the nominal friction; a motion with one reversal shows the machine's to its standard error."""
    monkeypatch.setattr(part_log, "SHARE_ERROR", 0.5)
    real = PlantBox().machine(machine(), 0.0, friction, 0.0, 0)
    learned = learn_from_log(machine(), PLAN, logged(real))
    for axis, (share, error) in learned.shares.items():
        assert abs(share - 1.0 - friction) < 2.0 * error
        assert abs(share - 1.0 - friction) < 0.3
        assert learned.correction.shares[axis] == pytest.approx(SHARE_FOUND * share)
    assert learned.correction.passes == 1


def test_a_share_that_is_not_certain_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """One reversal tells the share to 0.2 only: where 0.1 is asked for, the model's is taken, and said so."""
    monkeypatch.setattr(part_log, "SHARE_ERROR", 0.1)
    learned = learn_from_log(machine(), PLAN, LOG)
    assert not learned.shares
    assert all("starts and reverses too seldom: 91 % of the model's" in remark for remark in learned.remarks)
    assert learned.correction.forces["x"] == pytest.approx(correct_by_plan(machine(), PLAN).forces["x"])


def test_part_after_part_on_a_machine_that_the_model_does_not_know() -> None:
    """Mass -10 %, friction -30 %, softer and later: two logs take the RMS below 0.56 of the first."""
    real = PlantBox().machine(machine(), -0.1, -0.3, -0.2, 1)
    last, before, history = None, None, ()
    for part in range(12):
        learned = learn_from_log(
            machine(), PLAN, logged(real, last, seed=part), last=last, before=before, history=history
        )
        history = learned.history
        if learned.best:
            break
        before, last = last, learned.correction
    assert learned.best
    assert history[2] < 0.56 * history[0]
    assert min(history) == min(history[-2:])


def test_the_better_of_two_passes_is_kept() -> None:
    """A part 1 % better than the one before ends the learning with its own correction; a worse one with the earlier."""
    old, new = (correct_by_plan(machine(), PLAN, share=share) for share in (0.5, 0.6))
    rms = learn_from_log(machine(), PLAN, LOG).figures.rms
    little = learn_from_log(machine(), PLAN, LOG, last=new, before=old, history=(1.0, rms * 1.01))
    assert little.best
    assert little.correction is new
    worse = learn_from_log(machine(), PLAN, LOG, last=new, before=old, history=(1.0, rms * 0.99))
    assert worse.correction is old
    better = learn_from_log(machine(), PLAN, LOG, last=new, before=old, history=(1.0, rms / 0.98 * 1.001))
    assert not better.best


def test_what_rests_is_not_learned() -> None:
    """An error in a rest only, where the axis may stick, leaves the force as it was."""
    rest = np.abs(np.asarray(PLAN["x"].velocity)) < 1e-12
    error = np.where(rest, 1e-6, 0.0)
    log = replace(LOG, position={axis: path.position - (error if axis == "x" else 0.0) for axis, path in PLAN.items()})
    last = correct_by_plan(machine(), PLAN)
    learned = learn_from_log(machine(), PLAN, log, last=last, history=())
    assert np.max(np.abs(learned.correction.forces["x"] - last.forces["x"])) < 0.5


def test_what_is_learned_ends_in_a_rest_and_becomes_less_from_part_to_part() -> None:
    """An error while the axis moves adds no force 1 ms off the motion, where the splines of 10 ms alone would."""
    velocity = np.abs(np.asarray(PLAN["x"].velocity))
    error = np.where(velocity > 1e-3, 1e-6, 0.0)
    log = replace(LOG, position={axis: path.position - (error if axis == "x" else 0.0) for axis, path in PLAN.items()})
    start = correct_by_plan(machine(), PLAN)
    added: list[np.ndarray] = []
    for passes in (0, 1, 2, 3):
        last = replace(start, passes=passes)
        learned = learn_from_log(machine(), PLAN, log, last=last).correction
        assert learned.passes == passes + 1
        added.append(learned.forces["x"] - last.forces["x"])
    moving = np.flatnonzero(velocity > 1e-9)
    far = np.ones(velocity.size, bool)
    far[moving] = False
    reach = round(1e-3 / T)
    for k in range(1, reach + 1):
        far[np.minimum(moving + k, far.size - 1)] = far[np.maximum(moving - k, 0)] = False
    assert np.any(far)
    assert np.all(np.abs(added[0][far]) < 1e-9)
    assert np.max(np.abs(added[0])) > 1.0
    for before, after, ratio in zip(added, added[1:], (1.0, 0.7, 0.7), strict=False):
        assert after == pytest.approx(ratio * before, abs=1e-9)


def test_signs_in_the_control_are_left_to_the_log() -> None:
    """The control feeds friction by signs: the first log teaches a force and no share."""
    block = DisturbanceCompensator(mass=150.0, coulomb_positive=60.0, coulomb_negative=60.0)
    signs = {name: replace(loop(name), control=replace(loop().control, feedforward=(block,))) for name in ("x", "y")}
    given = Machine.of(signs)
    learned = learn_from_log(given, PLAN, logged(given))
    assert not learned.shares
    # no force along the plan is there at the start, so that the force learned for it begins in the rest
    rest = np.abs(np.asarray(PLAN["x"].velocity)) < 1e-9
    assert np.max(np.abs(learned.correction.forces["x"][rest])) > 1.0
    assert float(np.max(np.abs(learned.correction.forces["x"]))) > 1.0


def changed(name: str, axis: str, change: Callable[[np.ndarray], np.ndarray]) -> PartLog:
    rows = dict(getattr(LOG, name))
    rows[axis] = change(rows[axis].copy())
    return replace(LOG, **{name: rows})


def with_value(row: np.ndarray, k: int, value: float) -> np.ndarray:
    row[k] = value
    return row


REFUSED: dict[str, tuple[Callable[[], PartLog], str]] = {
    "another sample time": (lambda: replace(LOG, sample_time=1e-3), "its clock of 1 ms differs"),
    "missing samples": (
        lambda: changed("position", "y", lambda row: row[:-50]),
        "axis y: has .* samples of the position",
    ),
    "not a number": (
        lambda: changed("position", "x", lambda row: with_value(row, 700, np.nan)),
        "axis x: the position is not a number in row 700.*log the part again",
    ),
    "another program": (
        lambda: changed("set_position", "x", lambda row: row + 1e-6 * (np.arange(row.size) > 900)),
        "axis x: the set position differs from the plan by 1 um at .*another program",
    ),
    "another start": (
        lambda: changed("position", "y", lambda row: np.append(np.full(3, row[0]), row[:-3])),
        "axis y: the positions are .* samples later than the model",
    ),
    "a stuck axis": (
        lambda: changed("position", "x", lambda row: np.full(row.size, row[0])),
        "axis x: moves .* where the plan moves .* stuck or switched off",
    ),
    "a saturated force": (
        lambda: changed("force", "x", lambda row: with_value(row, 800, 4000.0)),
        "axis x: the force is at its limit of 4000 N in 1 samples that count",
    ),
    "a tripped guard": (
        lambda: replace(LOG, tripped={"x": np.arange(LOG.position["x"].size) > 1000}),
        "axis x: the guard tripped at 0.5005 s",
    ),
    "friction that is not the model's": (
        lambda: logged(PlantBox().machine(machine(), 0.0, -0.8, 0.0, 0)),
        "friction of this axis is not what the model says; identify it again",
    ),
}


@pytest.mark.parametrize("case", list(REFUSED))
def test_a_log_that_teaches_nothing(case: str) -> None:
    make, said = REFUSED[case]
    with pytest.raises(LogError, match=said):
        learn_from_log(machine(), PLAN, make())


def with_rows(rows: int, away: float = 0.0) -> PartLog:
    """The log with more rows behind the plan, of which the set position of y is away from its end, m."""
    longer = {
        name: {axis: np.append(row, np.full(rows, row[-1])) for axis, row in getattr(LOG, name).items()}
        for name in ("set_position", "position", "force")
    }
    longer["set_position"]["y"][-1] += away
    tripped = {"x": np.arange(LOG.position["x"].size + rows) > LOG.position["x"].size}
    return replace(LOG, **longer, tripped=tripped)


def test_the_rest_behind_the_plan_is_no_part_of_the_log() -> None:
    """Exported setpoints end with 20 ms at rest; a control logs them, and is switched off there."""
    rested = learn_from_log(machine(), PLAN, with_rows(40))
    plain = learn_from_log(machine(), PLAN, LOG)
    assert rested.history == plain.history
    for axis, force in plain.correction.forces.items():
        assert np.array_equal(rested.correction.forces[axis], force)
    with pytest.raises(LogError, match=r"the plan .*: cut the log to the program"):
        learn_from_log(machine(), PLAN, with_rows(40, 1e-6))


def test_the_range_of_shares() -> None:
    assert (LEAST_SHARE, MOST_SHARE) == (0.3, 1.6)


def test_friction_on_both_bodies_is_not_told_apart() -> None:
    both = machine(motor=FRICTION)
    with pytest.raises(LogError, match="axis x: the model has friction on motor and load"):
        learn_from_log(both, PLAN, logged(both))


def test_an_axis_that_never_reverses_has_the_usual_share() -> None:
    names = ("position", "velocity", "acceleration", "jerk", "snap")
    # up to the first sample at which an axis moves backwards
    length = min(int(np.argmax(np.asarray(path.velocity) < 0.0)) for path in PLAN.values())
    one_way = {
        axis: Recorded(**{name: np.asarray(getattr(path, name))[:length] for name in names}, sample_time=T)
        for axis, path in PLAN.items()
    }
    run = simulate(machine(), one_way, record=["x.reading_load", "y.reading_load", "x.set_position", "y.set_position"])
    log = PartLog(
        "part.csv",
        {axis: run[f"{axis}.set_position"] for axis in one_way},
        {axis: run[f"{axis}.reading_load"] for axis in one_way},
        T,
    )
    learned = learn_from_log(machine(), one_way, log)
    assert not learned.shares
    assert all("never reverses" in remark for remark in learned.remarks)
    expected = correct_by_plan(machine(), one_way).forces["x"]
    assert learned.correction.forces["x"] == pytest.approx(expected)
