"""Variables and assignments of kernels as LLVM text."""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence

from feeddrive.language.kernels.expressions import Expressions
from feeddrive.language.kernels.names import Variable
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import FLOAT, INT, Source, Type, source_of
from feeddrive.language.kernels.text import Function, Value, shown

_LARGEST_LOCAL = 256  # numbers in an array of `zeros`: it lies on the stack


class Assignments(Expressions):
    """Prints assignments to names, cells and rows."""

    def __init__(self, source: Source, callee: Callable[[Source], Function]) -> None:
        super().__init__(source, callee)
        self.depth = 0  # loops and branches around a statement
        self.memory: list[str] = []  # of variables, at the start of the function
        self.count_of_slots = 0
        self.taken_from: dict[str, set[str]] = {}  # array variable -> variables whose arrays it views

    def store(self, name: str, value: Value, node: ast.AST) -> None:
        """Assign a value to a variable, which is created at its first assignment."""
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
            self.facts[f"load {kind}, ptr {slot}"] = operand
        for (leaf, _), part in zip(value.type.leaves(name), value.leaves, strict=True):
            if part.root:
                self.taken_from.setdefault(leaf, set()).add(part.root)
        if self.assigned is not None:
            self.assigned |= {name}

    def variable(self, value: Value, name: str) -> Variable:
        """Memory for a value of this type, and of its fields one by one."""
        if value.parts:
            parts = tuple(self.variable(part, f"{name}{place}.") for place, part in enumerate(value.parts))
            return Variable(value.type, (), parts)
        slots = tuple(f"{name}{place}" for place in range(len(value.operands)))
        self.memory += [f"  {slot} = alloca {kind}" for slot, (kind, _) in zip(slots, value.operands, strict=True)]
        return Variable(value.type, slots)

    def assign(self, node: ast.Assign) -> None:
        """A = b, a = b = c, a, b = c, d, row = m[k], m[k] = a, b, name = zeros(3)."""
        if isinstance(node.value, ast.Call) and self.outside(node.value.func) is zeros:
            return self.local_array(node, node.value)
        several = isinstance(node.value, ast.Tuple)
        if not several and not any(isinstance(target, ast.Tuple) for target in node.targets):
            value = self.expression(node.value)
            for target in node.targets:
                self.put(target, value)
            return None
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
        """The numbers of a tuple, of a kernel with several results, of a record or of a row."""
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
        """A number of a row whose length is known."""
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
        """Write a number into a cell, or a record into a row."""
        if place.sizes:
            self.refuse(target, f"'{shown(target)}' is a row", "assign a tuple, or copy cell by cell in a loop")
        if place.type != value.type:
            what = f"'{shown(target)}' is of type {place.type} and is given {value.type}"
            remedy = f"give a {place.type}" if place.type.layout else "write float(...), int(...), or 0.0 for 0"
            self.refuse(target, what, remedy)
        self.stored.add(place.root)
        self.put_into(place, value)

    def fill(self, target: ast.expr, values: Sequence[Value]) -> None:
        """Write the numbers of a tuple into a row."""
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
        """Name = zeros(3, 2): memory on the stack, cleared once a call."""
        (target, *more), sizes = node.targets, list[int]()
        for argument in call.args:
            length = argument.value if isinstance(argument, ast.Constant) else self.outside(argument)
            if isinstance(length, bool) or not isinstance(length, int) or length < 1:
                self.refuse(argument, f"'{shown(argument)}' is no fixed size", "write whole numbers, or give the array")
            sizes.append(length)
        count = 1
        for size in sizes:
            count *= size
        if call.keywords or not 1 <= len(sizes) <= 3 or count > _LARGEST_LOCAL:
            self.refuse(node, f"'{shown(call)}'", f"write one to three sizes, {_LARGEST_LOCAL} numbers at most")
        if more or not isinstance(target, ast.Name) or self.depth or target.id in self.variables:
            remedy = "write  name = zeros(3)  once, in the kernel's body, outside of loops and branches"
            self.refuse(node, f"'{shown(node)}'", remedy)
        place = f"%z{len(self.variables)}"
        self.memory.append(f"  {place} = alloca [{count} x double]")
        self.add(f"store [{count} x double] zeroinitializer, ptr {place}")
        self.store(target.id, Value(Type("float", len(sizes)), place, tuple(map(str, sizes)), target.id), node)

    def change(self, node: ast.AugAssign) -> None:
        """A += b; the old value is read before b is computed."""
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
        """Allocate memory for an unnamed whole number."""
        self.count_of_slots += 1
        place = f"%r{self.count_of_slots}"
        self.memory.append(f"  {place} = alloca i64")
        self.add(f"store i64 {value}, ptr {place}")
        return place

    def written(self, parameters: Sequence[str]) -> frozenset[int]:
        """Places of the parameters or fields whose arrays are written to, directly or through a view."""
        reached, left = set[str](), [*self.stored]
        while left:
            name = left.pop()
            if name not in reached:
                reached.add(name)
                left += self.taken_from.get(name, ())
        return frozenset(place for place, name in enumerate(parameters) if name in reached)


def _instead(target: ast.expr) -> str:
    """The remedy for an assignment to something that is neither a name nor a cell."""
    if isinstance(target, ast.Attribute):
        return f"assign to names and cells, and a record as a whole: record = record._replace({target.attr}=...)"
    return "assign to names and cells"
