"""The graph of a step: its arithmetic as a list of operations in the order of evaluation.

A law runs on three number types: float, array and `Symbol`.  Operations whose result on symbols would differ from that
on floats raise an error: `if`, `and`, `float()`, `math.*` and numpy functions.

Arithmetic is never rearranged, so its results are bit-identical to those of the Python source.  Only two
simplifications are made, neither of which changes a result: common subexpressions are stored once, and constants are
folded.

CasADi is not used: its rewriting of arithmetic, its silent NaN from `math.sin(SX)`, its lack of table lookup and its
encoding of `where` would all need workarounds, and it occupies 277 MB. This module is sufficient here.
"""

from __future__ import annotations

import linecache
import os
import re
import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any, NamedTuple, NoReturn, TypeAlias

import numpy as np

from feeddrive.language.errors import LanguageError, StructureError, plain

# Operations on numbers by name, with their numbers of arguments.  "select" takes a truth value first;
# "lt", "le", "eq", "and", "or" and "not" return one.  "table", "ring" and "input" are leaves; "get" reads
# a cell of a ring, and "put" returns the ring with a new value in one cell.
# "decays" takes the entries of a square matrix, row by row; it is computed once, for a rule, never in a step.
ARITY: dict[str, int] = {
    "add": 2, "sub": 2, "mul": 2, "div": 2, "neg": 1, "abs": 1, "sqrt": 1, "floor": 1,
    "lt": 2, "le": 2, "eq": 2, "and": 2, "or": 2, "not": 1, "select": 3,
    "exp": 1, "expm1": 1, "log": 1, "sin": 1, "cos": 1, "tanh": 1, "atan": 1,
    "power_of_two": 1, "exponent": 1, "quantise": 2, "uniform": 3, "gather": 2,
    "get": 2, "put": 3,
}  # fmt: skip
LEAVES = frozenset({"const", "truth", "input", "table", "ring"})
TRUTH = frozenset({"lt", "le", "eq", "and", "or", "not", "decays"})
# Functions implemented in `mathematics.py`; all other operations map to one or a few machine instructions.
ELEMENTARY = frozenset({"exp", "expm1", "log", "sin", "cos", "tanh", "atan"})
# may have an infinite derivative at a finite value, or a discontinuity: the graph stores their source lines
STEEP = frozenset({"sqrt", "log", "select"})
# Functions of other libraries and their replacements in a law; functions with the same name in `ops` are not listed.
SPELLED = {
    "abs": "ops.absolute(x)",
    "absolute": "ops.absolute(x)",
    "fabs": "ops.absolute(x)",
    "arctan": "ops.atan(x)",
    "arctan2": "ops.atan2(y, x)",
    "ceil": "-ops.floor(-x)",
    "copysign": "ops.where(y < 0.0, -abs(x), abs(x))",
    "floor_divide": "ops.floor(x / y)",
    "fmax": "ops.maximum(x, y)",
    "fmin": "ops.minimum(x, y)",
    "hypot": "ops.sqrt(x*x + y*y)",
    "isfinite": "nothing: the guard of the loop replaces broken readings",
    "isnan": "nothing: the guard of the loop replaces broken readings",
    "log10": "ops.log(x) / 2.302585092994046",
    "log2": "ops.log(x) / 0.6931471805599453",
    "max": "ops.maximum(x, y)",
    "min": "ops.minimum(x, y)",
    "pow": "ops.power(x, y) for x > 0, or x*x",
    "round": "ops.floor(x + 0.5)",
    "square": "x*x",
    "trunc": "ops.where(x < 0.0, -ops.floor(-x), ops.floor(x))",
}
_NAMED = ("atan2", "clip", "power", "minimum", "maximum", "sign", "tan", "where")  # operations of `ops` made of others

Node: TypeAlias = tuple[Any, ...]


class Line(NamedTuple):
    """A source line of a block: file, line number, and the kind of the block whose method contains it."""

    file: str
    number: int
    kind: str

    def __str__(self) -> str:
        code = plain(linecache.getline(self.file, self.number).strip())
        code = code if len(code) <= 100 else code[:97] + "..."
        return f"{f'{self.kind}, ' if self.kind else ''}{os.path.basename(self.file)}, line {self.number}: {code}"


def _frame() -> FrameType | None:
    """Return the innermost running frame outside both this package and NumPy."""
    frame = sys._getframe(1)  # pyright: ignore[reportPrivateUsage]
    while frame is not None and str(frame.f_globals.get("__name__", "")).startswith((f"{__package__}.", "numpy.")):
        frame = frame.f_back
    return frame


def _line(frame: FrameType) -> Line:
    kind = getattr(frame.f_locals.get("self"), "kind", "")
    return Line(frame.f_code.co_filename, frame.f_lineno, kind if isinstance(kind, str) else "")


class Graph:
    """The operations in evaluation order. A node is a tuple (name, argument, ...); its arguments are indices of earlier
    nodes.

    Leaves are ("const", float), ("truth", bool), ("input", name), ("table", name, length) and ("ring", name, length).
    """

    def __init__(self, counted: Callable[[Symbol], float] | None = None) -> None:
        """Create an empty graph; `counted` returns the bound of a symbol for fixed-count loops (see `ops.most`)."""
        self.counted = counted
        self.nodes: list[Node] = []
        self.lines: dict[int, Line] = {}
        self._index: dict[Node, int] = {}

    def _store(self, node: Node) -> int:
        index = self._index.get(node)
        if index is None:
            index = len(self.nodes)
            self.nodes.append(node)
            self._index[node] = index
        return index

    def input(self, name: str) -> Symbol:
        """Return an input leaf, such as a state, a parameter or a setpoint, whose value is passed at each call."""
        return Symbol(self, self._store(("input", name)))

    def table(self, name: str, length: int) -> Symbol:
        """Return a table leaf, from which `gather` reads."""
        return Symbol(self, self._store(("table", name, length)))

    def ring(self, name: str, length: int) -> Symbol:
        """Return a ring leaf, whose cells persist from sample to sample."""
        return Symbol(self, self._store(("ring", name, length)))

    def constant(self, value: float | bool) -> Symbol:
        """Return the symbol of a constant."""
        if isinstance(value, bool | np.bool_):
            return Symbol(self, self._store(("truth", bool(value))))
        number = float(value)
        if number != number:
            raise StructureError("a law holds the constant NaN: it was computed outside `ops`")
        # the hexadecimal text distinguishes -0.0 from 0.0, which compare as equal
        return Symbol(self, self._store(("const", number.hex())))

    def apply(self, name: str, *arguments: Any) -> Symbol:
        """Append an operation on symbols and plain numbers; return its symbol."""
        symbols = [self.symbol(argument) for argument in arguments]
        index = self._store((name, *(symbol.index for symbol in symbols)))
        # a shared subexpression keeps the line that computed it first
        if name in STEEP and index not in self.lines:
            frame = _frame()
            if frame is not None:
                self.lines[index] = _line(frame)
        return Symbol(self, index)

    def symbol(self, value: Any) -> Symbol:
        """Return a plain number as a constant symbol; return a symbol of this graph unchanged."""
        if isinstance(value, Symbol):
            if value.graph is not self:
                raise StructureError("two traces were mixed: a symbol of another graph entered this one")
            return value
        if value is None:
            raise StructureError("an absent part entered the arithmetic of a law")
        return self.constant(value)

    def name(self, index: int) -> str:
        """Return the name of the operation at a node."""
        return self.nodes[index][0]

    def origin(self, index: int) -> int:
        """Return the index of the ring leaf from which a node originates, found by tracing its writes back."""
        while self.nodes[index][0] == "put":
            index = self.nodes[index][1]
        return index


class Symbol:
    """A number of unknown value in a trace. It supports + - * /, abs() and comparisons; `ops` provides the rest."""

    __slots__ = ("graph", "index")

    def __init__(self, graph: Graph, index: int) -> None:
        self.graph = graph
        self.index = index

    def __repr__(self) -> str:
        return f"Symbol({self.index}: {self.graph.nodes[self.index]})"

    def __add__(self, other: Any) -> Symbol:
        return self.graph.apply("add", self, other)

    def __radd__(self, other: Any) -> Symbol:
        return self.graph.apply("add", other, self)

    def __sub__(self, other: Any) -> Symbol:
        return self.graph.apply("sub", self, other)

    def __rsub__(self, other: Any) -> Symbol:
        return self.graph.apply("sub", other, self)

    def __mul__(self, other: Any) -> Symbol:
        return self.graph.apply("mul", self, other)

    def __rmul__(self, other: Any) -> Symbol:
        return self.graph.apply("mul", other, self)

    def __truediv__(self, other: Any) -> Symbol:
        return self.graph.apply("div", self, other)

    def __rtruediv__(self, other: Any) -> Symbol:
        return self.graph.apply("div", other, self)

    def __neg__(self) -> Symbol:
        return self.graph.apply("neg", self)

    def __pos__(self) -> Symbol:
        return self

    def __lt__(self, other: Any) -> Symbol:
        return self.graph.apply("lt", self, other)

    def __le__(self, other: Any) -> Symbol:
        return self.graph.apply("le", self, other)

    def __gt__(self, other: Any) -> Symbol:
        return self.graph.apply("lt", other, self)

    def __ge__(self, other: Any) -> Symbol:
        return self.graph.apply("le", other, self)

    def __abs__(self) -> Symbol:
        return self.graph.apply("abs", self)

    # a set or dictionary compares its keys by ==, which raises below
    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: object) -> NoReturn:
        raise _refused("a law compares with `ops.equal(a, b)`, not with ==")

    def __bool__(self) -> NoReturn:
        raise _refused(
            "a law cannot branch on a signal: use `ops.where(condition, a, b)`, or `ops.both`, `ops.either`, `ops.no` "
            "for and, or, not, and `ops.minimum`, `ops.maximum` for min, max"
        )

    def __float__(self) -> NoReturn:
        raise _refused(f"the value is not known yet: {_instead(_called())}")

    def __pow__(self, other: Any) -> NoReturn:
        raise _refused("a law writes x*x, or `ops.power(x, y)`, instead of x**y")

    def __mod__(self, other: Any) -> NoReturn:
        raise _refused(
            "a law writes `ops.floor(x / y)` instead of x // y, and `x - y*ops.floor(x / y)` instead of x % y"
        )

    def __and__(self, other: Any) -> NoReturn:
        raise _refused("a law writes `ops.both(a, b)`, `ops.either(a, b)`, `ops.no(a)` instead of a & b, a | b, ~a")

    def __round__(self, digits: Any = None) -> NoReturn:
        raise _refused(_instead("round"))

    def __floor__(self) -> NoReturn:
        raise _refused(_instead("floor"))

    def __ceil__(self) -> NoReturn:
        raise _refused(_instead("ceil"))

    def __trunc__(self) -> NoReturn:
        raise _refused(_instead("trunc"))

    __rpow__ = __pow__
    __rmod__ = __floordiv__ = __rfloordiv__ = __divmod__ = __rdivmod__ = __mod__
    __rand__ = __or__ = __ror__ = __and__
    __int__ = __float__
    __index__ = __float__

    def __invert__(self) -> NoReturn:
        self.__and__(self)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **settings: Any) -> Symbol:
        """Support arithmetic with NumPy scalars, such as np.float64(2.0) * x; raise an error for NumPy functions."""
        name = _OF_NUMPY.get(ufunc.__name__)
        if name is None or method != "__call__" or settings or any(getattr(operand, "ndim", 0) for operand in inputs):
            if ufunc.__name__ in ("equal", "not_equal"):
                raise _refused("a law compares with `ops.equal(a, b)`, not with ==")
            if name is not None:
                raise _refused("a law does not put signals into arrays of numpy: keep them in tuples")
            raise _refused(f"a law does not use numpy.{ufunc.__name__}: {_instead(ufunc.__name__)}")
        # a > b is stored as b < a: graphs have no operation for "greater"
        return self.graph.apply(name, *(reversed(inputs) if ufunc.__name__.startswith("greater") else inputs))


# NumPy function name -> operation, for the operators of a symbol
_OF_NUMPY = {
    "add": "add",
    "subtract": "sub",
    "multiply": "mul",
    "divide": "div",
    "less": "lt",
    "less_equal": "le",
    "greater": "lt",
    "greater_equal": "le",
}


def _refused(why: str) -> LanguageError:
    """Return the error for an operation that symbols do not support; it names the source line of the law."""
    frame = _frame()
    return LanguageError(why if frame is None else f"{_line(frame)}: {why}")


def _called() -> str:
    """Return the name of the function being called, such as `sqrt` in `math.sqrt(x)`; empty if unknown."""
    frame = _frame()
    if frame is None:
        return ""
    # f_lasti counts bytes; an instruction has two
    first, last, begin, end = list(frame.f_code.co_positions())[frame.f_lasti // 2]
    # each column counts from the start of its own line: a call that spans lines is not parsed
    if first is None or first != last:
        return ""
    # the columns count bytes of UTF-8, not characters
    text = linecache.getline(frame.f_code.co_filename, first).encode()[begin:end].decode(errors="replace")
    called = re.match(r"(?:\w+\.)*(\w+)\(", text)
    return called[1] if called else ""


def _instead(name: str) -> str:
    """Return the remedy for an error message: what to use in a law instead of a function of another library."""
    if name in SPELLED:
        return f"a law writes {SPELLED[name]}"
    if name in ARITY or name in _NAMED:
        return f"a law writes ops.{name}"
    return "a law uses `ops`, not `math`, `numpy` or float()"


def reachable(graph: Graph, outputs: Sequence[int]) -> list[int]:
    """Return the indices of the nodes on which the outputs depend, in evaluation order; all others are dead code."""
    needed: set[int] = set()
    stack = list(outputs)
    while stack:
        index = stack.pop()
        if index in needed:
            continue
        needed.add(index)
        stack.extend(arguments(graph.nodes[index]))
    return sorted(needed)


def arguments(node: Node) -> tuple[int, ...]:
    """Return the indices of a node's arguments; empty for a leaf."""
    return () if node[0] in LEAVES else node[1:]


def rebuilt(
    graph: Graph, roots: Sequence[int], compose: Callable[[Graph, str, list[Symbol]], Any]
) -> tuple[Graph, dict[int, int]]:
    """Copy the subgraph on which the roots depend; return the copy and a map from old to new node indices.

    Leaves are copied unchanged. For every other node, `compose` receives the new graph, the name of the operation and
    its copied arguments, and returns the expression that replaces the node.
    """
    copied = Graph()
    place: dict[int, Symbol] = {}
    for index in reachable(graph, roots):
        node = graph.nodes[index]
        match node[0]:
            case "const":
                place[index] = copied.constant(float.fromhex(node[1]))
            case "truth":
                place[index] = copied.constant(node[1])
            case "input":
                place[index] = copied.input(node[1])
            case "table":
                place[index] = copied.table(node[1], node[2])
            case "ring":
                place[index] = copied.ring(node[1], node[2])
            case name:
                place[index] = copied.symbol(compose(copied, name, [place[i] for i in arguments(node)]))
    return copied, {old: symbol.index for old, symbol in place.items()}
