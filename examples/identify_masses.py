"""Masses, stiffness and modes of an axis from the responses of its encoders, and what they cannot tell.

The responses are simulated: a drive screw of two masses, 1 % of noise on every line.  Printed are the structure that
predicts best what it has not seen, its parameters with their errors, and what one encoder and a short band leave open.
"""

from dataclasses import replace

import numpy as np

import feeddrive as fd

plant = fd.blocks.TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0)
loop = fd.Loop(
    control=fd.Control(law=fd.blocks.CascadePPI(Kv=1.0, Kp=1.0, Tn=1.0)),
    axis=fd.Axis(plant=plant, actuator=fd.blocks.Actuator(dead_time=2e-4)),
    sample_time=2e-4,
)
model = fd.linearize(loop, ["cut"], ["position_motor", "position_load"], velocity=0.05)
f = np.linspace(5.0, 400.0, 200)
random = np.random.default_rng(2)


def measured(output: str) -> fd.FRF:
    """One encoder's response with 1 % of complex noise, and its variance."""
    exact = model.response(f, output=output).response
    rough = 0.01 / np.sqrt(2.0) * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
    variance = (0.01 * np.abs(exact)) ** 2
    return fd.FRF(f, exact * (1.0 + rough), "force", output, "m/N", sample_time=2e-4, variance=variance)


motor, load = measured("position_motor"), measured("position_load")
found = fd.identification.fit_axis(motor, load)
print(found.table())
print(found.fit.table())
for name, why in found.fit.not_identifiable.items():
    print(f"not identifiable: {name}: {why}")

modes = fd.identification.fit_modes([motor, load])
print(modes.table())

alone = fd.identification.fit_two_mass(motor, band=(5.0, 30.0))
print(f"to 30 Hz with one encoder: {', '.join(alone.not_identifiable)}")
print(alone.remarks[-1])

in_amperes = replace(motor * 35.0, unit="m/A"), replace(load * 35.0, unit="m/A")
found = fd.identification.fit_two_mass(*in_amperes, force_per_unit=35.0)
print(f"through the motor's 35 N/A: {found['mass_load'].value:.2f} kg")
