"""One step of a law alone, against the same law written by hand in C: DADSC, pole placement, GPI observer with its law.

python benchmarks/laws.py [--rounds 60]
"""

from __future__ import annotations

import argparse
import ctypes
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import compiler
import numpy as np
import rounds

import feeddrive as fd
from feeddrive.blocks.families import Law
from feeddrive.blocks.plant.two_bodies import lag, two_bodies
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import tree
from feeddrive.language.graph import Graph
from feeddrive.loop.engine.llvm import native
from feeddrive.loop.engine.plan import Plan, plan
from feeddrive.loop.loop import SETPOINT
from feeddrive.loop.trace import Carried, Program, concrete, numbers

SOURCE = (Path(__file__).parent / "laws.c").read_text()
SAMPLES = 40_000
READING = tuple(f"reading_{name}" for name in ("position_motor", "position_load", "applied", "requested"))


@dataclass(frozen=True)
class Candidate:
    """A law, its C function, and the parameters of that function in their order."""

    name: str
    function: str
    law: Any
    T: float
    parameters: Callable[[Any, Any], list[float]]


def candidates() -> list[Candidate]:
    """The laws that are written by hand in laws.c."""
    dadsc = fd.blocks.DADSC(mass=40.0, viscous=60.0, tracking_rate=300.0, reaching_rate=300.0, adaptation_rate=300.0)
    table = fd.blocks.TwoMass(
        mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0
    )
    poles = fd.blocks.PolePlacement(model=table, bandwidth=50.0)
    bodies = two_bodies("", table)
    observer = fd.blocks.GpiObserver(mass=139.0, omega_o=700.0)
    rejection = fd.blocks.ActiveDisturbanceRejection(mass=139.0, omega_c=12.0, observer=observer)
    cascade = fd.blocks.CascadePPI(Kv=100.0, Kp=6.8e4, Tn=5.4e-3)
    return [
        Candidate(
            "P-PI",
            "cascade_ppi",
            cascade,
            5e-5,
            lambda law, _: [law.Kv, law.Kp, law.Tn, law.velocity_feedforward],
        ),
        Candidate(
            "DADSC",
            "dadsc",
            dadsc,
            1e-4,
            lambda law, made: [law.mass, law.viscous, law.tracking_rate, law.reaching_rate, made.g1, made.g2],
        ),
        Candidate(
            "pole placement",
            "pole_placement",
            poles,
            5e-5,
            lambda _, made: [*made.gains, bodies.led / bodies.k, bodies.dragged / bodies.k, lag(bodies)],
        ),
        Candidate(
            "GPI observer and its law",
            "gpi",
            rejection,
            1e-4,
            lambda law, made: [
                law.mass,
                law.omega_c,
                law.zeta_c,
                law.share,
                law.observer.omega_o,
                *(float(x) for row in made.F for x in row),
                *made.Gu,
                *made.Gy,
            ],
        ),
    ]


def program(law: Law, T: float, begun: Any) -> Program:
    """One sample of a law as a program: setpoint and reading in, force out."""
    graph = Graph()
    made = concrete(law).prepare(np.float64(T))  # type: ignore[arg-type]
    symbolic = tree.rebuild(law, (graph.input(name) for name, _ in tree.leaves(law)))
    prepared = tree.rebuild(
        made, (v if type(v) is float else graph.input(name) for name, v in tree.leaves(made, "prepared"))
    )
    names = [name for name, _ in tree.leaves(begun)]
    before = tree.rebuild(begun, (graph.input(f"state.{name}") for name in names))
    setpoint = Setpoint(*(graph.input(name) for name in SETPOINT))
    reading = Reading(*(graph.input(name) for name in READING))
    after, force = symbolic.step(prepared, before, setpoint, reading, graph.input("T"))
    constants = [*dict(tree.leaves(law)), *dict(numbers(made, "prepared")), "T"]
    return Program(
        graph=graph,
        constants={name: graph.input(name).index for name in constants},
        inputs={name: graph.input(name).index for name in (*SETPOINT, *READING)},
        states=tuple(
            Carried(name, graph.input(f"state.{name}").index, graph.symbol(value).index)
            for name, (_, value) in zip(names, tree.leaves(after), strict=True)
        ),
        outputs={"force": graph.symbol(force).index},
        sample=None,
        tables={},
    )


def rows(T: float) -> np.ndarray:
    """Setpoints of a sine and readings that follow it late and with noise, the limit reached now and then."""
    t = T * np.arange(SAMPLES)
    w = 2.0 * np.pi * 2.0
    motion = [0.05 * w**n * np.sin(w * t + 0.5 * np.pi * n) for n in range(5)]
    noise = np.random.default_rng(1).normal(size=(2, SAMPLES)) * 1e-8
    wanted = 2000.0 * np.sin(w * t)
    reading = [motion[0] - 1e-4 + noise[0], motion[0] - 1.1e-4 + noise[1], np.clip(wanted, -1900, 1900), wanted]
    return np.ascontiguousarray(np.array([*motion, *reading]).T)


def by_hand(
    function: Any, given: np.ndarray, inputs: np.ndarray, first: np.ndarray, force: np.ndarray
) -> Callable[[], object]:
    """The C function as a call without arguments."""
    function.restype, function.argtypes = None, [ctypes.c_long, *[ctypes.c_void_p] * 4]
    state = np.empty_like(first)
    arguments = [SAMPLES, *(array.ctypes.data for array in (given, inputs, state, force))]

    def call(kept: object = (given, inputs, force)) -> object:
        state[:] = first
        function(*arguments)
        return kept

    return call


def engine(
    planned: Plan, values: dict[str, Any], inputs: np.ndarray, begun: Any, force: np.ndarray
) -> Callable[[], object]:
    """The native step of the law as a call without arguments."""
    made = native(planned)
    columns = np.ascontiguousarray(inputs[:, [(*SETPOINT, *READING).index(name) for name, _ in planned.inputs]])
    constants = np.array([[float(values[name])] for name, _ in planned.constants])
    first = np.array([[float(dict(tree.leaves(begun))[state.name])] for state in planned.states])
    states = first.copy()

    def call() -> None:
        states[:] = first
        made.run(SAMPLES, 0, constants, columns, states, force.reshape(SAMPLES, 1, 1), [])

    return call


def compare(candidate: Candidate, count: int) -> list[list[str]]:
    """The rows of a table for one law."""
    law, T = candidate.law, candidate.T
    inputs = rows(T)
    made = concrete(law).prepare(np.float64(T))
    begun = concrete(law).start(made, Setpoint(*inputs[0, :5]), Reading(*inputs[0, 5:]))
    values = {**dict(tree.leaves(concrete(law))), **dict(numbers(made, "prepared")), "T": T}
    traced = program(law, T, begun)
    first = np.array([float(value) for _, value in tree.leaves(begun)])
    forces: dict[str, np.ndarray] = {}
    calls: dict[str, Callable[[], object]] = {}

    for name, command in compiler.compilers().items():
        for said, flags in (("", []), (", no contraction", ["-ffp-contract=off"])):
            library = compiler.library(SOURCE, command, ["-O3", "-march=native", *flags])
            given = np.array([float(value) for value in (*candidate.parameters(law, made), T)])
            label = f"C by hand, {name}{said}"
            forces[label] = np.empty(SAMPLES)
            calls[label] = by_hand(getattr(library, candidate.function), given, inputs, first, forces[label])
    for arithmetic in ("exact", "fma"):
        label = f"engine, {arithmetic}"
        forces[label] = np.empty(SAMPLES)
        calls[label] = engine(plan(traced, lanes=1, arithmetic=arithmetic), values, inputs, begun, forces[label])
    taken = rounds.measure(calls, count)
    base, exact = (next(name for name in calls if ("no contraction" in name) is said) for said in (False, True))
    found = []
    for name in calls:
        apart = np.max(np.abs(forces[name] - forces[exact]))
        each = statistics.median(taken[name]) / SAMPLES * 1e9
        same = "bit-equal" if apart == 0.0 else f"{apart:.1e} N"
        found.append([candidate.name, name, f"{each:.2f}", f"{rounds.ratio(taken, name, base):.3f}", same])
    assert np.allclose(forces["engine, exact"], forces[exact], rtol=1e-9, atol=1e-6), "engine and C by hand must agree"
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=60)
    given = parser.parse_args()
    print(rounds.machine())
    if not compiler.compilers():
        raise SystemExit("this benchmark needs a C compiler: gcc, clang, or pip install ziglang")
    print(f"\n## One step of a law alone, {SAMPLES} samples\n")
    found = [row for candidate in candidates() for row in compare(candidate, given.rounds)]
    rounds.table(["law", "candidate", "ns/sample", "ratio", "force against C without contraction"], found)


if __name__ == "__main__":
    main()
