"""The battery: tests that every block must pass, shipped or user-defined.

    from feeddrive.testing import battery
    from my_law import MyLaw

    TestMyLaw = battery(MyLaw)          # pytest collects the rows as its tests

The rows check that floats, arrays and symbols give bit-identical results, that native code and C agree bit for bit with
Python, that the Jacobian agrees with finite differences, that all values within the declared bounds give finite
numbers, and more.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, get_type_hints

import numpy as np

from feeddrive.language.errors import MissingExtraError, NoSlopeError, StructureError

try:
    import pytest
    from hypothesis import HealthCheck, Phase, given, settings
    from hypothesis import strategies as st
except ImportError as absent:
    raise MissingExtraError(str(absent.name), "testing", "the battery of a block") from absent

from feeddrive.blocks.catalogue import catalogue, family_of, required
from feeddrive.blocks.families import Law
from feeddrive.language import tree
from feeddrive.language.block import Block, declarations
from feeddrive.language.graph import Graph, reachable
from feeddrive.language.ring import Ring
from feeddrive.language.units import measure
from feeddrive.loop.axis import Axis
from feeddrive.loop.engine.plan import classify
from feeddrive.loop.gradient import push, require_slopes
from feeddrive.loop.machine import Machine
from feeddrive.loop.trace import concrete, evaluate, node_values
from feeddrive.testing import exercise as c_loop
from feeddrive.testing.exercise import SAMPLED, TRACED, Exercise, Inputs, flat, inputs, run_of
from feeddrive.testing.steady import ERRORS, RETUNED, UNPREPARED, bump, place, without_friction
from feeddrive.testing.strategies import blocks_of, part_types, variants_of


def battery(*blocks: type[Block]) -> type[Rows]:
    """Return the test class of some blocks; assign it to a name that begins with Test in a test module.

    Raises StructureError for anything but a concrete block, and for a call within a running test, where pytest would
    collect nothing.
    """
    inside = sys._getframe(1).f_code.co_name != "<module>"  # pyright: ignore[reportPrivateUsage]
    if inside and os.environ.get("PYTEST_CURRENT_TEST", "").endswith("(call)"):
        raise StructureError(
            "the battery is a class of tests that pytest collects: write TestMyLaw = battery(MyLaw) in the module, "
            "outside of any test"
        )
    if not blocks:
        raise StructureError("the battery needs a block: battery(MyLaw)")
    for block in blocks:
        required(block, Block, getattr(block, "__name__", repr(block)))
    return type("TestBlocks", (Rows,), {"blocks": blocks, "__doc__": Rows.__doc__})


def _bits(values: Sequence[Any] | np.ndarray) -> list[bytes]:
    """Return the bits of numbers; all NaN count as equal."""
    numbers = np.array([float(value) for value in values])
    return [b"nan" if number != number else number.tobytes() for number in numbers]


def _exercise(data: st.DataObject, block: type[Block]) -> Exercise:
    x = _inputs(data)
    return Exercise(concrete(data.draw(blocks_of(block, float(x.T)))), run_of(block), x)


def _inputs(data: st.DataObject) -> Inputs:
    return Inputs(*map(np.float64, data.draw(inputs())))


def _moved(leaves: dict[str, Any], steps: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return the leaves with some of them changed, lane by lane."""
    return {**leaves, **{name: np.float64(leaves[name]) + step for name, step in steps.items()}}


def _answers(graph: Graph, nodes: list[int], leaves: dict[str, Any], lanes: int) -> np.ndarray:
    """Return the values of nodes, shape (nodes, lanes)."""
    with np.errstate(all="ignore"):
        return np.array([np.broadcast_to(v, lanes).astype(float) for v in evaluate(graph, nodes, leaves)])


def _slopes(graph: Graph, nodes: list[int], leaves: dict[str, Any], names: list[str]) -> np.ndarray:
    """Return the derivatives of nodes with respect to the named leaves, one leaf per lane."""
    seeds = {graph.input(name).index: unit for name, unit in zip(names, np.eye(len(names)), strict=True)}
    with np.errstate(all="ignore"):
        pushed = push(graph, nodes, node_values(graph, nodes, leaves), seeds)
    return np.array([np.broadcast_to(0.0 if slope is None else slope, len(names)).astype(float) for slope in pushed])


def _stands_at_a_root(graph: Graph, nodes: list[int], values: dict[int, Any], names: list[str]) -> bool:
    """True if an output depends on the root or logarithm of a number that is 0 for these values."""
    seeds = {graph.input(name).index: unit for name, unit in zip(names, np.eye(len(names)), strict=True)}
    try:
        require_slopes(graph, nodes, values, {node: seed for node, seed in seeds.items() if node in values}, {}, ())
    except NoSlopeError:
        return True
    return False


def _rounding(graph: Graph, nodes: list[int], leaves: dict[str, Any], moved: list[str], base: np.ndarray) -> np.ndarray:
    """Return the change of the outputs if all numbers change in their last digits: the noise of differences."""
    rng, lanes = np.random.default_rng(0), 8
    steps: dict[str, np.ndarray] = {}
    for name in moved:
        least = 0.1 if name.startswith("x.") and name != "x.mobility" else 0.0
        steps[name] = 1e-12 * rng.uniform(-1.0, 1.0, lanes) * max(abs(float(leaves[name])), least)
    beside = _answers(graph, nodes, _moved(leaves, steps), lanes)
    return np.fmax.reduce(np.abs(beside - base[:, None]), axis=1, initial=0.0)


def check_slopes(exercise: Exercise) -> None:
    """Compare tangents of the graph with central differences, where one-sided differences and other step sizes agree.

    Raises AssertionError with the output and its error.
    """
    graph, nodes, leaves = exercise.trace()
    if any(graph.name(index) == "quantise" for index in reachable(graph, nodes)):
        return  # counts as a straight line, which differences cannot show; see test_linearize.py
    moved = [name for name, value in leaves.items() if not isinstance(value, np.ndarray)]
    # seed and sample are whole numbers that select noise: their slopes mean nothing
    moved = [name for name in moved if name not in ("x.seed", "x.sample", "x.time")]
    truth = classify(graph, [], [], []).truth
    values = node_values(graph, nodes, leaves)
    if _stands_at_a_root(graph, nodes, values, moved):
        return  # √0 has no slope: nothing to compare with differences there
    base = np.array([float(values[node]) for node in nodes])
    sizes = np.abs([float(value) for value in values.values() if not isinstance(value, np.ndarray | Ring)])
    largest = np.max(sizes[np.isfinite(sizes)], initial=1e-9)
    rounding = _rounding(graph, nodes, leaves, moved, base)

    def size(name: str) -> float:
        return max(abs(float(leaves[name])), 1e-2 if name.startswith("x.") and name != "x.mobility" else 1e-6)

    # a lane for each number that moves: lanes compute the bits of floats, as another row asserts
    # 1e-6: curvature (h²) and rounding (1e-16/h) both stay far below the 1e-3 by which slopes may differ
    h = 1e-6 * np.array([size(name) for name in moved])
    steps = dict(zip(moved, np.diag(h), strict=True))
    above, below, far_above, far_below, near_above, near_below = (
        _answers(graph, nodes, _moved(leaves, {name: k * step for name, step in steps.items()}), len(moved))
        for k in (1.0, -1.0, 2.0, -2.0, _BETWEEN, -_BETWEEN)
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
        # a step twice as wide must show the same slope, or the function is too curved for a difference
        central, wide = 0.5 * (right + left), (far_above[i] - far_below[i]) / (4.0 * h)
        near = (near_above[i] - near_below[i]) / (2.0 * _BETWEEN * h)
        bent = np.maximum(np.maximum(np.abs(right - left), np.abs(central - wide)), np.abs(central - near))
        # a tangent that differs a step away stands beside a kink, where a central difference averages two slopes
        jumps = np.abs(slope - beside[i]) > 1e-3 * np.abs(slope)
        # a kink, a jump, or too curved for this step
        uneven = jumps | (bent > 1e-4 * np.maximum(np.abs(right), np.abs(left)) + blur)
        wrong = ~uneven & ~(np.abs(central - slope) <= 1e-3 * np.abs(slope) + 10 * blur)
        assert not np.any(wrong), f"output {i} by {[name for name, bad in zip(moved, wrong, strict=True) if bad]}"


def _without_denormal(values: Sequence[Any] | np.ndarray) -> list[float]:
    """Replace subnormal numbers by zeros of the same sign, as native code does."""
    numbers = np.array([float(value) for value in values])
    return list(np.where(np.abs(numbers) < 2.3e-308, np.copysign(0.0, numbers), numbers))


_BETWEEN = 0.6180339887498949  # of the step of a difference: steps of whole periods of a ripple show no slope
_UNHURRIED = (
    HealthCheck.too_slow,
    HealthCheck.data_too_large,
    HealthCheck.filter_too_much,
    HealthCheck.large_base_example,
    HealthCheck.differing_executors,
)
# no search for a smaller example: it takes minutes, and the numbers are ordinary ones already
_PHASES = (Phase.explicit, Phase.reuse, Phase.generate)
# compiling takes long: the simplest example and one more
compiled_once = settings(max_examples=2, deadline=None, suppress_health_check=_UNHURRIED, phases=_PHASES)
_LANES = st.sampled_from((8, 1))  # each is compiled anew
few = settings(compiled_once, max_examples=4)
drawn = settings(compiled_once, max_examples=6)
often = settings(compiled_once, max_examples=20)  # nothing is compiled or traced


class Rows:
    """The tests: those with the argument `block` run for all `blocks`, those with `asked` for blocks that run in a
    step.
    """

    blocks: ClassVar[tuple[type[Block], ...]] = ()

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Parametrize each test with the blocks that it applies to."""
        stepped = [block for block in self.blocks if family_of(block) in TRACED]
        # parts of the physics have no retune: a live change is one of the control
        held = [block for block in stepped if issubclass(block, RETUNED)]
        goes_on = [block for block in held if not getattr(block, "steps_live", False)]
        for name, applicable in (("block", self.blocks), ("asked", stepped), ("retuned", held), ("goes_on", goes_on)):
            if name in metafunc.fixturenames:
                metafunc.parametrize(name, applicable, ids=[member.__name__ for member in applicable])

    @drawn
    @given(data=st.data())
    def test_symbols_compute_the_same_bits_as_floats(self, asked: type[Block], data: st.DataObject) -> None:
        exercise = _exercise(data, asked)
        graph, nodes, leaves = exercise.trace()
        assert _bits(evaluate(graph, nodes, leaves)) == _bits(flat(exercise.run()))

    @drawn
    @given(data=st.data())
    def test_lanes_compute_the_same_bits_as_floats(self, asked: type[Block], data: st.DataObject) -> None:
        first = _exercise(data, asked)
        others = [
            Exercise(concrete(data.draw(variants_of(first.block, float(x.T)))), first.ask, x)
            for x in (_inputs(data), _inputs(data))
        ]
        lanes = [first, *others]
        together = Exercise(
            tree.rebuild(first.block, map(np.array, zip(*(_values(lane.block) for lane in lanes), strict=True))),
            first.ask,
            Inputs(*map(np.array, zip(*(lane.x for lane in lanes), strict=True))),
        )
        results = [np.broadcast_to(value, len(lanes)) for value in flat(together.run())]
        for i, lane in enumerate(lanes):
            assert _bits([value[i] for value in results]) == _bits(flat(lane.run()))

    @compiled_once
    @given(data=st.data())
    def test_native_code_computes_the_same_bits_as_floats(self, asked: type[Block], data: st.DataObject) -> None:
        exercise = _exercise(data, asked)
        expected = _bits(_without_denormal(flat(exercise.run())))
        lanes = data.draw(_LANES)
        results = exercise.native(lanes)
        for lane in range(lanes):
            assert _bits(_without_denormal(results[:, lane])) == expected, f"{lanes} lanes"

    @compiled_once
    @given(data=st.data())
    def test_c_computes_the_same_bits_as_floats(
        self,
        asked: type[Block],
        data: st.DataObject,
        tmp_path_factory: pytest.TempPathFactory,
    ) -> None:
        exercise = _exercise(data, asked)
        expected = _bits(_without_denormal(flat(exercise.run())))
        plan, constants, rows = exercise.plan(1)
        folder = tmp_path_factory.mktemp("c")
        # -O0 compiles fastest, and the bits must not depend on the level of optimization
        library = c_loop.compiled(c_loop.text(plan, "feeddrive_run"), folder, "-Wno-unused-parameter", "-O0")
        outputs = np.empty((len(plan.outputs), 1))
        tables = (ctypes.c_void_p * max(1, len(rows)))(*[row.ctypes.data for row in rows])
        arrays = (constants, np.empty((1, 0)), np.zeros((len(plan.memory), 1)), outputs)
        function = library.feeddrive_run
        function.restype, function.argtypes = None, [ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 5]
        function(1, 0, *(array.ctypes.data for array in arrays), ctypes.addressof(tables))
        assert _bits(_without_denormal(outputs[:, 0])) == expected

    @few
    @given(data=st.data())
    def test_slopes_are_those_of_differences(self, asked: type[Block], data: st.DataObject) -> None:
        check_slopes(_exercise(data, asked))

    @drawn
    @given(data=st.data())
    def test_start_is_a_state_as_a_step_returns_it(self, asked: type[Block], data: st.DataObject) -> None:
        answers = _exercise(data, asked).run()
        assert tree.structure(answers.start) == tree.structure(answers.after)

    @drawn
    @given(data=st.data())
    def test_a_live_change_to_the_same_numbers_changes_no_bit(self, retuned: type[Block], data: st.DataObject) -> None:
        exercise = _exercise(data, retuned)
        block, state = exercise.block, exercise.run().after
        with np.errstate(all="ignore"):
            prepared = () if issubclass(retuned, UNPREPARED) else (block.prepare(exercise.x.T),) * 2
            after = block.retune(state, block, *prepared)
        assert tree.structure(after) == tree.structure(state)
        # a zero may change its sign, which nothing in a step asks for
        values = [
            [float(value) + 0.0 for _, value in tree.leaves(compared) if not isinstance(value, Ring)]
            for compared in (state, after)
        ]
        assert _bits(values[0]) == _bits(values[1])

    @often
    @given(data=st.data())
    def test_a_live_change_to_other_numbers_makes_no_bump(self, goes_on: type[Block], data: st.DataObject) -> None:
        """Check live changes at rest and at constant speed without following error, also with a charged integrator."""
        x = _inputs(data)
        T, position, force = float(x.T), float(x.position), float(x.force)
        old = concrete(data.draw(blocks_of(goes_on, T)))
        new = concrete(data.draw(variants_of(old, T)))
        at_rest, moving = place(position, False, T, force), place(position, True, T, force)
        with np.errstate(all="ignore"):
            assert not bump(old, new, at_rest)
            assert not bump(old, new, at_rest._replace(force=np.float64(0.0)))
            assert not bump(old, without_friction(new, old), moving)
            if isinstance(old, Law):
                assert not bump(old, new, at_rest, ERRORS)

    @drawn
    @given(data=st.data())
    def test_answers_are_finite(self, asked: type[Block], data: st.DataObject) -> None:
        assert np.all(np.isfinite([float(value) for value in flat(_exercise(data, asked).run())]))

    @drawn
    @given(data=st.data())
    def test_any_values_within_the_declared_bounds_make_a_block(self, block: type[Block], data: st.DataObject) -> None:
        sample = data.draw(blocks_of(block))
        assert tree.structure(concrete(sample)) == tree.structure(sample)

    def test_it_says_what_it_is_and_what_it_computes(self, block: type[Block]) -> None:
        """Check that fields have meaning and unit, that the docstring has an equation, and that the family is known."""
        for name, declared in declarations(block).items():
            assert declared.meaning, f"{block.__name__}.{name} has no meaning"
            measure(declared.unit)
        text = block.__dict__.get("__doc__") or ""
        assert any(sign in text for sign in "=∈"), f"{block.__name__} does not say what it computes"
        known = family_of(block) in (*TRACED, *SAMPLED)
        assert known or _is_part(block, self.blocks), f"{block.__name__} is of no family and part of no block"


def _values(block: Block) -> list[Any]:
    return [value for _, value in tree.leaves(block)]


def _is_part(block: type[Block], beside: Iterable[type[Block]]) -> bool:
    """True if another block, the axis or the machine declares a part of this type."""
    owners = (*(member for members in catalogue().values() for member in members.values()), *beside, Axis, Machine)
    hints = (get_type_hints(owner)[name] for owner in owners for name in _part_names(owner))
    return any(block in part_types(hint) for hint in hints)


def _part_names(owner: type[Block]) -> list[str]:
    return [name for name, declared in declarations(owner).items() if declared.role == "part"]
