"""A cutting force recovered from positions and commands, and subtracted beside a cascade that stays as it is."""

import numpy as np

import feeddrive as fd

T = 1e-4
axis = fd.Axis(plant=fd.blocks.Rigid(mass=40.0, viscous=60.0), encoder_load=fd.blocks.Encoder(resolution=1e-8))
law = fd.blocks.CascadePPI(Kv=100.0, Kp=24e3, Tn=0.01)
forward = (fd.blocks.Inertia(mass=40.0, viscous=60.0),)
rest = fd.blocks.Polynomial7(distance=0.0, travel_time=0.5)
cut = fd.blocks.SineForce(amplitude=150.0, frequency=40.0, start=0.05)  # N
observers = {
    "none": None,
    "exact": fd.blocks.DisturbanceRecovery(mass=40.0, viscous=60.0, form="exact"),
    "500 Hz": fd.blocks.DisturbanceRecovery(mass=40.0, viscous=60.0, frequency=500.0),
    "kalman": fd.blocks.KalmanRecovery(mass=40.0, viscous=60.0, resolution=1e-8, force_step=20.0),
}
frequency = np.geomspace(1.0, 5000.0, 1500)
for name, observer in observers.items():
    beside = () if observer is None else (fd.blocks.DisturbanceRejection(observer=observer, blend_time=0.02),)
    control = fd.Control(law=law, feedforward=forward, compensation=beside)
    loop = fd.Loop(control=control, axis=axis, sample_time=T)
    run = fd.simulate(loop, rest, load=cut)
    rms = 1e6 * np.sqrt(np.mean(run["tracking_error"][1000:] ** 2))
    peak = fd.margins(fd.loop_gain(loop, frequency)).sensitivity_peak
    print(f"{name:8s} {rms:6.3f} um RMS, Ms {peak:.2f}", end="")
    if observer is not None:  # what it saw, from the run as from any log
        seen = fd.analysis.observe(observer, run["reading_load"], run["force"], T)
        off = seen.error(run["load_force"], skip=1000, aligned=True)
        print(f"; force off by {off:5.2f} N RMS, {1e3 * seen.lag:.2f} ms late", end="")
    print()
