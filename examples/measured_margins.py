"""Margins, stability and stiffness of a control on an axis of which only frequency responses were measured."""

from __future__ import annotations

import numpy as np

import feeddrive as fd

loop = fd.read_machine("ball_screw").loop("x")
T = float(loop.sample_time)
lines = np.geomspace(3.0, 3000.0, 800)
random = np.random.default_rng(4)


def measured(source: str, reading: str) -> fd.FRF:
    """A response with 2 % of noise, as a hammer or an excitation of some minutes would leave it."""
    # a force on the table, too, is measured with the loop cut: the axis alone answers
    true = fd.linearize(loop, list({"cut", source}), [reading]).response(lines, input=source)
    size = 0.02 * true.magnitude
    a, b = random.standard_normal((2, lines.size)) * size / np.sqrt(2.0)
    return fd.FRF(lines, true.response + a + 1j * b, source, reading, "m/N", T, variance=size**2)


load, motor = (measured("cut", name) for name in ("reading_load", "reading_motor"))
hammer = tuple(measured("load_force", name) for name in ("reading_load", "reading_motor"))
found = fd.measured_loop(loop.control, T, load, motor, disturbance=hammer)
exact = fd.margins(fd.loop_gain(loop, lines))

print(found)
print(found.encirclement().sentence())
print(found.margin_intervals())
print(f"modulus margin of the true loop: {exact.modulus_margin:.3f}")
later = fd.margins(found.loop_gain.delayed(2 * T))
print(f"with two samples more of dead time Ms rises from {exact.sensitivity_peak:.2f} to {later.sensitivity_peak:.2f}")

# control and axis as arrays, or as objects of python-control: here C(s) of force over error, on the load's encoder
s = 2j * np.pi * lines
C = 1.2e4 * (20.0 + s) * (1.0 + 10.0 / s) / (1.0 + s / 300.0)
arrays = fd.measured_loop((lines, C), None, (lines, load.response), delay=1.5 * T)
print(f"from arrays: Ms {arrays.margins.sensitivity_peak:.2f}, {arrays.encirclement().sentence()}")
