"""Which gains follow best on the EMPS axis? 400 variants in one call, then the margins of the best."""

import numpy as np

import feeddrive as fd

loop = fd.read_machine("emps").loop("x")
move = fd.blocks.SnapLimitedMove(distance=0.1, velocity=0.1, acceleration=0.8, jerk=20, snap=1000, dwell_after=0.2)

Kv, Kp = np.meshgrid(np.linspace(60, 400, 20), np.linspace(4e3, 30e3, 20))
variants = fd.vary(
    loop,
    {
        "axis.x.control.law.Kv": Kv.ravel(),
        "axis.x.control.law.Kp": Kp.ravel(),
        "axis.x.control.law.velocity_feedforward": np.ones(Kv.size),
    },
)
batch = fd.simulate_batch(variants, move)
print(batch)

f = np.geomspace(1, 500, 400)
for best in np.argsort(batch.rms["following_error"]):
    gains = {"axis.x.control.law.Kv": float(Kv.flat[best]), "axis.x.control.law.Kp": float(Kp.flat[best])}
    peak = fd.margins(fd.loop_gain(fd.vary(loop, gains), f)).sensitivity_peak
    if peak <= 2.0:
        break
print(
    f"least error with Ms <= 2: Kv {Kv.flat[best]:.0f} 1/s, Kp {Kp.flat[best]:.0f} N s/m, Ms {peak:.2f}, "
    f"{1e6 * batch.rms['following_error'][best]:.1f} um RMS"
)
