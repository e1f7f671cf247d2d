"""A certificate from a real measurement: the two-inertia bench of the University of Tokyo, multisine type A."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import feeddrive as fd
from feeddrive.certificate.certificate import deviations
from test_tokyo_bench import estimated, needs_log


@needs_log
def test_a_cascade_on_the_bench_is_certified() -> None:
    """Angle over current stands for m/N: the law's gains carry the constant of the motor.

    Two modes at the antiresonance's and resonance's place are found, every line lies in its disc, and what makes the
    discs wide is the variance: friction and noise of 4 % in the middle, at the confidence for all 240 lines together.
    """
    T = 4e-4
    frf = replace(estimated("theta_mx").frf, unit="m/N", sample_time=T)
    inertia = 1.0 / np.mean(frf.magnitude[:3] * (2.0 * np.pi * frf.frequency[:3]) ** 2)
    crossover = 2.0 * np.pi * 20.0
    law = fd.blocks.CascadePPI(
        Kp=inertia * crossover, Tn=4.0 / crossover, Kv=0.25 * crossover, velocity_encoder="motor"
    )
    found = fd.certificate.certify_loop(fd.Control(law=law), {"bench": frf}, sample_time=T, arithmetic="float32")
    plant = found.document["plants"][0]
    assert "240 measured lines" in plant["source"]
    assert found.reserve is not None
    assert 1.5 < found.reserve < 3.0
    loop = found.loops["bench"]
    resonance = [np.angle(p) / (2.0 * np.pi * T) for p in loop.plant.poles() if 0.9 < abs(p) < 1.0 and p.imag > 0.0]
    assert any(abs(f / 76.2 - 1.0) < 0.02 for f in resonance)
    model = loop.plant.response(frf.frequency).response
    assert frf.variance is not None
    noise = deviations(240, 0.95) * np.sqrt(frf.variance) / np.abs(model)
    misfit = np.abs(frf.response - model) / np.abs(model)
    assert np.median(misfit / noise) < 0.5
