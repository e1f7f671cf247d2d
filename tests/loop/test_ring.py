"""Rings: what they hold, and that every way to run a loop with rings gives the same bits."""

from __future__ import annotations

import ctypes
import shutil
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Feedforward, Force, Plant
from feeddrive.blocks.feedforward.reversal_pulse import ReversalPulse
from feeddrive.blocks.force.regeneration import Regeneration
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.signals import Motion, Noise, Setpoint
from feeddrive.export.c_bundle import streamed
from feeddrive.export.c_code import texts
from feeddrive.export.design import Trial
from feeddrive.export.layout import layout
from feeddrive.language import ops, tree
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.graph import Graph, Symbol
from feeddrive.language.ring import History, Ring, Track
from feeddrive.loop import routine as routine_run
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.engine.llvm import native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.gradient import gradient
from feeddrive.loop.guard import Guard
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop, Signals
from feeddrive.loop.routine import controller_routine
from feeddrive.loop.runner import Prepared, Work
from feeddrive.loop.simulate import simulate, simulate_batch, stream
from feeddrive.loop.trace import Carried, Program, concrete
from feeddrive.testing import exercise as c
from fresh_draws import Seeded
from loop.engine_loops import Saw, Sway
from slow_share import all_but

T = 2e-4
COUNT = 700


class LateInertia(Feedforward):
    """F = mass · a(t - late), from a history of the set acceleration."""

    mass: Number = parameter("kg", "moving mass", least=0)
    late: Number = parameter("s", "delay", least=0)

    def start(self, setpoint: Setpoint) -> History:
        return History.start(16, setpoint.acceleration)

    def step(self, state: History, setpoint: Setpoint, T: Number) -> tuple[History, Any]:
        state = state.push(setpoint.acceleration)
        return state, self.mass * state.ago(self.late / T)

    def retune(self, state: History, old: LateInertia) -> History:
        """The set accelerations of the past, which no parameter scales."""
        return state


class LearnedByPlace(Force):
    """F = -gain · (mean of the velocities at this place): a ring that is written by a position."""

    gain: Number = parameter("N s/m", "force per velocity", least=0)
    cells: int = choice("places", default=9, least=2)

    def start(self, plant: Plant, motion: Motion) -> Ring:
        return Ring(self.cells)

    def step(
        self, state: Ring, plant: Plant, motion: Motion, drive: Number, time: Number, h: Number
    ) -> tuple[Ring, Any, Any]:
        place = motion.position_load / 3e-4
        held = state.interpolate(place)
        state = state.put(ops.floor(place), 0.9 * state.get(ops.floor(place)) + 0.1 * motion.velocity_load)
        return state, 0.0, -(self.gain * held)


def rings(substeps: int = 2) -> Loop:
    """Rings in forces, in a feedforward and behind a guard."""
    return Loop(
        sample_time=T,
        control=Control(
            law=CascadePPI(Kv=40.0, Kp=8.0e4, Tn=0.02),
            feedforward=(LateInertia(mass=400.0, late=1.7 * T), ReversalPulse(force=80.0, decay_time=0.01)),
            force_limit=3000.0,
            guard=Guard(following_error_limit=0.02),
        ),
        axis=Axis(
            plant=TwoMass(mass_motor=300.0, mass_load=200.0, stiffness=1.5e8, damping=9000.0),
            friction_load=Stribeck(coulomb=100.0, breakaway=160.0, stribeck_velocity=0.002, viscous=700.0),
            forces=(
                Regeneration(stiffness=2e5, delay=0.01313, remembered=200),
                LearnedByPlace(gain=900.0),
            ),
            actuator=Actuator(dead_time=1.3 * T),
            substeps=substeps,
        ),
    )


REFERENCE, LOAD = Sway(), Saw()
ENABLE = np.where((np.arange(COUNT) > 300) & (np.arange(COUNT) < 360), 0.0, 1.0)


def by_source(loop: Loop) -> dict[str, np.ndarray]:
    """The record of the plain Python of the laws."""
    work = Work(loop, REFERENCE, LOAD, ENABLE)
    plain, timing = concrete(loop), loop.timing()
    rows = work.sampled(0, COUNT)
    with np.errstate(all="ignore"):
        made = plain.prepare(timing)
        first = work.first()
        state = plain.start(made, timing, first, first.position, first.velocity)
        record = []
        for k in range(COUNT):
            setpoint = Setpoint(*(np.float64(rows[f"set_{name}"][k]) for name in Setpoint._fields))
            noise = Noise(np.float64(0.0), np.float64(k))
            state, signals = plain.step(
                made,
                state,
                setpoint,
                np.float64(rows["load_force"][k]),
                noise,
                np.float64(ENABLE[k]),
                np.float64(k) * plain.sample_time,
            )
            record.append([float(value) for value in signals])
    return dict(zip(Signals._fields, np.array(record).T, strict=True))


@pytest.mark.parametrize("substeps", all_but([1], [1, 3], "the same with more substeps"))
def test_native_code_has_the_bits_of_the_source(substeps: int):
    loop = rings(substeps)
    expected = by_source(loop)
    found = simulate(loop, REFERENCE, load=LOAD, enable=ENABLE, duration=(COUNT - 1) * T)
    for signal in Signals._fields:
        assert np.array_equal(found[signal], expected[signal]), signal
    assert np.ptp(found["velocity_load"]) > 1e-3
    assert found["trip"].max() == 0.0


def test_c_has_the_bits_of_native_code(tmp_path):
    loop = rings()
    work = Work(loop, REFERENCE, LOAD, ENABLE)
    prepared = Prepared(loop, work.first())
    made = prepared.native(prepared.program(load=True, enable=True), record=Signals._fields)
    assert made.plan.rings
    library = c.compiled(c.text(made.plan, "ring_run"), tmp_path, "-Wno-unused-parameter")
    library.ring_run.restype = None
    library.ring_run.argtypes = [ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 5]
    records = []
    inputs = np.ascontiguousarray(work.inputs(made, 0, COUNT))
    for by_c in (False, True):
        states, outputs = prepared.states(made), np.empty((COUNT, len(Signals._fields)))
        if by_c:
            arrays = (prepared.constants(made), inputs, states, outputs)
            tables = (ctypes.c_void_p * 1)()
            library.ring_run(COUNT, 0, *(each.ctypes.data for each in arrays), ctypes.addressof(tables))
        else:
            made.run(COUNT, 0, prepared.constants(made), inputs, states, outputs, [])
        records.append((states, outputs))
    assert np.array_equal(records[0][0], records[1][0])
    assert np.array_equal(records[0][1], records[1][1])


def test_a_batch_has_the_bits_of_single_runs():
    values = np.linspace(0.004, 0.0171, 11)
    loop = rings()
    varied = tree.vary(loop, {"axis.x.forces.0.delay": values, "axis.x.control.law.Kv": np.linspace(30.0, 50.0, 11)})
    found = simulate_batch(varied, REFERENCE, load=LOAD, duration=(COUNT - 1) * T)
    for i in (0, 4, 10):
        one = tree.vary(
            loop, {"axis.x.forces.0.delay": values[i], "axis.x.control.law.Kv": np.linspace(30.0, 50.0, 11)[i]}
        )
        alone = simulate(one, REFERENCE, load=LOAD, duration=(COUNT - 1) * T)
        assert found.peak["force"][i] == np.max(np.abs(alone["force"]))
        assert found.most["tracking_error"][i] == np.max(alone["tracking_error"])


def test_a_stream_has_the_bits_of_a_single_run():
    loop = rings()
    whole = simulate(loop, REFERENCE, load=LOAD, enable=ENABLE, duration=(COUNT - 1) * T)
    pieces = list(stream(loop, REFERENCE, load=LOAD, enable=ENABLE, duration=(COUNT - 1) * T, chunk=97))
    assert np.array_equal(np.concatenate([piece["force"] for piece in pieces]), whole["force"])


def test_a_live_change_keeps_what_rings_hold():
    loop = rings()
    same = simulate(loop, REFERENCE, load=LOAD, duration=(COUNT - 1) * T, changes={350: loop.control})
    assert np.array_equal(same["force"], simulate(loop, REFERENCE, load=LOAD, duration=(COUNT - 1) * T)["force"])


def test_the_linear_model_of_a_delay_is_its_z_power():
    """A regenerative force of whole substeps: x is fed back through 1 - z⁻ᵈ, exact to rounding."""
    d, k, m, damping = 9, 3e5, 400.0, 5000.0
    force = Regeneration(stiffness=k, delay=d * T, remembered=32)
    loop = Loop(
        sample_time=T,
        control=Control(law=CascadePPI(Kv=1e-9, Kp=1e-9, Tn=1e9)),
        axis=Axis(plant=Rigid(mass=m, viscous=damping), forces=(force,)),
    )
    f = np.array([3.0, 30.0, 300.0, 1700.0])
    found = linearize(loop, ["cut"], ["position_load"]).response(f).response
    # zero-order hold of the mass: x+ = x + a v, v+ = e v, with the force held at the middle x + v T/2 of the sample
    e = np.exp(-damping / m * T)
    A = np.array([[1.0, (1.0 - e) * m / damping], [0.0, e]])
    b = np.array([(T - (1.0 - e) * m / damping) / damping, (1.0 - e) / damping])
    C = np.array([1.0, 0.5 * T])
    for frequency, value in zip(f, found, strict=True):
        z = np.exp(2j * np.pi * frequency * T)
        closed = A - np.outer(b, C) * k * (1.0 - z**-d)
        expected = np.linalg.solve(z * np.eye(2) - closed, b)[0]
        assert abs(value - expected) < 1e-9 * abs(expected)


def test_gradients_go_through_rings():
    loop = replace(rings(), control=replace(rings().control, guard=None))
    loop = replace(loop, axis=replace(loop.axis, friction_load=None))
    names = [
        "axis.x.forces.0.stiffness",
        "axis.x.forces.1.gain",
        "axis.x.control.feedforward.0.mass",
        "axis.x.forces.0.delay",
    ]
    found = gradient(loop, REFERENCE, names, load=LOAD, duration=(COUNT - 1) * T)
    for name in names:
        value = float(tree.get(loop, name))

        def cost(x: float, name: str = name) -> float:
            varied = tree.vary(loop, {name: x})
            run = simulate(varied, REFERENCE, load=LOAD, duration=(COUNT - 1) * T)
            return float(np.mean(run["tracking_error"] ** 2))

        h = 1e-5 * value
        slope = (cost(value + h) - cost(value - h)) / (2.0 * h)
        # the cost bends where an interpolation or a place goes over a cell
        assert found.gradient[name] == pytest.approx(slope, rel=2e-3), name


def test_a_history_is_a_delay_line(seeded: Seeded):
    """Against a plain list, through several turns of the ring, for whole and for broken ages."""
    rng = np.random.default_rng(seeded(0))
    values = rng.standard_normal(40)
    history = History.start(7, np.float64(5.0))
    past = [5.0] * 20
    for value in values:
        history = history.push(np.float64(value))
        past.append(float(value))
        for age in (0.0, 1.0, 2.25, 5.5, 6.0):
            below, share = int(age), age - int(age)
            expected = past[-1 - below] + share * (past[-2 - below] - past[-1 - below])
            assert history.ago(np.float64(age)) == pytest.approx(expected, abs=1e-15)
        assert history.ago(np.float64(99.0)) == past[-7]  # held to what is remembered


def test_indices_count_around_and_nan_reads_a_cell():
    ring = Ring(5)
    for i in range(12):
        ring = ring.put(np.float64(i), np.float64(10.0 * i))
    assert [float(ring.get(np.float64(i))) for i in (-1, 7, 8, 9, 10, 11)] == [90.0, 70.0, 80.0, 90.0, 100.0, 110.0]
    assert ring.interpolate(np.float64(8.25)) == 82.5
    assert ring.get(np.float64(np.nan)) in (70.0, 80.0, 90.0, 100.0, 110.0)


def program(step: Any) -> Program:
    graph = Graph()
    ring = Ring(4, graph.ring("state.r", 4))
    x = graph.input("x")
    after, out = step(ring, x)
    states = (Carried("r", graph.ring("state.r", 4).index, after.cells.index),)
    return Program(graph, {}, {"x": x.index}, states, {"y": graph.symbol(out).index}, None, {})


def run(made: Program, xs: list[float]) -> list[float]:
    machine = native(plan(made))
    outputs, states = np.empty((len(xs), 1)), np.zeros((len(machine.plan.memory), 1))
    machine.run(len(xs), 0, np.empty((0, 1)), np.array(xs)[:, None], states, outputs, [])
    return list(outputs[:, 0])


def test_what_a_ring_was_is_read_before_it_is_written():
    def late(ring: Ring, x: Symbol) -> tuple[Ring, Any]:
        after = ring.put(0.0, x)
        return after, after.get(0.0) - ring.get(0.0)  # the old cell is read behind the write in the text

    assert run(program(late), [3.0, 5.0, 4.0]) == [3.0, 2.0, -1.0]


def test_a_read_in_a_branch_that_is_not_taken_keeps_its_place():
    def branch(ring: Ring, x: Symbol) -> tuple[Ring, Any]:
        old = ring.get(0.0)
        work = old
        for _ in range(40):  # enough that the branch is computed lazily
            work = work * 1.0 + 0.0
        return ring.put(0.0, x), ops.where(x > 0.0, work, -1.0)

    assert run(program(branch), [1.0, 2.0, -3.0, 4.0]) == [0.0, 1.0, -1.0, -3.0]


def test_two_writes_to_one_state_are_refused():
    def twice(ring: Ring, x: Symbol) -> tuple[Ring, Any]:
        return ring.put(0.0, x), ring.put(1.0, x).get(1.0)

    with pytest.raises(StructureError, match="written twice"):
        plan(program(twice))


def test_a_read_that_cannot_come_first_is_refused():
    def circle(ring: Ring, x: Symbol) -> tuple[Ring, Any]:
        after = ring.put(0.0, x)
        return after, ring.get(after.get(0.0))

    with pytest.raises(StructureError, match="depends on what it is after"):
        plan(program(circle))


def test_a_choice_between_two_rings_is_refused():
    first, second = (Ring(3).put(0.0, np.float64(v)) for v in (1.0, 2.0))
    with pytest.raises(StructureError, match="choice between two rings"):
        tree.select(True, (first,), (second,))
    assert tree.select(False, (first,), (Ring(3),))[0] is first


def test_a_delay_longer_than_what_is_remembered_is_refused():
    loop = rings()
    axis = replace(loop.axis, forces=(Regeneration(stiffness=1.0, delay=250 * T / 2, remembered=200),))
    with pytest.raises(ParameterError, match=r"remembered = 200 .* at least 251"):
        replace(loop, axis=axis)


class Repetitive(Feedforward):
    """F = gain · set acceleration of a period ago, from a ring alone."""

    gain: Number = parameter("kg", "gain", least=0)

    def start(self, setpoint: Setpoint) -> tuple[Ring, Any]:
        return Ring(8), ops.zero(setpoint.position)

    def step(self, state: tuple[Ring, Any], setpoint: Setpoint, T: Number) -> tuple[tuple[Ring, Any], Any]:
        ring, place = state
        old = ring.get(place)
        return (ring.put(place, setpoint.acceleration), place + 1.0), self.gain * old


def test_a_ring_that_a_reset_cannot_clear_is_refused_under_a_guard():
    """Without the check the force after a trip holds what the ring was given before it, in simulation and in C."""
    loop = rings()
    guarded = replace(loop.control, guard=Guard(), feedforward=(Repetitive(gain=100.0),))
    with pytest.raises(StructureError, match=r"control\.feedforward\.0\.0 is a ring, which the reset of the guard"):
        simulate(replace(loop, control=guarded), Sway(), duration=0.01)
    with pytest.raises(StructureError, match="which the reset of the guard does not clear"):
        controller_routine(replace(loop, control=guarded), "axis_x")
    assert np.isfinite(
        simulate(replace(loop, control=replace(guarded, guard=None)), Sway(), duration=0.01)["force"]
    ).all()


@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
def test_a_history_forgets_at_a_reset_in_simulation_and_in_c():
    """Two pasts before the loop was off, one present: after the enable both give the same force, with no jump."""
    law = CascadePPI(Kv=25.0, Kp=3e4, Tn=0.03)
    control = Control(law=law, guard=Guard(), feedforward=(LateInertia(mass=100.0, late=12.4 * T),))
    routine = controller_routine(Loop(control=control, axis=Axis(plant=Rigid(mass=100.0)), sample_time=T), "axis_x")
    names = [v.name for v in routine.inputs]
    on, off, enabled, acceleration = 40, 44, names.index("enable"), names.index("set_acceleration")
    answers = []
    for past in (0.0, 5.0):
        inputs = np.zeros((80, len(names)))
        inputs[:, enabled] = 1.0
        inputs[on:off, enabled] = 0.0
        inputs[:on, acceleration] = past
        inputs[on:, acceleration] = 1.0
        found = routine_run.run(routine, inputs)
        made = texts(layout(routine), "a control under test", "made by a test")
        files = {"axis_x.h": made.header, "axis_x.c": made.source, "axis_x_configure.c": made.configure}
        assert np.array_equal(streamed(layout(routine), files, Trial(inputs, {})).outputs, found)
        answers.append(found[:, 0])
    assert answers[1][on - 1] - answers[0][on - 1] > 400.0
    assert np.array_equal(answers[0][on:], answers[1][on:])
    fresh = routine_run.run(routine, inputs[off:])
    assert np.array_equal(answers[1][off:], fresh[:, 0]), "as if the loop had never run before"


def test_a_track_is_read_by_hermite():
    """A sine with its slope: whole ages exactly, between them within (ωh)⁴/384; and half a step ahead of there."""
    h, w = 0.05, 3.0
    track = Track.start(16, (np.float64(7.0), np.float64(0.0)))
    assert track.ago(3.5, h) == (7.0, 0.0)
    for k in range(40):
        track = track.push((np.sin(w * h * k), 2.0), (w * np.cos(w * h * k), 0.0))
    for age in (0.0, 1.0, 5.0, 15.0):
        assert track.ago(age, h)[0] == pytest.approx(np.sin(w * h * (39 - age)), abs=1e-15)
    for age in (0.5, 3.3, 13.9):
        true = np.sin(w * h * (39 - age))
        assert abs(track.ago(age, h)[0] - true) < 1.01 * (w * h) ** 4 / 384.0
        ahead = track.ago(age, h, 0.5)[0] - track.ago(age, h)[0]
        assert ahead == pytest.approx(0.5 * h * w * np.cos(w * h * (39 - age)), abs=0.5 * (w * h) ** 4 / 24.0)
        assert track.ago(age, h)[1] == 2.0
    old = track.settled()
    assert old.ago(11.2, h) == (7.0, 0.0)
