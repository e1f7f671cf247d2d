"""A log of an axis to its mass, friction and gains, with errors; then the friction near standstill from slow runs."""

import numpy as np

import feeddrive as fd

T = 1e-3
truth = fd.read_machine("emps_symmetric").loop("x")

# a log as a controller would write it: three strokes, and a force of 2 N that nobody knows of
moves = [
    fd.blocks.SnapLimitedMove(
        distance=0.15, velocity=v, acceleration=0.84, jerk=20, snap=1000, back=True, dwell_before=0.1, dwell_after=0.1
    )
    for v in (0.125, 0.06, 0.03)
]
reference = np.concatenate([move.at(np.arange(round(move.duration / T)) * T).position for move in moves])
white = np.random.default_rng(1).standard_normal(reference.size + 500)
unknown = 2.0 * np.convolve(white, np.ones(50) / np.sqrt(50.0), "valid")[: reference.size]
run = fd.simulate(
    truth,
    fd.blocks.Recorded(position=reference, sample_time=T),
    load=fd.blocks.RecordedForce(force=unknown, sample_time=T),
)
rows = slice(0, reference.size)
log = fd.identification.MotionLog(
    name="log", position=run["reading_load"][rows], force=run["force"][rows], set_position=reference, sample_time=T
)

found = fd.identify(log)
print(found.rigid, "\n")
print(found.refinement, "\n")
print(found.recommendation)
mass, Kv = found.rigid["mass"], found.control["Kv"]
print(f"true mass within 95 %: {abs(mass.value - 95.1089) < 1.96 * mass.error}")
print(f"dead time {found.refinement.delay} samples; Kv {Kv.value:.2f}")

# constant-speed runs: which friction do they support?
curve = fd.blocks.Stribeck(coulomb=20, breakaway=28, stribeck_velocity=4e-3, viscous=200)
speeds = np.concatenate([-np.geomspace(5e-4, 0.1, 12), np.geomspace(5e-4, 0.1, 12)])
forces = [curve.steady(np.float64(v)) for v in speeds] + 0.2 * np.random.default_rng(2).standard_normal(speeds.size)
friction = fd.identification.fit_friction(fd.identification.runs_of(speeds, forces))
print(f"\n{friction}\n\n{friction.comparison()}")
