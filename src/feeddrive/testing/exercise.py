"""A block that is run on floats, traced on symbols, and compiled as a C loop.

For the tests of the battery, an `Exercise` combines everything that a block of a family computes in a step into one
pure function of some numbers.  It runs this function on floats or arrays, traces it on symbols, and compiles it.

The C source of a plan is the C99 time loop of one variant, which can be read, compiled and compared.  Its signature and
memory layout are those of the native code, and its results are bit-identical:

    void name(int64_t count, int64_t first, const double *constants, const double *inputs, double *states,
              double *outputs, const double *const *tables)

An operation whose result is used once is written inside the expression that uses it; all others are named variables.
Unless the plan uses "libm", the only functions called from the C library are `fabs`, `floor` and `sqrt`, whose results
IEEE 754 specifies exactly.
"""

import ctypes
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import strategies as st

from feeddrive.blocks import families
from feeddrive.blocks.catalogue import family_of
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.signals import Motion, Noise, Reading, Setpoint
from feeddrive.export.c_code import CALLS, FLUSH, FUNCTIONS, RESERVED, WIDTH, expression, number
from feeddrive.export.identifiers import bare
from feeddrive.language import ops, tree
from feeddrive.language.block import Block
from feeddrive.language.graph import Graph, Symbol, arguments
from feeddrive.language.ring import Ring
from feeddrive.loop.engine.llvm import native
from feeddrive.loop.engine.plan import Plan, classify, plan
from feeddrive.loop.trace import Program


class _Writer:
    """A writer that converts graph nodes to C source; it collects the lines of the current part of the program."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.lines: list[str] = []
        self.texts: dict[int, str] = {}
        self.names = {*RESERVED, *CALLS.values(), *FUNCTIONS}
        self.uses = Counter(i for index in plan.order for i in arguments(plan.graph.nodes[index]))
        self.uses.update(node for _, node in plan.outputs)
        # counted twice: a state that is carried on is written back and needs a name
        self.uses.update(2 * [state.after for state in plan.states])

    def name(self, wanted: str) -> str:
        """Return a unique C name."""
        text = re.sub(r"\W", "_", wanted, flags=re.ASCII)
        while text in self.names:
            text += "_"
        self.names.add(text)
        return text

    def declare(self, index: int, wanted: str, text: str) -> None:
        """Add a line that declares a named variable for a node."""
        self.texts[index] = self.name(wanted)
        kind = "int" if self.plan.kinds.truth[index] else "double"
        self.lines.append(f"const {kind} {self.texts[index]} = {text};")

    def node(self, index: int) -> None:
        """Write one operation; if it is used only once, in an expression of the same part, write it inside that
        expression.
        """
        node = self.plan.graph.nodes[index]
        if node[0] in ("input", "table", "ring"):
            return
        if node[0] == "const":
            self.texts[index] = number(float.fromhex(node[1]))
            return
        if node[0] == "truth":
            self.texts[index] = "1" if node[1] else "0"
            return
        if node[0] == "put":
            ring, place, value = (self.texts[i] for i in node[1:])
            self.lines.append(f"{ring}[(int64_t){place}] = {bare(value)};")
            self.texts[index] = ring
            return
        text = expression(node[0], [self.texts[i] for i in arguments(node)])
        # not inside a later expression: the ring may be written in between
        if node[0] == "get":
            self.declare(index, f"v{index}", text)
            return
        # inside an expression of the loop it would be computed again in each sample
        hoisted = not self.plan.kinds.moving[index]
        if self.uses[index] > 1 or len(text) > WIDTH or hoisted:
            self.declare(index, f"v{index}", bare(text))
        else:
            self.texts[index] = text


def text(plan: Plan, name: str) -> str:
    """Return the C source of a plan of one variant, with `name` as its only visible function."""
    assert plan.lanes == 1, "C text is written for one variant"
    writer = _Writer(plan)
    writer.name(name)
    # a ring is written in place: the plan has put all reads of its old contents before the write
    order = sorted(plan.order) if not plan.rings else plan.order  # that of the law's text
    needed, moving = set(order), plan.kinds.moving
    for i, (title, node) in enumerate(plan.tables):
        writer.texts[node] = writer.name(title)
        writer.lines.append(f"const double *{writer.texts[node]} = tables[{i}];")
    for i, (title, node) in enumerate(plan.constants):
        if node in needed:
            writer.declare(node, title, f"constants[{i}]")
    first = len(plan.states)
    for title, node, length in plan.rings:
        writer.texts[node] = writer.name(title)
        writer.lines.append(f"double *const {writer.texts[node]} = states + {first};")
        first += length
    for i, state in enumerate(plan.states):
        still = "const " if state.before == state.after else ""
        writer.texts[state.before] = writer.name(state.name)
        writer.lines.append(f"{still}double {writer.texts[state.before]} = states[{i}];")
    for index in order:
        if not moving[index]:
            writer.node(index)
    entry, writer.lines = writer.lines, []

    for i, (title, node) in enumerate(plan.inputs):
        if node in needed:
            writer.declare(node, title, f"inputs[{len(plan.inputs)} * k + {i}]")
    if plan.sample is not None and plan.sample in needed:
        writer.declare(plan.sample, "sample", "(double)(first + k)")
    for index in order:
        if moving[index]:
            writer.node(index)
    for i, (title, node) in enumerate(plan.outputs):
        writer.lines.append(f"outputs[{len(plan.outputs)} * k + {i}] = {writer.texts[node]}; /* {title} */")
    carried = [state for state in plan.states if state.before != state.after]
    # states change one after another: the old value of one that another state takes over is saved first
    held = {}
    for before in sorted({s.before for s in carried} & {s.after for s in carried}):
        held[before] = writer.name(f"last_{writer.texts[before]}")
        writer.lines.append(f"const double {held[before]} = {writer.texts[before]};")
    for state in carried:
        writer.lines.append(f"{writer.texts[state.before]} = {held.get(state.after, writer.texts[state.after])};")
    body, writer.lines = writer.lines, []
    done = [f"states[{i}] = {writer.texts[s.before]};" for i, s in enumerate(plan.states) if s.before != s.after]

    used = {plan.graph.nodes[index][0] for index in plan.order}
    lines = [
        "#include <math.h>",
        "#include <stdint.h>",
        "#include <string.h>",
        "",
        *([] if plan.arithmetic == "fma" else ["#pragma STDC FP_CONTRACT OFF /* gcc: -ffp-contract=off */", ""]),
        FLUSH,
        *(FUNCTIONS[function] for function in sorted(used & set(FUNCTIONS))),
        f"void {name}(int64_t count, int64_t first, const double *constants, const double *inputs, double *states,",
        f"{' ' * (6 + len(name))}double *outputs, const double *const *tables)",
        "{",
        *(f"    (void){unused};" for unused in ("first", "constants", "inputs", "outputs", "tables")),
        *("    " + line for line in ("const uint64_t mode = flush();", *entry)),
        "    for (int64_t k = 0; k < count; k++) {",
        *("        " + line for line in body),
        "    }",
        *("    " + line for line in (*done, "restore(mode);")),
        "}",
        "",
    ]
    return "\n".join(lines)


def compiled(source: str, folder: Path, *flags: str) -> ctypes.CDLL:
    """Compile C source with warnings as errors and load it; skip the test if there is no compiler."""
    compiler = next(filter(None, map(shutil.which, ("gcc", "clang", "cc"))), None)
    if compiler is None:
        pytest.skip("no C compiler (gcc, clang or cc) on this machine: the C text was NOT compiled and NOT compared")
    text, library = folder / "loop.c", folder / "loop.so"
    text.write_text(source, encoding="utf-8")
    # gcc knows no FP_CONTRACT pragma and would fuse a*b + c by default: the option forbids it
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-unknown-pragmas"]
    done = subprocess.run(
        [
            compiler,
            *strict,
            "-O2",
            "-ffp-contract=off",
            *flags,
            "-shared",
            "-fPIC",
            "-o",
            str(library),
            str(text),
            "-lm",
        ],
        capture_output=True,
        text=True,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    assert done.returncode == 0, done.stderr[:3000]
    return ctypes.CDLL(str(library))


# enough to pass a state on twice: a state that is right only at the start would go unnoticed with fewer
STEPS = 3


class Inputs(NamedTuple):
    """The numbers that a block may receive: floats, arrays or symbols; each family uses those that it needs."""

    T: Any
    position: Any
    position_motor: Any
    velocity: Any
    velocity_motor: Any
    acceleration: Any
    jerk: Any
    snap: Any
    force: Any
    mobility: Any
    time: Any
    seed: Any
    sample: Any

    def setpoint(self) -> Setpoint:
        """Return the setpoint."""
        return Setpoint(self.position, self.velocity, self.acceleration, self.jerk, self.snap)

    def motion(self) -> Motion:
        """Return the motion of both bodies of the axis."""
        return Motion(self.position_motor, self.position, self.velocity_motor, self.velocity)


@cache
def inputs() -> st.SearchStrategy[Inputs]:
    """Return a strategy for inputs in the range of motions and forces of feed drives."""

    # numbers so small that a product leaves the normal ones are 0 in native code: none of them is a motion or a force
    def about(size: float) -> st.SearchStrategy[float]:
        return st.floats(-size, size).map(lambda value: value if abs(value) > 1e-12 else 0.0)

    return st.builds(
        Inputs,
        # at most 0.2 ms: all filters of the strategies lie below half of 5 kHz
        T=st.sampled_from([5e-5, 1e-4, 2e-4]),
        position=about(1.0),
        position_motor=about(1.0),
        velocity=about(2.0),
        velocity_motor=about(2.0),
        acceleration=about(20.0),
        jerk=about(1e3),
        snap=about(1e5),
        force=about(2e3),
        mobility=st.floats(1e-8, 1e-3),
        time=st.floats(0.0, 3600.0),
        seed=st.integers(0, 2**32).map(float),
        sample=st.integers(0, 2**40).map(float),
    )


class Answers(NamedTuple):
    """The results of a block: all outputs and, if it has a state, the state at the start and after some steps."""

    start: Any
    after: Any
    outputs: Any


def _plant(block: Any, x: Inputs) -> Answers:
    mechanics = block.mechanics()
    matrices = (mechanics.mass, mechanics.damping, mechanics.stiffness, mechanics.shape, mechanics.rigid_motion())
    return Answers((), (), (*matrices, block.rigid_mass()))


def _friction(block: Any, x: Inputs) -> Answers:
    start = state = block.start()
    outputs: list[Any] = [block.linear(), block.steady(x.velocity)]
    free = x.velocity_motor
    for _ in range(STEPS):
        state, force, stuck = block.contact(x.T, state, x.velocity, free, x.mobility)
        outputs += [force, stuck]
        free = free + x.mobility * force
    return Answers(start, state, tuple(outputs))


def _force(block: Any, x: Inputs) -> Answers:
    plant = TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7)
    motion, outputs = x.motion(), list[Any]()
    start = state = block.start(plant, motion)
    for step in range(STEPS):
        state, *forces = block.step(state, plant, motion, x.force, x.time + float(step) * x.T, x.T)
        outputs += forces
        motion = motion._replace(
            position_motor=motion.position_motor + x.T * motion.velocity_motor,
            position_load=motion.position_load + x.T * motion.velocity_load,
        )
    return Answers(start, state, tuple(outputs))


def _motor(block: Any, x: Inputs) -> Answers:
    return Answers((), (), (block.force_per_unit(), block.limits(), block.velocity_limit()))


def _sensor(block: Any, x: Inputs) -> Answers:
    start = state = block.start(x.position)
    outputs: list[Any] = [block.still(x.position)]
    position = x.position
    for step in range(STEPS):
        state, reading = block.step(state, position, x.velocity, Noise(x.seed, x.sample + float(step), 16.0), x.T)
        outputs.append(reading)
        position = position + x.T * x.velocity
    return Answers(start, state, tuple(outputs))


def _reading(x: Inputs, step: int) -> Reading:
    passed = float(step) * x.T
    motor, load = x.position_motor + passed * x.velocity_motor, x.position + passed * x.velocity
    # two different forces: a block that mixes up requested and applied gives another result
    return Reading(motor, load, x.force, 1.5 * x.force)


def _law(block: Any, x: Inputs) -> Answers:
    prepared = block.prepare(x.T)
    start = state = block.start(prepared, x.setpoint(), _reading(x, 0))
    outputs = []
    for step in range(STEPS):
        setpoint = x.setpoint().shifted(float(step) * x.T)
        state, force = block.step(prepared, state, setpoint, _reading(x, step), x.T)
        outputs.append(force)
    return Answers(start, state, (tuple(outputs), _retuned(block, state, prepared, x.T)))


def _retuned(block: Any, state: Any, prepared: Any, T: Any) -> Any:
    """Return the state after a live change to a block from a copy of it with all parameters 10 % smaller."""
    old = tree.rebuild(block, (0.9 * value for _, value in tree.leaves(block)))
    return block.retune(state, old, old.prepare(T), prepared)


def _compensation(block: Any, x: Inputs) -> Answers:
    prepared = block.prepare(x.T)
    start = state = block.start(prepared, x.setpoint(), _reading(x, 0))
    outputs = []
    for step in range(STEPS):
        setpoint = x.setpoint().shifted(float(step) * x.T)
        state, *commands = block.step(prepared, state, setpoint, _reading(x, step), x.T)
        outputs.append(tuple(commands))
    return Answers(start, state, (tuple(outputs), _retuned(block, state, prepared, x.T)))


def _filter(block: Any, x: Inputs) -> Answers:
    prepared = block.prepare(x.T)
    start = state = block.start(prepared, x.force)
    outputs = []
    for value in (x.force, x.position, x.velocity):
        state, output = block.step(prepared, state, value)
        outputs.append(output)
    return Answers(start, state, (prepared, tuple(outputs), _retuned(block, state, prepared, x.T)))


def _feedforward(block: Any, x: Inputs) -> Answers:
    start = state = block.start(x.setpoint())
    outputs: list[Any] = []
    for step in range(STEPS):
        state, force = block.step(state, x.setpoint().shifted(float(step) * x.T), x.T)
        outputs.append(force)
    old = tree.rebuild(block, (0.9 * value for _, value in tree.leaves(block)))
    return Answers(start, state, (tuple(outputs), block.retune(state, old)))


def _prefilter(block: Any, x: Inputs) -> Answers:
    start = state = block.start(x.setpoint())
    outputs = []
    for step in range(STEPS):
        state, setpoint = block.step(state, x.setpoint().shifted(float(step) * x.T), x.T)
        outputs.append(setpoint)
    return Answers(start, block.retune(state, block), tuple(outputs))


def _observer(block: Any, x: Inputs) -> Answers:
    prepared = block.prepare(x.T)
    start = state = block.start(prepared, _reading(x, 0))
    outputs = []
    for step in range(STEPS):
        state, estimate = block.step(prepared, state, _reading(x, step), x.T)
        outputs.append(estimate)
    return Answers(start, state, (tuple(outputs), _retuned(block, state, prepared, x.T)))


def _cutter(block: Any, x: Inputs) -> Answers:
    angle = 20.0 * x.position  # some turns to either side
    return Answers((), (), (block.forces(angle, x.mobility), block.torque(angle, x.mobility)))


def _coupling(block: Any, x: Inputs) -> Answers:
    prepared = block.prepare(x.T)
    motions = {name: x.motion() for name in block.axes()}
    start = state = block.start(prepared, motions)
    outputs: list[Any] = [tuple((mode.mass, mode.damping, mode.stiffness) for mode in block.modes())]
    outputs.append(tuple((spring.stiffness, spring.damping) for spring in block.springs()))
    for step in range(STEPS):
        state, forces = block.step(prepared, state, motions, x.time + float(step) * x.T, x.T)
        outputs.append(tuple(forces.values()))
        motions = {
            name: motion._replace(position_load=motion.position_load + x.T * motion.velocity_load)
            for name, motion in motions.items()
        }
    if not block.controls:
        return Answers(start, state, tuple(outputs))
    setpoints = {name: x.setpoint().shifted(float(i) * x.T) for i, name in enumerate(block.axes())}
    begun = heard = block.listen(setpoints)
    for _ in range(STEPS):
        setpoints = {name: motion.shifted(x.T) for name, motion in setpoints.items()}
        heard, added = block.correct(heard, setpoints, dict.fromkeys(block.axes(), x.position_motor))
        outputs.append(tuple(added.values()))
    return Answers((start, begun), (state, heard), tuple(outputs))


# The families that are part of a step, with the function that runs a block of each.
TRACED: dict[type[Block], Callable[[Any, Inputs], Answers]] = {
    families.Plant: _plant,
    families.Friction: _friction,
    families.Force: _force,
    families.Motor: _motor,
    families.Sensor: _sensor,
    families.Law: _law,
    families.Compensation: _compensation,
    families.Filter: _filter,
    families.Feedforward: _feedforward,
    families.Prefilter: _prefilter,
    families.Observer: _observer,
    families.Cutter: _cutter,
    families.Coupling: _coupling,
}
SAMPLED: tuple[type[Block], ...] = (families.Reference, families.Load)


def run_of(block: type[Block]) -> Callable[[Any, Inputs], Answers]:
    """Return the function that runs some steps of a block, according to its family."""
    return TRACED[family_of(block)]


class Exercise(NamedTuple):
    """A block, the function that runs it, and its input numbers."""

    block: Any
    ask: Callable[[Any, Inputs], Answers]
    x: Inputs

    def run(self) -> Answers:
        """Run the function on the input numbers themselves, which are floats or arrays over variants."""
        with np.errstate(all="ignore"):
            return self.ask(self.block, self.x)

    def trace(self) -> tuple[Graph, list[int], dict[str, Any]]:
        """Return the graph of all results, the nodes of these results, and the values of the graph's leaves by name."""
        graph = Graph()
        rows = dict(tree.tables(self.block))
        block = tree.rebuild(self.block, (graph.input(name) for name, _ in tree.leaves(self.block)))
        block = tree.with_tables(block, {name: graph.table(name, len(row)) for name, row in rows.items()})
        x = Inputs(*(graph.input(f"x.{name}") for name in Inputs._fields))
        nodes = [graph.symbol(value).index for value in flat(self.ask(block, x))]
        inputs = {f"x.{name}": value for name, value in zip(Inputs._fields, self.x, strict=True)}
        return graph, nodes, {**dict(tree.leaves(self.block)), **rows, **inputs}

    def program(self) -> tuple[Program, dict[str, Any], dict[str, np.ndarray]]:
        """Return a program that computes the results from constants and tables, and their values by name."""
        graph, nodes, leaves = self.trace()
        tables = {name: value for name, value in leaves.items() if isinstance(value, np.ndarray)}
        numbers = {name: value for name, value in leaves.items() if name not in tables}
        truth = classify(graph, [], [], []).truth
        outputs = [ops.where(Symbol(graph, node), 1.0, 0.0).index if truth[node] else node for node in nodes]
        program = Program(
            graph=graph,
            constants={name: graph.input(name).index for name in numbers},
            inputs={},
            states=(),
            outputs={f"y{i}": node for i, node in enumerate(outputs)},
            sample=None,
            tables={name: graph.table(name, len(row)).index for name, row in tables.items()},
        )
        return program.keeping(list(program.outputs)), numbers, tables

    def plan(self, lanes: int) -> tuple[Plan, np.ndarray, list[np.ndarray]]:
        """Return the plan of the program, its constants (one row per number, one column per variant) and its tables."""
        program, numbers, tables = self.program()
        compiled_plan = plan(program, lanes=lanes, varying=list(numbers) if lanes > 1 else ())
        column = np.array([numbers[name] for name, _ in compiled_plan.constants], dtype=float).reshape(
            -1, 1
        )  # perhaps empty
        constants = np.ascontiguousarray(np.repeat(column, lanes, axis=1))
        return compiled_plan, constants, [tables[name] for name, _ in compiled_plan.tables]

    def native(self, lanes: int) -> np.ndarray:
        """Return the results computed by native machine code, shape (outputs, lanes)."""
        compiled_plan, constants, rows = self.plan(lanes)
        outputs = np.empty((1, len(compiled_plan.outputs), lanes))
        native(compiled_plan).run(
            1, 0, constants, np.empty((1, 0)), np.zeros((len(compiled_plan.memory), lanes)), outputs, rows
        )
        return outputs[0]


def flat(answers: Answers) -> list[Any]:
    """Return all numbers of the results except ring buffers, whose content shows up in the values read from them."""
    return [value for _, value in tree.leaves(answers) if not isinstance(value, Ring)]
