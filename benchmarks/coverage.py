"""Coverage of the 95 % intervals of the identification, on logs of a simulator that shares no code with feeddrive.

    python benchmarks/coverage.py [--draws 400] [--seed 1] [--cells stops,counts_5um]

Prints the table of docs/identification.md. Each cell draws axes of 20 to 300 kg with their friction, gains, dead time
and noise (`tests/foreign_axis.py`), identifies each log as `feeddrive identify` does from position and force, and
counts how often the 95 % interval holds the truth. A log that is refused, or whose values are not recommended, is
counted in its own column. 400 draws of all cells take some 10 minutes on one core.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import foreign_axis as fa
from feeddrive.identification.excitation.estimate_frf import estimate_frf
from feeddrive.identification.excitation.frequency_estimate import Record
from feeddrive.identification.motion.identify import POOR
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.rigid import RigidFit, find_delay, identify_rigid
from feeddrive.identification.response.plant_fit import fit_two_mass
from feeddrive.language.errors import FeeddriveError

T = 1e-3
NORMAL = 1.959964
PERIOD, PERIODS = 1000, 10  # samples of a multisine, and how many of it


@dataclass(frozen=True)
class Cell:
    """One kind of log: what its axes have beside the usual, the kind of law, the dwell of its moves (s)."""

    name: str
    over: Callable[[np.random.Generator, int], dict[str, Any]]
    dwell: float = 0.3
    integral: bool = True
    pulses: bool = False


def plain(*_: Any) -> dict[str, Any]:
    """Return nothing beside the usual."""
    return {}


CELLS = (
    Cell("stops", plain, dwell=0.6),
    Cell("counts 5 um", lambda *_: {"resolution": 5e-6}),
    Cell("counts 20 um", lambda *_: {"resolution": 20e-6}),
    Cell("P-PI, no stops", plain, dwell=0.0),
    Cell("disturbance", lambda rng, n: {"drive": rng.uniform(0.02, 0.06, n), "colour": rng.uniform(0.8, 0.98, n)}),
    Cell("asymmetric friction", lambda rng, n: {"skew": rng.uniform(0.1, 0.3, n) * rng.choice((-1, 1), n)}),
    Cell(
        "Stribeck, creep",
        lambda rng, n: {
            "stribeck": rng.uniform(0.1, 0.5, n),
            "stribeck_velocity": rng.uniform(1e-3, 8e-3, n),
            "creep": rng.uniform(2e-6, 15e-6, n),
        },
    ),
)


def logs_of(cell: Cell, rng: np.random.Generator, n: int) -> fa.Logs:
    """Simulate n axes of a cell."""
    over = cell.over(rng, n)
    mass = np.exp(rng.uniform(np.log(20), np.log(300), n))
    unit = 2.0 * mass
    level, skew = unit * rng.uniform(0.1, 0.5, n), over.pop("skew", 0.0)
    axes = fa.Axes(
        mass=mass,
        viscous=mass * np.exp(rng.uniform(np.log(0.5), np.log(5), n)),
        coulomb_positive=level * (1 + skew),
        coulomb_negative=level * (1 - skew),
        stribeck=level * over.pop("stribeck", 0.0),
        dead_time=T * rng.uniform(0.0, 2.0, n),
        offset=level * rng.uniform(-0.1, 0.1, n),
        noise_log=unit * rng.uniform(0.005, 0.03, n),
        noise_drive=unit * over.pop("drive", 0.005),
        resolution=over.pop("resolution", 1e-6),
        colour=over.pop("colour", 0.0),
        limit=unit * 8,
        **over,
    )
    wc = np.minimum(rng.uniform(0.12, 0.28, n) / (axes.dead_time + 1.5 * T), 200.0)
    law = fa.Cascade(
        Kv=wc * rng.uniform(0.15, 0.3, n),
        Kp=mass * wc,
        rate=wc * rng.uniform(0.1, 0.25, n) * cell.integral,
        ff=rng.choice((0.0, 0.7, 1.0), n),
        n=int(rng.choice((1, 2))),
        windup="back",
    )
    moves = []
    for _ in range(n):
        speed, acc = np.exp(rng.uniform(np.log(0.08), np.log(0.35))), np.exp(rng.uniform(np.log(1.0), np.log(4.0)))
        travel = rng.uniform(0.06, 0.25)
        way = travel / speed + speed / acc + cell.dwell
        ends = [travel * rng.uniform(0.7, 1.0) * (i % 2 == 0) for i in range(max(4, round(8.0 / way)))]
        moves.append(fa.smooth_moves(T, ends, speed, acc, acc / rng.uniform(0.015, 0.05), cell.dwell, 0.3))
    rows = min(max(len(m) for m in moves), 9000)
    xs = np.stack([np.pad(m, (0, max(0, rows - len(m))), mode="edge")[:rows] for m in moves])
    push = np.stack([fa.pulses(rows, T, rng, 6, u, 0.05) for u in unit]) if cell.pulses else None
    return fa.simulate(axes, law, xs, T, rng, count=n, disturbance=push, substeps=4)


def excited(cell: Cell, rng: np.random.Generator, n: int) -> tuple[fa.Logs, np.ndarray]:
    """Simulate n axes of two masses with a multisine of 5 to 200 Hz on a slow motion to and fro; excitation too."""
    over = cell.over(rng, n)
    mass, share = np.exp(rng.uniform(np.log(20), np.log(300), n)), rng.uniform(0.3, 0.65, n)
    unit, wr = 2.0 * mass, 2.0 * np.pi * rng.uniform(30.0, 90.0, n)
    level, skew = unit * rng.uniform(0.05, 0.2, n), over.pop("skew", 0.0)
    m1, m2 = mass * (1.0 - share), mass * share
    reduced = m1 * m2 / mass
    axes = fa.Axes(
        mass=m1,
        mass_load=m2,
        stiffness=wr**2 * reduced,
        damping=2.0 * rng.uniform(0.01, 0.05, n) * wr * reduced,
        viscous=mass * rng.uniform(0.5, 3.0, n),
        coulomb_positive=level * (1 + skew),
        coulomb_negative=level * (1 - skew),
        stribeck=level * over.pop("stribeck", 0.0),
        share_load=0.5,
        dead_time=T * rng.uniform(0.0, 1.5, n),
        noise_log=unit * 0.005,
        noise_drive=unit * over.pop("drive", 0.005),
        resolution=over.pop("resolution", 1e-6),
        colour=over.pop("colour", 0.0),
        limit=unit * 8,
        **over,
    )
    wc = np.minimum(0.2 / (axes.dead_time + 1.5 * T), 0.3 * wr)
    law = fa.Cascade(Kv=0.15 * wc, Kp=mass * wc, rate=0.1 * wc * cell.integral, ff=1.0, n=1)
    rows = PERIODS * PERIOD
    ramp = fa.smooth_moves(T, [0.15 * (i % 2 == 0) for i in range(8)], 0.05, 0.5, 10.0, cell.dwell, 0.0)
    tones = np.stack([fa.multisine(T, rng, 5.0, 200.0, PERIOD * T, PERIODS) for _ in range(n)])
    force = tones * (unit * rng.uniform(0.4, 1.0, n))[:, None]
    return fa.simulate(axes, law, np.resize(ramp, rows), T, rng, count=n, added=force, substeps=4), force


def one_resonance(cell: Cell, draws: int, seed: int) -> dict[str, Any]:
    """Coverage of resonance and antiresonance by a frequency response of the motor and a fit of two masses."""
    rng = np.random.default_rng([seed, 50 + CELLS.index(cell)])
    misses: dict[str, list[float]] = {"resonance": [], "antiresonance": []}
    refused: list[str] = []
    for begin in range(0, draws, 100):
        n = min(100, draws - begin)
        logs, force = excited(cell, rng, n)
        for i in range(n):
            log = logs.log(i)
            try:
                record = Record(
                    input=log["force"], output=log["position"], sample_time=T, references=(force[i],), unit="m/N"
                )
                frf = estimate_frf(record, period=PERIOD, band=(5.0, 200.0)).frf
                fit = fit_two_mass(frf)
                for name, z in misses.items():
                    z.append((fit[name].value - logs.true(name, i)) / fit[name].error)
            except FeeddriveError as error:
                refused.append(str(error)[:160])
    return {"misses": misses, "refused": refused}


def motion(logs: fa.Logs, i: int, setpoint: bool = True) -> MotionLog:
    log = logs.log(i)
    return MotionLog(
        name=f"log {i}",
        position=log["position"],
        force=log["force"],
        set_position=log["setpoint"] if setpoint else None,
        sample_time=logs.T,
    )


def identify(log: MotionLog) -> RigidFit:
    """Identify as `identify_motion` does while no law is known: the search of the delay first."""
    delay = find_delay(log)
    return identify_rigid(log, dead_time=delay.dead_time)


def estimates(rigid: RigidFit) -> dict[str, tuple[float, float]]:
    """Value and standard error of mass, viscous, Coulomb, offset and dead time (samples)."""
    names = [estimate.name for estimate in rigid.estimates]
    values = np.array([estimate.value for estimate in rigid.estimates])
    way = {"mass": {"mass": 1.0}}
    if "coulomb" in names:
        way |= {name: {name: 1.0} for name in ("viscous", "coulomb", "offset")}
    else:
        way["viscous"] = {"viscous_positive": 0.5, "viscous_negative": 0.5}
        way["coulomb"] = {"coulomb_positive": 0.5, "coulomb_negative": 0.5}
        way["offset"] = {"coulomb_positive": 0.5, "coulomb_negative": -0.5}
        if "offset" in names:
            way["offset"]["offset"] = 1.0
    said = {}
    for name, shares in way.items():
        w = np.array([shares.get(n, 0.0) for n in names])
        said[name] = (float(w @ values), float(np.sqrt(max(w @ rigid.covariance @ w, 0.0))))
    said["dead time"] = (rigid.dead_time.value, rigid.dead_time.error)
    return said


TRUTH = {
    "mass": "mass",
    "viscous": "viscous",
    "coulomb": "coulomb",
    "offset": "offset_of_levels",
    "dead time": "dead_time_samples",
}


def one_cell(cell: Cell, draws: int, seed: int, setpoint: bool) -> dict[str, Any]:
    """Coverage, bias and scatter of (value - truth) / error, median of |value / truth - 1|, refusals."""
    rng = np.random.default_rng([seed, CELLS.index(cell) if cell in CELLS else 99])
    misses: dict[str, list[float]] = {name: [] for name in TRUTH}
    away: dict[str, list[float]] = {name: [] for name in TRUTH}
    refused: list[str] = []
    doubted, unstable = 0, 0
    for begin in range(0, draws, 100):
        logs = logs_of(cell, rng, min(100, draws - begin))
        for i in range(len(logs)):
            if not logs.stable[i]:
                unstable += 1
                continue
            try:
                found = identify(motion(logs, i, setpoint))
            except FeeddriveError as error:
                refused.append(str(error)[:160])
                continue
            if found.left > POOR or found.changed:
                doubted += 1
            for name, (value, error) in estimates(found).items():
                truth = logs.true(TRUTH[name], i)
                misses[name].append((value - truth) / max(error, 1e-300))
                away[name].append(abs(value - truth) / (abs(truth) if name != "dead time" else 1.0))
    return {"misses": misses, "away": away, "refused": refused, "doubted": doubted, "unstable": unstable}


def main() -> None:
    ask = argparse.ArgumentParser()
    ask.add_argument("--draws", type=int, default=400)
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--cells", default="")
    ask.add_argument("--without", action="store_true", help="without the set position")
    ask.add_argument("--two-masses", action="store_true", help="resonance and antiresonance by a frequency response")
    ask.add_argument("--detail", action="store_true")
    said = ask.parse_args()
    begin = time.process_time()
    if said.two_masses:
        print("| log | resonance | antiresonance | refused |")
        print("|---|---|---|---|")
        for cell in CELLS:
            if said.cells and not any(part in cell.name for part in said.cells.split(",")):
                continue
            got = one_resonance(cell, said.draws, said.seed)
            row = [f"{np.mean(np.abs(z) < NORMAL):.3f}" if z else "-" for z in got["misses"].values()]
            print(f"| {cell.name} | {' | '.join(row)} | {len(got['refused'])} |", flush=True)
            if said.detail:
                for name, z in got["misses"].items():
                    print(f"    {name}: z mean {np.mean(z):+.2f} std {np.std(z):.2f}")
                for why in sorted(set(got["refused"]))[:4]:
                    print("    refused:", why)
        print(f"\n{said.draws} draws a cell, seed {said.seed}, {time.process_time() - begin:.0f} s of CPU time")
        return
    print("| log | " + " | ".join(TRUTH) + " | refused | not recommended |")
    print("|---|" + "---|" * (len(TRUTH) + 2))
    for cell in CELLS:
        if said.cells and not any(part in cell.name for part in said.cells.split(",")):
            continue
        got = one_cell(cell, said.draws, said.seed, not said.without)
        whole = said.draws - got["unstable"]
        row = [f"{np.mean(np.abs(z) < NORMAL):.3f}" if z else "-" for z in got["misses"].values()]
        print(f"| {cell.name} | {' | '.join(row)} | {len(got['refused'])} | {got['doubted']} |", flush=True)
        if said.detail:
            for name, z in got["misses"].items():
                zz = np.array(z)
                print(
                    f"    {name}: z mean {zz.mean():+.2f} std {zz.std():.2f} median |z| {np.median(np.abs(zz)):.2f} "
                    f"(0.67)  median error {np.median(got['away'][name]):.2g}  of {whole}"
                )
            for why in sorted(set(got["refused"]))[:4]:
                print("    refused:", why)
    print(f"\n{said.draws} draws a cell, seed {said.seed}, {time.process_time() - begin:.0f} s of CPU time")


if __name__ == "__main__":
    main()
