"""Kernels as LLVM text: names and records, expressions, assignments, statements, and the whole function.

A record has no memory of its own: as a variable, parameter or result it is stored as separate fields, and in an array
as the numbers of a row.  It therefore costs no more than separate numbers.
"""

from __future__ import annotations

import ast
import math
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple, cast

from feeddrive.language.kernels.elementary import Elementary
from feeddrive.language.kernels.source import (
    BOOL,
    FLOAT,
    INT,
    Layout,
    Source,
    Type,
    is_record,
    records,
    source_of,
    zeros,
)
from feeddrive.language.kernels.text import LEAST, REMEDIES, Arithmetic, Function, Value, assembled, shown, struct_type
from feeddrive.language.machine_code import number


class RecordArithmetic(Arithmetic):
    """The part of the compiler that constructs records, accesses their fields, and loads and stores them in arrays."""

    @abstractmethod
    def expression(self, node: ast.expr) -> Value:
        """Emit an expression with one value; implemented by `Expressions`."""

    @abstractmethod
    def constant(self, value: object, node: ast.expr) -> Value:
        """Return a number or record known at compile time; implemented by `Names`."""

    def index(self, kind: Type, field: str, node: ast.AST) -> int:
        """Return the index of a field of a record."""
        if kind.layout is None or kind.dimensions:
            remedy = "kernels know arrays by len and their indices alone, and records by their fields"
            self.refuse(node, f"'{shown(node)}' is not known", "index it first" if kind.layout else remedy)
        names = [*kind.layout.fields]
        if field not in names:
            self.refuse(node, f"'{kind}' has no field '{field}'", f"its fields are {', '.join(names)}")
        return names.index(field)

    # rows of arrays

    def column(self, place: Value, field: str, node: ast.AST) -> Value:
        """Return the address of a field of a record in an array."""
        index = self.index(place.type, field, node)
        kinds = [*cast(Layout, place.type.layout).fields.values()]
        return self.shifted(place, sum(kind.width for kind in kinds[:index]), kinds[index])

    def shifted(self, place: Value, columns: int, kind: Type) -> Value:
        """Return the address offset by a number of columns."""
        text = place.text
        if columns:
            text = self.value(f"getelementptr inbounds double, ptr {text}, i64 {columns}")
        return Value(kind, text)

    def cells(self, place: Value) -> Iterator[Value]:
        """Yield the addresses of the numbers of a record, or of a single number, in an array."""
        for columns, (_, kind) in enumerate(place.type.leaves("")):
            yield self.shifted(place, columns, kind)

    def loaded(self, place: Value) -> Value:
        """Load the number or record at an address; in a column of bools any nonzero number is true."""
        return assembled(place.type, (self.load_cell(cell) for cell in self.cells(place)))

    def load_cell(self, cell: Value) -> Value:
        """Load the number in a cell."""
        if cell.type == BOOL:
            stored = self.emit(f"load double, ptr {cell.text}")
            # unordered: a NaN is true, as bool(nan) is
            return Value(BOOL, self.value(f"fcmp une double {stored}, {number(0.0)}"))
        return Value(cell.type, self.emit(f"load {cell.type.llvm}, ptr {cell.text}"))

    def put_into(self, place: Value, value: Value) -> None:
        """Store a number or record at an address of its type in an array."""
        for cell, leaf in zip(self.cells(place), value.leaves, strict=True):
            kind, text = leaf.type.llvm, leaf.text
            if leaf.type == BOOL:
                kind, text = "double", self.value(f"uitofp i1 {text} to double")
            self.add(f"store {kind} {text}, ptr {cell.text}")

    # constructors

    def constructed(self, layout: Layout, node: ast.Call) -> Value:
        """Emit a constructor call, `Stretch(begin, end, peak=v)`: positional fields, named ones, then defaults."""
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
        """Emit `stretch._replace(peak=v)`: a copy of the record with the named fields replaced."""
        record = self.expression(base)
        layout = record.type.layout
        if layout is None or record.type.dimensions or node.args:
            what = f"'{shown(node)}'" if layout else f"'{shown(base)}' is of type {record.type}, which is no record"
            self.refuse(node, what, "write  record._replace(field=value)")
        parts = dict(zip(layout.fields, record.parts, strict=True))
        return record._replace(parts=tuple((parts | self.named(layout, node, {})).values()))

    def named(self, layout: Layout, node: ast.Call, fields: dict[str, Value]) -> dict[str, Value]:
        """Return the fields passed by position and by name, in source order, after checking their types."""
        kind = Type("record", 0, layout)
        for keyword in node.keywords:
            if keyword.arg is None or keyword.arg in fields:
                self.refuse(node, f"'{shown(node)}'", "give each field once, by its name")
            self.index(kind, keyword.arg, node)
            fields[keyword.arg] = self.expression(keyword.value)
        return {name: self.fitting(layout, name, value, node) for name, value in fields.items()}

    def fitting(self, layout: Layout, name: str, value: Value, node: ast.AST) -> Value:
        """Return the value for a field; raise KernelError if its type is not that of the field."""
        if value.type != layout.fields[name]:
            what = f"'{shown(node)}' gives {value.type} for the field '{name}' of type {layout.fields[name]}"
            self.refuse(node, what, "write 0.0 for 0, float(...), int(...), or give another")
        return value

    def constant_record(self, value: tuple[object, ...], node: ast.expr) -> Value:
        """Return a constant record defined in the module."""
        layout = self.source.layout(type(value), node)
        parts = [self.constant(entry, node) for entry in value]
        fitting = [self.fitting(layout, name, part, node) for name, part in zip(layout.fields, parts, strict=True)]
        return Value(Type("record", 0, layout), "", parts=tuple(fitting))


class Variable(NamedTuple):
    """A local variable: its type, and the stack slots of its number, array (address, sizes) or fields."""

    type: Type
    slots: tuple[str, ...]
    parts: tuple[Variable, ...] = ()

    @property
    def leaves(self) -> list[Variable]:
        """The variables of its individual numbers and arrays."""
        return [leaf for part in self.parts for leaf in part.leaves] if self.parts else [self]

    @property
    def loads(self) -> list[str]:
        """The LLVM load instructions for its value."""
        if self.parts:
            return [load for part in self.parts for load in part.loads]
        kinds = [self.type.llvm, *["i64"] * (len(self.slots) - 1)]
        return [f"load {kind}, ptr {slot}" for kind, slot in zip(kinds, self.slots, strict=True)]


class Names(RecordArithmetic):
    """The part of the compiler that reads names.  `Statements` keeps `variables` and `assigned` up to date."""

    def __init__(self, source: Source, callee: Callable[[Source], Function]) -> None:
        super().__init__(source, callee)
        self.names: frozenset[str] = frozenset()  # names of all local variables
        self.fixed: dict[str, Value] = {}  # parameters that are never reassigned
        self.counters: frozenset[str] = frozenset()  # local integers that are never negative
        self.variables: dict[str, Variable] = {}
        self.assigned: frozenset[str] | None = frozenset()  # on every path to here; None if unreachable
        self.stored: set[str] = set()  # variables whose arrays are written to

    @abstractmethod
    def place(self, node: ast.Subscript) -> Value:
        """Return the address of a cell or row; implemented by `Expressions`."""

    def outside(self, node: ast.expr) -> object:
        """Return the value of a name that is not local; None for anything else."""
        first = node
        while isinstance(first, ast.Attribute):
            first = first.value
        return None if isinstance(first, ast.Name) and first.id in self.names else self.source.lookup(node)

    def constant(self, value: object, node: ast.expr) -> Value:
        """Return a number or record known at compile time."""
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
        """Return the value of a local variable, module constant or field; `whole` is the complete expression."""
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
        """Load the value of a variable."""
        if held.parts:
            leaves = zip(held.type.leaves(name), held.leaves, strict=True)
            return assembled(held.type, (self.load(leaf, variable) for (leaf, _), variable in leaves))
        text, *sizes = map(self.value, held.loads)
        return Value(held.type, text, tuple(sizes), name if held.type.dimensions else "")

    def inside(self, value: Value, fields: Iterable[str], node: ast.AST) -> Value:
        """Return a field of a record, or of a nested record."""
        for field in fields:
            value = value.parts[self.index(value.type, field, node)]
        return value

    def attribute(self, node: ast.Attribute) -> Value:
        """Return a constant of a module, or a field of a record; only that field is read."""
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
        value = self.outside(first) if first.id not in self.names else None
        if first.id in self.names or is_record(type(value)):
            return self.name(first, fields, node)
        value = self.outside(node)
        if value is None:
            self.refuse(node, f"'{shown(node)}' is not known", "import it, or define it")
        return self.constant(value, node)


class Expressions(Names):
    """The part of the compiler that emits expressions."""

    def expression(self, node: ast.expr) -> Value:
        """Emit an expression with one value."""
        print_it = _PRINTERS.get(type(node))
        if print_it is None:
            kind = type(node).__name__
            self.refuse(node, f"'{shown(node)}' ({kind})", REMEDIES.get(type(node), "kernels compute with numbers"))
        return print_it(self, node)

    def number(self, node: ast.expr) -> Value:
        """Emit an expression that must be a float or an integer."""
        value = self.expression(node)
        if value.type not in (FLOAT, INT):
            self.refuse(node, f"'{shown(node)}' is of type {value.type}", _as_number(value.type))
        return value

    def truth(self, node: ast.expr) -> str:
        """Emit an expression that must be a bool; return its LLVM operand."""
        value = self.expression(node)
        if value.type != BOOL:
            self.refuse(node, f"'{shown(node)}' is of type {value.type}, not bool", "compare it: x != 0.0")
        return value.text

    def whole(self, node: ast.expr) -> Value:
        """Emit an expression that must be an integer."""
        value = self.expression(node)
        if value.type != INT:
            self.refuse(node, f"'{shown(node)}' is of type {value.type}, not int", "write int(...) or floor(...)")
        return value

    # arithmetic

    def unary(self, node: ast.UnaryOp) -> Value:
        """Emit `-x`, `+x` or `not x`."""
        if isinstance(node.op, ast.Not):
            return Value(BOOL, self.value(f"xor i1 {self.truth(node.operand)}, true"))
        if isinstance(node.op, ast.Invert):
            self.refuse(node, f"'{shown(node)}'", "write -x - 1")
        value = self.number(node.operand)
        if isinstance(node.op, ast.UAdd):
            return value
        if value.literal is not None and value.literal != LEAST:
            return Value(INT, str(-value.literal), literal=-value.literal)
        if value.type == FLOAT:
            return Value(FLOAT, self.value(f"fneg double {value.text}"))
        return self.overflowing("ssub", "0", value.text, node)

    def binary(self, node: ast.BinOp) -> Value:
        """Emit a binary operation, such as `a + b`."""
        left = self.number(node.left)
        return self.operation(node.op, left, self.number(node.right), node)

    # comparisons and choices

    def compare(self, node: ast.Compare) -> Value:
        """Emit a comparison, `a < b`, or a chain of comparisons, which is evaluated up to the first false one."""
        left, ends = self.expression(node.left), list[tuple[str, str]]()
        after, before = self.label(), self.facts
        for place, (op, other) in enumerate(zip(node.ops, node.comparators, strict=True)):
            right = self.expression(other)
            truth = self.compared(op, left, right, node)
            if place + 1 < len(node.ops):
                onward = self.label()
                ends.append(("false", self.block))
                self.choose(truth, onward, after)
                # only what the first comparison needs is computed on every path
                before = dict(self.facts) if len(ends) == 1 else before
                self.begin(onward)
                left = right
            elif ends:
                ends.append((truth, self.block))
                self.jump(after)
                self.begin(after)
                self.facts = before
                return Value(BOOL, self.phi("i1", ends))
            else:
                return Value(BOOL, truth)
        raise AssertionError("a comparison has two sides")

    def logic(self, node: ast.BoolOp) -> Value:
        """Emit `and` or `or`, with short-circuit evaluation."""
        ends, after, before = list[tuple[str, str]](), self.label(), self.facts
        for value in node.values[:-1]:
            truth, onward = self.truth(value), self.label()
            conjunction = isinstance(node.op, ast.And)
            ends.append(("false" if conjunction else "true", self.block))
            self.choose(truth, *((onward, after) if conjunction else (after, onward)))
            before = dict(self.facts) if len(ends) == 1 else before
            self.begin(onward)
        ends.append((self.truth(node.values[-1]), self.block))
        self.jump(after)
        self.begin(after)
        self.facts = before
        return Value(BOOL, self.phi("i1", ends))

    def choice(self, node: ast.IfExp) -> Value:
        """Emit `a if c else b`."""
        labels = self.label(), self.label()
        after = self.label()
        self.choose(self.truth(node.test), *labels)
        values: list[Value] = []
        blocks: list[str] = []
        before = self.facts
        for label, side in zip(labels, (node.body, node.orelse), strict=True):
            self.facts = dict(before)
            self.begin(label)
            values.append(self.expression(side))
            blocks.append(self.block)
            self.jump(after)
        self.facts = before
        self.begin(after)
        kind = values[0].type
        if kind != values[1].type or any(leaf.type.dimensions for leaf in values[0].leaves):
            types = f"{kind} and {values[1].type}"
            self.refuse(node, f"'{shown(node)}' chooses between {types}", "give both sides one type of number")
        pairs = zip(*(value.leaves for value in values), strict=True)
        merged = (
            Value(one.type, self.phi(one.type.llvm, [(one.text, blocks[0]), (other.text, blocks[1])]))
            for one, other in pairs
        )
        return assembled(kind, merged)

    # arrays

    def place(self, node: ast.Subscript) -> Value:
        """Return the address and type of a cell, or the address, type and sizes of a row."""
        array = self.expression(node.value)
        indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if not array.type.dimensions:
            remedy = "name a field" if array.type.layout else "index arrays alone"
            self.refuse(node, f"'{shown(node.value)}' is a {array.type} without indices", remedy)
        if len(indices) > len(array.sizes):
            remedy = "name the field" if array.type.layout else "leave the last ones out"
            self.refuse(node, f"'{shown(node)}' has {len(indices)} indices for {array.type}", remedy)
        wholes = [self.whole(index) for index in indices]
        places = [self.counted(index, size) for index, size in zip(wholes, array.sizes, strict=False)]
        self.check_indices(zip(places, array.sizes, strict=False), node)
        offset = places[0]
        for level, size in enumerate(array.sizes[1:], start=1):
            # nsw: indices are within their sizes here, and the array fits into memory
            offset = self.value(f"mul nsw i64 {offset}, {size}")
            if level < len(places):
                offset = self.value(f"add nsw i64 {offset}, {places[level]}")
        if array.type.layout:
            offset = self.value(f"mul nsw i64 {offset}, {array.type.width}")
        address = self.value(f"getelementptr inbounds {array.type.cell}, ptr {array.text}, i64 {offset}")
        rest = array.sizes[len(wholes) :]
        return Value(array.type._replace(dimensions=len(rest)), address, rest, array.root)

    def counted(self, index: Value, size: str) -> str:
        """Return the index counted from the start of the array; a negative `index` counts from the end."""
        if index.sure:
            return index.text
        if index.literal is None:
            behind = self.value(f"icmp slt i64 {index.text}, 0")
            shifted = self.value(f"add i64 {index.text}, {size}")
            return self.value(f"select i1 {behind}, i64 {shifted}, i64 {index.text}")
        return str(index.literal + int(size)) if size.isdigit() else self.value(f"add i64 {index.text}, {size}")

    def check_indices(self, places: Iterable[tuple[str, str]], node: ast.AST) -> None:
        """Emit bounds checks for several indices, except those that are known to hold."""
        left: list[str] = []
        for place, size in places:
            if not (place.isdigit() and size.isdigit() and int(place) < int(size)):
                # unsigned: one comparison refuses negative indices, too
                good = self.value(f"icmp ult i64 {place}, {size}")
                if not self.holds(good):
                    left.append(good)
        both = left[0] if left else ""
        for condition in left[1:]:
            both = self.value(f"and i1 {both}, {condition}")
        if both:
            self.check(both, IndexError, "index out of range", node)
        for condition in left:
            self.learn(condition)

    def subscript(self, node: ast.Subscript) -> Value:
        """Return the number in a cell, the record in a row, or a row of numbers as a view of the same memory."""
        place = self.place(node)
        return place if place.sizes else self.loaded(place)

    # calls

    def call(self, node: ast.Call) -> Value:
        """Emit a call with one result."""
        results = self.results(node)
        if len(results) != 1:
            self.refuse(node, f"'{shown(node)}' gives {len(results)} numbers", "assign them to as many names")
        return results[0]

    def results(self, node: ast.Call) -> list[Value]:
        """Emit a call of a kernel or of a built-in function of the kernel language; return its results."""
        if isinstance(node.func, ast.Attribute) and node.func.attr == "_replace":
            return [self.replaced(node, node.func.value)]
        function = self.outside(node.func)
        if is_record(function):
            return [self.constructed(self.source.layout(function, node), node)]
        if node.keywords:
            self.refuse(node, f"'{shown(node)}' names its arguments", "give them in their order")
        if function is zeros or function is records:
            remedy = f"write  {_LOCAL[function]}  in the kernel's body, outside of loops and branches"
            self.refuse(node, f"'{shown(node)}' makes an array here", remedy)
        called = source_of(function)
        if called is not None:
            return self.kernel(called, node)
        if isinstance(function, Elementary):
            return [self.angle(function, node)]
        printers = [print_it for built_in, print_it in _CALLS if function is built_in]
        if not printers:
            names = ", ".join(built_in.__name__ for built_in, _ in _CALLS)
            remedy = f"call kernels, {names}, zeros, or sin and the like of {Elementary.__module__}"
            self.refuse(node, f"'{shown(node.func)}' is no kernel", remedy)
        return [printers[0](self, node)]

    def kernel(self, called: Source, node: ast.Call) -> list[Value]:
        """Emit a call of a kernel in this or another file; its errors propagate."""
        wanted = called.signature
        if len(node.args) != len(wanted.parameters):
            numbers = f"{len(node.args)} arguments for {len(wanted.parameters)}"
            self.refuse(node, f"'{shown(node)}' has {numbers}", f"give ({', '.join(wanted.names)})")
        operands: list[str] = []
        arguments = [self.expression(argument) for argument in node.args]
        for value, name, kind in zip(arguments, wanted.names, wanted.parameters, strict=True):
            if value.type != kind:
                remedy = f"'{called.name}' takes {kind}: convert it by float(...) or int(...), or give another"
                self.refuse(node, f"'{shown(node)}' gives {value.type} for '{name}'", remedy)
            operands += [f"{word} {operand}" for word, operand in value.operands]
        function = self.called(called)
        leaves = [leaf for value in arguments for leaf in value.leaves]
        for place in function.written:
            self.stored.add(leaves[place].root)
        returned = struct_type(wanted.results)
        result = self.emit(f"call {returned} @{function.symbol}({', '.join(operands)})")
        # a call of a kernel that cannot fail needs no branch
        if function.fails:
            status = self.value(f"extractvalue {returned} {result}, 0")
            self.hand_up(status)
        kinds = [kind for returned_type in wanted.results for _, kind in returned_type.leaves("")]
        results = (
            Value(kind, self.value(f"extractvalue {returned} {result}, {place}"))
            for place, kind in enumerate(kinds, start=1)
        )
        return [assembled(kind, results) for kind in wanted.results]

    def angle(self, function: Elementary, node: ast.Call) -> Value:
        """Emit a call of sin, cos, tan, atan or atan2."""
        if len(node.args) != function.arity:
            self.refuse(node, f"'{shown(node)}' has {len(node.args)} arguments", f"give {function.arity}")
        arguments = ", ".join(f"double {self.as_float(self.number(argument))}" for argument in node.args)
        self.elementary.append(function)
        return Value(FLOAT, self.emit(f"call double {function.symbol}({arguments})"))

    def one(self, node: ast.Call) -> ast.expr:
        """Return the argument of a call; raise KernelError unless there is exactly one."""
        if len(node.args) != 1 or isinstance(node.args[0], ast.Starred):
            self.refuse(node, f"'{shown(node)}' has {len(node.args)} arguments", "give one")
        return node.args[0]

    def sqrt(self, node: ast.Call) -> Value:
        """Emit the correctly rounded square root; a negative number raises an error."""
        x = self.as_float(self.number(self.one(node)))
        # unordered: a NaN passes, as through math.sqrt
        self.check(self.value(f"fcmp uge double {x}, {number(0.0)}"), ValueError, "math domain error", node)
        return Value(FLOAT, self.value(f"call double @llvm.sqrt.f64(double {x})"))

    def absolute(self, node: ast.Call) -> Value:
        """Emit `abs(x)`."""
        x = self.number(self.one(node))
        if x.type == FLOAT:
            return Value(FLOAT, self.value(f"call double @llvm.fabs.f64(double {x.text})"))
        # |-2⁶³| does not fit into 64 bits
        opposite = self.overflowing("ssub", "0", x.text, node).text
        negative = self.value(f"icmp slt i64 {x.text}, 0")
        return Value(INT, self.value(f"select i1 {negative}, i64 {opposite}, i64 {x.text}"))

    def extreme(self, node: ast.Call) -> Value:
        """Emit `min` or `max`, as Python computes it.

        A later argument replaces an earlier one only if it is strictly smaller or larger.  This matters for NaN and
        -0.0.
        """
        values = [self.number(argument) for argument in node.args]
        kind = values[0].type if len(values) > 1 else None
        if kind is None or any(value.type != kind for value in values):
            self.refuse(node, f"'{shown(node)}'", "give two or more numbers of one type")
        return self.best(values, ast.Lt if self.outside(node.func) is min else ast.Gt)

    def to_whole(self, node: ast.Call) -> Value:
        """Emit `int`, `floor` or `ceil`, which round towards zero, down or up."""
        x = self.expression(self.one(node))
        function = self.outside(node.func)
        if x.type == INT:
            return x
        if x.type == BOOL and function is int:
            return Value(INT, self.value(f"zext i1 {x.text} to i64"))
        if x.type != FLOAT:
            self.refuse(node, f"'{shown(node)}' is given {x.type}", "give a number")
        return self.rounded(x.text, function, node)

    def to_float(self, node: ast.Call) -> Value:
        """Emit the conversion of an integer to the nearest float."""
        return Value(FLOAT, self.as_float(self.number(self.one(node))))

    def length(self, node: ast.Call) -> Value:
        """Return the length of an array along its first index, as an integer."""
        array = self.expression(self.one(node))
        if not array.sizes:
            self.refuse(node, f"'{shown(node)}' is given {array.type}", "give an array")
        return Value(INT, array.sizes[0], sure=True)


def _as_number(kind: Type) -> str:
    """Return the remedy, for an error message, for a value that must be a number but has another type."""
    if kind.layout and not kind.dimensions:
        return "name a field"
    return "write int(...)" if kind == BOOL else "compute cell by cell, in a loop"


_CALLS: list[tuple[Callable[..., object], Callable[[Expressions, ast.Call], Value]]] = [
    (math.sqrt, Expressions.sqrt),
    (min, Expressions.extreme),
    (max, Expressions.extreme),
    (abs, Expressions.absolute),
    (math.floor, Expressions.to_whole),
    (math.ceil, Expressions.to_whole),
    (int, Expressions.to_whole),
    (float, Expressions.to_float),
    (len, Expressions.length),
]
_PRINTERS: dict[type[ast.AST], Callable[..., Value]] = {
    ast.Constant: lambda self, node: self.constant(node.value, node),
    ast.Name: Expressions.name,
    ast.Attribute: Expressions.attribute,
    ast.UnaryOp: Expressions.unary,
    ast.BinOp: Expressions.binary,
    ast.Compare: Expressions.compare,
    ast.BoolOp: Expressions.logic,
    ast.IfExp: Expressions.choice,
    ast.Subscript: Expressions.subscript,
    ast.Call: Expressions.call,
}


_LARGEST_LOCAL = 256  # largest size of an array of `zeros` or `records`, which is on the stack
_LOCAL: dict[object, str] = {zeros: "name = zeros(3)", records: "name = records(Record, 3)"}


class Assignments(Expressions):
    """The part of the compiler that emits assignments to names, cells and rows."""

    def __init__(self, source: Source, callee: Callable[[Source], Function]) -> None:
        super().__init__(source, callee)
        self.depth = 0  # nesting depth of loops and branches
        self.memory: list[str] = []  # allocations of variables, at the start of the function
        self.count_of_slots = 0
        self.taken_from: dict[str, set[str]] = {}  # array variable -> variables whose arrays it views

    def store(self, name: str, value: Value, node: ast.AST) -> None:
        """Assign a value to a variable; the first assignment creates it."""
        held = self.variables.get(name)
        if held is None:
            held = self.variables[name] = self.variable(value, f"%x{len(self.variables)}.")
        if held.type != value.type:
            remedy = {FLOAT: "start it as 0.0, or write float(...)", INT: "start it as 0.0 if it is to be a float"}
            what = f"'{name}' is of type {held.type} and is given {value.type}"
            self.refuse(node, what, remedy.get(held.type, "take another name"))
        slots = [slot for leaf in held.leaves for slot in leaf.slots]
        for (kind, operand), slot in zip(value.operands, slots, strict=True):
            self.add(f"store {kind} {operand}, ptr {slot}")
            # later reads use the operand instead of a load, which halves the text
            self.facts[f"load {kind}, ptr {slot}"] = operand
        for (leaf, _), part in zip(value.type.leaves(name), value.leaves, strict=True):
            if part.root:
                self.taken_from.setdefault(leaf, set()).add(part.root)
        if self.assigned is not None:
            self.assigned |= {name}

    def variable(self, value: Value, name: str) -> Variable:
        """Allocate a variable for a value, with separate slots for the fields of a record."""
        if value.parts:
            parts = tuple(self.variable(part, f"{name}{place}.") for place, part in enumerate(value.parts))
            return Variable(value.type, (), parts)
        slots = tuple(f"{name}{place}" for place in range(len(value.operands)))
        # in the entry block: elsewhere LLVM keeps them in memory, and a loop would grow the stack
        self.memory += [f"  {slot} = alloca {kind}" for slot, (kind, _) in zip(slots, value.operands, strict=True)]
        return Variable(value.type, slots)

    def assign(self, node: ast.Assign) -> None:
        """Emit an assignment: `a = b`, `a = b = c`, `a, b = c, d`, `row = m[k]`, `m[k] = a, b`, `name = zeros(3)`."""
        if isinstance(node.value, ast.Call) and self.outside(node.value.func) in (zeros, records):
            return self.local_array(node, node.value)
        several = isinstance(node.value, ast.Tuple)
        if not several and not any(isinstance(target, ast.Tuple) for target in node.targets):
            value = self.expression(node.value)
            for target in node.targets:
                self.put(target, value)
            return None
        # all values are computed before the first assignment, as in Python: a, b = b, a swaps
        counts = {len(target.elts) for target in node.targets if isinstance(target, ast.Tuple)}
        values = self.values(node.value, counts, node.targets[0])
        for target in node.targets:
            if isinstance(target, ast.Tuple):
                for element, value in zip(target.elts, values, strict=True):
                    self.put(element, value)
            else:
                self.fill(target, values)
        return None

    def values(self, node: ast.expr, counts: set[int], target: ast.AST) -> list[Value]:
        """Return the values of a tuple, of a kernel with several results, of a record or of a row."""
        if isinstance(node, ast.Tuple):
            values = [self.expression(element) for element in node.elts]
        elif isinstance(node, ast.Call):
            values, called = self.results(node), source_of(self.outside(node.func))
            if len(values) == 1 and values[0].parts and (called is None or called.signature.single):
                values = [*values[0].parts]
        elif (row := self.expression(node)).parts:
            values = [*row.parts]
        else:
            if len(row.sizes) != 1 or row.type.layout:
                self.refuse(node, f"'{shown(node)}' is of type {row.type}", "assign a tuple or a row of an array")
            (wanted,) = counts
            good = self.value(f"icmp eq i64 {row.sizes[0]}, {wanted}")
            self.check(good, ValueError, f"a row of another length for {wanted} names", target)
            return [self.entry(row, place) for place in range(wanted)]
        if counts - {len(values)}:
            self.refuse(target, f"{len(values)} values for {max(counts)} names", "give each name a value")
        return values

    def entry(self, row: Value, place: int) -> Value:
        """Return one entry of a row whose length is known at compile time."""
        kind = Type(row.type.element)
        address = self.value(f"getelementptr inbounds {kind.llvm}, ptr {row.text}, i64 {place}")
        return Value(kind, self.emit(f"load {kind.llvm}, ptr {address}"))

    def put(self, target: ast.expr, value: Value) -> None:
        """Assign a value to a name or a cell."""
        if isinstance(target, ast.Name):
            self.store(target.id, value, target)
            return
        if not isinstance(target, ast.Subscript):
            self.refuse(target, f"'{shown(target)}' is assigned", _instead(target))
        place = self.place(target)
        self.written_cell(target, place, value)

    def written_cell(self, target: ast.Subscript, place: Value, value: Value) -> None:
        """Store a number in a cell, or a record in a row."""
        if place.sizes:
            self.refuse(target, f"'{shown(target)}' is a row", "assign a tuple, or copy cell by cell in a loop")
        if place.type != value.type:
            what = f"'{shown(target)}' is of type {place.type} and is given {value.type}"
            remedy = f"give a {place.type}" if place.type.layout else "write float(...), int(...), or 0.0 for 0"
            self.refuse(target, what, remedy)
        self.stored.add(place.root)
        self.put_into(place, value)

    def fill(self, target: ast.expr, values: Sequence[Value]) -> None:
        """Store the numbers of a tuple in a row."""
        if not isinstance(target, ast.Subscript):
            self.refuse(target, f"'{shown(target)}' is given a tuple", "give each number a name")
        row = self.place(target)
        if row.type.layout:
            self.refuse(
                target, f"'{shown(target)}' is a record and is given a tuple", f"write  {row.type.layout.name}(...)"
            )
        if len(row.sizes) != 1:
            self.refuse(target, f"'{shown(target)}' is no row", "assign a tuple to a row of numbers")
        kind = Type(row.type.element)
        if any(value.type != kind for value in values):
            self.refuse(target, f"'{shown(target)}' has cells of type {kind}", "write 0.0 for 0, or float(...)")
        self.stored.add(row.root)
        good = self.value(f"icmp eq i64 {row.sizes[0]}, {len(values)}")
        self.check(good, ValueError, f"{len(values)} numbers for a row of another length", target)
        for place, value in enumerate(values):
            address = self.value(f"getelementptr inbounds {kind.llvm}, ptr {row.text}, i64 {place}")
            self.add(f"store {kind.llvm} {value.text}, ptr {address}")

    def local_array(self, node: ast.Assign, call: ast.Call) -> None:
        """Emit `name = zeros(3, 2)` or `name = records(Ramp, 3)`: memory on the stack, cleared at each call."""
        (target, *more), sizes, arguments = node.targets, list[int](), call.args
        kind, most = Type("float"), 3
        if self.outside(call.func) is records:
            record = self.outside(arguments[0]) if arguments else None
            if not is_record(record):
                self.refuse(node, f"'{shown(call)}'", f"write  {_LOCAL[records]}")
            kind, most, arguments = Type("record", 0, self.source.layout(record, node)), 2, arguments[1:]
            if not kind.width:
                remedy = "keep whole numbers and arrays apart from the fields that a row holds"
                self.refuse(node, f"'{kind}' has fields that are neither float nor bool, and fits no row", remedy)
        for argument in arguments:
            length = argument.value if isinstance(argument, ast.Constant) else self.outside(argument)
            if isinstance(length, bool) or not isinstance(length, int) or length < 1:
                self.refuse(argument, f"'{shown(argument)}' is no fixed size", "write whole numbers, or give the array")
            sizes.append(length)
        count = kind.width
        for size in sizes:
            count *= size
        if call.keywords or not 1 <= len(sizes) <= most or count > _LARGEST_LOCAL:
            up_to = "one to three sizes" if most == 3 else "one or two sizes"
            self.refuse(node, f"'{shown(call)}'", f"write {up_to}, {_LARGEST_LOCAL} numbers at most")
        if more or not isinstance(target, ast.Name) or self.depth or target.id in self.variables:
            written = _LOCAL[self.outside(call.func)]
            remedy = f"write  {written}  once, in the kernel's body, outside of loops and branches"
            self.refuse(node, f"'{shown(node)}'", remedy)
        place = f"%z{len(self.variables)}"
        self.memory.append(f"  {place} = alloca [{count} x double]")
        self.add(f"store [{count} x double] zeroinitializer, ptr {place}")
        kind = kind._replace(dimensions=len(sizes))
        self.store(target.id, Value(kind, place, tuple(map(str, sizes)), target.id), node)

    def change(self, node: ast.AugAssign) -> None:
        """Emit `a += b`; the old value is read before b is computed."""
        if isinstance(node.target, ast.Name):
            old = self.number(ast.copy_location(ast.Name(node.target.id, ast.Load()), node.target))
            new = self.operation(node.op, old, self.number(node.value), node)
            self.store(node.target.id, new, node)
            return
        if not isinstance(node.target, ast.Subscript):
            self.refuse(node, f"'{shown(node)}'", _instead(node.target))
        place = self.place(node.target)
        if place.sizes:
            self.refuse(node, f"'{shown(node.target)}' is a row", "loop over its cells")
        if place.type.layout:
            self.refuse(node, f"'{shown(node.target)}' is a record", "compute with its fields")
        old = self.loaded(place)
        self.written_cell(node.target, place, self.operation(node.op, old, self.number(node.value), node))

    def slot(self, value: str) -> str:
        """Allocate a stack slot for an unnamed integer."""
        self.count_of_slots += 1
        place = f"%r{self.count_of_slots}"
        self.memory.append(f"  {place} = alloca i64")
        self.add(f"store i64 {value}, ptr {place}")
        return place

    def written(self, parameters: Sequence[str]) -> frozenset[int]:
        """Return the indices of the parameters or fields whose arrays are written to, directly or through a view."""
        reached, left = set[str](), [*self.stored]
        while left:
            name = left.pop()
            if name not in reached:
                reached.add(name)
                left += self.taken_from.get(name, ())
        return frozenset(place for place, name in enumerate(parameters) if name in reached)


def _instead(target: ast.expr) -> str:
    """Return the remedy, for an error message, for an assignment to a target that is neither a name nor a cell."""
    if isinstance(target, ast.Attribute):
        return f"assign to names and cells, and a record as a whole: record = record._replace({target.attr}=...)"
    return "assign to names and cells"


class _Loop(NamedTuple):
    """A loop: the labels to which `continue` and `break` jump, and the names assigned on each exit path."""

    onward: str
    out: str
    outcomes: list[frozenset[str] | None]
    facts: dict[str, str]  # facts that hold at the start of each iteration, and so after the loop


class Statements(Assignments):
    """The part of the compiler that emits statements, up to the whole kernel."""

    def __init__(self, source: Source, callee: Callable[[Source], Function]) -> None:
        super().__init__(source, callee)
        self.loops: list[_Loop] = []

    def function(self, symbol: str, number: int) -> Function:
        """Return the whole kernel as an LLVM function; `number` is added to its failure indices."""
        tree, signature = self.source.tree, self.source.signature
        stored, upward = assigned(tree)
        self.names = frozenset([*stored, *signature.names])
        self.counters = frozenset(upward.difference(signature.names))
        parameters: list[str] = []
        arguments = iter(
            [
                Value(
                    kind,
                    f"%a{place}",
                    tuple(f"%a{place}.{level}" for level in range(kind.dimensions)),
                    leaf if kind.dimensions else "",
                )
                for place, (leaf, kind) in enumerate(signature.leaves)
            ]
        )
        for parameter, kind in zip(signature.names, signature.parameters, strict=True):
            value = assembled(kind, arguments)
            parameters += [f"{word} {operand}" for word, operand in value.operands]
            if parameter in stored:
                self.store(parameter, value, tree)
            else:
                self.fixed[parameter] = value
        self.assigned = frozenset(signature.names)
        self.block_of(tree.body)
        if self.reached() and signature.results:
            self.refuse(tree.body[-1], "a path ends without a return", "return on every path, or raise")
        self.leave([]) if self.reached() else self.add("unreachable")
        returned = struct_type(signature.results)
        # one exit for all failures, so that a check costs a comparison and a branch; a status handed up from a called
        # kernel already contains the numbers of its file and kernel
        for label, ends, added in (("fail", self.failed, number), ("handed", self.handed, 0)):
            if ends:
                self.begin(label)
                status = self.phi("i64", ends)
                status = self.emit(f"add i64 {status}, {added}") if added else status
                failed = self.emit(f"insertvalue {returned} poison, i64 {status}, 0")
                self.add(f"ret {returned} {failed}")
        size, fails = len(self.lines) + self.size, bool(self.failed or self.handed)
        written, head = (
            self.written([leaf for leaf, _ in signature.leaves]),
            f"{returned} @{symbol}({', '.join(parameters)})",
        )
        function = Function(symbol, head, "", written, self.failures, fails, size, [*self.kernels], self.elementary)
        first = f"{head} #0{' alwaysinline' if function.small else ''} {{\nentry:"
        return function._replace(text="\n".join([first, *self.memory, *self.lines, "}", ""]))

    def block_of(self, body: Iterable[ast.stmt]) -> None:
        """Emit the statements of a block."""
        for node in body:
            print_it = _STATEMENTS.get(type(node))
            if print_it is None:
                remedy = REMEDIES.get(type(node), "kernels have assignments, if, while, for, return and raise")
                self.refuse(node, f"'{shown(node)}' ({type(node).__name__})", remedy)
            print_it(self, node)

    def inner(self, body: Iterable[ast.stmt]) -> None:
        """Emit the statements of a loop or branch."""
        self.depth += 1
        self.block_of(body)
        self.depth -= 1

    def merged(self, outcomes: Iterable[frozenset[str] | None]) -> frozenset[str] | None:
        """Return the names that are assigned on every reachable path; None if no path is reachable."""
        ways = [outcome for outcome in outcomes if outcome is not None]
        return frozenset.intersection(*ways) if ways else None

    def reached(self) -> bool:
        """Return True if the current point is reachable."""
        return self.assigned is not None

    def dead(self) -> None:
        """Begin an unreachable block."""
        self.assigned, self.facts = None, {}
        self.begin(self.label())

    def branch(self, node: ast.If) -> None:
        """Emit `if`, `elif`, `else`."""
        yes, no, after = self.label(), self.label(), self.label()
        self.choose(self.truth(node.test), yes, no)
        before, outcomes = self.assigned, list[frozenset[str] | None]()
        outer, facts = self.facts, list[dict[str, str]]()
        for label, body in ((yes, node.body), (no, node.orelse)):
            self.assigned, self.facts = before, dict(outer)
            self.begin(label)
            self.inner(body)
            self.jump(after)
            outcomes.append(self.assigned)
            facts += [self.facts] if self.reached() else []
        self.assigned = self.merged(outcomes)
        # the other branch has returned or raised: all facts of this one hold
        if len(facts) == 1:
            self.facts = facts[0]
        else:
            self.facts = {fact: value for fact, value in outer.items() if all(way.get(fact) == value for way in facts)}
        self.begin(after)

    def repeat(self, node: ast.While) -> None:
        """Emit a `while` loop."""
        head, body, after = self.label(), self.label(), self.label()
        endless = isinstance(node.test, ast.Constant) and node.test.value is True
        self.jump(head)
        self.begin(head)
        changed = self.forget(node)
        self.choose(self.truth(node.test), body, after)
        # `while True` ends only by break: its test adds no path to the code after it
        loop = _Loop(head, after, [None if endless else self.assigned], self.lasting(changed))
        self.begin(body)
        self.turn(node, loop)
        self.after(loop)

    def count(self, node: ast.For) -> None:
        """Emit a `for` loop over a range with a literal step; the range is evaluated once."""
        call, target = node.iter, node.target
        if not isinstance(call, ast.Call) or self.outside(call.func) is not range or call.keywords:
            self.refuse(node, f"for over '{shown(call)}'", "loop over range(...)")
        if not isinstance(target, ast.Name) or not 1 <= len(call.args) <= 3:
            self.refuse(node, f"'for {shown(target)} in {shown(call)}'", "write  for i in range(n)")
        limits = [self.whole(argument) for argument in call.args]
        step = limits[2].literal if len(limits) == 3 else 1
        if not step:
            self.refuse(call.args[2], f"the step '{shown(call.args[2])}'", "write a whole number that is not 0")
        start, stop = (Value(INT, "0"), limits[0]) if len(limits) == 1 else limits[:2]
        head, body, onward, after = self.label(), self.label(), self.label(), self.label()
        number, left = self.slot(start.text), ""
        # a step of 1 meets the end; a longer one could pass it, and 64 bits with it
        if abs(step) > 1:
            left = self.slot(self.turns(start.text, stop.text, step))
        self.jump(head)
        self.begin(head)
        changed = self.forget(node)
        value, rest = self.emit(f"load i64, ptr {number}"), ""
        if left:
            rest = self.emit(f"load i64, ptr {left}")
            more = self.emit(f"icmp ne i64 {rest}, 0")
        else:
            more = self.emit(f"icmp {'slt' if step > 0 else 'sgt'} i64 {value}, {stop.text}")
        self.choose(more, body, after)
        loop = _Loop(onward, after, [self.assigned], self.lasting(changed))
        self.begin(body)
        self.store(target.id, Value(INT, value), target)
        self.turn(node, loop)
        self.begin(onward)
        following = self.emit(f"add i64 {value}, {step}")
        self.add(f"store i64 {following}, ptr {number}")
        if left:
            fewer = self.emit(f"sub i64 {rest}, 1")
            self.add(f"store i64 {fewer}, ptr {left}")
        self.jump(head)
        self.after(loop)

    def turns(self, start: str, stop: str, step: int) -> str:
        """Return the iteration count of a range as an unsigned integer, for which 64 bits always suffice."""
        near, far = (start, stop) if step > 0 else (stop, start)
        some = self.emit(f"icmp slt i64 {near}, {far}")
        span = self.emit(f"sub i64 {far}, {near}")
        less = self.emit(f"sub i64 {span}, 1")
        whole = self.emit(f"udiv i64 {less}, {abs(step)}")
        count = self.emit(f"add i64 {whole}, 1")
        return self.emit(f"select i1 {some}, i64 {count}, i64 0")

    def turn(self, node: ast.While | ast.For, loop: _Loop) -> None:
        """Emit the body of a loop."""
        if node.orelse:
            self.refuse(node.orelse[0], "a loop with else", "set a bool before break, and test it after the loop")
        self.loops.append(loop)
        self.inner(node.body)
        self.loops.pop()
        self.jump(loop.onward)

    def forget(self, loop: ast.While | ast.For) -> set[str]:
        """Discard the cached values of variables that a loop changes; return these variables' load instructions."""
        # the head is also reached from the end of the body, where these variables have other values
        held = [self.variables[name] for name in assigned(loop)[0] if name in self.variables]
        changed = {load for variable in held for load in variable.loads}
        self.facts = self.lasting(changed)
        return changed

    def lasting(self, changed: set[str]) -> dict[str, str]:
        """Return the known facts except those that depend on the given load instructions."""
        return {fact: value for fact, value in self.facts.items() if fact not in changed}

    def after(self, loop: _Loop) -> None:
        """Begin the block after a loop."""
        self.assigned, self.facts = self.merged(loop.outcomes), loop.facts
        self.begin(loop.out)

    def leave_loop(self, node: ast.Break) -> None:
        """Emit `break`."""
        self.loops[-1].outcomes.append(self.assigned)
        self.jump(self.loops[-1].out)
        self.dead()

    def go_on(self, node: ast.Continue) -> None:
        """Emit `continue`."""
        self.jump(self.loops[-1].onward)
        self.dead()

    def give_back(self, node: ast.Return) -> None:
        """Emit `return`."""
        signature = self.source.signature
        wanted = signature.results
        if node.value is None or (isinstance(node.value, ast.Constant) and node.value.value is None):
            values: list[Value] = []
        elif signature.single:
            values = [self.expression(node.value)]
        elif isinstance(node.value, (ast.Tuple, ast.Call)):
            values = self.values(node.value, {len(wanted)}, node)
        else:
            self.refuse(node, f"'{shown(node)}' is no tuple", "return the numbers one by one")
        if [value.type for value in values] != [*wanted]:
            types = ", ".join(str(value.type) for value in values) or "nothing"
            names = ", ".join(map(str, wanted)) or "nothing"
            remedy = "write 0.0 for 0, float(...) or int(...)"
            self.refuse(node, f"{types} is returned where the annotation has {names}", remedy)
        self.leave(values)
        self.dead()

    def leave(self, values: Sequence[Value]) -> None:
        """Emit the return from the function with status 0."""
        returned = struct_type(self.source.signature.results)
        leaves = [leaf for value in values for leaf in value.leaves]
        aggregate = f"{{ {', '.join(['i64 0', *[f'{leaf.type.llvm} poison' for leaf in leaves]])} }}"
        for place, value in enumerate(leaves, start=1):
            aggregate = self.emit(f"insertvalue {returned} {aggregate}, {value.type.llvm} {value.text}, {place}")
        self.add(f"ret {returned} {aggregate}")

    def throw(self, node: ast.Raise) -> None:
        """Emit `raise` with a constant message."""
        call = node.exc
        if not isinstance(call, ast.Call) or node.cause or call.keywords or len(call.args) != 1:
            self.refuse(node, f"'{shown(node)}'", "write  raise ValueError('a fixed text')")
        kind, text = self.outside(call.func), call.args[0]
        if not (isinstance(kind, type) and issubclass(kind, Exception)):
            self.refuse(node, f"'{shown(call.func)}' is no error", "write  raise ValueError('a fixed text')")
        if not (isinstance(text, ast.Constant) and isinstance(text.value, str)):
            self.refuse(node, f"the text '{shown(text)}' is not fixed", "write it in quotes, or return a number for it")
        try:
            kind(text.value)
        except Exception:
            # the constructor of a user's error class may raise anything
            self.refuse(node, f"'{shown(call.func)}' is not made of a text alone", "write  raise ValueError(...)")
        self.end_with(str(self.failure(kind, text.value, node)))
        self.dead()

    def alone(self, node: ast.Expr) -> None:
        """Emit an expression statement: a docstring, or a kernel call for its side effects."""
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return
        if not isinstance(node.value, ast.Call):
            self.refuse(node, f"'{shown(node)}' does nothing", REMEDIES.get(type(node.value), "leave it out"))
        self.results(node.value)

    def nothing(self, node: ast.Pass) -> None:
        """Emit no code, as for `pass`."""


_STATEMENTS: dict[type[ast.AST], Callable[..., None]] = {
    ast.Assign: Statements.assign,
    ast.AugAssign: Statements.change,
    ast.If: Statements.branch,
    ast.While: Statements.repeat,
    ast.For: Statements.count,
    ast.Break: Statements.leave_loop,
    ast.Continue: Statements.go_on,
    ast.Return: Statements.give_back,
    ast.Raise: Statements.throw,
    ast.Expr: Statements.alone,
    ast.Pass: Statements.nothing,
}


def assigned(tree: ast.FunctionDef | ast.While | ast.For) -> tuple[set[str], set[str]]:
    """Return all assigned names, and those assigned only by loops that count up from a literal integer >= 0.

    The latter need no test for negative values when used as an index.
    """
    names, others, left = set[str](), set[str](), list[ast.AST]([tree])
    while left:
        node = left.pop()
        if isinstance(node, ast.For) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
            if not _upward(node.iter):
                others.add(node.target.id)
            left += node.body
            left += node.orelse
        elif isinstance(node, (ast.Assign, ast.AugAssign)):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                for element in target.elts if isinstance(target, ast.Tuple) else [target]:
                    if isinstance(element, ast.Name):
                        others.add(element.id)
        elif isinstance(node, (ast.If, ast.While)):
            left += node.body
            left += node.orelse
        elif isinstance(node, ast.FunctionDef):
            left += node.body
    return names | others, names - others


def _upward(call: ast.expr) -> bool:
    """Return True if a range counts up from a literal integer >= 0."""
    if not isinstance(call, ast.Call):
        return False
    start, step = (call.args[0] if len(call.args) > 1 else None), (call.args[2] if len(call.args) > 2 else None)
    return all(
        argument is None or (isinstance(argument, ast.Constant) and type(argument.value) is int)
        for argument in (start, step)
    )
