"""A control as C: its step proven equal to the simulation, and its gains changed while the axis moves."""

import tempfile
from pathlib import Path

import feeddrive as fd

with tempfile.TemporaryDirectory() as folder:
    design, readme = fd.write_export("ball_screw", "c", Path(folder) / "axis_x")
    step = (readme.parent / "axis_x.c").read_text(encoding="utf-8").split("void axis_x_step")[1]
    lines = [line for line in step.splitlines() if "=" in line]
    print(f"{design.title}")
    print(f"the step: {len(lines)} assignments, {step.count('for (')} loops")
    found = fd.verify(readme.parent, samples=100_000)
    print(f"{found.samples} samples, {found.trips} trips, {found.changes} changes of gains by {found.program}:")
    print(f"{found.differing} outputs with other bits than the simulator's")

# the same change of gains, live, in the simulator: what the drive's technician will see
move = fd.blocks.SnapLimitedMove(distance=0.1, velocity=0.4, acceleration=5.0, jerk=300.0, snap=3e4)
softer = {
    "axis.x.control.law.Kv": 0.6 * design.loop.control.law.Kv,
    "axis.x.control.law.Kp": 0.8 * design.loop.control.law.Kp,
}
for name, changes in (("as it is", None), ("softer from 0.05 s on", {0.05: softer})):
    run = fd.simulate(design.loop, move, changes=changes)
    jump = abs(run["force"][1:] - run["force"][:-1])
    at = round(0.05 / design.routine.sample_time)
    print(f"{name:<22} largest error {1e6 * abs(run['tracking_error']).max():6.2f} um, ", end="")
    print(f"step of the force at 0.05 s {jump[at - 1]:5.2f} N, largest of all {jump.max():5.2f} N")
