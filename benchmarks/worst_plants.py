"""How often the search for the worst plant of a box falls short, on loops that are drawn at random.

    python benchmarks/worst_plants.py --count 30 --seed 1                # tuned over their boxes, and moved beside them
    python benchmarks/worst_plants.py --kept FILE                        # the same controls again, without a tuning
    python benchmarks/worst_plants.py --count 30 --keep FILE             # writes them

An axis of one to four masses or modes is drawn, with dead time, current loop and a box, and P-PI or another law is
tuned for it over the box by one search, with free filters: then several plants and peaks are equally bad, as where a
search for the worst one is used.  Beside it the gains are moved at random.  For each of these controls Ms at the worst
plant of the search is compared with the largest of 1,500 draws and of the plants around the worst of them, all by the
means of `box.py`.  Loops that are unstable somewhere in the box are left out.
"""

import argparse
import pickle
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from box import Draws, closed_eigenvalues, linear_law, spread

import feeddrive as fd
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Plant
from feeddrive.figures.of_loops import SENSITIVITY_PEAK
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.loop.box import Box
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import candidates
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.filters import with_notch_and_low_pass
from feeddrive.tuning.tune import tune_control
from feeddrive.tuning.worst import box_plants, worst_plants

LAWS = ("P-PI", "P-PI", "P-PI", "pole placement", "LADRC", "LQG", "GPI, 1 Taylor state")
KINDS = ("rigid", "two_mass", "two_mass", "three_mass_chain", "modal", "modal")
BOUND, VELOCITY = 2.0, 0.05
WIDTH = 0.06  # deviation of ln of the gains of a control beside a tuned one
ROOM = 1e-3  # of Ms: what a search may miss; the tuner keeps as much in reserve
GROWS = 1e-5  # of |z|: a pole as near to 1 may be on either side of it, by differences of floats
DRAWS, SEED = 1500, 7
SIZES, AROUND, WORST = (0.3, 0.1, 0.03, 0.01, 0.003), 30, 6  # steps around so many of the worst draws


@dataclass(frozen=True)
class Case:
    """A loop with its box, and whether its control is the tuned one."""

    law: str
    loop: Loop
    box: Box
    tuned: bool


def of_plant(kind: str, random: np.random.Generator) -> Plant:
    """Return a plant: resonances of 15 to 400 Hz, damping ratios of 0.5 to 5 %."""
    mass = 10.0 ** random.uniform(1.0, 3.0)
    given: dict[str, Any]
    viscous = mass * random.uniform(0.5, 10.0)
    if kind == "rigid":
        return fd.blocks.Rigid(mass=mass, viscous=viscous)
    rates = 2.0 * np.pi * np.exp(random.uniform(np.log(15.0), np.log(400.0), 3))
    ratios = 10.0 ** random.uniform(-2.3, -1.3, 3)
    if kind == "modal":
        modes = [
            fd.blocks.Mode(
                frequency=rate / (2.0 * np.pi),
                damping_ratio=ratio,
                mass=mass * 10.0 ** random.uniform(-0.3, 1.2),
                motor=1.0,
                load=random.choice((1.0, -0.6, 0.5)),
            )
            for rate, ratio in zip(rates[: random.integers(1, 3)], ratios, strict=False)
        ]
        return fd.blocks.Modal(mass=mass, viscous=viscous, modes=tuple(modes))
    shares = random.dirichlet(np.full(3 if kind == "three_mass_chain" else 2, 3.0)) * mass
    given = {"mass_motor": shares[0], "mass_load": shares[-1], "viscous_motor": viscous, "viscous_load": 0.1 * viscous}
    # a spring between two masses: of the resonance of both alone
    reduced = [shares[i] * shares[i + 1] / (shares[i] + shares[i + 1]) for i in range(len(shares) - 1)]
    springs = [m * rate**2 for m, rate in zip(reduced, rates, strict=False)]
    dampers = [2.0 * ratio * m * rate for m, rate, ratio in zip(reduced, rates, ratios, strict=False)]
    given |= {"stiffness": springs[-1], "damping": dampers[-1]}
    if kind == "three_mass_chain":
        coupling = {"mass_screw": shares[1], "coupling_stiffness": springs[0], "coupling_damping": dampers[0]}
        return fd.blocks.ThreeMassChain(**given, **coupling)
    return fd.blocks.TwoMass(**given)


def drawn_loop(random: np.random.Generator) -> tuple[str, Loop, Box]:
    """Return the name of a law, a loop with it, and a box."""
    base = fd.read_machine("machining_center").loop("x")
    T = float(random.choice((1e-4, 2e-4, 5e-4, 1e-3)))
    actuator = replace(
        base.axis.actuator,
        dead_time=T * random.uniform(0.2, 3.0),
        current_loop=None if random.random() < 0.3 else 10.0 ** random.uniform(2.5, 3.3),
    )
    plant = of_plant(str(random.choice(KINDS)), random)
    both = random.random() < 0.6
    axis = replace(
        base.axis,
        plant=plant,
        friction_load=None,
        actuator=actuator,
        encoder_motor=base.axis.encoder_motor if both else None,
    )
    box = Box(random.uniform(0.05, 0.3), random.uniform(0.05, 0.3), int(random.integers(0, 3)))
    sizes = spread(replace(base, axis=axis))
    mass = sizes.masses[0] if plant.kind == "modal" else sum(sizes.masses)
    law = CascadePPI(Kv=20.0, Kp=60.0 * mass, Tn=0.03)
    loop = replace(base, axis=axis, control=Control(law=law), sample_time=T)
    name = str(random.choice(LAWS))
    offered = {candidate.name: candidate.loop for candidate in candidates(loop)[0]}
    name = name if name in offered else "P-PI"
    return name, with_notch_and_low_pass(offered[name]), box


def tuned_cases(count: int, seed: int, beside: int) -> Iterator[Case]:
    """Yield drawn loops under a control that is tuned over their box, and under others beside it."""
    for i in range(count):
        random = np.random.default_rng((seed, i))
        try:
            name, loop, box = drawn_loop(random)
            found = tune_control(loop, limits=Limits(sensitivity_peak=BOUND), box=box, starts=1, velocity=VELOCITY)
        except (FeeddriveError, ArithmeticError) as error:
            print(f"case {i}: {str(error)[:140]}", file=sys.stderr, flush=True)
            continue
        yield Case(name, replace(loop, control=found.control), box, tuned=found.holds is not False)
        gains = {path: value for path, value in tree.leaves(found.control) if path.startswith(("law.", "filters."))}
        for _ in range(beside):
            moved = {path: x * float(np.exp(WIDTH * random.standard_normal())) for path, x in gains.items() if x}
            try:
                yield Case(name, replace(loop, control=tree.vary(found.control, moved)), box, tuned=False)
            except FeeddriveError:
                continue


def searched(case: Case) -> float:
    """Return Ms at the worst plant by the search of the tuner; infinite if the loop is unstable there."""
    limits = Limits(sensitivity_peak=BOUND)
    plants = box_plants(case.box, case.loop, "model", VELOCITY)
    found = worst_plants(case.loop.control, [plants], limits)[1]
    return BOUND * max(plant.of(SENSITIVITY_PEAK.key) for plant in found)


def true_peak(case: Case) -> tuple[float, np.ndarray]:
    """Return the largest Ms of the draws and of plants around the worst of them, and its place with the dead time."""
    T = float(case.loop.sample_time)
    law = linear_law(case.loop.control, T, VELOCITY)
    random = np.random.default_rng(SEED)

    def of(place: np.ndarray, late: np.ndarray) -> np.ndarray:
        draws = Draws(case.loop, case.box, at=(place, late))
        stable = closed_eigenvalues(draws.plants, law) < 1.0 + GROWS
        return np.where(stable, draws.peaks(law), np.inf)

    first = Draws(case.loop, case.box, DRAWS, SEED)
    place, late = first.place, first.late
    peaks = of(place, late)
    for size in SIZES:
        if not np.isfinite(np.max(peaks)):
            break
        order, best = np.argsort(-peaks), list[int]()
        for i in order:
            if len(best) == WORST:
                break
            if not any(late[i] == late[j] and np.max(np.abs(place[i] - place[j])) < size for j in best):
                best.append(int(i))
        steps = random.standard_normal((len(best), AROUND, place.shape[1])) * size
        steps *= random.random(steps.shape) < 0.7
        there = np.clip(place[best][:, None] + steps, -1.0, 1.0).reshape(-1, place.shape[1])
        lates = np.repeat(late[best], AROUND)
        place, late, peaks = (
            np.concatenate(pair) for pair in ((place, there), (late, lates), (peaks, of(there, lates)))
        )
    at = int(np.argmax(peaks))
    return float(peaks[at]), np.array([*place[at], late[at]])


def main() -> None:
    """Print how much the search misses, and the cases in which it misses more than `ROOM`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--beside", type=int, default=3, help="controls beside each tuned one")
    parser.add_argument("--keep", type=Path, help="file for the controls")
    parser.add_argument("--kept", type=Path, help="controls that were kept")
    asked = parser.parse_args()
    cases = pickle.loads(asked.kept.read_bytes()) if asked.kept else tuned_cases(asked.count, asked.seed, asked.beside)
    kept, rows, seconds = list[Case](), list[tuple[bool, float, float]](), 0.0
    for case in cases:
        begun = time.process_time()
        found = searched(case)
        seconds += time.process_time() - begun
        try:
            true, place = true_peak(case)
        except AssertionError:  # of `box.py`, which compares its sums over modes with solved systems
            print(f"{case.law}, {case.loop.axis.plant.kind}: left out, two of its poles are nearly equal", flush=True)
            continue
        kept.append(case)
        if not np.isfinite(found):
            continue
        rows.append((case.tuned, found, true))
        if found < true * (1.0 - ROOM):
            where = " ".join(f"{u:.2f}" for u in place[:-1])
            print(f"{case.law}, {case.loop.axis.plant.kind}, {case.box}{', tuned' if case.tuned else ''}: "
                  f"{found:.4f} found, {true:.4f} at {where}, {place[-1]:.0f} later", flush=True)  # fmt: skip
    if asked.keep:
        asked.keep.write_bytes(pickle.dumps(kept))
    for tuned, name in ((True, "tuned"), (False, "moved")):
        some = np.array([(found, true) for of, found, true in rows if of is tuned]).reshape(-1, 2)
        short = 1.0 - some[:, 0] / some[:, 1]
        line = ", ".join(f"{np.count_nonzero(short > room)} by more than {room:.1%}" for room in (ROOM, 0.01, 0.05))
        print(f"{len(some)} {name}: {line}; most {max(short, default=0.0):.2%}")
    print(f"{seconds:.1f} s of processor time for {len(kept)} searches with the models of their plants")


if __name__ == "__main__":
    main()
