"""Measures the figures of docs/reference/accuracy.md and prints them; about two minutes.

    python docs/measure_accuracy.py [--points 400000]

The event-driven truth is that of the tests; the log of the EMPS axis is looked for beside the repository.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import mpmath
import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tests"))

import feeddrive as fd  # noqa: E402
from axis_runs import Dry, EventDriven, matrices, move  # noqa: E402
from feeddrive.language import ops  # noqa: E402
from feeddrive.language.graph import Graph  # noqa: E402
from feeddrive.language.single import single_values  # noqa: E402
from feeddrive.loop.hold import Hold, Port, Rows, Timing, hold  # noqa: E402
from feeddrive.loop.loop import SETPOINT  # noqa: E402
from feeddrive.loop.runner import Prepared, Work  # noqa: E402
from feeddrive.loop.trace import evaluate  # noqa: E402

LOG = ROOT.parent / "shared" / "data" / "emps" / "DATA_EMPS.mat"


def functions(count: int) -> None:
    """Largest and mean error of the elementary functions in units in the last place."""
    random = np.random.default_rng(1)
    half, quarter = count // 2, count // 4

    def decades(least: float, most: float, n: int) -> np.ndarray:
        return np.sign(random.uniform(-1, 1, n)) * 10.0 ** random.uniform(least, most, n)

    turns = random.integers(1, 600_000_000, quarter) * (math.pi / 2)
    wave = np.concatenate([random.uniform(-10, 10, half), random.uniform(-1e9, 1e9, quarter), turns])
    arguments = {
        "exp": random.uniform(-700, 709.4, count),
        "expm1": np.concatenate([random.uniform(-40, 709.4, half), random.uniform(-1, 1, half)]),
        "log": np.concatenate([np.abs(decades(-307, 308.25, half)), random.uniform(0.5, 2, half)]),
        "sin": wave,
        "cos": wave,
        "tan": np.concatenate([random.uniform(-1.57, 1.57, half), random.uniform(-1e5, 1e5, half)]),
        "tanh": np.concatenate([random.uniform(-20, 20, half), random.uniform(-1, 1, half)]),
        "atan": np.concatenate([random.uniform(-3, 3, half), decades(-300, 300, half)]),
    }
    with mpmath.workdps(60):
        for name, x in arguments.items():
            exact = getattr(mpmath, name)
            assert np.all(np.isfinite(getattr(ops, name)(x))), name
            errors = []
            for argument, got in zip(x, getattr(ops, name)(x), strict=True):
                true = exact(mpmath.mpf(float(argument)))
                errors.append(abs(float((mpmath.mpf(float(got)) - true) / math.ulp(float(true)))))
            print(
                f"{name:6s} {len(errors)} arguments: {max(errors):.2f} ulp at most, {np.mean(errors):.2f} in the mean"
            )


def single_functions(count: int) -> None:
    """The same of the functions in single precision, against 30-digit arithmetic; next to multiples of π/2, too."""
    random = np.random.default_rng(1)
    half, quarter = count // 2, count // 4

    def decades(least: float, most: float, n: int) -> np.ndarray:
        return np.sign(random.uniform(-1, 1, n)) * 10.0 ** random.uniform(least, most, n)

    turns = random.integers(1, 6366, quarter) * (math.pi / 2)
    wave = np.concatenate([random.uniform(-10, 10, half), random.uniform(-1e4, 1e4, quarter), turns])
    arguments = {
        "exp": random.uniform(-86.6, 88.3, count),
        "expm1": np.concatenate([random.uniform(-20, 88.3, half), decades(-30, 0, half)]),
        "log": np.concatenate([np.abs(decades(-37.8, 38.5, half)), random.uniform(0.5, 2, half)]),
        "sin": wave,
        "cos": wave,
        "tanh": np.concatenate([random.uniform(-12, 12, half), decades(-30, 0, half)]),
        "atan": np.concatenate([random.uniform(-3, 3, half), decades(-30, 30, half)]),
    }
    with mpmath.workdps(30):
        for name, values in arguments.items():
            graph = Graph()
            node = graph.apply(name, graph.input("x")).index
            x = values.astype(np.float32)
            errors = []
            for argument, got in zip(x, single_values(graph, [node], {"x": x})[0], strict=True):
                true = getattr(mpmath, name)(mpmath.mpf(float(argument)))
                unit = float(np.spacing(np.float32(abs(float(true)))))
                errors.append(abs(float((mpmath.mpf(float(got)) - true) / unit)))
            worst, mean = max(errors), np.mean(errors)
            print(f"single {name:6s} {len(errors)} arguments: {worst:.2f} ulp at most, {mean:.2f} in the mean")


def two_mass(random: np.random.Generator) -> fd.Axis:
    """A ball screw with a mode between 40 and 400 Hz, and friction of the guideway."""
    motor, load = 10.0 ** random.uniform(1.0, 2.5, 2)
    frequency = random.uniform(40.0, 400.0)
    stiffness = (2 * math.pi * frequency) ** 2 * motor * load / (motor + load)
    coulomb = random.uniform(20.0, 200.0)
    return fd.Axis(
        plant=fd.blocks.TwoMass(
            mass_motor=motor,
            mass_load=load,
            stiffness=stiffness,
            damping=0.02 * math.sqrt(stiffness * load),
            viscous_motor=300.0,
            viscous_load=100.0,
        ),
        friction_load=fd.blocks.Stribeck(
            coulomb=coulomb, breakaway=coulomb * random.uniform(1.0, 1.6), stribeck_velocity=random.uniform(1e-3, 1e-2)
        ),
    )


def holds(count: int = 200) -> None:
    """Entries of the hold against a matrix exponential in 40 digits, relative to the largest entry of their row."""
    random, worst = np.random.default_rng(2), 0.0
    T = 1e-4
    for _ in range(count):
        axis = two_mass(random)
        M, C, K = matrices(axis)
        dead = random.uniform(0.05, 0.95) * T
        body = axis.mechanics().shape[0]
        port = Port(Rows(body, body, body), None, np.float64(dead), Timing(0, True))
        joint = hold(axis.mechanics(), [port], np.float64(T), 1)
        made = Hold(joint.change, *joint.axes[0])
        n = len(M)
        rate = np.zeros((2 * n + 1, 2 * n + 1))
        rate[:n, n : 2 * n] = np.eye(n)
        rate[n : 2 * n, :n], rate[n : 2 * n, n : 2 * n] = -np.linalg.solve(M, K), -np.linalg.solve(M, C)
        rate[n, 2 * n] = 1.0 / M[0, 0]
        with mpmath.workdps(40):
            exact = mpmath.matrix(rate.tolist())
            whole = mpmath.expm(exact * T)
            late = mpmath.expm(exact * mpmath.mpf(T - dead))
            for i in range(2 * n):
                row = [whole[i, j] - (1 if i == j else 0) for j in range(2 * n)]
                pairs = [(made.change[i][j], row[j]) for j in range(2 * n)]
                pairs += [(made.new[0][i], late[i, 2 * n]), (made.old[0][i], whole[i, 2 * n] - late[i, 2 * n])]
                for part in (pairs[:n], pairs[n : 2 * n], pairs[2 * n :]):  # entries of one unit
                    scale = max(abs(true) for _, true in part)
                    worst = max(worst, *(float(abs(mpmath.mpf(float(got)) - true) / scale) for got, true in part))
    print(f"hold: {count} two-mass axes with a fraction of dead time, largest relative error {worst:.1e}")


def friction() -> None:
    """At 2 kHz and at 20 kHz."""
    against_truth(5e-4, 24, 150)
    against_truth(5e-5, 12, 600)


def against_truth(T: float, cases: int, samples: int) -> None:
    """Error of the load's position against the event-driven truth, over substeps; RMS over each case."""
    counts = (1, 2, 4, 8, 16)
    errors: list[list[float]] = []
    lost = 0
    while len(errors) < cases:
        random = np.random.default_rng(100 + len(errors) + lost)
        axis = two_mass(random)
        law = axis.friction_load
        peak = law.breakaway * random.uniform(1.2, 4.0)
        push = peak * np.sin(2 * math.pi * random.uniform(0.4, 1.9) * np.arange(samples) / samples)

        def level(v: float, law: fd.blocks.Stribeck = law) -> float:
            return law.coulomb + (law.breakaway - law.coulomb) * math.exp(-((v / law.stribeck_velocity) ** 2))

        forces = np.column_stack([push, np.zeros(samples)])
        try:
            truth = EventDriven(*matrices(axis), [Dry(1, level, level)]).run(T, forces, np.zeros(4))
        except AssertionError:  # it chatters at the edge of sticking: another case
            lost += 1
            continue
        row = []
        for substeps in counts:
            got = move(fd.Axis(plant=axis.plant, friction_load=law, substeps=substeps), T, push)
            row.append(float(np.sqrt(np.mean((got.position[:, 1] - truth[:, 1]) ** 2))))
        errors.append(row)
    median, most = np.median(errors, axis=0), np.max(errors, axis=0)
    slope = np.median([np.polyfit(np.log(counts), np.log(row), 1)[0] for row in errors])
    print(f"friction: {cases} random two-mass axes, sine force through standstill, T = {T * 1e3:g} ms, RMS error in nm")
    print(f"  ({lost} more cases in which the truth chatters were left out)")
    for i, substeps in enumerate(counts):
        print(f"  {substeps:2d} substeps: median {median[i] * 1e9:.3g}, largest {most[i] * 1e9:.3g}")
    print(f"  median order {-slope:.2f}")


def standstill() -> None:
    """An axis that is pushed with 99 % of its breakaway level for 100,000 samples."""
    axis = fd.Axis(plant=fd.blocks.Rigid(mass=80.0), friction_load=fd.blocks.Coulomb(coulomb=100.0))
    held = move(axis, 1e-4, np.full(100_000, 99.0), position=0.123)
    print(f"standstill: largest |v| {np.max(np.abs(held.velocity)):g} m/s, {np.unique(held.position).size} position")


def emps() -> None:
    """Prediction of the measured log by the published parameters."""
    from feeddrive.analysis.replay import replay
    from feeddrive.files.job import read_job
    from feeddrive.files.machine import read_machine
    from feeddrive.jobs.run_laws import run_laws

    if not LOG.exists():
        print(f"EMPS: not measured, {LOG.name} is not in ../shared")
        return
    found = run_laws(read_job("emps_log", LOG)).rows[0].replay
    assert found is not None
    log = {name: np.asarray(values) for name, values in found.measured.items()}
    log["set_position"] = log["position_load"] + log.pop("following_error")
    for machine in ("emps_symmetric", "emps"):
        again = replay(read_machine(machine).loop("x"), log, skip=49)
        print(
            f"EMPS, {machine}: position error {1e6 * again.rms('position_load'):.3f} um RMS, "
            f"force {100 * again.share('force'):.2f} % of the measured RMS"
        )


def bits() -> None:
    """One run against batch, stream and plain Python: how many numbers differ in any bit."""
    loop, move_ = example()
    record = ["position_load", "force", "reading_load", "friction_load"]
    run = fd.simulate(loop, move_, record=record, seed=3)
    parts = list(fd.stream(loop, move_, record=record, seed=3, chunk=777))
    streamed = sum(int(np.sum(np.concatenate([p[s] for p in parts]) != run[s])) for s in record)
    Kv = np.linspace(30.0, 50.0, 16)
    batch = fd.simulate_batch(fd.vary(loop, {"axis.x.control.law.Kv": Kv}), move_, seed=3)
    peak = [
        np.max(np.abs(fd.simulate(fd.vary(loop, {"axis.x.control.law.Kv": v}), move_, seed=3)["force"])) for v in Kv
    ]
    work = Work(loop, move_)
    prepared = Prepared(loop, work.first(), None, 3, 1.0)
    program = prepared.program(load=False, enable=False).keeping(record)
    held = {f"state.{state.name}": prepared.first[state.name] for state in program.states}
    ends = [*program.outputs.values(), *(state.after for state in program.states)]
    setpoint = move_.at(run.time[:2000])
    wrong = 0
    with np.errstate(all="ignore"):
        for k in range(2000):
            row = {name: np.float64(values[k]) for name, values in zip(SETPOINT, setpoint, strict=True)}
            found = evaluate(program.graph, ends, {**prepared.numbers, **held, **row, "sample": np.float64(k)})
            wrong += sum(int(value != run[name][k]) for name, value in zip(program.outputs, found, strict=False))
            held = {
                f"state.{state.name}": value
                for state, value in zip(program.states, found[len(program.outputs) :], strict=True)
            }
    print(
        f"bits: stream differs in {streamed} of {run.time.size * len(record)}, batch in "
        f"{int(np.sum(batch.peak['force'] != peak))} of {Kv.size} peaks, Python in {wrong} of {2000 * len(record)}"
    )


def example() -> tuple[fd.Loop, fd.blocks.Recorded]:
    """A two-mass loop with noise, quantiser, friction, notch, limit and a fraction of dead time; a swing of 50 mm."""
    T = 1e-4
    loop = fd.Loop(
        sample_time=T,
        control=fd.Control(
            law=fd.blocks.CascadePPI(Kv=40.0, Kp=4e4, Tn=0.01),
            filters=(fd.blocks.Notch(frequency=460.0),),
            feedforward=(fd.blocks.Inertia(mass=150.0, viscous=1400.0),),
            force_limit=400.0,
        ),
        axis=fd.Axis(
            plant=fd.blocks.TwoMass(
                mass_motor=130.0,
                mass_load=33.0,
                stiffness=1.8e7,
                damping=700.0,
                viscous_motor=1500.0,
                viscous_load=20.0,
            ),
            friction_load=fd.blocks.Stribeck(coulomb=40.0, breakaway=60.0, stribeck_velocity=0.002),
            actuator=fd.blocks.Actuator(dead_time=1.4 * T, current_loop=1500.0),
            encoder_motor=fd.blocks.Encoder(resolution=1e-8, noise=2e-8),
            encoder_load=fd.blocks.Encoder(resolution=1e-7),
        ),
    )
    t = np.arange(10_001) * T
    w, a = 2 * math.pi * 2.0, 0.025
    swing = fd.blocks.Recorded(
        position=a - a * np.cos(w * t),
        velocity=a * w * np.sin(w * t),
        acceleration=a * w * w * np.cos(w * t),
        sample_time=T,
    )
    return loop, swing


def gradients() -> None:
    """Exact slopes against central differences, on the loop above without friction, noise and quantiser."""
    import dataclasses

    loop, swing = example()
    smooth = dataclasses.replace(
        loop,
        axis=fd.Axis(plant=loop.axis.plant, actuator=loop.axis.actuator),
        control=dataclasses.replace(loop.control, force_limit=None),
    )
    names = [
        "axis.x.control.law.Kv",
        "axis.x.control.law.Kp",
        "axis.x.control.law.Tn",
        "axis.x.control.filters.0.frequency",
        "axis.x.control.feedforward.0.mass",
        "axis.x.plant.stiffness",
        "axis.x.actuator.dead_time",
    ]
    found = fd.gradient(smooth, swing, names)
    worst = 0.0
    for name in names:
        value = found.values[name]

        def cost(share: float, name: str = name, value: float = value) -> float:
            error = fd.simulate(fd.vary(smooth, {name: value * (1 + share)}), swing, record=["tracking_error"])
            return float(np.mean(error["tracking_error"] ** 2))

        # three points on each side, of order 6, so that the differences are not the worse of the two
        h = 1e-3
        near = [cost(k * h) - cost(-k * h) for k in (1, 2, 3)]
        slope = (45 * near[0] - 9 * near[1] + near[2]) / (60 * h * value)
        worst = max(worst, abs(found.gradient[name] / slope - 1))
    print(f"gradient: {len(names)} parameters, {swing.duration:g} s, largest relative deviation {worst:.1e}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--points", type=int, default=400_000)
    asked = parser.parse_args()
    for measure in (standstill, holds, friction, gradients, bits, emps):
        measure()
    functions(asked.points)
    single_functions(asked.points)
