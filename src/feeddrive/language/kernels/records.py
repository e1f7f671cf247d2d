"""Records of kernels as LLVM text.

A record is a value and has no memory of its own: as a variable, parameter or result it is its fields, one by one, and
in an array the numbers of a row.  So it costs what the same numbers cost without it.
"""

from __future__ import annotations

import ast
from abc import abstractmethod
from collections.abc import Iterator
from typing import cast

from feeddrive.language.kernels.arithmetic import Arithmetic
from feeddrive.language.kernels.source import BOOL, Layout, Type
from feeddrive.language.kernels.text import Value, assembled, shown
from feeddrive.language.machine_code import number


class RecordArithmetic(Arithmetic):
    """Makes records, names their fields, and moves them between values and rows of arrays."""

    @abstractmethod
    def expression(self, node: ast.expr) -> Value:
        """Print an expression with one value (`expressions.py`)."""

    @abstractmethod
    def constant(self, value: object, node: ast.expr) -> Value:
        """Return a known number or record (`expressions.py`)."""

    def index(self, kind: Type, field: str, node: ast.AST) -> int:
        """The place of a field among those of a record."""
        if kind.layout is None or kind.dimensions:
            remedy = "kernels know arrays by len and their indices alone, and records by their fields"
            self.refuse(node, f"'{shown(node)}' is not known", "index it first" if kind.layout else remedy)
        names = [*kind.layout.fields]
        if field not in names:
            self.refuse(node, f"'{kind}' has no field '{field}'", f"its fields are {', '.join(names)}")
        return names.index(field)

    # rows of arrays

    def column(self, place: Value, field: str, node: ast.AST) -> Value:
        """The place of a field of a record that lies in an array."""
        index = self.index(place.type, field, node)
        kinds = [*cast(Layout, place.type.layout).fields.values()]
        return self.shifted(place, sum(kind.width for kind in kinds[:index]), kinds[index])

    def shifted(self, place: Value, columns: int, kind: Type) -> Value:
        """The address that lies so many columns behind another one."""
        text = place.text
        if columns:
            text = self.value(f"getelementptr inbounds double, ptr {text}, i64 {columns}")
        return Value(kind, text)

    def cells(self, place: Value) -> Iterator[Value]:
        """The places of the numbers of a record, or of a number, in an array."""
        for columns, (_, kind) in enumerate(place.type.leaves("")):
            yield self.shifted(place, columns, kind)

    def loaded(self, place: Value) -> Value:
        """The number or the record at a place; a column of bools holds 0.0 or something else."""
        return assembled(place.type, (self.load_cell(cell) for cell in self.cells(place)))

    def load_cell(self, cell: Value) -> Value:
        """The number in a cell."""
        if cell.type == BOOL:
            stored = self.emit(f"load double, ptr {cell.text}")
            return Value(BOOL, self.value(f"fcmp une double {stored}, {number(0.0)}"))
        return Value(cell.type, self.emit(f"load {cell.type.llvm}, ptr {cell.text}"))

    def put_into(self, place: Value, value: Value) -> None:
        """Store a number or a record at a place of its type in an array."""
        for cell, leaf in zip(self.cells(place), value.leaves, strict=True):
            kind, text = leaf.type.llvm, leaf.text
            if leaf.type == BOOL:
                kind, text = "double", self.value(f"uitofp i1 {text} to double")
            self.add(f"store {kind} {text}, ptr {cell.text}")

    # making

    def constructed(self, layout: Layout, node: ast.Call) -> Value:
        """Stretch(begin, end, peak=v): fields in their order, then by name; others have their defaults."""
        names = [*layout.fields]
        if len(node.args) > len(names):
            what = f"'{shown(node)}' has {len(node.args)} values for {len(names)} fields"
            self.refuse(node, what, f"give ({', '.join(names)})")
        fields = dict(zip(names, map(self.expression, node.args), strict=False))
        fields = self.named(layout, node, fields)
        for name in names:
            if name not in fields:
                if name not in layout.defaults:
                    self.refuse(node, f"'{shown(node)}' gives no '{name}'", f"give ({', '.join(names)})")
                fields[name] = self.fitting(layout, name, self.constant(layout.defaults[name], node), node)
        return Value(Type("record", 0, layout), "", parts=tuple(fields[name] for name in names))

    def replaced(self, node: ast.Call, base: ast.expr) -> Value:
        """stretch._replace(peak=v): the same record but for the fields that are named."""
        record = self.expression(base)
        layout = record.type.layout
        if layout is None or record.type.dimensions or node.args:
            what = f"'{shown(node)}'" if layout else f"'{shown(base)}' is of type {record.type}, which is no record"
            self.refuse(node, what, "write  record._replace(field=value)")
        parts = dict(zip(layout.fields, record.parts, strict=True))
        return record._replace(parts=tuple((parts | self.named(layout, node, {})).values()))

    def named(self, layout: Layout, node: ast.Call, fields: dict[str, Value]) -> dict[str, Value]:
        """The fields that are given by position and by name, in the order of the text, each of its type."""
        kind = Type("record", 0, layout)
        for keyword in node.keywords:
            if keyword.arg is None or keyword.arg in fields:
                self.refuse(node, f"'{shown(node)}'", "give each field once, by its name")
            self.index(kind, keyword.arg, node)
            fields[keyword.arg] = self.expression(keyword.value)
        return {name: self.fitting(layout, name, value, node) for name, value in fields.items()}

    def fitting(self, layout: Layout, name: str, value: Value, node: ast.AST) -> Value:
        """A value for a field, if it has its type."""
        if value.type != layout.fields[name]:
            what = f"'{shown(node)}' gives {value.type} for the field '{name}' of type {layout.fields[name]}"
            self.refuse(node, what, "write 0.0 for 0, float(...), int(...), or give another")
        return value

    def constant_record(self, value: tuple[object, ...], node: ast.expr) -> Value:
        """A record of the module, which is constant."""
        layout = self.source.layout(type(value), node)
        parts = [self.constant(entry, node) for entry in value]
        fitting = [self.fitting(layout, name, part, node) for name, part in zip(layout.fields, parts, strict=True)]
        return Value(Type("record", 0, layout), "", parts=tuple(fitting))
