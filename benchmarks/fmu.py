"""What an FMU costs: its size, how long it takes to make, a sample inside it, a call from FMPy, a sample of a loop.

    python benchmarks/fmu.py

Controller and plant of the bundled ball screw; medians over rounds, CPU time of the thread.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from functools import partial
from pathlib import Path

import fmpy
import fmpy.fmi2
from rounds import machine, measure, table

from feeddrive import read_machine, simulate
from feeddrive.blocks import SnapLimitedMove
from feeddrive.cosimulation import simulate_with_fmu
from feeddrive.export.fmu import fmu
from feeddrive.export.layout import layout
from feeddrive.loop.routine import controller_routine, plant_routine

ROUNDS, SAMPLES, CALLS = 9, 20_000, 2_000
MOVE = SnapLimitedMove(distance=0.05, velocity=0.2, acceleration=4.0, jerk=200.0, snap=4e4)


def started(path: Path, folder: Path) -> fmpy.fmi2.FMU2Slave:
    description = fmpy.read_model_description(str(path))
    fmpy.extract(str(path), str(folder))
    one = fmpy.fmi2.FMU2Slave(
        guid=description.guid, modelIdentifier=description.coSimulation.modelIdentifier, unzipDirectory=str(folder)
    )
    one.instantiate()
    one.setupExperiment(startTime=0.0)
    one.enterInitializationMode()
    one.exitInitializationMode()
    return one


def main() -> None:
    loop = read_machine("ball_screw").loop(None)
    T = float(loop.sample_time)
    routines = {"controller": controller_routine(loop, "axis_x"), "plant": plant_routine(loop, "plant_x")}
    print(f"{machine()}; FMPy {fmpy.__version__}\n")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, routine in routines.items():
            laid = layout(routine)
            packed = {v: fmu(laid, v, title=name, made_by="benchmarks/fmu.py") for v in (2, 3)}
            path = Path(folder) / f"{name}.fmu"
            path.write_bytes(packed[2])
            one = started(path, Path(folder) / name)
            times = {"long": 0.0}

            def long(one: fmpy.fmi2.FMU2Slave = one, times: dict[str, float] = times) -> None:
                one.doStep(times["long"], SAMPLES * T)
                times["long"] += SAMPLES * T

            def calls(one: fmpy.fmi2.FMU2Slave = one, times: dict[str, float] = times) -> None:
                for _ in range(CALLS):
                    one.doStep(times["long"], T)
                    times["long"] += T

            taken = measure({"long": long, "calls": calls}, ROUNDS)
            inside = 1e9 * statistics.median(taken["long"]) / SAMPLES
            called = 1e6 * statistics.median(taken["calls"]) / CALLS
            sizes = [f"{len(packed[version]) / 1000:.0f}" for version in (2, 3)]
            rows.append([name, *sizes, f"{inside:.0f}", f"{called:.1f}"])
        table(["FMU", "FMI 2, kB", "FMI 3, kB", "ns a sample inside", "us a step called by FMPy"], rows)

        made = {
            f"make the {name}": partial(fmu, layout(routine), 2, title="a", made_by="b")
            for name, routine in routines.items()
        }
        path = Path(folder) / "plant.fmu"
        runs = {"loop with an FMU": lambda: simulate_with_fmu(loop, path, MOVE), "loop": lambda: simulate(loop, MOVE)}
        count = simulate(loop, MOVE).time.size
        wall = measure(made, 5, time.perf_counter_ns)
        taken = measure(runs, ROUNDS)
        table(["", "s"], [[name, f"{statistics.median(each):.2f}"] for name, each in wall.items()])
        table(
            [f"a move of {count} samples", "us a sample"],
            [[name, f"{1e6 * statistics.median(each) / count:.2f}"] for name, each in taken.items()],
        )


if __name__ == "__main__":
    main()
