"""Measures what single precision costs a control, law by law, and prints the table of docs/how_to/cortex_m.md.

    python docs/measure_single.py

Both precisions are the exported C, compiled by gcc for this machine; a Cortex-M4F has the same bits.  The axis is
exported C, too, in double precision.
"""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import feeddrive as fd
from exported import LOOPS
from feeddrive.export.c_bundle import FLAGS, streamed
from feeddrive.export.c_code import texts
from feeddrive.export.design import trial
from feeddrive.export.layout import layout
from feeddrive.files.machine import read_machine
from feeddrive.loop.routine import Routine, controller_routine, plant_routine

MOVE = fd.blocks.SnapLimitedMove(distance=0.02, velocity=0.2, acceleration=3.0, jerk=200.0, snap=2e4, dwell_after=0.05)
PUSH, PUSHED_FROM = -100.0, 0.05  # N, s
FAR = 0.5  # m, from the origin of the encoders

CLOSED = """\
#include "axis_x.h"
#include "plant_x.h"
#include <stdio.h>
int main(void)
{{
    static axis_x_controller controller;
    static plant_x_plant plant;
    axis_x_parameters gains;
    plant_x_parameters masses;
    axis_x_inputs in;
    axis_x_outputs out;
    plant_x_inputs pushed = {{0.0, 0.0, {far}}};
    plant_x_outputs seen;
    double row[6], found[2];
    int begun = 0;
    const uint64_t mode = axis_x_flush_begin();
    axis_x_defaults(&gains);
    axis_x_configure(&controller, &gains);
    plant_x_defaults(&masses);
    plant_x_configure(&plant, &masses);
    plant_x_reset(&plant, &pushed, &seen);
    while (fread(row, sizeof row, 1, stdin) == 1) {{
        in.set_position = ({real})row[0], in.set_velocity = ({real})row[1], in.set_acceleration = ({real})row[2];
        in.set_jerk = ({real})row[3], in.set_snap = ({real})row[4], in.enable = 1;
{readings}
        if (!begun) {{
            axis_x_reset(&controller, &in);
            begun = 1;
        }}
        axis_x_step(&controller, &in, &out);
        found[0] = (double)out.force;
        found[1] = seen.position_load;
        pushed.force = found[0], pushed.load_force = row[5];
        fwrite(found, sizeof found, 1, stdout);
        plant_x_step(&plant, &pushed, &seen);
    }}
    axis_x_flush_end(mode);
    return 0;
}}
"""


def files(routine: Routine, precision: str) -> dict[str, str]:
    """The C of a routine."""
    P, found = routine.name, texts(layout(routine, precision), "a routine", "made to be measured")
    return {f"{P}.h": found.header, f"{P}.c": found.source, f"{P}_configure.c": found.configure}


def closed(loop: fd.Loop, precision: str, far: float) -> np.ndarray:
    """Force in N and position of the table in m, with the axis `far` from the origin of its encoders."""
    control, axis = controller_routine(loop, "axis_x"), plant_routine(loop, "plant_x")
    real = precision
    names = [v.name for v in control.inputs if v.name.startswith("reading")]
    readings = "\n".join(
        f"        in.{name} = ({real})seen.{'reading_load' if name == 'reading' else name};" for name in names
    )
    count = round(MOVE.duration / loop.sample_time)
    t = np.arange(count) * loop.sample_time
    set_ = MOVE.at(t)
    rows = [np.broadcast_to(getattr(set_, name), count) for name in set_._fields]
    rows[0] = rows[0] + far
    given = np.column_stack([*rows, np.where(t >= PUSHED_FROM, PUSH, 0.0)]).astype(np.float64)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = {**files(control, precision), **files(axis, "double")}
        for file, text in {**made, "main.c": CLOSED.format(real=real, readings=readings, far=far)}.items():
            (folder / file).write_text(text)
        sources = ["main.c", *(file for file in made if file.endswith(".c"))]
        subprocess.run(["gcc", *FLAGS, "-o", "closed", *sources, "-lm"], cwd=folder, check=True)
        done = subprocess.run([folder / "closed"], input=given.tobytes(), capture_output=True, check=True)
    return np.frombuffer(done.stdout).reshape(-1, 2)


def random_error(loop: fd.Loop) -> tuple[float, float]:
    """Largest error of the force in N on samples in which both precisions run, and as a share of its range."""
    routine = controller_routine(loop, "axis_x")
    tried = trial(routine, 100_000, seed=7, changes=0, broken=0.0)
    names = [v.name for v in routine.outputs]
    columns = [names.index("force"), names.index("enabled")]
    single, double = (
        streamed(layout(routine, precision), files(routine, precision), tried).outputs[:, columns]
        for precision in ("float", "double")
    )
    both = (single[:, 1] == 1.0) & (double[:, 1] == 1.0)
    worst = float(np.max(np.abs(single[both, 0] - double[both, 0])))
    return worst, worst / float(np.ptp(double[both, 0]))


def main() -> None:
    """Each law in its closed loop, near the origin of the encoders and far from it, and on random samples."""
    machine = next(iter(read_machine("ball_screw").loops.values()))
    print("| control | force, N | share | table, nm | far: force, N | share | table, nm | random: force, N | share |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, given in {"ball_screw (bundled)": machine, **LOOPS}.items():
        loop = dataclasses.replace(given, control=dataclasses.replace(given.control, guard=fd.Guard()))
        cells = []
        for far in (0.0, FAR):
            single, double = closed(loop, "float", far), closed(loop, "double", far)
            worst = np.max(np.abs(single - double), axis=0)
            cells += [f"{worst[0]:.2g}", f"{worst[0] / np.ptp(double[:, 0]):.1e}", f"{1e9 * worst[1]:.2g}"]
        worst, share = random_error(loop)
        print(f"| {name} | {' | '.join(cells)} | {worst:.2g} | {share:.1e} |")


if __name__ == "__main__":
    main()
