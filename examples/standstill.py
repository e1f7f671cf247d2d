"""A table held by friction under a load below breakaway: set-valued friction holds it, the regularised form creeps."""

import dataclasses

import numpy as np

import feeddrive as fd

loop = fd.read_machine("emps").loop("x")
rest = fd.blocks.SnapLimitedMove(distance=0.0, velocity=0.1, acceleration=1, jerk=50, snap=5000, dwell_before=5.0)
load = fd.blocks.StepForce(force=15.0, start=0.5)  # N; the axis sticks up to 20 N
off = dataclasses.replace(loop.control, law=fd.blocks.CascadePPI(Kv=1e-9, Kp=1e-9))  # a controller that does nothing
for friction in (fd.blocks.Coulomb(coulomb=20.0), fd.blocks.Regularised(coulomb=20.0, transition_velocity=2e-4)):
    axis = dataclasses.replace(loop.axis, friction_load=friction)
    run = fd.simulate(dataclasses.replace(loop, axis=axis, control=off), rest, load=load)
    moved, speed = run["position_load"][-1], np.max(np.abs(run["velocity_load"][1000:]))
    print(f"{friction.kind:12s} moved {1e6 * moved:8.2f} um in 4.5 s, fastest {1e6 * speed:8.3f} um/s")
