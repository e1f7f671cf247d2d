"""The gain margin says by how much the gain may rise. Does the simulated loop agree?"""

import numpy as np

import feeddrive as fd

loop = fd.read_machine("ball_screw").loop("x")
margins = fd.margins(fd.loop_gain(loop, np.geomspace(1, 10_000, 3000)))
rise = 10 ** (margins.gain_increase_dB / 20)
print(margins)

move = fd.blocks.SnapLimitedMove(
    distance=0.4, velocity=0.2, acceleration=5, jerk=400, snap=4e4
)  # 2 s at constant speed
for share in (0.98, 1.02):
    louder = fd.vary(loop, {"axis.x.control.law.Kp": share * rise * loop.control.law.Kp})
    run = fd.simulate(louder, move)
    early, late = (np.std(run["following_error"][(run.time > t) & (run.time < t + 0.2)]) for t in (0.2, 1.6))
    verdict = "rings on" if late > early else "dies out"
    print(
        f"gain x {share * rise:.3f}: ringing of {1e6 * early:.3g} um at 0.2 s, {1e6 * late:.3g} um at 1.6 s: {verdict}"
    )
