"""No input makes a command that is no number: every control, natively over 10 000 samples and in plain Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from feeddrive import Control, Guard
from feeddrive.blocks import GainSchedule, LinuxcncPid, Notch, SchedulePlace, StockPid
from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.families import Filter, Law, Observer, Prefilter
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.loop.guard import COMMAND_LIMIT, SETPOINT_LIMIT, TRIP_READING
from feeddrive.loop.routine import controller_routine, run
from fresh_draws import Seeded
from loop.controls import CONTROLS as RETUNED
from loop.controls import PPI, T, loop_of

SAFE, HOLD, LIMIT = 25.0, 2, 1000.0
ABSURD = [np.nan, np.inf, -np.inf, 5e-324, -1e-310, 1e-300, 1e308, -1e308, 1e30, -1e18, 1e12, 1e6, -999.0, 0.0, -0.0]

STOCK = StockPid(Pgain=30.0, Igain=200.0, Dgain=0.4)
# the readings of a quiet axis, 0.1 mm, lie on the slope and on both held ends
SCHEDULE = GainSchedule(
    places=(
        SchedulePlace(position=-1e-4, law=PPI),
        SchedulePlace(position=1e-4, law=replace(PPI, Kp=2.0 * PPI.Kp, Tn=0.02)),
    )
)
CONTROLS = RETUNED | {
    "linuxcnc pid": Control(law=LinuxcncPid(position=STOCK)),
    "gain schedule": Control(law=SCHEDULE),
}
every_control = pytest.mark.parametrize("control", CONTROLS.values(), ids=CONTROLS)
limited = pytest.mark.parametrize("limit", [None, 2000.0], ids=["no limit", "limited"])


def fuzzed(names: list[str], count: int, seed: int) -> np.ndarray:
    """Inputs of a quiet axis; in half of the samples one number or more is absurd, in rows and alone."""
    random = np.random.default_rng(seed)
    sound = {"enable": np.ones(count)}
    inputs = np.column_stack([sound.get(name, 1e-4 * random.standard_normal(count)) for name in names])
    loud = np.repeat(random.random(count // 10 + 1) < 0.5, 10)[:count, None]  # tenths of a stretch, so that some trip
    holes = loud & (random.random(inputs.shape) < 0.12)
    inputs[holes] = random.choice(np.array(ABSURD), int(holes.sum()))
    # disabled now and then, since a trip stays until then
    inputs[random.random(count) < 0.05, names.index("enable")] = random.choice(np.array([0.0, np.nan, -np.inf]))
    return inputs


def guarded(control: Control, limit: float | None) -> Control:
    filters = control.filters or (Notch(frequency=700.0),)
    guard = Guard(hold_samples=HOLD, safe_force=SAFE, reading_limit=LIMIT)
    return replace(control, filters=filters, force_limit=limit, guard=guard)


def check(names: list[str], inputs: np.ndarray, outputs: dict[str, np.ndarray], limit: float | None) -> None:
    """What a guard promises, from the inputs alone."""
    force, trip, enabled = outputs["force"], outputs["trip"], outputs["enabled"]
    assert np.all(np.isfinite(force))
    assert np.all(np.abs(force) <= (COMMAND_LIMIT if limit is None else limit))
    assert np.all(force[enabled == 0.0] == SAFE)
    assert np.array_equal(enabled == 1.0, (inputs[:, names.index("enable")] > 0.5) & (trip == 0.0))
    with np.errstate(all="ignore"):
        setpoint = np.abs(inputs[:, : names.index("set_snap") + 1].sum(axis=1)) <= SETPOINT_LIMIT
        readings = [i for i, name in enumerate(names) if name.startswith("reading")]
        broken = ~(setpoint & np.all(np.abs(inputs[:, readings]) <= LIMIT, axis=1))
    in_a_row = 0
    for k, bad in enumerate(broken):
        ran = k > 0 and enabled[k - 1] == 1.0
        in_a_row = in_a_row + 1 if bad and ran else 0
        if bad and inputs[k, names.index("enable")] > 0.5:
            if in_a_row > HOLD or not ran:
                assert trip[k] != 0.0, f"sample {k}: the fault is not flagged"
            elif trip[k] == 0.0:
                assert force[k] == force[k - 1], f"sample {k}: the command is not held"
    assert np.any(trip == TRIP_READING)
    assert 0.05 < np.mean(enabled) < 0.95  # both states are drawn often


def test_every_law_observer_and_filter_is_among_them() -> None:
    found = {block.kind for control in CONTROLS.values() for block in tree.blocks(guarded(control, None))}
    wanted = {kind for family in (Law, Observer, Filter, Prefilter) for kind in catalogue()[family]}
    # the axis of a law that commands a velocity is another one: blocks/test_velocity_loop.py
    assert wanted - found <= {"position_loop"}


@limited
@every_control
def test_ten_thousand_absurd_inputs_natively(control: Control, limit: float | None, seeded: Seeded) -> None:
    routine = controller_routine(loop_of(guarded(control, limit)), "axis_x")
    names = [variable.name for variable in routine.inputs]
    inputs = fuzzed(names, 10_000, seed=seeded(11))
    outputs = run(routine, inputs)
    check(names, inputs, dict(zip((v.name for v in routine.outputs), outputs.T, strict=True)), limit)


@every_control
def test_without_every_part_that_may_be_left_out_no_command_is_broken(control: Control, seeded: Seeded) -> None:
    """Laws carry a NaN on to their command, so that it is seen there; what none reads is not seen, and does no harm."""
    bare = guarded(control, 2000.0)
    parts = {"checks_setpoint": False, "holds": False, "aligns": False, "starts_moving": False}
    assert bare.guard is not None
    routine = controller_routine(loop_of(replace(bare, guard=replace(bare.guard, **parts))), "axis_x")
    names = [variable.name for variable in routine.inputs]
    inputs = fuzzed(names, 2_000, seed=seeded(13))
    found = dict(zip((v.name for v in routine.outputs), run(routine, inputs).T, strict=True))
    force, enabled = found["force"], found["enabled"]
    assert np.all(np.abs(force) <= 2000.0)
    assert np.all(force[enabled == 0.0] == SAFE)
    readings = [i for i, name in enumerate(names) if name.startswith("reading")]
    broken = ~np.all(np.abs(inputs[:, readings]) <= LIMIT, axis=1)
    assert np.all(enabled[broken] == 0.0)
    if getattr(control.law, "position_every", 1) == 1:  # a slow position loop does not read it in every sample
        assert np.all(enabled[np.isnan(inputs[:, names.index("set_position")])] == 0.0), "no law swallows a NaN"
    assert 0.05 < np.mean(enabled) < 0.95  # both states are drawn often


@every_control
def test_absurd_inputs_in_plain_python(control: Control, seeded: Seeded) -> None:
    """And nothing that is no number stays in the guard, whatever the law remembers."""
    loop = loop_of(guarded(control, 2000.0))
    names = [variable.name for variable in controller_routine(loop, "axis_x").inputs]
    inputs = fuzzed(names, 300, seed=seeded(12))
    made = tree.rebuild(loop.control, (np.float64(value) for _, value in tree.leaves(loop.control)))
    setpoints, readings = inputs[:, :5], inputs[:, 5:-1]
    found = []
    with np.errstate(all="ignore"):
        prepared = made.prepare(np.float64(T))
        state = made.start(prepared, Setpoint(*setpoints[0]), readings[0, 0], readings[0, -1])
        for k in range(len(inputs)):
            motor = load = readings[k, 0]
            if readings.shape[1] == 2:
                load = readings[k, 1]
            state, command = made.step(
                prepared, state, Setpoint(*setpoints[k]), motor, load, inputs[k, -1], np.float64(T)
            )
            found.append((command.applied, command.trip, command.running))
            assert all(np.isfinite(value) for _, value in tree.leaves(state.guard))
            assert np.isfinite(state.applied)
            assert np.isfinite(state.requested)
    check(names, inputs, dict(zip(("force", "trip", "enabled"), np.array(found).T, strict=True)), 2000.0)
