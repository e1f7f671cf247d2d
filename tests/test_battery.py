"""The battery: every block that is found in the packages passes every row that applies to it.

Whoever adds a block writes no test for this.  A row is a method of `TestBlock`; it gets the class of a block, and the
rows on numbers get an `Exercise`, which is everything that a block of its family is asked, as one pure function.
That files of a step import neither `math` nor `numpy` and that a block is final stands in test_architecture.py.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, get_type_hints

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from feeddrive.blocks import families, machine_families
from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.signals import Motion, Noise, Reading, Setpoint
from feeddrive.language import ops, tree
from feeddrive.language.block import Block, declarations
from feeddrive.language.graph import Graph, Symbol, reachable
from feeddrive.language.ring import Ring
from feeddrive.language.units import measure
from feeddrive.loop.axis import Axis
from feeddrive.loop.engine.native import native
from feeddrive.loop.engine.plan import Plan, classify, plan
from feeddrive.loop.trace import Program, concrete, evaluate, node_values
from feeddrive.loop.traced_model import push
from loop import c_loop as c
from loop.engine_loops import compiled
from strategies import blocks_of, part_types, variants_of

STEPS = 3


class Inputs(NamedTuple):
    """Numbers that a block may be given; each family takes those it needs."""

    T: float
    position: float
    position_motor: float
    velocity: float
    velocity_motor: float
    acceleration: float
    jerk: float
    snap: float
    force: float
    mobility: float
    time: float
    seed: float
    sample: float

    def setpoint(self) -> Setpoint:
        return Setpoint(self.position, self.velocity, self.acceleration, self.jerk, self.snap)

    def motion(self) -> Motion:
        return Motion(self.position_motor, self.position, self.velocity_motor, self.velocity)


def _inputs() -> st.SearchStrategy[Inputs]:
    # numbers so small that a product leaves the normal ones are 0 in native code: none of them is a motion or a force
    def about(size: float) -> st.SearchStrategy[float]:
        return st.floats(-size, size).map(lambda value: value if abs(value) > 1e-12 else 0.0)

    return st.builds(
        Inputs,
        T=st.sampled_from([5e-5, 1e-4, 2e-4]),  # all filters of the strategies lie below half of 5 kHz
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
    """What a block answered: its state at the start and after some steps, if it has one, and all outputs."""

    start: Any
    after: Any
    outputs: Any


def _plant(block: Any, x: Inputs) -> Answers:
    made = block.mechanics()
    matrices = (made.mass, made.damping, made.stiffness, made.shape, made.rigid_motion())
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
    """The state after a live change from the same block with all numbers a tenth smaller."""
    old = tree.rebuild(block, (0.9 * value for _, value in tree.leaves(block)))
    return block.retune(state, old, old.prepare(T), prepared)


def _compensation(block: Any, x: Inputs) -> Answers:
    prepared = block.prepare(x.T)
    start = state = block.start(prepared, x.setpoint(), _reading(x, 0))
    outputs = []
    for step in range(STEPS):
        setpoint = x.setpoint().shifted(float(step) * x.T)
        state, *found = block.step(prepared, state, setpoint, _reading(x, step), x.T)
        outputs.append(tuple(found))
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
    for step in range(STEPS):
        state, forces = block.step(prepared, state, motions, x.time + float(step) * x.T, x.T)
        outputs.append(tuple(forces.values()))
        motions = {
            name: each._replace(position_load=each.position_load + x.T * each.velocity_load)
            for name, each in motions.items()
        }
    return Answers(start, state, tuple(outputs))


# What is part of a step, and what a block of each family is asked.
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
    machine_families.Cutter: _cutter,
    machine_families.Coupling: _coupling,
}
SAMPLED: tuple[type[Block], ...] = (families.Reference, families.Load)

ALL = [block for members in catalogue().values() for block in members.values()]
ASKED = [(block, ask) for family, ask in TRACED.items() for block in catalogue().get(family, {}).values()]
RETUNED = [
    (block, ask)
    for block, ask in ASKED
    if hasattr(block, "retune") and not issubclass(block, families.Prefilter | families.Feedforward)
]


class Exercise(NamedTuple):
    """A block, what it is asked, and with which numbers."""

    block: Any
    ask: Callable[[Any, Inputs], Answers]
    x: Inputs

    def run(self) -> Answers:
        """On the numbers as they are: floats or arrays over lanes."""
        with np.errstate(all="ignore"):
            return self.ask(self.block, self.x)

    def trace(self) -> tuple[Graph, list[int], dict[str, Any]]:
        """The graph of all answers, their nodes, and the numbers of its leaves by name."""
        graph = Graph()
        rows = dict(tree.tables(self.block))
        block = tree.rebuild(self.block, (graph.input(name) for name, _ in tree.leaves(self.block)))
        block = tree.with_tables(block, {name: graph.table(name, len(row)) for name, row in rows.items()})
        x = Inputs(*(graph.input(f"x.{name}") for name in Inputs._fields))
        nodes = [graph.symbol(value).index for value in _flat(self.ask(block, x))]
        inputs = {f"x.{name}": value for name, value in zip(Inputs._fields, self.x, strict=True)}
        return graph, nodes, {**dict(tree.leaves(self.block)), **rows, **inputs}

    def program(self) -> tuple[Program, dict[str, Any], dict[str, np.ndarray]]:
        """The answers as a program whose numbers are all constants, and the numbers and tables by name."""
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

    def native(self, lanes: int) -> tuple[Plan, np.ndarray, list[np.ndarray], np.ndarray]:
        """Its plan, constants and tables, and what the machine code makes of them: (outputs, lanes)."""
        program, numbers, tables = self.program()
        made = plan(program, lanes=lanes, varying=list(numbers) if lanes > 1 else ())
        constants = np.repeat([[numbers[name]] for name, _ in made.constants], lanes, axis=1).astype(float)
        constants = np.ascontiguousarray(constants.reshape(len(made.constants), lanes))
        rows = [tables[name] for name, _ in made.tables]
        outputs = np.empty((1, len(made.outputs), lanes))
        native(made).run(1, 0, constants, np.empty((1, 0)), np.zeros((len(made.memory), lanes)), outputs, rows)
        return made, constants, rows, outputs[0]


def _flat(answers: Answers) -> list[Any]:
    """All numbers; what rings hold shows in what is read from them."""
    return [value for _, value in tree.leaves(answers) if not isinstance(value, Ring)]


def _bits(values: Sequence[Any]) -> list[bytes]:
    """The bits of numbers; every NaN is the same."""
    numbers = np.array([float(value) for value in values])
    return [b"nan" if number != number else number.tobytes() for number in numbers]


def _exercise(data: st.DataObject, block: type[Block], ask: Callable[[Any, Inputs], Answers]) -> Exercise:
    made = concrete(data.draw(blocks_of(block)))
    return Exercise(made, ask, Inputs(*map(np.float64, data.draw(_inputs()))))


def _moved(leaves: dict[str, Any], steps: dict[str, np.ndarray]) -> dict[str, Any]:
    """The leaves with some of them moved, lane by lane."""
    return {**leaves, **{name: np.float64(leaves[name]) + step for name, step in steps.items()}}


def _answers(graph: Graph, nodes: list[int], leaves: dict[str, Any], lanes: int) -> np.ndarray:
    """Nodes by lanes."""
    with np.errstate(all="ignore"):
        return np.array([np.broadcast_to(v, lanes).astype(float) for v in evaluate(graph, nodes, leaves)])


def _slopes(graph: Graph, nodes: list[int], leaves: dict[str, Any], names: list[str]) -> np.ndarray:
    """The tangents of nodes for a unit change of one leaf in each lane."""
    seeds = {graph.input(name).index: unit for name, unit in zip(names, np.eye(len(names)), strict=True)}
    with np.errstate(all="ignore"):
        pushed = push(graph, nodes, node_values(graph, nodes, leaves), seeds)
    return np.array([np.broadcast_to(0.0 if slope is None else slope, len(names)).astype(float) for slope in pushed])


def _rounding(graph: Graph, nodes: list[int], leaves: dict[str, Any], moved: list[str], base: np.ndarray) -> np.ndarray:
    """How far the answers move if every number moves by its last digits: higher differences cancel all others."""
    rng, lanes = np.random.default_rng(0), 8
    steps: dict[str, np.ndarray] = {}
    for name in moved:
        least = 0.1 if name.startswith("x.") and name != "x.mobility" else 0.0
        steps[name] = 1e-12 * rng.uniform(-1.0, 1.0, lanes) * max(abs(float(leaves[name])), least)
    beside = _answers(graph, nodes, _moved(leaves, steps), lanes)
    return np.fmax.reduce(np.abs(beside - base[:, None]), axis=1, initial=0.0)


def _without_denormal(values: Sequence[Any]) -> list[float]:
    """Numbers with those below the normal ones as 0 of their sign, as native code has them."""
    numbers = np.array([float(value) for value in values])
    return list(np.where(np.abs(numbers) < 2.3e-308, np.copysign(0.0, numbers), numbers))


every_block = pytest.mark.parametrize("block", ALL, ids=lambda block: block.__name__)
asked = pytest.mark.parametrize(("block", "ask"), ASKED, ids=lambda value: getattr(value, "__name__", ""))
# compiling takes long: the simplest example and one more, and no search for a smaller one
compiled_once = settings(
    max_examples=2, deadline=None, suppress_health_check=list(HealthCheck), phases=[Phase.explicit, Phase.generate]
)
few = settings(compiled_once, max_examples=4)
drawn = settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])


class TestBlock:
    """One row a method; a row applies to all blocks or to those that are part of a step."""

    @asked
    @drawn
    @given(data=st.data())
    def test_symbols_compute_the_same_bits_as_floats(
        self, block: type[Block], ask: Callable[[Any, Inputs], Answers], data: st.DataObject
    ) -> None:
        exercise = _exercise(data, block, ask)
        graph, nodes, leaves = exercise.trace()
        assert _bits(evaluate(graph, nodes, leaves)) == _bits(_flat(exercise.run()))

    @asked
    @drawn
    @given(data=st.data())
    def test_lanes_compute_the_same_bits_as_floats(
        self, block: type[Block], ask: Callable[[Any, Inputs], Answers], data: st.DataObject
    ) -> None:
        first = _exercise(data, block, ask)
        others = [
            Exercise(concrete(data.draw(variants_of(first.block))), ask, Inputs(*map(np.float64, data.draw(_inputs()))))
            for _ in range(2)
        ]
        lanes = [first, *others]
        together = Exercise(
            tree.rebuild(first.block, map(np.array, zip(*(_values(lane.block) for lane in lanes), strict=True))),
            ask,
            Inputs(*map(np.array, zip(*(lane.x for lane in lanes), strict=True))),
        )
        found = [np.broadcast_to(value, len(lanes)) for value in _flat(together.run())]
        for i, lane in enumerate(lanes):
            assert _bits([value[i] for value in found]) == _bits(_flat(lane.run()))

    @asked
    @compiled_once
    @given(data=st.data())
    def test_native_code_computes_the_same_bits_as_floats(
        self, block: type[Block], ask: Callable[[Any, Inputs], Answers], data: st.DataObject
    ) -> None:
        exercise = _exercise(data, block, ask)
        expected = _bits(_without_denormal(_flat(exercise.run())))
        for lanes in (1, 8):
            *_, found = exercise.native(lanes)
            for lane in range(lanes):
                assert _bits(found[:, lane]) == expected, f"{lanes} lanes"

    @asked
    @compiled_once
    @given(data=st.data())
    def test_c_computes_the_same_bits_as_native_code(
        self,
        block: type[Block],
        ask: Callable[[Any, Inputs], Answers],
        data: st.DataObject,
        tmp_path_factory: pytest.TempPathFactory,
    ) -> None:
        made, constants, rows, found = _exercise(data, block, ask).native(1)
        folder = tmp_path_factory.mktemp("c")
        library = compiled(c.text(made, "feeddrive_run"), folder, "-Wno-unused-parameter", "-O0")
        outputs = np.empty_like(found)
        tables = (ctypes.c_void_p * max(1, len(rows)))(*[row.ctypes.data for row in rows])
        arrays = (constants, np.empty((1, 0)), np.zeros((len(made.memory), 1)), outputs)
        function = library.feeddrive_run
        function.restype, function.argtypes = None, [ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 5]
        function(1, 0, *(array.ctypes.data for array in arrays), ctypes.addressof(tables))
        assert _bits(outputs[:, 0]) == _bits(found[:, 0])

    @asked
    @few
    @given(data=st.data())
    def test_slopes_are_those_of_differences(
        self, block: type[Block], ask: Callable[[Any, Inputs], Answers], data: st.DataObject
    ) -> None:
        """Tangents of the graph against central differences, wherever the two one-sided ones agree."""
        exercise = _exercise(data, block, ask)
        graph, nodes, leaves = exercise.trace()
        if any(graph.name(index) == "quantise" for index in reachable(graph, nodes)):
            return  # counts as a straight line, which differences cannot show; see test_linearize.py
        moved = [name for name, value in leaves.items() if not isinstance(value, np.ndarray)]
        moved = [name for name in moved if name not in ("x.seed", "x.sample", "x.time")]
        truth = classify(graph, [], [], []).truth
        values = node_values(graph, nodes, leaves)
        base = np.array([float(values[node]) for node in nodes])
        sizes = np.abs([float(value) for value in values.values() if not isinstance(value, np.ndarray | Ring)])
        largest = np.max(sizes[np.isfinite(sizes)], initial=1e-9)
        rounding = _rounding(graph, nodes, leaves, moved, base)

        def size(name: str) -> float:
            return max(abs(float(leaves[name])), 1e-2 if name.startswith("x.") and name != "x.mobility" else 1e-6)

        # a lane for each number that moves: lanes compute the bits of floats, as another row asserts
        h = 1e-6 * np.array([size(name) for name in moved])
        steps = dict(zip(moved, np.diag(h), strict=True))
        above, below, far_above, far_below = (
            _answers(graph, nodes, _moved(leaves, {name: k * step for name, step in steps.items()}), len(moved))
            for k in (1.0, -1.0, 2.0, -2.0)
        )
        slopes, beside = (
            _slopes(graph, nodes, _moved(leaves, {name: k * step for name, step in steps.items()}), moved)
            for k in (0.0, 1.0)
        )
        for i, node in enumerate(nodes):
            if truth[node]:
                continue
            slope = slopes[i]
            right, left = (above[i] - base[i]) / h, (base[i] - below[i]) / h
            # rounding of the largest number inside, or what cancellation makes of it, over the step
            blur = max(16 * 2.3e-16 * largest, 4.0 * rounding[i]) / h
            found, wide = 0.5 * (right + left), (far_above[i] - far_below[i]) / (4.0 * h)
            bent = np.maximum(np.abs(right - left), np.abs(found - wide))
            jumps = np.abs(slope - beside[i]) > 1e-3 * np.abs(slope)
            # a kink, a jump, or too curved for this step
            uneven = jumps | (bent > 1e-4 * np.maximum(np.abs(right), np.abs(left)) + blur)
            wrong = ~uneven & ~(np.abs(found - slope) <= 1e-3 * np.abs(slope) + 10 * blur)
            assert not np.any(wrong), f"output {i} by {[name for name, bad in zip(moved, wrong, strict=True) if bad]}"

    @asked
    @drawn
    @given(data=st.data())
    def test_start_is_a_state_as_a_step_returns_it(
        self, block: type[Block], ask: Callable[[Any, Inputs], Answers], data: st.DataObject
    ) -> None:
        answers = _exercise(data, block, ask).run()
        assert tree.structure(answers.start) == tree.structure(answers.after)

    @pytest.mark.parametrize(("block", "ask"), RETUNED, ids=lambda value: getattr(value, "__name__", ""))
    @drawn
    @given(data=st.data())
    def test_a_live_change_to_the_same_numbers_changes_no_bit(
        self, block: type[Block], ask: Callable[[Any, Inputs], Answers], data: st.DataObject
    ) -> None:
        exercise = _exercise(data, block, ask)
        made, state = exercise.block, exercise.run().after
        with np.errstate(all="ignore"):
            prepared = made.prepare(exercise.x.T)
            after = made.retune(state, made, prepared, prepared)
        assert tree.structure(after) == tree.structure(state)
        # a zero may change its sign, which nothing in a step asks for
        values = [
            [float(value) + 0.0 for _, value in tree.leaves(each) if not isinstance(value, Ring)]
            for each in (state, after)
        ]
        assert _bits(values[0]) == _bits(values[1])

    @asked
    @drawn
    @given(data=st.data())
    def test_answers_are_finite(
        self, block: type[Block], ask: Callable[[Any, Inputs], Answers], data: st.DataObject
    ) -> None:
        assert np.all(np.isfinite([float(value) for value in _flat(_exercise(data, block, ask).run())]))

    @every_block
    @drawn
    @given(data=st.data())
    def test_any_values_within_the_declared_bounds_make_a_block(self, block: type[Block], data: st.DataObject) -> None:
        made = data.draw(blocks_of(block))
        assert tree.structure(concrete(made)) == tree.structure(made)

    @every_block
    def test_every_field_says_what_it_is(self, block: type[Block]) -> None:
        for name, declared in declarations(block).items():
            assert declared.meaning, f"{block.__name__}.{name} has no meaning"
            measure(declared.unit)

    @every_block
    def test_docstring_states_the_equation(self, block: type[Block]) -> None:
        text = block.__dict__.get("__doc__") or ""
        assert any(sign in text for sign in "=∈"), f"{block.__name__} does not say what it computes"

    @every_block
    def test_the_family_is_known_to_the_battery(self, block: type[Block]) -> None:
        known = [family for family in (*TRACED, *SAMPLED) if issubclass(block, family)]
        assert known or _is_part(block), f"{block.__name__} is of no family and part of no block"


def _values(block: Block) -> list[Any]:
    return [value for _, value in tree.leaves(block)]


def _is_part(block: type[Block]) -> bool:
    """Whether another block, or the axis, declares a part of this type."""
    hints = (get_type_hints(owner)[name] for owner in (*ALL, Axis) for name in _part_names(owner))
    return any(block in part_types(hint) for hint in hints)


def _part_names(owner: type[Block]) -> list[str]:
    return [name for name, declared in declarations(owner).items() if declared.role == "part"]
