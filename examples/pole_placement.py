"""Pole placement on a ball screw: how far may the bandwidth go, and what does it buy over P-PI?"""

import dataclasses

import numpy as np

import feeddrive as fd

T = 1e-4
screw = fd.blocks.TwoMass(
    mass_motor=220.0, mass_load=90.0, stiffness=9.0e7, damping=1800.0, viscous_motor=2500.0, viscous_load=100.0
)
axis = fd.Axis(
    plant=screw,
    actuator=fd.blocks.Actuator(dead_time=T, current_loop=1200.0),
    encoder_motor=fd.blocks.Encoder(resolution=2e-8),
    encoder_load=fd.blocks.Encoder(resolution=2e-8),
)
rigid = fd.blocks.CascadePPI(Kv=141.0, Kp=1.75e5, Tn=5.3e-3)  # a velocity loop of 90 Hz
f = np.geomspace(0.5, 5000.0, 2000)


def loop(
    law: fd.blocks.CascadePPI | fd.blocks.PolePlacement, *feedforward: fd.blocks.Inertia | fd.blocks.InverseDynamics
) -> fd.Loop:
    return fd.Loop(control=fd.Control(law=law, feedforward=feedforward), axis=axis, sample_time=T)


def figures(made: fd.Loop) -> str:
    stiff = fd.stiffness(fd.compliance(made, f))
    peak = fd.margins(fd.loop_gain(made, f)).sensitivity_peak
    return f"Ms {peak:.2f}, {1e-6 * stiff.at(5.0):4.0f} N/um at 5 Hz, softest {1e-6 * stiff.minimum:4.1f} N/um"


print(f"P-PI                  {figures(loop(rigid))}")
for bandwidth in (40.0, 60.0, 80.0):
    law = fd.blocks.PolePlacement(model=screw, bandwidth=bandwidth, axial_damping=0.08)
    print(f"poles at {bandwidth:.0f} Hz        {figures(loop(law))}")
placed = loop(
    fd.blocks.PolePlacement(model=screw, bandwidth=80.0, axial_damping=0.08), fd.blocks.InverseDynamics(model=screw)
)
print(fd.tuning.placement(placed).table())

move = fd.blocks.SnapLimitedMove(distance=0.2, velocity=0.8, acceleration=8.0, jerk=500.0, snap=5e4, dwell_after=0.1)
for name, made in (
    ("P-PI", loop(rigid, fd.blocks.Inertia(mass=310.0, viscous=2600.0))),
    ("pole placement", placed),
    (
        "screw set as the table",
        dataclasses.replace(
            placed,
            control=dataclasses.replace(placed.control, law=dataclasses.replace(placed.control.law, commands="rigid")),
        ),
    ),
):
    error = fd.simulate(made, move)["tracking_error"]
    print(f"{name:22s} {1e6 * np.sqrt(np.mean(error**2)):6.3f} um RMS")
