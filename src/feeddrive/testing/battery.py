"""The battery: tests that every block must pass, shipped or user-defined.

    from feeddrive.testing import battery
    from my_law import MyLaw

    TestMyLaw = battery(MyLaw)          # pytest collects the tests of this class

The tests check that floats, arrays and symbols give bit-identical results, that native code and C agree bit for bit
with Python, that the Jacobian agrees with finite differences, that all values within the declared bounds give finite
results, and more.

One test changes the parameters of a controller block live, in a steady state without following error.  The axis
follows exactly, at rest or at constant velocity, and the force commanded by a law acts in the next sample.  All outputs
of the block are then constant and must remain so after a live change, unless the new parameters require another value:
for example, compensating a larger share of a disturbance requires a different force.  The required value is the output
of the new block when started in that steady state; a compensation is started with its blended parts fully active.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, NamedTuple, get_type_hints

import numpy as np

from feeddrive.blocks import families
from feeddrive.blocks.catalogue import catalogue, family_of, required
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Block, declarations
from feeddrive.language.errors import MissingExtraError, NoSlopeError, StructureError
from feeddrive.language.graph import Graph, reachable
from feeddrive.language.quantity import Quantity
from feeddrive.language.ring import Ring
from feeddrive.language.text import Text
from feeddrive.language.units import measure
from feeddrive.loop.axis import Axis
from feeddrive.loop.engine.plan import classify
from feeddrive.loop.gradient import push, require_slopes
from feeddrive.loop.machine import Machine
from feeddrive.loop.trace import concrete, evaluate, node_values
from feeddrive.testing import exercise as c_loop
from feeddrive.testing.exercise import SAMPLED, TRACED, Exercise, Inputs, flat, inputs, run_of
from feeddrive.testing.strategies import blocks_of, part_types, variants_of

# a power of two: sums of few of its multiples are exact in doubles, so that no rounding looks like a bump
_GRID = 2.0**-17  # m: positions on it, and their differences, are exact
ERRORS = tuple(1e-4 * k for k in (-1.5, -0.5, 0.5, 1.5, 2.5))  # m: they fill the integral of a law
# samples between the states that are compared, and outputs that are recorded on both sides of a change
SETTLING, SAMPLES = 12, 8
_SHARE = 1e-6  # of an output: far above rounding, far below what a wrong unit makes of it
_SMALL = 1e-9  # of the usual size of an output that is 0
_DIGITS = 8.0 * float(np.finfo(float).eps)
_SIZES = (1e-3, 1.0, 10.0, 1e3, 1e5)  # m, m/s, m/s², m/s³, m/s⁴ of motions
_FORCE = 1e3  # N


class Place(NamedTuple):
    """An operating point: position at sample 0 and travel per sample (m), sample time T (s) and acting force (N)."""

    position: Any
    way: Any
    T: Any
    force: Any

    def setpoint(self, sample: int, ahead: float = 0.0) -> Setpoint:
        """Return the setpoint at a sample, `ahead` m in front of the axis."""
        return Setpoint(self.position + float(sample) * self.way + ahead, self.way / self.T)

    def reading(self, sample: int, force: Any) -> Reading:
        """Return the reading at a sample while a force acts."""
        position = self.position + float(sample) * self.way
        return Reading(position, position, force, force, self.way / self.T)


def place(position: float, moves: bool, T: float, force: float) -> Place:
    """Return an operating point whose position is rounded to a grid on which differences of positions are exact."""
    return Place(*map(np.float64, (round(position / _GRID) * _GRID, _GRID if moves else 0.0, T, force)))


class Steady:
    """A block that runs at an operating point, at rest or at constant velocity, from a given sample on."""

    def __init__(self, block: Any, at: Place, sample: int = 0) -> None:
        self.block, self.at, self.sample = block, at, sample
        self._family = family_of(type(block))
        self.prepared = None if self._family in UNPREPARED else block.prepare(at.T)
        self.force = at.force  # that acts: of a law the last one that it commanded
        setpoint, reading = at.setpoint(sample), at.reading(sample, at.force)
        if self._family in UNPREPARED:
            self.state = block.start(setpoint)
        elif self._family is families.Filter:
            self.state = block.start(self.prepared, at.force)
        elif self._family is families.Observer:
            self.state = block.start(self.prepared, reading)
        else:
            self.state = block.start(self.prepared, setpoint, reading)

    def outputs(self, count: int, errors: Sequence[float] = ()) -> np.ndarray:
        """Return the outputs of the next `count` samples, one row per sample; `errors` apply to the first samples."""
        rows = [self._step(errors[k] if k < len(errors) else 0.0) for k in range(count)]
        return np.array(rows, dtype=float)

    def after(self, count: int, errors: Sequence[float] = ()) -> np.ndarray:
        """Return the numbers of the state after `count` more samples.

        Ring buffers are omitted, since their content shows up in the outputs when it is read.
        """
        self.outputs(count, errors)
        return np.array([float(value) for _, value in tree.leaves(self.state) if not isinstance(value, Ring)])

    def _step(self, error: float) -> Sequence[Any]:
        self.sample += 1
        setpoint, reading = self.at.setpoint(self.sample, error), self.at.reading(self.sample, self.force)
        block, prepared, T = self.block, self.prepared, self.at.T
        if self._family is families.Law:
            self.state, self.force = block.step(prepared, self.state, setpoint, reading, T)
            return (self.force,)
        if self._family is families.Filter:
            self.state, value = block.step(prepared, self.state, self.force)
            return (value,)
        if self._family is families.Observer:
            self.state, seen = block.step(prepared, self.state, reading, T)
            return (seen.position - reading.position_load, seen.velocity, seen.disturbance)
        if self._family is families.Compensation:
            self.state, moved, force = block.step(prepared, self.state, setpoint, reading, T)
            return (moved.position - setpoint.position, *moved[1:], force)
        self.state, outputs = block.step(self.state, setpoint, T)
        if self._family is families.Feedforward:
            return (outputs,)
        return (outputs.position - setpoint.position, *outputs[1:])

    def retune(self, new: Any) -> None:
        """Change the parameters of the block between two samples."""
        if self._family in UNPREPARED:
            self.state = new.retune(self.state, self.block)
        else:
            prepared = new.prepare(self.at.T)
            self.state, self.prepared = new.retune(self.state, self.block, self.prepared, prepared), prepared
        self.block = new


UNPREPARED = (families.Feedforward, families.Prefilter)
RETUNED = (families.Law, families.Filter, families.Observer, families.Compensation, *UNPREPARED)


def without_friction(new: Block, old: Block) -> Block:
    """Return the new block with the viscous friction of the old one, so that it needs the same force in motion."""
    pairs = zip(tree.leaves(new), tree.leaves(old), strict=True)
    values = (old if name.rpartition(".")[2].startswith("viscous") else new for (name, new), (_, old) in pairs)
    return tree.rebuild(new, values)


def bump(old: Block, new: Block, at: Place, errors: Sequence[float] = ()) -> str:
    """Return a description of the bump, an unnecessary change of a steady output, after a live change of a block.

    The description is empty if there is no bump, or if there is no steady state to compare with: for a block that
    settles slowly, for a law that does not hold the force with which it was started, and, in motion, for a new block
    that requires another output.
    """
    change = _changed(old, new, at, errors)
    if not change.settled:
        return ""
    last, required = change.before[-1], change.required
    rounding = _rounding_of_response(old, new, at, errors, change)
    near = _SHARE * np.maximum(np.abs(last), np.abs(required[0])) + _SMALL * _usual(last.size) + rounding
    # a hundredth of a bump: a slow drift must not count as one
    steady = np.all(np.abs(change.before - last) <= 0.01 * near)
    # a law that does not hold its first force still has a transient, which shows the change of gains, not of state
    if isinstance(old, families.Law) and not errors:
        steady = steady and abs(last[0] - at.force) <= near[0]
    # in motion other numbers may need another force: a change of the force is a bump only if they need the same one
    if at.way > 0.0:
        steady = steady and np.all(np.abs(required - last) <= near)
    low, high = np.minimum(last, required) - near, np.maximum(last, required) + near
    wrong = np.argwhere(~((low <= change.after) & (change.after <= high)))
    if not steady or not wrong.size:
        return ""
    sample, output = wrong[0]
    return Text(
        f"output {output} of {new.kind} was {Quantity(last[output]):9} in a steady state; {sample + 1} samples after a "
        f"live change it is {Quantity(change.after[sample, output]):9}, and started there with the new numbers it "
        f"would be {Quantity(required[sample, output]):9}: retune must return the state with which it goes on"
    )


class Change(NamedTuple):
    """The outputs around a live change.

    before, after  outputs of the samples before and after the change
    required       outputs of the new block when started in that steady state
    settled        True if the state had settled before the change
    size           largest magnitude of a number in the settled state
    """

    before: np.ndarray
    after: np.ndarray
    required: np.ndarray
    settled: bool
    size: float


def _changed(
    old: Block, new: Block, at: Place, errors: Sequence[float], wrong: float = 0.0, pattern: int = 0
) -> Change:
    """Run a live change; a nonzero `wrong` perturbs readings in their last digits and the state by this fraction.

    The sign of each number's perturbation is determined by bit `pattern` of the number's index in the state.
    """
    held = Steady(old, at)
    states = [held.after(SETTLING, errors), held.after(SETTLING), held.after(SETTLING)]
    before = held.outputs(SAMPLES)
    # a compensation fades in: the fade of a fresh start is no bump of the live change
    whole = new.settled() if isinstance(new, families.Compensation) else new
    required = Steady(whole, at._replace(force=held.force), held.sample).outputs(SAMPLES)
    if wrong:
        held.at = at._replace(position=(1.0 + _DIGITS) * at.position)
        values = [value for _, value in tree.leaves(held.state)]
        signs = [wrong if i >> pattern & 1 else -wrong for i in range(len(values))]
        moved = (v if isinstance(v, Ring) else (1.0 + sign) * v for v, sign in zip(values, signs, strict=True))
        held.state = tree.rebuild(held.state, moved)
    held.retune(new)
    settled, size = _settled(*states, exactly=len(errors) > 0), np.max(np.abs(states[-1]), initial=0.0)
    return Change(before, held.outputs(SAMPLES), required, settled, float(size))


def _rounding_of_response(old: Block, new: Block, at: Place, errors: Sequence[float], change: Change) -> np.ndarray:
    """Return how far the outputs may change because of rounding errors in readings, state and outputs.

    With a gain of 1e17 N/m, as in a predictive law with a short horizon, the change is 100 N; with a filter that
    amplifies high frequencies by 1e6 it is 0.1 N.
    """
    last = change.before[-1]
    size = np.abs(last) + _SMALL * _usual(last.size)
    off = np.abs(change.required[0] - last)
    wrong = _DIGITS * max(1.0, change.size / float(np.max(size)))
    wrong += float(np.max(np.where(off <= _SHARE * np.abs(last), off, 0.0) / size))
    # three patterns of signs: with a single one errors of two states could cancel each other
    beside = [_changed(old, new, at, errors, wrong, pattern).after for pattern in range(3)]
    return 10.0 * np.max(np.abs(np.array(beside) - change.after), axis=(0, 1))


def _settled(first: np.ndarray, second: np.ndarray, third: np.ndarray, exactly: bool) -> bool:
    """Return True if a block has settled: each number of its state changes linearly over three equidistant instants.

    A transient that remains would become visible after a change of gains.  If `exactly` is True, as after following
    errors, the three states must be bit-identical: those of an integrator are, whereas those of a slowly decaying
    observer are not.
    """
    if exactly:
        return bool(np.all(first == second) and np.all(second == third))
    largest = np.maximum(np.maximum(np.abs(first), np.abs(second)), np.abs(third))
    bent = np.abs(first - 2.0 * second + third)
    return bool(np.all(bent <= 1e-9 * largest + 1e-13 * np.max(largest, initial=0.0)))


def _usual(count: int) -> np.ndarray:
    """Return typical magnitudes of the `count` outputs of a block; the force comes last."""
    return np.array([*_SIZES[: 5 if count >= 5 else count - 1], *([_FORCE] if count != 5 else [])])


try:
    import pytest
    from hypothesis import HealthCheck, Phase, given, settings
    from hypothesis import strategies as st
except ImportError as absent:
    raise MissingExtraError(str(absent.name), "testing", "the battery of a block") from absent


def battery(*blocks: type[Block]) -> type[Rows]:
    """Return a test class for the given blocks; assign it to a name that begins with Test in a test module.

    Raises StructureError for anything but a concrete block class, and for a call within a running test, since pytest
    would then collect nothing.
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
    """Return the bytes of each number, for exact comparison; all NaN values give the same bytes."""
    numbers = np.array([float(value) for value in values])
    # the sign and payload of a NaN differ between processors and compilers
    return [b"nan" if number != number else number.tobytes() for number in numbers]


def _exercise(data: st.DataObject, block: type[Block]) -> Exercise:
    x = _inputs(data)
    return Exercise(concrete(data.draw(blocks_of(block, float(x.T)))), run_of(block), x)


def _inputs(data: st.DataObject) -> Inputs:
    return Inputs(*map(np.float64, data.draw(inputs())))


def _moved(leaves: dict[str, Any], steps: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return the leaves after adding arrays of steps to some of them."""
    return {**leaves, **{name: np.float64(leaves[name]) + step for name, step in steps.items()}}


def _answers(graph: Graph, nodes: list[int], leaves: dict[str, Any], lanes: int) -> np.ndarray:
    """Return the values of graph nodes, shape (nodes, lanes)."""
    with np.errstate(all="ignore"):
        return np.array([np.broadcast_to(v, lanes).astype(float) for v in evaluate(graph, nodes, leaves)])


def _slopes(graph: Graph, nodes: list[int], leaves: dict[str, Any], names: list[str]) -> np.ndarray:
    """Return the derivatives of graph nodes with respect to the named leaves, one column per leaf."""
    seeds = {graph.input(name).index: unit for name, unit in zip(names, np.eye(len(names)), strict=True)}
    with np.errstate(all="ignore"):
        pushed = push(graph, nodes, node_values(graph, nodes, leaves), seeds)
    return np.array([np.broadcast_to(0.0 if slope is None else slope, len(names)).astype(float) for slope in pushed])


def _stands_at_a_root(graph: Graph, nodes: list[int], values: dict[int, Any], names: list[str]) -> bool:
    """Return True if an output has no finite derivative for these values, for example because of the root of 0."""
    seeds = {graph.input(name).index: unit for name, unit in zip(names, np.eye(len(names)), strict=True)}
    try:
        require_slopes(graph, nodes, values, {node: seed for node, seed in seeds.items() if node in values}, {}, ())
    except NoSlopeError:
        return True
    return False


def _rounding(graph: Graph, nodes: list[int], leaves: dict[str, Any], moved: list[str], base: np.ndarray) -> np.ndarray:
    """Return how far the outputs change if all numbers change in their last digits: the noise of finite differences."""
    rng, lanes = np.random.default_rng(0), 8
    steps: dict[str, np.ndarray] = {}
    for name in moved:
        least = 0.1 if name.startswith("x.") and name != "x.mobility" else 0.0
        steps[name] = 1e-12 * rng.uniform(-1.0, 1.0, lanes) * max(abs(float(leaves[name])), least)
    beside = _answers(graph, nodes, _moved(leaves, steps), lanes)
    return np.fmax.reduce(np.abs(beside - base[:, None]), axis=1, initial=0.0)


def check_slopes(exercise: Exercise) -> None:
    """Compare derivatives of the graph with central differences, wherever one-sided differences and other step sizes
    agree with the central differences.

    Raises an AssertionError that names the output and the inputs for which they differ.
    """
    graph, nodes, leaves = exercise.trace()
    if any(graph.name(index) == "quantise" for index in reachable(graph, nodes)):
        # a quantizer has the slope of its straight line, which differences cannot show; see test_linearize.py
        return
    moved = [name for name, value in leaves.items() if not isinstance(value, np.ndarray)]
    # seed and sample are whole numbers that select noise: their slopes mean nothing
    moved = [name for name in moved if name not in ("x.seed", "x.sample", "x.time")]
    truth = classify(graph, [], [], []).truth
    values = node_values(graph, nodes, leaves)
    if _stands_at_a_root(graph, nodes, values, moved):
        # √0 has no slope that a difference could confirm
        return
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
        # rounding of the largest number inside, or its effect after cancellation, over the step
        blur = max(16 * 2.3e-16 * largest, 4.0 * rounding[i]) / h
        # a step twice as wide must show the same slope, or the function is too curved for a difference
        central, wide = 0.5 * (right + left), (far_above[i] - far_below[i]) / (4.0 * h)
        near = (near_above[i] - near_below[i]) / (2.0 * _BETWEEN * h)
        bent = np.maximum(np.maximum(np.abs(right - left), np.abs(central - wide)), np.abs(central - near))
        # a tangent that differs a step away indicates a kink, where a central difference averages two slopes
        jumps = np.abs(slope - beside[i]) > 1e-3 * np.abs(slope)
        # a kink, a jump, or too curved for this step
        uneven = jumps | (bent > 1e-4 * np.maximum(np.abs(right), np.abs(left)) + blur)
        wrong = ~uneven & ~(np.abs(central - slope) <= 1e-3 * np.abs(slope) + 10 * blur)
        assert not np.any(wrong), f"output {i} by {[name for name, bad in zip(moved, wrong, strict=True) if bad]}"


def _without_denormal(values: Sequence[Any] | np.ndarray) -> list[float]:
    """Replace subnormal numbers by zeros of the same sign, as native code does."""
    numbers = np.array([float(value) for value in values])
    return list(np.where(np.abs(numbers) < 2.3e-308, np.copysign(0.0, numbers), numbers))


# a step that is a whole number of periods of a ripple shows no slope: this fraction of it is none
_BETWEEN = 0.6180339887498949
_UNHURRIED = (
    HealthCheck.too_slow,
    HealthCheck.data_too_large,
    HealthCheck.filter_too_much,
    HealthCheck.large_base_example,
    HealthCheck.differing_executors,
)
# no shrinking: it takes minutes, and the drawn numbers are of ordinary size already
_PHASES = (Phase.explicit, Phase.reuse, Phase.generate)
# compilation dominates the time: the simplest example and one more
compiled_once = settings(max_examples=2, deadline=None, suppress_health_check=_UNHURRIED, phases=_PHASES)
# only two counts, since each is compiled anew
_LANES = st.sampled_from((8, 1))
few = settings(compiled_once, max_examples=4)
drawn = settings(compiled_once, max_examples=6)
often = settings(compiled_once, max_examples=20)  # nothing is compiled or traced


class Rows:
    """The tests of the battery.

    The name of a test's argument selects the blocks to which the test applies:

    block    all `blocks`
    asked    blocks that are called in each step
    retuned  blocks of these that support live changes
    goes_on  blocks of these whose output must not step at a live change
    """

    blocks: ClassVar[tuple[type[Block], ...]] = ()

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Parametrize each test with the blocks to which it applies."""
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
        # a zero may change its sign, which no step depends on
        values = [
            [float(value) + 0.0 for _, value in tree.leaves(compared) if not isinstance(value, Ring)]
            for compared in (state, after)
        ]
        assert _bits(values[0]) == _bits(values[1])

    @often
    @given(data=st.data())
    def test_a_live_change_to_other_numbers_makes_no_bump(self, goes_on: type[Block], data: st.DataObject) -> None:
        """Check live changes at rest and at constant velocity without following error, also with a nonzero integral."""
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
        """Check that each field has a meaning and a unit, the docstring has an equation, and the family is known."""
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
    """Return True if another block, the axis or the machine has a field for a part of this type."""
    owners = (*(member for members in catalogue().values() for member in members.values()), *beside, Axis, Machine)
    hints = (get_type_hints(owner)[name] for owner in owners for name in _part_names(owner))
    return any(block in part_types(hint) for hint in hints)


def _part_names(owner: type[Block]) -> list[str]:
    return [name for name, declared in declarations(owner).items() if declared.role == "part"]
