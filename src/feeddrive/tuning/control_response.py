"""The frequency response of a controller, with its derivatives with respect to the tunables.

One sample of the controller is traced symbolically and linearized.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph, Symbol, reachable
from feeddrive.language.recent import Recent
from feeddrive.loop.control import Control
from feeddrive.loop.engine.llvm import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.gradient import Resolvent, jacobian_entries, push, require_slopes
from feeddrive.loop.linearize import MOST
from feeddrive.loop.runner import PAYS_AFTER
from feeddrive.loop.trace import Program, node_values
from feeddrive.tuning.periodic_response import periodic_response

READINGS = ("reading_motor", "reading_load")


@dataclass(frozen=True, eq=False)
class TracedControl:
    """The linear model of a controller as nodes of a graph, for all matrix entries that are not always zero.

    The rows of the matrix are the states after a sample and the force; the columns are the states before the sample and
    the two readings.
    """

    graph: Graph
    entries: tuple[tuple[int, int, int], ...]  # row, column, node
    inputs: Mapping[str, int]  # parameters by name
    states: tuple[str, ...]
    after: tuple[int, ...]  # nodes of the states after a sample
    force: int  # node of the command
    _walks: dict[tuple[str, ...], Walk] = field(default_factory=dict)

    def walk(self, tunables: tuple[str, ...]) -> Walk:
        """Return the evaluator of the matrix entries and their derivatives with respect to a set of tunables.

        The evaluator is cached, together with its machine code.
        """
        return self._walks.setdefault(tunables, Walk(self, tunables))


_traced: Recent[TracedControl] = Recent(64)


def traced_control(control: Control, begun: Any) -> TracedControl:
    """Return the linearized model of one controller update from the state `begun`; models are cached by structure."""
    return _traced.get(tree.structure(control), lambda: _trace(control, begun))


def _trace(control: Control, begun: Any) -> TracedControl:
    """Trace one sample of the controller symbolically, with forward derivatives with respect to states and readings."""
    graph = Graph()

    def symbol(name: str) -> Number:
        return cast(Number, graph.input(name))

    rows = {name: graph.table(name, len(row)) for name, row in tree.tables(control)}
    names = [name for name, _ in tree.leaves(control)]
    symbolic = tree.with_tables(tree.rebuild(control, (symbol(name) for name in names)), rows)
    T = symbol("T")
    states = tuple(name for name, _ in tree.leaves(begun))
    state = tree.rebuild(begun, (symbol(f"state.{name}") for name in states))
    setpoint = Setpoint(*(symbol(f"set.{name}") for name in Setpoint._fields))
    motor, load = (symbol(name) for name in READINGS)
    after, command = symbolic.step(symbolic.prepare(T), state, setpoint, motor, load, 1.0, T)
    ends = [graph.symbol(value).index for _, value in tree.leaves(after)] + [graph.symbol(command.applied).index]
    columns = [graph.input(f"state.{name}").index for name in states] + [graph.input(name).index for name in READINGS]
    derived = jacobian_entries(graph, ends, columns)
    places = {name: graph.input(name).index for name in names}
    return TracedControl(graph, derived, places, states, tuple(ends[:-1]), ends[-1])


class Walk:
    """The evaluator of the matrix entries of a traced controller and their derivatives with respect to the tunables.

    The first evaluations of a structure run in Python. Later ones run as machine code, compiled from the same graph and
    its symbolic derivatives; the results are bit-identical, and the evaluation is 100 to 1000 times faster.
    """

    def __init__(self, traced: TracedControl, tunables: tuple[str, ...]) -> None:
        self.traced, self.tunables = traced, tunables
        self._nodes = [node for _, _, node in traced.entries]
        kinds = {traced.graph.nodes[i][0] for i in reachable(traced.graph, self._nodes)}
        # the compiled program has no tables and no ring buffers
        self._seen, self._possible = 0, not kinds & {"table", "ring"}
        self._native: tuple[Native, list[str]] | None = None

    def at(self, leaves: Mapping[str, Any], points: int, *, with_slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrix entries (points, entries) and, if requested, their derivatives (points, entries, tunables).

        leaves  all inputs of the trace by name: one value each, or one value per point
        """
        self._seen += points
        if not self._possible or self._seen <= PAYS_AFTER:
            return self._in_python(leaves, points, with_slopes=with_slopes)
        code, names = self._native = self._native or self._compiled()
        rows = np.empty((points, len(names)))
        for i, name in enumerate(names):
            rows[:, i] = leaves[name]
        nothing, answers = np.empty((1, 0)), np.empty((points, 1 + len(self.tunables), len(self._nodes)))
        for row, answer in zip(rows, answers, strict=True):
            code.run(1, 0, row, nothing, nothing[0], answer, ())
        slopes = answers[:, 1:].transpose(0, 2, 1)
        return answers[:, 0], slopes if with_slopes else slopes[:, :, :0]

    def _in_python(self, leaves: Mapping[str, Any], points: int, *, with_slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        traced, count = self.traced, len(self.tunables) if with_slopes else 0
        numbers = node_values(traced.graph, self._nodes, leaves)
        values, slopes = np.zeros((points, len(self._nodes))), np.zeros((points, len(self._nodes), count))
        for i, node in enumerate(self._nodes):
            values[:, i] = numbers[node]
        if count:
            eye, places = np.eye(count)[:, :, None], [traced.inputs[name] for name in self.tunables]
            seeds = {place: one for place, one in zip(places, eye, strict=True) if place in numbers}
            with np.errstate(all="ignore"):
                tangents = push(traced.graph, self._nodes, numbers, seeds)
            for i, tangent in enumerate(tangents):
                if tangent is not None:
                    slopes[:, i] = np.broadcast_to(tangent, (count, points)).T
        return values, slopes

    def _compiled(self) -> tuple[Native, list[str]]:
        """Return the machine code of the evaluation and the names of its inputs.

        It evaluates the matrix entries of the linear model and their derivatives with respect to each tunable.
        """
        graph = self.traced.graph
        values = {i: Symbol(graph, i) for i in range(len(graph.nodes))}
        ends = [*self._nodes]
        for name in self.tunables:
            tangents = push(graph, self._nodes, values, {self.traced.inputs[name]: 1.0})
            ends += [graph.symbol(0.0 if tangent is None else tangent).index for tangent in tangents]
        names = [node[1] for node in (graph.nodes[i] for i in reachable(graph, ends)) if node[0] == "input"]
        program = Program(
            graph=graph,
            constants={name: graph.input(name).index for name in names},
            inputs={},
            states=(),
            outputs={str(place): node for place, node in enumerate(ends)},
            sample=None,
            tables={},
        )
        return native(plan(program), flush=False, quick=True), names


def needed(traced: TracedControl) -> list[int]:
    """Return the indices of the states that both depend on a reading and affect the force."""
    n = len(traced.states)
    links = {(i, j) for i, j, _ in traced.entries}
    reached = {i for i, j in links if j >= n and i < n}
    seen = {j for i, j in links if i == n and j < n}
    for _ in range(n):
        reached |= {i for i, j in links if i < n and j in reached}
        seen |= {j for i, j in links if j < n and i in seen}
    return sorted(reached & seen)


# of |z|: a pole this near 1 counts as 1, since a double pole is only known to √ of the rounding error
_AT_ONE = 1e-5
_NEAR = 3  # images on either side of a line that are used where the nearest ones suffice
Axis = Callable[[np.ndarray], np.ndarray]  # frequency in Hz -> responses from command to motor and load readings, m/N


_ON_CIRCLE = 1e-7  # of |z|: a pole this near to the unit circle counts as one on it


class Response(NamedTuple):
    """The frequency response of a controller from the two readings to the force, N/m, with its derivatives.

    value  the response, shape (2, lines)
    slope  its derivatives with respect to the tunables, shape (2, lines, tunables)
    """

    value: np.ndarray
    slope: np.ndarray
    samples: np.ndarray  # [A B; c d] of each sample of a period
    rest: np.ndarray | None = None  # det(1 + L) of the images of each line, of a multirate control
    period: int = 1  # period of the control in samples
    poles: np.ndarray = np.zeros(0)  # of a multirate control itself, over a period

    def growth(self, T: float) -> np.ndarray:
        """Return |ln z|/T in rad/s of each pole of the control itself outside the unit circle; T is a sample."""
        poles = self._own
        # rounding puts the pole of an integrator on either side of 1
        outside = poles[(np.abs(poles) > 1.0 + _ON_CIRCLE) & np.isfinite(poles)].astype(complex)
        return np.abs(np.log(outside)) / (self.period * T)

    @property
    def swings(self) -> np.ndarray:
        """The decaying oscillatory poles of the control itself; none of a multirate control."""
        poles = self._own if self.period == 1 else np.zeros(0)
        return poles[(np.abs(poles) < 1.0 + _ON_CIRCLE) & (np.imag(poles) != 0.0)]

    @property
    def _own(self) -> np.ndarray:
        # computed where they are asked for: the loop of a model is judged by its own poles
        if self.period > 1:
            return self.poles
        n = self.samples.shape[1] - 1
        return np.linalg.eigvals(self.samples[0, :n, :n]) if n else np.zeros(0)


class ControlResponse:
    """The frequency response of a controller on given lines, for any values of its tunables.

        u = C1 x1 + C2 x2,   C = c (z - A)⁻¹ B + d,   ∂C = w ∂A x + ∂c x + w ∂B + ∂d
        x = (z - A)⁻¹ B,   w = c (z - A)⁻¹,   z = e^(j2πfT)

    u is the force, x1 and x2 are the readings of motor and load. A, B, c, d are the derivatives of the step with
    respect to states and readings, and ∂ denotes their derivatives with respect to the tunables. Both are obtained by
    forward differentiation of the code of the law. Guard and force limit are left out, and blocks with a blend-in time
    count as fully active, as in `linearize`.

    For a multirate law with a period of N samples, the response at f includes the feedback of the images f + k/(NT)
    through the loop of the same controller and the axis (`periodic_response`).

    Source: lifting as in `Lifted`.  Raises ParameterError for a period of more than 64 samples.
    """

    def __init__(self, control: Control, sample_time: float, tunables: Sequence[str], velocity: float = 0.05) -> None:
        if control.law.scheduled_at():
            raise ParameterError(
                f"the response of the law '{control.law.kind}' depends on the position of the axis: tune it over the "
                f"travel (feeddrive travel, tuning.tune_travel), or take the law of one position (tuning.frozen)"
            )
        self.period = control.law.period()
        if self.period > MOST:
            raise ParameterError(
                f"the period of the law '{control.law.kind}' is {self.period} samples: its response is computed for at "
                f"most {MOST}; set position_every <= {MOST}"
            )
        settled = tuple(block.settled() for block in control.compensation)
        control = replace(control.unlimited(), compensation=settled)
        for name in tunables:
            tree.declaration(control, name)
        self.T, self.tunables, self.velocity = float(sample_time), tuple(tunables), velocity
        self.control = tree.rebuild(control, (np.float64(value) for _, value in tree.leaves(control)))
        self._begun = self._start(self.control)
        self._traced = traced_control(self.control, self._begun)
        self._walk = self._traced.walk(self.tunables)
        # states without effect on the force may have poles at 1, which would count as integrators
        self._live = needed(self._traced)
        self._last: tuple[tuple[bytes, bool], tuple[np.ndarray, np.ndarray]] | None = None
        self._states: dict[str, np.ndarray] | None = None
        self._resolved: tuple[np.ndarray, Resolvent] | None = None
        # only roots, logarithms and selections store their lines: without them every slope is finite
        self._has_slopes = not self._traced.graph.lines

    def _start(self, control: Control) -> Any:
        zero = np.float64(0.0)
        setpoint = Setpoint(zero, np.float64(self.velocity), zero, zero, zero)
        # the axis slides: one sample before position 0 it was v T behind
        before = np.float64(-self.velocity * self.T)
        with np.errstate(all="ignore"):
            return control.start(control.prepare(self.T), setpoint, before, before, np.float64(self.velocity))

    def is_admissible(self, values: Sequence[float] | np.ndarray) -> bool:
        """Return True if the blocks of the controller accept the sample time with these values of the tunables."""
        changed = dict(zip(self.tunables, map(float, values), strict=True))
        try:
            tree.check_sampled(tree.vary(self.control, changed), self.T)
        except ParameterError:
            return False
        return True

    def images(self, axis: Axis | None, frequency: np.ndarray) -> np.ndarray | None:
        """Return the axis response at the images f + k/(NT) of the lines f in Hz, shape (2, lines, N - 1).

        The result is None for a single-rate law.
        """
        if self.period == 1 or axis is None:
            return None
        rate = 1.0 / self.T
        # a sampled response repeats with the sample rate and is conjugate symmetric about half of it
        there = (frequency[:, None] + rate / self.period * np.arange(1, self.period)) % rate
        beyond = there > 0.5 * rate
        response = axis(np.where(beyond, rate - there, there).ravel()).reshape(2, *there.shape)
        return np.where(beyond, np.conj(response), response)

    def model(self, values: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the linear model [A B; c d], shape (n + 1, n + 2), for values of the tunables, and its derivatives.

        The derivatives have shape (n + 1, n + 2, tunables). For a multirate law the model is that of the first sample
        of a period.
        """
        matrices, slopes = self._matrices(self._leaves([*map(np.float64, values)]), 1, with_slopes=True)
        # once: the operating point is the same for all values
        if not self._has_slopes:
            self._require_slopes(values)
            self._has_slopes = True
        return matrices[0], slopes[0]

    def _matrices(self, leaves: dict[str, Any], points: int, *, with_slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return [A B; c d] for several sets of inputs and, if requested, its derivatives."""
        values, changes = self._walk.at(leaves, points, with_slopes=with_slopes)
        n, (rows, columns, _) = len(self._traced.states), zip(*self._traced.entries, strict=True)
        matrices, slopes = np.zeros((points, n + 1, n + 2)), np.zeros((points, n + 1, n + 2, changes.shape[2]))
        matrices[:, rows, columns], slopes[:, rows, columns] = values, changes
        keep, wide = self._kept()
        return matrices[:, keep][:, :, wide], slopes[:, keep][:, :, wide]

    def _require_slopes(self, values: Sequence[float] | np.ndarray) -> None:
        """Raise NoSlopeError, with the line of the law, if an undefined derivative makes the model infinite or NaN."""
        traced, columns = self._traced, [*(f"state.{name}" for name in self._traced.states), *READINGS]
        ends, eye = [*traced.after, traced.force], np.eye(len(columns))
        numbers = node_values(traced.graph, ends, self._leaves([*map(np.float64, values)]))
        places = (traced.graph.input(name).index for name in columns)
        seeds = {node: eye[i] for i, node in enumerate(places) if node in numbers}
        require_slopes(traced.graph, ends, numbers, seeds, seeds, {self.control.law.kind})

    def _samples(self, values: Sequence[float] | np.ndarray, with_slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the linear models of all N samples of a period, shape (N, n + 1, n + 2), and requested derivatives.

        All samples are computed in one evaluation.
        """
        leaves = self._leaves([*map(np.float64, values)]) | self._followed()
        return self._matrices(leaves, self.period, with_slopes=with_slopes)

    def _followed(self) -> dict[str, np.ndarray]:
        """Return, by name, the values of each state before the samples of a period, shape (N,)."""
        if self._states is None:
            traced, leaves = (
                self._traced,
                self._leaves([dict(tree.leaves(self.control))[name] for name in self.tunables]),
            )
            rows: list[list[Any]] = []
            for _ in range(self.period):
                rows.append([leaves[f"state.{name}"] for name in traced.states])
                numbers = node_values(traced.graph, traced.after, leaves)
                leaves |= {
                    f"state.{name}": numbers[node] for name, node in zip(traced.states, traced.after, strict=True)
                }
            self._states = {f"state.{name}": np.array([row[i] for row in rows]) for i, name in enumerate(traced.states)}
        return self._states

    def models(self, values: np.ndarray) -> np.ndarray:
        """Return [A B; c d] for many sets of tunables (points, tunables) in one evaluation, without derivatives."""
        return self._matrices(self._leaves([*values.T]), len(values), with_slopes=False)[0]

    def _leaves(self, values: Sequence[Any]) -> dict[str, Any]:
        """Return all inputs of the trace, with the tunables as numbers or as arrays of equal length."""
        return self._usual | dict(zip(self.tunables, values, strict=True))

    @cached_property
    def _usual(self) -> dict[str, Any]:
        """All inputs of the trace, with the tunables at their start values."""
        return {
            **dict(tree.leaves(self.control)),
            **dict(tree.tables(self.control)),
            "T": np.float64(self.T),
            **{f"state.{name}": value for name, value in tree.leaves(self._begun)},
            **{f"set.{name}": np.float64(0.0) for name in Setpoint._fields},
            "set.velocity": np.float64(self.velocity),
            **dict.fromkeys(READINGS, np.float64(0.0)),
        }

    def _kept(self) -> tuple[list[int], list[int]]:
        """Return the rows and columns of the full model that remain: states with an effect, force and readings."""
        n = len(self._traced.states)
        return [*self._live, n], [*self._live, n, n + 1]

    def integrates(self, values: Sequence[float] | np.ndarray) -> bool:
        """Return True if the controller has a pole at z = 1 and so rejects a constant force completely."""
        product = np.eye(len(self._live))
        for matrix in self.model(values)[:1] if self.period == 1 else self._samples(values, with_slopes=False)[0]:
            product = matrix[:-1, :-2] @ product
        # only whole periods have poles: the matrices of single samples need not be stable
        poles = np.linalg.eigvals(product)
        return bool(np.any(np.abs(poles - 1.0) < _AT_ONE))

    def at(
        self,
        values: Sequence[float] | np.ndarray,
        frequency: np.ndarray,
        images: np.ndarray | None = None,
        *,
        near: bool = False,
        slopes: bool = True,
        alike: bool = False,
    ) -> Response:
        """Return the response and its derivatives on lines in Hz up to the Nyquist frequency.

        Raises ParameterError if the response is not finite.

        images  for a multirate law: axis response at the images of these lines (method `images`); without it the loops
                at the images are left open, which makes no difference far below the slow sample rate of the law
        near    for a multirate law: True to use only the nearest images
        slopes  for a multirate law: False to omit the derivatives
        alike   for a multirate law: True if both readings are those of one encoder; the response is then given as that
                to the load reading, and costs less
        """
        if self.period > 1:
            return self._over_a_period(values, frequency, images, near, slopes, alike)
        matrix, changes = self.model(values)
        _require_finite(matrix, changes)
        n = len(matrix) - 1
        return _response(matrix, changes, Resolvent(matrix[:n, :n], np.exp(2j * np.pi * frequency * self.T)))

    def of_model(self, matrix: np.ndarray, frequency: np.ndarray) -> Response:
        """Return the response of a linear model from `models` on lines in Hz, without derivatives.

        Raises ParameterError like `at`.
        """
        z = np.exp(2j * np.pi * frequency * self.T)
        # a look asks first for the lines of the model and then for those of the plants of a box
        if self._resolved is None or self._resolved[0] is not matrix:
            _require_finite(matrix)
            n = len(matrix) - 1
            self._resolved = matrix, Resolvent(matrix[:n, :n], z)
        return _response(matrix, np.zeros((*matrix.shape, 0)), self._resolved[1].at(z))

    def _over_a_period(
        self,
        values: Sequence[float] | np.ndarray,
        frequency: np.ndarray,
        images: np.ndarray | None,
        near: bool,
        with_slopes: bool,
        alike: bool,
    ) -> Response:
        """Compute the result of `at` for a multirate law."""
        samples, slopes = self._kept_samples(values, with_slopes)
        N, most = self.period, _NEAR if near else self.period
        _require_finite(samples, slopes)
        closed = [] if images is None else [k for k in range(1, N) if k <= most or k >= N - most]
        axis = np.zeros((2, frequency.size, 0)) if images is None else images[:, :, np.array(closed, int) - 1]
        if alike:
            whole = periodic_response(_as_one(samples), _as_one(slopes), frequency * self.T, closed, axis[1:])
            # the motor's share is in that of the load reading
            value, slope = (np.concatenate([np.zeros_like(part), part]) for part in (whole.value, whole.slope))
            whole = whole._replace(value=value, slope=slope)
        else:
            whole = periodic_response(samples, slopes, frequency * self.T, closed, axis)
        return Response(whole.value, whole.slope, samples, whole.rest, N, whole.poles)

    def of_a_period(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return [A B; c d] of each sample of a period, shape (N, n + 1, n + 2)."""
        return self._kept_samples(values, False)[0]

    def _kept_samples(self, values: Sequence[float] | np.ndarray, with_slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the cached result of `_samples`, which is needed both for the lines of a point and below them."""
        key = (np.asarray(values, float).tobytes(), with_slopes)
        if self._last is None or self._last[0] != key:
            self._last = key, self._samples(values, with_slopes)
        return self._last[1]


def _as_one(samples: np.ndarray) -> np.ndarray:
    """Return [A B; c d] of each sample, or its derivatives, with one reading in place of two that are equal."""
    n = samples.shape[1] - 1
    return np.concatenate([samples[:, :, :n], samples[:, :, n:].sum(axis=2, keepdims=True)], axis=2)


def _require_finite(*parts: np.ndarray) -> None:
    if not all(np.all(np.isfinite(part)) for part in parts):
        raise ParameterError("the linear model of the control holds numbers that are not finite")


def _response(matrix: np.ndarray, slopes: np.ndarray, inverse: Resolvent) -> Response:
    """Return the response of a linear controller model [A B; c d] at points of the unit circle, with derivatives.

    inverse  (z - A)⁻¹ at these points
    """
    n = matrix.shape[0] - 1
    B, c, d = matrix[:n, n:], matrix[n, :n], matrix[n, n:]
    count, tunables = inverse.z.size, slopes.shape[2]
    left = inverse.left(c[None])  # (n, 1, lines)
    value = B.T @ left[:, 0] + d[:, None]
    slope = np.zeros((2, count, tunables), complex)
    if tunables:
        # few entries depend on a tunable: products of a row and a column for these alone
        rows, columns = np.nonzero(np.any(slopes != 0.0, axis=2))
        before = np.concatenate([left[:, 0], np.ones((1, count))])
        after = np.concatenate(
            [inverse.after(B).transpose(1, 2, 0), np.broadcast_to(np.eye(2)[:, :, None], (2, 2, count))]
        )
        pairs = (before[rows, None] * after[columns]).reshape(rows.size, 2 * count)
        moved = (slopes[rows, columns].T @ pairs.view(float)).view(complex)
        slope = moved.reshape(tunables, 2, count).transpose(1, 2, 0)
    return Response(value, slope, matrix[None])
