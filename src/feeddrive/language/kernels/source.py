"""What a kernel is given as: the text of a Python function, the types of its annotations, the names that it uses."""

from __future__ import annotations

import ast
import builtins
import inspect
import linecache
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from types import FunctionType, ModuleType
from typing import Annotated, Any, NamedTuple, NoReturn, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from feeddrive.language.errors import FeeddriveError

# Arrays in C order, with one, two and three indices.
Floats: TypeAlias = Annotated[NDArray[np.float64], 1]
Floats2: TypeAlias = Annotated[NDArray[np.float64], 2]
Floats3: TypeAlias = Annotated[NDArray[np.float64], 3]
Ints: TypeAlias = Annotated[NDArray[np.int64], 1]

_LLVM = {"float": "double", "int": "i64", "bool": "i1"}


class KernelError(FeeddriveError):
    """A function that is not in the language of kernels; the message names file, line and what to write instead."""


class Type(NamedTuple):
    """A number, or an array of numbers with one to three indices."""

    element: str
    dimensions: int = 0

    def __str__(self) -> str:
        if not self.dimensions:
            return self.element
        return f"{self.element.capitalize()}s{self.dimensions if self.dimensions > 1 else ''}"

    @property
    def llvm(self) -> str:
        """The type of a number, or of the address of an array."""
        return "ptr" if self.dimensions else _LLVM[self.element]

    @property
    def cell(self) -> str:
        """The type of a number of an array."""
        return _LLVM[self.element]


FLOAT, INT, BOOL = Type("float"), Type("int"), Type("bool")
_TYPES: dict[object, Type] = {
    float: FLOAT, int: INT, bool: BOOL,
    Floats: Type("float", 1), Floats2: Type("float", 2), Floats3: Type("float", 3), Ints: Type("int", 1),
}  # fmt: skip
_STARS = inspect.CO_VARARGS | inspect.CO_VARKEYWORDS
_KNOWN = "float, int, bool, Floats, Floats2, Floats3 or Ints"


class Signature(NamedTuple):
    """Names and types of what a kernel is given, and types of what it returns."""

    names: tuple[str, ...]
    parameters: tuple[Type, ...]
    results: tuple[Type, ...]
    single: bool  # one number is returned as it is, several as a tuple


def _alone(lines: Sequence[str], first: int) -> ast.FunctionDef | None:
    """The function that begins at a line, if it ends where the first letter of a line next stands at its margin.

    Where that is not its end, in a text over several lines or in brackets, what stands before cannot be parsed.
    """
    begun, last = False, first - 1
    for line in lines[first - 1 :]:
        if begun and line[0] not in " \t\f\r\n#)":
            break
        begun, last = begun or line.startswith("def "), last + 1
    try:
        found = ast.parse("\n" * (first - 1) + "".join(lines[first - 1 : last])).body
    except SyntaxError:
        return None
    return found[0] if len(found) == 1 and isinstance(found[0], ast.FunctionDef) else None


@lru_cache(maxsize=64)
def _functions(text: str) -> dict[tuple[str, int], ast.FunctionDef]:
    """The functions of a file at its top level, by name and first line (that of the decorator)."""
    found = [node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)]
    return {(node.name, min([node.lineno, *[each.lineno for each in node.decorator_list]])): node for node in found}


@lru_cache(maxsize=1024)
def _parsed(annotation: str) -> ast.expr:
    """The expression of an annotation."""
    return ast.parse(annotation, mode="eval").body


class Source:
    """A Python function as the compiler reads it."""

    def __init__(self, python: FunctionType) -> None:
        self.python = python
        self.name = python.__name__
        self.file = python.__code__.co_filename
        self.unit: Any = None  # all kernels of its file, once they are asked for (`module.py`)
        self.part = False  # of kernels, which the compiler alone calls

    @cached_property
    def tree(self) -> ast.FunctionDef:
        """The function's text, parsed."""
        code = self.python.__code__
        place = ast.Pass(lineno=code.co_firstlineno)
        if self.python.__qualname__ != self.name or self.name == "<lambda>":
            self.refuse(place, "a kernel stands at the top level of its file", "move it there, without a closure")
        linecache.checkcache(self.file)
        try:
            tree = _alone(linecache.getlines(self.file), code.co_firstlineno)
            if tree is None:
                tree = _functions("".join(linecache.getlines(self.file))).get((self.name, code.co_firstlineno))
        except SyntaxError:
            tree = None
        given = [each.arg for each in [*tree.args.posonlyargs, *tree.args.args]] if tree else []
        if tree is None or (tree.name, given) != (self.name, [*code.co_varnames[: code.co_argcount]]):
            self.refuse(place, "its text is not in the file", "start Python again if the file has changed")
        if len(tree.decorator_list) > 1:
            self.refuse(tree, "a second decorator", "leave it out: a kernel has @kernel alone")
        return tree

    @cached_property
    def signature(self) -> Signature:
        """Types of parameters and results, for which the file need not be parsed."""
        code, annotations = self.python.__code__, self.python.__annotations__
        if code.co_flags & _STARS or code.co_kwonlyargcount or code.co_posonlyargcount or self.python.__defaults__:
            what = "defaults, * or / among the parameters"
            self.refuse(self.tree, what, "write plain parameters and give all of them")
        names = code.co_varnames[: code.co_argcount]
        if not {*names, "return"} <= annotations.keys() or not all(isinstance(x, str) for x in annotations.values()):
            return self._annotated([each.annotation for each in self.tree.args.args], self.tree.returns)
        try:
            return self._annotated([_parsed(annotations[name]) for name in names], _parsed(annotations["return"]))
        except KernelError:  # the line is that of the file
            return self._annotated([each.annotation for each in self.tree.args.args], self.tree.returns)

    def _annotated(self, given: Sequence[ast.expr | None], returns: ast.expr | None) -> Signature:
        """Types of annotations."""
        names, parameters = self.python.__code__.co_varnames, list[Type]()
        for place, each in enumerate(given):
            if each is None:
                what = f"the parameter '{names[place]}' has no type"
                self.refuse(self.tree.args.args[place], what, f"annotate it as {_KNOWN}")
            parameters.append(self._type(each))
        results, single = self._results(returns)
        return Signature(names[: len(given)], tuple(parameters), results, single)

    def _type(self, node: ast.expr) -> Type:
        """The type that an annotation names."""
        try:
            found = _TYPES.get(self.lookup(node))
        except TypeError:  # not hashable
            found = None
        return found or self.refuse(node, f"'{ast.unparse(node)}' is no type of a kernel", f"write {_KNOWN}")

    def _results(self, node: ast.expr | None) -> tuple[tuple[Type, ...], bool]:
        """Types of what is returned, and whether it is one number."""
        if node is None:
            self.refuse(self.tree, "no type is said to be returned", "write -> float, -> tuple[float, int] or -> None")
        if isinstance(node, ast.Constant) and node.value is None:
            return (), False
        single = not (isinstance(node, ast.Subscript) and self.lookup(node.value) is tuple)
        if isinstance(node, ast.Subscript) and not single:
            inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
            found = tuple(self._type(each) for each in inner)
        else:
            found = (self._type(node),)
        if any(each.dimensions for each in found):
            self.refuse(node, "an array is returned", "let the caller give the array that is filled")
        return found, single

    def lookup(self, node: ast.expr) -> object:
        """What a name outside of the function stands for, also within a module; None if it is not there."""
        if isinstance(node, ast.Name):
            return self.named[node.id] if node.id in self.named else self._outside(node.id)
        if isinstance(node, ast.Attribute):
            module = self.lookup(node.value)
            if not isinstance(module, ModuleType):
                return None
            name = f"{module.__name__}.{node.attr}"
            return self.named[name] if name in self.named else getattr(module, node.attr, None)
        return None

    @cached_property
    def named(self) -> dict[str, object]:
        """What the names of its code stand for, those in modules too, when it is first asked: it stays so."""
        names = self.python.__code__.co_names
        found = {each: self._outside(each) for each in names}
        left, seen = list(found.values()), set[int]()
        while left:
            module = left.pop()
            if isinstance(module, ModuleType) and id(module) not in seen:
                seen.add(id(module))
                inner = {f"{module.__name__}.{each}": vars(module)[each] for each in names if each in vars(module)}
                found |= inner
                left += inner.values()
        return found

    def _outside(self, name: str) -> object:
        """What a name outside of the function stands for."""
        names = self.python.__globals__
        return names[name] if name in names else getattr(builtins, name, None)

    def refuse(self, node: ast.AST, what: str, remedy: str) -> NoReturn:
        """The error that something is not in the language."""
        line = getattr(node, "lineno", self.python.__code__.co_firstlineno)
        raise KernelError(f"{self.file}, line {line}, kernel '{self.name}': {what}; {remedy}")


_Python = TypeVar("_Python", bound=Callable[..., object])


def readable(function: _Python) -> _Python:
    """Marks a function that only the compiler calls, as a part of kernels."""
    source = Source(cast(FunctionType, function))
    source.part = True
    vars(function)["source"] = source
    return function


def source_of(value: object) -> Source | None:
    """The source of a kernel; None for anything else."""
    found = getattr(value, "source", None)
    return found if isinstance(found, Source) else None
