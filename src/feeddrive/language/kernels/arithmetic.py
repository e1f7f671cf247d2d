"""Arithmetic of kernels as LLVM text: each operation gives the bits of Python, or a status where Python raises."""

from __future__ import annotations

import ast
import math
from collections.abc import Sequence

from feeddrive.language.kernels import remainder
from feeddrive.language.kernels.source import BOOL, FLOAT, INT, source_of
from feeddrive.language.kernels.text import REMEDIES, Text, Value, shown
from feeddrive.language.machine_code import number

_FLOATS = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul"}
_WHOLES = {ast.Add: "sadd", ast.Sub: "ssub", ast.Mult: "smul"}
_FLOAT_ORDER: dict[type[ast.cmpop], str] = {
    ast.Lt: "olt",
    ast.LtE: "ole",
    ast.Gt: "ogt",
    ast.GtE: "oge",
    ast.Eq: "oeq",
    ast.NotEq: "une",
}
_ORDER: dict[type[ast.cmpop], str] = {
    ast.Lt: "slt",
    ast.LtE: "sle",
    ast.Gt: "sgt",
    ast.GtE: "sge",
    ast.Eq: "eq",
    ast.NotEq: "ne",
}
_MIRRORED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.Gt,
    ast.LtE: ast.GtE,
    ast.Gt: ast.Lt,
    ast.GtE: ast.LtE,
    ast.Eq: ast.Eq,
    ast.NotEq: ast.NotEq,
}
_TOP = number(2.0**63)
LEAST = -(2**63)
_TOO_LARGE = "a whole number beyond 64 bits"


class Arithmetic(Text):
    """Operations on numbers that are computed already."""

    def operation(self, op: ast.operator, left: Value, right: Value, node: ast.AST) -> Value:
        """Print an operation on two numbers; a whole number beside a float is converted to float."""
        kind = type(op)
        whole = left.type == INT and right.type == INT
        if whole and kind in _WHOLES:
            sure = left.sure and right.sure and kind is not ast.Sub
            return self.overflowing(_WHOLES[kind], left.text, right.text, node)._replace(sure=sure)
        if whole and kind in (ast.FloorDiv, ast.Mod):
            return self.floor_division(kind is ast.Mod, left, right, node)
        if whole and kind is ast.Div:
            for operand in (left, right):
                self.check_exact(operand, node)
        a, b = self.as_float(left), self.as_float(right)
        if kind in _FLOATS:
            return Value(FLOAT, self.value(f"{_FLOATS[kind]} double {a}, {b}"))
        if kind not in (ast.Div, ast.FloorDiv, ast.Mod):
            self.refuse(node, f"'{shown(node)}'", REMEDIES.get(kind, "kernels have + - * / // %"))
        good = self.value(f"fcmp une double {b}, {number(0.0)}")
        self.check(good, ZeroDivisionError, "division by zero", node)
        if kind is ast.Div:
            return Value(FLOAT, self.value(f"fdiv double {a}, {b}"))
        called = source_of(remainder.floor_division if kind is ast.FloorDiv else remainder.modulo)
        assert called
        function = self.called(called)
        result = self.emit(f"call {{ i64, double }} @{function.symbol}(double {a}, double {b})")
        return Value(FLOAT, self.value(f"extractvalue {{ i64, double }} {result}, 1"))

    def overflowing(self, operation: str, a: str, b: str, node: ast.AST) -> Value:
        """+ - * on whole numbers of 64 bits."""
        both = self.value(f"call {{ i64, i1 }} @llvm.{operation}.with.overflow.i64(i64 {a}, i64 {b})")
        over = self.value(f"extractvalue {{ i64, i1 }} {both}, 1")
        self.check(self.value(f"xor i1 {over}, true"), OverflowError, _TOO_LARGE, node)
        return Value(INT, self.value(f"extractvalue {{ i64, i1 }} {both}, 0"))

    def floor_division(self, left_over: bool, left: Value, right: Value, node: ast.AST) -> Value:
        """// and % of whole numbers: the processor rounds to zero and Python down; by -1 the processor may stop."""
        a, b = left.text, right.text
        self.check(self.value(f"icmp ne i64 {b}, 0"), ZeroDivisionError, "division by zero", node)
        negated = self.value(f"icmp eq i64 {b}, -1")
        divisor = self.value(f"select i1 {negated}, i64 1, i64 {b}")
        rest = self.value(f"srem i64 {a}, {divisor}")
        some = self.value(f"icmp ne i64 {rest}, 0")
        signs = self.value(f"xor i64 {rest}, {divisor}")
        differ = self.value(f"icmp slt i64 {signs}, 0")
        down = self.value(f"and i1 {some}, {differ}")
        if left_over:
            added = self.value(f"add i64 {rest}, {divisor}")
            return Value(INT, self.value(f"select i1 {down}, i64 {added}, i64 {rest}"))
        quotient = self.value(f"sdiv i64 {a}, {divisor}")
        one = self.value(f"zext i1 {down} to i64")
        floor = self.value(f"sub i64 {quotient}, {one}")
        least = self.value(f"icmp eq i64 {a}, {LEAST}")
        over = self.value(f"and i1 {least}, {negated}")
        self.check(self.value(f"xor i1 {over}, true"), OverflowError, _TOO_LARGE, node)
        opposite = self.value(f"sub i64 0, {a}")
        return Value(INT, self.value(f"select i1 {negated}, i64 {opposite}, i64 {floor}"))

    def check_exact(self, value: Value, node: ast.AST) -> None:
        """Check that a whole number is exact as a float, since Python rounds a quotient of whole numbers once."""
        if value.literal is not None and abs(value.literal) <= 2**53:
            return
        moved = self.value(f"add i64 {value.text}, {2**53}")
        good = self.value(f"icmp ule i64 {moved}, {2**54}")
        self.check(good, OverflowError, "a quotient of whole numbers beyond 2**53", node)

    def as_float(self, value: Value) -> str:
        """A number as a float, as Python rounds it."""
        if value.type == FLOAT:
            return value.text
        if value.literal is not None:
            return number(float(value.literal))
        return self.value(f"sitofp i64 {value.text} to double")

    def compared(self, op: ast.cmpop, left: Value, right: Value, node: ast.Compare) -> str:
        """One comparison, exact also between a whole number and a float."""
        kind = type(op)
        if kind not in _ORDER:
            remedy = REMEDIES.get(kind) or REMEDIES[ast.Is if kind is ast.IsNot else ast.In]
            self.refuse(node, f"'{shown(node)}'", remedy)
        types = {left.type, right.type}
        if types == {BOOL} and kind in (ast.Eq, ast.NotEq):
            return self.value(f"icmp {_ORDER[kind]} i1 {left.text}, {right.text}")
        if not types <= {FLOAT, INT}:
            self.refuse(
                node, f"'{shown(node)}' compares {left.type} with {right.type}", "compare numbers, cell by cell"
            )
        if types == {FLOAT}:
            return self.value(f"fcmp {_FLOAT_ORDER[kind]} double {left.text}, {right.text}")
        if types == {INT}:
            return self.value(f"icmp {_ORDER[kind]} i64 {left.text}, {right.text}")
        if left.type == FLOAT:
            return self.mixed(_MIRRORED[kind], right, left)
        return self.mixed(kind, left, right)

    def mixed(self, kind: type[ast.cmpop], whole: Value, real: Value) -> str:
        """Compare a whole number with a float, by its nearest float and, where these are equal, as whole numbers."""
        rounded = self.as_float(whole)
        order = self.value(f"fcmp {_FLOAT_ORDER[kind]} double {rounded}, {real.text}")
        if whole.literal is not None and abs(whole.literal) <= 2**53:
            return order
        equal = self.value(f"fcmp oeq double {rounded}, {real.text}")
        below = self.value(f"fcmp olt double {rounded}, {_TOP}")
        inside = self.value(f"select i1 {below}, double {rounded}, double {number(0.0)}")
        back = self.value(f"fptosi double {inside} to i64")
        exact = self.value(f"icmp {_ORDER[kind]} i64 {whole.text}, {back}")
        at_top = "true" if kind in (ast.Lt, ast.LtE, ast.NotEq) else "false"  # 2**63 is above every whole number
        settled = self.value(f"select i1 {below}, i1 {exact}, i1 {at_top}")
        return self.value(f"select i1 {equal}, i1 {settled}, i1 {order}")

    def best(self, values: Sequence[Value], kind: type[ast.cmpop]) -> Value:
        """The least or largest number; a later one only if it is strictly less or more (NaN, -0.0)."""
        one = values[0].type
        order = _ORDER if one == INT else _FLOAT_ORDER
        better = order[kind]
        compare = "icmp" if one == INT else "fcmp"
        best = values[0].text
        for value in values[1:]:
            taken = self.value(f"{compare} {better} {one.llvm} {value.text}, {best}")
            best = self.value(f"select i1 {taken}, {one.llvm} {value.text}, {one.llvm} {best}")
        return Value(one, best)

    def rounded(self, x: str, function: object, node: ast.AST) -> Value:
        """A float as a whole number: towards zero, down or up."""
        below = self.value(f"fcmp olt double {x}, {_TOP}")
        above = self.value(f"fcmp oge double {x}, {number(-(2.0**63))}")
        bad, good = self.label(), self.label()
        self.choose(self.value(f"and i1 {below}, {above}"), good, bad)
        self.begin(bad)
        large = self.failure(OverflowError, _TOO_LARGE, node)
        none = self.failure(ValueError, "cannot convert float NaN to integer", node)
        broken = self.emit(f"fcmp uno double {x}, {x}")
        self.end_with(self.value(f"select i1 {broken}, i64 {none}, i64 {large}"))
        self.begin(good)
        cut = self.value(f"fptosi double {x} to i64")
        if function is int:
            return Value(INT, cut)
        back = self.value(f"sitofp i64 {cut} to double")
        passed = self.value(f"fcmp {'ogt' if function is math.floor else 'olt'} double {back}, {x}")
        one = self.value(f"zext i1 {passed} to i64")
        return Value(INT, self.value(f"{'sub' if function is math.floor else 'add'} i64 {cut}, {one}"))
