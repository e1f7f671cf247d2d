"""The LLVM text of one kernel: its lines, blocks and checks, and Python's arithmetic."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, NoReturn

from feeddrive.language.kernels import elementary as remainder
from feeddrive.language.kernels.elementary import Elementary
from feeddrive.language.kernels.source import BOOL, FLOAT, INT, Source, Type, source_of
from feeddrive.language.machine_code import number


class Failure(NamedTuple):
    """An error that Python would raise, with its source and line."""

    kind: type[Exception]
    text: str
    source: Source
    line: int


# Replacements for constructs outside the language.
REMEDIES: dict[type[ast.AST], str] = {
    ast.Pow: "write x * x, or sqrt(x)",
    ast.Slice: "loop over the indices",
    ast.List: "let the caller give an array, or write  row = zeros(3)",
    ast.ListComp: "write a loop over an array that the caller gives",
    ast.Dict: "use arrays and whole numbers",
    ast.Lambda: "write another kernel",
    ast.JoinedStr: "use numbers alone",
    ast.NamedExpr: "assign in a line before",
    ast.Is: "compare numbers by ==",
    ast.In: "write a loop, or a chain of comparisons",
    ast.Try: "test before, or let the error go to the caller",
    ast.With: "leave it out",
    ast.Assert: "write  if ...: raise ValueError('why')",
    ast.FunctionDef: "write another kernel at the top level of the file",
    ast.Global: "take the number as an argument and return it",
    ast.Delete: "leave it out",
    ast.Match: "write if and elif",
    ast.Import: "import at the top of the file",
    ast.ImportFrom: "import at the top of the file",
    ast.AnnAssign: "leave the annotation out: a variable has the type of its first assignment",
    ast.BitAnd: "use and, or, not on bools",
    ast.BitOr: "use and, or, not on bools",
}


class Value(NamedTuple):
    """A number, an array (the address of its first cell and the size of each dimension), or a record."""

    type: Type
    text: str
    sizes: tuple[str, ...] = ()
    root: str = ""  # the variable that owns the memory of an array
    literal: int | None = None
    sure: bool = False  # an integer that is never negative
    parts: tuple[Value, ...] = ()  # the fields of a record

    @property
    def leaves(self) -> list[Value]:
        """The numbers and arrays of this value, with records flattened."""
        return [leaf for part in self.parts for leaf in part.leaves] if self.parts else [self]

    @property
    def operands(self) -> list[tuple[str, str]]:
        """The LLVM types and operands with which the value is passed to a function or stored."""
        return [
            word
            for leaf in self.leaves
            for word in ((leaf.type.llvm, leaf.text), *(("i64", size) for size in leaf.sizes))
        ]


def assembled(kind: Type, leaves: Iterator[Value]) -> Value:
    """Return a value of this type from its numbers and arrays, in order."""
    if kind.layout is None or kind.dimensions:
        return next(leaves)
    parts = tuple(assembled(field, leaves) for field in kind.layout.fields.values())
    return Value(kind, "", parts=parts)


class Function(NamedTuple):
    """A kernel as LLVM text, with the information that its callers need."""

    symbol: str
    head: str  # types of results and parameters, as a declaration has them
    text: str  # its definition, from the result types on
    written: frozenset[int]  # indices in `Signature.leaves` of the arrays to which it writes
    failures: list[Failure]  # errors of its own statuses, from 1 on
    fails: bool  # its status can be nonzero
    size: int  # number of lines, including inlined functions
    called: list[Source]
    elementary: list[Elementary]  # sin and the like that it calls

    @property
    def small(self) -> bool:
        """True if the function is inlined."""
        return self.size <= _INLINED


# Functions of at most so many lines are inlined, which makes code a tenth faster; inlining longer ones costs more time
# to compile than it gains.
_INLINED = 250


class Text:
    """The writer of the lines of one function, block by block.

    A function returns {status, results...}.  Status 0 is success.  In any other status, the low bits are the 1-based
    index of a `Failure` in the list of a kernel, and the higher bits identify that kernel.
    """

    def __init__(self, source: Source, callee: Callable[[Source], Function]) -> None:
        self.source = source
        self.callee = callee  # the function of another kernel
        self.failures: list[Failure] = []
        self.lines: list[str] = []
        self.facts: dict[str, str] = {}  # operation already computed on every path to the current point -> its value
        self.block = "entry"
        self.count = 0
        self.failed: list[tuple[str, str]] = []  # index of a failure, and the block where it occurs
        self.handed: list[tuple[str, str]] = []  # status of a called kernel, and the block where it occurs
        self.kernels: dict[Source, None] = {}  # kernels that it calls
        self.elementary: list[Elementary] = []  # sin and the like that it calls
        self.size = 0  # lines of inlined functions

    def called(self, source: Source) -> Function:
        """Return the LLVM function of a called kernel."""
        function = self.callee(source)
        self.kernels[source] = None
        self.size += function.size if function.small else 0
        return function

    def emit(self, text: str) -> str:
        """Append a line that defines a new value; return the value's name."""
        self.count += 1
        name = f"%v{self.count}"
        self.lines.append(f"  {name} = {text}")
        return name

    def value(self, text: str) -> str:
        """Return the value of an operation without side effects; the operation is emitted only once on each path."""
        value = self.facts.get(text)
        if value is None:
            value = self.facts[text] = self.emit(text)
        return value

    def add(self, text: str) -> None:
        """Append a line that defines no value."""
        self.lines.append(f"  {text}")

    def label(self) -> str:
        """Return a new block label."""
        self.count += 1
        return f"b{self.count}"

    def begin(self, label: str) -> None:
        """Begin a block."""
        self.block = label
        self.lines.append(f"{label}:")

    def jump(self, label: str) -> None:
        """Emit a jump to another block."""
        self.lines.append(f"  br label %{label}")

    def choose(self, condition: str, yes: str, no: str) -> None:
        """Emit a branch to one of two blocks."""
        self.lines.append(f"  br i1 {condition}, label %{yes}, label %{no}")

    def phi(self, kind: str, ends: list[tuple[str, str]]) -> str:
        """Return the value selected by the predecessor block (a phi node)."""
        return self.emit(f"phi {kind} {', '.join(f'[ {value}, %{block} ]' for value, block in ends)}")

    def check(self, good: str, kind: type[Exception], text: str, node: ast.AST) -> None:
        """Emit a check that raises the error unless `good` holds; a condition known to hold is not tested again."""
        if not self.holds(good):
            self.failed.append((str(self.failure(kind, text, node)), self.block))
            self.go_on_if(good, "fail")
            self.learn(good)

    def holds(self, good: str) -> bool:
        """Return True if a condition is known to hold on every path to the current point."""
        return f"true {good}" in self.facts

    def learn(self, good: str) -> None:
        """Record that a condition holds from the current point on."""
        self.facts[f"true {good}"] = good

    def failure(self, kind: type[Exception], text: str, node: ast.AST) -> int:
        """Add an error at the line of a node to the list of failures; return its index."""
        self.failures.append(Failure(kind, text, self.source, getattr(node, "lineno", 0)))
        return len(self.failures)

    def hand_up(self, status: str) -> None:
        """Emit code that returns from the function with the status of a called kernel if that status is not 0."""
        self.handed.append((status, self.block))
        self.go_on_if(self.emit(f"icmp eq i64 {status}, 0"), "handed")

    def go_on_if(self, good: str, other: str) -> None:
        """Emit a jump to the block `other` if `good` is false; the jump is marked as unlikely."""
        after = self.label()
        self.lines.append(f"  br i1 {good}, label %{after}, label %{other}, !prof !0")
        self.begin(after)

    def end_with(self, failure: str) -> None:
        """Emit a return from the function with the status of an error."""
        self.failed.append((failure, self.block))
        self.jump("fail")

    def refuse(self, node: ast.AST, what: str, remedy: str) -> NoReturn:
        """Raise KernelError for a construct outside the kernel language."""
        self.source.refuse(node, what, remedy)


def struct_type(results: Sequence[Type]) -> str:
    """Return the LLVM return type of a kernel: its status and its results, with records as separate fields."""
    leaves = [leaf.llvm for result in results for _, leaf in result.leaves("")]
    return f"{{ {', '.join(['i64', *leaves])} }}"


def shown(node: ast.AST) -> str:
    """Return the source of an expression, shortened for a message."""
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= 60 else text[:57] + "..."


_FLOATS = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul"}
_WHOLES = {ast.Add: "sadd", ast.Sub: "ssub", ast.Mult: "smul"}
# with a NaN Python's != is true and every other comparison false
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
    """The part of the compiler that emits operations on evaluated numbers."""

    def operation(self, op: ast.operator, left: Value, right: Value, node: ast.AST) -> Value:
        """Emit an operation on two numbers; an integer combined with a float is converted to float."""
        kind = type(op)
        whole = left.type == INT and right.type == INT
        if whole and kind in _WHOLES:
            # an overflow is an error, so sums and products of numbers >= 0 are >= 0
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
        """Emit `+`, `-` or `*` on 64-bit integers, with an overflow check."""
        both = self.value(f"call {{ i64, i1 }} @llvm.{operation}.with.overflow.i64(i64 {a}, i64 {b})")
        over = self.value(f"extractvalue {{ i64, i1 }} {both}, 1")
        self.check(self.value(f"xor i1 {over}, true"), OverflowError, _TOO_LARGE, node)
        return Value(INT, self.value(f"extractvalue {{ i64, i1 }} {both}, 0"))

    def floor_division(self, left_over: bool, left: Value, right: Value, node: ast.AST) -> Value:
        """Emit integer `//` or `%`, rounded down as in Python.

        Processor instructions round towards zero, and their division by -1 may trap.
        """
        a, b = left.text, right.text
        self.check(self.value(f"icmp ne i64 {b}, 0"), ZeroDivisionError, "division by zero", node)
        # -2⁶³ by -1 overflows, which is undefined in LLVM: divide by 1, and change the sign below
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
        """Emit a check that an integer is exact as a float: Python rounds a quotient of integers only once."""
        if value.literal is not None and abs(value.literal) <= 2**53:
            return
        # shifted by 2⁵³, one unsigned comparison tests both bounds
        moved = self.value(f"add i64 {value.text}, {2**53}")
        good = self.value(f"icmp ule i64 {moved}, {2**54}")
        self.check(good, OverflowError, "a quotient of whole numbers beyond 2**53", node)

    def as_float(self, value: Value) -> str:
        """Return a number as a float operand, rounded as in Python."""
        if value.type == FLOAT:
            return value.text
        if value.literal is not None:
            return number(float(value.literal))
        return self.value(f"sitofp i64 {value.text} to double")

    def compared(self, op: ast.cmpop, left: Value, right: Value, node: ast.Compare) -> str:
        """Emit one comparison; it is exact even if an integer is compared with a float."""
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
        """Compare an integer with a float: first as floats and, if these are equal, as integers."""
        rounded = self.as_float(whole)
        order = self.value(f"fcmp {_FLOAT_ORDER[kind]} double {rounded}, {real.text}")
        if whole.literal is not None and abs(whole.literal) <= 2**53:
            return order
        equal = self.value(f"fcmp oeq double {rounded}, {real.text}")
        below = self.value(f"fcmp olt double {rounded}, {_TOP}")
        # the conversion of 2⁶³ to an integer is undefined
        inside = self.value(f"select i1 {below}, double {rounded}, double {number(0.0)}")
        back = self.value(f"fptosi double {inside} to i64")
        exact = self.value(f"icmp {_ORDER[kind]} i64 {whole.text}, {back}")
        # rounded up to 2⁶³, the float is above every 64-bit integer
        at_top = "true" if kind in (ast.Lt, ast.LtE, ast.NotEq) else "false"
        settled = self.value(f"select i1 {below}, i1 {exact}, i1 {at_top}")
        return self.value(f"select i1 {equal}, i1 {settled}, i1 {order}")

    def best(self, values: Sequence[Value], kind: type[ast.cmpop]) -> Value:
        """Emit the minimum or maximum of numbers, as Python computes it.

        A later number replaces an earlier one only if it is strictly smaller or larger; this matters for NaN and -0.0.
        """
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
        """Emit the conversion of a float to an integer, rounded towards zero, down or up."""
        # 2⁶³ is too large, -2⁶³ is not; a NaN fails both
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
