"""Exact derivatives of a graph, of a traced linear model, and of a scalar cost of a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self, cast

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.language import ops, tree
from feeddrive.language.block import Number
from feeddrive.language.errors import NoSlopeError, ParameterError
from feeddrive.language.graph import Graph, Line, Symbol, arguments, reachable
from feeddrive.language.quantity import Quantity
from feeddrive.language.recent import Recent
from feeddrive.language.ring import Ring
from feeddrive.language.table import Column, Result, Table
from feeddrive.loop.engine.llvm import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.loop import Loop, Signals
from feeddrive.loop.machine import System, check_system
from feeddrive.loop.runner import STARTS, Prepared, TracedBeginning, Work, by_lane, each_axis, traced_beginning
from feeddrive.loop.simulate import checked_signals, sample_count
from feeddrive.loop.trace import Carried, Program, lengths, node, node_values


@dataclass(frozen=True, eq=False)
class TracedModel:
    """The matrix [A B; C D] of a linear model as nodes of a graph, without the entries that are constant zeros.

    Rows are the `states` followed by the outputs, columns the states followed by the inputs.  `leaves` are the graph's
    inputs by name.
    """

    graph: Graph
    states: int
    shape: tuple[int, int]
    entries: tuple[tuple[int, int, int], ...]  # row, column, node
    leaves: Mapping[str, int]

    def kept(self) -> list[int]:
        """Return the states that an input reaches and an output sees, by their index."""
        n = self.states
        links = {(i, j) for i, j, _ in self.entries}
        reached = {i for i, j in links if j >= n and i < n}
        seen = {j for i, j in links if i >= n and j < n}
        for _ in range(n):
            reached |= {i for i, j in links if i < n and j in reached}
            seen |= {j for i, j in links if j < n and i in seen}
        return sorted(reached & seen)

    def trimmed(self) -> TracedModel:
        """Return the model without states that are unreachable from the inputs or unobservable at the outputs."""
        n, kept = self.states, self.kept()
        rows = {old: new for new, old in enumerate([*kept, *range(n, self.shape[0])])}
        columns = {old: new for new, old in enumerate([*kept, *range(n, self.shape[1])])}
        entries = tuple((rows[i], columns[j], node) for i, j, node in self.entries if i in rows and j in columns)
        return replace(self, states=len(kept), shape=(len(rows), len(columns)), entries=entries)

    def at(self, values: Mapping[str, Any], names: Sequence[str] = ()) -> LinearModel:
        """Return the model for values of all leaves, with its derivatives with respect to the leaves in `names`."""
        nodes = [node for _, _, node in self.entries]
        results = node_values(self.graph, nodes, values)
        places = [(i, j) for i, j, _ in self.entries]
        matrix, slopes = np.zeros(self.shape), np.zeros((len(places), len(names)))
        for (i, j), entry in zip(places, nodes, strict=True):
            matrix[i, j] = results[entry]
        if names:
            eye = np.eye(len(names))
            seeds = {self.leaves[name]: eye[i] for i, name in enumerate(names) if self.leaves.get(name) in results}
            with np.errstate(all="ignore"):
                tangents = push(self.graph, nodes, results, seeds)
            for place, tangent in enumerate(tangents):
                if tangent is not None:
                    slopes[place] = tangent
        return LinearModel(self.states, matrix, np.array(places, int).reshape(-1, 2), slopes)


class LinearModel(NamedTuple):
    """The numerical matrix [A B; C D], the (row, column) of its traced entries, and their derivatives."""

    states: int
    matrix: np.ndarray
    places: np.ndarray
    slopes: np.ndarray

    def is_finite(self) -> bool:
        """True if all numbers are finite."""
        return bool(np.all(np.isfinite(self.matrix)) and np.all(np.isfinite(self.slopes)))

    def poles(self) -> np.ndarray:
        """Return the eigenvalues of A."""
        n = self.states
        return np.linalg.eigvals(self.matrix[:n, :n]) if n else np.zeros(0)

    def response(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return G = C (z - A)⁻¹ B + D at complex z (sampled) or s (continuous), and its derivatives with respect to
        the leaves.

            ∂G = [w 1] ∂[A B; C D] [x; 1],   x = (z - A)⁻¹ B,   w = C (z - A)⁻¹

        Shapes (points, outputs, inputs) and (points, outputs, inputs, leaves).
        """
        n = self.states
        A, B, C, D = self.matrix[:n, :n], self.matrix[:n, n:], self.matrix[n:, :n], self.matrix[n:, n:]
        x, w = resolved(A, B, C, at)
        value = C @ x + D
        if not self.slopes.shape[1]:
            return value, np.zeros((*value.shape, 0))
        p, m = D.shape
        ones = np.broadcast_to(np.eye(p), (at.size, p, p)), np.broadcast_to(np.eye(m), (at.size, m, m))
        left, right = np.concatenate([w, ones[0]], axis=2), np.concatenate([x, ones[1]], axis=1)
        rows, columns = self.places.T
        # most entries depend on no leaf that varies: only the others are multiplied
        moving = np.any(self.slopes != 0.0, axis=1)
        pairs = left[:, :, None, rows[moving]] * right[:, columns[moving], :].transpose(0, 2, 1)[:, None]
        slopes = self.slopes[moving]
        # real and imaginary part apart: half the work of a complex product with a real matrix
        return value, np.real(pairs) @ slopes + 1j * (np.imag(pairs) @ slopes)


def resolved(A: np.ndarray, B: np.ndarray, C: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (z - A)⁻¹ B of shape (points, n, inputs) and C (z - A)⁻¹ of shape (points, outputs, n)."""
    inverse = Resolvent(A, z)
    return inverse.after(B), inverse.before(C)


def _unsorted(_: complex) -> None:
    """Leave the eigenvalues of a Schur form in the order in which they were found."""


class Resolvent:
    """The resolvent (z - A)⁻¹ at many points z.

    It is computed from the Schur form of the balanced A, row by row for all points at once, as accurately as by solving
    for each point.
    """

    def __init__(self, A: np.ndarray, z: np.ndarray) -> None:
        # imported here: commands that only read files do not load scipy
        from scipy.linalg import lapack

        self.z, self.scale = z, np.zeros(0)
        if A.size:
            # balanced as in `transfer`: rounding of forces in N would swallow positions in m; without the wrappers of
            # scipy, which cost more than the factors of a matrix of ten states
            functions: Any = lapack  # made when scipy is built, so that no types are known
            balanced, _, _, self.scale, _ = functions.dgebal(A, scale=1, permute=0)
            self.form, _, _, self.vectors, _, failed = functions.zgees(_unsorted, balanced.astype(complex))
            if failed:
                raise np.linalg.LinAlgError("the Schur form of the control was not found")

    def at(self, z: np.ndarray) -> Self:
        """Return the resolvent of the same matrix at other points."""
        other = copy(self)
        other.z = z
        return other

    def after(self, B: np.ndarray) -> np.ndarray:
        """Return (z - A)⁻¹ B of shape (points, n, columns), for one B for all points or one B per point."""
        n, z = self.scale.size, self.z
        if not n:
            return np.zeros((z.size, 0, B.shape[-1]), complex)
        S, Z = self.form, self.vectors
        right = Z.conj().T @ (B / self.scale[:, None])
        # points last: each step of the back substitution runs over contiguous memory
        x = (
            np.repeat(right[:, :, None], z.size, axis=2)
            if B.ndim == 2
            else np.ascontiguousarray(right.transpose(1, 2, 0))
        )
        for i in range(n - 1, -1, -1):
            x[i] /= z - S[i, i]
            x[:i] += S[:i, i, None, None] * x[i]
        x = ((Z * self.scale[:, None]) @ x.reshape(n, -1)).reshape(x.shape)
        return np.ascontiguousarray(x.transpose(2, 0, 1))

    def before(self, C: np.ndarray) -> np.ndarray:
        """Return C (z - A)⁻¹ of shape (points, rows, n), for one C for all points or one C per point."""
        return np.ascontiguousarray(self.left(C).transpose(2, 1, 0))

    def left(self, C: np.ndarray) -> np.ndarray:
        """Return C (z - A)⁻¹ of shape (n, rows, points), for one C for all points or one C per point."""
        if not self.scale.size:
            return np.zeros((0, C.shape[-2], self.z.size), complex)
        w = self._left(C)
        return ((self.vectors.conj().T / self.scale).T @ w.reshape(len(w), -1)).reshape(w.shape)

    def between(self, C: np.ndarray, B: np.ndarray) -> np.ndarray:
        """Return C (z - A)⁻¹ B of shape (columns, rows, points), for one C and one B for all points."""
        if not self.scale.size:
            return np.zeros((B.shape[1], C.shape[0], self.z.size), complex)
        w = self._left(C)
        right = self.vectors.conj().T @ (B / self.scale[:, None])
        return (right.T @ w.reshape(len(w), -1)).reshape(-1, *w.shape[1:])

    def _left(self, C: np.ndarray) -> np.ndarray:
        """Return C (z - A)⁻¹ in the basis of the Schur form, shape (n, rows, points)."""
        n, z = self.scale.size, self.z
        S, Z = self.form, self.vectors
        left = (C * self.scale) @ Z
        w = (
            np.repeat(left.T[:, :, None], z.size, axis=2)
            if C.ndim == 2
            else np.ascontiguousarray(left.transpose(2, 1, 0))
        )
        for i in range(n):
            w[i] /= z - S[i, i]
            w[i + 1 :] += S[i, i + 1 :, None, None] * w[i]
        return w


# A tangent that is zero for all values is None and costs no operation.


def _scaled(factor: Any, tangent: Any) -> Any:
    return None if tangent is None else factor * tangent


def _sum(a: Any, b: Any) -> Any:
    return b if a is None else a if b is None else a + b


def _difference(a: Any, b: Any) -> Any:
    return a if b is None else -b if a is None else a - b


def rule(name: str, values: Sequence[Any], result: Any, tangents: Sequence[Any]) -> Any:
    """Return the tangent of one operation from its arguments' values and tangents and its result.

    At a tie of `where` the tangent is that of the selected branch.  Rounding and table reads have derivative 0, except
    `quantise`, whose derivative with respect to its first argument is taken as 1.
    """
    if all(tangent is None for tangent in tangents):
        return None
    match name:
        case "add":
            return _sum(tangents[0], tangents[1])
        case "sub":
            return _difference(tangents[0], tangents[1])
        case "mul":
            return _sum(_scaled(values[1], tangents[0]), _scaled(values[0], tangents[1]))
        case "div":
            above = _difference(tangents[0], _scaled(result, tangents[1]))
            return above / values[1]
        case "neg":
            return -tangents[0]
        case "abs":
            return ops.where(values[0] < 0.0, -tangents[0], tangents[0])
        case "sqrt":
            return tangents[0] / (2.0 * result)
        case "exp":
            return result * tangents[0]
        case "expm1":
            return (result + 1.0) * tangents[0]
        case "log":
            return tangents[0] / values[0]
        case "sin":
            return ops.cos(values[0]) * tangents[0]
        case "cos":
            return -(ops.sin(values[0]) * tangents[0])
        case "tanh":
            return (1.0 - result * result) * tangents[0]
        case "atan":
            return tangents[0] / (1.0 + values[0] * values[0])
        case "select":
            if tangents[1] is None and tangents[2] is None:
                return None
            zero = 0.0
            a = zero if tangents[1] is None else tangents[1]
            b = zero if tangents[2] is None else tangents[2]
            return ops.where(values[0], a, b)
        # a slope of 0 would open the loop at its encoder
        case "quantise":
            return tangents[0]
        case "get":  # the tangent of a ring is a ring
            return None if tangents[0] is None else tangents[0].get(values[1])
        case "put":
            ring = Ring(values[0].length) if tangents[0] is None else tangents[0]
            return None if tangents[0] is None and tangents[2] is None else ring.put(values[1], _number(tangents[2]))
        case _:
            return None


def _number(tangent: Any) -> Any:
    return 0.0 if tangent is None else tangent


def push(graph: Graph, outputs: Sequence[int], values: Mapping[int, Any], seeds: Mapping[int, Any]) -> list[Any]:
    """Return the tangents of nodes, from the tangents `seeds` of leaves; None where a node does not depend on them.

    `values` holds the value of every node: numbers, or the nodes' own symbols, whose tangents are then symbols of the
    same graph.
    """
    tangents = _tangents(graph, outputs, values, seeds)
    return [tangents.get(index) for index in outputs]


def jacobian_entries(graph: Graph, outputs: Sequence[int], inputs: Sequence[int]) -> tuple[tuple[int, int, int], ...]:
    """Return the derivatives of nodes with respect to leaves that are not always 0: place of the node, place of the
    leaf, and the node of the derivative, of each.
    """
    values = {i: Symbol(graph, i) for i in range(len(graph.nodes))}
    found: list[tuple[int, int, int]] = []
    for j, leaf in enumerate(inputs):
        for i, tangent in enumerate(push(graph, outputs, values, {leaf: 1.0})):
            if tangent is not None:
                node = graph.symbol(tangent).index
                if graph.nodes[node] != ("const", (0.0).hex()):
                    found.append((i, j, node))
    return tuple(found)


def _tangents(
    graph: Graph, outputs: Sequence[int], values: Mapping[int, Any], seeds: Mapping[int, Any]
) -> dict[int, Any]:
    """Return the tangents of all nodes that depend on the seeds."""
    pushed: dict[int, Any] = dict(seeds)
    for index in reachable(graph, outputs):
        node = graph.nodes[index]
        inner = arguments(node)
        if inner and index not in pushed:
            tangents = [pushed.get(i) for i in inner]
            if any(tangent is not None for tangent in tangents):
                pushed[index] = rule(node[0], [values[i] for i in inner], values[index], tangents)
    return pushed


def require_slopes(
    graph: Graph,
    outputs: Sequence[int],
    values: Mapping[int, Any],
    seeds: Mapping[int, Any],
    moving: Mapping[int, Any],
    kinds: Collection[str],
) -> None:
    """Raise NoSlopeError, naming the source line, if outputs depend on a root or logarithm of 0 or on a choice at its
    threshold.

    moving  seeds that an input can affect; a choice that depends only on a counter is ignored
    kinds   kinds of the blocks whose choices are checked

    A number counts as 0 if its magnitude is below its rounding error, a reading if it is below one encoder count: for s
    = 1e-17, √|s| has a slope of 1e8, which is meaningless for the loop.  A choice is at its threshold if its two
    operands are equal.  Nothing is checked for a graph without such operations, or if the numbers themselves are not
    finite.
    """
    there = [index for index in graph.lines if index in values]
    steep = [index for index in there if graph.name(index) != "select"]
    steep += [index for index in there if graph.name(index) == "select" and graph.lines[index].kind in kinds]
    if not steep:
        return
    operands = {index: _operands(graph, index) for index in steep}
    rounding = _rounding(graph, [node for index in steep for node in (index, *operands[index])], values)
    zeros = [index for index in steep if operands[index] and _at_edge(graph, index, operands[index], values, rounding)]
    if not zeros:
        return
    with np.errstate(all="ignore"):
        tangents, outside = _tangents(graph, outputs, values, seeds), _tangents(graph, outputs, values, moving)
    stack, seen = list(outputs), set(outputs)
    while stack:
        index = stack.pop()
        node = graph.nodes[index]
        inner = arguments(node)
        # a root in the branch that is not taken has no effect on the result
        if node[0] == "select":
            inner = inner[1:2] if values[inner[0]] else inner[2:3]
        new = [i for i in inner if i not in seen]
        stack += new
        seen.update(new)
    for index in zeros:
        jumps = graph.name(index) == "select"
        slopes = outside if jumps else tangents
        # a NaN counts as moving, since it is not equal to 0
        moved = any(np.any(slopes.get(i, 0.0) != 0.0) for i in operands[index])
        if index in seen and moved and (not jumps or _felt(graph, index, outputs, values)):
            raise NoSlopeError(_no_slope(graph.lines[index], graph.name(index)))


def _felt(graph: Graph, index: int, outputs: Sequence[int], values: Mapping[int, Any]) -> bool:
    """True if the derivative of an output with respect to a node is not 0."""
    with np.errstate(all="ignore"):
        tangents = push(graph, outputs, values, {index: 1.0})
    return any(
        np.any((tangent.cells if isinstance(tangent, Ring) else tangent) != 0.0)
        for tangent in tangents
        if tangent is not None
    )


def _operands(graph: Graph, index: int) -> tuple[int, ...]:
    """Return the argument of a root, or the two operands that a choice compares; empty for other conditions."""
    first = arguments(graph.nodes[index])[0]
    if graph.name(index) != "select":
        return (first,)
    return arguments(graph.nodes[first]) if graph.name(first) in ("lt", "le") else ()


def _at_edge(
    graph: Graph, index: int, operands: tuple[int, ...], values: Mapping[int, Any], rounding: Mapping[int, float]
) -> bool:
    """True if, within rounding errors, the argument of a root is 0, or a choice is at its threshold and its two values
    differ.
    """
    if len(operands) == 1:
        return bool(abs(values[operands[0]]) <= rounding[operands[0]])
    first, second = arguments(graph.nodes[index])[1:]
    if any(isinstance(values[i], Ring | bool | np.bool_) for i in (*operands, first, second)):
        return False
    apart, jump = abs(values[operands[0]] - values[operands[1]]), abs(values[first] - values[second])
    room = rounding[operands[0]] + rounding[operands[1]]
    return bool(apart <= room and jump > rounding[first] + rounding[second] + room)


def _rounding(graph: Graph, outputs: Sequence[int], values: Mapping[int, Any]) -> dict[int, float]:
    """Return the first-order rounding error of each number on which the outputs depend; for readings it is the encoder
    count.
    """
    # 4 ε: above the rounding of one operation, ε/2, and of the elementary functions
    unit, errors = 2.0**-50, dict[int, float]()
    for index in reachable(graph, outputs):
        node, value = graph.nodes[index], values[index]
        if isinstance(value, Ring | bool | np.bool_) or np.ndim(value):
            errors[index] = 0.0
            continue
        inner = [i for i in arguments(node) if i in errors]
        match node[0]:
            case "mul":
                moved = abs(values[inner[0]]) * errors[inner[1]] + abs(values[inner[1]]) * errors[inner[0]]
            case "div":
                moved = (errors[inner[0]] + abs(value) * errors[inner[1]]) / abs(values[inner[1]])
            case "select":
                moved = errors[inner[1] if values[inner[0]] else inner[2]]
            case "quantise":
                moved = errors[inner[0]] + abs(values[inner[1]])
            case "add" | "sub" | "neg" | "abs":
                moved = sum(errors[i] for i in inner)
            case _:
                moved = 0.0
        errors[index] = float(moved + unit * abs(float(value)))
    return errors


def _no_slope(line: Line, operation: str) -> str:
    edge = {"sqrt": "a square root of 0", "log": "a logarithm of 0", "select": "a choice that jumps at its edge"}
    instead = "s / (ops.absolute(s) + small)" if operation == "select" else "s / ops.sqrt(ops.absolute(s) + small)"
    kind = "sign(s)" if operation == "select" else "√|s| sign(s)"
    return (
        f"there is no linear model at this operating point: {edge[operation]} has no finite slope ({line}). "
        "Poles, margins, tuning by them and certificates need one; simulation and export do not. Judge the law by "
        f"simulated runs, or give it a finite slope there: for {kind} write {instead}"
    )


LANES = 8  # tangents that share a vector
COST = "gradient.cost"


def squared_error(signals: Any) -> Any:
    """Return the default objective: the squared tracking error, m²; for a machine the sum over its axes."""
    if isinstance(signals, Signals):
        return signals.tracking_error * signals.tracking_error
    total: Any = None
    for signal in signals.values():
        square = signal.tracking_error * signal.tracking_error
        total = square if total is None else total + square
    return total


@dataclass(frozen=True, eq=False, repr=False)
class Gradient(Result):
    """The mean of an objective over a run, and its derivatives by parameter name."""

    cost: float
    gradient: Mapping[str, float]
    values: Mapping[str, float]

    def table(self) -> Table:
        """Return a table of the derivatives, with the relative change of the cost if a parameter changes by 1 %."""
        rows = []
        for name, slope in self.gradient.items():
            share = slope * self.values[name] / self.cost if self.cost else float("nan")
            rows.append([name, self.values[name], slope, Quantity(0.01 * share, "share", form="+.4f")])
        columns = ["parameter", Column("value", form="6"), Column("d cost / d value", form="6"), "cost for +1 %"]
        return Table(f"cost {Quantity(self.cost):6}", columns, rows)


_gradients: Recent[Native] = Recent(64)


def gradient(
    loop: System,
    reference: Reference | Mapping[str, Reference],
    parameters: Sequence[str],
    *,
    objective: Callable[[Any], Any] = squared_error,
    load: Load | Mapping[str, Load] | None = None,
    duration: float | None = None,
    start: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
    arithmetic: str = "exact",
) -> Gradient:
    """Return the mean of `objective(signals)` over a run and its derivatives with respect to parameters by path.

    Paths are those of the loop, such as `axis.x.control.law.Kv`.  The tangents are computed during the run (forward
    mode), eight at a time as one vector.  `objective` is plain arithmetic on the `Signals` of one sample; for a machine
    its argument is a mapping from axis names to `Signals`.  Quantizers are replaced by their slope 1; friction is
    differentiated in its present state, stuck or sliding, with the instants of sticking held fixed.  Therefore tune
    with `Regularised` friction, and verify the result with the actual friction.
    For a dead time of a whole number of substeps, the derivative is the right-hand one.
    Raises ParameterError for an unknown name, and for `sample_time`, which is a constant of the design; NoSlopeError if
    a root or logarithm of 0 during the run makes the gradient infinite or undefined.
    """
    check_system(loop)
    checked_signals(loop, (), arithmetic)
    if isinstance(parameters, str):
        raise ParameterError(f"parameters must be a list of paths: [{parameters!r}]")
    names = tuple(tree.name_of(loop, path) for path in parameters)
    for name in names:
        if name.rpartition(".")[2] == "sample_time":
            raise ParameterError(
                "sample_time is a constant of the design: the reference is sampled with it, no gradient"
            )
    work = Work(loop, reference, load)
    count = sample_count(work, duration)
    # the graph of a dead time of whole samples has no fraction, which the derivative needs
    delayed = [axis for axis, name in _dead_times(loop).items() if name in names]
    prepared = Prepared(loop, work.first(), start, seed, partial=delayed)
    program = prepared.program(load=work.load)
    seeds, first = _seeds(loop, prepared, work.first(), start, names)
    key = (program.key, objective, frozenset(seeds), frozenset(first), arithmetic)

    def differentiated() -> Native:
        augmented = _augmented(loop, program, objective, frozenset(seeds), frozenset(first))
        varying = [f"d.{name}" for name in (*seeds, *first)]
        return native(plan(augmented, lanes=LANES, varying=varying, arithmetic=arithmetic))

    derivative = _gradients.get(key, differentiated)
    inputs, slopes, cost = work.inputs(derivative, 0, count), [], 0.0
    for begin in range(0, len(parameters), LANES):
        part = slice(begin, min(begin + LANES, len(parameters)))
        numbers = {**prepared.numbers, **{f"d.{name}": row for name, row in seeds.items()}}
        states = {**prepared.first, COST: 0.0, **{f"d.{name}": row for name, row in first.items()}}
        constants = by_lane([name for name, _ in derivative.plan.constants], numbers, LANES, part)
        carried = {name: states.get(name, 0.0) for name in derivative.plan.memory}
        memory = by_lane(list(carried), carried, LANES, part)
        derivative.run(count, 0, constants, inputs, memory, None, prepared.rows(derivative))
        places = {state.name: i for i, state in enumerate(derivative.plan.states)}
        cost = float(memory[places[COST], 0]) / count
        # a cost that no parameter reaches has no tangent in the program
        row = memory[places[f"d.{COST}"]] if f"d.{COST}" in places else np.zeros(LANES)
        slopes.extend(row[: part.stop - part.start] / count)
    graph = program.graph
    roots = sorted({str(line) for index, line in graph.lines.items() if graph.name(index) != "select"})
    if math.isfinite(cost) and not np.all(np.isfinite(slopes)) and roots:
        raise NoSlopeError(
            f"the cost of this run has no finite gradient: a root or logarithm came to 0 in it, where it has no finite "
            f"slope ({'; '.join(roots)}). Take differences of runs, or give it a finite slope at 0"
        )
    values = {name: float(tree.get(loop, name)) for name in parameters}
    return Gradient(cost, dict(zip(parameters, map(float, slopes), strict=True)), values)


def _dead_times(loop: System) -> dict[str, str]:
    """Return the parameter name of the dead time of each axis."""
    if isinstance(loop, Loop):
        return {loop.name: "axis.actuator.dead_time"}
    return {axis: f"axis.{axis}.actuator.dead_time" for axis in loop.axes()}


def _signals(loop: System, program: Program) -> Any:
    """Return the signals of a sample as symbols; for a machine by axis."""

    def row(port: str) -> Signals:
        symbols = (Symbol(program.graph, program.outputs[f"{port}{name}"]) for name in Signals._fields)
        return Signals(*(cast(Number, symbol) for symbol in symbols))

    if isinstance(loop, Loop):
        return row("")
    return {axis: row(port) for axis, port in zip(loop.loops(), loop.ports(), strict=True)}


def _augmented(
    loop: System, program: Program, objective: Callable[[Any], Any], seeded: frozenset[str], started: frozenset[str]
) -> Program:
    """Return the program extended by the accumulated cost and the tangents of the states that depend on parameters."""
    graph = program.graph
    summed = graph.input(f"state.{COST}") + objective(_signals(loop, program))
    states = [*program.states, Carried(COST, graph.input(f"state.{COST}").index, summed.index)]
    tangents = {name: graph.input(f"d.{name}").index for name in seeded}
    ends = [state.after for state in states]
    moving = set(started)
    # a state reached in one sample may carry the tangent to others in the next: repeat until no state is added
    while True:
        seeds = {program.constants[name]: Symbol(graph, node) for name, node in tangents.items()}
        seeds |= {s.before: _tangent(graph, s) for s in states if s.name in moving}
        values = {i: _value(graph, i) for i in range(len(graph.nodes))}
        pushed = push(graph, ends, values, seeds)
        reached = {s.name for s, tangent in zip(states, pushed, strict=True) if tangent is not None}
        if reached <= moving:
            break
        moving |= reached
    carried = [
        Carried(f"d.{s.name}", node(graph, _tangent(graph, s)), node(graph, tangent))
        for s, tangent in zip(states, pushed, strict=True)
        if s.name in moving and tangent is not None
    ]
    constants = {**program.constants, **{f"d.{name}": node for name, node in tangents.items()}}
    return replace(program, states=(*states, *carried), constants=constants).keeping(())


def _tangent(graph: Graph, state: Carried) -> Any:
    """Return the symbol for the tangent of a state at the start of a sample."""
    size = lengths(graph, state.before)
    name = f"state.d.{state.name}"
    return graph.input(name) if size is None else Ring(size, graph.ring(name, size))


def _value(graph: Graph, index: int) -> Any:
    size = lengths(graph, index)
    return Symbol(graph, index) if size is None else Ring(size, Symbol(graph, index))


_traced: Recent[TracedBeginning] = Recent(64)


def _seeds(
    loop: System, prepared: Prepared, setpoint: Any, start: Any, parameters: tuple[str, ...]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the nonzero derivatives of constants and initial states with respect to the parameters, each of shape
    (parameters,).

    They come from the trace of `prepare` and `start`, which run once before the simulation.
    """
    if start is None:
        start = each_axis(lambda at: (at.position, at.velocity), setpoint)
    key = (tree.structure(loop), prepared.timing)
    graph, constants, states = _traced.get(key, lambda: traced_beginning(loop, prepared.timing))
    leaves = {
        **prepared.numbers,
        **_starts(setpoint, start),
    }
    eye = np.eye(len(parameters))
    inputs = {name: graph.input(name).index for name in parameters}
    dependent = _dependent(graph, set(inputs.values()))
    ends = {name: node for name, node in {**constants, **states}.items() if node in dependent}
    values = node_values(graph, list(ends.values()), leaves)
    seeds = {node: eye[i] for i, node in enumerate(inputs.values()) if node in values}
    with np.errstate(all="ignore"):
        pushed = dict(zip(ends, push(graph, list(ends.values()), values, seeds), strict=True))
    tangents = {name: eye[i] for i, name in enumerate(parameters)}
    tangents |= {name: _row(pushed[name], eye) for name in constants if pushed.get(name) is not None}
    first = {name: _row(pushed[name], eye) for name in states if pushed.get(name) is not None}
    return tangents, {name: row for name, row in first.items() if np.any(row)}


def _row(tangent: Any, eye: np.ndarray) -> np.ndarray:
    return np.array(np.broadcast_to(tangent, eye.shape[:1]), dtype=float)


def _dependent(graph: Graph, leaves: set[int]) -> set[int]:
    """Return the nodes that depend on any of the leaves."""
    dependent = set(leaves)
    for index, operation in enumerate(graph.nodes):
        if any(i in dependent for i in arguments(operation)):
            dependent.add(index)
    return dependent


def _starts(setpoint: Any, start: Any) -> dict[str, Any]:
    """Return the numbers of the first setpoint and of the start state by name; for a machine the names are prefixed by
    the axis.
    """
    if isinstance(setpoint, Mapping):
        rows = {axis: _starts(one, start[axis]) for axis, one in setpoint.items()}
        return {f"{axis}.{name}": value for axis, row in rows.items() for name, value in row.items()}
    values = (*start, *setpoint)
    return dict(zip(STARTS, map(np.float64, values), strict=True))
