"""Draws docs/images/turning_and_drilling.svg: a hole through a plate, and a turning cut beside its limit.

python docs/draw_turning_and_drilling.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("svg")
import matplotlib.pyplot as plt
import numpy as np

import feeddrive as fd

IMAGES = Path(__file__).parent / "images"


def plate() -> tuple[Any, ...]:
    """Time, thrust, torque and following error of the bundled job, with the cut of the actual motion."""
    job = fd.read_job("drill_plate")
    load = job.load
    cut = fd.blocks.DrillingCut(
        tool=load.tool, spindle_speed=3000, along="x", towards="positive", surface=0.005, thickness=0.012
    )
    machine = fd.read_machine("ball_screw").machine(cut)
    run = fd.simulate(machine, {"x": job.reference})
    x = run["x.position_load"]
    lip = round(60.0 / (2 * 3000) / run.sample_time)
    chip = x - np.concatenate([np.full(lip, x[0]), x[:-lip]])
    thrust, torque = load.tool.forces(x - 0.005, 0.012, chip)
    return run.time, thrust, torque, run["x.tracking_error"]


def shaft(share: float) -> tuple[Any, Any]:
    """Turns and motion of a tool of one mode, at a share of its least limit in depth."""
    frequency, ratio, mass = 120.0, 0.03, 20.0
    stiffness = mass * (2.0 * np.pi * frequency) ** 2
    edge = fd.blocks.EdgeCoefficients(Ktc=1.9e9, Kfc=0.8e9)
    depth = 2.0 * stiffness * ratio * (1.0 + ratio) / edge.Kfc
    w = 2.0 * np.pi * frequency * np.sqrt(1.0 + 2.0 * ratio)
    answer = 1.0 / (stiffness - mass * w * w + 2j * ratio * mass * 2.0 * np.pi * frequency * w)
    turn = (2.0 * np.pi * 3.0 - np.angle(1.0 + 1.0 / (edge.Kfc * depth * answer))) / w
    tool = fd.blocks.TurningTool(cutting_depth=share * depth, edge=edge)
    loop = fd.Loop(
        control=fd.Control(law=fd.blocks.CascadePPI(Kv=1e-9, Kp=1e-9, Tn=1e9)),
        axis=fd.Axis(plant=fd.blocks.Rigid(mass=1e18)),
        sample_time=turn / 200,
    )
    mode = fd.blocks.StructureMode(
        frequency=frequency, damping_ratio=ratio, mass=mass, shapes=(fd.blocks.ModeShape(axis="z", load=1.0),)
    )
    cut = fd.blocks.TurningCut(tool=tool, spindle_speed=60.0 / turn, feed_towards="positive")
    machine = fd.Machine.of({"z": loop}, (mode, cut))
    still = {"z": fd.blocks.LinearMove(distance=0.0, travel_time=1.0)}
    feed = 2e-4 / turn
    run = fd.simulate(machine, still, start={"z": (0.0, feed)}, duration=60 * turn)
    return run.time / turn, run["z.position_load"] - feed * run.time


if __name__ == "__main__":
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "feeddrive", "font.size": 8}):
        figure, rows = plt.subplots(3, 1, figsize=(7.0, 6.0), constrained_layout=True)
        time, thrust, torque, error = plate()
        rows[0].plot(time, thrust, label="thrust, N")
        rows[0].plot(time, 200.0 * np.asarray(torque), label="torque, N m x 200")
        rows[0].legend(loc="upper right")
        rows[0].set_title("a hole of 10 mm through 12 mm of aluminum, 0.3 mm a turn")
        rows[1].plot(time, 1e6 * error)
        rows[1].set_ylabel("following error, um")
        rows[1].set_xlabel("s")
        for share in (1.1, 0.9):
            turns, moved = shaft(share)
            rows[2].plot(turns, 1e6 * moved, lw=0.6, label=f"{share} of the limit")
        rows[2].legend(loc="upper left")
        rows[2].set_title("turning with one mode of 120 Hz")
        rows[2].set_xlabel("turns of the spindle")
        rows[2].set_ylabel("motion of the tool, um")
        figure.savefig(IMAGES / "turning_and_drilling.svg", metadata={"Date": None})
