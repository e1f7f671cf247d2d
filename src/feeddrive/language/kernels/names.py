"""Names in kernels as LLVM text: local variables, constants of modules, and the fields of records."""

from __future__ import annotations

import ast
from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, cast

from feeddrive.language.kernels.arithmetic import LEAST
from feeddrive.language.kernels.records import RecordArithmetic
from feeddrive.language.kernels.source import BOOL, FLOAT, INT, Source, Type, is_record
from feeddrive.language.kernels.text import Function, Value, assembled, shown
from feeddrive.language.machine_code import number


class Variable(NamedTuple):
    """A local name: its type, and the memory of its number, of address and sizes of its array, or of its fields."""

    type: Type
    slots: tuple[str, ...]
    parts: tuple[Variable, ...] = ()

    @property
    def leaves(self) -> list[Variable]:
        """The variables of its numbers and arrays."""
        return [leaf for part in self.parts for leaf in part.leaves] if self.parts else [self]

    @property
    def loads(self) -> list[str]:
        """The LLVM loads of its value."""
        if self.parts:
            return [load for part in self.parts for load in part.loads]
        kinds = [self.type.llvm, *["i64"] * (len(self.slots) - 1)]
        return [f"load {kind}, ptr {slot}" for kind, slot in zip(kinds, self.slots, strict=True)]


class Names(RecordArithmetic):
    """Reads names.  Statements (`statements.py`) keep `variables` and `assigned` up to date."""

    def __init__(self, source: Source, callee: Callable[[Source], Function]) -> None:
        super().__init__(source, callee)
        self.names: frozenset[str] = frozenset()  # all that are local
        self.fixed: dict[str, Value] = {}  # parameters that keep their value
        self.counters: frozenset[str] = frozenset()  # local whole numbers that are never below 0
        self.variables: dict[str, Variable] = {}
        self.assigned: frozenset[str] | None = frozenset()  # on every path to here; None where no path leads
        self.stored: set[str] = set()  # variables into whose arrays something is written

    @abstractmethod
    def place(self, node: ast.Subscript) -> Value:
        """The address of a cell or row (`expressions.py`)."""

    def outside(self, node: ast.expr) -> object:
        """Return the value of a name that is not local; None for anything else."""
        first = node
        while isinstance(first, ast.Attribute):
            first = first.value
        return None if isinstance(first, ast.Name) and first.id in self.names else self.source.lookup(node)

    def constant(self, value: object, node: ast.expr) -> Value:
        """Return a known number or record."""
        if is_record(type(value)):
            return self.constant_record(cast("tuple[object, ...]", value), node)
        if isinstance(value, bool):
            return Value(BOOL, "true" if value else "false")
        if isinstance(value, int):
            if not LEAST <= value < -LEAST:
                self.refuse(node, f"{shown(node)} is beyond 64 bits", "write it as a float")
            return Value(INT, str(value), literal=value, sure=value >= 0)
        if not isinstance(value, float):
            self.refuse(node, f"{shown(node)} is no number", "kernels compute with numbers and arrays of the caller")
        return Value(FLOAT, number(value))

    def name(self, node: ast.Name, fields: Sequence[str] = (), whole: ast.AST | None = None) -> Value:
        """A local variable or a constant of the module, or a field inside; `whole` is then the text with the field."""
        whole = whole or node
        if node.id not in self.names:
            value = self.outside(node)
            if value is None:
                self.refuse(node, f"'{node.id}' is not known", "assign it, or define it in the file")
            return self.inside(self.constant(value, node), fields, whole)
        if self.assigned is not None and node.id not in self.assigned:
            self.refuse(node, f"'{node.id}' is read where a path has not assigned it", "assign it before")
        if node.id in self.fixed:
            return self.inside(self.fixed[node.id], fields, whole)
        held = self.variables.get(node.id)
        if held is None:
            self.refuse(node, f"'{node.id}' is read before it is assigned", "assign it before")
        for field in fields:
            index = self.index(held.type, field, whole)
            held = held.parts[index]
        return self.load(".".join([node.id, *fields]), held)._replace(sure=node.id in self.counters)

    def load(self, name: str, held: Variable) -> Value:
        """The value of a variable."""
        if held.parts:
            leaves = zip(held.type.leaves(name), held.leaves, strict=True)
            return assembled(held.type, (self.load(leaf, variable) for (leaf, _), variable in leaves))
        text, *sizes = map(self.value, held.loads)
        return Value(held.type, text, tuple(sizes), name if held.type.dimensions else "")

    def inside(self, value: Value, fields: Iterable[str], node: ast.AST) -> Value:
        """A field of a record, or of a record inside."""
        for field in fields:
            value = value.parts[self.index(value.type, field, node)]
        return value

    def attribute(self, node: ast.Attribute) -> Value:
        """A constant of a module, or a field of a record, of which nothing else is read."""
        fields, first = [node.attr], node.value
        while isinstance(first, ast.Attribute):
            fields.insert(0, first.attr)
            first = first.value
        if isinstance(first, ast.Subscript):
            place = self.place(first)
            for field in fields:
                place = self.column(place, field, node)
            return self.loaded(place)
        if not isinstance(first, ast.Name):
            return self.inside(self.expression(first), fields, node)
        known = self.outside(first) if first.id not in self.names else None
        if first.id in self.names or is_record(type(known)):
            return self.name(first, fields, node)
        value = self.outside(node)
        if value is None:
            self.refuse(node, f"'{shown(node)}' is not known", "import it, or define it")
        return self.constant(value, node)
