"""Identification of a logged motion of 25 s at 1 kHz: each step, and all of `feeddrive identify` but its report."""

from __future__ import annotations

import numpy as np
from rounds import machine, measure_both, table

from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.files.machine import read_machine
from feeddrive.identification.motion.identify import identify_motion
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.output_error import refine
from feeddrive.identification.motion.rigid import find_delay, identify_rigid
from feeddrive.loop.simulate import simulate

ROUNDS = 7
ROWS = 24841  # as many as the EMPS log has


def main() -> None:
    print(machine(), "\n")
    loop = read_machine("emps").loop("x")
    log = simulated()
    wall, cpu = measure_both(
        {
            "inverse dynamics, two models of friction, cross-validation": lambda: identify_rigid(log),
            "dead time, 41 candidates": lambda: find_delay(log),
            "output error, 5 parameters, 2 dead times": lambda: refine(loop, log),
            "all": lambda: identify_motion(log, loop),
        },
        ROUNDS,
    )
    rows = [[name, f"{1e3 * np.median(wall[name]):.0f}", f"{1e3 * np.median(cpu[name]):.0f}"] for name in wall]
    table([f"{ROWS} rows", "wall ms", "CPU ms"], rows)


def simulated() -> MotionLog:
    """The bundled axis along four strokes to and fro, with 2 N of noise."""
    T = 1e-3
    move = SnapLimitedMove(
        distance=0.246,
        velocity=0.125,
        acceleration=0.84,
        jerk=20.0,
        snap=1000.0,
        back=True,
        dwell_before=0.2,
        dwell_between=0.2,
        dwell_after=0.8,
    )
    t = np.arange(ROWS) * T
    positions = np.asarray(move.at(np.mod(t, move.duration)).position)
    noise = RecordedForce(force=2.0 * np.random.default_rng(1).standard_normal(ROWS), sample_time=T)
    run = simulate(read_machine("emps").loop("x"), Recorded(position=positions, sample_time=T), load=noise)
    return MotionLog(
        name="simulated",
        position=run["reading_load"][:ROWS],
        force=run["force"][:ROWS],
        set_position=positions,
        sample_time=T,
    )


if __name__ == "__main__":
    main()
