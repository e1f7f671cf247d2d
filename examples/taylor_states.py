"""A milling axis under active disturbance rejection: what more Taylor states in its observer bring, and cost."""

import dataclasses

import numpy as np

import feeddrive as fd

loop = fd.read_machine("mill").loop("x")
frequency = np.geomspace(0.5, 4000.0, 3000)  # Hz
leg = fd.blocks.Bezier10(distance=4e-3, travel_time=1.0, dwell_before=0.2)
still = fd.blocks.LinearMove(distance=0.0, travel_time=1.2)
cut = fd.blocks.MillingForce(
    cutter=fd.blocks.HelicalCutter.beltran2013(), spindle_speed=1800.0, references=(leg, still)
)
for states in (0, 1, 3, 5):
    observer = dataclasses.replace(loop.control.law.observer, taylor_states=states)
    law = dataclasses.replace(loop.control.law, observer=observer)
    made = dataclasses.replace(loop, control=dataclasses.replace(loop.control, law=law))
    peak = fd.margins(fd.loop_gain(made, frequency)).sensitivity_peak
    soft = 1e6 * fd.compliance(made, np.array([10.0, 60.0, 140.0])).magnitude  # um/N; the teeth pass at 60 Hz
    run = fd.simulate(made, leg, load=cut)
    rms = 1e6 * np.sqrt(np.mean(run["tracking_error"] ** 2))
    shown = " ".join(f"{value:8.4f}" for value in soft)
    print(
        f"{states} Taylor states: Ms {peak:.2f}, compliance at 10, 60, 140 Hz {shown} um/N, cutting {rms:8.1f} um RMS"
    )
try:
    dataclasses.replace(loop, sample_time=3e-3)
except fd.FeeddriveError as error:
    print(error)
