"""The memory layout of a routine on a target: the numbers that `configure` stores, and those that a step computes."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple, TypeVar

import numpy as np

from feeddrive.export.identifiers import C_WORDS, identifier
from feeddrive.language import matrix
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import ELEMENTARY, TRUTH, Graph, Symbol, arguments, reachable, rebuilt
from feeddrive.language.naming import Name
from feeddrive.loop.engine.plan import composed
from feeddrive.loop.routine import Function, Retune, Routine, target_name

# The memory layout of a routine on a target: what `configure` computes and stores, and what each step computes.
#
# A number that depends on parameters only is computed by `configure` and stored in the design, if a step or a reset
# reads it; all others are computed in every step.  With a single-precision step, `configure` still computes in double
# precision, and its results are rounded once, so that the stored numbers are the best that single precision allows.

Word = TypeVar("Word")
PRECISIONS = ("double", "float")


class Field(NamedTuple):
    """A number that `configure` computes and stores: its name, its node, and a flag that marks a truth value."""

    name: str
    node: int
    truth: bool


@dataclass(frozen=True, eq=False, repr=False)
class Layout:
    """A routine expressed in the operations that the code generators support.

    leaves   node -> (kind, index): kind is "parameter", "sample_time", "input", "state" or "table"
    moving   per node: True if it changes from sample to sample; all others are computed once by `configure`
    truth    per node: True if it is a Boolean value
    design   numbers that `configure` stores for reset, step and retune
    names    variable names in the source of the laws, by node
    makers   dotted names of the blocks that compute the nodes, by node
    prepared dotted names and nodes of the precomputed coefficients, in order
    conditions  nodes of the routine's conditions, in order
    retune   the live parameter change in plain arithmetic; `retune_truth` flags the truth values among its nodes
    """

    routine: Routine
    precision: str
    graph: Graph
    leaves: dict[int, tuple[str, int]]
    moving: list[bool]
    truth: list[bool]
    design: tuple[Field, ...]
    names: dict[int, Name]
    makers: dict[int, str]
    reset: Function
    step: Function
    prepared: tuple[tuple[str, int], ...]
    conditions: tuple[int, ...]
    retune: Retune | None
    retune_truth: list[bool]

    @property
    def moving_users(self) -> list[bool]:
        """For each node, True if it is an operand of a node whose value changes from sample to sample."""
        read = [False] * len(self.graph.nodes)
        for index, node in enumerate(self.graph.nodes):
            if self.moving[index]:
                for i in arguments(node):
                    read[i] = True
        return read

    def order(self, roots: Iterable[int], *, moving: bool) -> list[int]:
        """Return the operations on which `roots` depend, in the order in which the law evaluates them.

        If `moving` is True, only operations whose results change from sample to sample; otherwise only the others.
        """
        return [
            index
            for index in reachable(self.graph, list(roots))
            if self.moving[index] == moving and self.graph.nodes[index][0] not in ("const", "truth")
        ]


def layout(routine: Routine, precision: str = "double") -> Layout:
    """Return the layout of a routine. Raises ParameterError for an unknown precision."""
    if precision not in PRECISIONS:
        raise ParameterError(f"precision = '{precision}' must be one of {', '.join(PRECISIONS)}")
    roots = [
        *(v.node for v in (*routine.parameters, *routine.inputs, *routine.states)),
        *(node for _, node, _ in routine.tables),
        *routine.reset.states,
        *routine.reset.outputs,
        *routine.step.states,
        *routine.step.outputs,
        *(node for _, node in routine.prepared),
        *(condition.node for condition in routine.conditions),
    ]
    leaves_by_node = {routine.sample_time_node: ("sample_time", 0)}
    for kind, nodes in (
        ("parameter", [v.node for v in routine.parameters]),
        ("input", [v.node for v in routine.inputs]),
        ("state", [v.node for v in routine.states]),
        ("table", [node for _, node, _ in routine.tables]),
    ):
        leaves_by_node.update({node: (kind, i) for i, node in enumerate(nodes)})
    graph, place = _lowered(routine.graph, roots)
    leaves = {place[node]: kind for node, kind in leaves_by_node.items() if node in place}
    moving = _moving(graph, {node for node, (kind, _) in leaves.items() if kind in ("input", "state")})
    names, makers = _moved(routine.names, place), _moved(routine.makers, place)
    prepared = tuple((name, place[node]) for name, node in routine.prepared)
    reset, step = (_placed(function, place) for function in (routine.reset, routine.step))
    ends = (*reset.states, *reset.outputs, *step.states, *step.outputs)
    wanted = {i for index in reachable(graph, ends) if moving[index] for i in arguments(graph.nodes[index])}
    wanted |= set(ends)
    if routine.retune is not None:
        read = {i for kind, i in routine.retune.leaves.values() if kind.endswith("prepared")}
        wanted |= {prepared[place][1] for place, leaf in enumerate(routine.prepared_leaves) if leaf in read}
    truth = truths(graph)
    kept = sorted(i for i in wanted if not moving[i] and graph.nodes[i][0] not in ("const", "truth", "table"))
    design = _fields(routine, graph, kept, leaves, {n: t for t, n in reversed(prepared)}, names, truth, moving)
    retune = None if routine.retune is None else _lowered_retune(routine.retune)
    return Layout(
        routine=routine,
        precision=precision,
        graph=graph,
        leaves=leaves,
        moving=moving,
        truth=truth,
        design=design,
        names=names,
        makers=makers,
        reset=reset,
        step=step,
        prepared=prepared,
        retune=retune,
        conditions=tuple(place[condition.node] for condition in routine.conditions),
        retune_truth=[] if retune is None else truths(retune.graph),
    )


def _lowered_retune(retune: Retune) -> Retune:
    """Express the live parameter change in operations that the generators can emit, in double precision."""
    graph, place = _lowered(retune.graph, [*retune.states, *retune.leaves])
    leaves = {place[node]: leaf for node, leaf in retune.leaves.items()}
    states = tuple(place[i] for i in retune.states)
    return Retune(graph, leaves, states, _moved(retune.names, place), _moved(retune.makers, place))


def _moved(words: Mapping[int, Word], place: Mapping[int, int]) -> dict[int, Word]:
    """Return the names or makers of nodes for the nodes that replace them.

    A node that replaces several nodes gets the name or maker of the first one.
    """
    return {place[node]: word for node, word in sorted(words.items(), reverse=True) if node in place}


def _placed(function: Function, place: dict[int, int]) -> Function:
    return Function(tuple(place[i] for i in function.states), tuple(place[i] for i in function.outputs))


def _moving(graph: Graph, signals: set[int]) -> list[bool]:
    """Return, per node, True if it depends on an input or a state."""
    moving: list[bool] = []
    for index, node in enumerate(graph.nodes):
        moving.append(index in signals or any(moving[i] for i in arguments(node)))
    return moving


def truths(graph: Graph) -> list[bool]:
    """Return, per node, True if it is a truth value."""
    truth: list[bool] = []
    for node in graph.nodes:
        truth.append(node[0] in TRUTH or node[0] == "truth" or (node[0] == "select" and truth[node[2]]))
    return truth


def _lowered(graph: Graph, roots: list[int]) -> tuple[Graph, dict[int, int]]:
    """Return the graph on which the roots depend, in operations that the generators can emit, and the new node indices.

    Elementary functions remain calls.
    """

    def compose(printable: Graph, name: str, values: list[Symbol]) -> Symbol:
        known = _known(printable, name, values)
        return composed(printable, name, values, "libm") if known is None else known

    return rebuilt(graph, roots, compose)


_FOLDED = {"add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b}


def _known(graph: Graph, name: str, operands: list[Symbol]) -> Symbol | None:
    """Return the result of an operation that need not be executed: one on constants, or x · 1 or x / 1, which equal x.

    It is None for all other operations.
    """
    numbers = [_number(graph, symbol) for symbol in operands]
    if name in _FOLDED and None not in numbers:
        return graph.constant(_FOLDED[name](*numbers))
    if name == "neg" and numbers[0] is not None:
        return graph.constant(-numbers[0])
    # no such rule for x + 0, which turns -0 into 0
    if name == "mul" and 1.0 in numbers:
        return operands[1 - numbers.index(1.0)]
    return operands[0] if name == "div" and numbers[1] == 1.0 else None


def _number(graph: Graph, symbol: Symbol) -> float | None:
    node = graph.nodes[symbol.index]
    return float.fromhex(node[1]) if node[0] == "const" else None


def _fields(
    routine: Routine,
    graph: Graph,
    nodes: list[int],
    leaves: dict[int, tuple[str, int]],
    prepared: dict[int, str],
    names: dict[int, Name],
    truth: list[bool],
    moving: list[bool],
) -> tuple[Field, ...]:
    """Return the fields of the design numbers.

    Each is named after its parameter, precomputed coefficient or variable of the law. A number without such a name is
    named after the first named value that depends on it: `law_integral_factor`.
    """
    taken: set[str] = set()
    fields: list[Field] = []
    results = _named_results(graph, nodes, names, moving)
    for node in nodes:
        kind, place = leaves.get(node, ("", 0))
        if kind == "parameter":
            wanted = routine.parameters[place].name
        elif kind == "sample_time":
            wanted = "sample_time"
        elif node in prepared:
            wanted = target_name(prepared[node])
        elif node in names:
            wanted = word(names[node])
        elif graph.nodes[node][0] == "neg" and leaves.get(graph.nodes[node][1], ("", 0))[0] == "parameter":
            wanted = f"minus_{routine.parameters[leaves[graph.nodes[node][1]][1]].name}"
        else:
            wanted = f"{results.get(node, 'a')}_factor"
        fields.append(Field(identifier(wanted, taken, C_WORDS), node, truth[node]))
    return tuple(fields)


def _named_results(graph: Graph, nodes: list[int], names: Mapping[int, Name], moving: list[bool]) -> dict[int, str]:
    """Return, for each node, the first named value that depends on it and changes from sample to sample."""
    wanted, results = set(nodes), dict[int, str]()
    reaches: dict[int, set[int]] = {node: {node} for node in nodes}
    for index, node in enumerate(graph.nodes):
        if not moving[index]:
            continue
        below = set[int]().union(*(reaches.get(i, set()) for i in arguments(node))) & (wanted - results.keys())
        if index in names:
            results.update(dict.fromkeys(below, word(names[index])))
        elif below:
            reaches[index] = below
    return results


def word(name: Name) -> str:
    """Return a variable name prefixed by its block: `law_velocity`; `velocity` if the block is the controller."""
    owner = target_name(name.owner)
    return f"{owner}_{name.word}" if owner else name.word


# A layout executed in Python in the precision of the target: the reference, bit for bit, for single precision.
#
# `configure` and `retune` run in double precision, `reset` and `step` in that of the layout.  Subnormal numbers count
# as zero, as they are configured to on the targets.

_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "floor": np.floor,
    "lt": lambda a, b: bool(a < b),
    "le": lambda a, b: bool(a <= b),
    "eq": lambda a, b: bool(a == b),
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
    "select": lambda condition, a, b: a if condition else b,
    "power_of_two": lambda k: type(k)(np.ldexp(1.0, int(k))),
    # frexp gives a mantissa in [0.5, 1), this operation has it in [1, 2)
    "exponent": lambda x: type(x)(np.frexp(x)[1] - 1 if x != 0.0 else np.finfo(type(x)).minexp - 1),
    "gather": lambda row, place: row[int(place)],
    "decays": lambda *entries: bool(matrix.decays(np.reshape(entries, (math.isqrt(len(entries)), -1)).tolist())),
}


class LayoutRun:
    """The execution of a controller or a plant from its layout, as the reference for exported code.

    It is slow: 10 000 operations take about 10 ms.
    """

    def __init__(self, layout: Layout, parameters: Mapping[str, float] | None = None, *, wide: bool = False) -> None:
        """Configure the controller or plant.

        `parameters` override those of the machine file, by dotted name.  With `wide`, all computations are in double
        precision.
        """
        self.layout = layout
        self.real: Any = np.float64 if wide or layout.precision == "double" else np.float32
        values = {v.path: v.value for v in layout.routine.parameters} | dict(parameters or {})
        self.parameters = values
        self.state: list[Any] = []
        self.design = self._configured()

    def _configured(self) -> dict[int, Any]:
        """Return the numbers that `configure` stores, by node, each rounded once to the precision of the target."""
        nodes = [field.node for field in self.layout.design]
        computed = self.values(nodes)
        kept = (value if isinstance(value, bool) else self._rounded(value) for value in computed)
        return dict(zip(nodes, kept, strict=True))

    def values(self, nodes: list[int]) -> list[Any]:
        """Return the values of nodes that depend on parameters only, in double precision."""
        values = self._tables(np.float64)
        for node, (kind, i) in self.layout.leaves.items():
            if kind == "parameter":
                values[node] = np.float64(self.parameters[self.layout.routine.parameters[i].path])
            elif kind == "sample_time":
                values[node] = np.float64(self.layout.routine.sample_time)
        return evaluated(self.layout.graph, nodes, values, np.float64)

    def _rounded(self, value: Any) -> Any:
        with np.errstate(over="ignore", under="ignore"):
            return self.real(value)

    def _tables(self, real: Any) -> dict[int, Any]:
        rows = self.layout.routine.tables
        return {node: real(rows[i][2]) for node, (kind, i) in self.layout.leaves.items() if kind == "table"}

    def reset(self, inputs: Iterable[float]) -> list[Any]:
        """Reset the state at the position given by the inputs; return the outputs, which only a plant has."""
        return self._advance(self.layout.reset, inputs)

    def step(self, inputs: Iterable[float]) -> list[Any]:
        """Compute one sample; return the outputs in the order of the routine."""
        return self._advance(self.layout.step, inputs)

    def _advance(self, function: Any, inputs: Iterable[float]) -> list[Any]:
        layout = self.layout
        sources = {"input": [self._rounded(x) for x in inputs], "state": self.state}
        values = {
            node: sources[kind][i]
            for node, (kind, i) in layout.leaves.items()
            if kind in sources and i < len(sources[kind])
        }
        ends = [*function.states, *function.outputs]
        results = evaluated(layout.graph, ends, values | self._tables(self.real) | self.design, self.real)
        self.state = results[: len(function.states)]
        return results[len(function.states) :]

    def retune(self, changes: Mapping[str, float]) -> None:
        """Change parameters, by dotted name, and adapt the state."""
        layout, routine = self.layout, self.layout.routine
        before, design = dict(self.parameters), self.design
        self.parameters = before | dict(changes)
        self.design = self._configured()
        assert layout.retune is not None
        values: dict[int, Any] = {}
        for node, (kind, i) in layout.retune.leaves.items():
            if kind == "state":
                values[node] = np.float64(self.state[i])
            elif kind in ("old", "new"):
                values[node] = np.float64((before if kind == "old" else self.parameters)[routine.parameters[i].path])
            elif i in routine.prepared_leaves:
                source = layout.prepared[routine.prepared_leaves.index(i)][1]
                held = design if kind == "old_prepared" else self.design
                constant = layout.graph.nodes[source]
                values[node] = np.float64(
                    float.fromhex(constant[1]) if constant[0] == "const" else held.get(source, 0.0)
                )
        states = evaluated(layout.retune.graph, list(layout.retune.states), values, np.float64)
        self.state = [self._rounded(x) for x in states]


def evaluated(graph: Graph, ends: list[int], leaves: Mapping[int, Any], real: Any) -> list[Any]:
    """Return the values of the nodes `ends`; each operation is rounded to `real`, and subnormal numbers become zero."""
    values: dict[int, Any] = dict(leaves)
    least = np.finfo(real).tiny
    with np.errstate(all="ignore"):
        for index in _needed(graph, ends, values):
            node = graph.nodes[index]
            if node[0] == "const":
                values[index] = real(float.fromhex(node[1]))
            elif node[0] == "truth":
                values[index] = node[1]
            else:
                # operands and results, as processors do that count subnormal numbers as zero
                operands = [_flushed(values[i], least) for i in arguments(node)]
                operation = _OPERATIONS.get(node[0])
                result = elementary(node[0], operands[0], real) if operation is None else operation(*operands)
                # a selection moves bits and is no arithmetic operation
                values[index] = _flushed(result, least) if node[0] != "select" else result
    return [values[index] for index in ends]


def _flushed(value: Any, least: Any) -> Any:
    """Return a number, or a zero of the same sign if it is subnormal."""
    # `not <`, so that NaN passes unchanged
    if isinstance(value, (bool, np.ndarray)) or not abs(value) < least:
        return value
    return value * type(value)(0.0)


def _needed(graph: Graph, ends: list[int], known: Mapping[int, Any]) -> list[int]:
    """Return, in order, the nodes that must be computed for `ends` if the values of `known` nodes are available."""
    needed: set[int] = set()
    stack = [index for index in ends if index not in known]
    while stack:
        index = stack.pop()
        if index in needed:
            continue
        needed.add(index)
        stack.extend(i for i in arguments(graph.nodes[index]) if i not in known)
    return sorted(needed)


_graphs: dict[tuple[str, Any], tuple[Graph, int, int]] = {}


def elementary(name: str, x: Any, real: Any) -> Any:
    """Return the value of an elementary function, computed by its definition in the precision `real`."""
    assert name in ELEMENTARY, f"no operation '{name}' in {real.__name__}"
    key = (name, real)
    if key not in _graphs:
        module = import_module(f"feeddrive.language.{'mathematics' if real is np.float64 else 'single'}")
        graph = Graph()
        argument = graph.input("x")
        result = graph.symbol(getattr(module, name)(argument)).index
        assert reachable(graph, [result])
        _graphs[key] = (graph, argument.index, result)
    graph, argument, result = _graphs[key]
    return evaluated(graph, [result], {argument: x}, real)[0]
