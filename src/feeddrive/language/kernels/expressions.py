"""Expressions of kernels as LLVM text: each operation gives the bits of Python, or a status where Python raises."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Iterable

from feeddrive.language.kernels.arithmetic import LEAST
from feeddrive.language.kernels.elementary import Elementary
from feeddrive.language.kernels.names import Names
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import BOOL, FLOAT, INT, Source, Type, is_record, source_of
from feeddrive.language.kernels.text import REMEDIES, Value, assembled, shown, struct
from feeddrive.language.machine_code import number


class Expressions(Names):
    """Prints expressions."""

    def expression(self, node: ast.expr) -> Value:
        """Print an expression with one value."""
        print_it = _PRINTERS.get(type(node))
        if print_it is None:
            kind = type(node).__name__
            self.refuse(node, f"'{shown(node)}' ({kind})", REMEDIES.get(type(node), "kernels compute with numbers"))
        return print_it(self, node)

    def number(self, node: ast.expr) -> Value:
        """An expression that gives a float or a whole number."""
        value = self.expression(node)
        if value.type not in (FLOAT, INT):
            self.refuse(node, f"'{shown(node)}' is of type {value.type}", _as_number(value.type))
        return value

    def truth(self, node: ast.expr) -> str:
        """An expression that gives a bool, as an operand."""
        value = self.expression(node)
        if value.type != BOOL:
            self.refuse(node, f"'{shown(node)}' is of type {value.type}, not bool", "compare it: x != 0.0")
        return value.text

    def whole(self, node: ast.expr) -> Value:
        """An expression that gives a whole number."""
        value = self.expression(node)
        if value.type != INT:
            self.refuse(node, f"'{shown(node)}' is of type {value.type}, not int", "write int(...) or floor(...)")
        return value

    # arithmetic

    def unary(self, node: ast.UnaryOp) -> Value:
        """-x, +x, not x."""
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
        """A + b and the like."""
        left = self.number(node.left)
        return self.operation(node.op, left, self.number(node.right), node)

    # comparisons and choices

    def compare(self, node: ast.Compare) -> Value:
        """A < b, also in a chain, whose rest is not computed behind the first comparison that is false."""
        left, ends = self.expression(node.left), list[tuple[str, str]]()
        after, before = self.label(), self.facts
        for place, (op, other) in enumerate(zip(node.ops, node.comparators, strict=True)):
            right = self.expression(other)
            truth = self.compared(op, left, right, node)
            if place + 1 < len(node.ops):
                onward = self.label()
                ends.append(("false", self.block))
                self.choose(truth, onward, after)
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
        """And, or; what follows is not computed where the first decides."""
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
        """A if c else b."""
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
        """The address of a cell, with the type of its number, or of a row, with its type and sizes."""
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
            offset = self.value(f"mul nsw i64 {offset}, {size}")
            if level < len(places):
                offset = self.value(f"add nsw i64 {offset}, {places[level]}")
        if array.type.layout:
            offset = self.value(f"mul nsw i64 {offset}, {array.type.width}")
        address = self.value(f"getelementptr inbounds {array.type.cell}, ptr {array.text}, i64 {offset}")
        rest = array.sizes[len(wholes) :]
        return Value(array.type._replace(dimensions=len(rest)), address, rest, array.root)

    def counted(self, index: Value, size: str) -> str:
        """An index counted from the start."""
        if index.sure:
            return index.text
        if index.literal is None:
            behind = self.value(f"icmp slt i64 {index.text}, 0")
            shifted = self.value(f"add i64 {index.text}, {size}")
            return self.value(f"select i1 {behind}, i64 {shifted}, i64 {index.text}")
        return str(index.literal + int(size)) if size.isdigit() else self.value(f"add i64 {index.text}, {size}")

    def check_indices(self, places: Iterable[tuple[str, str]], node: ast.AST) -> None:
        """End with an error if one of several indices is not within its size; known ones are not tested again."""
        left: list[str] = []
        for place, size in places:
            if not (place.isdigit() and size.isdigit() and int(place) < int(size)):
                good = self.value(f"icmp ult i64 {place}, {size}")
                if not self.known(good):
                    left.append(good)
        both = left[0] if left else ""
        for condition in left[1:]:
            both = self.value(f"and i1 {both}, {condition}")
        if both:
            self.check(both, IndexError, "index out of range", node)
        for condition in left:
            self.learn(condition)

    def subscript(self, node: ast.Subscript) -> Value:
        """The number in a cell, the record in a row, or a row of numbers: a view of the same memory."""
        place = self.place(node)
        return place if place.sizes else self.loaded(place)

    # calls

    def call(self, node: ast.Call) -> Value:
        """A call with one result."""
        results = self.results(node)
        if len(results) != 1:
            self.refuse(node, f"'{shown(node)}' gives {len(results)} numbers", "assign them to as many names")
        return results[0]

    def results(self, node: ast.Call) -> list[Value]:
        """A call of a kernel or of a function of the language."""
        if isinstance(node.func, ast.Attribute) and node.func.attr == "_replace":
            return [self.replaced(node, node.func.value)]
        function = self.outside(node.func)
        if is_record(function):
            return [self.constructed(self.source.layout(function, node), node)]
        if node.keywords:
            self.refuse(node, f"'{shown(node)}' names its arguments", "give them in their order")
        if function is zeros:
            remedy = "write  name = zeros(3)  in the kernel's body, outside of loops and branches"
            self.refuse(node, f"'{shown(node)}' makes an array here", remedy)
        called = source_of(function)
        if called is not None:
            return self.kernel(called, node)
        if isinstance(function, Elementary):
            return [self.angle(function, node)]
        printers = [print_it for known, print_it in _CALLS if function is known]
        if not printers:
            names = ", ".join(known.__name__ for known, _ in _CALLS)
            remedy = f"call kernels, {names}, zeros, or sin and the like of {Elementary.__module__}"
            self.refuse(node, f"'{shown(node.func)}' is no kernel", remedy)
        return [printers[0](self, node)]

    def kernel(self, called: Source, node: ast.Call) -> list[Value]:
        """A call of a kernel, of this file or another; its errors are handed up."""
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
        returned = struct(wanted.results)
        result = self.emit(f"call {returned} @{function.symbol}({', '.join(operands)})")
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
        """A call of sin, cos, tan, atan or atan2."""
        if len(node.args) != function.arity:
            self.refuse(node, f"'{shown(node)}' has {len(node.args)} arguments", f"give {function.arity}")
        arguments = ", ".join(f"double {self.as_float(self.number(argument))}" for argument in node.args)
        self.elementary.append(function)
        return Value(FLOAT, self.emit(f"call double {function.symbol}({arguments})"))

    def one(self, node: ast.Call) -> ast.expr:
        """The only argument of a call."""
        if len(node.args) != 1 or isinstance(node.args[0], ast.Starred):
            self.refuse(node, f"'{shown(node)}' has {len(node.args)} arguments", "give one")
        return node.args[0]

    def sqrt(self, node: ast.Call) -> Value:
        """The correctly rounded root; a negative number is an error."""
        x = self.as_float(self.number(self.one(node)))
        self.check(self.value(f"fcmp uge double {x}, {number(0.0)}"), ValueError, "math domain error", node)
        return Value(FLOAT, self.value(f"call double @llvm.sqrt.f64(double {x})"))

    def absolute(self, node: ast.Call) -> Value:
        """|x|."""
        x = self.number(self.one(node))
        if x.type == FLOAT:
            return Value(FLOAT, self.value(f"call double @llvm.fabs.f64(double {x.text})"))
        opposite = self.overflowing("ssub", "0", x.text, node).text
        negative = self.value(f"icmp slt i64 {x.text}, 0")
        return Value(INT, self.value(f"select i1 {negative}, i64 {opposite}, i64 {x.text}"))

    def extreme(self, node: ast.Call) -> Value:
        """The least or largest: a later one only if it is really less or more, which matters for NaN and -0.0."""
        values = [self.number(argument) for argument in node.args]
        kind = values[0].type if len(values) > 1 else None
        if kind is None or any(value.type != kind for value in values):
            self.refuse(node, f"'{shown(node)}'", "give two or more numbers of one type")
        return self.best(values, ast.Lt if self.outside(node.func) is min else ast.Gt)

    def to_whole(self, node: ast.Call) -> Value:
        """int, floor, ceil: towards zero, down, up."""
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
        """The nearest float of a whole number."""
        return Value(FLOAT, self.as_float(self.number(self.one(node))))

    def length(self, node: ast.Call) -> Value:
        """The length of an array along its first index."""
        array = self.expression(self.one(node))
        if not array.sizes:
            self.refuse(node, f"'{shown(node)}' is given {array.type}", "give an array")
        return Value(INT, array.sizes[0], sure=True)


def _as_number(kind: Type) -> str:
    """The remedy where something else than a number was used as one."""
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
