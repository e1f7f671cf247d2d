"""A frequency response of an axis, from the design of its excitation to a loop gain with the law that is on it."""

import numpy as np

import feeddrive as fd

T = 2.5e-4
encoder = fd.blocks.Encoder(resolution=1e-8, noise=5e-9)
loop = fd.Loop(
    control=fd.Control(law=fd.blocks.CascadePPI(Kv=40.0, Kp=12e3, Tn=0.02), force_limit=4000.0),
    axis=fd.Axis(
        plant=fd.blocks.TwoMass(mass_motor=60.0, mass_load=60.0, stiffness=1.5e7, damping=900.0),
        actuator=fd.blocks.Actuator(dead_time=1.5 * T, current_loop=1000.0),
        friction_motor=fd.blocks.Coulomb(coulomb=60.0),
        encoder_motor=encoder,
        encoder_load=encoder,
    ),
    sample_time=T,
)

# Three of four odd lines from 5 to 500 Hz on the force; the axis slides underneath, so that friction does not stick.
# The simulation says what that does to the axis, and refuses what breaks a limit.
excitation = fd.identification.design_excitation(loop, band=(5.0, 500.0), amplitude=200.0, realisations=3, travel=0.3)
print(excitation)
try:
    fd.identification.design_excitation(loop, band=(5.0, 500.0), amplitude=6000.0, travel=2.0)
except fd.FeeddriveError as error:
    print(f"refused: {error}")

# What the simulated log gives back, against the linear model of the axis: on a machine the log comes from `read_log`.
estimate = fd.estimate_frf(excitation.records("reading_load"))
model = fd.linearize(loop, ["cut"], ["reading_load"], velocity=excitation.offset_velocity).response(estimate.frequency)
away = np.abs(estimate.frf.response - model.response)
inside = 100.0 * np.mean(away <= estimate.radius(0.95))
print(f"{inside:.0f} % of {away.size} lines within their 95 % discs, {estimate.method}")

# The same record without the periods: any excitation would do, at the price of more variance.
for method in ("h1", "indirect"):
    other = fd.estimate_frf(excitation.records("reading_load"), method=method, segment=4000, band=(5.0, 500.0))
    error = np.sqrt(np.median(other.frf.variance / np.abs(other.frf.response) ** 2))
    print(f"{method}: typical deviation {100.0 * error:.2g} %")

# Margins straight from the measurement.
motor = fd.estimate_frf(excitation.records("reading_motor"))
print(fd.measured_loop(loop.control, T, estimate.frf, motor.frf).margins)
