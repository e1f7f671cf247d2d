"""A P-PI cascade from mass and delay alone: gains by rule, checked by margins, stiffness and one move."""

import dataclasses
import math

import numpy as np

import feeddrive as fd

axis = fd.Axis(
    plant=fd.blocks.Rigid(mass=350.0),
    actuator=fd.blocks.Actuator(dead_time=2.5e-4, current_loop=1000.0),
    friction_load=fd.blocks.Coulomb(coulomb=120.0),
    encoder_load=fd.blocks.Encoder(resolution=1e-7),
)
T = 2.5e-4
move = fd.blocks.SnapLimitedMove(distance=0.1, velocity=0.5, acceleration=5.0, jerk=200.0, snap=2e4, back=True)
frequency = np.geomspace(1.0, 0.5 / T, 2000)

for crossover in (40.0, 80.0, 160.0):  # Hz, of the velocity loop
    w = 2.0 * math.pi * crossover
    law = fd.blocks.CascadePPI(
        Kv=w / 4.0, Kp=350.0 * w, Tn=4.0 / w
    )  # position loop a quarter, integral a quarter of it
    forward = (
        fd.blocks.Inertia(mass=350.0),
        fd.blocks.FrictionFeedforward(coulomb_positive=120.0, coulomb_negative=120.0),
    )
    loop = fd.Loop(control=fd.Control(law=law), axis=axis, sample_time=T)
    margins = fd.margins(fd.loop_gain(loop, frequency))
    stiff = fd.stiffness(fd.compliance(loop, frequency))
    print(f"velocity loop {crossover:3.0f} Hz: Kv {law.Kv:4.0f} 1/s, Kp {law.Kp:6.0f} N s/m, Tn {1e3 * law.Tn:4.1f} ms")
    print(f"  Ms {margins.sensitivity_peak:.2f}, softest {1e-6 * stiff.minimum:.1f} N/um")
    for name, blocks in (("feedback alone", ()), ("with feedforward", forward)):
        with_blocks = dataclasses.replace(loop, control=dataclasses.replace(loop.control, feedforward=blocks))
        run = fd.simulate(with_blocks, move)
        rms = np.sqrt(np.mean(run["tracking_error"] ** 2))
        print(f"  {name:16s} {1e6 * rms:7.2f} um RMS")
