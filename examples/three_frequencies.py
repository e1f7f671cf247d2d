"""DADSC from three frequencies and the dead time, beside a cascade of equal velocity gain."""

import dataclasses

import numpy as np

import feeddrive as fd

T = 1e-4
axis = fd.Axis(
    plant=fd.blocks.Rigid(mass=40.0, viscous=60.0),
    actuator=fd.blocks.Actuator(dead_time=T),
    encoder_load=fd.blocks.Encoder(resolution=1e-8),
)
rate = 0.5 * 0.19 / (2 * T)  # half of what keeps Ms <= 2 with one sample of dead time, 1/s
gain = 4.0 * rate / 9.0  # the most that leaves the cascade's poles real
dadsc = fd.Loop(
    control=fd.Control(
        law=fd.blocks.DADSC(mass=40.0, viscous=60.0, tracking_rate=rate, reaching_rate=rate, adaptation_rate=rate)
    ),
    axis=axis,
    sample_time=T,
)
cascade = fd.Control(
    law=fd.blocks.CascadePPI(Kv=gain, Kp=3.0 * 40.0 * rate, Tn=1.0 / gain, viscous=60.0),
    feedforward=(fd.blocks.Inertia(mass=40.0),),
)
rest = fd.blocks.Polynomial7(distance=0.0, travel_time=0.2)
cut = fd.blocks.StepForce(force=200.0, start=0.02)
frequency = np.geomspace(0.1, 5000.0, 2000)
print(f"p = {rate:.0f} 1/s")
for name, loop in (("dadsc", dadsc), ("cascade", dataclasses.replace(dadsc, control=cascade))):
    margins = fd.margins(fd.loop_gain(loop, frequency))
    stiff = fd.stiffness(fd.compliance(loop, frequency))
    error = fd.simulate(loop, rest, load=cut)["tracking_error"]
    print(
        f"{name:8s} Ms {margins.sensitivity_peak:.2f}, N/um at 1 Hz {1e-6 * stiff.at(1.0):6.1f}, at 100 Hz "
        f"{1e-6 * stiff.at(100.0):5.1f}; a step of 200 N pushes it off by {1e6 * np.max(np.abs(error)):.2f} um"
    )
tunables = [f"axis.x.control.law.{name}" for name in fd.blocks.DADSC.tunables]
print(fd.tuning.delay_map(dadsc, tunables, [0.0, T, 2.0 * T, 3.0 * T]))
