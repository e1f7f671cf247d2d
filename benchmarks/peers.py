"""The job of `peer_job.py` in the tools that a Python user would pick, side by side.

    python benchmarks/peers.py [--rounds 3]

Every peer gets the sampled inputs ready made; its model is built before the clock starts.  CPU time of the process.
What is not installed is said so.  `apart` is the RMS distance of the table's position from the plain Python loop.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import peer_job as job
import peer_tools
import rounds

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Friction
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.language import tree
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.runner import Prepared, Work
from feeddrive.loop.simulate import simulate, simulate_batch

RECORD = ("position_load", "velocity_load", "force")
LOAD = StepForce(force=500.0, start=1.3, end=1.7)
BASE = "python-control, interconnect"
VARIANTS = 512


def loop(motor: Friction, load: Friction, substeps: int = 1) -> Loop:
    """The job in feeddrive: exact hold and implicit friction in place of Runge-Kutta, back-calculation at the limit."""
    return Loop(
        sample_time=job.T,
        control=Control(
            law=CascadePPI(Kv=job.KV, Kp=job.KP, Tn=job.TN),
            feedforward=(Inertia(mass=job.MASS_MOTOR + job.MASS_LOAD, viscous=job.VISCOUS_MOTOR + job.VISCOUS_LOAD),),
            force_limit=job.FORCE_LIMIT,
        ),
        axis=Axis(
            plant=TwoMass(
                mass_motor=job.MASS_MOTOR, mass_load=job.MASS_LOAD, stiffness=job.STIFFNESS, damping=job.DAMPING
            ),
            friction_motor=motor,
            friction_load=load,
            actuator=Actuator(dead_time=job.T),
            encoder_motor=Encoder(resolution=job.COUNT_MOTOR),
            encoder_load=Encoder(resolution=job.COUNT_LOAD),
            substeps=substeps,
        ),
    )


def sharp(substeps: int = 1) -> Loop:
    """With true standstill, as feeddrive models an axis."""
    return loop(
        Coulomb(coulomb=job.COULOMB_MOTOR, viscous=job.VISCOUS_MOTOR),
        Coulomb(coulomb=job.COULOMB_LOAD, viscous=job.VISCOUS_LOAD),
        substeps,
    )


def smooth(substeps: int = 1) -> Loop:
    """With the tanh of the peers."""
    width = job.TANH_VELOCITY
    return loop(
        Regularised(coulomb=job.COULOMB_MOTOR, transition_velocity=width, viscous=job.VISCOUS_MOTOR),
        Regularised(coulomb=job.COULOMB_LOAD, transition_velocity=width, viscous=job.VISCOUS_LOAD),
        substeps,
    )


def native(loop: Loop) -> Callable[[], np.ndarray]:
    """The time loop alone, on inputs that are sampled already as those of the peers are."""
    work = Work(loop, job.reference(), LOAD)
    prepared = Prepared(loop, work.first())
    made = prepared.native(prepared.program(load=True, enable=False), record=RECORD)
    inputs, constants = work.inputs(made, 0, job.SAMPLES), prepared.constants(made)
    outputs = np.empty((job.SAMPLES, len(RECORD)))

    def call() -> np.ndarray:
        made.run(job.SAMPLES, 0, constants, inputs, prepared.states(made), outputs, prepared.rows(made))
        return outputs[:, 0]

    return call


def batch() -> Callable[[], None]:
    """Many variants of the gains at once; the time of one of them counts."""
    draw = np.random.default_rng(0)
    names = ("axis.x.control.law.Kv", "axis.x.control.law.Kp", "axis.x.control.law.Tn")
    variants = tree.vary(sharp(), {n: tree.get(sharp(), n) * draw.uniform(0.9, 1.1, VARIANTS) for n in names})
    return lambda: simulate_batch(variants, job.reference(), load=LOAD, gather=("tracking_error", "force"))


def ours() -> dict[str, tuple[Callable[[], object], int]]:
    """Name -> call, and how many runs it does."""
    ready, work = sharp(), job.reference()
    return {
        "feeddrive, standstill, time loop": (native(ready), 1),
        "feeddrive, standstill, 10 substeps, time loop": (native(sharp(10)), 1),
        "feeddrive, standstill, all of simulate()": (
            lambda: simulate(ready, work, load=LOAD, record=RECORD)["position_load"],
            1,
        ),
        f"feeddrive, standstill, simulate_batch() of {VARIANTS}, one of them": (batch(), VARIANTS),
        "feeddrive, tanh, time loop": (native(smooth()), 1),
        "feeddrive, tanh, 10 substeps, time loop": (native(smooth(10)), 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    print(rounds.machine() + "\n")
    inputs = job.given()
    calls = {name: (call, 1) for name, make in peer_tools.TOOLS.items() if (call := peer_tools.made(make, inputs))}
    missing = [name for name in peer_tools.TOOLS if name not in calls]
    calls |= ours()
    truth = np.asarray(calls["plain Python loop, RK4"][0]())
    taken: dict[str, list[float]] = {name: [] for name in calls}
    apart: dict[str, str] = {}
    for name, (call, _) in calls.items():
        found = call()
        near = isinstance(found, np.ndarray)
        apart[name] = f"{1e9 * np.sqrt(np.mean((found - truth) ** 2)):.3g}" if near else "-"
    for _ in range(given.rounds):
        for name, (call, runs) in calls.items():
            begun, repeats = time.process_time(), 0
            while repeats < 20 and (repeats == 0 or time.process_time() - begun < 0.2):
                call()
                repeats += 1
            taken[name].append((time.process_time() - begun) / repeats / runs)
    rows = []
    for name in sorted(calls, key=lambda name: statistics.median(taken[name])):
        seconds = statistics.median(taken[name])
        times = rounds.ratio(taken, BASE, name) if BASE in taken else float("nan")
        rows.append([name, f"{1e3 * seconds:.3g}", f"{1e9 * seconds / job.SAMPLES:.3g}", f"{times:.3g}", apart[name]])
    rounds.table(["tool", "ms a run", "ns/sample", "times as fast as python-control", "apart nm"], rows)
    print(f"Not installed: {', '.join(missing) or 'none'}.")


if __name__ == "__main__":
    main()
