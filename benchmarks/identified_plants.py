"""Identify the plants of the benchmark that come from public data again, and compare them with their machine files.

    python benchmarks/identified_plants.py                # ../shared/data
    python benchmarks/identified_plants.py --data DIR     # tokyo_stage_frf/frf.csv below it

Exit code 1: a machine file has a number that the data do not give; 2: the data are not there.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from feeddrive.benchmark.rules import folder
from feeddrive.files.frf import read_frfs
from feeddrive.files.machine import read_machine
from feeddrive.identification.response.plant_fit import PlantFit, fit_modal_axis
from feeddrive.language import tree

DATA = Path(__file__).parents[2] / "shared" / "data"
STAGE = "tokyo_stage_frf/frf.csv"
BAND = (10.0, 400.0)  # Hz: below, the published response is noise; above, it has resonances of the foundation
DIGITS = 5e-6  # relative: half of the sixth digit of a number that begins with 1
SAMPLE = 0.5e-3  # s of computation, added to the identified dead time


def identified(data: Path, number: int) -> PlantFit:
    """Return the fit of the stage at one of its encoders, from the velocity over the command."""
    response = read_frfs(data / STAGE)[f"Pv{number}"]
    return fit_modal_axis(load=replace(response, unit="(m/s)/N"), band=BAND)


def differences(data: Path, number: int) -> list[str]:
    """Return the numbers of the machine file that differ from the identified ones, in words."""
    fit = identified(data, number)
    axis = read_machine(folder(2) / "machines" / f"stage_{number}.toml").loop("x").axis
    plant, actuator = fit.blocks()
    found = {**dict(tree.leaves(plant)), "dead_time": float(actuator.dead_time) + SAMPLE}
    stated = {**dict(tree.leaves(axis.plant)), "dead_time": float(axis.actuator.dead_time)}
    if found.keys() != stated.keys():
        return [f"stage_{number}: the file has {', '.join(stated)}, the data give {', '.join(found)}"]
    # the file has the dead time in ms with six decimals, and the sample in it is no identified number
    room = {"dead_time": 1e-9}
    return [
        f"stage_{number}: {name} is {stated[name]:.9g} in the file and {value:.9g} by the data"
        for name, value in found.items()
        if abs(stated[name] - value) > room.get(name, DIGITS * abs(value))
    ]


def main() -> int:
    """Print what differs."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--data", type=Path, default=DATA)
    data = asked.parse_args().data
    if not (data / STAGE).is_file():
        print(f"NOT RUN: {data / STAGE} is not there; name the folder of the data with --data", file=sys.stderr)
        return 2
    wrong = [line for number in (1, 2) for line in differences(data, number)]
    print("\n".join(wrong) or "stage_1 and stage_2 have the numbers that the data give")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
