"""The force of an end mill in half immersion: up and down milling, energy, and what it does to an axis."""

import dataclasses

import numpy as np

import feeddrive as fd

tool = fd.blocks.HelicalCutter(
    teeth=4, diameter=0.016, axial_depth=0.004, radial_depth=0.008, helix_angle=np.radians(30), specific_energy=2.2e9
)
speed, chip_load = 3000.0, 8e-5  # rpm, m per tooth
angle = 2.0 * np.pi * (np.arange(20_000) + 0.5) / 20_000
loop = fd.read_machine("ball_screw").loop("x")
rest = fd.blocks.LinearMove(distance=0.0, travel_time=0.5)
for milling in ("up", "down"):
    cutter = dataclasses.replace(tool, milling=milling)
    feed, normal, axial = (np.asarray(force) for force in cutter.forces(angle, chip_load))
    power = np.mean(cutter.torque(angle, chip_load)) * 2.0 * np.pi * speed / 60.0
    chips = 2.2e9 * (chip_load * 4 * speed / 60.0) * 0.008 * 0.004  # specific energy times volume per second
    print(
        f"{milling:4s} milling: feed {feed.mean():7.1f} N, normal {normal.mean():7.1f} N, axial {axial.mean():6.1f} N"
    )
    print(f"  spindle {power:.4f} W, chips {chips:.4f} W")
    force = fd.blocks.MillingForce(cutter=cutter, spindle_speed=speed, chip_load=chip_load, component="x", start=0.1)
    run = fd.simulate(loop, rest, load=force)
    x = 1e6 * run["position_load"][run.time > 0.3]
    print(f"  a standing axis moves by {np.ptp(x):.2f} um, {np.mean(x):+.3f} um in the mean")
