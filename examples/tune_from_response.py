"""From a noisy frequency response to tuned gains: what holds them back, and whether they hold on the true axis."""

import dataclasses

import numpy as np

import feeddrive as fd

loop = fd.read_machine("ball_screw").loop("x")  # the true axis, of which only the responses below are known
T = loop.sample_time
lines = np.arange(1.0, 2001.0)
random = np.random.default_rng(0)
model = fd.linearize(loop, ["cut", "load_force"], ["reading_load", "reading_motor"])


def measured(source: str, reading: str) -> fd.FRF:
    """One per cent of noise on each line."""
    true = model.response(lines, reading, source).response
    a, b = random.standard_normal((2, lines.size))
    noise = 0.01 * np.abs(true) * (a + 1j * b) / np.sqrt(2.0)
    return fd.FRF(lines, true + noise, source, reading, "m/N", T, variance=(0.01 * np.abs(true)) ** 2)


load, motor = measured("cut", "reading_load"), measured("cut", "reading_motor")
hammer = (measured("load_force", "reading_load"), measured("load_force", "reading_motor"))
point = fd.tuning.measured_point(load, motor, disturbance=hammer, sample_time=T)

rule = fd.tuning.margin_goals(point, loop.control, goal="robust")
print(f"by rule: Kv {rule.law.Kv:.0f} 1/s, Kp {rule.law.Kp:.0f} N s/m, Tn {1e3 * rule.law.Tn:.1f} ms")

limits = fd.tuning.Limits(sensitivity_peak=2.0, compliance_peak_m_per_N=0.2e-6)
for filters in ("kept", "free", "placed"):
    found = fd.tuning.tune_control(loop.control, point, limits=limits, filters=filters)
    true = dataclasses.replace(loop, control=found.control)
    margins = fd.margins(fd.loop_gain(true, np.geomspace(1.0, 9999.0, 6000)))
    print(f"filters {filters}: rope snap {1e9 * found.after[0].rope_snap:.2f} nm s^1/2/N as measured")
    print(f"  Ms on the true axis {margins.sensitivity_peak:.3f}, kept with {found.sure:.1f} standard deviations")
    print(f"  held back by {found.held[0].sentence()}")
    print(f"  {found.recommendation()}")
