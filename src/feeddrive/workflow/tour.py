"""`feeddrive tour`: the log for the introductory tour, simulated on an axis that differs from its machine file.

tour.csv   the log a drive would record: set position, both encoders and force at every sample
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from feeddrive.analysis.replay import path_of
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.machine import read_machine
from feeddrive.files.run_files import write_run_csv
from feeddrive.language import tree
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Table
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate
from feeddrive.workflow.command import OUT, Outcome, Request, command, option

MACHINE = "ball_screw"
WORKPIECE = 12.0  # kg on the table
DRIER = 25.0  # N, dry friction in addition to that of the machine file
NOISE = 5e-9  # m, standard deviation of both readings, before quantization to the counts of the file
SEED = 16
_STROKES = ((0.06, 0.25, 4.0), (0.03, 0.1, 3.0), (0.005, 0.02, 1.0))  # m, m/s, m/s2: there and back
_JERK, _SNAP, _PAUSE = 200.0, 2e4, 0.05  # m/s3, m/s4, s


class TourRequest(Request):
    """The output directory of the log."""

    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results/tour")


@command(TourRequest)
def tour(request: TourRequest, progress: Progress) -> Outcome[Run]:
    """Simulate the log for the introductory tour: a ball screw with a workpiece, more friction, noise and quantization.

    The control is that of the machine file. The result is the run.
    """
    loop = axis()
    progress.step("simulating three strokes")
    reference = strokes(loop.sample_time)
    # as a drive does, the control feeds forward the differences of its set positions
    moved = simulate(loop, path_of(loop.control, reference, float(loop.sample_time)), seed=SEED, name="tour")
    files = dict[str, Path]()
    if request.out is not None:
        progress.step("writing the log")
        rows = slice(0, reference.size)
        millimetres = {
            "set_position": reference,
            "position_load": moved["reading_load"][rows],
            "position_motor": moved["reading_motor"][rows],
        }
        # positions to 1 nm, a tenth of a count of the encoders; set positions finer: their second differences are fed
        # forward, which 1 nm would change by up to 0.8 m/s2
        digits = {"set_position": 9}
        columns: dict[str, np.ndarray] = {
            name: np.round(1e3 * signal, digits.get(name, 6)) for name, signal in millimetres.items()
        }
        columns["force"] = np.round(moved["force"][rows], 3)
        with new_directory(request.out) as folder:
            write_run_csv(
                folder / "tour.csv",
                np.round(moved.time[rows], 9),
                columns,
                {**dict.fromkeys(millimetres, "mm"), "force": "N"},
            )
        files["Log"] = request.out / "tour.csv"
    rows_of_table = [
        ("workpiece", Quantity(WORKPIECE, "kg", form="6"), UNIT),
        ("dry friction", Quantity(DRIER, "N", form="6"), UNIT),
        ("noise of both encoders", Quantity(NOISE, "m", form="6 nm"), UNIT),
    ]
    shown = Table(f"the axis of the log: {MACHINE}, and more of", ("what", "more", "unit"), rows_of_table)
    log = files.get("Log", "the log")
    notes = [f"Next: feeddrive identify {log} --machine {MACHINE}; or all of it on a page: feeddrive studio --tour."]
    return Outcome(moved, [shown], [f"seed {SEED}"], notes=notes, files=files)


def axis() -> Loop:
    """Return the loop that the tour measures: the bundled axis, modified, under its existing control."""
    loop = read_machine(MACHINE).loop("x")
    place = loop.place_of("axis")
    more = {"plant.mass_load": WORKPIECE, "friction_motor.coulomb": DRIER, "friction_motor.breakaway": DRIER}
    changed = tree.vary(loop, {f"{place}.{name}": tree.get(loop, f"{place}.{name}") + by for name, by in more.items()})
    motor, load = changed.axis.encoder_motor, changed.axis.encoder_load
    assert isinstance(motor, Encoder)
    assert isinstance(load, Encoder)
    noisy = replace(changed.axis, encoder_motor=replace(motor, noise=NOISE), encoder_load=replace(load, noise=NOISE))
    return replace(changed, axis=noisy)


def strokes(sample_time: float) -> np.ndarray:
    """Return the set positions (m) of three back-and-forth strokes, each slower than the previous one."""
    moves = [
        SnapLimitedMove(
            distance=distance,
            velocity=velocity,
            acceleration=acceleration,
            jerk=_JERK,
            snap=_SNAP,
            back=True,
            dwell_before=_PAUSE,
            dwell_after=_PAUSE,
        )
        for distance, velocity, acceleration in _STROKES
    ]
    # rounded: the quotient of a whole number of samples may come out just below it
    times = [np.arange(round(move.duration / sample_time)) * sample_time for move in moves]
    return np.concatenate([move.at(time).position for move, time in zip(moves, times, strict=True)])
