"""Names of intermediate values, read from the source of a law while it runs on symbols.

For `velocity = (position - state.position) / T` the graph stores the operation and `Names` stores `velocity`, so that
code printed from the graph uses the same names as the law.
"""

import sys
from collections.abc import Mapping
from types import FrameType, TracebackType
from typing import Any, NamedTuple, Self

from feeddrive.language.block import Block
from feeddrive.language.graph import Graph, Symbol

_LANGUAGE = __name__.rpartition(".")[0]  # the package `language`, whose variable names do not belong to a law


class Name(NamedTuple):
    """A variable name, and the dotted name of the block whose code first assigned a value to it."""

    owner: str
    word: str


class Names:
    """A context manager that names each symbol of a graph after the local variable of a block's method that holds it.

    with Names(graph, {id(block): "control.law", ...}) as names:
        ...
    names.by_node   node -> Name; the first name is kept
    names.makers    node -> dotted name of the block whose code computed it

    An element of a tuple gets a combined name: `middle.velocity` becomes `middle_velocity`, the first element of `z` is
    `z_0`.
    Arithmetic is not affected.
    """

    def __init__(self, graph: Graph, owners: Mapping[int, str]) -> None:
        self.graph = graph
        self.owners = owners
        self.by_node: dict[int, Name] = {}
        self.makers: dict[int, str] = {}
        self._seen = 0
        self._before: Any = None

    def __enter__(self) -> Self:
        # a debugger or the measurement of coverage goes on afterwards
        self._before = sys.gettrace()
        sys.settrace(self._called)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        sys.settrace(self._before)

    def _called(self, frame: FrameType, event: str, argument: Any) -> Any:
        """Return the line tracer for a called function; None for functions of the language package itself."""
        inside = str(frame.f_globals.get("__name__", "")).startswith(_LANGUAGE)
        return None if inside else self._line

    def _line(self, frame: FrameType, event: str, argument: Any) -> Any:
        """Record the local variables after each line."""
        if event in ("line", "return"):
            owner = self._owner(frame)
            if owner is not None:
                self.makers.update(dict.fromkeys(range(self._seen, len(self.graph.nodes)), owner))
                self._seen = len(self.graph.nodes)
                for word, value in frame.f_locals.items():
                    self._take(owner, word, value)
        return self._line

    def _owner(self, frame: FrameType | None) -> str | None:
        """Return the dotted name of the block whose method is running, directly or further up the call stack."""
        while frame is not None:
            owner = self.owners.get(id(frame.f_locals.get("self")))
            if owner is not None:
                return owner
            frame = frame.f_back
        return None

    def _take(self, owner: str, word: str, value: Any) -> None:
        if isinstance(value, Symbol):
            if value.graph is self.graph:
                self.by_node.setdefault(value.index, Name(owner, word.strip("_")))
        elif isinstance(value, tuple) and not isinstance(value, Block):
            fields = getattr(value, "_fields", None) or map(str, range(len(value)))
            for field, part in zip(fields, value, strict=True):
                if isinstance(part, Symbol) and part.graph is self.graph:
                    self.by_node.setdefault(part.index, Name(owner, f"{word.strip('_')}_{field}"))
