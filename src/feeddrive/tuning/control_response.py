"""Frequency response of a control and its derivatives with respect to parameters, from the simulated code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import numpy as np

from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph, Symbol
from feeddrive.loop.control import Control
from feeddrive.loop.trace import node_values
from feeddrive.loop.traced_model import push, resolved

_SPEED = 0.05  # m/s of the operating point
_AT_ONE = 1e-5  # of |z|: a pole this near counts as 1, since a double pole is known only to the square root of rounding
_READINGS = ("reading_motor", "reading_load")


class Response(NamedTuple):
    """Force over the two readings, N/m, of shape (2, lines), and its slopes, of shape (2, lines, tunables)."""

    value: np.ndarray
    slope: np.ndarray
    unstable: np.ndarray  # |ln z|/T in rad/s of each pole of the control itself that is outside of the unit circle


@dataclass(frozen=True, eq=False)
class Traced:
    """The linear model of a control as nodes of a graph: its entries that are not plain zeros, by row and column.

    Rows are the states after a sample and the force, columns the states before it and the two readings.
    """

    graph: Graph
    entries: tuple[tuple[int, int, int], ...]  # row, column, node
    inputs: Mapping[str, int]  # parameters by name
    states: tuple[str, ...]


_traced: dict[Any, Traced] = {}


def _trace(control: Control, begun: Any) -> Traced:
    """One sample of the control on symbols, and its forward slopes to states and readings, on symbols as well."""
    graph = Graph()

    def given(name: str) -> Number:
        return cast(Number, graph.input(name))

    rows = {name: graph.table(name, len(row)) for name, row in tree.tables(control)}
    names = [name for name, _ in tree.leaves(control)]
    symbolic = tree.with_tables(tree.rebuild(control, (given(name) for name in names)), rows)
    T = given("T")
    states = tuple(name for name, _ in tree.leaves(begun))
    state = tree.rebuild(begun, (given(f"state.{name}") for name in states))
    setpoint = Setpoint(*(given(f"set.{name}") for name in Setpoint._fields))
    motor, load = (given(name) for name in _READINGS)
    after, command = symbolic.step(symbolic.prepare(T), state, setpoint, motor, load, 1.0, T)
    ends = [graph.symbol(value).index for _, value in tree.leaves(after)] + [graph.symbol(command.applied).index]
    columns = [graph.input(f"state.{name}").index for name in states] + [graph.input(name).index for name in _READINGS]
    values = {i: Symbol(graph, i) for i in range(len(graph.nodes))}
    entries: list[tuple[int, int, int]] = []
    for j, column in enumerate(columns):
        for i, tangent in enumerate(push(graph, ends, values, {column: 1.0})):
            if tangent is not None:
                node = graph.symbol(tangent).index
                if graph.nodes[node] != ("const", (0.0).hex()):
                    entries.append((i, j, node))
    return Traced(graph, tuple(entries), {name: graph.input(name).index for name in names}, states)


class ControlResponse:
    """The response of a control on some lines, at any values of its tunables.

        u = C1 x1 + C2 x2,   C = c (z - A)⁻¹ B + d,   ∂C = w ∂A x + ∂c x + w ∂B + ∂d
        x = (z - A)⁻¹ B,   w = c (z - A)⁻¹,   z = e^(j2πfT)

    A, B, c, d are the slopes of the step to states and readings, and ∂ their slopes to the tunables, both by the
    forward rules on the law's own lines.  Guard and force limit are left out, and parts that are blended in count as
    fully active, as in `linearize`. Raises ParameterError for a law whose period is several samples.
    """

    def __init__(self, control: Control, sample_time: float, tunables: Sequence[str], velocity: float = _SPEED) -> None:
        if control.law.period() > 1:
            raise ParameterError(
                f"the law '{control.law.kind}' repeats itself only every {control.law.period()} samples: it has no "
                f"response at the actuator; set position_every = 1"
            )
        settled = tuple(block.settled() for block in control.compensation)
        control = replace(control, compensation=settled, guard=None, force_limit=None)
        for name in tunables:
            tree.declaration(control, name)
        self.T, self.tunables, self.velocity = float(sample_time), tuple(tunables), velocity
        self.control = tree.rebuild(control, (np.float64(value) for _, value in tree.leaves(control)))
        self._begun = self._start(self.control)
        key = tree.structure(control)
        if key not in _traced:
            _traced[key] = _trace(self.control, self._begun)
        self._traced = _traced[key]
        self._live = _needed(self._traced)

    def _start(self, control: Control) -> Any:
        zero = np.float64(0.0)
        setpoint = Setpoint(zero, np.float64(self.velocity), zero, zero, zero)
        before = np.float64(-self.velocity * self.T)
        with np.errstate(all="ignore"):
            return control.start(control.prepare(self.T), setpoint, before, before, np.float64(self.velocity))

    def model(self, values: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """[A B; c d] of shape (n + 1, n + 2) at values of the tunables, and slopes (n + 1, n + 2, tunables)."""
        traced = self._traced
        nodes = [node for _, _, node in traced.entries]
        found = node_values(traced.graph, nodes, self._leaves([*map(np.float64, values)]))
        count, eye = len(self.tunables), np.eye(len(self.tunables))
        seeds = {traced.inputs[name]: eye[i] for i, name in enumerate(self.tunables) if traced.inputs[name] in found}
        with np.errstate(all="ignore"):
            tangents = push(traced.graph, nodes, found, seeds)
        n = len(traced.states)
        matrix, slopes = np.zeros((n + 1, n + 2)), np.zeros((n + 1, n + 2, count))
        for (i, j, node), tangent in zip(traced.entries, tangents, strict=True):
            matrix[i, j] = found[node]
            if tangent is not None:
                slopes[i, j] = tangent
        keep, wide = self._kept()
        return matrix[np.ix_(keep, wide)], slopes[np.ix_(keep, wide)]

    def models(self, values: np.ndarray) -> np.ndarray:
        """[A B; c d] at many values of the tunables (points, tunables), in one walk, without slopes."""
        traced, n = self._traced, len(self._traced.states)
        found = node_values(traced.graph, [node for _, _, node in traced.entries], self._leaves([*values.T]))
        matrices = np.zeros((values.shape[0], n + 1, n + 2))
        for i, j, node in traced.entries:
            matrices[:, i, j] = found[node]
        keep, wide = self._kept()
        return matrices[:, keep][:, :, wide]

    def _leaves(self, values: Sequence[Any]) -> dict[str, Any]:
        """All inputs of the trace, with the tunables at numbers or at arrays of one length."""
        return {
            **dict(tree.leaves(self.control)), **dict(zip(self.tunables, values, strict=True)),
            **dict(tree.tables(self.control)), "T": np.float64(self.T),
            **{f"state.{name}": value for name, value in tree.leaves(self._begun)},
            **{f"set.{name}": np.float64(0.0) for name in Setpoint._fields}, "set.velocity": np.float64(self.velocity),
            **dict.fromkeys(_READINGS, np.float64(0.0)),
        }  # fmt: skip

    def _kept(self) -> tuple[list[int], list[int]]:
        """Rows and columns of a model without the states that do not count."""
        n = len(self._traced.states)
        return [*self._live, n], [*self._live, n, n + 1]

    def integrates(self, values: Sequence[float] | np.ndarray) -> bool:
        """Whether the control has a pole at z = 1: it then compensates a constant force completely."""
        matrix, _ = self.model(values)
        poles = np.linalg.eigvals(matrix[:-1, :-2])
        return bool(np.any(np.abs(poles - 1.0) < _AT_ONE))

    def at(self, values: Sequence[float] | np.ndarray, frequency: np.ndarray) -> Response:
        """The response and its slopes on lines in Hz up to Nyquist. Raises ParameterError if it is not finite."""
        return _response(*self.model(values), np.exp(2j * np.pi * frequency * self.T), self.T)

    def of_model(self, matrix: np.ndarray, frequency: np.ndarray) -> Response:
        """The response of one of `models` on lines in Hz, without slopes. Raises ParameterError as `at` does."""
        return _response(matrix, np.zeros((*matrix.shape, 0)), np.exp(2j * np.pi * frequency * self.T), self.T)


def _response(matrix: np.ndarray, slopes: np.ndarray, z: np.ndarray, T: float) -> Response:
    """The response of a linear model [A B; c d] of a control, and its slopes, on lines z."""
    if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(slopes))):
        raise ParameterError("the linear model of the control holds numbers that are not finite")
    n = matrix.shape[0] - 1
    A, B, c, d = matrix[:n, :n], matrix[:n, n:], matrix[n, :n], matrix[n, n:]
    x, w = resolved(A, B, c[None], z)
    value = np.einsum("i,lik->kl", c, x) + d[:, None]
    # line by line: such small products stay in one thread, which is quicker than one large product over all lines
    count, tunables = z.size, slopes.shape[2]
    by_row = slopes[:n, :n].transpose(0, 2, 1).reshape(n * tunables, n)
    moved = (by_row @ x).reshape(count, n, 2 * tunables)
    moved = moved + slopes[:n, n:].transpose(0, 2, 1).reshape(n, 2 * tunables)
    through = (w @ moved).reshape(count, tunables, 2) + slopes[n, :n].T @ x
    slope = through.transpose(2, 0, 1) + slopes[n, n:][:, None, :]
    poles = np.linalg.eigvals(A) if n else np.zeros(0)
    outside = poles[(np.abs(poles) > 1.0 + 1e-7) & np.isfinite(poles)].astype(complex)
    return Response(value, slope, np.abs(np.log(outside)) / T)


def _needed(traced: Traced) -> list[int]:
    """The states that depend on a reading and act on the force."""
    n = len(traced.states)
    links = {(i, j) for i, j, _ in traced.entries}
    reached = {i for i, j in links if j >= n and i < n}
    seen = {j for i, j in links if i == n and j < n}
    for _ in range(n):
        reached |= {i for i, j in links if i < n and j in reached}
        seen |= {j for i, j in links if j < n and i in seen}
    return sorted(reached & seen)
