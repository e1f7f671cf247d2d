"""Feedforward learned from the errors of a few moves: which columns pay, and that the moves need not repeat."""

import numpy as np

import feeddrive as fd

machine = fd.read_machine("xy_table").loop("x")


def move(distance: float, velocity: float) -> fd.blocks.SnapLimitedMove:
    return fd.blocks.SnapLimitedMove(
        distance=distance,
        velocity=velocity,
        acceleration=3.0,
        jerk=60.0,
        snap=15e3,
        back=True,
        dwell_before=0.02,
        dwell_between=0.2,
        dwell_after=0.2,
    )


def force_noise(trial: int) -> fd.blocks.RecordedForce:
    return fd.blocks.RecordedForce(force=5.0 * np.random.default_rng(trial).standard_normal(20_000), sample_time=2.5e-4)


here = move(0.1, 0.25)
moves = (here, move(0.06, 0.15), move(0.2, 0.4), here)
print(fd.learning.convergence(machine, here))

for name, columns in (
    ("mass and viscous friction", {"mass": 45.0, "viscous": 0.0}),
    ("and Coulomb levels", {"mass": 45.0, "viscous": 0.0, "coulomb_positive": 0.0, "coulomb_negative": 0.0}),
):
    loop = fd.learning.compensated(machine, fd.blocks.DisturbanceCompensator(**columns))
    same = fd.learning.iterate_trials(loop, here, 4, load=force_noise)
    turns = fd.learning.iterate_trials(loop, moves, 4, load=force_noise)
    print(f"{name:26s} same move {same.rms[0] * 1e6:5.2f} -> {same.rms[-1] * 1e6:5.2f} um, ", end="")
    print(f"changing moves -> {turns.rms[-1] * 1e6:5.2f} um")

step = turns.iterations[-1]
print(step)
print(f"predicted {1e6 * step.predicted_rms:.2f} um for the same move again")

signal = fd.learning.learn_signal(fd.learning.begin_compensation(machine), moves, 4, load=force_noise)
print(f"a learned signal, changing moves: {signal.rms[0] * 1e6:.2f} -> {signal.rms[-1] * 1e6:.2f} um")
