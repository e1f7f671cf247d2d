"""A single run, a batch, a stream and plain Python have the same bits: noise, quantisers, stick-slip, limit, guard."""

from __future__ import annotations

import math

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.families import Reference
from feeddrive.blocks.signals import Setpoint
from feeddrive.loop.loop import Loop, Signals
from feeddrive.loop.runner import Prepared, Work, program_of
from feeddrive.loop.trace import SETPOINT, evaluate

T = 1e-4
SEED = 3


class Swing(Reference):
    """50 mm back and forth, at 2 Hz."""

    @property
    def duration(self) -> float:
        return 0.25

    def at(self, t: np.ndarray) -> Setpoint:
        w, a = 4.0 * math.pi, 0.025
        c, s = a * np.cos(w * t), a * np.sin(w * t)
        return Setpoint(a - c, w * s, w * w * c, -(w**3) * s, -(w**4) * c)


def loop() -> Loop:
    return fd.Loop(
        sample_time=T,
        control=fd.Control(
            law=fd.CascadePPI(Kv=40.0, Kp=4e4, Tn=0.01),
            filters=(fd.Notch(frequency=460.0),),
            feedforward=(fd.Inertia(mass=150.0, viscous=1400.0),),
            force_limit=400.0,
            guard=fd.Guard(following_error_limit=0.5),
        ),
        axis=fd.Axis(
            plant=fd.TwoMass(
                mass_motor=130.0,
                mass_load=33.0,
                stiffness=1.8e7,
                damping=700.0,
                viscous_motor=1500.0,
                viscous_load=20.0,
            ),
            friction_motor=fd.Stribeck(coulomb=20.0, breakaway=30.0, stribeck_velocity=0.002),
            friction_load=fd.Lugre(
                coulomb=40.0, breakaway=60.0, stribeck_velocity=0.002, bristle_stiffness=1e7, bristle_damping=300.0
            ),
            forces=(fd.Cogging(force=10.0, period=0.02, harmonics=(fd.Harmonic(order=3, share=0.5, phase=0.3),)),),
            actuator=fd.Actuator(dead_time=1.4 * T, current_loop=1500.0),
            encoder_motor=fd.Encoder(resolution=1e-8, noise=2e-8, jitter=0.01),
            encoder_load=fd.Encoder(resolution=1e-7),
            substeps=2,
        ),
    )


@pytest.fixture(scope="module")
def run() -> fd.Run:
    return fd.simulate(loop(), Swing(), seed=SEED)


def test_the_loop_exercises_what_it_should(run: fd.Run):
    assert np.max(np.abs(run["force"])) == 400.0  # the limit
    assert np.any(run["velocity_load"] == 0.0) or np.any(np.abs(run["friction_load"]) > 40.0)
    assert np.any(run["reading_motor"] != run["position_motor"])


@pytest.mark.parametrize("chunk", [1, 777, 100_000])
def test_a_stream_has_the_bits_of_the_run(run: fd.Run, chunk: int):
    if chunk == 1:
        parts = list(fd.stream(loop(), Swing(), seed=SEED, chunk=chunk, duration=0.01))
    else:
        parts = list(fd.stream(loop(), Swing(), seed=SEED, chunk=chunk))
    for signal in Signals._fields:
        joined = np.concatenate([part[signal] for part in parts])
        assert np.array_equal(joined, run[signal][: joined.size]), signal


@pytest.mark.parametrize(("lanes", "threads"), [(8, 1), (8, 2), (16, 2)])
def test_a_batch_has_the_bits_of_its_runs(lanes: int, threads: int):
    Kv = np.linspace(30.0, 50.0, 11)  # not a multiple of the lanes
    batch = fd.simulate_batch(fd.vary(loop(), {"control.law.Kv": Kv}), Swing(), seed=SEED, lanes=lanes, threads=threads)
    for i, value in enumerate(Kv):
        alone = fd.simulate(fd.vary(loop(), {"control.law.Kv": value}), Swing(), seed=SEED)
        for signal in batch.peak:
            assert batch.peak[signal][i] == np.max(np.abs(alone[signal])), signal
            assert batch.least[signal][i] == np.min(alone[signal]), signal
            total = 0.0
            for x in alone[signal]:  # in the order of the samples
                total += x * x
            assert batch.rms[signal][i] == math.sqrt(total / alone.time.size), signal


def test_plain_python_has_the_bits_of_the_run(run: fd.Run):
    work = Work(loop(), Swing())
    prepared = Prepared(loop(), work.first(), None, SEED, 1.0)
    program = program_of(loop(), prepared.timing, load=False, enable=False)
    ends = [*program.outputs.values(), *(state.after for state in program.states)]
    held = {f"state.{state.name}": prepared.first[state.name] for state in program.states}
    setpoints = Swing().at(run.time)
    with np.errstate(all="ignore"):
        for k in range(400):
            given = {name: np.float64(row[k]) for name, row in zip(SETPOINT, setpoints, strict=True)}
            leaves = {**prepared.numbers, **held, **given, **prepared.tables, "sample": np.float64(k)}
            found = evaluate(program.graph, ends, leaves)
            for name, value in zip(program.outputs, found, strict=False):
                assert value == run[name][k], f"{name} at sample {k}"
            after = found[len(program.outputs) :]
            held = {f"state.{state.name}": x for state, x in zip(program.states, after, strict=True)}


def test_another_seed_is_another_run_and_the_same_seed_the_same(run: fd.Run):
    again = fd.simulate(loop(), Swing(), seed=SEED)
    other = fd.simulate(loop(), Swing(), seed=SEED + 1)
    assert np.array_equal(again["reading_motor"], run["reading_motor"])
    assert not np.array_equal(other["reading_motor"], run["reading_motor"])
