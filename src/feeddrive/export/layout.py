"""Memory layout of a routine on a target: what `configure` computes and stores, and what each step computes.

A number that depends on parameters only is computed by `configure` and stored in the design, if a step or a reset
reads it; all others are computed in every step.  With a single-precision step, `configure` still computes in double
precision, and its results are rounded once, so that the stored numbers are the best that single precision allows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from feeddrive.export.identifiers import C_WORDS, identifier
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import TRUTH, Graph, Symbol, arguments, reachable, rebuilt
from feeddrive.language.naming import Name
from feeddrive.loop.engine.plan import composed
from feeddrive.loop.routine import Function, Retune, Routine, target_name

Word = TypeVar("Word")
PRECISIONS = ("double", "float")


class Field(NamedTuple):
    """A number that `configure` computes and stores: its name, its node, and whether it is a truth value."""

    name: str
    node: int
    truth: bool


@dataclass(frozen=True, eq=False, repr=False)
class Layout:
    """A routine in the operations that the code generators can print.

    leaves   node -> (kind, index): kind is "parameter", "sample_time", "input", "state" or "table"
    moving   whether a node changes from sample to sample; the others are computed by `configure`
    truth    whether a node is a truth value
    design   numbers that `configure` stores for reset, step and retune
    names    variable names in the source of the laws, by node
    makers   dotted names of the blocks that compute the nodes
    prepared the prepared numbers, in their order, as nodes
    conditions the truth nodes of the routine's conditions, in their order
    retune   the live change, in plain arithmetic, and which of its nodes are truth values
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
        """Whether a node is read by one that moves."""
        read = [False] * len(self.graph.nodes)
        for index, node in enumerate(self.graph.nodes):
            if self.moving[index]:
                for i in arguments(node):
                    read[i] = True
        return read

    def order(self, roots: Iterable[int], *, moving: bool) -> list[int]:
        """The operations below some nodes, those that move or those that do not, in the order of the text."""
        return [
            index
            for index in reachable(self.graph, list(roots))
            if self.moving[index] == moving and self.graph.nodes[index][0] not in ("const", "truth")
        ]


def layout(routine: Routine, precision: str = "double") -> Layout:
    """The layout of a routine. Raises ParameterError for an unknown precision."""
    if precision not in PRECISIONS:
        raise ParameterError(f"precision = '{precision}' must be one of {', '.join(PRECISIONS)}")
    roots = [
        *(v.node for v in (*routine.parameters, *routine.inputs, *routine.states)),
        *(node for _, node, _ in routine.tables),
        *routine.reset.states, *routine.reset.outputs, *routine.step.states, *routine.step.outputs,
        *(node for _, node in routine.prepared), *(each.node for each in routine.conditions),
    ]  # fmt: skip
    given = {routine.sample_time_node: ("sample_time", 0)}
    for kind, nodes in (
        ("parameter", [v.node for v in routine.parameters]),
        ("input", [v.node for v in routine.inputs]),
        ("state", [v.node for v in routine.states]),
        ("table", [node for _, node, _ in routine.tables]),
    ):
        given.update({node: (kind, i) for i, node in enumerate(nodes)})
    graph, place = _lowered(routine.graph, roots)
    leaves = {place[node]: kind for node, kind in given.items() if node in place}
    moving = _moving(graph, {node for node, (kind, _) in leaves.items() if kind in ("input", "state")})
    names, makers = _moved(routine.names, place), _moved(routine.makers, place)
    prepared = tuple((name, place[node]) for name, node in routine.prepared)
    reset, step = (_placed(each, place) for each in (routine.reset, routine.step))
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
        routine=routine, precision=precision, graph=graph, leaves=leaves, moving=moving, truth=truth, design=design,
        names=names, makers=makers, reset=reset, step=step, prepared=prepared, retune=retune,
        conditions=tuple(place[each.node] for each in routine.conditions),
        retune_truth=[] if retune is None else truths(retune.graph),
    )  # fmt: skip


def _lowered_retune(retune: Retune) -> Retune:
    """`configure` and `retune` compute in double precision always."""
    graph, place = _lowered(retune.graph, [*retune.states, *retune.leaves])
    leaves = {place[node]: leaf for node, leaf in retune.leaves.items()}
    states = tuple(place[i] for i in retune.states)
    return Retune(graph, leaves, states, _moved(retune.names, place), _moved(retune.makers, place))


def _moved(words: Mapping[int, Word], place: Mapping[int, int]) -> dict[int, Word]:
    """Properties of nodes, for the nodes that replace them; if two became one, the first counts."""
    return {place[node]: word for node, word in sorted(words.items(), reverse=True) if node in place}


def _placed(function: Function, place: dict[int, int]) -> Function:
    return Function(tuple(place[i] for i in function.states), tuple(place[i] for i in function.outputs))


def _moving(graph: Graph, given: set[int]) -> list[bool]:
    """Whether a node depends on an input or a state."""
    moving: list[bool] = []
    for index, node in enumerate(graph.nodes):
        moving.append(index in given or any(moving[i] for i in arguments(node)))
    return moving


def truths(graph: Graph) -> list[bool]:
    """Whether each node is a truth value."""
    truth: list[bool] = []
    for node in graph.nodes:
        truth.append(node[0] in TRUTH or node[0] == "truth" or (node[0] == "select" and truth[node[2]]))
    return truth


def _lowered(graph: Graph, roots: list[int]) -> tuple[Graph, dict[int, int]]:
    """The graph below the roots in printable operations; elementary functions stay, each printed as a function."""

    def compose(made: Graph, name: str, values: list[Symbol]) -> Symbol:
        known = _known(made, name, values)
        return composed(made, name, values, "libm") if known is None else known

    return rebuilt(graph, roots, compose)


_FOLDED = {"add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b}


def _known(graph: Graph, name: str, given: list[Symbol]) -> Symbol | None:
    """The value if no operation is needed: two constants, or x · 1; the bits are the same."""
    numbers = [_number(graph, symbol) for symbol in given]
    if name in _FOLDED and None not in numbers:
        return graph.constant(_FOLDED[name](*numbers))
    if name == "neg" and numbers[0] is not None:
        return graph.constant(-numbers[0])
    if name == "mul" and 1.0 in numbers:
        return given[1 - numbers.index(1.0)]
    return given[0] if name == "div" and numbers[1] == 1.0 else None


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
    """Names of the design numbers: those of parameters and prepared numbers, else the variable names in the law.

    A number without a name in the law is named after the first named number that depends on it: `law_integral_factor`.
    """
    taken: set[str] = set()
    found: list[Field] = []
    made = _named_results(graph, nodes, names, moving)
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
            wanted = f"{made.get(node, 'a')}_factor"
        found.append(Field(identifier(wanted, taken, C_WORDS), node, truth[node]))
    return tuple(found)


def _named_results(graph: Graph, nodes: list[int], names: Mapping[int, Name], moving: list[bool]) -> dict[int, str]:
    """By node, the first named number that changes from sample to sample and depends on it."""
    wanted, found = set(nodes), dict[int, str]()
    reaches: dict[int, set[int]] = {node: {node} for node in nodes}
    for index, node in enumerate(graph.nodes):
        if not moving[index]:
            continue
        below = set[int]().union(*(reaches.get(i, set()) for i in arguments(node))) & (wanted - found.keys())
        if index in names:
            found.update(dict.fromkeys(below, word(names[index])))
        elif below:
            reaches[index] = below
    return found


def word(name: Name) -> str:
    """`law_velocity`, or `velocity` if the whole control is the block."""
    owner = target_name(name.owner)
    return f"{owner}_{name.word}" if owner else name.word
