"""Lines and blocks of LLVM text of one function, and the checks that end it with a status."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, NoReturn

from feeddrive.language.kernels.elementary import Elementary
from feeddrive.language.kernels.source import Source, Type


class Failure(NamedTuple):
    """An error that Python would raise, and where."""

    kind: type[Exception]
    text: str
    source: Source
    line: int


# What to write instead of what is not in the language.
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
    """A number; an array, by the address of its first cell and how many entries each index has; or a record."""

    type: Type
    text: str
    sizes: tuple[str, ...] = ()
    root: str = ""  # the variable in whose memory an array lies
    literal: int | None = None
    sure: bool = False  # a whole number that is never below 0
    parts: tuple[Value, ...] = ()  # the fields of a record

    @property
    def leaves(self) -> list[Value]:
        """The numbers and arrays of which it consists."""
        return [leaf for part in self.parts for leaf in part.leaves] if self.parts else [self]

    @property
    def operands(self) -> list[tuple[str, str]]:
        """LLVM types and operands by which it is handed to a function, or kept in memory."""
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
    """A printed kernel."""

    symbol: str
    head: str  # types of results and parameters, as a declaration has them
    text: str  # of its definition, from the types of its results on
    written: frozenset[int]  # places of the arrays into which it writes, among `Signature.leaves`
    failures: list[Failure]  # behind its own statuses
    fails: bool  # its status can be other than 0
    size: int  # lines, with those of inlined functions
    called: list[Source]
    elementary: list[Elementary]  # sin and the like that it calls

    @property
    def small(self) -> bool:
        """True if it is inlined."""
        return self.size <= _INLINED


# Functions of at most so many lines are inlined, which makes code a tenth faster; inlining longer ones costs more time
# to compile than it gains.
_INLINED = 250


class Text:
    """Writes the lines of one function, block after block.

    A function returns {status, results...}.  Status 0 is success; any other is the place of a `Failure` in the list of
    a kernel, from 1, and the number of that kernel in the bits above.
    """

    def __init__(self, source: Source, callee: Callable[[Source], Function]) -> None:
        self.source = source
        self.callee = callee  # the function of another kernel
        self.failures: list[Failure] = []
        self.lines: list[str] = []
        self.facts: dict[str, str] = {}  # operation computed already on every path to here -> its value
        self.block = "entry"
        self.count = 0
        self.failed: list[tuple[str, str]] = []  # place of a failure, and block from which it comes
        self.handed: list[tuple[str, str]] = []  # status of a called kernel, and block from which it comes
        self.kernels: dict[Source, None] = {}  # that it calls
        self.elementary: list[Elementary] = []  # sin and the like that it calls
        self.size = 0  # lines of inlined functions

    def called(self, source: Source) -> Function:
        """The function of a kernel that is called."""
        function = self.callee(source)
        self.kernels[source] = None
        self.size += function.size if function.small else 0
        return function

    def emit(self, text: str) -> str:
        """Add a line that defines a new value, and return the value's name."""
        self.count += 1
        name = f"%v{self.count}"
        self.lines.append(f"  {name} = {text}")
        return name

    def value(self, text: str) -> str:
        """Return the value of an operation without side effects, computed once on a path."""
        value = self.facts.get(text)
        if value is None:
            value = self.facts[text] = self.emit(text)
        return value

    def add(self, text: str) -> None:
        """Add a line that defines no value."""
        self.lines.append(f"  {text}")

    def label(self) -> str:
        """Return a new name of a block."""
        self.count += 1
        return f"b{self.count}"

    def begin(self, label: str) -> None:
        """Begin a block."""
        self.block = label
        self.lines.append(f"{label}:")

    def jump(self, label: str) -> None:
        """Jump to another block."""
        self.lines.append(f"  br label %{label}")

    def choose(self, condition: str, yes: str, no: str) -> None:
        """Branch to one of two blocks."""
        self.lines.append(f"  br i1 {condition}, label %{yes}, label %{no}")

    def phi(self, kind: str, ends: list[tuple[str, str]]) -> str:
        """Return the value that comes from one of several blocks."""
        return self.emit(f"phi {kind} {', '.join(f'[ {value}, %{block} ]' for value, block in ends)}")

    def check(self, good: str, kind: type[Exception], text: str, node: ast.AST) -> None:
        """Continue if `good`, else end with the error; a condition that is known to hold is not tested again."""
        if not self.known(good):
            self.failed.append((str(self.failure(kind, text, node)), self.block))
            self.go_on_if(good, "fail")
            self.learn(good)

    def known(self, good: str) -> bool:
        """Return True if a condition is known to hold on every path to here."""
        return f"true {good}" in self.facts

    def learn(self, good: str) -> None:
        """Record that a condition holds from here on."""
        self.facts[f"true {good}"] = good

    def failure(self, kind: type[Exception], text: str, node: ast.AST) -> int:
        """Add an error at a line, and return its place in the list."""
        self.failures.append(Failure(kind, text, self.source, getattr(node, "lineno", 0)))
        return len(self.failures)

    def hand_up(self, status: str) -> None:
        """Continue if the status of a called kernel is 0, else end with it."""
        self.handed.append((status, self.block))
        self.go_on_if(self.emit(f"icmp eq i64 {status}, 0"), "handed")

    def go_on_if(self, good: str, other: str) -> None:
        """Continue if `good`, else jump to another block, which is marked as the rare case."""
        after = self.label()
        self.lines.append(f"  br i1 {good}, label %{after}, label %{other}, !prof !0")
        self.begin(after)

    def end_with(self, failure: str) -> None:
        """End with the place of an error."""
        self.failed.append((failure, self.block))
        self.jump("fail")

    def refuse(self, node: ast.AST, what: str, remedy: str) -> NoReturn:
        """Raise KernelError for something that is not in the language."""
        self.source.refuse(node, what, remedy)


def struct(results: Sequence[Type]) -> str:
    """The LLVM type that a kernel returns: its status and its results, records as their fields."""
    leaves = [leaf.llvm for result in results for _, leaf in result.leaves("")]
    return f"{{ {', '.join(['i64', *leaves])} }}"


def shown(node: ast.AST) -> str:
    """The text of an expression for a message, shortened."""
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= 60 else text[:57] + "..."
