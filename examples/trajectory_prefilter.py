"""A prefilter from one run: what a well-fed axis still leaves behind, and how much of it can be foreseen."""

import dataclasses

import numpy as np

import feeddrive as fd

machine = fd.read_machine("ball_screw").loop("x")
smooth = dataclasses.replace(machine, axis=dataclasses.replace(machine.axis, friction_motor=None))
move = fd.blocks.SnapLimitedMove(distance=0.2, velocity=0.6, acceleration=8.0, jerk=500.0, snap=5e4, dwell_after=0.1)
other = fd.blocks.SnapLimitedMove(distance=0.05, velocity=0.3, acceleration=5.0, jerk=400.0, snap=4e4, dwell_after=0.1)


def error(loop: fd.Loop, reference: fd.blocks.SnapLimitedMove) -> float:
    return 1e6 * float(np.sqrt(np.mean(fd.simulate(loop, reference)["tracking_error"] ** 2)))


def behind(prefilter: fd.blocks.TrajectoryPrefilter) -> fd.Loop:
    return dataclasses.replace(smooth, control=dataclasses.replace(smooth.control, prefilter=prefilter))


fit = fd.learning.fit_prefilter(fd.simulate(smooth, move), move)
print(fit)
print(f"this move:  {error(smooth, move):.3f} -> {error(behind(fit.prefilter), move):.3f} um RMS")
print(f"other move: {error(smooth, other):.3f} -> {error(behind(fit.prefilter), other):.3f} um RMS")
even = fd.learning.fit_prefilter(fd.simulate(smooth, move), move, regressors=("acceleration", "snap"))
print(f"acceleration and snap only: {error(behind(even.prefilter), move):.3f} um RMS")
f = np.array([10.0, 20.0])
for name, loop in (("without", smooth), ("with", behind(fit.prefilter))):
    found = fd.tracking(loop, f)
    print(f"{name:8s} phase at 10 and 20 Hz: {found.phase_deg[0]:5.2f} and {found.phase_deg[1]:5.2f} deg")
