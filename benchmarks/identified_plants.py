"""Identify the plants of the benchmark that come from public data again, and compare them with their machine files.

    python benchmarks/identified_plants.py                # ../shared/data
    python benchmarks/identified_plants.py --data DIR     # tokyo_stage_frf/frf.csv below it
    python benchmarks/identified_plants.py --others       # why the lead screw and the motor with cogging are no plants

Exit code 1: a machine file has a number that the data do not give; 2: the data are not there.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from feeddrive.benchmark.rules import folder
from feeddrive.files.frf import read_frfs
from feeddrive.files.machine import read_machine
from feeddrive.files.read_log import read_log
from feeddrive.identification.response.plant_fit import PlantFit, fit_modal_axis
from feeddrive.language import tree

DATA = Path(__file__).parents[2] / "shared" / "data"
STAGE = "tokyo_stage_frf/frf.csv"
BAND = (10.0, 400.0)  # Hz: below, the published response is noise; above, it has resonances of the foundation
DIGITS = 5e-6  # relative: half of the sixth digit of a number that begins with 1
SAMPLE = 0.5e-3  # s of computation, added to the identified dead time
SCREW = "leadscrew_epos/experiments/driveNo1"
FAST = 13e-3  # s: sample time of the fastest runs of the lead screw, at most
RATED = 9.84e-5  # N m in a percent of the rated torque
SPEED, TORQUE = "Velocity actual value averaged", "Torque actual value averaged"
MOTOR = ("odrive_cogging/slow2_nocomp_0.npy", "odrive_cogging/slow2_comp_0.npy")
COUNTS = 8192  # in a turn of this motor
ORDERS = (1, 2, 3, 4, 6, 7, 8, 10, 12, 14, 21, 24, 28, 35, 36, 42, 48, 49, 56, 63, 70, 72, 84)


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


def lag_of_speed(data: Path) -> tuple[float, float]:
    """Return the time constant (s) with which the recorded speed of the lead screw rises to 200 rpm, and the sample
    time.

    From the first two rows after the start: behind a first-order filter the distance to the final speed falls by the
    same factor in every sample.
    """
    log = read_log(data / SCREW / "start_stop" / "200.csv")
    speed = -log[SPEED]
    first = int(np.argmax(speed > 0.0))
    distance = 200.0 - speed[first : first + 2]
    return log.sample_time / float(np.log(distance[0] / distance[1])), log.sample_time


def inertias_of_screw(data: Path) -> dict[str, tuple[float, float]]:
    """Return the inertia (kg m2) and viscous friction (N m s) of the lead screw that each fast run of constant speed
    seems to have.

        torque = J v' + b v + c    in least squares, over the ripple of the speed
    """
    found: dict[str, tuple[float, float]] = {}
    for file in sorted((data / SCREW / "steady_state").rglob("*.csv")):
        log = read_log(file)
        if log.sample_time < FAST:
            speed, torque = -log[SPEED] * 2.0 * np.pi / 60.0, -log[TORQUE] * RATED
            rows = np.column_stack([np.gradient(speed, log.sample_time), speed, np.ones_like(speed)])[1:-1]
            inertia, viscous, _ = np.linalg.lstsq(rows, torque[1:-1], rcond=None)[0]
            found[file.stem] = float(inertia), float(viscous)
    return found


def inertias_of_motor(data: Path, cutoff: float) -> tuple[float, ...]:
    """Return the inertia over the torque constant (A s2/rad) that the slow turns of the motor seem to have, each
    alone and both together.

        current = J/Kt α + cogging(θ) + b ω + c sign ω + d    in least squares, cogging as harmonics

    cutoff  Hz, of the low-pass that all terms pass in both directions
    """
    from scipy.signal import butter, filtfilt

    every: list[tuple[np.ndarray, np.ndarray]] = []
    for name in MOTOR:
        time, counts, current = np.load(data / name)
        T = float(np.median(np.diff(time)))
        even = np.arange(time[0], time[-1], T)
        angle = np.interp(even, time, counts) * 2.0 * np.pi / COUNTS
        b, a = butter(4, 2.0 * cutoff * T)
        speed = np.gradient(angle, T)
        terms = [np.gradient(speed, T), speed, np.sign(filtfilt(b, a, speed)), np.ones_like(angle)]
        terms += [wave(order * angle) for order in ORDERS for wave in (np.cos, np.sin)]
        inside = slice(200, -200)  # without the ends of the filter
        every.append(
            (
                np.column_stack([filtfilt(b, a, term)[inside] for term in terms]),
                filtfilt(b, a, np.interp(even, time, current))[inside],
            )
        )
    both = tuple(np.concatenate(parts) for parts in zip(*every, strict=True))
    return tuple(float(np.linalg.lstsq(rows, values, rcond=None)[0][0]) for rows, values in (*every, both))


def print_others(data: Path) -> None:
    """Print what the logs say of an inertia that no plant can be made of."""
    lag, sample = lag_of_speed(data)
    print(f"lead screw: the recorded speed rises with {1e3 * lag:.0f} ms, at a sample each {1e3 * sample:.0f} ms")
    for name, (inertia, viscous) in inertias_of_screw(data).items():
        print(f"lead screw, {name} rpm: inertia {inertia:.2e} kg m2, viscous friction {viscous:.1e} N m s")
    for cutoff in (10.0, 20.0, 40.0):
        alone, other, both = inertias_of_motor(data, cutoff)
        print(f"motor, below {cutoff:.0f} Hz: J/Kt {alone:.5f}, {other:.5f}, both {both:.5f} A s2/rad")


def main() -> int:
    """Print what differs."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--data", type=Path, default=DATA)
    asked.add_argument("--others", action="store_true", help="what the other logs say of an inertia")
    chosen = asked.parse_args()
    data = chosen.data
    if chosen.others:
        missing = [path for path in (data / SCREW, *(data / name for name in MOTOR)) if not path.exists()]
        if missing:
            print(f"NOT RUN: {missing[0]} is not there; name the folder of the data with --data", file=sys.stderr)
            return 2
        print_others(data)
        return 0
    if not (data / STAGE).is_file():
        print(f"NOT RUN: {data / STAGE} is not there; name the folder of the data with --data", file=sys.stderr)
        return 2
    wrong = [line for number in (1, 2) for line in differences(data, number)]
    print("\n".join(wrong) or "stage_1 and stage_2 have the numbers that the data give")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
