"""A column that gives way at 35 Hz: the axis recovers the cutting force and moves with the tool."""

import numpy as np
from scipy.integrate import solve_ivp

import feeddrive as fd

T, frequency, damping, stiffness = 1e-4, 35.0, 0.03, 2e7
axis = fd.Axis(plant=fd.blocks.Rigid(mass=40.0, viscous=60.0))
law = fd.blocks.DADSC(mass=40.0, viscous=60.0, tracking_rate=600.0, reaching_rate=600.0, adaptation_rate=600.0)
recovery = fd.blocks.DisturbanceRecovery(mass=40.0, viscous=60.0, frequency=500.0)
rest = fd.blocks.Polynomial7(distance=0.0, travel_time=1.0)
cut = fd.blocks.SineForce(amplitude=100.0, frequency=frequency)  # at resonance

# the machine itself: the reaction of the cutting force bends the column by x_s
w = 2.0 * np.pi * frequency
t = T * np.arange(10_001)
column = solve_ivp(
    lambda t, y: [y[1], w * w * (-100.0 * np.sin(w * t) / stiffness - y[0]) - 2.0 * damping * w * y[1]],
    (0.0, t[-1]),
    [0.0, 0.0],
    t_eval=t,
    rtol=1e-8,
    atol=1e-12,
).y[0]


def compensated(believed: float, **lead: float) -> tuple[fd.blocks.ModeCompensation, ...]:
    """Compensation of the mode, with the frequency in Hz that one believes it has."""
    mode = fd.blocks.MachineMode(frequency=believed, damping_ratio=damping, stiffness=stiffness)
    return (fd.blocks.ModeCompensation(modes=(mode,), observer=recovery, **lead),)


for name, compensation in (
    ("none", ()),
    ("without lead", compensated(frequency, lead_time=0.0)),
    ("with lead", compensated(frequency)),
    ("5 % off", compensated(0.95 * frequency)),
):
    loop = fd.Loop(control=fd.Control(law=law, compensation=compensation), axis=axis, sample_time=T)
    run = fd.simulate(loop, rest, load=cut)
    tool = run["position_load"] - column
    print(f"{name:13s} {1e6 * np.sqrt(np.mean(tool[5000:] ** 2)):6.2f} um RMS at the tool")
